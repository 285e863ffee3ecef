"""Densities as VTK files (.vtu, .pvd) that open in ParaView: quadratic cells, errors stated."""

from collections.abc import Mapping
from pathlib import Path
from xml.etree import ElementTree
from xml.sax.saxutils import quoteattr

import meshio
import numpy as np

from cases.compare.answers import Answers
from cases.compare.stationary import Outcome
from cases.scene.units import attribute, in_brackets
from cases.show.fields import attributes_of, curve_numbers, variable_name
from cases.show.files import write_by
from fpk.answer.dynamics import Transient
from fpk.answer.names import Observable, observable_name
from fpk.answer.quantities import field_of
from fpk.numeric.arrays import Array
from fpk.system.system import System


def write_vtu(outcome: Outcome, path: Path) -> list[Path]:
    """Write the densities of the first observable of the scene's own system, by every route.

    The grid has quadratic cells. Beside ``path``, ``…_stops.vtu`` has the stops of the observed
    displacements if there are any. Returns the paths written; raises as ``write_by``. ::

        outcome = run_scene(fpk.load("fig7"), [NonIntegrable("closed-form")])
        write_vtu(outcome, Path("fig7.vtu"))
    """
    return _write(outcome, outcome.curves[0], outcome.scene.observables[0], path)


def write_pvd(outcome: Outcome, path: Path) -> list[Path]:
    """Write a collection over the curves for every observable; the varied number stands for time.

    The collection is ``path`` itself if the scene has one observable, else ``…_q2.pvd`` and so on
    beside it. Each has a ``.vtu`` for each curve, the numbers ascending, and the stops as a second
    part. Curves and observables without a density are left out. Returns the paths written; raises
    as ``write_by``.
    """
    written: list[Path] = []
    numbers = curve_numbers(outcome)
    for observable in outcome.scene.observables:
        entries: dict[Path, Mapping[str, str]] = {}
        name = variable_name(observable)
        for k in np.argsort(numbers):
            curve = outcome.curves[k]
            if not curve.densities(observable):
                continue
            file = path.with_name(f"{path.stem}_{name}_{k}.vtu")
            for part, each in enumerate(_write(outcome, curve, observable, file)):
                entry = {"timestep": repr(float(numbers[k])), "part": str(part)}
                entries[each] = entry | {"name": "stops" if part else name}
        if entries:
            alone = len(outcome.scene.observables) == 1
            own = path if alone else path.with_name(f"{path.stem}_{name}{path.suffix}")
            written += _write_collection(own, entries)
    return written


def write_time_pvd(outcome: Outcome, folder: Path) -> list[Path]:
    """Write each transient k = 1, 2, … of the scene's own system as a collection over time.

    ``transient_k.pvd`` lists a ``.vtu`` for each time with the densities and errors by every route
    on lines between the points; none for a transient without an answer. Returns the paths written;
    raises as ``write_by``.
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
            words: dict[str, str | float] = {"quantity": replies.question.name, "time": time}
            _write_mesh(outcome, meshio.Mesh(points, lines, point_data=data), words, file)
            entries[file] = {"timestep": repr(time), "part": "0"}
        written += _write_collection(folder / f"transient_{k}.pvd", entries)
    return written


def _write_collection(path: Path, entries: Mapping[Path, Mapping[str, str]]) -> list[Path]:
    """Write the collection ``path`` of files beside it with their attributes; return all paths."""
    root = ElementTree.Element("VTKFile", type="Collection", version="0.1")
    collection = ElementTree.SubElement(root, "Collection")
    for file, entry in entries.items():
        ElementTree.SubElement(collection, "DataSet", {**entry, "file": file.name})
    write_by(path, ElementTree.ElementTree(root).write)
    return [path, *entries]


def _write(outcome: Outcome, curve: Answers, observable: Observable, path: Path) -> list[Path]:
    # A theory first: the differences from it then show what it leaves out.
    densities = sorted(
        curve.densities(observable).items(), key=lambda a: (a[0].sampled, a[0].solves != "averaged")
    )
    mesh, subdivision = field_of({route.label: density for route, density in densities})
    name, units = observable_name(observable), outcome.scene.units
    largest = float(mesh.point_data["density"].max())
    data: dict[str, str | float] = {
        "curve": curve.label,
        "observable": name,
        "axes": ", ".join(f"{c}{in_brackets(units.coordinate(c))}" for c in observable),
        "quantity": f"probability density of {name}",
        "unit of density": attribute(units.density(observable)),
        "first route": densities[0][0].label,
        "subdivision error": subdivision,
        "largest density": largest,
    }
    _write_mesh(outcome, mesh, data, path)
    stops = stop_planes(curve.system, observable, mesh.points, largest)
    if stops is None:
        return [path]
    beside = path.with_name(f"{path.stem}_stops.vtu")
    _write_mesh(outcome, stops, {"quantity": f"stops beside {name}"}, beside)
    return [path, beside]


def stop_planes(
    system: System, observable: Observable, points: Array, height: float
) -> meshio.Mesh | None:
    """Return the stops of the displacements of ``observable`` as planes, None if it has no stop.

    Each is a rectangle from 0 to ``height`` in z, the largest density of a surface z = p. It spans
    the ``points`` (points, 3) of the field along the other coordinate; over a density of one
    coordinate it is as wide as high. The cells have the number of the ``mass``, from 1.
    """
    ends = np.array([points.min(axis=0), points.max(axis=0)])
    if len(observable) == 1:
        ends[:, 1] = -0.5 * height, 0.5 * height
    corners, masses = [], []
    for axis, coordinate in enumerate(observable):
        for stop in system.stops if coordinate.kind == "q" else ():
            if stop.index != coordinate.row:
                continue
            for along, z in ((0, 0.0), (1, 0.0), (1, height), (0, height)):
                corner = np.array([*ends[along, :2], z])
                corner[axis] = stop.sign * stop.clearance
                corners.append(corner)
            masses.append(float(stop.mass))
    if not masses:
        return None
    cells = np.arange(len(corners)).reshape(-1, 4)
    return meshio.Mesh(np.array(corners), [("quad", cells)], cell_data={"mass": [np.array(masses)]})


def _write_mesh(
    outcome: Outcome, mesh: meshio.Mesh, data: Mapping[str, str | float], path: Path
) -> None:
    """Write ``mesh``, and ``attributes_of`` the scene and ``data`` as field data, texts as codes
    that end with 0."""
    root, origin = ElementTree.Element("FieldData"), attributes_of(outcome.scene)
    for name, value in {**{k.replace("_", " "): v for k, v in origin.items()}, **data}.items():
        kind = "Float64" if isinstance(value, float) else "String"
        entry = {"type": kind, "Name": name, "NumberOfTuples": "1", "format": "ascii"}
        codes = [value] if isinstance(value, float) else [*value.encode(), 0]
        ElementTree.SubElement(root, "DataArray", entry).text = " ".join(map(repr, codes))
    fields = ElementTree.tostring(root, encoding="unicode")

    def write(temporary: Path) -> None:
        meshio.vtu.write(temporary, mesh)
        # meshio writes no field data, and no array as the active one.
        text, head = temporary.read_text(encoding="utf-8"), "<UnstructuredGrid>"
        text = text.replace(head, head + fields, 1)
        for kind, arrays in (("PointData", mesh.point_data), ("CellData", mesh.cell_data)):
            active = f"<{kind} Scalars={quoteattr(next(iter(arrays), ''))}>"
            text = text.replace(f"<{kind}>", active, 1)
        temporary.write_text(text, encoding="utf-8")

    write_by(path, write)
