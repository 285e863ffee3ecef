"""Pictures over one coordinate: densities, and differences of two answers with their bands."""

from collections.abc import Iterator, Mapping, Sequence
from itertools import cycle
from typing import Any

from matplotlib.artist import Artist
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from cases.comparison.answers import Answers
from cases.comparison.compare import joined
from cases.output.fields import common_grid
from cases.output.pictures.choice import (
    Differences,
    lines_of,
    samples_of,
    solver_difference,
)
from cases.output.pictures.style import (
    COLOURS,
    GAP,
    INK,
    SHOWN,
    SOLVER_WORDS,
    arrange,
    density_words,
    symbol_of,
    words_of,
)
from fpk.arrays import Array
from fpk.density import bin_differences
from fpk.observable import Observable, observable_name
from fpk.sampled_density import SampledDensity

POINTS = 600
"""Points of a line."""

MARKERS = 56
"""Bins drawn as points."""

LINES: Any = ("-", (0, (6, 2)), (0, (6, 2, 1, 2)), (0, (1, 1)))
"""Dashes of the lines of one curve, by its routes."""

MARKS = {"full": "o", "averaged": "s"}
"""Markers of samples, by what the route solves."""

MARK: Any = {
    "linestyle": "none",
    "markersize": 3.4,
    "markerfacecolor": "none",
    "markeredgewidth": 0.9,
}

HEIGHT, ALONE, ROW = 3.1, 1.6, 0.9
"""Height in inches of the axes of densities, and of differences of a lone curve or one of many."""


def line_pictures(
    curves: Sequence[Answers], observable: Observable
) -> Iterator[tuple[str, str, Figure]]:
    """Yield file stem, caption and figure of everything to be seen of one coordinate."""
    name = observable_name(observable)
    curves = sorted(curves, key=lambda c: c.value or 0.0)
    densities = [d for c in curves for d in c.densities(observable).values()]
    (x,) = common_grid(densities, cut=SHOWN, count=POINTS)
    words = "theory as lines, simulation as points with two standard errors."
    yield f"density_{name}", f"Density of {name}: {words}", density_figure(curves, observable, x)
    for stem, words, band, differences in DIFFERENCES:
        rows = {c.label: row for c in curves if (row := differences(c, observable, x))}
        if rows:
            figure = difference_figure(rows, observable, x, band=band)
            yield f"{stem}_{name}", words.format(name), figure


def density_figure(
    curves: Sequence[Answers], observable: Observable, x: Array, figure: Figure | None = None
) -> Figure:
    """Draw the densities of one coordinate: deterministic as lines, sampled as points with bars.

    Several curves are distinguished by colour, and their routes by dashes; the routes of a single
    curve have their own colours, too. ``figure`` None: a new one.
    """
    figure = figure or Figure()
    axes = figure.subplots()
    colours = dict(zip((c.label for c in curves), cycle(COLOURS), strict=False))
    alone = len(curves) == 1
    legend: dict[str, Artist] = {}
    if not alone:
        legend |= {w: Line2D([], [], color=c, linewidth=3) for w, c in colours.items()}
    for curve in curves:
        functions = lines_of(curve, observable).items()
        for (route, density), dashes in zip(functions, LINES, strict=False):
            colour, ink = (route.colour,) * 2 if alone else (colours[curve.label], INK)
            axes.plot(x, density(x), linestyle=dashes, color=colour)
            legend.setdefault(route.words, Line2D([], [], color=ink, linestyle=dashes))
        for route, sampled in samples_of(curve, observable).items():
            colour, ink = (route.colour,) * 2 if alone else (colours[curve.label], INK)
            mark = {**MARK, "marker": MARKS[route.solves]}
            few, middles, inside = _bins(sampled, MARKERS, x)
            error = 2.0 * few.standard_error[inside]
            axes.errorbar(middles, few.values[inside], error, color=colour, elinewidth=0.9, **mark)
            words = f"{route.words}, ±2 standard errors"
            legend.setdefault(words, Line2D([], [], color=ink, **mark))
    axes.set(xlim=(x[0], x[-1]), xlabel=words_of(observable[0]), ylabel=density_words(observable))
    axes.set_ylim(bottom=0)
    arrange(figure, HEIGHT, legend, head=0.12)
    return figure


def theory_differences(curve: Answers, observable: Observable, x: Array) -> Differences | None:
    """Return simulation − theory for every theory drawn, in two standard errors."""
    sampled = [d for r, d in samples_of(curve, observable).items() if r.solves == "full"]
    theories = lines_of(curve, observable).items()
    if not sampled or not theories:
        return None
    few, middles, inside = _bins(sampled[0], 2 * MARKERS, x)
    return middles, 2.0 * few.standard_error[inside], {
        f"simulation − {route.words}": bin_differences(few, theory)[inside]
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


def _bins(sampled: SampledDensity, count: int, x: Array) -> tuple[SampledDensity, Array, Any]:
    """About ``count`` joined bins, the middles of those between the ends of ``x``, and which."""
    few = joined(sampled, count)
    middles = 0.5 * (few.edges[0][1:] + few.edges[0][:-1])
    inside = (middles >= x[0]) & (middles <= x[-1])
    return few, middles[inside], inside
