"""Figures as SVG: the same every time, and fit to stand inside a page of any colour."""

import re
from io import StringIO

from markupsafe import Markup
from matplotlib import rc_context
from matplotlib.figure import Figure

from cases.output.pictures.style import INK, STYLE


def svg_text(figure: Figure, *, salt: str) -> str:
    """Return the figure as SVG that is the same every time, with identifiers of its own."""
    stream = StringIO()
    with rc_context({**STYLE, "svg.hashsalt": salt}):
        nothing = dict.fromkeys(("Creator", "Date", "Format", "Type"))
        figure.savefig(stream, format="svg", metadata=nothing)
    return stream.getvalue()


def inline_svg(svg: str, words: str) -> Markup:
    """Return SVG to stand inside a page: ink takes the page's colour, no background."""
    body = svg[svg.index("<svg") :].replace(INK, "currentColor")
    body = re.sub(r'(<g id="patch_1">\s*<path [^>]*?)fill: #ffffff', r"\1fill: none", body)
    body = re.sub(r' (?:width|height)="[\d.]+pt"', "", body, count=2)
    label = Markup('<svg role="img" aria-label="{}" ').format(words)
    return label + Markup(body.removeprefix("<svg "))  # drawn by this program
