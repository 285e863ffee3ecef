"""Style of all pictures: ink and colours, words for axes, margins; which answers are drawn."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from itertools import combinations
from pathlib import Path
from typing import Any

from matplotlib import rc_params_from_file
from matplotlib.artist import Artist
from matplotlib.figure import Figure

from cases.compare.answers import Answers
from cases.scene.units import NO_UNITS, Units, bracketed
from fpk.answer.density import Density
from fpk.answer.method import Route
from fpk.answer.names import Coordinate, Observable
from fpk.answer.sampled_density import SampledDensity
from fpk.numeric.arrays import Array

STYLE: Any = rc_params_from_file(
    Path(__file__).with_name("fpk.mplstyle"), use_default_template=False
)
"""Settings of matplotlib in all pictures."""

INK: str = STYLE["text.color"]
"""Colour of text and axes; the report replaces it by that of the page's text."""

COLOURS = ("#00a688", "#e07500", "#5e02e0", "#601626", "#056c66", "#b50c01", "#b86cfa")
DARK = ("#00fdd3", "#fab034", "#9447e3", "#546f00", "#14a697", "#ff1b74", "#ceacff")
"""Colours of curves and routes on a light page, and those that take their places on a dark one: any
two of a row differ by more than 20 by CIE76 and by CIEDE2000, in normal vision and in its three
deficiencies, and have a contrast of 3 or more with the page. Seven that do so on both pages do not
exist by a search: 18 is the best."""

SHOWN = 1e-3
"""Share of the largest value below which a linear axis shows nothing."""

WIDTH = 4.4
"""Width of a picture with one column of axes, in inches: legible on a telephone."""

LEFT, RIGHT, FOOT, GAP, LEGEND_ROW = 0.66, 0.12, 0.5, 0.34, 0.19
"""Margins beside and below the axes, the gap between two for a title, and the height of a row of
the legend, in inches. Fixed: to measure all words first draws every picture twice."""

LONGEST_OF_TWO = 27
"""Letters of the longest entry with which a legend of two columns fits."""

SOLVER_WORDS = (
    "Numerical error for {}: two solvers of the same equation against each other, and the errors"
    " that they state."
)
"""Caption of the differences of two solvers of an observable."""

SUBSCRIPTS = str.maketrans("0123456789", "₀₁₂₃₄₅₆₇₈₉")

Differences = tuple[Array, Array, dict[str, Array]]
"""Points along the first axis, the band in which differences of two answers may lie, and these."""


def arrange(figure: Figure, height: float, legend: Mapping[str, Artist], *, head: float) -> None:
    """Size a figure of one column of axes, ``height`` inches each, and put its legend above.

    ``legend`` has the handles by their words; ``head`` is the space below it in inches.
    """
    rows = len(figure.axes)
    columns = 2 if max(map(len, legend)) <= LONGEST_OF_TWO else 1
    head += LEGEND_ROW * -(-len(legend) // columns)
    total = head + rows * height + (rows - 1) * GAP + FOOT
    figure.set_size_inches(WIDTH, total)
    figure.subplots_adjust(
        LEFT / WIDTH, FOOT / total, 1.0 - RIGHT / WIDTH, 1.0 - head / total, hspace=GAP / height
    )
    figure.legend(
        list(legend.values()), list(legend), loc="upper left", ncols=columns, columnspacing=1.6,
        borderaxespad=0.2,
    )  # fmt: skip


SHOWN_UNITS: ContextVar[Units] = ContextVar("SHOWN_UNITS", default=NO_UNITS)
"""Units of the scene whose pictures are being drawn, as the style of matplotlib is set for them."""


@contextmanager
def in_units(units: Units) -> Iterator[None]:
    """Return a context in which the axes of pictures say these units."""
    token = SHOWN_UNITS.set(units)
    try:
        yield
    finally:
        SHOWN_UNITS.reset(token)


def density_words(observable: Observable) -> str:
    """Return the words for an axis of the density, as ``density p(q₂) [mm⁻¹]``."""
    unit = bracketed(SHOWN_UNITS.get().density(observable))
    return f"density p({', '.join(map(symbol_of, observable))}){unit}"


def time_words() -> str:
    """Return the words for an axis of time."""
    return f"time t{bracketed(SHOWN_UNITS.get().time)}"


def symbol_of(coordinate: Coordinate) -> str:
    """Return the coordinate with its index as a subscript."""
    return str(coordinate).translate(SUBSCRIPTS)


def words_of(coordinate: Coordinate) -> str:
    """Return the coordinate in words with its symbol and its unit."""
    words = {"q": "displacement", "p": "momentum", "H": "energy"}[coordinate.kind]
    modal = "modal " if coordinate.kind == "H" and coordinate.index is not None else ""
    unit = bracketed(SHOWN_UNITS.get().coordinate(coordinate))
    return f"{modal}{words} {symbol_of(coordinate)}{unit}"


def lines_of(curve: Answers, observable: Observable) -> dict[Route, Density]:
    """Return the densities drawn as lines: an exact one, and of each averaged method its first.

    An averaged method that is exact itself is not drawn beside the exact density.
    """
    drawn: dict[str, tuple[Route, Density]] = {}
    for route, density in curve.densities(observable).items():
        full = route.solves == "full"
        if isinstance(density, Density) and (full or "" not in drawn or not curve.is_exact(route)):
            drawn.setdefault("" if full else route.method, (route, density))
    return dict(drawn.values())


def samples_of(curve: Answers, observable: Observable) -> dict[Route, SampledDensity]:
    """Return the histograms of one observable, that of the full system first."""
    densities = curve.densities(observable).items()
    return {route: d for route, d in densities if isinstance(d, SampledDensity)}


def solver_difference(curve: Answers, observable: Observable, *points: Array) -> Differences | None:
    """Return how far two solvers of one averaged equation differ; the band is what both state.

    None where no equation has two deterministic answers. The one that states the larger error comes
    first.
    """
    answers = curve.densities(observable).items()
    functions = [(r, d) for r, d in answers if r.solves == "averaged" and isinstance(d, Density)]
    for pair in combinations(functions, 2):
        (a, first), (b, second) = sorted(pair, key=lambda answer: -answer[1].l1_error)
        if a.method == b.method:
            (value, stated), (other, also_stated) = first.at(*points), second.at(*points)
            return points[0], stated + also_stated, {f"{a.solver} − {b.solver}": value - other}
    return None
