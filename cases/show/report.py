"""The report of a run: one self-contained page, its answer in words, the pictures beside it."""

from collections.abc import Iterator, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import matplotlib as mpl
from matplotlib.figure import Figure

from cases.compare.claims import ALMOST_KURTOSIS, ALMOST_L1
from cases.compare.doubt import ACCEPTABLE_L1
from cases.compare.stationary import Outcome
from cases.scene.scene import Scene
from cases.scene.written import number, percent, with_error
from cases.show.digest import curves_of
from cases.show.facts import theories, units_record
from cases.show.files import write_text
from cases.show.page import PLOTS, as_script_data, origin_record, page_record, script_record
from cases.show.pictures.chain import chain_svg
from cases.show.pictures.densities import (
    HEIGHT,
    density_panel,
    fall_exponentially,
    joint_fields,
    joint_pictures,
    line_pictures,
)
from cases.show.pictures.draw import column_figure
from cases.show.pictures.in_time import time_panels
from cases.show.pictures.panel import map_record
from cases.show.pictures.style import SHOWN, STYLE, in_units
from cases.show.pictures.svg import image_address, svg_text
from cases.show.records import Record
from cases.show.slider_model import slider_curves, slider_model
from cases.show.text import render, theory_table
from cases.show.words import reader_words
from fpk.answer.contacts import CLEARANCE_RULE
from fpk.answer.method import Progress, silent
from fpk.answer.names import observable_name
from sim.sample.diagnostics import FALSE_ALARMS

GROUPS = {"passage": "time", "transient": "time", "solver": "difference", "left": "difference"}
"""Part of the page in which a picture stands, by the first word of its file; others: "density"."""

SCRIPTS = *PLOTS, "closed_forms.js", "sliders.js"

RELIABILITY = "in P(T > t) at the times asked for"


def write_report(
    outcome: Outcome,
    digest: Record,
    folder: Path,
    *,
    command: str = "",
    progress: Progress = silent,
) -> list[Path]:
    """Write ``report.html`` and the pictures into ``folder``; return their paths in this order.

    ``digest`` is ``digest_of(outcome)``; the page shows ``command``, by default ``fpk run`` of the
    scene, with links to the pictures and to all netCDF files in the folder. Every file appears
    whole or not at all. Raises ``BadInput`` if a file cannot be written.
    """
    pictures, written = [], []
    live = live_record(outcome)
    touched = {stem for plot in (live or {"plots": ()})["plots"] for stem in plot["still"]}
    for stem, caption, figure in figures(outcome, progress=progress):
        written.append(folder / f"{stem}.svg")
        write_text(written[-1], svg_text(figure, salt=stem))
        group = GROUPS.get(stem.partition("_")[0], "density")
        image = "" if stem in touched else image_address(figure)
        pictures.append({"stem": stem, "group": group, "caption": caption, "image": image})
    fields = [path.name for path in sorted(folder.glob("*.nc"))]
    page = report_html(
        outcome.scene,
        digest,
        pictures,
        live=live,
        command=command,
        downloads=[*fields, *(path.name for path in written)],
    )
    write_text(folder / "report.html", page)
    return [folder / "report.html", *written]


def figures(outcome: Outcome, *, progress: Progress = silent) -> Iterator[tuple[str, str, Figure]]:
    """Yield file stem, caption and figure: densities, differences, answers in time.

    A pair is drawn for the first curve that has its density.
    """
    with mpl.rc_context(dict(STYLE)), in_units(outcome.scene.units):
        for k, observable in enumerate(outcome.scene.observables, start=1):
            curves = [c for c in outcome.curves if c.densities(observable)]
            if curves and len(observable) == 1:
                yield from line_pictures(curves, observable)
            elif curves:
                yield from joint_pictures(curves[0], observable)
            progress(k, len(outcome.scene.observables), "drawing")
        for k, curve in enumerate(outcome.curves):
            for stem, caption, panel in time_panels(curve, f"_{k}" if k else ""):
                yield stem, caption, column_figure([panel], HEIGHT)


def live_record(outcome: Outcome) -> Record | None:
    """Return the data of the page's scripts: plots and ``slider_model``; None without plots."""
    observables = outcome.scene.observables
    model, missing = slider_model(outcome.curves[0], observables, units_record(outcome.scene))
    plots = []
    with in_units(outcome.scene.units):
        for observable in observables:
            name = observable_name(observable)
            own: Record = {"id": name, "of": name, "cut": SHOWN}
            own["still"] = [f"density_{name.replace(',', '_')}"]
            curves = [c for c in outcome.curves if c.densities(observable)]
            if curves and len(observable) == 1:
                curves.sort(key=lambda c: c.value or 0.0)
                sliders = slider_curves(model, observable)
                panel = density_panel(curves, observable, log=True, every=True, sliders=sliders)
                own["still"].append(f"density_{name}_log")
                plots.append(panel.record(**own, scales=[False, True]))
            elif curves:
                log = fall_exponentially(observable)
                plots.append(map_record(joint_fields(curves[0], observable, log=log), **own))
        for k, curve in enumerate(outcome.curves):
            for stem, _, panel in time_panels(curve, f"_{k}" if k else ""):
                # Of several times the page shows the first until a reader asks for others.
                plots.append(panel.record(id=stem, still=[stem], off=panel.groups[1:]))
    return script_record(plots, model=model, missing=missing) if plots else None


def report_html(
    scene: Scene,
    digest: Record,
    pictures: list[dict[str, Any]],
    *,
    live: Record | None = None,
    command: str = "",
    downloads: Sequence[str] = (),
) -> str:
    """Return the HTML of the page; every text that comes from a scene is escaped.

    ``pictures`` have ``stem``, ``group`` (a value of ``GROUPS``), ``caption``, and the address
    ``image``, which may be empty. ``live`` is ``live_record``, without it there are no interactive
    plots. ``downloads`` are names of files beside the page, ``command`` is the command shown.
    """
    curves = curves_of(digest)
    settings = [m.get("settings", {}) for curve in curves for m in curve["methods"]]
    seeds = sorted({own["seed"] for own in settings if "seed" in own})
    record = {
        "scene": scene,
        "digest": digest,
        "curves": curves,
        "answer": headline_of(curves),
        "answer_numbers": numbers_of(digest),
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
    return render("report.html", record)


def headline_of(curves: list[Record]) -> str:
    """Return how far each averaged theory is from the full system, in one sentence.

    ``curves`` are from ``curves_of``. If the exact density of all is known, a sentence before says
    so. For each curve and theory the largest L1 distance of a density is given, each density by the
    reference that leaves the smallest error. Under modulated noise the densities at the times of
    the [[transient]] tables are compared, or else P(T > t) of the [[passage]] tables; without these
    tables the sentence says that it is about constant noise. Empty if neither a distance nor the
    exact density of all is known.
    """
    parts = []
    for curve in curves:
        asked, rows = _subject_and_distances(curve)
        words = [_words(name, *row) for name, row in _worst(rows).items()]
        where = ", ".join(filter(None, [f"at {curve['label']}" * bool(curve["label"]), asked]))
        if words:
            parts.append((f"{where}: " if where else "") + ", ".join(words))
    sentences = []
    if all(curve["regime"]["incompatible"] is None for curve in curves):
        constant = curves[0]["system"]["modulation"] is None
        known = "known" if constant else "known under constant noise"
        sentences.append(f"The compatibility condition (8) holds: the exact density is {known}.")
    if parts:
        text = "; ".join(parts)
        sentences.append(text[0].upper() + text[1:] + ".")
    return " ".join(sentences)


def measure_of(curves: list[Record]) -> str:
    """Return the definition of the distances in ``headline_of`` in words; empty without any."""
    if not any(_subject_and_distances(curve)[1] for curve in curves):
        return ""
    if _subject_and_distances(curves[0])[0] == RELIABILITY:
        return "Largest difference of P(T > t), T the time of first passage"
    return (
        "L1 distance ∫|p − p_full| of the density that is furthest off, which weighs its bulk and"
        " says little of its tails"
    )


def numbers_of(curve: Record) -> str:
    """Return in sentences the main numbers of a curve, and answers with unknown averaging error.

    The numbers are the rms of each displacement observed, impact rate and mean force of the stop
    that is hit most, and P(T ≤ t) of each first passage at all times: by an answer of the full
    system if there is any, a solution before a simulation. Under modulated noise only the last.
    ``curve`` is an entry of ``curves_of``. Empty if there is nothing to say.
    """
    best: dict[tuple[str, str], Record] = {}
    stationary = curve["quantities"] if curve["system"]["modulation"] is None else []
    for row in sorted(stationary, key=lambda row: row["solves"] != "full"):
        best.setdefault((row["observable"], row["label"]), row)
    parts = [
        _number_words(f"rms {of}", row)
        for (of, quantity), row in best.items()
        if quantity == "rms" and of.startswith("q")
    ]
    rates = [row for (_, quantity), row in best.items() if quantity.startswith("impact rate")]
    if rates:
        row = max(rates, key=lambda row: row["value"] or 0.0)
        force = row["label"].replace("impact rate", "mean force")
        parts.append(_number_words(f"{row['observable']} {row['label']}", row))
        if (row["observable"], force) in best:  # its density is not asked for beside a pair's
            parts.append(_number_words(force, best[row["observable"], force]))
    for question in curve["passages"]:
        answers = sorted(question["answers"], key=lambda a: a["solves"] != "full")
        for answer in answers[:1]:
            by = answer["words"] + ", averaged equation" * (answer["solves"] == "averaged")
            failures = zip(
                question["times"], answer["failure"], answer["failure_error"], strict=True
            )
            chances = [f"{with_error(p, error)} by t = {number(t)}" for t, p, error in failures]
            if chances:
                name = f"probability of first passage, {question['question']}"
                parts.append(f"{name}: {', '.join(chances)} ({by})")
    sentences = ["; ".join(parts) + "."] if parts else []
    if unknown := curve["averaging_unknown"]:
        words = "solved by averaged equations only: the averaging error is unknown."
        sentences.append(f"{', '.join(unknown)} {'is' if len(unknown) == 1 else 'are'} {words}")
    text = " ".join(sentences)
    return text[:1].upper() + text[1:]


def _number_words(name: str, row: Record) -> str:
    value, unit = with_error(row["value"], row["error"]), row.get("unit") or ""
    by = reader_words(row["route"]).partition(",")[0]
    by += ", averaged equation" * (row["solves"] == "averaged")
    return f"{name} {value}{' ' + unit if unit not in ('', '1') else ''} ({by})"


def _subject_and_distances(curve: Record) -> tuple[str, list[Record]]:
    """Words for what is compared, empty for stationary densities, and rows of distances.

    A row has ``theory``, ``observable``, ``error`` and ``L1`` (of P(T > t): absolute difference).
    """
    if curve["system"]["modulation"] is None:
        return "", curve["averaging"]
    for words, questions, norm in (
        ("at the times asked for", curve["transients"], "L1"),
        (RELIABILITY, curve["passages"], "absolute"),
    ):
        rows = [
            {**c, "theory": c["a"], "observable": question["question"]}
            for question in questions
            for c in question["comparisons"]
            if (c["measures"], c["norm"]) == ("averaging", norm)
        ]
        if rows:
            return words, rows
    return "under constant noise", curve["averaging"]


def _worst(rows: list[Record]) -> dict[str, tuple[float, float]]:
    """By theory the largest ``L1`` of its rows and the ``error`` of this row; best theory first.

    Keys are names of theories for readers, without solvers. ``rows`` are from
    ``_subject_and_distances``; of several rows of one theory and observable, by solution and
    simulation, the row with the smallest error counts.
    """
    best: dict[tuple[str, str], tuple[float, float]] = {}
    for row in sorted(rows, key=lambda row: row["error"]):
        name = reader_words(row["theory"]).partition(",")[0]
        best.setdefault((name, row["observable"]), (row["L1"], row["error"]))
    ascending = sorted((distance, name) for (name, _), distance in best.items())
    worst = {name: distance for distance, name in ascending}
    return dict(sorted(worst.items(), key=lambda row: row[1]))


def _words(name: str, distance: float, error: float) -> str:
    if distance + error <= ACCEPTABLE_L1:
        return f"{name} is within {percent(distance + error, up=True)} of the full system"
    uncertain = f" (± {percent(error, up=True)})" if error > 0.05 * distance else ""
    return f"{name} is {percent(distance)} off{uncertain}"
