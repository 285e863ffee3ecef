"""The weight w = exp(−Φ) of p = w u, Φ a polynomial of both energies close to −ln p.

p does not depend on the weight; the closer w is to p, the fewer unknowns u has, and the farther out
p stays positive. The first weight is fitted to slopes of ln p for zero flux, others to solutions.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.polynomial.polynomial import polyder, polygrid2d, polyval2d
from scipy.integrate import cumulative_trapezoid
from scipy.linalg import solve_triangular

from fpk.numeric.arrays import EPS, ROUND_OFF, Array, Flags, Integers
from fpk.numeric.errors import NotCertified
from fpk.system.process import Process

PROBE = np.logspace(-2.0, 3.0, 26)
"""Energies along each axis of the first fit, over ``Process.energy_scales``; at 0 b is singular."""
NEGLIGIBLE_FALL = -float(np.log(EPS))
"""Fall of ln p from its maximum, 36, at which p is round-off of its maximum."""
EDGE_WEIGHT = 1e-3
"""At the far edges of the first mesh w is EDGE_WEIGHT · tol times its value at the start."""
RISE = 3.0
"""Rise of −ln w from the ends of a mesh to the ends of the next: the difference of both solutions
contains the error by ending the mesh."""
MAX_WEIGHT_DEGREE = 6
"""Highest total degree of Φ; under detailed balance it is one above the degree of the damping."""
GAIN = 0.5
"""Largest misfit at which a fit is accepted, over the misfit of the fit of lower degree accepted
before: a higher degree extrapolates worse."""
IMPORTANCE = 10.0
"""Rise of Φ over which the weight of a point in a least-squares fit falls by e: far larger than
for p itself, 1."""
RISE_PER_DEGREE = 2.8
"""Rise of −ln p that the data must cover for each degree of Φ, which is extrapolated far beyond."""
RAYS = np.concatenate([np.linspace(0.0, 1.0, 49), np.geomspace(1.04, 30.0, 48)])
"""Coordinates, in units of the fitted box, at which Φ is tested: it must rise along every ray."""
FLOOR = float(np.exp(-44.0))
"""Default constant added to w so that no element matrix is singular: p ≥ −1e-14 of its maximum as
long as u ≥ −1e5."""


@dataclass(frozen=True, eq=False)
class Weight:
    """w = exp(−Φ) + ``floor`` with Φ = Σ ``coefficients``[i, j] (H1/a)^i (H2/b)^j.

    a, b = ``scales`` are the ends of the fitted box, on which the smallest Φ is 0. ``H1``, ``H2``
    broadcast everywhere.
    """

    coefficients: Array
    scales: tuple[float, ...]
    floor: float = FLOOR

    @property
    def plain(self) -> bool:
        """Whether w = 1."""
        return self.coefficients.size == 1

    def exponent(self, H1: Array, H2: Array) -> Array:
        """Return Φ at energies ``H1``, ``H2``."""
        x, y = np.asarray(H1) / self.scales[0], np.asarray(H2) / self.scales[1]
        if x.ndim == 2 and x.shape[1] == 1 and y.shape[-1:] == (y.size,):
            return np.asarray(polygrid2d(x.ravel(), y.ravel(), self.coefficients))
        x, y = np.broadcast_arrays(x, y)
        return np.asarray(polyval2d(x, y, self.coefficients))

    def __call__(self, H1: Array, H2: Array) -> Array:
        """Return w at energies ``H1``, ``H2``."""
        return np.asarray(np.exp(-self.exponent(H1, H2)) + self.floor)

    def slopes(self, H1: Array, H2: Array) -> list[Array]:
        """Return ∂Φ/∂H1 and ∂Φ/∂H2 at ``H1``, ``H2``: the slopes of −ln w without the floor."""
        each = (polyder(self.coefficients, axis=k).astype(float) for k in (0, 1))
        of_slope = zip(each, self.scales, strict=True)
        return [replace(self, coefficients=phi).exponent(H1, H2) / s for phi, s in of_slope]

    def terms(self, H1: Array, H2: Array) -> Array:
        """Return the sum of the sizes of the terms of Φ at ``H1``, ``H2``: the round-off scale."""
        sizes = replace(self, coefficients=np.abs(self.coefficients))
        return sizes.exponent(np.abs(H1), np.abs(H2))

    def ends(self, rise: float) -> tuple[float, float]:
        """Return the ends (H1, H2) of a box outside which Φ >= ``rise`` > 0 on a grid of ``RAYS``.
        Raises ``NotCertified`` if Φ is smaller at a far edge of this grid."""
        inside = polygrid2d(RAYS, RAYS, self.coefficients) < rise
        if inside[-1].any() or inside[:, -1].any():
            raise NotCertified(f"the weight falls by less than exp(−{rise:.0f})")
        first, second = (float(RAYS[last_index(inside, axis) + 1]) for axis in (0, 1))
        return first * self.scales[0], second * self.scales[1]


UNIT_WEIGHT = Weight(np.zeros((1, 1)), (1.0, 1.0))
"""The weight w = 1; the floor is below its round-off."""


def negligible_rise(tol: float, height: float = 0.0, level: int = 0) -> float:
    """Return −ln w at the ends of a mesh, beyond which p is negligible for the L1 ``tol``.

    It is ``height`` − ln(``EDGE_WEIGHT`` · ``tol``) + ``level`` · ``RISE``: ``height`` is −ln w at
    a start or limit inside the mesh, ``level`` the number of refinements. −ln w is measured from
    its minimum, 0.
    """
    return height - float(np.log(EDGE_WEIGHT * tol)) + level * RISE


def flux_free_weight(process: Process) -> Weight:
    """Return w fitted to the slopes of p for zero flux everywhere, ∇ ln p = b⁻¹ (2s − ∇·b).

    s, b are drift and diffusion of ``process``. If p or the fit does not fall off, Φ is
    Σ H_i/``energy_scales``[i]. Raises ``NotCertified`` if b is singular off the axes.
    """
    scales = np.array(process.energy_scales)
    points = np.stack(np.broadcast_arrays(PROBE[:, None], PROBE), axis=-1).reshape(-1, 2)
    c = process.coefficients(points * scales)
    slopes = inverse_diffusion(2.0 * c.drift - c.divergence, c.diffusion)
    first, second = (slopes * scales).T.reshape(2, PROBE.size, PROBE.size)
    # Mean of the integrals along two paths: first along H1, then H2, and in the other order.
    a = cumulative_trapezoid(first, PROBE, axis=0, initial=0)
    b = cumulative_trapezoid(second, PROBE, axis=1, initial=0)
    log_p = 0.5 * (a[:, :1] + b + b[:1] + a)
    # p H1 H2, the density of the logarithms of the energies.
    log_mass = log_p + np.log(np.multiply.outer(PROBE, PROBE))
    weight = None
    if max(log_mass[-1].max(), log_mass[:, -1].max()) < log_mass.max() - NEGLIGIBLE_FALL:
        rise = log_p.max() - log_p
        near, least = rise < NEGLIGIBLE_FALL, MAX_WEIGHT_DEGREE + 2
        m, n = (max(last_index(near, axis) + 2, least) for axis in (0, 1))
        ends = PROBE[[min(m, PROBE.size) - 1, min(n, PROBE.size) - 1]]
        x, y = PROBE[:m] / ends[0], PROBE[:n] / ends[1]
        powers, root = _power_pairs(MAX_WEIGHT_DEGREE)[1:], np.exp(-0.5 * rise[:m, :n] / IMPORTANCE)
        i, j = powers.T
        columns = [
            root[..., None] * _power_columns(x, i, slope=True)[:, None] * _power_columns(y, j),
            root[..., None] * _power_columns(x, i)[:, None] * _power_columns(y, j, slope=True),
        ]
        right = -root * first[:m, :n] * ends[0], -root * second[:m, :n] * ends[1]
        candidates = fits_by_degree(np.reshape(columns, (-1, len(powers))), np.ravel(right), powers)
        weight = _chosen(candidates, tuple((ends * scales).tolist()))
    # In units of 40 energy scales Φ rises by more than NEGLIGIBLE_FALL within RAYS.
    return weight or Weight(np.array([[0.0, 40.0], [40.0, 0.0]]), tuple((40.0 * scales).tolist()))


def inverse_diffusion(flow: Array, diffusion: Array) -> Array:
    """Return b⁻¹ ``flow`` (points, 2), b = ``diffusion`` (points, 2, 2). Raises ``NotCertified`` if
    b is singular at any point."""
    (a, b), (_, c) = np.moveaxis(diffusion, 0, -1)
    determinant = a * c - b**2
    if not np.all(determinant > 0.0):
        raise NotCertified("some combination of the two energies gets no noise")
    first, second = flow.T
    slopes = np.stack([c * first - b * second, a * second - b * first], axis=1)
    return np.asarray(slopes / determinant[:, None])


def fit_weight(
    grid: tuple[Array, Array],
    log_p: Array,
    known: Flags,
    rise: float,
    *,
    present: Weight | None = None,
) -> Weight | None:
    """Return w fitted to ``log_p`` (m, n), ln p at the ``known`` points of a ``grid``, or None.

    The ``grid`` has axes (m,) and (n,); ``rise`` is the fall of ln p over the known points. None:
    no fit has less than ``GAIN`` times the misfit of the ``present`` weight, or none rises outside.
    """
    scales, (i, j) = (float(grid[0][-1]), float(grid[1][-1])), np.nonzero(known)
    x, y = grid[0][i], grid[1][j]
    target = log_p[known].max() - log_p[known]
    root, powers = np.exp(-0.5 * target / IMPORTANCE), _power_pairs(int(rise / RISE_PER_DEGREE))
    i, j = powers.T
    columns = _power_columns(x / scales[0], i) * _power_columns(y / scales[1], j)
    columns, least = root[:, None] * columns, np.inf
    if present is not None:
        misfit = target - present.exponent(x, y)
        misfit -= np.average(misfit, weights=root**2)
        least = float(np.linalg.norm(root * misfit) / np.linalg.norm(root * target))
    return _chosen(fits_by_degree(columns, root * target, powers), scales, rise, least)


def last_index(inside: Flags, axis: int) -> int:
    """Return the largest index along ``axis`` at which any entry of ``inside``, a matrix, is true.
    Raises ``IndexError`` if no entry is."""
    return int(np.flatnonzero(inside.any(axis=1 - axis))[-1])


@lru_cache
def _power_pairs(degree: int) -> Integers:
    """Pairs of powers (coefficients, 2), by rising total, up to the total ``degree`` and at most
    ``MAX_WEIGHT_DEGREE``."""
    totals = range(min(degree, MAX_WEIGHT_DEGREE) + 1)
    return np.array([(i, total - i) for total in totals for i in range(total + 1)])


def _power_columns(x: Array, powers: Integers, *, slope: bool = False) -> Array:
    """``x``^k, or the slope k x^(k−1), for the ``powers`` k: (points, powers)."""
    values = np.vander(x, int(powers.max(initial=0)) + 1, increasing=True)
    return values[:, powers] if not slope else powers * values[:, np.maximum(powers - 1, 0)]


def fits_by_degree(columns: Array, right: Array, powers: Integers) -> Iterator[tuple[Array, float]]:
    """Yield least-squares fits of ``right`` (rows,) of total degree 1, 2, …, and |misfit|/|right|.

    ``columns`` (rows, coefficients) are the values of the monomials with the ``powers``
    (coefficients, 2), by degree. A fit is (degree + 1, degree + 1), [i, j] for x^i y^j. The fits
    end at linearly dependent columns.
    """
    R = np.asarray(np.linalg.qr(np.column_stack([columns, right]), mode="r"))
    total = powers.sum(axis=1)
    dependent = np.abs(np.diag(R)) <= ROUND_OFF * np.linalg.norm(R, axis=0)[: len(R)]
    for degree in range(1, int(total[-1]) + 1):
        n = int(np.count_nonzero(total <= degree))
        if n >= len(R) or dependent[:n].any():
            return
        phi = np.zeros((degree + 1, degree + 1))
        phi[powers[:n, 0], powers[:n, 1]] = solve_triangular(R[:n, :n], R[:n, -1])
        yield phi, float(np.linalg.norm(R[n:, -1]) / np.linalg.norm(R[:, -1]))


def _chosen(
    fits: Iterator[tuple[Array, float]],
    scales: tuple[float, ...],
    rise: float = np.inf,
    least: float = np.inf,
) -> Weight | None:
    """The weight of ``scales`` with the accepted Φ of highest degree, its minimum made 0, or None.

    One of the ``fits`` (Φ, misfit) must rise along every ray beyond the box and where Φ > ``rise``,
    and have less than ``GAIN`` times the misfit of the fit accepted before, at first ``least``.
    """
    best, outside = None, np.maximum(RAYS[:, None], RAYS) > 1.0
    for phi, misfit in fits:
        if misfit < GAIN * least:
            raised, values = phi.copy(), polygrid2d(RAYS, RAYS, phi)
            lowest = values[~outside].min()
            raised[0, 0], values = phi[0, 0] - lowest, values - lowest
            # (i + j) Φ_ij are the coefficients of x ∂Φ/∂x + y ∂Φ/∂y, the slope along a ray.
            powers = np.arange(len(phi))
            along = polygrid2d(RAYS, RAYS, (powers[:, None] + powers) * phi)
            far = outside | (values > rise)
            if np.all(along[far] > 0.0) and np.all(values[far] > 0.0):
                best, least = Weight(raised, scales), misfit
        if misfit <= ROUND_OFF:
            break
    return best
