"""Densities as labelled arrays and as files: netCDF and comma-separated values."""

import csv
import json
from io import BytesIO, StringIO
from pathlib import Path
from typing import Any

import h5netcdf
import numpy as np
import xarray as xr

from cases.comparison.run import Outcome
from cases.output.files import write_by, write_text
from cases.output.grids import common_grid, values_on
from cases.output.records import UNITS, certificate_record, plain, program_version
from fpk.density import Density
from fpk.observable import Observable, observable_name


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


def write_netcdf(outcome: Outcome, path: Path) -> list[Path]:
    """Write the dataset of ``outcome`` as netCDF-4."""
    write_dataset(dataset(outcome), path)
    return [path]


def write_dataset(data: xr.Dataset, path: Path) -> None:
    """Write ``data`` as netCDF-4, made in memory: HDF5 does not survive a disk that fills up."""
    stream = BytesIO()
    with h5netcdf.File(stream, "w") as file:
        data.dump_to_store(xr.backends.H5NetCDFStore(file))
    write_by(path, lambda temporary: temporary.write_bytes(stream.getvalue()))


def write_csv(outcome: Outcome, path: Path) -> list[Path]:
    """Write the densities as lines ``curve, observable, route, x, y, density, error``."""
    stream = StringIO()
    lines = csv.writer(stream, lineterminator="\n")
    lines.writerow(["curve", "observable", "route", "x", "y", "density", "error"])
    for observable in outcome.scene.observables:
        for curve in outcome.curves:
            densities = curve.densities(observable)
            if not densities:
                continue
            mesh = np.meshgrid(*common_grid(densities.values()), indexing="ij")
            points = [m.ravel() for m in mesh]
            for route, density in densities.items():
                value, error = values_on(density, *points)
                y = points[1].tolist() if len(points) == 2 else [""] * value.size
                for row in zip(points[0].tolist(), y, value.tolist(), error.tolist(), strict=True):
                    lines.writerow([curve.label, density.name, route.label, *row])
    write_text(path, stream.getvalue())
    return [path]


def _add(data: xr.Dataset, outcome: Outcome, observable: Observable) -> None:
    densities = {
        (curve.label, route.label): density
        for curve in outcome.curves
        for route, density in curve.densities(observable).items()
    }
    if not densities:
        return
    name = observable_name(observable)
    axes = [str(c) for c in observable]
    curves = list(dict.fromkeys(label for label, _ in densities))
    routes = list(dict.fromkeys(route for _, route in densities))
    grid = common_grid(densities.values())
    values = np.full((len(curves), len(routes), *(g.size for g in grid)), np.nan)
    errors, kinds = values.copy(), np.full(values.shape[:2], "", dtype=object)
    mesh = np.meshgrid(*grid, indexing="ij")
    for (label, route), density in densities.items():
        where = (curves.index(label), routes.index(route))
        values[where], errors[where] = values_on(density, *mesh)
        kinds[where] = density.error_kind
    # Each observable has its own grid and routes: a coordinate of another must not realign it.
    route_axis = f"route_{name}"
    points = [f"{axis}_of_{name}" if len(axes) == 2 else axis for axis in axes]
    dims = ("curve", route_axis, *points)
    data.coords["curve"] = ("curve", curves)
    data.coords[route_axis] = (route_axis, routes)
    for point, axis, g in zip(points, axes, grid, strict=True):
        data.coords[point] = (point, g, {"long_name": axis, "units": UNITS})
    words = {"long_name": f"probability density of {name}", "units": UNITS}
    data[f"p_{name}"] = (dims, values, words)
    data[f"error_{name}"] = (dims, errors, {"long_name": f"error of p_{name}", "units": UNITS})
    data[f"error_kind_{name}"] = (dims[:2], kinds.astype(str))


def _provenance(outcome: Outcome) -> list[dict[str, Any]]:
    return [
        {
            "curve": curve.label,
            "route": result.method.route.label,
            "observable": density.name,
            "l1_error": density.l1_error if isinstance(density, Density) else None,
            "certificate": certificate_record(density),
            **result.settings,
            **density.provenance,
        }
        for curve in outcome.curves
        for result in curve.results
        for density in result.densities
    ]
