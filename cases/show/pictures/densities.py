"""Pictures of densities: over one coordinate, of pairs, and differences of two answers."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from matplotlib.colors import LightSource, Normalize
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d import Axes3D

from cases.compare.answers import Answers
from cases.compare.compare import join_bins
from cases.show.fields import common_grid
from cases.show.pictures.draw import column_figure, contour_figure
from cases.show.pictures.panel import Curve, Field, Panel
from cases.show.pictures.style import (
    COLOURS,
    INK,
    MARKERS,
    SHOWN,
    density_words,
    lines_of,
    marker_of,
    samples_of,
    solver_pair,
    style_of,
    words_of,
)
from cases.show.variables import Axis
from fpk.answer.density import AnyDensity, bin_differences
from fpk.answer.method import Route
from fpk.answer.names import Observable, observable_name
from fpk.answer.sampled_density import SampledDensity
from fpk.numeric.arrays import Array

POINTS, MAP_POINTS, MAP_BINS = 301, 61, 40
"""Points of a curve, points an axis of a map, and about as many bins of a map that is sampled."""

MARKED = 48
"""Points of a curve that is sampled."""

TAIL = 1e-6
"""Share of the largest value at which a logarithmic scale ends."""

SAME_LINE = 0.007
"""Distance of two lines, relative to the height of a picture, that the width of a line hides."""

HEIGHT, ALONE, ROW = 2.7, 1.6, 0.9
"""Height in inches of the axes of densities, and of differences of a lone curve or one of many."""

SHEET = 72
"""Points an axis of a surface, and about as many bins where it is sampled."""

SOLVER_WORDS = (
    "Numerical error for {}: two solvers of the same equation against each other, and the errors"
    " that they state."
)
LEFT_WORDS = (
    "Simulation minus theory for {}. Inside the grey band the difference is chance; a curve that"
    " leaves it shows the averaging error where the theory is an averaged one."
)


def line_pictures(
    curves: Sequence[Answers], observable: Observable
) -> Iterator[tuple[str, str, Figure]]:
    """Yield file stem, caption and figure of all pictures over one coordinate."""
    name = observable_name(observable)
    curves = sorted(curves, key=lambda c: c.value or 0.0)
    panel = density_panel(curves, observable)
    words = "theory as lines, simulation as points and a band of two standard errors"
    words += "".join(f"; {note}" for note in coincidences(panel))
    words += "; stops shaded." if panel.stops else "."
    yield f"density_{name}", f"Density of {name}: {words}", column_figure([panel], HEIGHT)
    caption = "The same with a logarithmic scale, to a millionth of the top."
    panel = density_panel(curves, observable, log=True)
    yield f"density_{name}_log", caption, column_figure([panel], HEIGHT)
    every = [d for c in curves for d in c.densities(observable).values()]
    (x,) = common_grid(every, cut=SHOWN, count=POINTS)
    for stem, words, differences in (
        ("solver", SOLVER_WORDS, solver_differences),
        ("left", LEFT_WORDS, theory_differences),
    ):
        rows = [row for k, c in enumerate(curves) if (row := differences(c, observable, x, k))]
        if rows:
            figure = column_figure(rows, ROW if len(rows) > 1 else ALONE)
            yield f"{stem}_{name}", words.format(name), figure


def joint_pictures(curve: Answers, observable: Observable) -> Iterator[tuple[str, str, Figure]]:
    """Yield file stem, caption and figure of all pictures of a pair of coordinates."""
    name = observable_name(observable)
    stem = name.replace(",", "_")
    figure = joint_figure(curve, observable, log=fall_exponentially(observable))
    yield f"density_{stem}", f"Joint density of {name}, on common levels.", figure
    if (pair := solver_pair(curve, observable)) is not None:
        (a, first), (b, second) = pair
        axes = _axes(lines_of(curve, observable).values(), observable)
        (value, stated), (other, also) = (
            d.at(*np.meshgrid(*(axis.values for axis in axes), indexing="ij"))
            for d in (first, second)
        )
        panels = {
            f"|{a.solver} − {b.solver}|": np.abs(value - other),
            "errors that both state, added": stated + also,
        }
        top = max(float(values.max()) for values in panels.values())
        stops = stops_of([curve], observable[:1]), stops_of([curve], observable[1:])
        fields = [
            Field(
                words,
                *axes,
                values,
                logarithmic=True,
                limits=(0.0, top),
                lowest=SHOWN,
                stops=stops,
            )
            for words, values in panels.items()
        ]
        label = density_words(observable).replace("density", "difference of")
        yield f"solver_{stem}", SOLVER_WORDS.format(name), contour_figure(fields, label)
    if not fall_exponentially(observable):  # these have their largest value in a corner
        words = f"Joint density of {name} as a surface: theory, and simulation in join_bins bins."
        yield f"surface_{stem}", words, surface_figure(curve, observable)


def joint_figure(
    curve: Answers, observable: Observable, *, log: bool, figure: Figure | None = None
) -> Figure:
    """Draw the joint density of ``observable`` by every route drawn, on common levels."""
    fields = [f for f in joint_fields(curve, observable, log=log) if f.shown]
    return contour_figure(fields, density_words(observable), figure=figure)


def fall_exponentially(observable: Observable) -> bool:
    """Whether the density falls exponentially in all coordinates, as those of energies do."""
    return all(c.kind == "H" for c in observable)


def _axes(densities: Iterable[AnyDensity], observable: Observable) -> tuple[Axis, Axis]:
    """The axes of a map of the densities, their words with units."""
    x, y = (
        Axis(str(c), words_of(c), values, logarithmic=False)
        for c, values in zip(
            observable, common_grid(densities, cut=SHOWN, count=MAP_POINTS), strict=True
        )
    )
    return x, y


def stops_of(curves: Sequence[Answers], observable: Observable) -> list[float]:
    """Return the places, ascending, at which the observed displacement touches its stops.

    Those of all curves, each once; negative on the left, -0.0 without a gap.
    """
    (c,) = observable
    stops = {
        (s.sign, s.clearance)
        for curve in curves
        for s in curve.system.stops
        if c.kind == "q" and s.index == c.row
    }
    return sorted(sign * clearance for sign, clearance in sorted(stops))


def density_panel(
    curves: Sequence[Answers],
    observable: Observable,
    *,
    log: bool = False,
    every: bool = False,
    sliders: Sequence[Curve] = (),
) -> Panel:
    """Return the densities of one coordinate: of functions as lines, of samples as points.

    Several curves are groups; a lone one has the colours of its routes. ``log``: down to ``TAIL``
    of the largest value. ``every``: routes that are not drawn are there, not shown, and those that
    are have their errors and full names; ``sliders`` are further curves.
    """
    answers = [(k, r, d) for k, c in enumerate(curves) for r, d in c.densities(observable).items()]
    cut = TAIL if log else SHOWN
    (x,) = common_grid([d for *_, d in answers], cut=cut, count=POINTS)
    drawn = []
    for k, route, density in answers:
        curve = curves[k]
        shown = isinstance(density, SampledDensity) or route in lines_of(curve, observable)
        if not (shown or every):
            continue
        colour = route.colour if len(curves) == 1 else COLOURS[k % len(COLOURS)]
        own = Curve(route.words, x, x, group=curve.label, brief=route.name, colour=colour)
        if isinstance(density, SampledDensity):
            points, values, errors = points_within(density, MARKED * (1 + every), x)
            marker = marker_of(route) if len(curves) == 1 else list(MARKERS)[k % len(MARKERS)]
            own = replace(own, x=points, y=values, bar=errors, style="none", marker=marker)
            drawn.append(replace(own, bars=2, band=True))
        else:
            values, errors = density.at(x)
            own = replace(
                own,
                y=values,
                bar=errors if every else None,
                style=style_of(route),
                marker="",
                shown=shown,
            )
            drawn.append(replace(own, bars=0))
    return panel_of([*drawn, *sliders], observable, x, log=log, stops=stops_of(curves, observable))


def lone_density(density: AnyDensity, *, log: bool) -> Panel | Field:
    """Return one density with a band of ± its error, or as a map of a pair of coordinates."""
    observable, name = density.observable, density.name
    if len(observable) == 2:
        axes = _axes([density], observable)
        values = density(*np.meshgrid(*(axis.values for axis in axes), indexing="ij"))
        limits = 0.0, float(values.max())
        return Field(name, *axes, values, logarithmic=log, limits=limits, lowest=SHOWN)
    (x,) = common_grid([density], cut=TAIL if log else SHOWN, count=POINTS)
    return panel_of([Curve(name, x, *density.at(x), band=True, marker="")], observable, x, log=log)


def panel_of(
    curves: Sequence[Curve],
    observable: Observable,
    x: Array,
    *,
    log: bool,
    stops: Sequence[float] = (),
) -> Panel:
    """Return the panel of densities of one coordinate between the ends of ``x``."""
    return Panel(
        "",
        words_of(observable[0]),
        density_words(observable),
        curves,
        logarithmic=False,
        y_logarithmic=log,
        by_x=True,
        ends=(x[0], x[-1]),
        zero=True,
        lowest=TAIL if log else 0.0,
        stops=stops,
    )


def coincidences(panel: Panel) -> list[str]:
    """Return in words the lines that are nowhere further apart than the width of a line."""
    lines = [c for c in panel.curves if c.shown and c.style != "none"]
    top = max((float(np.max(c.y)) for c in lines), default=0.0)
    alike: list[list[Curve]] = []
    for line in lines:
        for others in alike:
            if np.abs(np.subtract(others[0].y, line.y)).max() <= SAME_LINE * top:
                others.append(line)
                break
        else:
            alike.append([line])
    notes = []
    for others in alike:
        groups: dict[str, list[str]] = {}
        for line in others:
            groups.setdefault(line.brief, []).append(line.group)
        if len(others) > 1:
            words = [f"{n} ({', '.join(of)})" if any(of) else n for n, of in groups.items()]
            notes.append(f"the lines of {' and '.join(words)} coincide")
    return notes


def solver_differences(
    curve: Answers, observable: Observable, x: Array, number: int
) -> Panel | None:
    """Return the difference of two solvers of one averaged equation, and the errors they state."""
    if (pair := solver_pair(curve, observable)) is None:
        return None
    (a, first), (b, second) = pair
    (value, stated), (other, also) = first.at(x), second.at(x)
    colour, name = COLOURS[number % len(COLOURS)], f"{a.solver} − {b.solver}"
    own = Curve(name, x, value - other, colour=colour, marker="")
    return _differences(curve, observable, x, [own], stated + also, "±the errors that both state")


def theory_differences(
    curve: Answers, observable: Observable, x: Array, number: int
) -> Panel | None:
    """Return simulation minus theory for every theory drawn, and two standard errors."""
    sampled = [d for r, d in samples_of(curve, observable).items() if r.solves == "full"]
    theories = lines_of(curve, observable).items()
    if not sampled or not theories:
        return None
    few = join_bins(sampled[0], 2 * MARKED)
    middles = 0.5 * (few.edges[0][1:] + few.edges[0][:-1])
    inside = (middles >= x[0]) & (middles <= x[-1])
    # Above kinks some bins are much narrower than a pixel, with few samples: no place in a curve.
    inside &= np.diff(few.edges[0]) > 1e-4 * (x[-1] - x[0])
    curves = [
        Curve(
            f"simulation − {route.name}",
            middles[inside],
            bin_differences(few, theory)[inside],
            style=style_of(route),
            colour=COLOURS[number % len(COLOURS)] if curve.label else route.colour,
            marker="",
        )
        for route, theory in theories
    ]
    allowed = 2.0 * few.standard_error[inside]
    return _differences(curve, observable, x, curves, allowed, "±2 standard errors")


def _differences(
    curve: Answers,
    observable: Observable,
    x: Array,
    curves: list[Curve],
    allowed: Array,
    words: str,
) -> Panel:
    """Differences of two answers, and the band ± ``allowed`` in which they may lie."""
    at = np.asarray(curves[0].x)
    band = Curve(words, at, 0.0 * at, allowed, style="none", band=True, colour=INK, marker="")
    label = density_words(observable).replace("density", "difference of")
    own: Any = {"logarithmic": False, "y_logarithmic": False, "ends": (x[0], x[-1])}
    return Panel(
        curve.label, words_of(observable[0]), label, [*curves, band], marks=[(0.0, "")], **own
    )


def points_within(sampled: SampledDensity, count: int, x: Array) -> tuple[Array, Array, Array]:
    """Return up to ``count`` equidistant points within ``x`` and the bins, p there and its error.

    Points at which the error exceeds the value are left out.
    """
    edges = sampled.edges[0]
    ends = np.linspace(max(x[0], edges[0]), min(x[-1], edges[-1]), count + 1)
    points = 0.5 * (ends[1:] + ends[:-1])
    value, error = sampled.at(points)
    seen = value > error
    return points[seen], value[seen], error[seen]


def joint_fields(curve: Answers, observable: Observable, *, log: bool) -> list[Field]:
    """Return the joint density of a pair by every route, on common levels; ``log``: by decades.

    A density by a function has values at points, one that is sampled those of its bins. Solvers
    that are not drawn are there, not shown.
    """
    densities = curve.densities(observable)
    drawn = lines_of(curve, observable)
    axes = _axes(densities.values(), observable)
    stops = stops_of([curve], observable[:1]), stops_of([curve], observable[1:])
    fields = []
    for route, density in densities.items():
        shown = route in drawn or route.sampled
        own = Field(route.words, *axes, np.zeros(0), brief=route.name, shown=shown, stops=stops)
        if isinstance(density, SampledDensity):
            few = join_bins(density, MAP_BINS)
            middles = [0.5 * (e[1:] + e[:-1]) for e in few.edges]
            inside = [
                (m >= a.values[0]) & (m <= a.values[-1]) for m, a in zip(middles, axes, strict=True)
            ]
            x, y = (replace(a, values=m[i]) for a, m, i in zip(axes, middles, inside, strict=True))
            values, errors = few.values[np.ix_(*inside)], few.standard_error[np.ix_(*inside)]
            fields.append(replace(own, x=x, y=y, values=values, errors=errors))
        else:
            mesh = np.meshgrid(*(axis.values for axis in axes), indexing="ij")
            values, errors = density.at(*mesh)
            fields.append(replace(own, values=values, errors=errors, smooth=True))
    top = max(float(field.values.max()) for field in fields)
    common: Any = {"logarithmic": log, "limits": (0.0, top), "lowest": SHOWN}
    return [replace(field, **common) for field in fields]


def surface_figure(curve: Answers, observable: Observable) -> Figure:
    """Draw the joint density as surfaces on the same levels: theory and simulation.

    The theory is the exact density where there is one, else an averaged one; one that neglects
    something, the contacts for example, comes last.
    """
    theories = sorted(lines_of(curve, observable).items(), key=lambda a: curve.neglects(a[0]))
    full = [a for a in samples_of(curve, observable).items() if a[0].solves == "full"]
    drawn: dict[Route, AnyDensity] = dict([*theories[:1], *full])
    x, y = np.meshgrid(*common_grid(drawn.values(), cut=SHOWN, count=SHEET), indexing="ij")
    sheets = {
        route.name: (join_bins(d, SHEET) if isinstance(d, SampledDensity) else d)(x, y)
        for route, d in drawn.items()
    }
    top = max(float(values.max()) for values in sheets.values())
    figure = Figure(figsize=(4.4, 3.6 * len(sheets)))
    for place, (words, values) in enumerate(sheets.items(), start=1):
        axes = figure.add_subplot(len(sheets), 1, place, projection="3d", proj_type="ortho")
        assert isinstance(axes, Axes3D)
        axes.view_init(elev=28.0, azim=-58.0)
        axes.set_box_aspect((1.0, 1.0, 0.72), zoom=0.92)  # beyond it labels are cut
        x_words, y_words = map(words_of, observable)
        axes.set(xlabel=x_words, ylabel=y_words, zlabel=density_words(observable))
        axes.set_zlim(0.0, 1.05 * top)
        axes.locator_params(nbins=5)
        sheet = axes.plot_surface(
            x, y, values, cmap="viridis", norm=Normalize(0.0, top), rcount=SHEET, ccount=SHEET,
            lightsource=LightSource(azdeg=225, altdeg=50), linewidth=0, antialiased=False,
        )  # fmt: skip
        sheet.set_rasterized(True)
        axes.set_title(words, y=0.96, loc="left", x=0.05)
    figure.subplots_adjust(left=0.0, right=0.92, bottom=0.04, top=0.98, hspace=0.06)
    return figure
