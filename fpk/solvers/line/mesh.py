"""Meshes of one energy: where they end, and how they follow the coefficients."""

import math

import numpy as np

from fpk.numeric.arrays import Array
from fpk.solvers.probe import Probe

NATS = 4.0
"""Fall of ln(p/T) over one element. Where ln(p/T) is linear in H, over n nats a polynomial of
degree p misses e^(−x) by n^(p+1)/((p+1)! 2^(2p+1)) of its largest value (Chebyshev), with the
degree of a tolerance (four more than its digits) 1e-1 to 1e-2 of the tolerance."""
LOG_GROWTH = math.log(1.75)
"""ln of how many times ``NATS`` an element may have where little of the mass is left: over 7
nats p still exceeds its error at the far end (of degree 6 and more), so that it stays positive."""
GRADING = 0.15
"""Ratio of neighbouring lengths towards a point where smoothness is lost."""
GRADED_LAYERS = 6
DEEP_LAYERS = 15
"""Layers down to 3e-12 of the next element: beside a stiff stop and a small clearance T itself has
layers as thin as that."""


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
    energy (below it, the density is smooth up to it). With none elements still grow from there
    where that is tiny beside them, as T changes with H/H_c.
    """
    ends = np.array([0.0, *(H for H in nonsmooth if 0.0 < H < end), end])
    return with_layers(_placed(probe.energy, probe.roughness / nats, ends), nonsmooth, count=layers)


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

    They go from the last node down to the ``count``-th from the node next to H: wherever that is,
    the distance of the ends of an element from H is in the ratio ``GRADING`` or nearer to 1, but
    for the first one.
    """
    for H in nonsmooth:
        if nodes[0] <= H < nodes[-1]:
            reach = float(nodes[-1]) - H
            gap = float(nodes[np.searchsorted(nodes, H, side="right")]) - H
            layers = np.arange(1.0, count + math.log(gap / reach) / math.log(GRADING))
            nodes = np.unique(np.concatenate([nodes, H + reach * GRADING**layers]))
    return nodes


def split_points(left: Array, right: Array, special: Array) -> Array:
    """Return where to cut elements in two: towards a special point they begin at, else half-way."""
    share = np.where(np.isin(left, special), GRADING, 0.5)
    return left + share * (right - left)
