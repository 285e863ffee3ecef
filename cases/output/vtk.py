"""Densities as VTK files (.vtu, .pvd) that open in ParaView: quadratic cells, errors stated."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

import meshio
import numpy as np
from numpy.typing import NDArray

from cases.comparison.run import CurveOutcome, Outcome
from cases.output.files import write_by
from cases.output.grids import common_grid, values_on
from cases.output.records import UNITS, program_version
from cases.scene.errors import BadInput
from fpk.density import AnyDensity, Array
from fpk.observable import Observable, observable_name

SUBDIVISION = 1e-5
"""Largest error of the quadratic cells between their nodes, relative to the largest density."""

MOST_CELLS = {1: 20_000, 2: 60_000}
"""Cells at which refinement ends; the error that is left is stated in any case."""

PROBES = (0.25, 0.75)
"""Where in a cell its interpolant is held against the density: halfway between its nodes."""


@dataclass(frozen=True)
class Field:
    """One observable of one curve on quadratic cells: ``nodes`` per axis, values at every node.

    ``points`` maps names to arrays over the nodes, ``subdivision`` is the largest difference of
    interpolant and density at the probes, in units of the density.
    """

    nodes: tuple[Array, ...]
    points: Mapping[str, Array]
    subdivision: float

    @property
    def largest(self) -> float:
        """The largest density."""
        return float(self.points["density"].max())


def write_vtu(outcome: Outcome, path: Path) -> list[Path]:
    """Write the first observable of the scene's own system as a grid of quadratic cells."""
    curve, observable = outcome.curves[0], outcome.scene.observables[0]
    if not curve.densities(observable):
        reasons = [r.reason for r in curve.refusals if observable_name(observable) in r.observables]
        why = f": {reasons[0]}" if reasons else ""
        raise BadInput(f"{outcome.scene.name}: no theory gives {observable_name(observable)}{why}")
    _write(outcome, curve, observable, path)
    return [path]


def write_pvd(outcome: Outcome, path: Path) -> list[Path]:
    """Write every observable and curve as a ``.vtu`` beside ``path``, and the collection of them.

    The curves of ``[vary]`` are the collection's time steps, the observables its parts.
    """
    root = ElementTree.Element("VTKFile", type="Collection", version="0.1")
    collection = ElementTree.SubElement(root, "Collection")
    written = []
    for step, curve in enumerate(outcome.curves):
        for part, observable in enumerate(outcome.scene.observables):
            if not curve.densities(observable):
                continue
            name = observable_name(observable).replace(",", "_")
            file = path.with_name(f"{path.stem}_{name}_{step}.vtu")
            _write(outcome, curve, observable, file)
            written.append(file)
            entry = {"timestep": str(step), "part": str(part), "file": file.name}
            ElementTree.SubElement(collection, "DataSet", {**entry, "name": name})
    write_by(path, ElementTree.ElementTree(root).write)
    return [path, *written]


def field_of(densities: Mapping[str, AnyDensity]) -> Field:
    """Return the densities on cells that follow the first one's panels, refined where it bends.

    ``density`` is the first; every route has its own array, the error it states, and the
    difference of the first from it.
    """
    first, *others = densities
    nodes = _ends(densities)
    while True:
        values = [_values(densities[first], nodes)]
        misses = _misses(densities[first], nodes, values[0])
        largest = max(float(m.max()) for m in misses)
        halves = tuple(n[::2] for n in nodes)
        allowed = SUBDIVISION * float(values[0].max())
        finer = tuple(_split(h, m > allowed) for h, m in zip(halves, misses, strict=True))
        cells = int(np.prod([f.size // 2 for f in finer]))
        if largest <= allowed or cells > MOST_CELLS[len(nodes)]:
            break
        nodes = finer
    mesh = np.meshgrid(*nodes, indexing="ij")
    points: dict[str, Array] = {}
    for route, density in densities.items():
        name = route.replace("/", " ")
        points[name], points[f"error of {name}"] = values_on(density, *mesh)
    for route in others:
        name = f"{first} - {route}".replace("/", " ")
        points[name] = points[first.replace("/", " ")] - points[route.replace("/", " ")]
    return Field(nodes, {"density": points[first.replace("/", " ")], **points}, largest)


def _write(outcome: Outcome, curve: CurveOutcome, observable: Observable, path: Path) -> None:
    densities = curve.densities(observable)
    # A theory first: the differences from it then show what it leaves out.
    routes = sorted(densities, key=lambda r: (r.sampled, r.solves != "averaged"))
    field = field_of({route.label: densities[route] for route in routes})
    scene = outcome.scene
    words = {
        "scene": scene.name,
        "title": scene.title,
        "source": scene.source,
        "curve": curve.label,
        "observable": observable_name(observable),
        "axes": ", ".join(map(str, observable)),
        "quantity": f"probability density of {observable_name(observable)}",
        "units": UNITS,
        "first route": routes[0].label,
        "scene file": scene.text,
        "program": f"vibro-fpk {program_version()}",
    }
    numbers = {"subdivision error": field.subdivision, "largest density": field.largest}

    def write(temporary: Path) -> None:
        meshio.vtu.write(temporary, _mesh(field))
        _add_field_data(temporary, words, numbers)

    write_by(path, write)


def _mesh(field: Field) -> meshio.Mesh:
    """The nodes as points in the plane (a line for one axis) and the quadratic cells on them."""
    mesh = np.meshgrid(*field.nodes, indexing="ij")
    axes = [m.ravel() for m in mesh]
    points = np.column_stack([*axes, *(np.zeros(axes[0].size) for _ in range(3 - len(axes)))])
    index = np.arange(axes[0].size).reshape(mesh[0].shape)
    data = {name: np.ascontiguousarray(v).ravel() for name, v in field.points.items()}
    if len(field.nodes) == 1:
        cells = ("line3", np.column_stack([index[:-1:2], index[2::2], index[1::2]]))
    else:
        # Corners counter-clockwise, then the middles of the sides, then the centre.
        a, b, m = slice(None, -1, 2), slice(2, None, 2), slice(1, None, 2)
        order = ((a, a), (b, a), (b, b), (a, b), (m, a), (b, m), (m, b), (a, m), (m, m))
        cells = ("quad9", np.column_stack([index[place].ravel() for place in order]))
    return meshio.Mesh(points, [cells], point_data=data)


def _add_field_data(path: Path, words: Mapping[str, str], numbers: Mapping[str, float]) -> None:
    """Add field data, which meshio does not write: texts as VTK has them, zero-ended codes."""
    tree = ElementTree.parse(path)
    grid = tree.getroot().find("UnstructuredGrid")
    assert grid is not None
    block = ElementTree.Element("FieldData")
    for name, text in words.items():
        codes = " ".join(str(byte) for byte in [*text.encode(), 0])
        array = ElementTree.SubElement(
            block, "DataArray", type="String", Name=name, NumberOfTuples="1", format="ascii"
        )
        array.text = codes
    for name, number in numbers.items():
        array = ElementTree.SubElement(
            block, "DataArray", type="Float64", Name=name, NumberOfTuples="1", format="ascii"
        )
        array.text = repr(number)
    grid.insert(0, block)
    tree.write(path, xml_declaration=True, encoding="utf-8")


def _ends(densities: Mapping[str, AnyDensity]) -> tuple[Array, ...]:
    """The first density's panels where any density counts, as cells with a node in the middle."""
    first = next(iter(densities.values()))
    ends = []
    for grid, panels in zip(common_grid(densities.values()), first.panels, strict=True):
        within = panels[(panels > grid[0]) & (panels < grid[-1])]
        ends.append(_quadratic(np.unique(np.concatenate([grid[[0, -1]], within]))))
    return tuple(ends)


def _quadratic(ends: Array) -> Array:
    """The ends of cells and their middles."""
    nodes = np.empty(2 * ends.size - 1)
    nodes[::2], nodes[1::2] = ends, 0.5 * (ends[1:] + ends[:-1])
    return nodes


def _split(ends: Array, bad: NDArray[np.bool_]) -> Array:
    """The nodes after every cell marked ``bad`` was halved."""
    middles = 0.5 * (ends[1:] + ends[:-1])
    return _quadratic(np.sort(np.concatenate([ends, middles[bad]])))


def _values(density: AnyDensity, nodes: Sequence[Array]) -> Array:
    return values_on(density, *np.meshgrid(*nodes, indexing="ij"))[0]


def _misses(density: AnyDensity, nodes: tuple[Array, ...], values: Array) -> list[Array]:
    """Per axis and cell, the largest |interpolant − density| at the probes along that axis."""
    misses = []
    for axis, x in enumerate(nodes):
        left, width = x[:-1:2], x[2::2] - x[:-1:2]
        low, middle, high = (
            np.moveaxis(values, axis, 0)[s]
            for s in (slice(None, -1, 2), slice(1, None, 2), slice(2, None, 2))
        )
        worst = np.zeros(left.size)
        for t in PROBES:
            weights = (2 * (t - 0.5) * (t - 1), 4 * t * (1 - t), 2 * t * (t - 0.5))
            guess = weights[0] * low + weights[1] * middle + weights[2] * high
            probe = tuple(left + t * width if a == axis else n for a, n in enumerate(nodes))
            truth = np.moveaxis(_values(density, probe), axis, 0)
            off = np.abs(guess - truth).reshape(left.size, -1).max(axis=1)
            worst = np.maximum(worst, off)
        misses.append(worst)
    return misses
