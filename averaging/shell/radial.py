"""Integrals over the energy shell along rays from the equilibrium, exact at its singular ends.

Along a ray y = r e of whitened coordinates V rises strictly, so the shell is 0 <= r <= R. The ray
is cut where a stop is first touched. Up to the first cut the integrals are incomplete beta
functions. In every later panel the substitution x = X sin²φ, with X the distance to the turning
point that the panel's own smooth potential would have, removes both the root at the turning point
and the half-integer powers of Hertz contact, and stays smooth when the true turning point lies
just beyond the panel.
"""

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.special import beta, betainc

from averaging.shell.panel import Panel
from averaging.shell.reduced import ReducedPotential

Array = NDArray[np.float64]


def shell_ray_integrals(
    potential: ReducedPotential, energy: Array, directions: Array, *, rules: Sequence[int]
) -> Array:
    """Return ∫ v^a r^(c−1) (1, v, w) dr along rays, v = 1 − V/H, lengths in units of √H.

    ``energy`` (rays,) and unit ``directions`` (rays, c); a = n − c/2 − 1. The three integrals
    belong to T, to the phase volume and to H T'. For a > 0, w = a/v, the derivative under the
    integral; otherwise that diverges and w = a + 1 + V ((c−1)/(r V_r) − V_rr/V_r²), from
    differentiating with V as the variable. ``rules`` are numbers of Gauss points per panel, each
    of which gives a result of its own. Shape (rules, rays, 3).
    """
    c = potential.count
    exponent = potential.n - 0.5 * c - 1.0
    first, panels = _cut(potential, energy, directions)
    total = np.empty((len(rules), energy.size, 3))
    total[:] = _free_panel(energy, first, exponent, c)
    for rays, panel, level, end_level, length in panels:
        total[:, rays] += panel.integrals(
            energy[rays], level, end_level, length, exponent=exponent, rules=rules
        )
    return total


def shell_ray_moments(
    potential: ReducedPotential,
    energy: Array,
    directions: Array,
    orders: Sequence[tuple[int, int]],
    *,
    rules: Sequence[int],
) -> Array:
    """Return ∫ v^(a+j) r^(k+c−1) dr along rays for every (k, j) of ``orders``.

    v = 1 − V/H and a as in ``shell_ray_integrals``, lengths in units of √H. Shape
    (rules, rays, orders).
    """
    c = potential.count
    exponent = potential.n - 0.5 * c - 1.0
    first, panels = _cut(potential, energy, directions)
    total = np.empty((len(rules), energy.size, len(orders)))
    share = _free_share(energy, first)
    for column, (k, j) in enumerate(orders):
        half = 0.5 * (c + k)
        total[..., column] = 2.0 ** (half - 1.0) * _beta_to(share, half, exponent + j + 1.0)
    for rays, panel, level, end_level, length in panels:
        total[:, rays] += panel.moments(
            energy[rays], level, end_level, length, exponent=exponent, orders=orders, rules=rules
        )
    return total


def _cut(
    potential: ReducedPotential, energy: Array, directions: Array
) -> tuple[Array, Iterator[tuple[NDArray[np.intp], Panel, Array, Array, Array]]]:
    """Where rays first touch a stop, (rays,), and the panels beyond.

    Each panel comes with the rays that reach it, V at its start and end (∞ for none) and length.
    """
    reach = np.maximum(directions @ potential.rows.T, 0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        touch = np.where(reach > 0, potential.clearance / reach, np.inf)
    # Columns that no ray reaches are dropped: a stop that cannot be touched costs nothing.
    cuts = np.sort(touch, axis=1)
    cuts = cuts[:, np.isfinite(cuts).any(axis=0)]
    edges = np.concatenate([cuts, np.full((energy.size, 1), np.inf)], axis=1)

    def panels() -> Iterator[tuple[NDArray[np.intp], Panel, Array, Array, Array]]:
        for j in range(edges.shape[1] - 1):
            candidates = np.flatnonzero(edges[:, j + 1] > edges[:, j])
            start = edges[candidates, j]
            level = potential(start[:, None] * directions[candidates])
            live = level < energy[candidates]
            rays, start, level = candidates[live], start[live], level[live]
            if rays.size:
                end = edges[rays, j + 1]
                inside = np.isfinite(end)
                end_level = np.full(end.shape, np.inf)
                if inside.any():
                    end_level[inside] = potential(end[inside, None] * directions[rays[inside]])
                engaged = np.where(touch[rays] <= start[:, None], reach[rays], 0.0)
                yield rays, Panel(potential, start, engaged), level, end_level, end - start

    return edges[:, 0], panels()


def _free_share(energy: Array, end: Array) -> Array:
    """½ r²/H at the first stop, 1 at the most."""
    with np.errstate(over="ignore"):
        return np.asarray(np.minimum(end * end / (2.0 * energy), 1.0))


def _beta_to(share: Array, x: float, y: float) -> Array:
    return np.asarray(beta(x, y) * betainc(x, y, share))


def _free_panel(energy: Array, end: Array, exponent: float, c: int) -> Array:
    """The integrals up to the first stop, where V = ½ r²; shape (rays, 3)."""
    share = _free_share(energy, end)
    half = 0.5 * c
    unit = 2.0 ** (half - 1.0)
    states = unit * _beta_to(share, half, exponent + 1.0)
    volume = unit * _beta_to(share, half, exponent + 2.0)
    if exponent > 0:
        slope = exponent * unit * _beta_to(share, half, exponent)
    else:
        slope = (exponent + half) * states
    return np.stack([states, volume, slope], axis=1)
