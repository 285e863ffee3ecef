"""Meshes of one energy for questions of time: fine where a motion starts and where it ends."""

from math import comb, exp, sqrt

import numpy as np

from fpk.numeric.arrays import Array
from fpk.solvers.line.mesh import NATS, initial_nodes
from fpk.solvers.probe import probed
from fpk.system.process import Process

HIGHEST = 16
"""Highest degree of elements."""
GROWTH = 1.6
"""Ratio of neighbouring lengths away from a point where f changes fast: a function of the distance
over it is as smooth on each element as on the one before."""
SAME = 1e-3
"""Distance of two nodes, relative to the elements beside it, below which one is left out."""
LAYER = 0.5
"""Length of the elements at a start or a limit, in units of the width of the density there at the
first time."""
THINNEST = 1e-12
"""Least length of the elements at a limit, relative to it: in shorter ones energies are not told
apart. Whoever starts farther from it has not failed at times for which these are too long."""
FAST = 20.0
"""Laplace variables on a contour times t, as far as they count."""
LARGEST_VALUE = 100.0
"""Largest value at H = 0, relative to the norm in π ~ H^(n−1), of a polynomial that is taken: it
multiplies round-off."""
NONE: Array = np.zeros(0)


def first_degree(degree: int, n: int) -> int:
    """Return the degree of the element at H = 0, where T ~ H^(n−1): at the most ``degree``.

    The polynomial that is orthogonal in H^(n−1) to all of a lower degree k is (n+k−1 over k) at 0.
    """
    return max(k for k in range(1, degree + 1) if k == 1 or comb(k + n - 1, k) <= LARGEST_VALUE)


def layer_at(process: Process, limit: float, time: float) -> tuple[float, float]:
    """Return the ``limit`` and the length of elements there: p falls to 0 over √(b t)."""
    b = float(process.coefficients(np.array([limit])).diffusion[0])
    return limit, max(LAYER * sqrt(b * time), THINNEST * limit)


def time_nodes(
    process: Process,
    end: float,
    degree: int,
    *,
    fine: tuple[tuple[float, float], ...] = (),
    more: Array = NONE,
) -> Array:
    """Return nodes from 0 to ``end``: those of the stationary density, fine at some energies.

    ``fine`` holds energies, which become nodes, and the lengths of the elements beside them. From
    there elements grow. The nodes of contact energies stay. ``more`` are nodes that are added, but
    for those that nearly are others.
    """
    n = process.degrees_of_freedom
    nodes = initial_nodes(probed(process), end, process.nonsmooth, nats=NATS)
    nodes = _with(nodes, end * np.array([0.25, 0.5, 0.75]))  # four elements at least
    kept = [0.0, end, *(H for H in process.nonsmooth if end > H)]
    beside_zero = [length for energy, length in fine if energy == 0.0]
    if n > 2:
        # Of degree k the first element gives k + 2 times as many digits as its share of the scale.
        scale = min([process.energy_scale, end, *(n * length / FAST for length in beside_zero)])
        first = 10.0 ** (-16.0 / (first_degree(degree - 1, n) + 2)) * scale
        # ln T ~ (n − 1) ln H.
        ratio = min(exp(NATS / (n - 1)), GROWTH if beside_zero else np.inf)
        if first < 0.5 * nodes[1]:
            steps = int(np.log(end / first) / np.log(ratio))
            nodes = _with(nodes, first * ratio ** np.arange(steps + 1.0))
    for energy, length in fine:
        if energy == 0.0 and n > 2:
            continue
        nodes = _with(nodes, np.array([energy]))
        kept.append(energy)
        k = int(np.searchsorted(nodes, energy))
        gaps = np.diff(nodes)
        above, below = _growing(gaps[k:], length), _growing(gaps[:k][::-1], length)
        nodes = _with(nodes, np.concatenate([energy + above, energy - below]))
    nodes = _with(nodes, more)
    while True:
        gaps = np.diff(nodes)
        wide = np.maximum(np.append(gaps[1:], 0.0), np.append(0.0, gaps[:-1]))
        close = np.flatnonzero(gaps < SAME * wide)
        # Of two nodes that are nearly the same the right one is left out, or else the left one.
        either = np.stack([close + 1, close], axis=1).ravel()
        either = either[~np.isin(nodes[either], kept)]
        if not either.size:
            return nodes
        nodes = np.delete(nodes, either[0])


def _growing(gaps: Array, length: float) -> Array:
    """Distances at which elements end that grow from ``length`` until ``gaps`` are shorter."""
    ends, steps, x = np.cumsum(gaps), [], 0.0
    while gaps.size and length < gaps[k := min(int(np.searchsorted(ends, x)), gaps.size - 1)]:
        x, length = x + length, GROWTH * length
        if x + 0.5 * length > ends[k] and k == gaps.size - 1:
            break
        steps.append(x)
    return np.array(steps)


def _with(nodes: Array, more: Array) -> Array:
    inside = more[(more > 0.0) & (more < nodes[-1])]
    return np.unique(np.concatenate([nodes, inside]))
