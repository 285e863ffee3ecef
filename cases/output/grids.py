"""Common grids of densities: for pictures, tables and fields."""

from collections.abc import Iterable

import numpy as np

from fpk.density import AnyDensity, Array

POINTS = {1: 401, 2: 101}
"""Points an axis of a grid, by the number of axes."""

CUT = 1e-9
"""Share of the largest value below which a density no longer widens the grid."""

COARSE = {1: 200, 2: 60}
"""Cells an axis on which the extent of a density is measured, by the number of axes."""


def common_grid(
    densities: Iterable[AnyDensity], *, cut: float = CUT, count: int | None = None
) -> tuple[Array, ...]:
    """Return one ascending array per axis: where any density exceeds ``cut`` of its largest.

    ``count`` points an axis; None: as many as in ``POINTS``.
    """
    reach = np.array([_reach(density, cut) for density in densities])
    count = count or POINTS[reach.shape[1]]
    ends = zip(reach[..., 0].min(axis=0), reach[..., 1].max(axis=0), strict=True)
    return tuple(np.linspace(low, high, count) for low, high in ends)


def _reach(density: AnyDensity, cut: float) -> list[tuple[float, float]]:
    """Per axis, the interval in which the density exceeds ``cut`` of its largest value."""
    cells = COARSE[len(density.panels)]
    edges = [np.linspace(nodes[0], nodes[-1], cells + 1) for nodes in density.panels]
    values = density(*np.ix_(*(0.5 * (e[1:] + e[:-1]) for e in edges)))
    above = np.nonzero(values > cut * values.max())
    return [(e[i.min()], e[i.max() + 1]) for e, i in zip(edges, above, strict=True)]
