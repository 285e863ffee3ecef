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

POINTS, MAP_POINTS, SHEET = 301, 61, 72
"""Points of a curve, and points an axis of a map and of a surface."""

MARKED, MAP_BINS = 48, 40
"""Points drawn of a sampled density of one coordinate; bins on each axis of a sampled map."""

LOG_TAIL = 1e-6
"""Share of the largest density below which a logarithmic axis shows nothing."""

HEIGHT, ALONE, ROW = 2.7, 1.6, 0.9
"""Height in inches of the axes of densities, and of differences of a lone curve or one of many."""

CAPTIONS = {
    "solver": "Numerical error for {}: two solvers of the same equation against each other, and the"
    " errors that they state.",
    "left": "Simulation minus theory for {}. Inside the grey band the difference is chance; a curve"
    " that leaves it shows the averaging error where the theory is an averaged one.",
}
"""Captions of the pictures of differences, by the first word of their files."""


def line_pictures(
    curves: Sequence[Answers], observable: Observable
) -> Iterator[tuple[str, str, Figure]]:
    """Yield file name without ending, caption and figure of all pictures over one coordinate.

    The densities, linear (``density_q2``) and logarithmic (``density_q2_log``), and, if not None,
    ``solver_differences`` (``solver_q2``) and ``theory_differences`` (``left_q2``).
    """
    name = observable_name(observable)
    curves = sorted(curves, key=lambda c: c.value or 0.0)
    panel = density_panel(curves, observable)
    words = "theory as lines, simulation as points and a band of two standard errors"
    words += "".join(f"; {note}" for note in panel.coincidences())
    words += "; stops shaded." if panel.stops else "."
    yield f"density_{name}", f"Density of {name}: {words}", column_figure([panel], HEIGHT)
    caption = "The same with a logarithmic scale, to a millionth of the top."
    panel = density_panel(curves, observable, log=True)
    yield f"density_{name}_log", caption, column_figure([panel], HEIGHT)
    every = [d for c in curves for d in c.densities(observable).values()]
    (x,) = common_grid(every, cut=SHOWN, count=POINTS)
    for stem, differences in (("solver", solver_differences), ("left", theory_differences)):
        drawn = [differences(c, observable, x, k) for k, c in enumerate(curves)]
        if rows := [row for row in drawn if row is not None]:
            figure = column_figure(rows, ROW if len(rows) > 1 else ALONE)
            yield f"{stem}_{name}", CAPTIONS[stem].format(name), figure


def joint_pictures(curve: Answers, observable: Observable) -> Iterator[tuple[str, str, Figure]]:
    """Yield file name without ending, caption and figure of all pictures of a pair.

    Contours (``density_q2_p2``), differences of the ``solver_pair``, if any (``solver_…``),
    and surfaces unless ``fall_exponentially`` (``surface_…``).
    """
    name = observable_name(observable)
    stem, log = name.replace(",", "_"), fall_exponentially(observable)
    figure = joint_figure(curve, observable, log=log)
    yield f"density_{stem}", f"Joint density of {name}, on common levels.", figure
    if (pair := solver_pair(curve, observable)) is not None:
        (a, first), (b, second) = pair
        axes, mesh = _map_axes(lines_of(curve, observable).values(), observable)
        (value, stated), (other, also) = first.at(*mesh), second.at(*mesh)
        panels = {
            f"|{a.solver} − {b.solver}|": np.abs(value - other),
            "errors that both state, added": stated + also,
        }
        fields = [Field(words, *axes, values) for words, values in panels.items()]
        fields = _on_common_levels(fields, observable, [curve], log=True)
        label = density_words(observable, difference=True)
        yield f"solver_{stem}", CAPTIONS["solver"].format(name), contour_figure(fields, label)
    if not log:  # a density that falls exponentially has its largest value in a corner
        words = f"Joint density of {name} as a surface: theory, and simulation in joined bins."
        yield f"surface_{stem}", words, surface_figure(curve, observable)


def joint_figure(
    curve: Answers, observable: Observable, *, log: bool, figure: Figure | None = None
) -> Figure:
    """Draw contours by every route drawn, on common levels, logarithmic with ``log``.

    ``figure`` None: in a new figure.
    """
    fields = [f for f in joint_fields(curve, observable, log=log) if f.shown]
    return contour_figure(fields, density_words(observable), figure=figure)


def fall_exponentially(observable: Observable) -> bool:
    """Whether the density falls exponentially in all coordinates, as densities of energies do."""
    return all(c.kind == "H" for c in observable)


def stops_of(curves: Sequence[Answers], observable: Observable) -> list[float]:
    """Return the places, ascending, at which the observed displacement touches its stops.

    The stops of all curves, each once: −clearance of a left stop, -0.0 without a gap. Empty unless
    the observable is a displacement; raises ``ValueError`` for a pair.
    """
    (c,) = observable
    every = [s for curve in curves for s in curve.system.stops if c.kind == "q"]
    places = {(stop.sign, stop.clearance) for stop in every if stop.index == c.row}
    return sorted(sign * clearance for sign, clearance in sorted(places))


def density_panel(
    curves: Sequence[Answers],
    observable: Observable,
    *,
    log: bool = False,
    every: bool = False,
    sliders: Sequence[Curve] = (),
) -> Panel:
    """Return the densities of one coordinate: of functions as lines, of samples as points.

    Several curves are groups; a single curve has the colours of its routes. ``log``: down to
    ``LOG_TAIL`` of the largest value. ``every``: the page's panel, which also has the routes that
    are not drawn, the errors of functions and twice as many points of samples; ``sliders`` are
    further curves.
    """
    answers = [(k, r, d) for k, c in enumerate(curves) for r, d in c.densities(observable).items()]
    (x,) = common_grid([d for *_, d in answers], cut=LOG_TAIL if log else SHOWN, count=POINTS)
    alone, drawn = len(curves) == 1, []
    for k, route, density in answers:
        colour = route.colour if alone else COLOURS[k % len(COLOURS)]
        own = Curve(route.words, x, x, group=curves[k].label, brief=route.name, colour=colour)
        if isinstance(density, SampledDensity):
            points, values, errors = points_within(density, MARKED * (1 + every), x)
            own = replace(own, x=points, y=values, bar=errors, bars=2, band=True, style="none")
            marker = marker_of(route) if alone else list(MARKERS)[k % len(MARKERS)]
            drawn.append(replace(own, marker=marker))
        elif (shown := route in lines_of(curves[k], observable)) or every:
            values, errors = density.at(x) if every else (density(x), np.zeros_like(x))
            own = replace(own, y=values, bar=errors, bars=0, style=style_of(route), marker="")
            drawn.append(replace(own, shown=shown))
    return panel_of([*drawn, *sliders], observable, log=log, stops=stops_of(curves, observable))


def panel_of(
    curves: Sequence[Curve], observable: Observable, *, log: bool, stops: Sequence[float] = ()
) -> Panel:
    """Return the panel of densities with ``stops``; ``log``: down to ``LOG_TAIL``, else from 0."""
    scales: Any = {"logarithmic": False, "y_logarithmic": log, "lowest": LOG_TAIL if log else 0.0}
    words = words_of(observable[0]), density_words(observable)
    return Panel("", *words, curves, **scales, by_x=True, zero=True, stops=stops)


def lone_density(density: AnyDensity, *, log: bool) -> Panel | Field:
    """Return one density ± its error, or a map of a pair; ``log``: on a logarithmic scale."""
    observable, name = density.observable, density.name
    if len(observable) == 2:
        axes, mesh = _map_axes([density], observable)
        return _on_common_levels([Field(name, *axes, density(*mesh))], observable, [], log=log)[0]
    (x,) = common_grid([density], cut=LOG_TAIL if log else SHOWN, count=POINTS)
    return panel_of([Curve(name, x, *density.at(x), band=True, marker="")], observable, log=log)


def solver_differences(
    curve: Answers, observable: Observable, x: Array, number: int
) -> Panel | None:
    """Return the difference at ``x`` of two solvers of one averaged equation, and a band.

    The solver with the smaller L1 error is subtracted. The band is ± the sum of their errors. None
    if no equation has two solvers here. ``number`` of the curve, from 0, gives its colour.
    """
    if (pair := solver_pair(curve, observable)) is None:
        return None
    (a, first), (b, second) = pair
    (value, stated), (other, also) = first.at(x), second.at(x)
    name, colour = f"{a.solver} − {b.solver}", COLOURS[number % len(COLOURS)]
    curves = [Curve(name, x, value - other, colour=colour, marker="")]
    return _differences(curve, observable, curves, stated + also, "±the errors that both state")


def theory_differences(
    curve: Answers, observable: Observable, x: Array, number: int
) -> Panel | None:
    """Return simulation minus theory in the bins within ``x``, and a band of ± 2 standard errors.

    There is a curve for every theory in ``lines_of``. None without these or without a simulation of
    the full system. ``number`` of the curve, from 0, gives the colour if a scene has several.
    """
    sampled = [d for r, d in samples_of(curve, observable).items() if r.solves == "full"]
    theories = lines_of(curve, observable).items()
    if not sampled or not theories:
        return None
    few = join_bins(sampled[0], 2 * MARKED)
    middles = 0.5 * (few.edges[0][1:] + few.edges[0][:-1])
    inside = (middles >= x[0]) & (middles <= x[-1])
    # Above kinks some bins are much narrower than a pixel, with few samples: no place in a curve.
    inside &= np.diff(few.edges[0]) > 1e-4 * (x[-1] - x[0])
    curves = []
    for route, theory in theories:
        name, values = f"simulation − {route.name}", bin_differences(few, theory)[inside]
        colour = COLOURS[number % len(COLOURS)] if curve.label else route.colour
        own = Curve(name, middles[inside], values, colour=colour, marker="")
        curves.append(replace(own, style=style_of(route)))
    allowed = 2.0 * few.standard_error[inside]
    return _differences(curve, observable, curves, allowed, "±2 standard errors")


def _differences(
    curve: Answers, observable: Observable, curves: list[Curve], allowed: Array, words: str
) -> Panel:
    """The panel of ``curves``, all at one x, and a band ± ``allowed`` around 0, named ``words``."""
    x = np.asarray(curves[0].x)
    band = Curve(words, x, 0.0 * x, allowed, style="none", band=True, colour=INK, marker="")
    labels = words_of(observable[0]), density_words(observable, difference=True)
    linear: Any = {"logarithmic": False, "y_logarithmic": False, "by_x": True}
    return Panel(curve.label, *labels, [*curves, band], marks=[(0.0, "")], **linear)


def points_within(sampled: SampledDensity, count: int, x: Array) -> tuple[Array, Array, Array]:
    """Return points, p there and one standard error, at up to ``count`` equidistant points.

    They lie within the bins and between the first and last of ``x``; points at which the error is
    not below p are left out.
    """
    edges = sampled.edges[0]
    ends = np.linspace(max(x[0], edges[0]), min(x[-1], edges[-1]), count + 1)
    points = 0.5 * (ends[1:] + ends[:-1])
    value, error = sampled.at(points)
    seen = value > error
    return points[seen], value[seen], error[seen]


def joint_fields(curve: Answers, observable: Observable, *, log: bool) -> list[Field]:
    """Return the joint density of a pair by every route, on common levels; ``log``: logarithmic.

    A function has values at points, a sample the values of its bins. Functions that ``lines_of``
    leaves out, such as second solvers of an equation, have ``shown`` False.
    """
    densities = curve.densities(observable)
    drawn = lines_of(curve, observable)
    axes, mesh = _map_axes(densities.values(), observable)
    fields = []
    for route, density in densities.items():
        own = Field(route.words, *axes, np.zeros(0), brief=route.name)
        if isinstance(density, SampledDensity):
            few = join_bins(density, MAP_BINS)
            middles = [0.5 * (e[1:] + e[:-1]) for e in few.edges]
            ends = [(a.values[0], a.values[-1]) for a in axes]
            inside = [(m >= e[0]) & (m <= e[1]) for m, e in zip(middles, ends, strict=True)]
            own = replace(own, x=replace(axes[0], values=middles[0][inside[0]]))
            own = replace(own, y=replace(axes[1], values=middles[1][inside[1]]))
            values, errors = few.values[np.ix_(*inside)], few.standard_error[np.ix_(*inside)]
        else:
            values, errors = density.at(*mesh)
            own = replace(own, smooth=True, shown=route in drawn)
        fields.append(replace(own, values=values, errors=errors))
    return _on_common_levels(fields, observable, [curve], log=log)


def _map_axes(
    densities: Iterable[AnyDensity], observable: Observable
) -> tuple[tuple[Axis, Axis], list[Array]]:
    """The two axes of a map of the densities, and their mesh: two arrays (x, y)."""
    grid = common_grid(densities, cut=SHOWN, count=MAP_POINTS)
    x, y = (Axis(str(c), words_of(c), g, False) for c, g in zip(observable, grid, strict=True))
    return (x, y), list(np.meshgrid(*grid, indexing="ij"))


def _on_common_levels(
    fields: list[Field], observable: Observable, curves: Sequence[Answers], *, log: bool
) -> list[Field]:
    """Copies of the fields: limits 0 and the largest value, ``lowest``, the stops of ``curves``."""
    stops = stops_of(curves, observable[:1]), stops_of(curves, observable[1:])
    limits = 0.0, max(float(field.values.max()) for field in fields)
    own: Any = {"logarithmic": log, "limits": limits, "lowest": SHOWN, "stops": stops}
    return [replace(field, **own) for field in fields]


def surface_figure(curve: Answers, observable: Observable) -> Figure:
    """Draw the joint density as surfaces of the same height scale: one theory and simulations.

    The theory is a solution of the full system if there is one, else an averaged theory; theories
    that neglect something, the contacts for example, come last. The simulations are of the full
    system.
    """
    theories = sorted(lines_of(curve, observable).items(), key=lambda a: curve.neglects(a[0]))
    full = [a for a in samples_of(curve, observable).items() if a[0].solves == "full"]
    drawn: dict[Route, AnyDensity] = dict([*theories[:1], *full])
    grid = common_grid(drawn.values(), cut=SHOWN, count=SHEET)
    x, y = np.meshgrid(*grid, indexing="ij")
    sheets = {
        route.name: (join_bins(d, SHEET) if isinstance(d, SampledDensity) else d)(x, y)
        for route, d in drawn.items()
    }
    top = max(float(values.max()) for values in sheets.values())
    figure = Figure(figsize=(4.4, 3.6 * len(sheets)))
    light = LightSource(azdeg=225, altdeg=50)
    look: Any = {"cmap": "viridis", "norm": Normalize(0.0, top), "lightsource": light}
    for place, (words, values) in enumerate(sheets.items(), start=1):
        axes = figure.add_subplot(len(sheets), 1, place, projection="3d", proj_type="ortho")
        assert isinstance(axes, Axes3D)
        axes.view_init(elev=28.0, azim=-58.0)
        axes.set_box_aspect((1.0, 1.0, 0.72), zoom=0.92)  # beyond it labels are cut
        x_words, y_words = map(words_of, observable)
        axes.set(xlabel=x_words, ylabel=y_words, zlabel=density_words(observable))
        axes.set_zlim(0.0, 1.05 * top)
        axes.locator_params(nbins=5)
        size: Any = {"rcount": SHEET, "ccount": SHEET, "linewidth": 0, "antialiased": False}
        axes.plot_surface(x, y, values, **size, **look).set_rasterized(True)
        axes.set_title(words, y=0.96, loc="left", x=0.05)
    figure.subplots_adjust(left=0.0, right=0.92, bottom=0.04, top=0.98, hspace=0.06)
    return figure
