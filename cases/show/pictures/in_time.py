"""Pictures of answers about motion after a start: reliability, and densities at several times."""

from collections.abc import Iterator
from dataclasses import replace
from math import ceil
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.colors import to_hex

from cases.compare.answers import Answers
from cases.compare.in_time import Replies, failure_of
from cases.scene.questions import PassageQuestion, TransientQuestion
from cases.show.pictures.densities import LOG_TAIL, MARKED
from cases.show.pictures.panel import Curve, Panel
from cases.show.pictures.style import (
    COLOURS,
    SHOWN,
    density_words,
    marker_of,
    style_of,
    time_words,
    words_of,
)
from fpk.answer.dynamics import Passage, Transient
from fpk.answer.method import Route
from fpk.numeric.arrays import Array

RARE = 0.05
"""Probability of failure at the last time below which it is drawn instead of the reliability."""

SHADES = 0.05, 0.88
"""Ends of the used part of a colour map, 0 to 1, for more times than there are ``COLOURS``: the
rest is too light on white."""


def time_panels(curve: Answers, label: str) -> Iterator[tuple[str, str, Panel]]:
    """Yield file name without ending, ``passage_1`` + ``label``, caption, panel of each question.

    Left out are questions without answers, passages without times, transients without windows.
    """
    suffix = f", {curve.label}" if curve.label else ""
    for k, replies in enumerate(curve.passages, start=1):
        if replies.given and replies.question.times:
            panel = passage_panel(replies, curve.label)
            drawn = f"{panel.y} by every route, on a logarithmic scale"
            words = f"First passage of {replies.question.name}{suffix}: {drawn}; lines join the"
            yield f"passage_{k}{label}", f"{words} times asked for, which are marked.", panel
    for k, replies in enumerate(curve.transients, start=1):
        if replies.given and replies.windows:
            words = f"Density after the start, {replies.question.name}{suffix}: theory as lines,"
            caption = f"{words} simulation as points with two standard errors."
            yield f"transient_{k}{label}", caption, transient_panel(replies, curve.label)


def passage_panel(replies: Replies, title: str) -> Panel:
    """Return P(T > t) by route, or P(T ≤ t) if all give less than ``RARE`` at the last time.

    P(T > t) begins with 1 at t = 0, unless the start is random and may lie beyond the limit. Bands
    and bars are ± the stated errors of solutions, ± 2 standard errors of samples. The times asked
    for are marked. Values that the logarithmic scale does not reach, or whose error is not known,
    are left out, as are further solvers of one equation.
    """
    assert isinstance(replies.question, PassageQuestion)
    answers = [(r, p) for r, p in _answers_to_draw(replies) if isinstance(p, Passage)]
    random = replies.question.start.kind == "noise"
    rare = max(float(failure_of(p)[0][-1]) for _, p in answers) < RARE
    curves = []
    for route, p in answers:
        values, errors = failure_of(p) if rare else (p.survival, p.survival_error)
        seen = (values > (0.0 if rare else LOG_TAIL)) & np.isfinite(errors)
        start = () if rare or random or p.times[0] == 0.0 else (0.0,)
        x, y = np.append(start, p.times[seen]), np.append(np.ones(len(start)), values[seen])
        own = replace(_curve(route, x, y, np.append(np.zeros(len(start)), errors[seen])), band=True)
        curves.append(own if route.sampled else replace(own, bars=1, marker="o"))
    drawn = np.concatenate([curve.y for curve in curves])
    words = "failure P(T ≤ t)" if rare else "reliability P(T > t)"
    limits = 0.5 * drawn.min(initial=1.0), 2.0 * max(drawn, default=0.5) if rare else 1.3
    scales: Any = {"logarithmic": False, "by_x": True, "limits": limits}
    return Panel(title, time_words(), words, curves, **scales)


def _curve(route: Route, x: Array, y: Array, error: Array) -> Curve:
    """A line ``y`` over ``x``, all (points,), or points with bars ±2 ``error`` of a sample."""
    own = Curve(route.words, x, y, error, brief=route.name, colour=route.colour, bars=2)
    if route.sampled:
        return replace(own, style="none", marker=marker_of(route))
    return replace(own, style=style_of(route), marker="", bars=0)


def transient_panel(replies: Replies, title: str) -> Panel:
    """Return the densities at all times, each in its window: groups are times, names routes."""
    question, points = replies.question, replies.points
    assert isinstance(question, TransientQuestion) and points is not None
    times, answers = (
        question.times,
        [a for a in _answers_to_draw(replies) if isinstance(a[1], Transient)],
    )
    shades = map(to_hex, colormaps["viridis"](np.linspace(*SHADES, len(times))))
    colours = COLOURS[: len(times)] if len(times) <= len(COLOURS) else tuple(shades)
    curves, tops = [], np.zeros(len(times))
    for route, p in answers:
        assert isinstance(p, Transient)
        for k, window in enumerate(replies.windows):
            inside = window[:: ceil(len(window) / MARKED)] if route.sampled else window
            tops[k] = max(tops[k], p.values[k, window].max())
            curve = _curve(route, points[inside], p.values[k, inside], p.errors[k, inside])
            curves.append(replace(curve, group=f"t = {times[k]:g}", colour=colours[k]))
    energy = question.of[0].kind == "H"  # from rest its density falls exponentially at all times
    scales: Any = {"logarithmic": False, "y_logarithmic": energy, "by_x": True, "zero": True}
    scales["lowest"] = SHOWN * tops.min() / tops.max()
    return Panel(title, words_of(question.of[0]), density_words(question.of), curves, **scales)


def _answers_to_draw(replies: Replies) -> Iterator[tuple[Route, Passage | Transient]]:
    """Yield routes and answers, samples last; of the solvers of one equation only the first."""
    solved: set[str] = set()
    for g in sorted(replies.given, key=lambda g: g.route.sampled):
        if g.route.sampled or g.route.method not in solved:
            solved.add(g.route.method)
            yield replace(g.route, words=g.words), g.answer
