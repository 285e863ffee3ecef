"""The density between the edges of bins: exp(polynomial) on boxes of bins, fitted to their counts.

On a box the density of one or two coordinates is ``p = r exp(Σ_j θ_j P_j)``, P_j products of
Legendre polynomials of the bin number and r a known reference. The θ are those of maximum
likelihood of the *contents* of the bins, integrals of p: the width of the bins is not in the
answer, and p is positive. Boxes end at the known kinks of p. A box whose highest coefficients are
not consistent with 0 is halved, and each box that fits is halved once more, so that a misfit that
the test does not see is small beside the sampling error. Errors follow from independent batches.
Kooperberg and Stone, Comput. Stat. Data Anal. 12, 1991, 327 (logspline density estimation).
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from itertools import pairwise, product

import numpy as np
from numpy.polynomial.legendre import legvander
from scipy.special import chdtrc, fdtrc, stdtr

from fpk.arrays import Array, Flags, Integers
from fpk.bins import LARGEST_LOG, NODES, BinAxis

Bins = tuple[int, ...]
"""A bin number for each axis."""

DEGREE = 8
"""Largest total degree of ln p on a box."""
HIGHEST = {1: 3, 2: 2}
"""How many of the highest degrees must be consistent with 0, by the number of coordinates."""
LEAST_BINS = DEGREE + 4
"""Bins along each axis of the smallest box: more than coefficients, so that a misfit shows."""
PER_COEFFICIENT = 30
"""Least number of independent samples for each coefficient, which is then known to some 20 %."""
PER_BATCH = 10
"""Samples in each batch above which the mean of all batches is nearly normal."""
STEPS, HALVINGS, CONVERGED = 60, 10, 1e-4
"""Largest number of Newton steps and of the halvings of one, and the squared distance from the
maximum, in units of the standard error, at which they end."""
ROUNDING = 1e-13
"""Change of the mean log-likelihood of a sample that is round-off."""
SPREAD = 10.0
"""Size of a coefficient of which no sample says anything: ln p changes by less within a box."""
DOUBT, ALARM = 0.01, 1e-6
"""Probabilities with which a right fit is halved needlessly, and with which it is called wrong."""
STEEPEST = 2.0
"""Change of ln p from bin to bin above which the contents of bins do not show the density."""


@dataclass(frozen=True, eq=False)
class Box:
    """Fit of ln p on the bins ``first`` <= bin < ``last`` of each axis.

    ``theta`` (coefficients,), empty without samples: p is 0. ``deviations`` (batches, coefficients)
    are by what the θ of single batches differ from that of all; ``covariance`` is that of θ for
    independent samples. ``chance`` is the probability of a misfit as large as there is, 0 where the
    density changes too much from bin to bin.
    """

    first: Bins
    last: Bins
    theta: Array
    deviations: Array
    covariance: Array
    chance: float = 1.0

    @property
    def bins(self) -> tuple[slice, ...]:
        """The slice of the bins along each axis."""
        return tuple(map(slice, self.first, self.last))

    def basis(self, numbers: Sequence[Array]) -> Array:
        """Return the polynomials (points, coefficients) at bin ``numbers`` (points,), by axis."""
        degrees = powers(len(self.first), self.theta.size)
        ends = zip(numbers, self.first, self.last, degrees, strict=True)
        factors = [scaled_vander(u, a, b, max(k, default=0))[:, k] for u, a, b, k in ends]
        return reduce(np.multiply, factors)


def scaled_vander(numbers: Array, first: int, last: int, degree: int) -> Array:
    """Return P_0 to P_degree (..., degree + 1) of bin ``numbers`` scaled to [−1, 1]."""
    return np.asarray(legvander(2.0 * (numbers - first) / (last - first) - 1.0, int(degree)))


def powers(axes: int, count: int) -> Integers:
    """Return the degrees (axes, count) along each axis, in ascending order of the total degree."""
    if axes == 1:
        return np.arange(count)[None]
    pairs = [(total - k, k) for total in range(count) for k in range(total + 1)]
    return np.array(pairs[:count], dtype=np.int64).reshape(-1, 2).T


def coefficients(axes: int, degree: int) -> int:
    """Return the number of polynomials up to a total ``degree``."""
    return degree + 1 if axes == 1 else (degree + 1) * (degree + 2) // 2


@dataclass(frozen=True, eq=False)
class Counts:
    """Shares of the samples in the bins of ``axes``, of all and of each of independent batches.

    ``shares`` (bins of each axis), ``batch_shares`` (batches, bins of each axis); ``samples`` is
    the number of independent samples. ::

        Counts([BinAxis(edges)], shares, batch_shares, 1e6).boxes()
    """

    axes: Sequence[BinAxis]
    shares: Array
    batch_shares: Array
    samples: float

    def boxes(self, *, halve: bool = True) -> Iterator[Box]:
        """Yield the fits that cover all bins, none of them across a kink.

        ``halve`` False: one between each two kinks, whether it fits or not.
        """
        for piece in product(*(list(pairwise(axis.cuts)) for axis in self.axes)):
            first, last = zip(*piece, strict=True)
            if halve:
                yield from self._fitted(first, last, halved=False)
            else:
                yield self._fit(first, last)

    def _fitted(self, first: Bins, last: Bins, *, halved: bool) -> Iterator[Box]:
        """Yield the fit of a box or of its halves; ``halved``: it is half of a box that fits."""
        box = self._fit(first, last)
        fits, halves = box.chance > DOUBT, self._halves(box)
        if not halves or (halved and fits):
            yield box
            return
        for half in halves:
            yield from self._fitted(*half, halved=halved or fits)

    def _halves(self, box: Box) -> list[tuple[Bins, Bins]]:
        """Both parts of a box cut across the axis that fits worst; none if one has too little.

        The cut is in the middle, or as near to it as leaves both parts bins and samples enough.
        """
        axes = range(len(box.first))
        needed = PER_COEFFICIENT * coefficients(len(axes), DEGREE) / self.samples
        shares = self.shares[box.bins]
        for axis in sorted(axes, key=lambda k: chance_of_highest(box, alone=k)):
            below = np.cumsum(shares.sum(axis=tuple(k for k in axes if k != axis)))[:-1]
            enough = np.flatnonzero((below >= needed) & (below <= below[-1] - needed)) + 1
            enough = enough[(enough >= LEAST_BINS) & (enough <= below.size + 1 - LEAST_BINS)]
            if enough.size:
                middle = 0.5 * (below.size + 1)
                cut = box.first[axis] + int(enough[np.argmin(np.abs(enough - middle))])
                low = tuple(cut if k == axis else x for k, x in enumerate(box.last))
                high = tuple(cut if k == axis else x for k, x in enumerate(box.first))
                return [(box.first, low), (high, box.last)]
        return []

    def _fit(self, first: Bins, last: Bins) -> Box:
        """Return the fit of one box, of the largest degree that has a largest likelihood."""
        own = tuple(map(slice, first, last))
        shares, batches = self.shares[own], self.batch_shares[(slice(None), *own)]
        many, none = len(batches), np.zeros((0, 0))
        if not shares.any():
            return Box(first, last, np.zeros(0), np.zeros((many, 0)), none)
        rules = [[x[s] for x in axis.rule] for axis, s in zip(self.axes, own, strict=True)]
        for degree in reversed(range(self._degree(shares) + 1)):
            model = Model(first, last, degree, rules)
            theta, information, solved = model.solved(shares.ravel(), self.samples)
            if solved:
                break
        content, covariance = model.contents(theta), np.asarray(np.linalg.inv(information))
        weighted = model.design * content[:, None]
        apart = batches.reshape(many, -1) - content
        deviations = apart @ model.design @ covariance
        box = Box(first, last, theta, deviations, covariance / self.samples)
        held = shares * self.samples
        steep = too_steep((model.design @ theta).reshape(shares.shape))
        if np.any(steep & (held > PER_COEFFICIENT)):
            return replace(box, chance=0.0)
        residuals = (apart - deviations @ weighted.T).reshape(batches.shape)
        highest = chance_of_highest(box)
        if float(held.sum()) < PER_BATCH * many * theta.size:  # too few for deviations to be normal
            highest = max(highest, ALARM)
        return replace(box, chance=min(highest, chance_of_misfit(residuals, held)))

    def _degree(self, shares: Array) -> int:
        """Largest total degree for which a box has samples and bins enough."""
        filled = float(np.count_nonzero(shares))
        most = min(float(shares.sum()) * self.samples / PER_COEFFICIENT, filled)
        degrees = range(1, min(DEGREE, min(shares.shape) - 1) + 1)
        return sum(coefficients(shares.ndim, degree) <= most for degree in degrees)


class Model:
    """Contents of the bins of a box as functions of θ, by Gauss points.

    ``rules`` are bin numbers and weights (bins, ``NODES``) of each axis. ``design`` (bins of all
    axes, coefficients) has the means of the polynomials over each bin, the statistics that a fit
    matches.
    """

    def __init__(self, first: Bins, last: Bins, degree: int, rules: Sequence[Sequence[Array]]):
        """Evaluate the polynomials."""
        self.shape = tuple(len(u) for u, _ in rules)
        self.powers = powers(len(rules), coefficients(len(rules), degree))
        ends = zip(rules, first, last, strict=True)
        self.vander = [scaled_vander(u, a, b, degree) for (u, _), a, b in ends]
        self.weights = reduce(np.multiply.outer, [w.ravel() for _, w in rules])
        means = [
            np.einsum("bg,bgk->bk", w / w.sum(axis=1, keepdims=True), v)[:, k]
            for (_, w), v, k in zip(rules, self.vander, self.powers, strict=True)
        ]
        products = means[0] if len(means) == 1 else means[0][:, None] * means[1]
        self.design = products.reshape(-1, self.powers.shape[1])

    def contents(self, theta: Array) -> Array:
        """Return the integral of p over each bin, (bins of all axes,)."""
        split = self.spread(theta)
        return np.asarray(split.sum(axis=tuple(range(1, split.ndim, 2)))).ravel()

    def spread(self, theta: Array) -> Array:
        """Return p times the weight of each Gauss point, (bins, ``NODES``) for each axis."""
        size = self.vander[0].shape[-1]
        square = np.zeros((size,) * len(self.shape))
        square[tuple(self.powers)] = theta
        log_p = self.vander[0].reshape(-1, size) @ square
        if len(self.shape) == 2:
            log_p = log_p @ self.vander[1].reshape(-1, size).T
        p = self.weights * np.exp(np.clip(log_p, -LARGEST_LOG, LARGEST_LOG))
        return p.reshape([k for bins in self.shape for k in (bins, NODES)])

    def solved(self, shares: Array, samples: float) -> tuple[Array, Array, bool]:
        """Return θ of the largest likelihood, the information, and whether the maximum was reached.

        By Newton's method with halved steps, from a fit to ln of the counts and half a sample more
        in each bin, or from a constant where that is likelier.
        Where samples say nothing coefficients are about 0 ± ``SPREAD``.
        """
        constant = np.zeros(self.design.shape[1])
        held, volume = samples * shares + 0.5, self.contents(constant)
        weighted, log_p = self.design.T * held, np.log(held / (samples * volume))
        fitted = np.linalg.lstsq(weighted @ self.design, weighted @ log_p)[0]
        constant[0] = np.log(shares.sum() / volume.sum())
        prior = np.where(self.powers.any(axis=0), 1.0 / (samples * SPREAD**2), 0.0)

        def unlikely(theta: Array, content: Array) -> float:
            own = shares[shares > 0.0] @ np.log(content[shares > 0.0])
            return float(content.sum() - own + 0.5 * prior @ theta**2)

        theta: Array = min(fitted, constant, key=lambda x: unlikely(x, self.contents(x)))
        content = self.contents(theta)
        value = unlikely(theta, content)
        for _ in range(STEPS):
            score = (shares - content) @ self.design - prior * theta
            information = (self.design * content[:, None]).T @ self.design + np.diag(prior)
            step = np.linalg.solve(information, score)
            if float(score @ step) < max(CONVERGED / samples, ROUNDING):
                return theta + step, information, True
            for _ in range(HALVINGS):
                content = self.contents(theta + step)
                if (less := unlikely(theta + step, content)) < value + ROUNDING:
                    break
                step = 0.5 * step
            else:
                break
            theta, value = theta + step, less
        return theta, information, False


def chance_of_highest(box: Box, alone: int | None = None) -> float:
    """Return the probability of highest coefficients as large as they are, were the true ones 0.

    By Hotelling's T². ``alone``: of the polynomials of this axis alone.
    """
    degrees = powers(len(box.first), box.theta.size)
    total = degrees.sum(axis=0)
    highest = total > max(0, int(total.max(initial=0)) - HIGHEST[len(box.first)])
    if alone is not None:
        highest &= degrees[alone] == total
    size, batches = int(np.count_nonzero(highest)), len(box.deviations)
    theta, freedom = box.theta[highest], batches - size
    if not size:
        return 1.0
    known = freedom > 2 * size  # enough batches to know a covariance from them
    spread = np.cov(box.deviations[:, highest].T).reshape(size, size) / batches
    covariance = spread if known else box.covariance[np.ix_(highest, highest)]
    square = float(theta @ np.linalg.pinv(covariance, hermitian=True) @ theta)
    if known:
        return float(fdtrc(size, freedom, square * freedom / (size * (batches - 1.0))))
    return float(chdtrc(size, square))


def chance_of_misfit(residuals: Array, held: Array) -> float:
    """Return the probability of the largest residual of all blocks of 1, 2, 4, … bins an axis.

    ``residuals`` (batches, bins of each axis) are shares less those of the fit to the batch, and
    ``held`` the samples in the bins.
    """
    least, count, batches, size = 1.0, 0, len(residuals), 1
    while 4 * size <= max(held.shape):
        blocks, own = residuals, held
        for axis, bins in enumerate(held.shape):
            starts = np.arange(0, bins, size)
            blocks = np.add.reduceat(blocks, starts, axis=axis + 1)
            own = np.add.reduceat(own, starts, axis=axis)
        blocks = blocks[:, own > PER_BATCH * batches]
        error, mean = blocks.std(axis=0, ddof=1) / np.sqrt(batches), np.abs(blocks.mean(axis=0))
        z = np.divide(mean, error, out=np.zeros_like(mean), where=error > 0.0)
        least = min(least, 2.0 * float(stdtr(batches - 1, -z.max(initial=0.0))))
        count, size = count + z.size, 2 * size
    return min(1.0, count * least) if count else 1.0


def too_steep(log_p: Array) -> Flags:
    """Return which bins have a neighbour whose mean of ln p is more than ``STEEPEST`` away."""
    steep = np.zeros(log_p.shape, dtype=bool)
    for axis in range(log_p.ndim):
        change = np.moveaxis(np.abs(np.diff(log_p, axis=axis)), axis, 0) > STEEPEST
        along = np.moveaxis(steep, axis, 0)
        along[1:] |= change
        along[:-1] |= change
    return steep
