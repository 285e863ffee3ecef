"""Densities as labelled arrays and as files: netCDF and comma-separated values."""

import csv
import json
from collections.abc import Mapping
from importlib.metadata import PackageNotFoundError, version
from io import BytesIO, StringIO
from pathlib import Path
from typing import Any

import h5netcdf
import numpy as np
import xarray as xr

from cases.comparison.run import Outcome
from cases.output.files import write_by
from cases.output.summary import certificate_record, plain
from fpk.density import AnyDensity, Array, Density, SampledDensity
from fpk.observable import Observable, observable_name

GRID_1D, GRID_2D = 401, 101
"""Points an axis of the exported fields."""

CUT = 1e-9
"""Share of the largest value below which a density no longer widens the grid."""

UNITS = "the scene's own consistent units"


def dataset(outcome: Outcome) -> xr.Dataset:
    """Return the densities of every observable, curve and route on common grids.

    ``p_q2`` (curve, route, q2) is the density and ``error_q2`` its error: an estimate of the
    numerical error or one standard error, as ``error_kind_q2`` says. A route that does not apply is
    not a number. Provenance and certificates are JSON in ``provenance``.
    """
    data = xr.Dataset()
    for observable in outcome.scene.observables:
        _add(data, outcome, observable)
    data.attrs = {
        "title": outcome.scene.title,
        "scene": outcome.scene.name,
        "source": outcome.scene.source,
        "scene_file": outcome.scene.text,
        "program": f"vibro-fpk {program_version()}",
        "units": UNITS,
        "provenance": json.dumps(plain(_provenance(outcome)), ensure_ascii=False),
    }
    return data


def program_version() -> str:
    """Return the version of the installed distribution."""
    try:
        return version("vibro-fpk")
    except PackageNotFoundError:
        return "(not installed)"


def common_grid(densities: Mapping[Any, AnyDensity], *, cut: float = CUT) -> tuple[Array, ...]:
    """Return one ascending array per axis: where any density exceeds ``cut`` of its largest."""
    ends = [_reach(d, cut) for d in densities.values()]
    count = GRID_1D if len(ends[0]) == 1 else GRID_2D
    return tuple(
        np.linspace(min(e[axis][0] for e in ends), max(e[axis][1] for e in ends), count)
        for axis in range(len(ends[0]))
    )


def values_on(density: AnyDensity, *points: Array) -> tuple[Array, Array]:
    """Return density and error at ``points``; outside the support the density is zero.

    The error is, too, but for a histogram: nothing was seen there in so many samples.
    """
    inside = np.ones(np.broadcast_shapes(*(x.shape for x in points)), dtype=bool)
    held = []
    for x, nodes in zip(points, density.panels, strict=True):
        inside &= (x >= nodes[0]) & (x <= nodes[-1])
        held.append(np.clip(x, nodes[0], nodes[-1]))
    value, error = density.at(*held)
    beyond = density.one_sample if isinstance(density, SampledDensity) else 0.0
    return np.where(inside, value, 0.0), np.where(inside, error, beyond)


def write_netcdf(outcome: Outcome, path: Path) -> None:
    """Write the dataset of ``outcome`` as netCDF-4."""
    write_dataset(dataset(outcome), path)


def write_dataset(data: xr.Dataset, path: Path) -> None:
    """Write ``data`` as netCDF-4, made in memory: HDF5 does not survive a disk that fills up."""
    stream = BytesIO()
    with h5netcdf.File(stream, "w") as file:
        data.dump_to_store(xr.backends.H5NetCDFStore(file))
    write_by(path, lambda temporary: temporary.write_bytes(stream.getvalue()))


def csv_text(outcome: Outcome) -> str:
    """Return the densities as lines ``curve, observable, route, x, y, density, error``."""
    stream = StringIO()
    lines = csv.writer(stream, lineterminator="\n")
    lines.writerow(["curve", "observable", "route", "x", "y", "density", "error"])
    for observable in outcome.scene.observables:
        for curve in outcome.curves:
            densities = curve.densities(observable)
            if not densities:
                continue
            mesh = np.meshgrid(*common_grid(densities), indexing="ij")
            points = [m.ravel() for m in mesh]
            for route, density in densities.items():
                value, error = values_on(density, *points)
                y = points[1].tolist() if len(points) == 2 else [""] * value.size
                for row in zip(points[0].tolist(), y, value.tolist(), error.tolist(), strict=True):
                    lines.writerow([curve.label, density.name, route, *row])
    return stream.getvalue()


def _add(data: xr.Dataset, outcome: Outcome, observable: Observable) -> None:
    found = {
        (curve.label, route): density
        for curve in outcome.curves
        for route, density in curve.densities(observable).items()
    }
    if not found:
        return
    name = observable_name(observable)
    axes = [str(c) for c in observable]
    curves = list(dict.fromkeys(label for label, _ in found))
    routes = list(dict.fromkeys(route for _, route in found))
    grid = common_grid(found)
    values = np.full((len(curves), len(routes), *(g.size for g in grid)), np.nan)
    errors, kinds = values.copy(), np.full(values.shape[:2], "", dtype=object)
    mesh = np.meshgrid(*grid, indexing="ij")
    for (label, route), density in found.items():
        where = (curves.index(label), routes.index(route))
        values[where], errors[where] = values_on(density, *mesh)
        kinds[where] = density.error_kind
    # Each observable has its own grid and routes: a coordinate of another must not realign it.
    route_axis, points = (
        f"route_{name}",
        [f"{axis}_of_{name}" if len(axes) == 2 else axis for axis in axes],
    )
    dims = ("curve", route_axis, *points)
    data.coords["curve"] = ("curve", curves)
    data.coords[route_axis] = (route_axis, routes)
    for point, axis, g in zip(points, axes, grid, strict=True):
        data.coords[point] = (point, g, {"long_name": axis, "units": UNITS})
    data[f"p_{name}"] = (
        dims,
        values,
        {"long_name": f"probability density of {name}", "units": UNITS},
    )
    data[f"error_{name}"] = (dims, errors, {"long_name": f"error of p_{name}", "units": UNITS})
    data[f"error_kind_{name}"] = (dims[:2], kinds.astype(str))


def _provenance(outcome: Outcome) -> list[dict[str, Any]]:
    return [
        {
            "curve": curve.label,
            "route": route,
            "observable": density.name,
            "l1_error": density.l1_error if isinstance(density, Density) else None,
            "certificate": certificate_record(density),
            **dict(density.provenance),
        }
        for curve in outcome.curves
        for observable in outcome.scene.observables
        for route, density in curve.densities(observable).items()
    ]


def _reach(density: AnyDensity, cut: float) -> list[tuple[float, float]]:
    """Per axis, the interval in which the density exceeds ``cut`` of its largest value."""
    coarse = 400 if len(density.panels) == 1 else 60
    edges = [np.linspace(nodes[0], nodes[-1], coarse + 1) for nodes in density.panels]
    middles = [0.5 * (e[1:] + e[:-1]) for e in edges]
    value, _ = density.at(*np.meshgrid(*middles, indexing="ij"))
    counts = value > cut * value.max()
    reach = []
    for axis, e in enumerate(edges):
        others = tuple(a for a in range(counts.ndim) if a != axis)
        cells = np.flatnonzero(counts.any(axis=others))
        reach.append((float(e[cells[0]]), float(e[cells[-1] + 1])))
    return reach
