"""Densities on common grids, and these as files: netCDF and comma-separated values."""

import csv
import json
from collections.abc import Iterable, Mapping, Sequence
from io import BytesIO, StringIO
from pathlib import Path

import h5netcdf
import h5py
import numpy as np

from cases.comparison.answers import Answers, Outcome
from cases.output.digest import method_record
from cases.output.files import write_by, write_text
from cases.output.records import UNITS, plain, program_version
from cases.output.time_fields import Variables, time_variables
from cases.scene.scene import Scene
from fpk.arrays import Array
from fpk.density import AnyDensity
from fpk.observable import Observable, observable_name
from fpk.sampled_density import SampledDensity

POINTS = {1: 401, 2: 101}
"""Points an axis of a grid, by the number of axes."""

CUT = 1e-9
"""Share of the largest value below which a density no longer widens the grid."""

COARSE = {1: 200, 2: 60}
"""Cells an axis on which the extent of a density by a function is measured, by axes."""


def write_netcdf(outcome: Outcome, path: Path) -> list[Path]:
    """Write the densities of every observable, curve and route on common grids as netCDF-4.

    ``p_q2`` (curve, route, q2) is the density and ``error_q2`` its error: an estimate of the
    numerical error or one standard error, as ``error_kind_q2`` says. A route that does not apply is
    not a number. Settings and certificates are JSON in the attribute ``provenance``. Of answers in
    time see ``time_variables``.
    """
    variables: Variables = {}
    for observable in outcome.scene.observables:
        variables |= density_variables(outcome.curves, observable)
    variables |= time_variables(outcome)
    answers = [
        plain({"curve": curve.label, **method_record(result)})
        for curve in outcome.curves
        for result in curve.results
    ]
    provenance = json.dumps(answers, ensure_ascii=False)
    attributes = {**attributes_of(outcome.scene), "units": UNITS, "provenance": provenance}
    write_variables(variables, attributes, path)
    return [path]


def attributes_of(scene: Scene) -> dict[str, str]:
    """Return what every file of results says of its origin."""
    return {
        "title": scene.title,
        "scene": scene.name,
        "source": scene.source,
        "scene_file": scene.text,
        "program": f"vibro-fpk {program_version()}",
    }


def write_variables(variables: Variables, attributes: Mapping[str, str], path: Path) -> None:
    """Write ``variables`` as netCDF-4, made in memory: HDF5 does not survive a full disk."""
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
    """Write the densities as lines ``curve, observable, route, x, y, density, error``."""
    stream = StringIO()
    lines = csv.writer(stream, lineterminator="\n")
    lines.writerow(["curve", "observable", "route", "x", "y", "density", "error"])
    for observable in outcome.scene.observables:
        if not (variables := density_variables(outcome.curves, observable)):
            continue
        name = observable_name(observable)
        dimensions, values, _ = variables[f"p_{name}"]
        errors, kinds = variables[f"error_{name}"][1], variables[f"error_kind_{name}"][1]
        curves, routes, *grid = (variables[dimension][1] for dimension in dimensions)
        x, *others = (m.ravel().tolist() for m in np.meshgrid(*grid, indexing="ij"))
        y = others[0] if others else [""] * len(x)
        for i, j in np.argwhere(kinds != ""):
            columns = x, y, values[i, j].ravel().tolist(), errors[i, j].ravel().tolist()
            names = curves[i], name, routes[j]
            lines.writerows([*names, *row] for row in zip(*columns, strict=True))
    write_text(path, stream.getvalue())
    return [path]


def density_variables(all_of: Sequence[Answers], observable: Observable) -> Variables:
    """Return the densities of an observable on a common grid, empty where no route gives it.

    As ``write_netcdf`` says, for ``all_of`` the curves.
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
    name = observable_name(observable)
    curves = [c.label for c in all_of]
    routes = list(dict.fromkeys(route for _, route in answers))
    values = np.full((len(curves), len(routes), *mesh[0].shape), np.nan)
    errors, kinds = values.copy(), np.full(values.shape[:2], "", dtype=object)
    for (i, route), density in answers.items():
        where = i, routes.index(route)
        values[where], errors[where] = density.at(*mesh)
        kinds[where] = density.error_kind
    # Each observable has its own grid and routes: a coordinate of another must not realign it.
    axes = [str(c) for c in observable]
    points = [f"{axis}_of_{name}" if len(axes) == 2 else axis for axis in axes]
    first = ("curve", f"route_{name}")
    words = {"long_name": f"probability density of {name}", "units": UNITS}
    coordinates: Variables = {
        point: ((point,), g, {"long_name": axis, "units": UNITS})
        for point, axis, g in zip(points, axes, grid, strict=True)
    }
    return coordinates | {
        "curve": (first[:1], np.array(curves), {}),
        first[1]: (first[1:], np.array(routes), {}),
        f"p_{name}": ((*first, *points), values, words),
        f"error_{name}": ((*first, *points), errors, {**words, "long_name": f"error of p_{name}"}),
        f"error_kind_{name}": (first, kinds, {}),
    }


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
    if isinstance(density, SampledDensity):
        edges, values = list(density.edges), density.values
    else:
        cells = COARSE[len(density.panels)]
        edges = [np.linspace(nodes[0], nodes[-1], cells + 1) for nodes in density.panels]
        values = density.tabulated(*np.ix_(*(0.5 * (e[1:] + e[:-1]) for e in edges)))
    above = np.nonzero(values > cut * values.max())
    return [(e[i.min()], e[i.max() + 1]) for e, i in zip(edges, above, strict=True)]
