"""Control variates: second moments made sharper by the identities of any stationary state.

The generator applied to q_i q_j, q_i p_i, p_i² and the potential energy has mean zero. What such a
control shows on a trajectory is chance alone, and what of it is correlated with the wanted mean is
taken away by regression (Glasserman 2003, section 4.1).
"""

from dataclasses import dataclass
from functools import cached_property
from math import sqrt

import numpy as np
from numpy.typing import NDArray

from fpk.system import System
from sim.statistics import Product, moment_products

Array = NDArray[np.float64]

DEPENDENT = 1e-9
"""Share of variance below which a direction of the correlated controls counts as none: beneath it
regression would fit the round-off of the sums."""


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
    """A mean by control variates, one standard error of it, and the variance gained.

    ``gain`` is the variance of the plain mean over that of this one, the cost of the fit included.
    """

    value: float
    error: float
    gain: float


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

    With normal means the coefficients of p controls, fitted to the same data, multiply the variance
    of what is left by (N − 2)/(N − p − 2) (Lavenberg and Welch 1981), whose unbiased estimate has
    N − p − 1 degrees of freedom. Controls that depend on each other are used once. The mean of more
    than these N has the same factor: errors of the coefficients are uncorrelated with what is left
    of the others, too, and their share, p/(N − p − 2), multiplies the variance of that mean.
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
    plain = float(target @ paths.covariance @ target)
    left = max(0.0, plain - float(with_target @ with_target))
    N, p = paths.fitted, int(kept.sum())
    value = float(target @ paths.mean) - float(with_target @ (W @ (rows @ paths.mean - expected)))
    variance = left * (N - 1.0) / (N - p - 1.0) * (N - 2.0) / (N - p - 2.0)
    gain = plain / variance if variance > 0 else np.inf
    return ControlledMean(value, sqrt(variance / paths.count), gain)
