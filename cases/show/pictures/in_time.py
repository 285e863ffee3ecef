"""Pictures of motion after a start: reliability by all routes, densities at several times."""

from collections.abc import Iterator
from itertools import cycle
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.artist import Artist
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from cases.compare.answers import Answers
from cases.compare.in_time import Replies, failure_of
from cases.scene.questions import PassageQuestion, TransientQuestion
from cases.show.pictures.lines import HEIGHT, LINES, MARK
from cases.show.pictures.style import (
    COLOURS,
    INK,
    SHOWN,
    arrange,
    density_words,
    time_words,
    words_of,
)
from fpk.answer.dynamics import Passage, Transient
from fpk.answer.method import Route
from fpk.numeric.arrays import Array

MARKS = {"full": "os", "averaged": "^v"}
"""Markers of simulations, by what they solve."""

RARE = 0.05
"""Probability of failure at the last time below which it is drawn instead of the reliability."""

LOWEST = 1e-4
"""Least reliability that is drawn; nothing that is sampled is known below it."""

EVERY = 6
"""Every so many points a marker of a sampled density in time is drawn."""

SHADES = 0.05, 0.88
"""Part of the colours of many times, first to last: the rest is too light on white."""


def asked_in_time(curve: Answers, label: str) -> Iterator[tuple[str, Replies]]:
    """Yield file stem and replies of every question that somebody answered with what is drawn."""
    for k, replies in enumerate(curve.passages, start=1):
        if replies.given and replies.question.times:
            yield f"passage_{k}{label}", replies
    for k, replies in enumerate(curve.transients, start=1):
        if replies.given and replies.windows:
            yield f"transient_{k}{label}", replies


def time_pictures(curve: Answers, label: str) -> Iterator[tuple[str, str, Figure]]:
    """Yield file stem, caption and figure of every question that somebody answered."""
    suffix = f", {curve.label}" if curve.label else ""
    for stem, replies in asked_in_time(curve, label):
        name = f"{replies.question.name}{suffix}"
        if isinstance(replies.question, PassageQuestion):
            figure, words = passage_figure(replies)
            yield stem, f"First passage of {name}: {words}", figure
        else:
            caption = (
                f"Density after the start, {name}: theory as lines,"
                " simulation as points with two standard errors."
            )
            yield stem, caption, transient_figure(replies)


def drawn_passage(replies: Replies) -> tuple[str, list[tuple[Route, Any, Array, Array, Array]]]:
    """Return what is drawn in words, and by route its style, times, probabilities and errors.

    P(T > t), or P(T ≤ t) of rare failure; what a logarithmic scale cannot show is left out.
    """
    answers = [(r, p, style) for r, p, style in styled(replies) if isinstance(p, Passage)]
    rare = max(float(failure_of(p)[0][-1]) for _, p, _ in answers) < RARE
    drawn = []
    for route, p, style in answers:
        values, errors = failure_of(p) if rare else (p.survival, p.survival_error)
        seen = values > (0.0 if rare else LOWEST)
        drawn.append((route, style, p.times[seen], values[seen], errors[seen]))
    return ("P(T ≤ t), failure by t" if rare else "P(T > t), reliability"), drawn


def passage_figure(replies: Replies) -> tuple[Figure, str]:
    """Draw P(T > t), or P(T ≤ t) of rare failure, of all routes with what they state as bands.

    Returned with the figure is what it shows in words.
    """
    figure = Figure()
    axes = figure.subplots()
    name, answers = drawn_passage(replies)
    rare = "≤" in name
    legend: dict[str, Artist] = {}
    for route, style, times, values, errors in answers:
        colour = route.colour
        if route.sampled:
            marks = {**MARK, "marker": style, "markersize": 4.2}
            axes.errorbar(times, values, 2.0 * errors, color=colour, elinewidth=0.9, **marks)
            legend[f"{route.name}, ±2 s.e."] = Line2D([], [], color=colour, **marks)
        else:
            axes.plot(times, values, color=colour, linestyle=style)
            low, high = np.maximum(values - errors, 1e-300), values + errors
            axes.fill_between(times, low, high, color=colour, alpha=0.16, linewidth=0)
            legend[route.name] = Line2D([], [], color=colour, linestyle=style)
    lowest = min([1.0, *(value for *_, values, _ in answers for value in values)])
    axes.set(yscale="log", xlabel=time_words(), ylabel=name)
    axes.set_xlim(left=0.0)
    axes.set_ylim(0.5 * lowest, None if rare else 1.3)
    arrange(figure, HEIGHT, legend, head=0.12)
    words = "the probability of failure by t" if rare else "the reliability P(T > t)"
    return figure, f"{words} by every route, on a logarithmic scale."


def shades_of(count: int) -> list[str]:
    """Return the colours of so many times: those of curves, or of many times dark to light."""
    shades = map(to_hex, colormaps["viridis"](np.linspace(*SHADES, count)))
    return list(COLOURS[:count] if count <= len(COLOURS) else shades)


def transient_figure(replies: Replies) -> Figure:
    """Draw the densities at all times: colours are times, dashes and markers routes."""
    question, points = replies.question, replies.points
    assert isinstance(question, TransientQuestion) and points is not None
    figure = Figure()
    axes = figure.subplots()
    colours = shades_of(len(question.times))
    legend: dict[str, Artist] = {
        f"t = {t:g}": Line2D([], [], color=c, linewidth=3)
        for t, c in zip(question.times, colours, strict=True)
    }
    for route, p, style in styled(replies):
        assert isinstance(p, Transient)
        for k, (inside, colour) in enumerate(zip(replies.windows, colours, strict=True)):
            x, values, errors = points[inside], p.values[k, inside], p.errors[k, inside]
            if route.sampled:
                few = slice(None, None, EVERY)
                axes.errorbar(
                    x[few], values[few], 2.0 * errors[few], color=colour, elinewidth=0.9,
                    **{**MARK, "marker": style},
                )  # fmt: skip
            else:
                axes.plot(x, values, color=colour, linestyle=style)
        drawn = {**MARK, "marker": style} if route.sampled else {"linestyle": style}
        legend[route.name] = Line2D([], [], color=INK, **drawn)
        tops = [float(v[i].max()) for v, i in zip(p.values, replies.windows, strict=True)]
    if question.of[0].kind == "H":  # decades: from rest it falls exponentially at all times
        axes.set(yscale="log", ylim=(SHOWN * min(tops), 2.0 * max(tops)))
        axes.set_xlim(left=0.0)
    else:
        axes.set_ylim(bottom=0.0)
    axes.set(xlabel=words_of(question.of[0]), ylabel=density_words(question.of))
    arrange(figure, HEIGHT, legend, head=0.12)
    return figure


def styled(replies: Replies) -> Iterator[tuple[Route, Passage | Transient, Any]]:
    """Yield routes, answers, dashes or markers: of what solves an equation its first solver."""
    dashes, marks = cycle(LINES), {solves: cycle(own) for solves, own in MARKS.items()}
    solved: set[str] = set()
    for g in sorted(replies.given, key=lambda g: g.route.sampled):
        if not g.route.sampled and g.route.method in solved:
            continue
        solved.add(g.route.method)
        yield g.route, g.answer, next(marks[g.route.solves] if g.route.sampled else dashes)
