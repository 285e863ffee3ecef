"""Data of the interactive plots of a report: curves with errors, parameters of closed forms."""

import json
from collections.abc import Sequence
from typing import Any

import numpy as np
from markupsafe import Markup

from averaging.closed_form import averaged_rate
from averaging.conditional import conditional
from averaging.modal.analysis import modal_analysis
from averaging.modal.observables import gaussian_modes
from cases.comparison.answers import Answers
from cases.comparison.run import Outcome
from cases.output.fields import common_grid
from cases.output.pictures.choice import lines_of
from cases.output.pictures.lines import MARKERS, TAIL, bins_within, dashes_of, walls_of
from cases.output.pictures.style import COLOURS, density_words, words_of
from cases.output.records import Record, plain
from cases.written import bound
from fpk.contact import Contact
from fpk.observable import Observable, observable_name
from fpk.sampled_density import SampledDensity

POINTS = 301
"""Points of a curve in the page."""

MARKS = (
    "m-2.4,0a2.4,2.4 0 1,0 4.8,0a2.4,2.4 0 1,0 -4.8,0",
    "m-2.2,-2.2h4.4v4.4h-4.4z",
    "m0,-3.2l3.2,3.2l-3.2,3.2l-3.2,-3.2z",
    "m0,-3l2.8,5h-5.6z",
    "m0,3l2.8,-5h-5.6z",
    "m-2.4,-2.4l4.8,4.8m0,-4.8l-4.8,4.8",
    "m-3,0h6m-3,-3v6",
)
"""Paths of the markers of samples by curve, as ``CURVE_MARKS`` of the drawn pictures."""

DIGITS, ERROR_DIGITS = 10, 2
"""Digits of a density in the page, and of its error."""


def live_record(outcome: Outcome) -> Record | None:
    """Return the plots of all single coordinates and the model of ``_model``; None without plots.

    Densities are rounded to ``DIGITS`` digits, their errors up to ``ERROR_DIGITS``.
    """
    curves = sorted(outcome.curves, key=lambda c: c.value or 0.0)
    singles = [o for o in outcome.scene.observables if len(o) == 1]
    plots = [plot for o in singles if (plot := _plot(curves, o)) is not None]
    model = _model(outcome.curves[0], singles) if plots else None
    return plain({"plots": plots, "model": model}) if plots else None


def as_script_data(record: Record) -> Markup:
    """Return the record as JSON for a script element: ``<``, ``>`` and ``&`` are escaped in it."""
    text = json.dumps(record, ensure_ascii=True, allow_nan=False, separators=(",", ":"))
    for character in "<>&":
        text = text.replace(character, f"\\u{ord(character):04x}")
    return Markup(text)


def _plot(curves: list[Answers], observable: Observable) -> Record | None:
    """Words, points and series of the plot of one coordinate; None where no route gives it."""
    answers = [
        (k, route, density)
        for k, curve in enumerate(curves)
        for route, density in curve.densities(observable).items()
    ]
    if not answers:
        return None
    (x,) = common_grid((density for *_, density in answers), cut=TAIL, count=POINTS)
    series = []
    for k, route, density in answers:
        drawn = route in lines_of(curves[k], observable) or isinstance(density, SampledDensity)
        own: Record = {"curve": curves[k].label, "name": route.words, "shown": drawn}
        own["colour"] = route.colour if len(curves) == 1 else COLOURS[k % len(COLOURS)]
        if isinstance(density, SampledDensity):
            few, middles, inside = bins_within(density, 2 * MARKERS, x)
            values, errors = few.values[inside], few.standard_error[inside]
            mark = k if len(curves) > 1 else int(route.solves == "averaged")
            own["mark"] = MARKS[mark % len(MARKS)]
            own["x"], values, errors = (v[values > 0.0] for v in (middles, values, errors))
        else:
            dashes = dashes_of(route)
            own["dash"] = "" if dashes == "-" else " ".join(str(2 * d) for d in dashes[1])
            values, errors = density.at(x)
        own["p"] = [float(f"{p:.{DIGITS - 1}e}") for p in values]
        own["error"] = [float(bound(error, ERROR_DIGITS)) for error in errors]
        series.append(own)
    return {
        "of": observable_name(observable),
        "x": x,
        "xlabel": words_of(observable[0]),
        "ylabel": density_words(observable),
        "walls": walls_of(curves, observable),
        "series": series,
    }


def _power_law(stop: Contact) -> bool:
    """Whether the contact energy is that of a power law, which the page knows."""
    x = np.array([0.3, 1.7])
    expected = stop.stiffness * x ** (stop.power + 1.0) / (stop.power + 1.0)
    return bool(np.allclose(stop.energy(x), expected, rtol=1e-12))


def _model(curve: Answers, observables: Sequence[Observable]) -> Record | None:
    """Parameters of the closed forms (29), (30), (34), (36), which a slider evaluates anew.

    None where these do not hold: they need constant damping, noise without modulation, one contact
    mass and contact forces by power laws.
    """
    system = curve.system
    taken = {r.method.route.method for r in curve.results if r.method.route.solves == "averaged"}
    masses = system.contact_masses
    plain_system = not system.damping_terms and system.modulation is None
    if not (plain_system and len(masses) == 1 and all(map(_power_law, system.stops))):
        return None
    if "nonintegrable" not in taken:
        return None
    modes = system.fact(modal_analysis) if "integrable" in taken else None
    variances = None if modes is None else np.sum(gaussian_modes(modes).factor ** 2, axis=1)
    of: dict[str, Any] = {}
    for (c,) in observables:
        if c.kind == "H" and c.index is None:
            of[str(c)] = {"kind": "H"}
        elif c.kind == "p" or (c.kind == "q" and c.row == masses[0]):
            row = c.row + (system.n if c.kind == "p" else 0)
            variance = None if variances is None else float(variances[row])
            of[str(c)] = {"kind": c.kind, "mass": system.mass[c.row], "variance": variance}
    return {
        "n": system.n,
        "a": conditional(system, masses[0], ()).precision,
        "alpha": float(averaged_rate(system)[0]),
        "stops": [
            {"sign": s.sign, "B": s.stiffness, "delta": s.clearance, "e": s.power}
            for s in system.stops
        ],
        "theta": [] if modes is None else modes.temperature,
        "of": of,
    }
