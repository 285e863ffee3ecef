"""Pictures of answers about motion after a start: reliability, and densities at several times."""

from collections.abc import Iterator

import numpy as np
from matplotlib import colormaps
from matplotlib.colors import to_hex
from matplotlib.figure import Figure

from cases.compare.answers import Answers
from cases.compare.in_time import Replies, failure_of
from cases.scene.questions import PassageQuestion, TransientQuestion
from cases.show.pictures.densities import HEIGHT
from cases.show.pictures.draw import column_figure
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

RARE = 0.05
"""Probability of failure at the last time below which it is drawn instead of the reliability."""

LOWEST = 1e-4
"""Smallest reliability that is drawn; samples know nothing below it."""

EVERY = 6
"""One of so many points of a sampled density in time is drawn."""

SHADES = 0.05, 0.88
"""Part of the colours of many times, first to last: the rest is too light on white."""


def time_panels(curve: Answers, label: str) -> Iterator[tuple[str, str, Panel]]:
    """Yield file stem, caption and panel of every question that has an answer to be drawn."""
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


def time_pictures(curve: Answers, label: str) -> Iterator[tuple[str, str, Figure]]:
    """Yield file stem, caption and figure of every question that has an answer to be drawn."""
    for stem, caption, panel in time_panels(curve, label):
        yield stem, caption, column_figure([panel], HEIGHT)


def passage_panel(replies: Replies, title: str) -> Panel:
    """Return P(T > t) from P = 1 at t = 0, or P(T ≤ t) of rare failure, by every route.

    Bands and bars are what the answers state. The times asked for are marked. What a logarithmic
    scale cannot show is left out.
    """
    assert isinstance(replies.question, PassageQuestion)
    answers = [(r, p) for r, p in _drawn(replies) if isinstance(p, Passage)]
    rare = max(float(failure_of(p)[0][-1]) for _, p in answers) < RARE
    curves = []
    for route, p in answers:
        values, errors = failure_of(p) if rare else (p.survival, p.survival_error)
        seen = values > (0.0 if rare else LOWEST)
        start = () if rare or p.times[0] == 0.0 else (0.0,)  # starts lie below every limit: P = 1
        curves.append(
            Curve(
                route.words,
                np.concatenate([start, p.times[seen]]),
                np.concatenate([np.ones(len(start)), values[seen]]),
                np.concatenate([np.zeros(len(start)), errors[seen]]),
                brief=route.name,
                colour=route.colour,
                style="none" if route.sampled else style_of(route),
                marker=marker_of(route) if route.sampled else "o",
                bars=2 if route.sampled else 1,
                band=True,
            )
        )
    lowest = min((float(v) for curve in curves for v in curve.y), default=1.0)
    highest = max((float(v) for curve in curves for v in curve.y), default=1.0)
    return Panel(
        title,
        time_words(),
        "failure P(T ≤ t)" if rare else "reliability P(T > t)",
        curves,
        logarithmic=False,
        by_x=True,
        limits=(0.5 * lowest, 2.0 * highest if rare else 1.3),
        ends=(0.0, 1.04 * max(replies.question.times)),
    )


def transient_panel(replies: Replies, title: str) -> Panel:
    """Return the densities at all times: groups are times, names routes."""
    question, points = replies.question, replies.points
    assert isinstance(question, TransientQuestion) and points is not None
    times, answers = question.times, [a for a in _drawn(replies) if isinstance(a[1], Transient)]
    shades = map(to_hex, colormaps["viridis"](np.linspace(*SHADES, len(times))))
    colours = COLOURS[: len(times)] if len(times) <= len(COLOURS) else tuple(shades)
    curves, tops = [], np.zeros(len(times))
    for route, p in answers:
        assert isinstance(p, Transient)
        for k, window in enumerate(replies.windows):
            inside = window[::EVERY] if route.sampled else window
            tops[k] = max(tops[k], p.values[k, window].max())
            curves.append(
                Curve(
                    route.words,
                    points[inside],
                    p.values[k, inside],
                    p.errors[k, inside],
                    group=f"t = {times[k]:g}",
                    brief=route.name,
                    colour=colours[k],
                    style="none" if route.sampled else style_of(route),
                    marker=marker_of(route) if route.sampled else "",
                    bars=2 if route.sampled else 0,
                )
            )
    energy = question.of[0].kind == "H"  # from rest its density falls exponentially at all times
    return Panel(
        title,
        words_of(question.of[0]),
        density_words(question.of),
        curves,
        logarithmic=False,
        y_logarithmic=energy,
        by_x=True,
        zero=True,
        lowest=SHOWN * tops.min() / tops.max(),
        ends=(0.0, float(points[max(w[-1] for w in replies.windows)])) if energy else None,
    )


def _drawn(replies: Replies) -> Iterator[tuple[Route, Passage | Transient]]:
    """Yield routes and answers, samples last: of each equation that of its first solver."""
    solved: set[str] = set()
    for g in sorted(replies.given, key=lambda g: g.route.sampled):
        if g.route.sampled or g.route.method not in solved:
            solved.add(g.route.method)
            yield g.route, g.answer
