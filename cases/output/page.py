"""Style and scripts that stand inside a page, and the policy that allows no others."""

import json
from base64 import b64encode
from collections.abc import Sequence
from hashlib import sha256
from pathlib import Path
from typing import Any

from markupsafe import Markup
from matplotlib import colormaps
from matplotlib.colors import to_hex

from cases.output.pictures.style import COLOURS, DARK
from cases.output.records import Record, plain
from cases.written import bound

TEMPLATES = Path(__file__).parent / "templates"

DIGITS, ERROR_DIGITS = 10, 2
"""Digits of a number in the data of a page, and of its error, which is rounded up."""

MARKS = (
    "m-2.4,0a2.4,2.4 0 1,0 4.8,0a2.4,2.4 0 1,0 -4.8,0",
    "m-2.2,-2.2h4.4v4.4h-4.4z",
    "m0,-3.2l3.2,3.2l-3.2,3.2l-3.2,-3.2z",
    "m0,-3l2.8,5h-5.6z",
    "m0,3l2.8,-5h-5.6z",
    "m-2.4,-2.4l4.8,4.8m0,-4.8l-4.8,4.8",
    "m-3,0h6m-3,-3v6",
)
"""Paths of the markers of points, by curve, as ``CURVE_MARKS`` of the drawn pictures."""

PLOTS = "axes.js", "curves.js", "maps.js", "plots.js"
"""Scripts of the plots that can be touched, in the order in which they need each other."""

PALETTE = 64
"""Colours of a map in a page."""


def page_record(scripts: Sequence[str] = ()) -> Record:
    """Return ``style``, ``script`` and ``policy`` of ``page.html``; ``scripts`` are file names.

    The policy is the content security policy of the page: of styles and scripts it has the sources.
    """
    style = Markup("\n").join((_source("report.css"), _dark_curves()))
    script = Markup("\n").join(map(_source, scripts))
    policy = {"style": _hash(style), "script": _hash(script) if scripts else "'none'"}
    return {"style": style, "script": script, "policy": policy}


def script_record(plots: Sequence[Record], **more: Any) -> Record:
    """Return the data of the scripts ``PLOTS``: plots, the colours of maps, and ``more``."""
    palette = [to_hex(c) for c in colormaps["viridis"](range(0, 256, 256 // PALETTE))]
    return plain({"plots": plots, "palette": palette, **more})


def rounded(*, error: Any, **values: Any) -> Record:
    """Return the values to ``DIGITS`` digits and their ``error``, rounded up; no number is None."""
    return {
        **{key: [_number(f"{v:.{DIGITS - 1}e}") for v in own] for key, own in values.items()},
        "error": [_number(bound(e, ERROR_DIGITS)) for e in error],
    }


def _number(text: str) -> float | None:
    return None if text == "nan" else float(text)


def as_script_data(record: Record) -> Markup:
    """Return the record as JSON for a script element: ``<``, ``>`` and ``&`` are escaped in it."""
    text = json.dumps(record, ensure_ascii=True, allow_nan=False, separators=(",", ":"))
    for character in "<>&":
        text = text.replace(character, f"\\u{ord(character):04x}")
    return Markup(text)


def _source(name: str) -> Markup:
    """The text of a file in ``templates``, which the page takes over without escaping."""
    return Markup((TEMPLATES / name).read_text(encoding="utf-8").strip())


def _dark_curves() -> Markup:
    """Rules by which curves take their colours on a dark page; those of an attribute yield."""
    rules = "".join(
        f'[{key}="{light}"]{{{key}:{dark}}}'
        for light, dark in zip(COLOURS, DARK, strict=True)
        for key in ("fill", "stroke")
    )
    return Markup(f"@media screen and (prefers-color-scheme: dark) {{ {rules} }}")


def _hash(text: str) -> Markup:
    """The source expression 'sha256-…' by which a content security policy allows a text."""
    digest = sha256(text.encode()).digest()
    return Markup(f"'sha256-{b64encode(digest).decode()}'")
