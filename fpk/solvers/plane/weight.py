"""The weight w = exp(−Φ) of p = w u: Φ a polynomial of both energies, close to −ln p.

Any weight gives the same p, as the equation is solved for w u; the closer w is to p, the fewer
unknowns u takes, and the farther out p stays positive. The first weight is fitted to a probe of the
process, later ones to solutions.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.polynomial.polynomial import polyder, polyval2d
from scipy.linalg import solve_triangular

from fpk.numeric.arrays import EPS, SMALLEST, Array, Flags, Integers
from fpk.numeric.errors import NotCertified
from fpk.system.process import Process

PROBE = np.concatenate([[0.0], np.logspace(-2.0, 3.0, 52)])
"""Energies of a probe along each axis, in units of the process's scales; ten per decade resolve
ln p of damping of any power of H."""
AXIS = 1e-4
"""Where the slopes at H_i = 0 are evaluated, in units of the scale: b is singular on the axis, and
the slopes vary over energies of the order of the scale."""
NATS = -float(np.log(EPS))
"""Fall of ln p, 36, beyond which the density is below round-off of its largest value."""
BEYOND = 1e-3
"""Fraction of the tolerance that w falls to at the far edges of the first mesh."""
HIGHEST = 6
"""Highest total degree of Φ. Damping of degree k in the energies gives k + 1 under detailed
balance."""
EXACT = 1e-12
"""Relative misfit that is round-off: no higher degree is tried."""
GAIN = 0.5
"""Factor by which a higher degree must lower the misfit: high degrees extrapolate badly."""
IMPORTANCE = 10.0
"""Rise of Φ over which a point's share in the sum of squares falls to 1/e: w matters most where p
is large, but u = p/w should stay of order one far out, too."""
RISE_PER_DEGREE = 2.8
"""Rise of −ln p that a fit must cover per degree: Φ is extrapolated far beyond it."""
RAYS = np.concatenate([np.linspace(0.0, 1.0, 49), np.geomspace(1.04, 30.0, 48)])
"""Coordinates of the grid on which Φ is checked, in units of the fitted box: up to the last of them
it must rise along every ray."""
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

        Raises ``NotCertified`` where Φ does not rise so far within ``RAYS``.
        """
        inside = on_grid(RAYS, RAYS, self.coefficients) < rise
        if inside[-1].any() or inside[:, -1].any():
            raise NotCertified(f"the weight falls by less than exp(−{rise:.0f})")
        first, second = (
            float(RAYS[int(np.flatnonzero(inside.any(axis=1 - axis))[-1]) + 1]) * scale
            for axis, scale in enumerate(self.scales)
        )
        return first, second


@dataclass(frozen=True, eq=False)
class Probe:
    """Approximate ln p and its slopes (2, …) on the grid of ``PROBE`` in units of the scales.

    Meshes and weights start from it; the answer does not rest on it.
    """

    log_density: Array
    slopes: Array

    def extent(self, tail: float) -> Array:
        """Return the energies (2,), in units of the scales, with the share ``tail`` beyond each."""
        width = np.gradient(PROBE)
        mass = np.exp(self.log_density - self.log_density.max()) * np.multiply.outer(width, width)
        ends = np.empty(2)
        for axis in (0, 1):
            beyond = np.cumsum(mass.sum(axis=1 - axis)[::-1])[::-1]
            share = np.log(np.maximum(beyond / beyond[0], SMALLEST))
            ends[axis] = np.interp(-np.log(tail), -share, PROBE)
        return ends


def probed(process: Process) -> Probe:
    """Return the density that zero flux everywhere would give, ∇ ln p = b⁻¹ (2s − ∇·b).

    ln p is the mean of the integrals along two paths, first one energy, then the other: exact
    under detailed balance, whatever the coupling. Where that does not fall off, the probability
    circulates strongly; taken instead is the product of exponentials whose means are the process's
    scales.

    Raises ``NotCertified`` where b is singular off the axes.
    """
    inside = np.maximum(PROBE, AXIS)
    points = np.stack(np.broadcast_arrays(inside[:, None], inside), axis=-1).reshape(-1, 2)
    c = process.coefficients(points * process.energy_scales)
    slopes = divided_by_diffusion(2.0 * c.drift - c.divergence, c.diffusion)
    first, second = (slopes * process.energy_scales).T.reshape(2, PROBE.size, PROBE.size)

    def integral(slope: Array) -> Array:
        steps = 0.5 * (slope[1:] + slope[:-1]) * np.diff(PROBE)[:, None]
        return np.concatenate([np.zeros_like(slope[:1]), np.cumsum(steps, axis=0)])

    along = integral(first), integral(second.T).T
    log_density = 0.5 * (along[0][:, :1] + along[1] + along[1][:1] + along[0])
    # p H1 H2, the density of the logarithms of the energies.
    log = np.log(np.maximum(PROBE, PROBE[1]))
    log_mass = log_density + log[:, None] + log
    if max(log_mass[-1].max(), log_mass[:, -1].max()) < log_mass.max() - NATS:
        return Probe(log_density, np.stack([first, second]))
    return Probe(-PROBE[:, None] - PROBE, np.full((2, PROBE.size, PROBE.size), -1.0))


def divided_by_diffusion(flow: Array, b: Array) -> Array:
    """Return b⁻¹ ``flow`` (points, 2); raises ``NotCertified`` where b is singular."""
    determinant = b[:, 0, 0] * b[:, 1, 1] - b[:, 0, 1] ** 2
    if not np.all(determinant > 0.0):
        raise NotCertified("some combination of the two energies gets no noise")
    first = b[:, 1, 1] * flow[:, 0] - b[:, 0, 1] * flow[:, 1]
    second = b[:, 0, 0] * flow[:, 1] - b[:, 0, 1] * flow[:, 0]
    return np.stack([first, second], axis=1) / determinant[:, None]


def flux_free_weight(probe: Probe, scales: tuple[float, ...]) -> Weight | None:
    """Return w fitted to the slopes of the probe, or None where no fit falls off.

    Where probability circulates b⁻¹ (2s − ∇·b) is no gradient, and Φ the nearest potential.
    """
    rise = probe.log_density.max() - probe.log_density
    last = [
        max(int(np.flatnonzero((rise < NATS).any(axis=1 - axis))[-1]) + 1, HIGHEST + 1)
        for axis in (0, 1)
    ]
    first, second = (min(n, PROBE.size - 1) for n in last)
    # Every second point, the last one included, resolves ln p as well.
    inside = slice(2 - first % 2, first + 1, 2), slice(2 - second % 2, second + 1, 2)
    ends = float(PROBE[first]), float(PROBE[second])
    x, y = PROBE[inside[0]] / ends[0], PROBE[inside[1]] / ends[1]
    powers, root = _powers(HIGHEST)[1:], np.exp(-0.5 * rise[inside] / IMPORTANCE)
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
    return _chosen(candidates, (ends[0] * scales[0], ends[1] * scales[1]), np.inf, np.inf)


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
    powers = _powers(min(HIGHEST, int(rise / RISE_PER_DEGREE)))
    if target.size < len(powers):
        return None
    root, (first, second) = np.exp(-0.5 * target / IMPORTANCE), powers.T
    x, y = grid[0][i] / scales[0], grid[1][j] / scales[1]
    columns = root[:, None] * _monomials(x, first) * _monomials(y, second)
    least = np.inf
    if present is not None:
        misfit = target - present.exponent(grid[0][i], grid[1][j])
        misfit -= np.average(misfit, weights=root**2)
        least = float(np.linalg.norm(root * misfit) / np.linalg.norm(root * target))
    return _chosen(fits(columns, root * target, powers), scales, rise, least)


def on_grid(x: Array, y: Array, coefficients: Array) -> Array:
    """Return Σ c_ij x^i y^j on the grid (x.size, y.size)."""
    first, second = (
        np.vander(z, n, increasing=True) for z, n in zip((x, y), coefficients.shape, strict=True)
    )
    return np.asarray(first @ coefficients @ second.T)


def _values(coefficients: Array, x: Array, y: Array) -> Array:
    """Σ c_ij x^i y^j at points that broadcast together; of a grid (m, 1), (n,) by axes."""
    if x.ndim == 2 and x.shape[1] == 1 and y.ndim == 1:
        return on_grid(x[:, 0], y, coefficients)
    first, second = np.broadcast_arrays(x, y)
    return np.asarray(polyval2d(first, second, coefficients))


@lru_cache
def _powers(degree: int) -> Integers:
    """Pairs of powers up to a total degree, in its order, (coefficients, 2)."""
    return np.array([(i, total - i) for total in range(degree + 1) for i in range(total + 1)])


def _monomials(x: Array, powers: Integers, *, slope: bool = False) -> Array:
    """x^k or its slope k x^(k−1), (points, powers)."""
    values = np.vander(x, int(powers.max(initial=0)) + 1, increasing=True)
    return values[:, powers] if not slope else powers * values[:, np.maximum(powers - 1, 0)]


def fits(columns: Array, right: Array, powers: Integers) -> Iterator[tuple[Array, float]]:
    """Yield the least-squares fit of ``right`` for each total degree, with its relative misfit.

    ``columns`` belong to ``powers`` by rising degree, so that the leading blocks of one
    triangular factor hold every fit. Ends where columns are linearly dependent.
    """
    R = np.asarray(np.linalg.qr(np.column_stack([columns, right]), mode="r"))
    total = powers.sum(axis=1)
    dependent = np.abs(np.diag(R)) <= EXACT * np.sqrt(np.sum(R**2, axis=0))
    for degree in range(1, int(total[-1]) + 1):
        n = int(np.count_nonzero(total <= degree))
        if dependent[:n].any():
            return
        phi = np.zeros((degree + 1, degree + 1))
        phi[powers[:n, 0], powers[:n, 1]] = solve_triangular(R[:n, :n], R[:n, -1])
        yield phi, float(np.linalg.norm(R[n:, -1]) / np.linalg.norm(R[:, -1]))


def _chosen(
    fits: Iterator[tuple[Array, float]], scales: tuple[float, float], rise: float, least: float
) -> Weight | None:
    """The best of the fits that rise along every ray beyond the box and where Φ > ``rise``."""
    best, outside = None, np.maximum(RAYS[:, None], RAYS) > 1.0
    for phi, misfit in fits:
        if misfit < GAIN * least:
            raised, values = phi.copy(), on_grid(RAYS, RAYS, phi)
            lowest = values[~outside].min()
            raised[0, 0], values = phi[0, 0] - lowest, values - lowest
            # (i + j) Φ_ij are the coefficients of x ∂Φ/∂x + y ∂Φ/∂y, the slope along a ray.
            powers = np.arange(len(phi))
            along = on_grid(RAYS, RAYS, (powers[:, None] + powers) * phi)
            far = outside | (values > rise)
            if np.all(along[far] > 0.0) and np.all(values[far] > 0.0):
                best, least = Weight(raised, scales), misfit
        if misfit <= EXACT:
            break
    return best
