"""Densities as VTK files (.vtu, .pvd) that open in ParaView: quadratic cells, errors stated."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from xml.etree import ElementTree

import meshio
import numpy as np

from cases.comparison.answers import Answers, Outcome
from cases.output.fields import attributes_of, common_grid
from cases.output.files import write_by
from cases.output.records import UNITS
from fpk.arrays import Array, Flags
from fpk.density import AnyDensity
from fpk.evolution import Transient
from fpk.observable import Observable, observable_name

SUBDIVISION = 1e-5
"""Largest error of the quadratic cells between their nodes, relative to the largest density."""

MOST_CELLS = {1: 20_000, 2: 60_000}
"""Cells at which refinement ends; the error that is left is stated in any case."""


def write_vtu(outcome: Outcome, path: Path) -> list[Path]:
    """Write the first observable of the scene's own system as a grid of quadratic cells."""
    _write(outcome, outcome.curves[0], outcome.scene.observables[0], path)
    return [path]


def write_pvd(outcome: Outcome, path: Path) -> list[Path]:
    """Write every observable and curve as a ``.vtu`` beside ``path``, and the collection of them.

    The curves of ``[vary]`` are the collection's time steps, the observables its parts.
    """
    entries: dict[Path, Mapping[str, str]] = {}
    for step, curve in enumerate(outcome.curves):
        for part, observable in enumerate(outcome.scene.observables):
            if not curve.densities(observable):
                continue
            name = observable_name(observable).replace(",", "_")
            file = path.with_name(f"{path.stem}_{name}_{step}.vtu")
            _write(outcome, curve, observable, file)
            entries[file] = {"timestep": str(step), "part": str(part), "name": name}
    return _write_collection(path, entries)


def write_time_pvd(outcome: Outcome, folder: Path) -> list[Path]:
    """Write every transient of the scene's own system as a collection over time, and its files.

    One ``transient_k.pvd`` with a ``.vtu`` for each time, on the same lines between the points.
    """
    written: list[Path] = []
    for k, replies in enumerate(outcome.curves[0].transients, start=1):
        if not replies.given or replies.points is None:
            continue
        points = np.column_stack([replies.points, np.zeros((replies.points.size, 2))])
        index = np.arange(replies.points.size)
        lines = [("line", np.column_stack([index[:-1], index[1:]]))]
        entries: dict[Path, Mapping[str, str]] = {}
        for j, time in enumerate(replies.question.times):
            data: dict[str, Array] = {}
            for g in replies.given:
                assert isinstance(g.answer, Transient)
                name = g.route.label.replace("/", " ")
                data[name] = g.answer.values[j]
                data[f"error of {name}"] = g.answer.errors[j]
            file = folder / f"transient_{k}_{j}.vtu"
            words: dict[str, str | float] = {**_origin(outcome)}
            words |= {"quantity": replies.question.name, "time": time}
            _write_mesh(meshio.Mesh(points, lines, point_data=data), words, file)
            entries[file] = {"timestep": repr(time), "part": "0"}
        written += _write_collection(folder / f"transient_{k}.pvd", entries)
    return written


def _write_collection(path: Path, entries: Mapping[Path, Mapping[str, str]]) -> list[Path]:
    """Write the collection of the files beside it, each with its ``entries``; return all paths."""
    root = ElementTree.Element("VTKFile", type="Collection", version="0.1")
    collection = ElementTree.SubElement(root, "Collection")
    for file, entry in entries.items():
        ElementTree.SubElement(collection, "DataSet", {**entry, "file": file.name})
    write_by(path, ElementTree.ElementTree(root).write)
    return [path, *entries]


def field_of(densities: Mapping[str, AnyDensity]) -> tuple[meshio.Mesh, float]:
    """Return the densities on cells that follow the first one's panels, refined where it bends.

    In ``point_data`` the array ``density`` is the first; every route has its own array, the error
    it states, and the difference of the first from it. The number is the largest difference of
    interpolant and density at the probes, in units of the density.
    """
    named = {route.replace("/", " "): density for route, density in densities.items()}
    (first, density), *_ = named.items()
    ends = [
        np.union1d(np.clip(panels, grid[0], grid[-1]), grid[[0, -1]])
        for grid, panels in zip(common_grid(named.values()), density.panels, strict=True)
    ]
    cells, subdivision, allowed = 0, np.inf, 0.0
    while subdivision > allowed and cells <= MOST_CELLS[len(ends)]:
        nodes = tuple(_with_middles(e) for e in ends)
        values = density(*np.ix_(*nodes))
        misses = [_misses(density, nodes, values, axis) for axis in range(len(nodes))]
        subdivision = max(float(m.max()) for m in misses)
        allowed = SUBDIVISION * float(values.max())
        ends = [_with_middles(e, only=miss > allowed) for e, miss in zip(ends, misses, strict=True)]
        cells = int(np.prod([e.size - 1 for e in ends]))
    grid = np.meshgrid(*nodes, indexing="ij")
    data: dict[str, Array] = {}
    for name, other in named.items():
        data[name], data[f"error of {name}"] = other.at(*grid)
    differences = {f"{first} - {k}": data[first] - data[k] for k in named if k != first}
    return _mesh(grid, {"density": data[first], **data, **differences}), subdivision


def _mesh(grid: Sequence[Array], data: Mapping[str, Array]) -> meshio.Mesh:
    """The grid as points in the plane (a line for one axis) and the quadratic cells on them."""
    points = np.zeros((grid[0].size, 3))
    points[:, : len(grid)] = np.column_stack([x.ravel() for x in grid])
    a, b, m = slice(None, -1, 2), slice(2, None, 2), slice(1, None, 2)
    line = (a,), (b,), (m,)
    # Corners counter-clockwise, then the middles of the sides, then the centre.
    square = (a, a), (b, a), (b, b), (a, b), (m, a), (b, m), (m, b), (a, m), (m, m)
    kind, order = ("line3", line) if len(grid) == 1 else ("quad9", square)
    index = np.arange(grid[0].size).reshape(grid[0].shape)
    cells = np.column_stack([index[place].ravel() for place in order])
    return meshio.Mesh(points, [(kind, cells)], point_data={k: v.ravel() for k, v in data.items()})


def _write(outcome: Outcome, curve: Answers, observable: Observable, path: Path) -> None:
    # A theory first: the differences from it then show what it leaves out.
    densities = sorted(
        curve.densities(observable).items(), key=lambda a: (a[0].sampled, a[0].solves != "averaged")
    )
    mesh, subdivision = field_of({route.label: density for route, density in densities})
    name = observable_name(observable)
    data: dict[str, str | float] = {
        **_origin(outcome),
        "curve": curve.label,
        "observable": name,
        "axes": ", ".join(map(str, observable)),
        "quantity": f"probability density of {name}",
        "units": UNITS,
        "first route": densities[0][0].label,
        "subdivision error": subdivision,
        "largest density": float(mesh.point_data["density"].max()),
    }
    _write_mesh(mesh, data, path)


def _origin(outcome: Outcome) -> dict[str, str]:
    return {key.replace("_", " "): text for key, text in attributes_of(outcome.scene).items()}


def _write_mesh(mesh: meshio.Mesh, data: Mapping[str, str | float], path: Path) -> None:
    def write(temporary: Path) -> None:
        meshio.vtu.write(temporary, mesh)
        # meshio writes no field data.
        text, head = temporary.read_text(encoding="utf-8"), "<UnstructuredGrid>"
        temporary.write_text(text.replace(head, head + _field_data(data), 1), encoding="utf-8")

    write_by(path, write)


def _field_data(data: Mapping[str, str | float]) -> str:
    """The field data of a file; texts as VTK has them, zero-ended codes."""
    root = ElementTree.Element("FieldData")
    for name, value in data.items():
        kind = "Float64" if isinstance(value, float) else "String"
        entry = {"type": kind, "Name": name, "NumberOfTuples": "1", "format": "ascii"}
        codes = [value] if isinstance(value, float) else [*value.encode(), 0]
        ElementTree.SubElement(root, "DataArray", entry).text = " ".join(map(repr, codes))
    return ElementTree.tostring(root, encoding="unicode")


def _with_middles(ends: Array, only: Flags | None = None) -> Array:
    """The ends of cells with the middles of all of them, or of those in ``only``."""
    middles = 0.5 * (ends[1:] + ends[:-1])
    return np.sort(np.concatenate([ends, middles if only is None else middles[only]]))


def _misses(density: AnyDensity, nodes: Sequence[Array], values: Array, axis: int) -> Array:
    """Per cell along an axis, the largest |interpolant − density| halfway between its nodes."""
    x = nodes[axis]
    between = [0.5 * (x[1:] + x[:-1]) if a == axis else n for a, n in enumerate(nodes)]
    truth = np.moveaxis(density(*np.ix_(*between)), axis, 0)
    along = np.moveaxis(values, axis, 0)
    low, middle, high = along[:-1:2], along[1::2], along[2::2]
    # The parabola through three nodes at a quarter and at three quarters of the cell.
    quarters = [0.125 * (3 * a + 6 * middle - b) for a, b in ((low, high), (high, low))]
    off = np.abs(np.stack(quarters, axis=1).reshape(truth.shape) - truth)
    return np.asarray(off.reshape(low.shape[0], -1).max(axis=1))
