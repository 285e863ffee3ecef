"""A map as a page: table, netCDF, comma-separated values; the picture is another module's."""

import csv
from functools import partial
from io import StringIO

import numpy as np
import xarray as xr

from cases.output.records import UNITS
from cases.studies.regime_map.build import RegimeMap
from cases.studies.regime_map.picture import regime_figure
from cases.studies.regime_map.points import NEITHER, THEORIES, UNDECIDED
from cases.studies.tables import Page, Table
from fpk.observable import observable_name


def map_page(result: RegimeMap) -> Page:
    """Return what ``fpk regime`` shows and writes: every point, and how often each is nearer."""
    symbols = [a.symbol for a in result.axes]
    head = " | ".join([*symbols, *(f"L1 {t}" for t in THEORIES), "nearer", "δ / rms"])
    rows = [
        (
            *(f"{v:.4g}" for v in p.values),
            *(
                f"{p.L1[t]:.4f} ± {p.error[t]:.4f}" if t in p.L1 else "does not apply"
                for t in THEORIES
            ),
            p.winner,
            None if p.rms_ratio is None else f"{p.rms_ratio:.2f}",
        )
        for p in result.points
    ]
    names = (*THEORIES, UNDECIDED, NEITHER)
    counts = {name: sum(p.winner == name for p in result.points) for name in names}
    words = ", ".join(f"{name} {count}" for name, count in counts.items() if count)
    summary = (
        f"p({observable_name(result.observable)}), {len(result.points)} points"
        f" ({result.reused} from disk), nearer to the full system: {words}"
    )
    return Page(
        "regime",
        result.scene,
        f"Map of regimes: {result.scene.title}",
        [Table("", head, rows, (summary,))],
        partial(map_dataset, result),
        partial(regime_figure, result),
        summary=summary,
        csv=partial(map_csv, result),
    )


def map_dataset(result: RegimeMap) -> xr.Dataset:
    """Return ``L1`` and ``error`` (theory, parameters), ``winner`` and ``rms_ratio``."""
    keys, name = [axis.key for axis in result.axes], observable_name(result.observable)
    words = {
        "L1": f"L1 distance of p({name}) to the full system",
        "error": "how far chance and the solvers may have moved L1",
    }
    axes = {a.key: (a.key, a.values, {"units": UNITS, "symbol": a.symbol}) for a in result.axes}
    data = xr.Dataset(coords={"theory": list(THEORIES), **axes}, attrs={"observable": name})
    for key, meaning in words.items():
        tables = np.array([result.of_theory(key, theory) for theory in THEORIES])
        data[key] = (("theory", *keys), tables, {"long_name": meaning})
    for key in ("rms_ratio", "winner", "reference"):
        data[key] = (keys, result.table(lambda p, key=key: getattr(p, key)))  # type: ignore[misc]
    ratio = "smallest clearance over rms displacement without contact"
    data["rms_ratio"].attrs["long_name"] = ratio
    return data


def map_csv(result: RegimeMap) -> str:
    """Return one line a point: parameters, L1 and error of each theory, winner, reference."""
    stream = StringIO()
    lines = csv.writer(stream, lineterminator="\n")
    theories = [f"{word} {theory}" for theory in THEORIES for word in ("L1", "error")]
    lines.writerow([*(a.key for a in result.axes), *theories, "winner", "reference", "rms_ratio"])
    for p in result.points:
        numbers = [part.get(theory, "") for theory in THEORIES for part in (p.L1, p.error)]
        lines.writerow([*p.values, *numbers, p.winner, p.reference, p.rms_ratio])
    return stream.getvalue()
