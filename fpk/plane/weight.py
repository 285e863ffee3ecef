"""The weight w = exp(−Φ) of p = w u: Φ a polynomial of both energies, fitted to −ln p.

Only how soon u is found depends on w, not what p is: the equation is solved for w u.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.polynomial.polynomial import polyder
from numpy.typing import NDArray

from fpk.errors import NotCertified
from fpk.plane.mesh import SURVEY, Survey

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
FLOOR = float(np.exp(-44.0))
"""Added to w on elements, which span all of it: 8e-20 keeps their matrices regular, and u need only
be above −1e5 there for p ≥ −1e-14."""
NATS_PER_PANEL = 10.0
"""Rise of Φ over a panel: 12 Gauss points integrate exp(−10 t) to 1e-14 by their remainder."""


@dataclass(frozen=True, eq=False)
class Weight:
    """w(H1, H2) = exp(−Φ), Φ = Σ ``coefficients``[i, j] (H1/``scales``[0])^i (H2/``scales``[1])^j.

    The least Φ on the grid that is looked at is 0.
    """

    coefficients: Array
    scales: tuple[float, float]

    def exponent(self, H1: Array, H2: Array) -> Array:
        """Φ at energies that broadcast together."""
        return _polynomial(self.coefficients, H1 / self.scales[0], H2 / self.scales[1])

    def on_grid(self, H1: Array, H2: Array) -> tuple[Array, Array, Array]:
        """Φ and its two slopes on the grid (H1.size, H2.size)."""
        x, y = H1[:, None] / self.scales[0], H2 / self.scales[1]
        first, second = (
            _polynomial(_slope(self.coefficients, axis), x, y) / self.scales[axis]
            for axis in (0, 1)
        )
        return _polynomial(self.coefficients, x, y), first, second

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
        return _polynomial(sizes, np.abs(H1) / self.scales[0], np.abs(H2) / self.scales[1])

    def ends(self, nats: float) -> tuple[float, float]:
        """Energies along each axis as far as w > exp(−``nats``).

        Raises ``NotCertified`` where w does not fall so far within ``REACH``.
        """
        phi = _polynomial(self.coefficients, LOOKED_AT[:, None], LOOKED_AT)
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
            # An even share on top, for places at which Φ does not change at all.
            rate = rate + NATS_PER_PANEL / H[-1]
            rise = np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]) * H[1])])
            count = int(np.ceil(rise[-1] / NATS_PER_PANEL))
            nodes.append(np.interp(np.linspace(0.0, rise[-1], count + 1), rise, H))
        return nodes[0], nodes[1]


def flux_free_weight(survey: Survey, scales: tuple[float, ...]) -> Weight | None:
    """Return w fitted to the slopes of the survey's guess of ln p, or None where none falls off.

    Where probability circulates b⁻¹ (2s − ∇·b) is no gradient, and Φ the nearest potential.
    """
    depth = survey.log_density.max() - survey.log_density
    seen = depth < SEEN
    last = [
        max(int(np.flatnonzero(seen.any(axis=1 - axis))[-1]) + 1, len(DEGREES) + 1)
        for axis in (0, 1)
    ]
    first, second = (min(n, SURVEY.size - 1) for n in last)
    inside = (slice(1, first + 1), slice(1, second + 1))
    ends = SURVEY[first], SURVEY[second]
    x, y = SURVEY[inside[0]] / ends[0], SURVEY[inside[1]] / ends[1]
    wanted = [-slope[inside] * end for slope, end in zip(survey.slopes, ends, strict=True)]
    root = _importance(depth[inside])
    right = np.concatenate([(root * slope).ravel() for slope in wanted])
    fits = []
    for degree in DEGREES:
        powers = _powers(degree)[1:]
        i, j = powers.T
        X, Y = (z[:, None] ** np.arange(degree + 1) for z in (x, y))
        along = root[..., None] * (i * X[:, np.maximum(i - 1, 0)])[:, None, :] * Y[:, j]
        across = root[..., None] * X[:, None, i] * (j * Y[:, np.maximum(j - 1, 0)])
        rows = np.concatenate([along.reshape(-1, i.size), across.reshape(-1, i.size)])
        phi, misfit = _least_squares(rows, right, powers)
        fits.append((phi, misfit))
        if misfit <= EXACT:
            break
    outside = np.maximum(LOOKED_AT[:, None], LOOKED_AT) > 1.0
    return _chosen(fits, (ends[0] * scales[0], ends[1] * scales[1]), lambda _: outside)


def fitted_weight(
    grid: tuple[Array, Array], log_p: Array, known: Flags, level: float
) -> Weight | None:
    """Return w fitted to ``log_p`` where it is ``known`` on a grid, None where no fit falls off.

    Beyond the grid, and where Φ exceeds ``level`` (nats below the largest p), Φ has to rise along
    every ray from the origin.
    """
    scales = float(grid[0][-1]), float(grid[1][-1])
    x, y = grid[0] / scales[0], grid[1] / scales[1]
    top = float(log_p[known].max()) if known.any() else 0.0
    target = np.where(known, top - log_p, 0.0)
    root = _importance(target) * known
    fits = []
    for degree in DEGREES:
        powers = _powers(degree)
        too_few = PER_COEFFICIENT * len(powers) > np.count_nonzero(known)
        if too_few or degree > max(2.0, level / NATS_PER_DEGREE):
            break
        X, Y = (z[:, None] ** np.arange(degree + 1) for z in (x, y))
        rows = root[..., None] * X[:, None, powers[:, 0]] * Y[:, powers[:, 1]]
        phi, misfit = _least_squares(rows.reshape(-1, len(powers)), (root * target).ravel(), powers)
        fits.append((phi, misfit))
        if misfit <= EXACT:
            break
    outside = np.maximum(LOOKED_AT[:, None], LOOKED_AT) > 1.0
    return _chosen(fits, scales, lambda phi: outside | (phi > level))


def _polynomial(coefficients: Array, x: Array, y: Array) -> Array:
    """Σ coefficients[i, j] x^i y^j at places that broadcast together."""
    powers = np.stack([y**j for j in range(coefficients.shape[1])])
    across = np.tensordot(coefficients, powers, axes=1)
    total = across[-1]
    for row in across[-2::-1]:
        total = total * x + row
    return np.asarray(np.broadcast_to(total, np.broadcast_shapes(x.shape, y.shape)))


def _slope(coefficients: Array, axis: int) -> Array:
    return np.asarray(polyder(coefficients, axis=axis))


def _importance(depth: Array) -> Array:
    return np.asarray(np.sqrt(np.exp(-depth / IMPORTANCE) + LEAST))


def _powers(degree: int) -> NDArray[np.int64]:
    """Pairs of powers of total degree up to ``degree``, the constant first."""
    return np.array([(i, k - i) for k in range(degree + 1) for i in range(k + 1)])


def _least_squares(rows: Array, right: Array, powers: NDArray[np.int64]) -> tuple[Array, float]:
    found = np.linalg.lstsq(rows, right, rcond=None)[0]
    size = int(powers.max()) + 1
    phi = np.zeros((size, size))
    phi[powers[:, 0], powers[:, 1]] = found
    return phi, float(np.linalg.norm(rows @ found - right) / np.linalg.norm(right))


def _chosen(
    fits: list[tuple[Array, float]],
    scales: tuple[float, float],
    unknown: Callable[[Array], Flags],
) -> Weight | None:
    """The best of the fits that rise along every ray where the density is ``unknown``."""
    best, least = None, np.inf
    g, box = LOOKED_AT, UNIT_GRID
    for phi, misfit in fits:
        # Φ counts from its least value where it was fitted.
        raised = phi.copy()
        raised[0, 0] -= _polynomial(phi, box[:, None], box).min()
        values = _polynomial(raised, g[:, None], g)
        along = g[:, None] * _polynomial(_slope(phi, 0), g[:, None], g)
        along = along + g * _polynomial(_slope(phi, 1), g[:, None], g)
        far = unknown(values)
        safe = np.all(along[far] > 0.0) and np.all(values[far] > 0.0)
        if safe and misfit < BETTER * least:
            best, least = Weight(raised, scales), misfit
    return best
