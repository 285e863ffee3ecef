"""The weight w = exp(−Φ) of p = w u: Φ a polynomial of both energies, close to −ln p.

Any weight gives the same p, as the equation is solved for w u; the closer w is to p, the fewer
unknowns u takes, and the farther out p stays positive.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.polynomial.polynomial import polyder, polyval2d
from scipy.linalg import solve_triangular

from fpk.arrays import SMALLEST, Array, Flags, Integers
from fpk.errors import NotCertified
from fpk.plane.probe import PROBE, Probe

Powers = Integers

BEYOND = 1e-3
"""Fraction of the tolerance that w falls to at the far edges of the first mesh."""
DEGREES = range(1, 7)
"""Total degrees of Φ. Damping of degree k in the energies gives k + 1 under detailed balance."""
EXACT = 1e-12
"""Relative misfit that is round-off: no higher degree is tried."""
GAIN = 0.5
"""Factor by which a higher degree must lower the misfit: high degrees extrapolate badly."""
IMPORTANCE = 10.0
"""Rise of Φ over which a point's share in the sum of squares falls to 1/e: w matters most where p
is large, but u = p/w should stay of order one far out, too."""
LEAST_IMPORTANCE = 1e-4
"""Share of points far out, so that no fit leaves them entirely free."""
POINTS_PER_COEFFICIENT = 3
"""Fewest points of a fit per coefficient, against interpolation of errors."""
RISE_PER_DEGREE = 4.0
"""Rise of −ln p that a fit must cover per degree beyond 2: Φ is extrapolated far beyond it."""
DEPENDENT = 1e-13
"""Norm of a column orthogonal to those before it, relative to its own, that is round-off."""
PROBED = 36.0
"""Rise of −ln p down to which a probe is fitted: e^−36 = 2e-16 of the largest density."""
UNIT = np.linspace(0.0, 1.0, 49)
REACH = 30.0
"""How far Φ must rise along every ray, in units of the fitted box."""
RAYS = np.concatenate([UNIT, np.geomspace(1.04, REACH, 48)])
"""Coordinates of the grid on which Φ is checked, in units of the fitted box."""
OUTSIDE = np.maximum(RAYS[:, None], RAYS) > 1.0
FLOOR = float(np.exp(-44.0))
"""Added to w, so that no element matrix is singular: 8e-20, and u ≥ −1e5 there keeps
p ≥ −1e-14 of its maximum."""


@dataclass(frozen=True, eq=False)
class Weight:
    """w = exp(−Φ) + ``floor`` with Φ = Σ ``coefficients``[i, j] x^i y^j, x, y = H1, H2/``scales``.

    The least Φ on the fitted box is 0.
    """

    coefficients: Array
    scales: tuple[float, float]
    floor: float = FLOOR

    def exponent(self, H1: Array, H2: Array) -> Array:
        """Φ at energies that broadcast together."""
        return _values(self.coefficients, H1 / self.scales[0], H2 / self.scales[1])

    def __call__(self, H1: Array, H2: Array) -> Array:
        """w at energies that broadcast together."""
        return np.asarray(np.exp(-self.exponent(H1, H2)) + self.floor)

    def on_grid(self, H1: Array, H2: Array) -> tuple[Array, Array, Array]:
        """w and the slopes of −ln w along H1 and H2 on the grid (H1.size, H2.size)."""
        x, y = H1 / self.scales[0], H2 / self.scales[1]
        w = np.exp(-on_grid(x, y, self.coefficients))
        # Where w underflows without a floor its slope is that of nothing.
        share = w / np.maximum(w + self.floor, SMALLEST)
        first, second = (
            on_grid(x, y, np.asarray(polyder(self.coefficients, axis=axis), float))
            * share
            / self.scales[axis]
            for axis in (0, 1)
        )
        return w + self.floor, first, second

    def terms(self, H1: Array, H2: Array) -> Array:
        """Sum of the sizes of the terms of Φ, to which its round-off is relative."""
        sizes = np.abs(self.coefficients)
        return _values(sizes, np.abs(H1) / self.scales[0], np.abs(H2) / self.scales[1])

    def ends(self, rise: float) -> tuple[float, float]:
        """Return the energies along each axis beyond which Φ > ``rise`` everywhere.

        Raises ``NotCertified`` where Φ does not rise so far within ``REACH``.
        """
        inside = on_grid(RAYS, RAYS, self.coefficients) < rise
        if inside[-1].any() or inside[:, -1].any():
            raise NotCertified(f"the weight falls by less than exp(−{rise:.0f})")
        first, second = (
            float(RAYS[int(np.flatnonzero(inside.any(axis=1 - axis))[-1]) + 1]) * scale
            for axis, scale in enumerate(self.scales)
        )
        return first, second


def flux_free_weight(probe: Probe, scales: tuple[float, ...]) -> Weight | None:
    """Return w fitted to the slopes of the probe, or None where no fit falls off.

    Where probability circulates b⁻¹ (2s − ∇·b) is no gradient, and Φ the nearest potential.
    """
    rise = probe.log_density.max() - probe.log_density
    last = [
        max(int(np.flatnonzero((rise < PROBED).any(axis=1 - axis))[-1]) + 1, len(DEGREES) + 1)
        for axis in (0, 1)
    ]
    first, second = (min(n, PROBE.size - 1) for n in last)
    # Every second point, the last one included, resolves ln p as well.
    inside = slice(2 - first % 2, first + 1, 2), slice(2 - second % 2, second + 1, 2)
    ends = float(PROBE[first]), float(PROBE[second])
    x, y = PROBE[inside[0]] / ends[0], PROBE[inside[1]] / ends[1]
    powers, root = _powers(DEGREES[-1])[1:], _importance(rise[inside])
    i, j = powers.T
    columns = [
        root[..., None] * _monomials(x, i, slope=True)[:, None] * _monomials(y, j),
        root[..., None] * _monomials(x, i)[:, None] * _monomials(y, j, slope=True),
    ]
    right = [-root * slope[inside] * end for slope, end in zip(probe.slopes, ends, strict=True)]
    candidates = fits(
        np.concatenate([part.reshape(-1, len(powers)) for part in columns]),
        np.concatenate([part.ravel() for part in right]),
        powers,
    )
    return _chosen(candidates, (ends[0] * scales[0], ends[1] * scales[1]), lambda _: OUTSIDE)


def fitted_weight(
    grid: tuple[Array, Array],
    log_p: Array,
    known: Flags,
    rise: float,
    *,
    present: Weight | None = None,
) -> Weight | None:
    """Return w fitted to ``log_p`` where it is ``known`` on a grid, None where no fit falls off.

    Beyond the grid, and where Φ exceeds ``rise``, how far ln p is known to fall, Φ must rise along
    every ray from the origin. The misfit must be less than ``GAIN`` times that of the ``present``
    weight.
    """
    scales = float(grid[0][-1]), float(grid[1][-1])
    i, j = np.nonzero(known)
    target = log_p[known].max() - log_p[known]
    highest = max(
        (
            degree
            for degree in DEGREES
            if POINTS_PER_COEFFICIENT * (degree + 1) * (degree + 2) <= 2 * target.size
            and degree <= max(2.0, rise / RISE_PER_DEGREE)
        ),
        default=0,
    )
    powers, root = _powers(highest), _importance(target)
    first, second = powers.T
    x, y = grid[0][i] / scales[0], grid[1][j] / scales[1]
    columns = root[:, None] * _monomials(x, first) * _monomials(y, second)
    least = np.inf
    if present is not None:
        misfit = target - present.exponent(grid[0][i], grid[1][j])
        misfit -= np.average(misfit, weights=root**2)
        least = float(np.linalg.norm(root * misfit) / np.linalg.norm(root * target))
    return _chosen(
        fits(columns, root * target, powers), scales, lambda phi: OUTSIDE | (phi > rise), least
    )


def on_grid(x: Array, y: Array, coefficients: Array) -> Array:
    """Return Σ c_ij x^i y^j on the grid (x.size, y.size)."""
    first, second = (
        np.vander(z, n, increasing=True) for z, n in zip((x, y), coefficients.shape, strict=True)
    )
    return np.asarray(first @ coefficients @ second.T)


def _values(coefficients: Array, x: Array, y: Array) -> Array:
    if x.ndim == 2 and x.shape[1] == 1 and y.ndim == 1:
        return np.asarray(on_grid(x[:, 0], y, coefficients))
    first, second = np.broadcast_arrays(x, y)
    return np.asarray(polyval2d(first, second, coefficients))


@lru_cache
def _powers(degree: int) -> Powers:
    """Pairs of powers up to a total degree, in its order, (coefficients, 2)."""
    return np.array([(i, total - i) for total in range(degree + 1) for i in range(total + 1)])


def _monomials(x: Array, powers: Powers, *, slope: bool = False) -> Array:
    """x^k or its slope k x^(k−1), (points, powers)."""
    values = np.vander(x, int(powers.max(initial=0)) + 1, increasing=True)
    return values[:, powers] if not slope else powers * values[:, np.maximum(powers - 1, 0)]


def fits(columns: Array, right: Array, powers: Powers) -> Iterator[tuple[Array, float]]:
    """Yield the least-squares fit of ``right`` for each total degree, with its relative misfit.

    ``columns`` belong to ``powers`` by rising degree, so that the leading blocks of one
    triangular factor hold every fit. Ends where columns are linearly dependent.
    """
    R = np.asarray(np.linalg.qr(np.column_stack([columns, right]), mode="r"))
    total = powers.sum(axis=1)
    dependent = np.abs(np.diag(R)) <= DEPENDENT * np.sqrt(np.sum(R**2, axis=0))
    for degree in range(1, int(total[-1]) + 1):
        n = int(np.count_nonzero(total <= degree))
        if dependent[:n].any():
            return
        phi = np.zeros((degree + 1, degree + 1))
        phi[powers[:n, 0], powers[:n, 1]] = solve_triangular(R[:n, :n], R[:n, -1])
        yield phi, float(np.linalg.norm(R[n:, -1]) / np.linalg.norm(R[:, -1]))


def _importance(rise: Array) -> Array:
    return np.asarray(np.sqrt(np.exp(-rise / IMPORTANCE) + LEAST_IMPORTANCE))


def _chosen(
    fits: Iterator[tuple[Array, float]],
    scales: tuple[float, float],
    unknown: Callable[[Array], Flags],
    least: float = np.inf,
) -> Weight | None:
    """The best of the fits that rise along every ray where the density is ``unknown``."""
    best = None
    for phi, misfit in fits:
        if misfit < GAIN * least:
            raised = phi.copy()
            raised[0, 0] -= on_grid(UNIT, UNIT, phi).min()
            values = on_grid(RAYS, RAYS, raised)
            # (i + j) Φ_ij are the coefficients of x ∂Φ/∂x + y ∂Φ/∂y, the slope along a ray.
            powers = np.arange(len(phi))
            along = on_grid(RAYS, RAYS, (powers[:, None] + powers) * raised)
            far = unknown(values)
            if np.all(along[far] > 0.0) and np.all(values[far] > 0.0):
                best, least = Weight(raised, scales), misfit
        if misfit <= EXACT:
            break
    return best
