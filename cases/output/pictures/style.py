"""Style of all pictures: ink and colours, words for axes, fixed margins, and figures as SVG."""

import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from io import StringIO
from pathlib import Path
from typing import Any

from markupsafe import Markup
from matplotlib import rc_context, rc_params_from_file
from matplotlib.artist import Artist
from matplotlib.figure import Figure

from cases.scene.units import NO_UNITS, Units, bracketed
from fpk.observable import Coordinate, Observable

STYLE: Any = rc_params_from_file(
    Path(__file__).with_name("fpk.mplstyle"), use_default_template=False
)
"""Settings of matplotlib in all pictures."""

INK: str = STYLE["text.color"]
"""Colour of text and axes; the report replaces it by that of the page's text."""

COLOURS = ("#2878b5", "#d1603d", "#2a9d6f", "#9a6fc0", "#c08a1e", "#5b8def", "#a8577e")
"""Colours of curves: distinct for colour-blind readers, and legible on white and on black."""

SHOWN = 1e-3
"""Share of the largest value below which a linear axis shows nothing."""

WIDTH = 6.6
"""Width of a picture with one column of axes, in inches."""

LEFT, RIGHT, FOOT, GAP, LEGEND_ROW = 0.66, 0.12, 0.5, 0.34, 0.19
"""Margins beside and below the axes, the gap between two for a title, and the height of a row of
the legend, in inches. Fixed: to measure all words first draws every picture twice."""

LONGEST_OF_THREE = 31
"""Letters of the longest entry with which a legend of three columns fits."""

SOLVER_WORDS = (
    "Numerical error for {}: two solvers of the same equation against each other, and the errors"
    " that they state."
)
"""Caption of the differences of two solvers of an observable."""

SUBSCRIPTS = str.maketrans("0123456789", "₀₁₂₃₄₅₆₇₈₉")


def arrange(figure: Figure, height: float, legend: Mapping[str, Artist], *, head: float) -> None:
    """Size a figure of one column of axes, ``height`` inches each, and put its legend above.

    ``legend`` has the handles by their words; ``head`` is the space below it in inches.
    """
    rows = len(figure.axes)
    columns = 3 if max(map(len, legend)) <= LONGEST_OF_THREE else 2
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


def svg_text(figure: Figure, *, salt: str) -> str:
    """Return the figure as SVG that is the same every time, with identifiers of its own."""
    stream = StringIO()
    with rc_context({**STYLE, "svg.hashsalt": salt}):
        nothing = dict.fromkeys(("Creator", "Date", "Format", "Type"))
        figure.savefig(stream, format="svg", metadata=nothing)
    return stream.getvalue()


def inline_svg(svg: str, words: str) -> Markup:
    """Return SVG to stand inside a page: ink takes the page's colour, no background.

    A screen too narrow for its width scrolls, so that its words keep their size.
    """
    body = svg[svg.index("<svg") :].replace(INK, "currentColor")
    body = re.sub(r'(<g id="patch_1">\s*<path [^>]*?)fill: #ffffff', r"\1fill: none", body)
    label = Markup('<svg role="img" aria-label="{}" ').format(words)
    return label + Markup(body.removeprefix("<svg "))  # drawn by this program
