"""Data of the plots of a report: curves and maps with errors, parameters of closed forms."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from cases.compare.answers import Answers
from cases.compare.compare import join_bins
from cases.compare.in_time import Replies
from cases.compare.stationary import Outcome
from cases.scene.questions import TransientQuestion
from cases.show.facts import units_record
from cases.show.fields import common_grid
from cases.show.page import MARKS, rounded, script_record
from cases.show.pictures.in_time import EVERY, asked_in_time, drawn_passage, shades_of, styled
from cases.show.pictures.joint import LOWEST
from cases.show.pictures.lines import MARKERS, TAIL, dashes_of, marks_within, walls_of
from cases.show.pictures.style import (
    COLOURS,
    SHOWN,
    density_words,
    in_units,
    lines_of,
    time_words,
    words_of,
)
from cases.show.records import Record
from cases.show.slider_model import slider_model, slider_series
from fpk.answer.dynamics import Passage, Transient
from fpk.answer.names import Observable, observable_name
from fpk.answer.sampled_density import SampledDensity
from fpk.numeric.arrays import Array

POINTS, MAP_POINTS, MAP_BINS = 301, 61, 40
"""Points of a curve in the page, points an axis of a map, and about as many bins of a sampled one.
"""

BARS = 2
"""Standard errors that a bar shows."""


def live_record(outcome: Outcome) -> Record | None:
    """Return the plots of all observables and of motion in time, and the model of the sliders.

    None where nothing can be drawn.
    """
    curves = sorted(outcome.curves, key=lambda c: c.value or 0.0)
    observables = outcome.scene.observables
    model, missing = slider_model(outcome.curves[0], observables, units_record(outcome.scene))
    with in_units(outcome.scene.units):
        plots = [
            plot
            for o in observables
            if (plot := _curves(curves, o, model) if len(o) == 1 else _map(outcome.curves, o))
        ]
        for k, curve in enumerate(outcome.curves):
            plots += _in_time(curve, f"_{k}" if k else "")
    return script_record(plots, model=model, missing=missing) if plots else None


def _series(name: str, y: Array, error: Array, **own: Any) -> Record:
    """A curve of a plot, by its name in words."""
    return {"curve": "", "shown": True, **own, "name": name, **rounded(y=y, error=error)}


def _curves(curves: list[Answers], observable: Observable, model: Record | None) -> Record | None:
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
        own: Record = {
            "curve": curves[k].label,
            "colour": route.colour if len(curves) == 1 else COLOURS[k % len(COLOURS)],
        }
        if isinstance(density, SampledDensity):
            middles, values, errors = marks_within(density, 2 * MARKERS, x)
            mark = MARKS[(k if len(curves) > 1 else int(route.solves == "averaged")) % len(MARKS)]
            own |= {"x": middles, "marks": mark, "band": True, "bars": BARS}
        else:
            own |= {
                "dash": _dash(dashes_of(route)),
                "shown": route in lines_of(curves[k], observable),
            }
            values, errors = density.at(x)
        series.append(_series(route.words, values, errors, **own))
    name = observable_name(observable)
    return {
        "id": name,
        "of": name,
        "still": [f"density_{name}", f"density_{name}_log"],
        "scales": [False, True],
        "cut": SHOWN,
        "zero": True,
        "lowest": TAIL,
        "x": x,
        "xlabel": words_of(observable[0]),
        "ylabel": density_words(observable),
        "walls": walls_of(curves, observable),
        "series": [*series, *slider_series(model, observable)],
    }


def _dash(dashes: Any) -> str:
    """Dashes of matplotlib as those of SVG."""
    return "" if dashes == "-" else " ".join(str(2 * d) for d in dashes[1])


def _map(curves: Sequence[Answers], observable: Observable) -> Record | None:
    """Fields of the joint density of a pair by every route, on common levels; of the first curve.

    None where no route gives it.
    """
    found = [(c, densities) for c in curves if (densities := c.densities(observable))]
    if not found:
        return None
    curve, densities = found[0]
    drawn = lines_of(curve, observable)
    grid = common_grid(densities.values(), cut=SHOWN, count=MAP_POINTS)
    fields = []
    for route, density in densities.items():  # of a function at the points, of a sample its bins
        if isinstance(density, SampledDensity):
            few = join_bins(density, MAP_BINS)
            middles = [0.5 * (e[1:] + e[:-1]) for e in few.edges]
            inside = [(m >= g[0]) & (m <= g[-1]) for m, g in zip(middles, grid, strict=True)]
            values, errors = few.values[np.ix_(*inside)], few.standard_error[np.ix_(*inside)]
            own: Record = {"x": middles[0][inside[0]], "y": middles[1][inside[1]]}
        else:
            values, errors = density.at(*np.meshgrid(*grid, indexing="ij"))
            own = {"smooth": True}
        shown = {"name": route.words, "shown": route in drawn or route.sampled}
        numbers = rounded(z=values.ravel(), error=errors.ravel())
        fields.append({**shown, "high": float(values.max()), **numbers, **own})
    energies = all(c.kind == "H" for c in observable)  # they fall exponentially
    top = max(field["high"] for field in fields)
    for field in fields:
        field |= {"log": energies, "low": 0.0, "high": top, "floor": LOWEST * top}
    x, y = observable
    name = observable_name(observable)
    return {
        "id": name,
        "of": name,
        "still": [f"density_{name.replace(',', '_')}"],
        "cut": SHOWN,
        "x": grid[0],
        "y": grid[1],
        "xlabel": words_of(x),
        "ylabel": words_of(y),
        "walls": [walls_of([curve], (c,)) for c in observable],
        "fields": fields,
    }


def _in_time(curve: Answers, label: str) -> list[Record]:
    """Plots of the questions about time that somebody answered."""
    plots = []
    for stem, replies in asked_in_time(curve, label):
        first = replies.given[0].answer
        common: Record = {"id": stem, "still": [stem], "title": curve.label}
        if isinstance(first, Passage):
            name, answers = drawn_passage(replies)
            series = [
                _series(
                    route.words, values, errors, x=times, colour=route.colour, band=True,
                    bars=BARS if route.sampled else 1,
                    **({"marks": MARKS[0]} if route.sampled else {"dash": _dash(style)}),
                )
                for route, style, times, values, errors in answers
            ]  # fmt: skip
            times = np.unique(np.concatenate([times for *_, times, _, _ in answers]))
            own: Record = {"x": times, "xlabel": time_words(), "ylabel": name}
            own |= {"scales": [True], "zero": True}
        else:
            own = _transient(replies)
            series = own.pop("series")
        plots.append({**common, **own, "series": series})
    return plots


def _transient(replies: Replies) -> Record:
    """Words and series of the densities at all times: curves are times, names routes."""
    question, points = replies.question, replies.points
    assert isinstance(question, TransientQuestion) and points is not None
    series = []
    for route, p, style in styled(replies):
        assert isinstance(p, Transient)
        for k, colour in enumerate(shades_of(len(question.times))):
            inside = replies.windows[k]
            own: Record = {"curve": f"t = {question.times[k]:g}", "colour": colour}
            if route.sampled:
                inside = inside[::EVERY]
                own |= {"marks": MARKS[0], "bars": BARS}
            else:
                own["dash"] = _dash(style)
            values, errors = p.values[k, inside], p.errors[k, inside]
            series.append(_series(route.words, values, errors, x=points[inside], **own))
    answers = [p for _, p, _ in styled(replies) if isinstance(p, Transient)]
    tops = [
        max(float(p.values[k, i].max()) for p in answers) for k, i in enumerate(replies.windows)
    ]
    return {
        "x": points,
        "xlabel": words_of(question.of[0]),
        "ylabel": density_words(question.of),
        "scales": [question.of[0].kind == "H"],
        "zero": True,
        "lowest": SHOWN * min(tops) / max(tops),
        "series": series,
    }
