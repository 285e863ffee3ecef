"""Densities on common grids: for pictures, tables and fields."""

from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from fpk.density import AnyDensity, Array, SampledDensity

GRID_1D, GRID_2D = 401, 101
"""Points an axis of a grid over one and over two coordinates."""

CUT = 1e-9
"""Share of the largest value below which a density no longer widens the grid."""

COARSE_1D, COARSE_2D = 200, 60
"""Cells an axis on which the extent of a density is measured."""


def common_grid(
    densities: Iterable[AnyDensity], *, cut: float = CUT, count: int | None = None
) -> tuple[Array, ...]:
    """Return one ascending array per axis: where any density exceeds ``cut`` of its largest.

    ``count`` points an axis; None: ``GRID_1D`` or ``GRID_2D``.
    """
    ends = [_reach(d, cut) for d in densities]
    count = count or (GRID_1D if len(ends[0]) == 1 else GRID_2D)
    return tuple(
        np.linspace(min(e[axis][0] for e in ends), max(e[axis][1] for e in ends), count)
        for axis in range(len(ends[0]))
    )


def values_on(density: AnyDensity, *points: Array) -> tuple[Array, Array]:
    """Return density and error at ``points``; outside the support the density is zero.

    The error is zero, too, but for a histogram: no sample lies there, of so many.
    """
    inside, clipped = _clipped(density, points)
    value, error = density.at(*clipped)
    beyond = density.one_sample if isinstance(density, SampledDensity) else 0.0
    return np.where(inside, value, 0.0), np.where(inside, error, beyond)


def value_on(density: AnyDensity, *points: Array) -> Array:
    """Return the density alone, which costs less; outside the support it is zero."""
    inside, clipped = _clipped(density, points)
    return np.where(inside, density(*clipped), 0.0)


def _clipped(density: AnyDensity, points: Sequence[Array]) -> tuple[NDArray[np.bool_], list[Array]]:
    """Which points lie in the support, and the points moved into it."""
    ends = [(nodes[0], nodes[-1]) for nodes in density.panels]
    within = [(x >= low) & (x <= high) for x, (low, high) in zip(points, ends, strict=True)]
    clipped = [np.clip(x, *interval) for x, interval in zip(points, ends, strict=True)]
    return np.logical_and.reduce(np.broadcast_arrays(*within)), clipped


def _reach(density: AnyDensity, cut: float) -> list[tuple[float, float]]:
    """Per axis, the interval in which the density exceeds ``cut`` of its largest value."""
    coarse = COARSE_1D if len(density.panels) == 1 else COARSE_2D
    edges = [np.linspace(nodes[0], nodes[-1], coarse + 1) for nodes in density.panels]
    middles = [0.5 * (e[1:] + e[:-1]) for e in edges]
    value = density(*np.meshgrid(*middles, indexing="ij"))
    counts = value > cut * value.max()
    reach = []
    for axis, e in enumerate(edges):
        others = tuple(a for a in range(counts.ndim) if a != axis)
        cells = np.flatnonzero(counts.any(axis=others))
        reach.append((float(e[cells[0]]), float(e[cells[-1] + 1])))
    return reach
