"""Style and scripts that stand inside a page, and the policy that allows no others."""

import json
import platform
import re
from base64 import b64encode
from collections.abc import Sequence
from hashlib import sha256
from importlib.metadata import version
from pathlib import Path
from typing import Any

from markupsafe import Markup
from matplotlib import colormaps
from matplotlib.colors import to_hex

from cases.scene.written import bound
from cases.show.pictures.style import COLOURS, DARK
from cases.show.records import Record, plain, program_version

TEMPLATES = Path(__file__).parent / "templates"

DIGITS, ERROR_DIGITS = 10, 2
"""Significant digits of a number in the data of a page, and of its error, which is rounded up."""

PLOTS = "axes.js", "curves.js", "maps.js", "plots.js"
"""Files in ``templates`` with the scripts of interactive plots, in the order of loading."""

LIBRARIES = ("numpy", "scipy", "scikit-fem", "numba", "matplotlib", "h5netcdf")

PALETTE = 64
"""Number of colours in a map of a page."""


class PageStyle:
    """The CSS of a page. Templates call ``table`` for each table before they use ``text``."""

    def __init__(self) -> None:
        """Start with no table."""
        self._tables: list[tuple[str, ...]] = []

    def table(self, names: Sequence[str], texts: Sequence[bool] = ()) -> str:
        """Return the CSS class of a table with the columns ``names``, whose rules ``text`` has.

        Names of columns of numbers begin with "#", or ``texts`` says for each column whether it is
        text. In a narrow window the rules show the names beside the cells.
        """
        columns = tuple(names)
        if texts:
            columns = tuple(n if text else f"#{n}" for n, text in zip(names, texts, strict=True))
        if columns not in self._tables:
            self._tables.append(columns)
        return f"t{self._tables.index(columns)}"

    @property
    def text(self) -> Markup:
        """The CSS, with rules for the columns of all tables so far."""
        tables = [
            (f".t{t} tr > :nth-child({k})", name.removeprefix("#"), name.startswith("#"))
            for t, columns in enumerate(self._tables)
            for k, name in enumerate(columns, start=1)
        ]
        # In a string of CSS special characters stand by their hexadecimal numbers.
        strings = [re.sub(r"[^\w ]", lambda c: rf"\{ord(c[0]):x} ", name) for _, name, _ in tables]
        names = "".join(
            f'{cells}::before{{content:"{name}"}}'
            for (cells, *_), name in zip(tables, strings, strict=True)
        )
        numbers = ",".join(cells for cells, _, number in tables if number)
        rules = f"""@media screen and (max-width: 44rem) {{ {names} }}
:where({numbers}) {{ text-align: right; white-space: nowrap; }}"""
        # On a dark page curves take their colours by rules, to which those of an attribute yield.
        dark = "".join(
            f'[{key}="{light}"]{{{key}:{colour}}}'
            for light, colour in zip(COLOURS, DARK, strict=True)
            for key in ("fill", "stroke")
        )
        curves = f"@media screen and (prefers-color-scheme: dark) {{ {dark} }}"
        return Markup("\n").join((_template("report.css"), Markup(curves), Markup(rules)))

    @property
    def hash(self) -> Markup:
        """``'sha256-…'`` of ``text`` for the security policy of the page."""
        return _hash(self.text)


def page_record(scripts: Sequence[str] = ()) -> Record:
    """Return ``style``, ``script`` and ``script_hash`` for the template ``page.html``.

    ``style`` is a new ``PageStyle``. ``scripts`` are names of files in ``templates``, joined in
    this order. The content security policy of the page allows the script with this hash alone;
    without ``scripts`` the hash is ``'none'``.
    """
    script = Markup("\n").join(map(_template, scripts))
    allowed = _hash(script) if scripts else "'none'"
    return {"style": PageStyle(), "script": script, "script_hash": allowed}


def origin_record(command: str, downloads: Sequence[str], *, seeds: Sequence[int] = ()) -> Record:
    """Return the record of ``origin.html``: the arguments, and ``versions`` as (name, version).

    ``command`` made the page, ``downloads`` are names of files beside it. ``seeds`` of the
    simulation are listed because the ``command`` need not name them.
    """
    return {
        "command": command,
        "seeds": seeds,
        "downloads": downloads,
        "versions": [
            ("vibro-fpk", program_version()),
            ("Python", platform.python_version()),
            *((name, version(name)) for name in LIBRARIES),
        ],
    }


def script_record(plots: Sequence[Record], **more: Any) -> Record:
    """Return ``plots``, the ``palette`` of maps as hex colours, and ``more``, as JSON has them."""
    palette = [to_hex(c) for c in colormaps["viridis"](range(0, 256, 256 // PALETTE))]
    return plain({"plots": plots, "palette": palette, **more})


def round_values(*, error: Any = None, **values: Any) -> Record:
    """Return each sequence of ``values``, under its key, as numbers of ``DIGITS`` digits.

    The sequence ``error``, if given, is rounded up to ``ERROR_DIGITS``. NaN gives None, inf stays.
    """
    own = {key: [_finite(f"{v:.{DIGITS - 1}e}") for v in each] for key, each in values.items()}
    return (
        own if error is None else own | {"error": [_finite(bound(e, ERROR_DIGITS)) for e in error]}
    )


def _finite(text: str) -> float | None:
    return None if text == "nan" else float(text)


def as_script_data(record: Record) -> Markup:
    """Return ``record`` as JSON, ``<``, ``>``, ``&`` escaped; ``ValueError`` for NaN and inf."""
    text = json.dumps(record, ensure_ascii=True, allow_nan=False, separators=(",", ":"))
    for character in "<>&":
        text = text.replace(character, f"\\u{ord(character):04x}")
    return Markup(text)


def _template(name: str) -> Markup:
    """The text of a file in ``templates``, which the page takes over without escaping."""
    return Markup((TEMPLATES / name).read_text(encoding="utf-8").strip())


def _hash(text: str) -> Markup:
    """The source expression 'sha256-…' by which a content security policy allows a text."""
    digest = sha256(text.encode()).digest()
    return Markup(f"'sha256-{b64encode(digest).decode()}'")
