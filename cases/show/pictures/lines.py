"""Pictures over one coordinate: densities, and differences of two answers with their bands."""

from collections.abc import Iterator, Mapping, Sequence
from itertools import cycle
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from cases.compare.answers import Answers
from cases.compare.compare import join_bins
from cases.show.fields import common_grid
from cases.show.pictures.style import (
    COLOURS,
    GAP,
    INK,
    SHOWN,
    SOLVER_WORDS,
    Differences,
    arrange,
    density_words,
    lines_of,
    samples_of,
    solver_difference,
    symbol_of,
    words_of,
)
from fpk.answer.density import bin_differences
from fpk.answer.method import ROUTES, Route
from fpk.answer.names import Observable, observable_name
from fpk.answer.sampled_density import SampledDensity
from fpk.numeric.arrays import Array

POINTS = 300
"""Points of a line: one for each point of a picture's width."""

MARKERS = 48
"""Bins drawn as points."""

TAIL = 1e-6
"""Share of the largest value at which a logarithmic scale ends."""

SAME_LINE = 0.007
"""Distance of two lines, relative to the height of a picture, that the width of a line hides."""

LINES: Any = ("-", (0, (6, 2)), (0, (6, 2, 1, 2)), (0, (1, 1)))
"""Dashes of the lines of one curve, by its routes."""

MARKS = {"full": "o", "averaged": "s"}
"""Markers of samples of a lone curve, by what the route solves."""

CURVE_MARKS = "osD^vXP"
"""Markers of samples by curve: a second cue beside its colour."""

MARK: Any = {
    "linestyle": "none",
    "markersize": 3.4,
    "markerfacecolor": "none",
    "markeredgewidth": 0.9,
}

HEIGHT, ALONE, ROW = 2.7, 1.6, 0.9
"""Height in inches of the axes of densities, and of differences of a lone curve or one of many."""


def line_pictures(
    curves: Sequence[Answers], observable: Observable
) -> Iterator[tuple[str, str, Figure]]:
    """Yield file stem, caption and figure of everything to be seen of one coordinate."""
    name = observable_name(observable)
    curves = sorted(curves, key=lambda c: c.value or 0.0)
    densities = [d for c in curves for d in c.densities(observable).values()]
    (x,) = common_grid(densities, cut=SHOWN, count=POINTS)
    words = "theory as lines, simulation as points and a band of two standard errors"
    words += "".join(f"; {note}" for note in coincidences(curves, observable, x))
    words += "; stops shaded." if walls_of(curves, observable) else "."
    yield f"density_{name}", f"Density of {name}: {words}", density_figure(curves, observable, x)
    (tails,) = common_grid(densities, cut=TAIL, count=POINTS)
    figure = density_figure(curves, observable, tails, lowest=TAIL)
    yield (
        f"density_{name}_log",
        "The same with a logarithmic scale, to a millionth of the top.",
        figure,
    )
    for stem, words, band, differences in DIFFERENCES:
        rows = {c.label: row for c in curves if (row := differences(c, observable, x))}
        if rows:
            figure = difference_figure(rows, observable, x, band=band)
            yield f"{stem}_{name}", words.format(name), figure


def walls_of(curves: Sequence[Answers], observable: Observable) -> list[float]:
    """Return where the observed displacement touches its stops, those of all curves, signed."""
    (c,) = observable
    stops = [
        s for curve in curves for s in curve.system.stops if c.kind == "q" and s.index == c.row
    ]
    return sorted({stop.sign * stop.clearance for stop in stops})


def coincidences(curves: Sequence[Answers], observable: Observable, x: Array) -> list[str]:
    """Return in words which lines are nowhere further apart than the width of a line."""
    lines = [
        (route.name, c.label, density(x))
        for c in curves
        for route, density in lines_of(c, observable).items()
    ]
    top = max((float(p.max()) for *_, p in lines), default=0.0)
    groups: list[list[tuple[str, str, Array]]] = []
    for line in lines:
        for group in groups:
            if np.abs(group[0][2] - line[2]).max() <= SAME_LINE * top:
                group.append(line)
                break
        else:
            groups.append([line])
    notes = []
    for group in groups:
        by_name: dict[str, list[str]] = {}
        for name, label, _ in group:
            by_name.setdefault(name, []).append(label)
        if len(group) > 1:
            words = [
                f"{name} ({', '.join(of)})" if any(of) else name for name, of in by_name.items()
            ]
            notes.append(f"the lines of {' and '.join(words)} coincide")
    return notes


def dashes_of(route: Route) -> Any:
    """Return the dashes of a theory, the same in all pictures; solid is the full system."""
    averaged = list(dict.fromkeys(r.method for r in ROUTES.values() if r.solves == "averaged"))
    place = averaged.index(route.method) + 1 if route.method in averaged else 0
    return LINES[min(place, len(LINES) - 1)]


def density_figure(
    curves: Sequence[Answers],
    observable: Observable,
    x: Array,
    figure: Figure | None = None,
    *,
    lowest: float = 0.0,
) -> Figure:
    """Draw the densities of one coordinate: deterministic as lines, sampled as points with bars.

    Several curves are distinguished by colour, and their routes by dashes; the routes of a single
    curve have their own colours, too. ``lowest``: the share of the largest value where a
    logarithmic scale ends, 0 for a linear one. ``figure`` None: a new one.
    """
    figure = figure or Figure()
    axes = figure.subplots()
    colours = dict(zip((c.label for c in curves), cycle(COLOURS), strict=False))
    alone = len(curves) == 1
    legend: dict[str, Artist] = {}
    if not alone:
        legend |= {
            w: Line2D([], [], color=c, linewidth=3, marker=m, markersize=5)
            for (w, c), m in zip(colours.items(), cycle(CURVE_MARKS), strict=False)
        }
    for curve, own_mark in zip(curves, cycle(CURVE_MARKS), strict=False):
        functions = lines_of(curve, observable).items()
        for route, density in functions:
            dashes = dashes_of(route)
            colour, ink = (route.colour,) * 2 if alone else (colours[curve.label], INK)
            axes.plot(x, density(x), linestyle=dashes, color=colour)
            legend.setdefault(route.name, Line2D([], [], color=ink, linestyle=dashes))
        for route, sampled in samples_of(curve, observable).items():
            colour, ink = (route.colour,) * 2 if alone else (colours[curve.label], INK)
            mark = {**MARK, "marker": MARKS[route.solves] if alone else own_mark}
            middles, values, error = marks_within(sampled, MARKERS, x)
            error = 2.0 * error
            floor = 0.1 * lowest * values.max()  # a logarithm ends somewhere
            low = np.minimum(values, np.maximum(values - error, floor))
            axes.fill_between(middles, low, values + error, color=colour, alpha=0.25, linewidth=0)
            # One path for all bars; those of errorbar make the file half as long again.
            bars = np.column_stack((low, values + error, np.full(len(values), np.nan)))
            axes.plot(np.repeat(middles, 3), bars.ravel(), color=colour, linewidth=0.9)
            axes.plot(middles, values, color=colour, **mark)
            words = f"{route.name}, ±2 s.e."
            legend.setdefault(words, Line2D([], [], color=ink, **{**mark, "marker": "o"}))
    axes.set(xlim=(x[0], x[-1]), xlabel=words_of(observable[0]), ylabel=density_words(observable))
    if lowest:
        top = axes.get_ylim()[1]
        axes.set(yscale="log", ylim=(lowest * top, 2.0 * top))
    else:
        axes.set_ylim(bottom=0)
    # Where the mass overlaps its stops is shaded; several clearances are only marked.
    walls, ends = walls_of(curves, observable), axes.get_xlim()
    for wall in walls:
        axes.axvline(wall, color=INK, linewidth=0.8, alpha=0.5)
    for sign, end in zip((-1.0, 1.0), ends, strict=True) if walls else ():
        own = {s.clearance for c in curves for s in c.system.stops
               if s.sign == sign and s.index == observable[0].row}  # fmt: skip
        if len(own) == 1:
            axes.axvspan(sign * own.pop(), end, color=INK, alpha=0.07, linewidth=0)
    axes.set_xlim(ends)
    arrange(figure, HEIGHT, legend, head=0.12)
    return figure


def theory_differences(curve: Answers, observable: Observable, x: Array) -> Differences | None:
    """Return simulation − theory for every theory drawn, in two standard errors."""
    sampled = [d for r, d in samples_of(curve, observable).items() if r.solves == "full"]
    theories = lines_of(curve, observable).items()
    if not sampled or not theories:
        return None
    few = join_bins(sampled[0], 2 * MARKERS)
    middles = 0.5 * (few.edges[0][1:] + few.edges[0][:-1])
    inside = (middles >= x[0]) & (middles <= x[-1])
    # Above kinks some bins are much narrower than a pixel, with few samples: no place in a curve.
    inside &= np.diff(few.edges[0]) > 1e-4 * (x[-1] - x[0])
    return middles[inside], 2.0 * few.standard_error[inside], {
        f"simulation − {route.name}": bin_differences(few, theory)[inside]
        for route, theory in theories
    }  # fmt: skip


DIFFERENCES = (
    ("solver", SOLVER_WORDS, "±the errors that both state", solver_difference),
    (
        "left",
        "Simulation minus theory for {}. Inside the grey band the difference is chance; a curve"
        " that leaves it shows the averaging error where the theory is an averaged one.",
        "±2 standard errors",
        theory_differences,
    ),
)
"""Pictures of differences: file stem, caption, what the band is, and the differences of a curve."""


def difference_figure(
    rows: Mapping[str, Differences], observable: Observable, x: Array, *, band: str
) -> Figure:
    """Draw the differences of each curve, by its label, in a row over the extent of ``x``.

    ``band`` says in words what the band is.
    """
    figure = Figure()
    panels = figure.subplots(len(rows), 1, sharex=True, squeeze=False)[:, 0]
    legend: dict[str, Artist] = {}
    for axes, (label, row), colour in zip(panels, rows.items(), cycle(COLOURS), strict=False):
        points, allowed, differences = row
        axes.axhline(0.0, color=INK, linewidth=0.7)
        axes.fill_between(points, -allowed, allowed, color=INK, alpha=0.16, linewidth=0)
        for (name, values), dashes in zip(differences.items(), LINES, strict=False):
            style: Any = {"linewidth": 1.2, "linestyle": dashes}
            axes.plot(points, values, color=colour, **style)
            legend.setdefault(name, Line2D([], [], color=INK, **style))
        axes.set_title(label, loc="right")  # on the left stands the power of ten of the axis
        axes.ticklabel_format(axis="y", scilimits=(-3, 3))
        axes.locator_params(axis="y", nbins=4)
    legend[band] = Line2D([], [], color=INK, alpha=0.16, linewidth=6)
    words = f"difference of p({symbol_of(observable[0])})"
    figure.supylabel(words, fontsize=9.5, x=0.005, ha="left")
    panels[-1].set(xlim=(x[0], x[-1]), xlabel=words_of(observable[0]))
    arrange(figure, ROW if len(rows) > 1 else ALONE, legend, head=GAP)
    return figure


def marks_within(sampled: SampledDensity, count: int, x: Array) -> tuple[Array, Array, Array]:
    """Return up to ``count`` equidistant points within ``x`` and the bins, p there and its error.

    Points at which the sample says nothing are left out.
    """
    edges = sampled.edges[0]
    ends = np.linspace(max(x[0], edges[0]), min(x[-1], edges[-1]), count + 1)
    points = 0.5 * (ends[1:] + ends[:-1])
    value, error = sampled.at(points)
    seen = value > error
    return points[seen], value[seen], error[seen]
