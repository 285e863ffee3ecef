"""Densities on common grids, and these as files: netCDF and comma-separated values."""

import csv
import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from io import BytesIO, StringIO
from pathlib import Path

import h5netcdf
import h5py
import numpy as np

from cases.compare.answers import Answers
from cases.compare.stationary import Outcome
from cases.scene.scene import Scene
from cases.scene.units import CONSISTENT, Units, attribute
from cases.show.digest import method_record
from cases.show.files import write_by, write_text
from cases.show.records import plain, program_version
from cases.show.variables import Part, Variables, by_route, time_variables
from fpk.answer.density import AnyDensity
from fpk.answer.names import Observable, observable_name
from fpk.answer.sampled_density import SampledDensity
from fpk.numeric.arrays import Array

GRID_POINTS = {1: 401, 2: 101}
"""Points on each axis of a common grid, by the number of axes."""

GRID_CUT = 1e-9
"""Share of its largest value below which a density no longer widens the common grid."""

EXTENT_CELLS = {1: 200, 2: 60}
"""Cells on each axis, by the number of axes, at whose middles a density that is a function is
evaluated to measure its extent."""


def write_netcdf(outcome: Outcome, path: Path) -> list[Path]:
    """Write the densities of every observable, curve and route on common grids as netCDF-4.

    ``p_q2`` (curve, route, q2) is the density and ``error_q2`` its error: an estimate of the
    numerical error or one standard error, as ``error_kind_q2`` says; of a pair ``p_q2_p2``. NaN
    stands for a missing answer. ``curve`` is the number that ``[vary]`` varies, ascending, with
    ``curve_label`` beside it. Settings and certificates are JSON in the attribute ``provenance``.
    ``time_variables`` adds answers in time. Returns ``[path]``; raises as ``write_by``. ::

        outcome = run_scene(fpk.load("fig3a"), [Exact(), NonIntegrable()])
        write_netcdf(outcome, Path("fig3a.nc"))
    """
    variables: Variables = {}
    for observable in outcome.scene.observables:
        variables |= density_variables(outcome.curves, observable, outcome.scene.units)
    variables |= time_variables(outcome)
    labels, numbers = [curve.label for curve in outcome.curves], curve_numbers(outcome)
    if variables:
        varied = {"long_name": labels[0].partition(" = ")[0] or "number of the curve"}
        variables["curve"] = ("curve",), np.array(numbers, dtype=float), varied
        variables["curve_label"] = ("curve",), np.array(labels), {"long_name": "label of the curve"}
    order = np.argsort(numbers, kind="stable")
    for name, (dimensions, values, words) in variables.items():
        if dimensions[0] == "curve":
            variables[name] = dimensions, values[order], words
    answers = [
        plain({"curve": curve.label, **method_record(result)})
        for curve in outcome.curves
        for result in curve.results
    ]
    provenance = json.dumps(answers, ensure_ascii=False)
    attributes = {**attributes_of(outcome.scene), "provenance": provenance}
    write_variables(variables, attributes, path)
    return [path]


def attributes_of(scene: Scene) -> dict[str, str]:
    """Return the attributes of a file of results: the scene, its text and units, the program."""
    return {
        "title": scene.title,
        "scene": scene.name,
        "source": scene.source,
        "scene_file": scene.text,
        "units": ", ".join(filter(None, vars(scene.units).values())) or CONSISTENT,
        "program": f"vibro-fpk {program_version()}",
    }


def write_variables(variables: Variables, attributes: Mapping[str, str], path: Path) -> None:
    """Write netCDF-4 with ``variables`` and ``attributes`` of the file; raises as ``write_by``."""
    stream = BytesIO()
    with h5netcdf.File(stream, "w") as file:
        for name, (dimensions, values, words) in variables.items():
            text = values.dtype.kind in "OU"
            kind = h5py.string_dtype() if text else values.dtype
            for dimension, size in zip(dimensions, values.shape, strict=True):
                if dimension not in file.dimensions:
                    file.dimensions[dimension] = size
            data = values.astype(object) if text else values
            file.create_variable(name, dimensions, dtype=kind, data=data).attrs.update(words)
        file.attrs.update(attributes)
    write_by(path, lambda temporary: temporary.write_bytes(stream.getvalue()))


def write_csv(outcome: Outcome, path: Path) -> list[Path]:
    """Write the densities as lines ``curve, observable, route, x, y, density, error``.

    A missing answer has no lines. ``y`` is empty for one coordinate. If the scene names its units,
    ``unit_x, unit_y, unit_density`` follow. Returns ``[path]``; raises as ``write_by``.
    """
    stream = StringIO()
    lines = csv.writer(stream, lineterminator="\n")
    units = outcome.scene.units
    heads = ["unit_x", "unit_y", "unit_density"] if units else []
    lines.writerow(["curve", "observable", "route", "x", "y", "density", "error", *heads])
    for observable in outcome.scene.observables:
        if not (variables := density_variables(outcome.curves, observable, units)):
            continue
        own = [*map(units.coordinate, observable), ""][:2] if units else []
        own += [units.density(observable)] if units else []
        name, key = observable_name(observable), variable_name(observable)
        dimensions, values, _ = variables[f"p_{key}"]
        errors, kinds = variables[f"error_{key}"][1], variables[f"error_kind_{key}"][1]
        curves = [curve.label for curve in outcome.curves]
        routes, *grid = (variables[dimension][1] for dimension in dimensions[1:])
        x, *others = (m.ravel().tolist() for m in np.meshgrid(*grid, indexing="ij"))
        y = others[0] if others else [""] * len(x)
        for i, j in np.argwhere(kinds != ""):
            columns = x, y, values[i, j].ravel().tolist(), errors[i, j].ravel().tolist()
            names = curves[i], name, routes[j]
            lines.writerows([*names, *row, *own] for row in zip(*columns, strict=True))
    write_text(path, stream.getvalue())
    return [path]


WRITERS: dict[str, Callable[[Outcome, Path], list[Path]]] = {
    ".nc": write_netcdf,
    ".csv": write_csv,
}
"""Writers of the densities of a run by the ending of the file; a format of one's own is one entry.

Each returns the paths of the files that it wrote."""


def density_variables(all_of: Sequence[Answers], observable: Observable, units: Units) -> Variables:
    """Return p and its error, (curve, route, x) or (curve, route, x, y), and their coordinates.

    ``write_netcdf`` explains the names. ``all_of`` has the answers of each curve; the grid is
    ``common_grid``. Empty if no route gives the observable.
    """
    answers = {
        (i, route.label): density
        for i, curve in enumerate(all_of)
        for route, density in curve.densities(observable).items()
    }
    if not answers:
        return {}
    grid = common_grid(answers.values())
    mesh = np.meshgrid(*grid, indexing="ij")
    # Each observable has its own grid and routes: a coordinate of another must not realign it.
    name, axes = variable_name(observable), [str(c) for c in observable]
    points = [f"{axis}_of_{name}" if len(axes) == 2 else axis for axis in axes]
    variables: Variables = {
        point: ((point,), g, {"long_name": axis, "units": attribute(units.coordinate(c))})
        for point, axis, g, c in zip(points, axes, grid, observable, strict=True)
    }
    words = f"probability density of {observable_name(observable)}"
    sizes = dict(zip(points, mesh[0].shape, strict=True))
    unit = attribute(units.density(observable))
    part: Part = (("p", "error"), words, unit, lambda d: d.at(*mesh), sizes)
    of_curves = {"coordinates": "curve_label"}
    return variables | by_route(name, len(all_of), answers, [part], of_curves=of_curves)


def variable_name(observable: Observable) -> str:
    """Return the observable's name as part of the name of a variable or a file: ``q2_p2``."""
    return observable_name(observable).replace(",", "_")


def curve_numbers(outcome: Outcome) -> list[float]:
    """Return the varied number of each curve, or 0, 1, 2, … if any is missing or repeats."""
    numbers = [curve.value for curve in outcome.curves]
    distinct = None not in numbers and len(set(numbers)) == len(numbers)
    return [number if distinct and number is not None else k for k, number in enumerate(numbers)]


def common_grid(
    densities: Iterable[AnyDensity], *, cut: float = GRID_CUT, count: int | None = None
) -> tuple[Array, ...]:
    """Return an ascending array of equidistant points for each axis of the ``densities``.

    It covers all points at which one of them exceeds ``cut`` times its own largest value.
    ``count``: points on each axis; None: ``GRID_POINTS``. All must be of the same observable.
    """
    reach = np.array([_extent(density, cut) for density in densities])
    count = count or GRID_POINTS[reach.shape[1]]
    ends = zip(reach[..., 0].min(axis=0), reach[..., 1].max(axis=0), strict=True)
    return tuple(np.linspace(low, high, count) for low, high in ends)


def _extent(density: AnyDensity, cut: float) -> list[tuple[float, float]]:
    """Per axis, the ends of the range in which p exceeds ``cut`` times its largest value."""
    if isinstance(density, SampledDensity):
        edges, values = list(density.edges), density.values
    else:
        cells = EXTENT_CELLS[len(density.panels)]
        edges = [np.linspace(nodes[0], nodes[-1], cells + 1) for nodes in density.panels]
        values = density(*np.ix_(*(0.5 * (e[1:] + e[:-1]) for e in edges)))
    above = np.nonzero(values > cut * values.max())
    return [(e[i.min()], e[i.max() + 1]) for e, i in zip(edges, above, strict=True)]
