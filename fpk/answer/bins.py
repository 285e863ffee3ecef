"""Density estimation from bin counts: exp(polynomial) on boxes of bins.

On a box the density of one or two coordinates is ``p = r exp(Σ_j θ_j P_j)``, P_j products of
Legendre polynomials of the bin number and r a known reference. θ maximises the likelihood of the
*contents* of the bins, integrals of p, so that the width of the bins does not bias p. Boxes end at
the known kinks of p. A box whose highest coefficients are not consistent with 0 is halved, and each
box that fits is halved once more, so that a misfit that the test does not see is small beside the
sampling error. Errors follow from independent batches. Kooperberg and Stone, Comput. Stat. Data
Anal. 12, 1991, 327 (logspline density estimation).
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, reduce
from itertools import pairwise, product
from math import comb

import numpy as np
import scipy  # its parts are loaded at their first use
from numpy.polynomial.legendre import legvander
from scipy.special import chdtrc, fdtrc, stdtr

from fpk.numeric.arrays import LARGEST_LOG, ROUND_OFF, Array, Integers
from fpk.numeric.quadrature import panel_rule

LogReference = Callable[[Array, Integers], Array]
"""Function ln r + constant, such as −U/kT, of values x and their bin numbers, in their shape."""
Bins = tuple[int, ...]
"""One bin number, from 0, for each axis."""

BIN_POINTS = 3
"""Gauss points along a bin: relative error 1e-4 of its content if ln p changes by 2 within it."""

MAX_FIT_DEGREE = 8
"""Largest total degree of the polynomial on a box."""
TESTED_DEGREES = {1: 3, 2: 2}
"""Number of highest total degrees whose coefficients must be consistent with 0, by the number of
coordinates."""
PER_COEFFICIENT = 30
"""Least number of independent samples per coefficient: the rms relative error of p is then 18 %."""
PER_BATCH = 10
"""Independent samples in a batch (of a fit: per coefficient) above which the mean of all batches
counts as normal."""
STEPS, HALVINGS, CONVERGED = 60, 10, 1e-4
"""Largest numbers of Newton steps and of halvings of each step; (distance of θ from the maximum of
the likelihood / sampling error of θ)² at which the iteration ends."""

PRIOR_WIDTH = 10.0
"""Standard deviation of the Gaussian prior of each coefficient but the constant: larger than
changes of ln p/r in a box, and effective only in parts of a box that have no samples."""
DOUBT, ALARM = 0.01, 1e-6
"""False-alarm rates of the tests of a fit: to halve its box, and to report it as wrong."""
STEEPEST = 2.0
"""|Change of ln p| from bin to bin above which bin contents no longer determine the density."""


def no_reference(x: Array, bins: Integers) -> Array:
    """Return ln r = 0 in the shape of ``x``, for the reference r = 1; ``bins`` has no effect."""
    return np.zeros_like(x)


@dataclass(frozen=True, eq=False)
class BinAxis:
    """Bins of one coordinate between ascending ``edges`` (bins + 1,), with the reference density r.

    ``kinks`` are the edges at which p is not smooth. Between kinks bins are equally wide, but above
    a kink in ``widening`` the k-th edge is k⁴ times as far as the first. ``log_reference``: ln r.
    """

    edges: Array
    kinks: Sequence[float] = ()
    widening: Sequence[float] = ()
    log_reference: LogReference = no_reference

    @cached_property
    def cuts(self) -> list[int]:
        """Ascending indices of the edges at both ends and at the kinks."""
        return sorted({0, self.edges.size - 1, *np.searchsorted(self.edges, self.kinks).tolist()})

    def number(self, x: Array, bins: Integers) -> Array:
        """Return fractional bin numbers at ``x`` in ``bins``: k at edge k, smooth between kinks."""
        value = np.empty(x.shape)
        for a, b, interpolant in self._numbers:
            own = (bins >= a) & (bins < b)
            value[own] = interpolant(x[own])
        return value

    @cached_property
    def _numbers(self) -> list[tuple[int, int, Callable[[Array], Array]]]:
        number, interpolant = np.arange(self.edges.size) + 0.0, scipy.interpolate.PchipInterpolator
        ends = [(a, b, slice(a, b + 1)) for a, b in pairwise(self.cuts)]
        return [(a, b, interpolant(self.edges[s], number[s])) for a, b, s in ends]

    @cached_property
    def rule(self) -> tuple[Array, Array]:
        """Fractional bin numbers at Gauss points, and weights times r, (bins, points) each."""
        x, w = panel_rule(self.edges, BIN_POINTS)
        bins = np.broadcast_to(np.arange(len(x))[:, None], x.shape)
        return self.number(x, bins), w * np.exp(self.log_r(x, bins))

    def log_r(self, x: Array, bins: Integers) -> Array:
        """Return max(ln r, −``LARGEST_LOG``/2) at ``x`` in ``bins``, so that r is never 0."""
        return np.maximum(self.log_reference(x, bins), -0.5 * LARGEST_LOG)


@dataclass(frozen=True, eq=False)
class Box:
    """Fit ln p = ln r + Σ_j θ_j P_j on the bins ``first`` <= bin < ``last`` of each axis.

    ``theta`` (coefficients,) is θ, empty if the box has no samples: p is 0 there. ``deviations``
    (batches, coefficients) are the θ of single batches less ``theta``; ``covariance``
    (coefficients, coefficients) is the covariance of θ if samples are independent. ``chance`` is
    the p-value of the observed misfit: 1 without samples, 0 if ln p changes by more than
    ``STEEPEST`` from a bin of more than ``PER_COEFFICIENT`` samples to its neighbour.
    """

    first: Bins
    last: Bins
    theta: Array
    deviations: Array
    covariance: Array
    chance: float = 1.0

    @property
    def degrees(self) -> Integers:
        """Degree (axes, coefficients) of every polynomial P_j along each axis."""
        return polynomial_degrees(len(self.first), self.theta.size)

    def basis(self, numbers: Sequence[Array]) -> Array:
        """Return P_j (points, coefficients) at fractional bin ``numbers`` (points,) by axis."""
        ends = zip(numbers, self.first, self.last, self.degrees, strict=True)
        factors = [_polynomials(u, a, b, max(k, default=0))[:, k] for u, a, b, k in ends]
        return reduce(np.multiply, factors)


def _polynomials(numbers: Array, first: int, last: int, degree: int) -> Array:
    """Return Legendre polynomials (..., ``degree`` + 1) on [``first``, ``last``] at ``numbers``."""
    return np.asarray(legvander(2.0 * (numbers - first) / (last - first) - 1.0, int(degree)))


def polynomial_degrees(axes: int, count: int) -> Integers:
    """Return the degrees (axes, count) of the first ``count`` polynomials of 1 or 2 ``axes``.

    The total degree ascends: 0, 1, 2, … for one axis, (0, 0), (1, 0), (0, 1), (2, 0), … for two.
    """
    if axes == 1:
        return np.arange(count)[None]
    pairs = [(total - k, k) for total in range(count) for k in range(total + 1)]
    return np.array(pairs[:count], dtype=np.int64).reshape(-1, 2).T


def boxes(
    axes: Sequence[BinAxis], shares: Array, batch_shares: Array, samples: float, *, halve: bool
) -> Iterator[Box]:
    """Yield fits of p whose boxes cover all bins of ``axes``; kinks are at borders of boxes only.

    ``shares`` (*bins) are the fractions of all samples in each bin, ``batch_shares`` (batches,
    *bins) the fractions of the samples of each batch; ``samples`` is the number of independent
    samples in all bins. Without ``halve`` there is one box between neighbouring kinks.
    """

    def parts(first: Bins, last: Bins, *, halved: bool) -> Iterator[Box]:
        own = tuple(map(slice, first, last))
        box = _fit_box(axes, first, last, shares[own], batch_shares[(slice(None), *own)], samples)
        fits = box.chance > DOUBT  # ``halved``: this is half of a box that fits
        halves = _halves(box, shares[own], samples) if halve else []
        if not halves or (halved and fits):
            yield box
            return
        for half in halves:
            yield from parts(*half, halved=halved or fits)

    for piece in product(*(list(pairwise(axis.cuts)) for axis in axes)):
        first, last = zip(*piece, strict=True)
        yield from parts(first, last, halved=False)


def _halves(box: Box, shares: Array, samples: float) -> list[tuple[Bins, Bins]]:
    """Return the ends (first, last) of the two halves of ``box``; no halves if it is too small.

    The cut is as near to the middle as leaves each half enough samples and bins for all
    coefficients, across the axis with the worst fit among the axes that can be cut. ``shares``
    (*bins of the box) are fractions of all samples, ``samples`` is the number of independent
    samples in all bins.
    """
    axes, bins = range(shares.ndim), MAX_FIT_DEGREE + 4  # more than coefficients: a misfit shows
    needed = PER_COEFFICIENT * comb(MAX_FIT_DEGREE + shares.ndim, shares.ndim) / samples
    for axis in sorted(axes, key=lambda k: _chance_of_highest(box, alone=k)):
        below = np.cumsum(shares.sum(axis=tuple(k for k in axes if k != axis)))[:-1]
        enough = np.flatnonzero((below >= needed) & (below <= below[-1] - needed)) + 1
        enough = enough[(enough >= bins) & (enough <= below.size + 1 - bins)]
        if enough.size:
            middle = 0.5 * (below.size + 1)
            cut = box.first[axis] + int(enough[np.argmin(np.abs(enough - middle))])
            low = tuple(cut if k == axis else x for k, x in enumerate(box.last))
            high = tuple(cut if k == axis else x for k, x in enumerate(box.first))
            return [(box.first, low), (high, box.last)]
    return []


def _fit_box(
    axes: Sequence[BinAxis], first: Bins, last: Bins, shares: Array, batches: Array, samples: float
) -> Box:
    """Return the fit of the box of bins ``first`` <= bin < ``last`` of ``axes``.

    Its degree is the highest for which there are enough samples and the likelihood has a maximum.
    ``shares`` (*bins of the box) are the fractions of all samples in its bins, ``batches``
    (batches, *bins of the box) the fractions of the samples of each batch; ``samples`` is the
    number of independent samples in all bins.
    """
    many = len(batches)
    if not shares.any():
        return Box(first, last, np.zeros(0), np.zeros((many, 0)), np.zeros((0, 0)))
    held = shares * samples
    most = min(float(shares.sum()) * samples / PER_COEFFICIENT, float(np.count_nonzero(shares)))
    degrees = range(min(MAX_FIT_DEGREE, min(shares.shape) - 1) + 1)
    for degree in reversed([k for k in degrees if k == 0 or comb(k + len(axes), k) <= most]):
        model = Model(axes, first, last, degree)
        theta, information, solved = model.solved(shares.ravel(), samples)
        if solved:
            break
    content, covariance = model.contents(theta), np.asarray(np.linalg.inv(information))
    weighted = model.design * content[:, None]
    apart = batches.reshape(many, -1) - content
    deviations = apart @ model.design @ covariance
    box = Box(first, last, theta, deviations, covariance / samples)
    log_p = (model.design @ theta).reshape(shares.shape)
    steep = np.zeros(log_p.shape, dtype=bool)
    for axis in range(log_p.ndim):
        change = np.moveaxis(np.abs(np.diff(log_p, axis=axis)), axis, 0) > STEEPEST
        along = np.moveaxis(steep, axis, 0)
        along[1:] |= change
        along[:-1] |= change
    if np.any(steep & (held > PER_COEFFICIENT)):
        return replace(box, chance=0.0)
    residuals = (apart - deviations @ weighted.T).reshape(batches.shape)
    highest = _chance_of_highest(box)
    if float(held.sum()) < PER_BATCH * many * theta.size:  # too few for deviations to be normal
        highest = max(highest, ALARM)
    return replace(box, chance=min(highest, _chance_of_misfit(residuals, held)))


class Model:
    """Contents ∫p of the bins of a box as a function of the coefficients θ.

    ``design`` (bins, coefficients) are the means of the P_j over each bin, weighted by r.
    """

    def __init__(self, axes: Sequence[BinAxis], first: Bins, last: Bins, degree: int):
        """Evaluate the P_j up to total ``degree`` on the bins ``first`` <= bin < ``last``."""
        ends = list(zip(axes, first, last, strict=True))
        numbers, weights = zip(*([x[a:b] for x in axis.rule] for axis, a, b in ends), strict=True)
        self.shape = tuple(map(len, numbers))
        self.powers = polynomial_degrees(len(axes), comb(degree + len(axes), degree))
        self.vander = list(map(_polynomials, numbers, first, last, [degree] * len(axes)))
        self.weights = reduce(np.multiply.outer, [w.ravel() for w in weights])
        means = [
            np.einsum("bg,bgk->bk", w / w.sum(axis=1, keepdims=True), v)[:, k]
            for w, v, k in zip(weights, self.vander, self.powers, strict=True)
        ]
        products: Array = means[0] if len(means) == 1 else means[0][:, None] * means[1]
        self.design = products.reshape(-1, self.powers.shape[1])

    def contents(self, theta: Array) -> Array:
        """Return ∫p over each bin, flattened to (bins,), for the coefficients ``theta``."""
        split = self.spread(theta)
        return np.asarray(split.sum(axis=tuple(range(1, split.ndim, 2)))).ravel()

    def spread(self, theta: Array) -> Array:
        """Return weight · p at Gauss points for ``theta``: (bins, ``BIN_POINTS``), for two axes
        (bins, ``BIN_POINTS``, bins, ``BIN_POINTS``)."""
        size = self.vander[0].shape[-1]
        square = np.zeros((size,) * len(self.shape))
        square[tuple(self.powers)] = theta
        log_p = self.vander[0].reshape(-1, size) @ square
        if len(self.shape) == 2:
            log_p = log_p @ self.vander[1].reshape(-1, size).T
        p = self.weights * np.exp(np.clip(log_p, -LARGEST_LOG, LARGEST_LOG))
        return np.asarray(p.reshape([k for bins in self.shape for k in (bins, BIN_POINTS)]))

    def solved(self, shares: Array, samples: float) -> tuple[Array, Array, bool]:
        """Return θ of the largest likelihood, the information, and whether the maximum was reached.

        The information (coefficients, coefficients), times ``samples``, is the inverse covariance
        of θ. ``shares`` (bins,) are fractions of all samples, not all 0; ``samples`` is the number
        of independent samples in all bins. Coefficients without samples are 0 ± ``PRIOR_WIDTH``.
        """
        constant = np.zeros(self.design.shape[1])
        held, volume = samples * shares + 0.5, self.contents(constant)
        weighted, log_p = self.design.T * held, np.log(held / (samples * volume))
        fitted = np.linalg.lstsq(weighted @ self.design, weighted @ log_p)[0]
        constant[0] = np.log(shares.sum() / volume.sum())
        prior = np.where(self.powers.any(axis=0), 1.0 / (samples * PRIOR_WIDTH**2), 0.0)

        def unlikely(theta: Array, content: Array) -> float:
            own = shares[shares > 0.0] @ np.log(content[shares > 0.0])
            return float(content.sum() - own + 0.5 * prior @ theta**2)

        starts = np.asarray(fitted), constant
        theta: Array = min(starts, key=lambda x: unlikely(x, self.contents(x)))
        content = self.contents(theta)
        value = unlikely(theta, content)
        for _ in range(STEPS):
            score = (shares - content) @ self.design - prior * theta
            information = (self.design * content[:, None]).T @ self.design + np.diag(prior)
            step = np.linalg.solve(information, score)
            if float(score @ step) < max(CONVERGED / samples, ROUND_OFF):
                return theta + step, information, True
            for _ in range(HALVINGS):
                content = self.contents(theta + step)
                if (less := unlikely(theta + step, content)) < value + ROUND_OFF:
                    break
                step = 0.5 * step
            else:
                break
            theta, value = theta + step, less
        return theta, information, False


def _chance_of_highest(box: Box, alone: int | None = None) -> float:
    """Return the p-value of 0 for the coefficients of the highest degrees.

    The test is Hotelling's T², or χ² with ``box.covariance`` if batches are few. ``TESTED_DEGREES``
    has the number of total degrees; the constant is not tested. With ``alone``, an axis from 0,
    only polynomials of this axis are tested. The result is 1 if there is nothing to test.
    """
    total = box.degrees.sum(axis=0)
    highest = total > max(0, int(total.max(initial=0)) - TESTED_DEGREES[len(box.first)])
    if alone is not None:
        highest &= box.degrees[alone] == total
    size, batches = int(np.count_nonzero(highest)), len(box.deviations)
    theta, freedom = box.theta[highest], batches - size
    if not size:
        return 1.0
    known = freedom > 2 * size  # enough batches to estimate a covariance
    spread = np.cov(box.deviations[:, highest].T).reshape(size, size) / batches
    covariance = spread if known else box.covariance[np.ix_(highest, highest)]
    square = float(theta @ np.linalg.pinv(covariance, hermitian=True) @ theta)
    if known:
        return float(fdtrc(size, freedom, square * freedom / (size * (batches - 1.0))))
    return float(chdtrc(size, square))


def _chance_of_misfit(residuals: Array, counts: Array) -> float:
    """Return the p-value, by t-tests, of mean 0 for the sums of residuals in blocks of bins.

    ``residuals`` (batches, *bins) are summed in blocks of 1, 2, 4, … bins along each axis; the
    least p-value is multiplied by the number of blocks. ``counts`` (*bins) are the numbers of
    independent samples; blocks of at most ``PER_BATCH`` a batch are left out: 1 if all are.
    """
    least, count, batches, size = 1.0, 0, len(residuals), 1
    while 4 * size <= max(counts.shape):
        blocks, own = residuals, counts
        for axis, bins in enumerate(counts.shape):
            starts = np.arange(0, bins, size)
            blocks = np.add.reduceat(blocks, starts, axis=axis + 1)
            own = np.add.reduceat(own, starts, axis=axis)
        blocks = blocks[:, own > PER_BATCH * batches]
        error, mean = blocks.std(axis=0, ddof=1) / np.sqrt(batches), np.abs(blocks.mean(axis=0))
        z = np.divide(mean, error, out=np.zeros_like(mean), where=error > 0.0)
        least = min(least, 2.0 * float(stdtr(batches - 1, -z.max(initial=0.0))))
        count, size = count + z.size, 2 * size
    return min(1.0, count * least) if count else 1.0
