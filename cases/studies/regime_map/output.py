"""A map as files: netCDF, comma-separated values, and a table for reading."""

import csv
from io import StringIO
from pathlib import Path

import numpy as np
import xarray as xr

from cases.output.fields import UNITS, program_version, write_dataset
from cases.output.files import write_text
from cases.output.svg import svg_text
from cases.studies.regime_map.build import RegimeMap
from cases.studies.regime_map.picture import regime_figure
from cases.studies.regime_map.points import NEITHER, THEORIES, UNDECIDED
from fpk.observable import observable_name


def write_map(found: RegimeMap, folder: Path) -> list[Path]:
    """Write ``regime.svg``, ``regime.nc``, ``regime.csv`` and ``regime.md``; return their paths."""
    paths = [folder / f"regime.{ending}" for ending in ("svg", "nc", "csv", "md")]
    write_text(paths[0], svg_text(regime_figure(found), salt="regime"))
    write_dataset(map_dataset(found), paths[1])
    write_text(paths[2], map_csv(found))
    write_text(paths[3], map_markdown(found))
    return paths


def map_dataset(found: RegimeMap) -> xr.Dataset:
    """Return ``L1`` and ``error`` (theory, parameters), ``winner`` and ``rms_ratio``."""
    names = [axis.key for axis in found.axes]
    shape = found.shape

    def table(key: str) -> list[np.ndarray]:
        columns = ([getattr(p, key).get(t, np.nan) for p in found.points] for t in THEORIES)
        return [np.reshape(column, shape) for column in columns]

    name = observable_name(found.observable)
    ratio = [np.nan if p.rms_ratio is None else p.rms_ratio for p in found.points]
    data = xr.Dataset(
        {
            "L1": (
                ("theory", *names),
                table("L1"),
                {"long_name": f"L1 distance of p({name}) to the full system"},
            ),
            "error": (
                ("theory", *names),
                table("error"),
                {"long_name": "how far chance and the solvers may have moved L1"},
            ),
            "rms_ratio": (
                names,
                np.reshape(ratio, shape),
                {"long_name": "smallest clearance over rms displacement without contact"},
            ),
            "winner": (names, np.reshape([p.winner for p in found.points], shape)),
            "reference": (names, np.reshape([p.reference for p in found.points], shape)),
        },
        coords={
            "theory": list(THEORIES),
            **{a.key: (a.key, a.values, {"units": UNITS, "symbol": a.symbol}) for a in found.axes},
        },
    )
    data.attrs = {
        "title": f"Map of regimes: {found.scene.title}",
        "scene": found.scene.name,
        "scene_file": found.scene.text,
        "observable": name,
        "program": f"vibro-fpk {program_version()}",
    }
    return data


def map_csv(found: RegimeMap) -> str:
    """Return one line a point: parameters, L1 and error of each theory, winner, reference."""
    stream = StringIO()
    lines = csv.writer(stream, lineterminator="\n")
    theories = [f"{word} {theory}" for theory in THEORIES for word in ("L1", "error")]
    keys = [axis.key for axis in found.axes]
    lines.writerow([*keys, *theories, "winner", "reference", "rms_ratio"])
    for p in found.points:
        numbers = [part.get(theory, "") for theory in THEORIES for part in (p.L1, p.error)]
        ratio = "" if p.rms_ratio is None else p.rms_ratio
        lines.writerow([*p.values, *numbers, p.winner, p.reference, ratio])
    return stream.getvalue()


def map_markdown(found: RegimeMap) -> str:
    """Return the points as a table, and how often each theory is nearer."""
    head = [a.symbol for a in found.axes] + [f"L1 {t}" for t in THEORIES] + ["nearer", "δ / rms"]
    lines = [f"# {found.scene.title}", "", map_summary(found), ""]
    lines += ["| " + " | ".join(head) + " |", "|" + "---:|" * len(head)]
    for p in found.points:
        cells = [f"{v:.4g}" for v in p.values]
        cells += [
            f"{p.L1[t]:.4f} ± {p.error[t]:.4f}" if t in p.L1 else "does not apply" for t in THEORIES
        ]
        cells += [p.winner, "–" if p.rms_ratio is None else f"{p.rms_ratio:.2f}"]
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


def map_summary(found: RegimeMap) -> str:
    """Return in one sentence how often each theory is nearer."""
    counts = {
        name: sum(p.winner == name for p in found.points)
        for name in (*THEORIES, UNDECIDED, NEITHER)
    }
    words = ", ".join(f"{name} {count}" for name, count in counts.items() if count)
    return (
        f"p({observable_name(found.observable)}), {len(found.points)} points"
        f" ({found.reused} from disk), nearer to the full system: {words}"
    )
