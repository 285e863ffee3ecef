"""Figures as SVG files that are the same every time, and as images inside a page."""

import re
from base64 import b64encode
from io import BytesIO, StringIO

from matplotlib import rc_context
from matplotlib.figure import Figure

from cases.show.pictures.style import STYLE

DOTS = 150
"""Dots per inch of an image in a page, about two for each pixel on which it is shown."""


def svg_text(figure: Figure, *, salt: str) -> str:
    """Return the figure as SVG with coordinates to a hundredth of a point.

    Two calls with the same ``salt`` give the same text, as identifiers are derived from it.
    """
    stream = StringIO()
    with rc_context({**STYLE, "svg.hashsalt": salt}):
        nothing = dict.fromkeys(("Creator", "Date", "Format", "Type"))
        figure.savefig(stream, format="svg", metadata=nothing)
    return re.sub(r"(\.\d\d)\d+", r"\1", stream.getvalue())


def image_address(figure: Figure) -> str:
    """Return the figure as the ``data:`` address of a lossless WebP image without background."""
    stream = BytesIO()
    with rc_context(STYLE):
        lossless = {"lossless": True}
        figure.savefig(stream, format="webp", dpi=DOTS, transparent=True, pil_kwargs=lossless)
    return f"data:image/webp;base64,{b64encode(stream.getvalue()).decode()}"
