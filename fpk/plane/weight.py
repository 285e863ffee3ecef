"""The weight w = exp(−Φ) of p = w u: Φ a polynomial of both energies, fitted to −ln p.

Only how soon u is found depends on w, not what p is: the equation is solved for w u.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from fpk.errors import NotCertified
from fpk.plane.mesh import PROBE, Probe
from fpk.plane.polynomials import Grid, fits, grid_of, of_total_degree, powers_of, values_at

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

DEGREES = (1, 2, 3, 4, 5, 6)
"""Total degrees of Φ that are tried: damping of even powers of q and v gives integers from 1 on."""
EXACT = 1e-12
"""Misfit, relative to what is fitted, below which no higher degree is asked for."""
BETTER = 0.5
"""Share of the misfit that a higher degree must bring it down to: it is less safe farther out."""
IMPORTANCE = 10.0
"""Nats over which the importance of a place falls to 1/e: u is to be of order one far out too."""
LEAST = 1e-4
"""Least importance of a place."""
PER_COEFFICIENT = 3
"""Places that each coefficient of Φ is to rest on."""
NATS_PER_DEGREE = 4.0
"""Nats of ln p known that a degree of Φ above 2 is to rest on: it is continued far beyond them."""
SEEN = 36.0
"""Nats down to which the first guess of p is fitted: e^−36 = 2e-16."""
UNIT_GRID = np.linspace(0.0, 1.0, 49)
REACH = 30.0
"""Ends of the places that are looked at, in units of the fitted box; Φ has to rise as far."""
LOOKED_AT = np.concatenate([UNIT_GRID, np.geomspace(1.04, REACH, 48)])
OUTSIDE = np.maximum(LOOKED_AT[:, None], LOOKED_AT) > 1.0
FLOOR = float(np.exp(-44.0))
"""Added to w on elements, which span all of it: 8e-20 keeps their matrices regular, and u need only
be above −1e5 there for p ≥ −1e-14."""
NATS_PER_PANEL = 32.0
"""Rise of Φ over a panel, N: m + k Gauss points integrate exp(−N t) times a product of two
polynomials of degree k, if it is bounded by 1 and the worst there is, to Σ I_j(N/2), j ≥ 2m,
against e^(N/2)/N: to 4e-14 for N = 32 and m = 18."""
EVEN = 10.0
"""Nats that are shared out evenly on top, for places at which Φ does not change at all."""


@dataclass(frozen=True, eq=False)
class Weight:
    """w(H1, H2) = exp(−Φ), Φ = Σ ``coefficients``[i, j] (H1/``scales``[0])^i (H2/``scales``[1])^j.

    The least Φ on the grid that is looked at is 0.
    """

    coefficients: Array
    scales: tuple[float, float]

    def exponent(self, H1: Array, H2: Array) -> Array:
        """Φ at energies that broadcast together."""
        return values_at(self.coefficients, H1 / self.scales[0], H2 / self.scales[1])

    def on_grid(self, H1: Array, H2: Array) -> tuple[Array, Array, Array]:
        """Φ and its two slopes on the grid (H1.size, H2.size)."""
        x, y = H1 / self.scales[0], H2 / self.scales[1]
        grid = grid_of(x, y, len(self.coefficients) - 1)
        first, second = grid.slopes(self.coefficients)
        return grid.values(self.coefficients), first / self.scales[0], second / self.scales[1]

    def floored(self, H1: Array, H2: Array) -> Array:
        """w + ``FLOOR`` at energies that broadcast together."""
        return np.asarray(np.exp(-self.exponent(H1, H2)) + FLOOR)

    def floored_on_grid(self, H1: Array, H2: Array) -> tuple[Array, Array, Array]:
        """w + ``FLOOR`` and the two slopes of its −ln on the grid (H1.size, H2.size)."""
        phi, *slopes = self.on_grid(H1, H2)
        w = np.exp(-phi)
        first, second = (slope * (w / (w + FLOOR)) for slope in slopes)
        return w + FLOOR, first, second

    def terms(self, H1: Array, H2: Array) -> Array:
        """Sum of the sizes of the terms of Φ at energies that broadcast together."""
        sizes = np.abs(self.coefficients)
        return values_at(sizes, np.abs(H1) / self.scales[0], np.abs(H2) / self.scales[1])

    def ends(self, nats: float) -> tuple[float, float]:
        """Energies along each axis as far as w > exp(−``nats``).

        Raises ``NotCertified`` where w does not fall so far within ``REACH``.
        """
        phi = _looked_at(len(self.coefficients) - 1)[0].values(self.coefficients)
        seen = phi < nats
        if seen[-1].any() or seen[:, -1].any():
            raise NotCertified(f"the weight falls by less than {nats:.0f} nats")
        first, second = (
            float(LOOKED_AT[int(np.flatnonzero(seen.any(axis=1 - axis))[-1]) + 1]) * scale
            for axis, scale in enumerate(self.scales)
        )
        return first, second

    def panels(self, nats: float) -> tuple[Array, Array]:
        """Nodes along each axis, as far as w > exp(−``nats``), over which Φ changes alike.

        Raises ``NotCertified`` where w does not fall so far within ``REACH``.
        """
        grids = [end * UNIT_GRID for end in self.ends(nats)]
        phi, *slopes = self.on_grid(*grids)
        nodes = []
        for axis, (H, slope) in enumerate(zip(grids, slopes, strict=True)):
            rate = np.where(phi < nats, np.abs(slope), 0.0).max(axis=1 - axis)
            rate = rate + EVEN / H[-1]
            rise = np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]) * H[1])])
            count = int(np.ceil(rise[-1] / NATS_PER_PANEL))
            nodes.append(np.interp(np.linspace(0.0, rise[-1], count + 1), rise, H))
        return nodes[0], nodes[1]


def flux_free_weight(probe: Probe, scales: tuple[float, ...]) -> Weight | None:
    """Return w fitted to the slopes of the probe's guess of ln p, or None where none falls off.

    Where probability circulates b⁻¹ (2s − ∇·b) is no gradient, and Φ the nearest potential.
    """
    depth = probe.log_density.max() - probe.log_density
    seen = depth < SEEN
    last = [
        max(int(np.flatnonzero(seen.any(axis=1 - axis))[-1]) + 1, len(DEGREES) + 1)
        for axis in (0, 1)
    ]
    first, second = (min(n, PROBE.size - 1) for n in last)
    inside = (slice(1, first + 1), slice(1, second + 1))
    ends = PROBE[first], PROBE[second]
    grid = grid_of(PROBE[inside[0]] / ends[0], PROBE[inside[1]] / ends[1], DEGREES[-1])
    wanted = [-slope[inside] * end for slope, end in zip(probe.slopes, ends, strict=True)]
    root = _importance(depth[inside])
    right = np.concatenate([(root * slope).ravel() for slope in wanted])

    def columns() -> Iterable[tuple[NDArray[np.int64], Array]]:
        for degree in DEGREES:
            i, j = (powers := of_total_degree(degree)).T
            along = root[..., None] * grid.dx[:, None, i] * grid.y[:, j]
            across = root[..., None] * grid.x[:, None, i] * grid.dy[:, j]
            yield powers, np.concatenate([along, across]).reshape(-1, i.size)

    return _chosen(
        fits(columns(), right), (ends[0] * scales[0], ends[1] * scales[1]), lambda _: OUTSIDE
    )


def fitted_weight(
    grid: tuple[Array, Array], log_p: Array, known: Flags, level: float
) -> Weight | None:
    """Return w fitted to ``log_p`` where it is ``known`` on a grid, None where no fit falls off.

    Beyond the grid, and where Φ exceeds ``level`` (nats below the largest p), Φ has to rise along
    every ray from the origin.
    """
    if not known.any():
        return None
    scales = float(grid[0][-1]), float(grid[1][-1])
    at = np.nonzero(known)
    X, Y = (
        powers_of(H / end, DEGREES[-1])[0][place]
        for H, end, place in zip(grid, scales, at, strict=True)
    )
    target = log_p[known].max() - log_p[known]
    root = _importance(target)

    def columns() -> Iterable[tuple[NDArray[np.int64], Array]]:
        yield np.zeros((1, 2), np.int64), root[:, None]
        for degree in DEGREES:
            too_few = PER_COEFFICIENT * (degree + 1) * (degree + 2) > 2 * target.size
            if too_few or degree > max(2.0, level / NATS_PER_DEGREE):
                return
            i, j = (powers := of_total_degree(degree)).T
            yield powers, root[:, None] * X[:, i] * Y[:, j]

    found = fits(columns(), root * target)
    return _chosen(found, scales, lambda phi: OUTSIDE | (phi > level))


@lru_cache
def _looked_at(degree: int) -> tuple[Grid, Grid]:
    """Powers at the places that are looked at, and in the box of the fit."""
    return grid_of(LOOKED_AT, LOOKED_AT, degree), grid_of(UNIT_GRID, UNIT_GRID, degree)


def _importance(depth: Array) -> Array:
    return np.asarray(np.sqrt(np.exp(-depth / IMPORTANCE) + LEAST))


def _chosen(
    found: Iterable[tuple[Array, float]],
    scales: tuple[float, float],
    unknown: Callable[[Array], Flags],
) -> Weight | None:
    """The best of the fits that rise along every ray where the density is ``unknown``."""
    best, least = None, np.inf
    for phi, misfit in found:
        if misfit < BETTER * least:
            looked_at, box = _looked_at(len(phi) - 1)
            # Φ counts from its least value where it was fitted.
            raised = phi.copy()
            raised[0, 0] -= box.values(phi).min()
            values = looked_at.values(raised)
            powers = np.arange(len(phi))
            # i Φ_ij + j Φ_ij are the coefficients of x ∂Φ/∂x + y ∂Φ/∂y.
            along = looked_at.values((powers[:, None] + powers) * raised)
            far = unknown(values)
            if np.all(along[far] > 0.0) and np.all(values[far] > 0.0):
                best, least = Weight(raised, scales), misfit
        if misfit <= EXACT:
            break
    return best
