"""Meshes of one energy: where they end, and how they follow the coefficients."""

import math
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.special import lambertw

from fpk.probe import Probe

Array = NDArray[np.float64]

NATS_PER_ELEMENT = 3.0
"""Fall of ln(p/T) over one element: exp(−3 t) is met by degree 10 to 1e-11."""
EACH = 0.03
"""Share of the tolerance that a first mesh grants each of its elements, ten or so."""
UNDER = 1e-3
"""Largest error of an element relative to the density at its far end."""
SPREAD = 20.0
"""Largest ratio of the ends of an element that begins where contact does."""
GRADING = 0.15
"""Ratio of neighbouring lengths towards a point where smoothness is lost."""
GRADED_LAYERS = 5
DEEP_LAYERS = 14
"""Layers down to 3e-12 of the next element: beside a stiff stop and a small clearance T itself has
layers as thin as that."""


def initial_nodes(
    probe: Probe,
    end: float,
    nonsmooth: tuple[float, ...],
    *,
    nats: Array | float = NATS_PER_ELEMENT,
    layers: int = GRADED_LAYERS,
) -> Array:
    """Return nodes from 0 to ``end``: on the nonsmooth energies, dense where p/T varies fast.

    ``nats`` is the fall of ln(p/T) over one element, at the energies of the probe. Geometric
    ``layers`` lie above every nonsmooth energy (below it, the density is smooth up to it). Where
    that is tiny beside its element, T still changes with H/H_c: elements grow from there.
    """
    ends = np.array([0.0, *(H for H in nonsmooth if 0.0 < H < end), end])
    nodes: Array = _placed(probe.energy, probe.roughness / nats, ends)
    wide = [H for H in ends[1:-1] if nodes[np.searchsorted(nodes, H) + 1] > SPREAD * H]
    if wide:
        steps = np.concatenate(
            [H * SPREAD ** np.arange(1.0, np.log(end / H) / math.log(SPREAD)) for H in wide]
        )
        nodes = np.unique(np.concatenate([nodes, steps]))
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


def nats_for(probe: Probe, degree: int, tol: float) -> Array:
    """Return how far ln(p/T) may fall over one element of ``degree``, at the probe's energies.

    Over n nats the best polynomial misses e^(−x) by n^(p+1)/((p+1)! 2^(2p+1)) of its largest value
    (Chebyshev), and an element's error counts by its share of the mass, which is that of its start
    at the most. Each element gets ``EACH`` of ``tol``, but in the tail no more than what keeps the
    density positive, by far.
    """
    log_unit, log_steepest = _miss(degree)
    depth = probe.log_mass - probe.log_mass.max()
    depth[: int(np.argmax(depth))] = 0.0
    log_nats = (log_unit + math.log(EACH * tol) - depth) / (degree + 1)
    return np.asarray(np.exp(np.minimum(log_nats, log_steepest)))


@lru_cache
def _miss(degree: int) -> tuple[float, float]:
    """ln of (p+1)! 2^(2p+1), and of the n where an element's error is ``UNDER`` of e^(−n)."""
    p = degree + 1
    log_unit = math.lgamma(p + 1) + (2 * p - 1) * math.log(2.0)
    # p ln n + n = log_unit + ln UNDER
    steepest = p * lambertw(math.exp((log_unit + math.log(UNDER)) / p) / p).real
    return log_unit, math.log(steepest)


def with_layers(nodes: Array, nonsmooth: tuple[float, ...], *, count: int = GRADED_LAYERS) -> Array:
    """Return the nodes and geometric layers above those that are nonsmooth energies."""
    layers = GRADING ** np.arange(1.0, count + 1.0)
    for H in nonsmooth:
        if count and nodes[-1] > H:
            gap = nodes[np.searchsorted(nodes, H, side="right")] - H
            nodes = np.unique(np.concatenate([nodes, H + gap * layers]))
    return nodes


def split_points(left: Array, right: Array, special: Array) -> Array:
    """Return where to cut elements in two: towards a special point they begin at, else half-way."""
    share = np.where(np.isin(left, special), GRADING, 0.5)
    return left + share * (right - left)
