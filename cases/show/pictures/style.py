"""Style of all pictures: colours, dashes and markers, words for axes; which answers are drawn."""

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from itertools import combinations
from pathlib import Path
from typing import Any

from matplotlib import rc_params_from_file

from cases.compare.answers import Answers
from cases.scene.units import NO_UNITS, Units, in_brackets
from fpk.answer.density import Density
from fpk.answer.method import ROUTES, Route
from fpk.answer.names import Coordinate, Observable
from fpk.answer.sampled_density import SampledDensity

STYLE: Any = rc_params_from_file(
    Path(__file__).with_name("fpk.mplstyle"), use_default_template=False
)
"""Settings of matplotlib in all pictures."""

INK: str = STYLE["text.color"]
"""Colour of text and axes; in a page the colour of its text takes its place."""

COLOURS = ("#00a688", "#e07500", "#5e02e0", "#601626", "#056c66", "#b50c01", "#b86cfa")
DARK = ("#00fdd3", "#fab034", "#9447e3", "#546f00", "#14a697", "#ff1b74", "#ceacff")
"""Colours of curves and routes on a light page, and their replacements on a dark page. Any two of a
row differ by more than 20 by CIE76 and by CIEDE2000, in normal vision and in its three
deficiencies, and have a contrast of 3 or more with the page. A search found no seven that do so on
both pages; the best differ by 18."""

DASHES = {"-": "", "--": "12 4", "-.": "12 4 2 4", ":": "2 2"}
"""Dashes and gaps of a line in pixels, as in SVG, by the names that matplotlib has for them."""

MARKERS = {
    "o": "m-2.4,0a2.4,2.4 0 1,0 4.8,0a2.4,2.4 0 1,0 -4.8,0",
    "s": "m-2.2,-2.2h4.4v4.4h-4.4z",
    "D": "m0,-3.2l3.2,3.2l-3.2,3.2l-3.2,-3.2z",
    "^": "m0,-3l2.8,5h-5.6z",
    "v": "m0,3l2.8,-5h-5.6z",
    "X": "m-2.4,-2.4l4.8,4.8m0,-4.8l-4.8,4.8",
    "P": "m-3,0h6m-3,-3v6",
}
"""SVG paths of the markers in a page by their names in matplotlib, as many as ``COLOURS``."""

SHOWN = 1e-3
"""Share of its largest value below which a density no longer widens the axes of a picture."""

SUBSCRIPTS = str.maketrans("0123456789", "₀₁₂₃₄₅₆₇₈₉")

SHOWN_UNITS: ContextVar[Units] = ContextVar("SHOWN_UNITS", default=NO_UNITS)
"""Units of the scene whose pictures are being drawn, as the style of matplotlib is set for them."""


@contextmanager
def in_units(units: Units) -> Iterator[None]:
    """Return a context in which ``units`` stand in the words for axes of pictures."""
    token = SHOWN_UNITS.set(units)
    try:
        yield
    finally:
        SHOWN_UNITS.reset(token)


def density_words(observable: Observable, *, difference: bool = False) -> str:
    """Return words for the axis of a density, or a ``difference``, as ``density p(q₂) [mm⁻¹]``."""
    unit = in_brackets(SHOWN_UNITS.get().density(observable))
    words = "difference of" if difference else "density"
    return f"{words} p({', '.join(map(symbol_of, observable))}){unit}"


def time_words() -> str:
    """Return the words for an axis of time."""
    return f"time t{in_brackets(SHOWN_UNITS.get().time)}"


def symbol_of(coordinate: Coordinate) -> str:
    """Return the coordinate with its index as a subscript."""
    return str(coordinate).translate(SUBSCRIPTS)


def words_of(coordinate: Coordinate) -> str:
    """Return the words for an axis of the coordinate: ``displacement q₂ [mm]``."""
    words = {"q": "displacement", "p": "momentum", "H": "energy"}[coordinate.kind]
    modal = "modal " if coordinate.kind == "H" and coordinate.index is not None else ""
    unit = in_brackets(SHOWN_UNITS.get().coordinate(coordinate))
    return f"{modal}{words} {symbol_of(coordinate)}{unit}"


def lines_of(curve: Answers, observable: Observable) -> dict[Route, Density]:
    """Return the densities drawn as lines: the first for the full system and each averaged method.

    An averaged method that is exact here is not drawn beside a solution of the full system.
    """
    drawn: dict[str, tuple[Route, Density]] = {}
    for route, density in curve.densities(observable).items():
        full = route.solves == "full"
        if isinstance(density, Density) and (full or "" not in drawn or not curve.is_exact(route)):
            drawn.setdefault("" if full else route.method, (route, density))
    return dict(drawn.values())


def samples_of(curve: Answers, observable: Observable) -> dict[Route, SampledDensity]:
    """Return the histograms of one observable, the full system's first."""
    densities = curve.densities(observable).items()
    return {route: d for route, d in densities if isinstance(d, SampledDensity)}


def solver_pair(
    curve: Answers, observable: Observable
) -> tuple[tuple[Route, Density], tuple[Route, Density]] | None:
    """Return two deterministic answers to one averaged equation, the larger stated error first.

    None if no averaged equation has two of them.
    """
    answers = curve.densities(observable).items()
    functions = [(r, d) for r, d in answers if r.solves == "averaged" and isinstance(d, Density)]
    for pair in combinations(functions, 2):
        if pair[0][0].method == pair[1][0].method:
            first, second = sorted(pair, key=lambda answer: -answer[1].l1_error)
            return first, second
    return None


def style_of(route: Route) -> str:
    """Return the key of ``DASHES`` of a route's line: "-" for the full system, else another."""
    averaged = list(dict.fromkeys(r.method for r in ROUTES.values() if r.solves == "averaged"))
    place = averaged.index(route.method) + 1 if route.method in averaged else 0
    return list(DASHES)[min(place, len(DASHES) - 1)]


def marker_of(route: Route) -> str:
    """Return the key of ``MARKERS`` of a route that samples, the same in all pictures.

    Simulation, rare events by splitting and each simulated averaged equation have their own.
    """
    sampled = sorted((r for r in ROUTES.values() if r.sampled), key=lambda r: r.solves != "full")
    others = [r for r in sampled if r.solves == "averaged"]
    place = 3 + others.index(route) if route in others else int(route not in sampled)
    return list(MARKERS)[place % len(MARKERS)]
