"""The report of a run: one self-contained page, the pictures beside it, the fields as netCDF."""

import platform
from collections.abc import Iterator
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

import matplotlib as mpl
from matplotlib.figure import Figure

from cases.comparison.answers import Outcome
from cases.comparison.claims import ACCEPTABLE_L1, ALMOST_KURTOSIS, ALMOST_L1
from cases.output.facts import theories
from cases.output.files import write_text
from cases.output.pictures.in_time import time_pictures
from cases.output.pictures.joint import joint_pictures
from cases.output.pictures.lines import line_pictures
from cases.output.pictures.style import STYLE, in_units, inline_svg, svg_text
from cases.output.records import Record, program_version
from cases.output.text import rendered
from cases.scene.scene import Scene
from fpk.method import Progress, silent

LIBRARIES = ("numpy", "scipy", "scikit-fem", "numba", "matplotlib", "h5netcdf")


def write_report(
    outcome: Outcome, digest: Record, folder: Path, *, progress: Progress = silent
) -> list[Path]:
    """Write ``report.html`` and the pictures into ``folder``; return their paths.

    ``digest`` is the record of the run, ``digest_of(outcome)``.
    Every file appears whole or not at all. Raises ``BadInput`` where the folder cannot be written.
    """
    pictures, written = [], []
    for stem, caption, figure in figures(outcome, progress=progress):
        svg = svg_text(figure, salt=stem)
        written.append(folder / f"{stem}.svg")
        write_text(written[-1], svg)
        in_time = stem.startswith(("passage_", "transient_"))
        pictures.append(
            {"stem": stem, "in_time": in_time, "caption": caption, "svg": inline_svg(svg, caption)}
        )
    write_text(folder / "report.html", report_html(outcome.scene, digest, pictures))
    return [folder / "report.html", *written]


def figures(outcome: Outcome, *, progress: Progress = silent) -> Iterator[tuple[str, str, Figure]]:
    """Yield file stem, caption and figure of everything that an outcome can show."""
    with mpl.rc_context(dict(STYLE)), in_units(outcome.scene.units):
        for k, observable in enumerate(outcome.scene.observables, start=1):
            curves = [c for c in outcome.curves if c.densities(observable)]
            if curves and len(observable) == 1:
                yield from line_pictures(curves, observable)
            elif curves:
                yield from joint_pictures(curves[0], observable)
            progress(k, len(outcome.scene.observables), "drawing")
        for k, curve in enumerate(outcome.curves):
            yield from time_pictures(curve, f"_{k}" if k else "")


def report_html(scene: Scene, digest: Record, pictures: list[dict[str, Any]]) -> str:
    """Return the page; every text that comes from a scene is escaped by the template."""
    record = {
        "scene": scene,
        "digest": digest,
        "theories": theories(scene),
        "pictures": pictures,
        "limits": {
            "gaussian": ALMOST_L1,
            "kurtosis": ALMOST_KURTOSIS,
            "acceptable": ACCEPTABLE_L1,
        },
        "made": datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"),
        "versions": [
            ("vibro-fpk", program_version()),
            ("Python", platform.python_version()),
            *((name, version(name)) for name in LIBRARIES),
        ],
    }
    return rendered("report.html", record)
