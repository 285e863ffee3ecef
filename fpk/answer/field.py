"""Densities as fields on quadratic cells that follow them, for meshio and pyvista."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from fpk.numeric.arrays import Array, Flags

SUBDIVISION = 1e-5
"""Largest error of the quadratic cells between their nodes, relative to the largest density."""
CUT = 1e-6
"""Share of its largest value down to which the first density lies in the box of the field."""
MOST_CELLS = 60_000
"""Cells at which refinement ends; the error that is left is stated in any case."""


def field_of(densities: Mapping[str, Any]) -> tuple[Any, float]:
    """Return the densities by route as a mesh of meshio, and the error of its cells.

    The mesh is the smallest box with all points at which the first density is at least ``CUT`` of
    its largest value, refined where it bends. In ``point_data`` are ``density``, the first, and
    ``log10 density``, NaN where it is not positive; of every route its density, the error it
    states, and the difference of the first from it. The error of the cells is the largest
    difference of interpolant and density at the probes, in units of the density.
    """
    import meshio  # noqa: PLC0415  (0.1 s)

    named = {route.replace("/", " "): density for route, density in densities.items()}
    (first, density), *_ = named.items()
    box = [panels[[0, -1]] for panels in density.panels]
    for _ in range(2):  # in the support, and again in the box that it gives
        grid = [np.linspace(a, b, 401 if len(box) == 1 else 101) for a, b in box]
        values = density(*np.ix_(*grid))
        inside = np.nonzero(values >= CUT * values.max())
        box = [
            x[np.clip([i.min() - 1, i.max() + 1], 0, x.size - 1)]
            for x, i in zip(grid, inside, strict=True)
        ]
    ends = [
        np.union1d(np.clip(panels, grid[0], grid[-1]), grid)
        for grid, panels in zip(box, density.panels, strict=True)
    ]
    cells, subdivision, allowed = 0, np.inf, 0.0
    while subdivision > allowed and cells <= MOST_CELLS:
        nodes = tuple(_with_middles(e) for e in ends)
        values = density(*np.ix_(*nodes))
        allowed, misses = SUBDIVISION * float(values.max()), []
        for axis, x in enumerate(nodes):  # the largest miss of each cell along the axis
            between = [0.5 * (x[1:] + x[:-1]) if n is x else n for n in nodes]
            truth = np.moveaxis(density(*np.ix_(*between)), axis, 0)
            along = np.moveaxis(values, axis, 0)
            low, middle, high = along[:-1:2], along[1::2], along[2::2]
            # The parabola through three nodes at a quarter and at three quarters of the cell.
            quarters = [0.125 * (3 * a + 6 * middle - b) for a, b in ((low, high), (high, low))]
            off = np.abs(np.stack(quarters, axis=1).reshape(truth.shape) - truth)
            misses.append(off.reshape(low.shape[0], -1).max(axis=1))
        subdivision = max(float(m.max()) for m in misses)
        ends = [_with_middles(e, only=miss > allowed) for e, miss in zip(ends, misses, strict=True)]
        cells = int(np.prod([e.size - 1 for e in ends]))
    mesh = np.meshgrid(*nodes, indexing="ij")
    data: dict[str, Array] = {}
    for name, other in named.items():
        data[name], data[f"error of {name}"] = other.at(*mesh)
    p = data[first]
    decades = np.log10(p, out=np.full_like(p, np.nan), where=p > 0.0)
    data = {"density": p, "log10 density": decades, **data}
    data |= {f"{first} - {k}": p - data[k] for k in named if k != first}
    points = np.zeros((p.size, 3))
    points[:, : len(mesh)] = np.column_stack([x.ravel() for x in mesh])
    a, b, m = slice(None, -1, 2), slice(2, None, 2), slice(1, None, 2)
    # Corners counter-clockwise, then the middles of the sides, then the centre.
    square = (a, a), (b, a), (b, b), (a, b), (m, a), (b, m), (m, b), (a, m), (m, m)
    kind, order = ("line3", ((a,), (b,), (m,))) if len(mesh) == 1 else ("quad9", square)
    index = np.arange(p.size).reshape(p.shape)
    blocks = [(kind, np.column_stack([index[place].ravel() for place in order]))]
    return meshio.Mesh(points, blocks, {k: v.ravel() for k, v in data.items()}), subdivision


def _with_middles(ends: Array, only: Flags | None = None) -> Array:
    """The ends of cells with the middles of all of them, or of those in ``only``."""
    middles = 0.5 * (ends[1:] + ends[:-1])
    return np.sort(np.concatenate([ends, middles if only is None else middles[only]]))
