"""Control variates: second moments made sharper by the identities of any stationary state.

The generator applied to q_i q_j, q_i p_i, p_i² and the potential energy has mean zero. What such a
control shows on a trajectory is chance, and what of it is correlated with the wanted mean is taken
away by regression (Glasserman 2003, section 4.1).

The means of the controls are those of the continuous system; a chain of steps h has others, off by
their own step bias δ(h). The controlled mean then is off by ``−b·δ`` beside the step bias of the
plain one, b being the coefficients: it is no longer the mean of the states, whose density is seen
in the histograms, and none the better for it. So the mean of the states is the plain one, and a
controlled one stands beside it only while the controls' means cannot be told from the continuous
ones (``ControlledMean.chance``). Even then the sample alone does not pay: δ is known from it to
the standard error of the controls' means, ``b·δ`` so to √(b·S b/N) (``unseen``), S their covariance
on one trajectory, and the squares of this and of the error of regression sum to that of the plain
mean. What is gained rests on knowing beforehand that δ is small beside ``unseen``, as of a scheme
of fourth order well below the steps that show a bias, or of one that is exact without contact.
"""

from dataclasses import dataclass
from functools import cached_property
from math import sqrt

import numpy as np
from numpy.typing import NDArray
from scipy.stats import f as fisher
from scipy.stats import t as student

from fpk.system import System
from sim.statistics import Mean, Product, moment_products

Array = NDArray[np.float64]

DEPENDENT = 1e-9
"""Share of variance below which a direction of the correlated controls counts as none: beneath it
regression would fit the round-off of the sums."""

FALSE_ALARMS = 0.01
"""How often controls of a mean are refused whose means are those that they are said to have: the
price is only what they gain."""


@dataclass(frozen=True, eq=False)
class PathMeans:
    """Means over each of ``count`` independent trajectories: their mean and their covariance.

    The covariance is that of ``fitted`` of them.
    """

    system: System
    count: int
    fitted: int
    mean: Array  # (products,)
    covariance: Array  # (products, products), of one trajectory's means


@dataclass(frozen=True, eq=False)
class ControlledMean:
    """A mean by control variates, one standard error of it, and the plain mean.

    ``error`` holds if the controls have the means of the continuous system. ``unseen`` is what they
    may be off without being seen makes of the mean, at one standard error; ``chance`` how often
    they, or what they correct here, deviate so much where they are right. ``gain`` is the variance
    of the plain mean over the square of ``error``, the cost of the fit included.
    """

    value: float
    error: float
    gain: float
    unseen: float
    chance: float
    plain: Mean

    @property
    def held(self) -> bool:
        """Whether chance explains how far the controls' means are off."""
        return self.chance >= FALSE_ALARMS


@dataclass(frozen=True, eq=False)
class Controls:
    """Linear functions of the products with known means: ``rows @ E products = expected``."""

    system: System

    @cached_property
    def products(self) -> tuple[Product, ...]:
        """The products in the order of the sums."""
        return moment_products(self.system.n, terms=bool(self.system.damping_terms))

    def row(self, *terms: tuple[float, str, int, str, int]) -> Array:
        """Return the coefficients of Σ factor · product, (products,)."""
        found = np.zeros(len(self.products))
        for factor, a, i, b, j in terms:
            key = (a, i, b, j) if (a, i, b, j) in self.products else (b, j, a, i)
            found[self.products.index(key)] += factor
        return found

    def _damped(self, a: str, i: int) -> list[tuple[float, str, int, str, int]]:
        """Terms of E a_i Σ_j c_ij v_j, damping terms among them."""
        c, m = self.system.damping, self.system.mass
        found = [(float(c[i, j] / m[j]), a, i, "p", j) for j in range(self.system.n)]
        return found + ([(1.0, a, i, "d", i)] if self.system.damping_terms else [])

    @cached_property
    def identities(self) -> tuple[Array, Array]:
        """The controls (controls, products) and their means (controls,), N = f D fᵀ.

        ``q_i v_j + q_j v_i`` and ``Σ v_i F_i`` are rates of change of q_i q_j and V: zero;
        ``m_i v_i² − q_i F_i − Σ_j c_ij q_i v_j`` is that of q_i p_i: zero;
        ``p_i F_i + Σ_j c_ij p_i v_j`` has the mean N_ii, from p_i².
        """
        m, noise = self.system.mass, self.system.noise_matrix
        masses = range(self.system.n)
        rows, expected = [], []
        for i in masses:
            for j in range(i, self.system.n):
                rows.append(self.row((1.0 / m[j], "q", i, "p", j), (1.0 / m[i], "q", j, "p", i)))
                expected.append(0.0)
        rows.append(self.row(*((1.0 / m[i], "p", i, "f", i) for i in masses)))
        expected.append(0.0)
        for i in masses:
            virial = self.row((1.0 / m[i], "p", i, "p", i), (-1.0, "q", i, "f", i))
            rows += [virial - self.row(*self._damped("q", i))]
            rows += [self.row((1.0, "p", i, "f", i), *self._damped("p", i))]
            expected += [0.0, float(noise[i, i])]
        return np.array(rows), np.array(expected)


def path_means(
    system: System,
    sums: Array,
    live: NDArray[np.int64],
    samples: int,
    *,
    whole: tuple[int, Array] | None = None,
) -> PathMeans:
    """Return mean and covariance of the trajectories' means.

    ``sums`` has the shape (blocks, products, lanes), of which ``live`` (blocks or more,) count in
    each block. The order of summation is fixed by the blocks. ``whole`` are number and mean of all
    trajectories, where those in ``sums`` are some of them.
    """
    live = live[: sums.shape[0]]
    alive = np.arange(sums.shape[2]) < live[:, None]
    count = int(live.sum())
    means = np.where(alive[:, None, :], sums / max(1, samples), 0.0)
    mean = means.sum(axis=2).sum(axis=0) / count
    means -= np.where(alive[:, None, :], mean[None, :, None], 0.0)
    covariance = (means @ means.transpose(0, 2, 1)).sum(axis=0) / max(1, count - 1)
    number, mean = whole or (count, mean)
    return PathMeans(system, number, count, mean, covariance)


def displacement_square(paths: PathMeans, i: int) -> ControlledMean:
    """Return E q_i² by control variates, the mass counted from 0."""
    return _controlled(paths, Controls(paths.system).row((1.0, "q", i, "q", i)))


def velocity_square(paths: PathMeans, i: int) -> ControlledMean:
    """Return E v_i² by control variates, the mass counted from 0."""
    row = Controls(paths.system).row((1.0 / paths.system.mass[i] ** 2, "p", i, "p", i))
    return _controlled(paths, row)


def _controlled(paths: PathMeans, target: Array) -> ControlledMean:
    """Regression of the target on the controls, fitted to N trajectories.

    With N' trajectories in all, whose mean of the controls is d off, the variance is
    ``s² (1/N' + dᵀ S⁻¹ d/(N − 1))``: that of what the p controls leave of the target, s² with
    N − p − 1 degrees of freedom, and that of the coefficients times d. It is conditional on d. Its
    mean over d, (N − 2)/(N − p − 2) (Lavenberg and Welch 1981), is too small where d is more than
    chance: by 43 for fig6 by BAOAB with h = 0.3 after 15 relaxation times. Errors of the
    coefficients are uncorrelated with what is left of any mean, of these N or of all N'.
    Controls that depend on each other are used once.

    ``chance`` is twice the smaller of two probabilities: of Hotelling's ``T² = N' dᵀ S⁻¹ d``,
    F(p, N − p), and of the correction b·d over its own standard error, in which few of many
    controls that are off are seen better.
    """
    rows, expected = Controls(paths.system).identities
    cov = rows @ paths.covariance @ rows.T
    size = np.sqrt(np.diag(cov))
    size[size == 0.0] = 1.0
    variances, directions = np.linalg.eigh(cov / np.outer(size, size))
    kept = variances > DEPENDENT * float(variances[-1])
    # Uncorrelated controls of variance one.
    W = (directions[:, kept] / np.sqrt(variances[kept])).T / size
    with_target = W @ rows @ paths.covariance @ target
    off = W @ (rows @ paths.mean - expected)
    N, p, all_paths = paths.fitted, int(kept.sum()), paths.count
    correction = float(with_target @ off)
    left, plain = _variance(target - with_target @ W @ rows, paths), _variance(target, paths)
    square = float(off @ off)
    variance = left * (N - 1.0) / (N - p - 1.0) * (1.0 / all_paths + square / (N - 1.0))
    unseen = float(np.linalg.norm(with_target)) / sqrt(all_paths)
    by_all = float(fisher.sf(all_paths * square * (N - p) / ((N - 1.0) * p), p, N - p))
    by_one = 2.0 * float(student.sf(abs(correction) / unseen, N - 1)) if unseen > 0 else 1.0
    mean = float(target @ paths.mean)
    return ControlledMean(
        value=mean - correction,
        error=sqrt(variance),
        gain=plain / (all_paths * variance) if variance > 0 else np.inf,
        unseen=unseen,
        chance=min(1.0, 2.0 * min(by_all, by_one)),
        plain=Mean(mean, sqrt(plain / all_paths)),
    )


def _variance(row: Array, paths: PathMeans) -> float:
    """Return the variance of ``row @ products`` and what round-off may have made of it.

    An element of the covariance is a sum of N products, in whatever order, the quadratic form one
    of 2n + 2: half an ulp of ``(|row| · sizes)²`` each, sizes the standard deviations, and as much
    for the centring. What the controls determine thus has the variance of its round-off, and none
    is negative.
    """
    size = float(np.abs(row) @ np.sqrt(np.diag(paths.covariance)))
    operations = paths.fitted + 2 * row.size + 2
    round_off = operations * float(np.finfo(np.float64).eps) * size**2
    return float(row @ paths.covariance @ row) + round_off
