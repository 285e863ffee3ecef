"""A map as files: picture, netCDF, comma-separated values, and a table for reading."""

import csv
from io import StringIO
from pathlib import Path

import numpy as np
import xarray as xr

from cases.output.files import write_text
from cases.output.records import UNITS
from cases.studies.regime_map.build import RegimeMap
from cases.studies.regime_map.picture import regime_figure
from cases.studies.regime_map.points import NEITHER, THEORIES, UNDECIDED
from cases.studies.tables import Table, markdown_text, write_study
from fpk.observable import observable_name


def write_map(result: RegimeMap, folder: Path) -> list[Path]:
    """Write ``regime.md``, ``regime.nc``, ``regime.svg`` and ``regime.csv``; return their paths."""
    paths = write_study(
        "regime",
        folder,
        result.scene,
        title=f"Map of regimes: {result.scene.title}",
        page=map_markdown(result),
        data=map_dataset(result),
        figure=regime_figure(result),
    )
    write_text(folder / "regime.csv", map_csv(result))
    return [*paths, folder / "regime.csv"]


def map_dataset(result: RegimeMap) -> xr.Dataset:
    """Return ``L1`` and ``error`` (theory, parameters), ``winner`` and ``rms_ratio``."""
    keys, name = [axis.key for axis in result.axes], observable_name(result.observable)
    words = {
        "L1": f"L1 distance of p({name}) to the full system",
        "error": "how far chance and the solvers may have moved L1",
    }
    data = xr.Dataset(
        coords={
            "theory": list(THEORIES),
            **{a.key: (a.key, a.values, {"units": UNITS, "symbol": a.symbol}) for a in result.axes},
        }
    )
    for key, meaning in words.items():
        tables = [result.table(lambda p, k=key, t=t: getattr(p, k).get(t)) for t in THEORIES]  # type: ignore[misc]
        data[key] = (("theory", *keys), np.array(tables), {"long_name": meaning})
    ratio = {"long_name": "smallest clearance over rms displacement without contact"}
    data["rms_ratio"] = (keys, result.table(lambda p: p.rms_ratio), ratio)
    data["winner"] = (keys, result.table(lambda p: p.winner))
    data["reference"] = (keys, result.table(lambda p: p.reference))
    data.attrs = {"observable": name}
    return data


def map_csv(result: RegimeMap) -> str:
    """Return one line a point: parameters, L1 and error of each theory, winner, reference."""
    stream = StringIO()
    lines = csv.writer(stream, lineterminator="\n")
    theories = [f"{word} {theory}" for theory in THEORIES for word in ("L1", "error")]
    lines.writerow([*(a.key for a in result.axes), *theories, "winner", "reference", "rms_ratio"])
    for p in result.points:
        numbers = [part.get(theory, "") for theory in THEORIES for part in (p.L1, p.error)]
        ratio = "" if p.rms_ratio is None else p.rms_ratio
        lines.writerow([*p.values, *numbers, p.winner, p.reference, ratio])
    return stream.getvalue()


def map_markdown(result: RegimeMap) -> str:
    """Return the points as a table, and how often each theory is nearer."""
    head = (*(a.symbol for a in result.axes), *(f"L1 {t}" for t in THEORIES), "nearer", "δ / rms")
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
    return markdown_text(result.scene.title, [Table("", head, rows, (map_summary(result),))])


def map_summary(result: RegimeMap) -> str:
    """Return in one sentence how often each theory is nearer."""
    names = (*THEORIES, UNDECIDED, NEITHER)
    counts = {name: sum(p.winner == name for p in result.points) for name in names}
    words = ", ".join(f"{name} {count}" for name, count in counts.items() if count)
    return (
        f"p({observable_name(result.observable)}), {len(result.points)} points"
        f" ({result.reused} from disk), nearer to the full system: {words}"
    )
