"""The report of a run: one self-contained page, the pictures beside it, the fields as netCDF."""

from collections.abc import Iterator, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import matplotlib as mpl
from matplotlib.figure import Figure

from cases.comparison.claims import ALMOST_KURTOSIS, ALMOST_L1
from cases.comparison.doubt import ACCEPTABLE_L1
from cases.comparison.run import Outcome
from cases.output.digest import curves_of
from cases.output.facts import theories, units_record
from cases.output.files import write_text
from cases.output.headline import headline_of, measure_of
from cases.output.live import live_record
from cases.output.page import PLOTS, as_script_data, origin_record, page_record
from cases.output.pictures.chain import chain_svg
from cases.output.pictures.in_time import time_pictures
from cases.output.pictures.joint import joint_pictures
from cases.output.pictures.lines import line_pictures
from cases.output.pictures.style import STYLE, in_units
from cases.output.pictures.svg import inline_svg, svg_text
from cases.output.records import Record
from cases.output.text import rendered, theory_table
from cases.scene.scene import Scene
from fpk.clearance import CLEARANCE_RULE
from fpk.method import Progress, silent
from sim.diagnostics import FALSE_ALARMS

GROUPS = {"passage": "time", "transient": "time", "solver": "difference", "left": "difference"}
"""Part of the page in which a picture stands, by the first word of its file; others: "density"."""

SCRIPTS = *PLOTS, "closed_forms.js", "sliders.js"


def write_report(
    outcome: Outcome,
    digest: Record,
    folder: Path,
    *,
    command: str = "",
    progress: Progress = silent,
) -> list[Path]:
    """Write ``report.html`` and the pictures into ``folder``; return their paths.

    ``digest`` is the record of the run, ``digest_of(outcome)``; ``command`` is what made it. The
    page has links to the pictures and to the fields that are in the folder.
    Every file appears whole or not at all. Raises ``BadInput`` where the folder cannot be written.
    """
    pictures, written = [], []
    for stem, caption, figure in figures(outcome, progress=progress):
        svg = svg_text(figure, salt=stem)
        written.append(folder / f"{stem}.svg")
        write_text(written[-1], svg)
        group = GROUPS.get(stem.partition("_")[0], "density")
        pictures.append(
            {"stem": stem, "group": group, "caption": caption, "svg": inline_svg(svg, caption)}
        )
    fields = [path.name for path in sorted(folder.glob("*.nc"))]
    page = report_html(
        outcome.scene,
        digest,
        pictures,
        live=live_record(outcome),
        command=command,
        downloads=[*fields, *(path.name for path in written)],
    )
    write_text(folder / "report.html", page)
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


def report_html(
    scene: Scene,
    digest: Record,
    pictures: list[dict[str, Any]],
    *,
    live: Record | None = None,
    command: str = "",
    downloads: Sequence[str] = (),
) -> str:
    """Return the page; every text that comes from a scene is escaped by the template.

    ``live`` is ``live_record``, with which the pictures can be touched.
    """
    curves = curves_of(digest)
    settings = [m.get("settings", {}) for curve in curves for m in curve["methods"]]
    seeds = sorted({own["seed"] for own in settings if "seed" in own})
    record = {
        "scene": scene,
        "digest": digest,
        "curves": curves,
        "answer": headline_of(curves),
        "answer_measure": measure_of(curves),
        "tables": [
            {**t, "label": c["label"], "columns": ["quantity", *(f"#{r}" for r in t["routes"])]}
            for c in curves
            for t in (theory_table(c["quantities"]),)
        ],
        "sketch": chain_svg(scene.system, scene.units),
        "units": units_record(scene),
        **page_record(SCRIPTS if live else ()),
        "live": live and as_script_data(live),
        **origin_record(command or f"fpk run {scene.name}", downloads, seeds=seeds),
        "theories": theories(scene),
        "pictures": pictures,
        "limits": {
            "gaussian": ALMOST_L1,
            "kurtosis": ALMOST_KURTOSIS,
            "acceptable": ACCEPTABLE_L1,
            "clearance": CLEARANCE_RULE,
            "false_alarms": FALSE_ALARMS,
        },
        "made": datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"),
    }
    return rendered("report.html", record)
