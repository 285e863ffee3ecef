"""Pictures of an outcome, as matplotlib figures: densities, solver differences, what is left."""

from collections.abc import Iterator, Mapping
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from cases.compare import FULL
from cases.fields import common_grid, values_on
from cases.run import CurveOutcome, Outcome
from fpk.density import AnyDensity, Array, Density, SampledDensity, bin_differences
from fpk.observable import Coordinate, Observable, observable_name

INK = "#1a1b1e"
"""Colour of text and axes; the report replaces it by that of the page's text."""

COLOURS = ("#2878b5", "#d1603d", "#2a9d6f", "#9a6fc0", "#c08a1e", "#5b8def", "#a8577e")
"""Told apart by colour-blind readers, and legible on white and on black."""

STYLE: Any = {
    "font.family": "DejaVu Sans",
    "font.size": 9.5,
    "mathtext.fontset": "dejavusans",
    "axes.facecolor": "none",
    "axes.formatter.use_mathtext": True,
    "axes.edgecolor": INK,
    "axes.labelcolor": INK,
    "axes.titlecolor": INK,
    "axes.titlesize": 9.5,
    "axes.titlelocation": "left",
    "axes.linewidth": 0.7,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "text.color": INK,
    "xtick.color": INK,
    "ytick.color": INK,
    "xtick.direction": "in",
    "ytick.direction": "in",
    "legend.frameon": False,
    "legend.fontsize": 8.5,
    "lines.linewidth": 1.6,
    "svg.fonttype": "path",
}

MARKERS, SHOWN = 56, 1e-3
"""Bins drawn as points; share of the largest value below which a linear axis shows nothing."""

THEORIES = {
    "exact": "exact, Eq. (7)",
    "linear": "Gaussian, exact without contact",
    "nonintegrable/closed-form": "averaging, Eq. (11)",
    "integrable/closed-form": "averaging, Eq. (34)",
}
LINES: Any = ("-", (0, (6, 2)), (0, (6, 2, 1, 2)), (0, (1, 1)))


def figures(outcome: Outcome) -> Iterator[tuple[str, str, Figure]]:
    """Yield file stem, caption and figure of everything that an outcome can show."""
    with mpl.rc_context(dict(STYLE)):
        for observable in outcome.scene.observables:
            curves = [c for c in outcome.curves if c.densities(observable)]
            own_first, curves = curves, sorted(curves, key=lambda c: _number(c.label))
            if not curves:
                continue
            name = observable_name(observable)
            stem = name.replace(",", "_")
            if len(observable) == 2:
                yield f"density_{stem}", _pair_caption(name), pair_figure(own_first[0], observable)
                continue
            yield f"density_{stem}", _density_caption(name), density_figure(curves, observable)
            if any(_both(c, observable, "fem") for c in curves):
                yield f"solver_{stem}", _solver_caption(name), solver_figure(curves, observable)
            if any(_both(c, observable, "montecarlo") for c in curves):
                yield f"left_{stem}", _left_caption(name), left_figure(curves, observable)


def density_figure(curves: list[CurveOutcome], observable: Observable) -> Figure:
    """Draw the densities of one coordinate: theory as lines, simulation as points with bars."""
    figure, axes = _figure(4.2)
    drawn: dict[str, Line2D] = {}
    ends = []
    for curve, colour in zip(curves, _cycle(COLOURS), strict=False):
        found = curve.densities(observable)
        lines = [r for r in THEORIES if r in found and not _coincides(r, found, curve)]
        if "exact" in lines and "linear" in lines:
            lines.remove("linear")
        x = np.linspace(*_shown(found), 600)
        ends.append((x[0], x[-1]))
        for route, dashes in zip(lines, LINES, strict=False):
            axes.plot(x, values_on(found[route], x)[0], color=colour, linestyle=dashes)
            drawn.setdefault(THEORIES[route], Line2D([], [], color=INK, linestyle=dashes))
        if "nonintegrable/fem" in found:
            y = values_on(found["nonintegrable/fem"], x)[0]
            axes.plot(x, y, color=INK, linewidth=0.9, linestyle=(0, (1, 2.5)), zorder=4)
            dots = Line2D([], [], color=INK, linewidth=0.9, linestyle=(0, (1, 2.5)))
            drawn.setdefault("finite elements", dots)
        sampled = found.get("montecarlo")
        if isinstance(sampled, SampledDensity):
            _points(axes, sampled, colour, x)
            words = "simulation, ±2 standard errors"
            drawn.setdefault(
                words, Line2D([], [], color=INK, marker="o", markersize=3.4, **_HOLLOW)
            )
    axes.set_xlim(min(e[0] for e in ends), max(e[1] for e in ends))
    axes.set_ylim(bottom=0)
    _labels(axes, observable[0])
    handles, labels = list(drawn.values()), list(drawn)
    if len(curves) > 1:
        colours = [c for _, c in zip(curves, _cycle(COLOURS), strict=False)]
        handles = [Line2D([], [], color=c, linewidth=3) for c in colours] + handles
        labels = [curve.label for curve in curves] + labels
    figure.legend(handles, labels, loc="outside upper left", ncols=3, columnspacing=1.6)
    return figure


def solver_figure(curves: list[CurveOutcome], observable: Observable) -> Figure:
    """Draw |finite elements − closed form| and the error that the solver states, log scale."""
    figure, axes = _figure(3.4)
    for curve, colour in zip(curves, _cycle(COLOURS), strict=False):
        pair = _both(curve, observable, "fem")
        if pair is None:
            continue
        x = np.linspace(*_shown(curve.densities(observable)), 500)
        fem, estimate = values_on(pair[0], x)
        difference = np.abs(fem - values_on(pair[1], x)[0])
        axes.plot(
            x, _positive(difference), color=colour, linewidth=1.0, label=curve.label or "difference"
        )
        axes.plot(x, _positive(estimate), color=colour, linewidth=1.4, linestyle=(0, (6, 2)))
    axes.set_yscale("log")
    handles, labels = axes.get_legend_handles_labels()
    handles += [
        Line2D([], [], color=INK, linewidth=1),
        Line2D([], [], color=INK, linestyle=(0, (6, 2))),
    ]
    labels += ["|finite elements − closed form|", "error the solver states"]
    if len(curves) == 1:
        handles, labels = handles[1:], labels[1:]
    figure.legend(handles, labels, loc="outside upper left", ncols=3, columnspacing=1.6)
    _labels(axes, observable[0], "difference of $p$")
    return figure


def left_figure(curves: list[CurveOutcome], observable: Observable) -> Figure:
    """Draw simulation − theory for each curve with the band of chance around zero."""
    pairs = [(c, p) for c in curves if (p := _both(c, observable, "montecarlo")) is not None]
    figure = Figure(figsize=(6.6, 0.9 + 1.35 * len(pairs)), layout="constrained")
    rows = figure.subplots(len(pairs), 1, sharex=True, squeeze=False)[:, 0]
    for axes, (curve, (sampled, theory)) in zip(rows, pairs, strict=True):
        assert isinstance(sampled, SampledDensity)
        colour = COLOURS[curves.index(curve) % len(COLOURS)]
        joined = _joined(sampled, 2 * MARKERS)
        x = _middles(joined)
        shown = _within(x, _shown(curve.densities(observable)))
        difference, error = bin_differences(joined, theory), joined.standard_error
        axes.fill_between(
            x[shown], -2 * error[shown], 2 * error[shown], color=INK, alpha=0.16, lw=0
        )
        axes.axhline(0.0, color=INK, linewidth=0.7)
        axes.plot(x[shown], difference[shown], color=colour, linewidth=1.2)
        axes.set_title(curve.label)
        axes.ticklabel_format(axis="y", style="sci", scilimits=(-2, 2))
    handles = [
        Line2D([], [], color=COLOURS[0], linewidth=1.2),
        Line2D([], [], color=INK, alpha=0.16, lw=6),
    ]
    theory_words = (
        "exact" if any("exact" in c.densities(observable) for c in curves) else "averaging"
    )
    figure.legend(
        handles,
        [f"simulation − {theory_words}", "±2 standard errors"],
        loc="outside upper left",
        ncols=2,
    )
    figure.supylabel(f"difference of $p({_symbol(observable[0])})$", fontsize=9.5)
    rows[-1].set_xlabel(_long(observable[0]))
    return figure


def pair_figure(curve: CurveOutcome, observable: Observable) -> Figure:
    """Draw a joint density by theory and by simulation, side by side on common levels."""
    found = curve.densities(observable)
    names = [r for r in (*THEORIES, "montecarlo") if r in found and not _coincides(r, found, curve)]
    figure = Figure(figsize=(3.4 * len(names) + 0.6, 3.2), layout="constrained")
    grid = common_grid({r: found[r] for r in names}, cut=SHOWN)
    values = {r: values_on(found[r], *np.meshgrid(*grid, indexing="ij"))[0] for r in names}
    top = max(float(v.max()) for v in values.values())
    panels = figure.subplots(1, len(names), sharex=True, sharey=True, squeeze=False)[0]
    for axes, route in zip(panels, names, strict=True):
        filled = axes.contourf(
            *grid, values[route].T, levels=np.linspace(0, top, 13), cmap="viridis"
        )
        axes.set_title(THEORIES.get(route, "simulation"))
        axes.set_xlabel(_long(observable[0]))
    panels[0].set_ylabel(_long(observable[1]))
    bar = figure.colorbar(filled, ax=list(panels), shrink=0.9, format="%.2f")
    bar.set_label(f"density $p({_symbol(observable[0])}, {_symbol(observable[1])})$")
    return figure


_HOLLOW: Mapping[str, Any] = {
    "linestyle": "none",
    "markerfacecolor": "none",
    "markeredgewidth": 0.9,
}


def _points(axes: Axes, sampled: SampledDensity, colour: str, x: Array) -> None:
    joined = _joined(sampled, MARKERS)
    middle = _middles(joined)
    shown = _within(middle, (float(x[0]), float(x[-1])))
    middle, value, error = middle[shown], joined.values[shown], 2 * joined.standard_error[shown]
    axes.errorbar(
        middle, value, error, color=colour, fmt="o", markersize=3.4, elinewidth=0.9,
        markerfacecolor="none", markeredgewidth=0.9,
    )  # fmt: skip


def _both(
    curve: CurveOutcome, observable: Observable, other: str
) -> tuple[AnyDensity, Density] | None:
    """The answer by finite elements or simulation, and the best theory to hold against it."""
    found = curve.densities(observable)
    first = found.get("montecarlo" if other == "montecarlo" else f"nonintegrable/{other}")
    best = (
        ("nonintegrable/closed-form",) if other == "fem" else (*FULL, "nonintegrable/closed-form")
    )
    second = next((found[r] for r in best if r in found), None)
    return (first, second) if first is not None and isinstance(second, Density) else None


def _coincides(route: str, found: Mapping[str, AnyDensity], curve: CurveOutcome) -> bool:
    return (
        route.startswith("nonintegrable") and "exact" in found and curve.regime.incompatible is None
    )


def _shown(found: Mapping[str, AnyDensity]) -> tuple[float, float]:
    """Where any of the densities exceeds ``SHOWN`` of its largest value."""
    x = common_grid(found)[0]
    counts = np.zeros(x.size, dtype=bool)
    for density in found.values():
        value = values_on(density, x)[0]
        counts |= value > SHOWN * value.max()
    inside = np.flatnonzero(counts)
    return float(x[max(inside[0] - 1, 0)]), float(x[min(inside[-1] + 1, x.size - 1)])


def _joined(sampled: SampledDensity, wanted: int) -> SampledDensity:
    """Join bins until about ``wanted`` are left where the density counts."""
    heavy = int(np.count_nonzero(sampled.values > SHOWN * sampled.values.max()))
    bins = sampled.edges[0].size - 1
    factors = [f for f in range(1, max(heavy // wanted, 1) + 1) if bins % f == 0]
    return sampled.coarsened(max(factors))


def _middles(sampled: SampledDensity) -> Array:
    edges = sampled.edges[0]
    middles: Array = 0.5 * (edges[1:] + edges[:-1])
    return middles


def _within(x: Array, ends: tuple[float, float]) -> Any:
    return (x >= ends[0]) & (x <= ends[1])


def _positive(values: Array) -> Array:
    """Leave out what a log scale cannot show."""
    return np.where(values > 1e-19, values, np.nan)


def _figure(height: float) -> tuple[Figure, Axes]:
    figure = Figure(figsize=(6.6, height), layout="constrained")
    return figure, figure.subplots()


def _labels(axes: Axes, coordinate: Coordinate, y: str | None = None) -> None:
    axes.set_xlabel(_long(coordinate))
    axes.set_ylabel(y or f"density $p({_symbol(coordinate)})$")


def _symbol(coordinate: Coordinate) -> str:
    return (
        coordinate.kind
        if coordinate.index is None
        else f"{coordinate.kind}_{{{coordinate.index + 1}}}"
    )


def _long(coordinate: Coordinate) -> str:
    words = {"q": "displacement", "p": "momentum", "H": "energy"}[coordinate.kind]
    modal = "modal " if coordinate.kind == "H" and coordinate.index is not None else ""
    return f"{modal}{words} ${_symbol(coordinate)}$"


def _cycle(colours: tuple[str, ...]) -> Iterator[str]:
    while True:
        yield from colours


def _number(label: str) -> float:
    """The first number of a label such as ``D = (0.01, 0.02)``, to order a legend by."""
    text = label.partition("=")[2].strip(" (").split(",")[0].rstrip(")")
    try:
        return float(text)
    except ValueError:
        return 0.0


def _density_caption(name: str) -> str:
    return f"Density of {name}: theory as lines, simulation as points with two standard errors."


def _solver_caption(name: str) -> str:
    return (
        f"Numerical error for {name}: the finite element answer against the closed form of the same"
        " equation, and what the solver said its error would be."
    )


def _left_caption(name: str) -> str:
    return (
        f"What is left for {name} between simulation and theory. Inside the grey band it is chance;"
        " a curve that leaves it shows the averaging error where the theory is an averaged one."
    )


def _pair_caption(name: str) -> str:
    return f"Joint density of {name}, on common levels."
