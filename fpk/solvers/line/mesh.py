"""Meshes of one energy: how they follow the coefficients, and where a motion starts and ends."""

import math

import numpy as np

from fpk.numeric.arrays import Array
from fpk.solvers.probe import Probe, probed
from fpk.system.process import Process

NATS = 3.0
"""Fall of ln(p/T) over one element: exp(−3 t) is met by degree 10 to 1e-11."""
SMOOTH_NATS = 4.0
"""Fall of ln(p/T) over one element where ln(p/T) is linear in H: over n nats a polynomial of degree
p misses e^(−x) by n^(p+1)/((p+1)! 2^(2p+1)) of its largest value (Chebyshev), with the
degree of a tolerance (four more than its digits) 1e-1 to 1e-2 of the tolerance."""
LOG_GROWTH = math.log(1.75)
"""ln of how many times ``SMOOTH_NATS`` an element may have where little of the mass is left: over 7
nats p still exceeds its error at the far end (of degree 6 and more), so that it stays positive."""
SPREAD = 20.0
"""Largest ratio of the ends of an element that begins where contact does."""
GRADING = 0.15
"""Ratio of neighbouring lengths towards a point where smoothness is lost."""
GRADED_LAYERS = 5
DEEP_LAYERS = 14
"""Layers down to 3e-12 of the next element: beside a stiff stop and a small clearance T itself has
layers as thin as that."""
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
"""Least length of the elements at a limit, relative to the limit: shorter elements do not tell
energies apart. A start farther from the limit has not failed at times for which they are too
long."""
FAST = 20.0
"""Largest |z| t of the Laplace variables z of a contour that contribute at the time t."""
LARGEST_VALUE = 100.0
"""Largest value at H = 0, relative to the norm in π ~ H^(n−1), of a polynomial that is taken: it
multiplies round-off."""
NONE: Array = np.zeros(0)


def initial_nodes(
    probe: Probe,
    end: float,
    nonsmooth: tuple[float, ...],
    *,
    nats: Array | float = NATS,
    layers: int = GRADED_LAYERS,
) -> Array:
    """Return nodes from 0 to ``end``: on the nonsmooth energies, dense where p/T varies fast.

    ``nats`` is the fall of ln(p/T) over one element. Geometric ``layers`` lie above every nonsmooth
    energy (below it, the density is smooth up to it). Where that is tiny beside its element, T
    still changes with H/H_c: elements grow from there.
    """
    ends = np.array([0.0, *(H for H in nonsmooth if 0.0 < H < end), end])
    nodes: Array = _placed(probe.energy, probe.roughness / nats, ends)
    for H in ends[1:-1]:
        if nodes[np.searchsorted(nodes, H) + 1] > SPREAD * H:
            steps = np.arange(1.0, math.log(end / H) / math.log(SPREAD))
            nodes = np.unique(np.append(nodes, H * SPREAD**steps))
    return with_layers(nodes, nonsmooth, count=layers)


def _placed(energy: Array, rate: Array, ends: Array) -> Array:
    """Nodes among them ``ends``, as many between two as ∫rate asks for, in equal shares of it."""
    grid = ends[-1] / 64.0 * np.arange(65.0)
    on_grid = np.interp(grid, energy, rate)
    total = np.append(0.0, (0.5 * grid[1] * (on_grid[1:] + on_grid[:-1])).cumsum())
    amount = np.interp(ends, grid, total)
    pieces = np.maximum(np.ceil(amount[1:] - amount[:-1]), 1.0)
    # The number of a node, counted by pieces, is linear in the amount between two ends.
    number = np.append(0.0, pieces.cumsum())
    nodes: Array = np.interp(np.interp(np.arange(number[-1] + 1.0), number, amount), total, grid)
    nodes[number.astype(int)] = ends
    return nodes


def with_layers(nodes: Array, nonsmooth: tuple[float, ...], *, count: int = GRADED_LAYERS) -> Array:
    """Return the nodes and geometric layers above those that are nonsmooth energies.

    They go from the last node down to ``count`` layers below the node next to H: wherever that is,
    the distance of the ends of an element from H is in the ratio ``GRADING`` or nearer to 1.
    """
    for H in nonsmooth:
        if count and nodes[0] <= H < nodes[-1]:
            reach = float(nodes[-1]) - H
            gap = float(nodes[np.searchsorted(nodes, H, side="right")]) - H
            layers = np.arange(1.0, count + 1.0 + math.log(gap / reach) / math.log(GRADING))
            nodes = np.unique(np.concatenate([nodes, H + reach * GRADING**layers]))
    return nodes


def split_points(left: Array, right: Array, special: Array) -> Array:
    """Return where to cut elements in two: towards a special point they begin at, else half-way."""
    share = np.where(np.isin(left, special), GRADING, 0.5)
    return left + share * (right - left)


def first_degree(degree: int, n: int) -> int:
    """Return the degree of the element at H = 0, where T ~ H^(n−1): at the most ``degree``.

    The polynomial that is orthogonal in H^(n−1) to all of a lower degree k is (n+k−1 over k) at 0.
    """
    return max(
        k for k in range(1, degree + 1) if k == 1 or math.comb(k + n - 1, k) <= LARGEST_VALUE
    )


def layer_at(process: Process, limit: float, time: float) -> tuple[float, float]:
    """Return the ``limit`` and the length of elements there: p falls to 0 over √(b t)."""
    b = float(process.coefficients(np.array([limit])).diffusion[0])
    return limit, max(LAYER * math.sqrt(b * time), THINNEST * limit)


def time_nodes(
    process: Process,
    end: float,
    degree: int,
    *,
    fine: tuple[tuple[float, float], ...] = (),
    more: Array = NONE,
) -> Array:
    """Return nodes from 0 to ``end`` for questions of time: fine where a motion starts or ends.

    They are those of the stationary density. ``fine`` holds energies, which become nodes, and the
    lengths of the elements beside them, which grow from there until those of the density are
    shorter. ``more`` are nodes that are added, but for those that nearly are others.
    """
    n = process.degrees_of_freedom
    nodes = initial_nodes(probed(process), end, process.nonsmooth, nats=SMOOTH_NATS)
    added = [nodes, more, end * np.array([0.25, 0.5, 0.75])]  # four elements at least
    beside_zero = [length for energy, length in fine if energy == 0.0]
    if n > 2:
        # Of degree k the first element gives k + 2 times as many digits as its share of the scale.
        scale = min([process.energy_scale, end, *(n * length / FAST for length in beside_zero)])
        first = 10.0 ** (-16.0 / (first_degree(degree - 1, n) + 2)) * scale
        # ln T ~ (n − 1) ln H.
        ratio = min(math.exp(SMOOTH_NATS / (n - 1)), GROWTH if beside_zero else np.inf)
        if first < 0.5 * nodes[1]:
            steps = int(math.log(end / first) / math.log(ratio))
            added.append(first * ratio ** np.arange(steps + 1.0))
        fine = tuple(x for x in fine if x[0] > 0.0)
    gaps = np.diff(nodes)
    for energy, length in fine:
        lengths = length * GROWTH ** np.arange(
            1.0 + max(math.log(end / length), 0.0) / math.log(GROWTH)
        )
        ends = lengths.cumsum()
        added.append(np.array([energy]))
        for side in (1.0, -1.0):
            within = np.searchsorted(nodes, energy + side * (ends - 0.5 * lengths)) - 1
            shorter = lengths < gaps[np.clip(within, 0, gaps.size - 1)]
            added.append(energy + side * ends[shorter])
    nodes = np.unique(np.concatenate(added))
    nodes = nodes[(nodes >= 0.0) & (nodes <= end)]
    kept = np.isin(nodes, [0.0, end, *process.nonsmooth, *(energy for energy, _ in fine)])
    gaps = np.diff(nodes)
    close = gaps < SAME * np.maximum(np.append(gaps[1:], 0.0), np.append(0.0, gaps[:-1]))
    # Of two nodes that are nearly the same the right one is left out, or else the left one.
    right, left = close & ~kept[1:], close & kept[1:] & ~kept[:-1]
    return np.asarray(nodes[~(np.append(False, right) | np.append(left, False))])
