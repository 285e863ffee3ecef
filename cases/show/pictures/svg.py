"""Figures as SVG: short files that are the same every time, and shorter ones inside a page."""

import re
from collections.abc import Iterable, Iterator, Sequence
from io import StringIO
from itertools import count
from xml.etree.ElementTree import Element, SubElement, fromstring, tostring

import numpy as np
from markupsafe import Markup
from matplotlib import rc_context
from matplotlib.figure import Figure
from numpy.typing import ArrayLike

from cases.show.pictures.style import INK, STYLE
from fpk.numeric.arrays import Array

COORDINATES = re.compile(r'( (?:d|x|y)=")([^"]*)"')
LINES = re.compile(r"(?=M)([ML]-?\d+(\.\d+)? -?\d+(\.\d+)?)+z?")
DIGITS, BLANKS = re.compile(r"(\.\d\d)\d+"), re.compile(r"\s*([A-Za-z])\s+(?=[-\d.])|\s*\n")

TOLERANCE = 0.05
"""Distance in points that a line may move when points are left out of it: a tenth of a pixel where
a picture is as wide as pages show it, 34rem. ``path.simplify`` of matplotlib is off: at its
threshold of 0.11 it moves lines by 0.16, and areas it leaves as they are."""

LEAST_USES = 3
"""Smallest number of uses of a symbol that are replaced by one line with the symbol as marker."""


def svg_text(figure: Figure, *, salt: str) -> str:
    """Return the figure as SVG that is the same every time, with identifiers of its own."""
    stream = StringIO()
    with rc_context({**STYLE, "svg.hashsalt": salt}):
        nothing = dict.fromkeys(("Creator", "Date", "Format", "Type"))
        figure.savefig(stream, format="svg", metadata=nothing)
    return COORDINATES.sub(_shorten_attribute, stream.getvalue())


def _shorten_attribute(attribute: re.Match[str]) -> str:
    """Coordinates rounded to a hundredth of a point; lines without the points that do not show."""
    text = BLANKS.sub(r"\1", attribute[2])
    if LINES.fullmatch(text):
        runs = [
            _thin_line([[float(v) for v in pair.split()] for pair in run.split("L")])
            for run in text.removesuffix("z").split("M")[1:]
        ]
        text = _path(runs) + "z" * text.endswith("z")
    return attribute[1] + DIGITS.sub(r"\1", text) + '"'


def _thin_line(points: Sequence[Sequence[float]]) -> Array:
    """The points (k, 2) of a line without those that move it by less than ``TOLERANCE``.

    Douglas, Peucker 1973, Cartographica 10, 112-122.
    """
    p = np.asarray(points)
    shown = np.zeros(len(p), dtype=bool)
    shown[[0, -1]] = True
    parts = [(0, len(p) - 1)]
    while parts:
        i, k = parts.pop()
        chord, rest = p[k] - p[i], p[i + 1 : k] - p[i]
        along = np.clip(rest @ chord / (chord @ chord or 1.0), 0.0, 1.0)
        away = np.hypot(*(rest - along[:, None] * chord).T)
        if away.size and away.max() > TOLERANCE:
            j = i + 1 + int(away.argmax())
            shown[j] = True
            parts += [(i, j), (j, k)]
    return p[shown]


def _path(runs: Iterable[ArrayLike]) -> str:
    """The path of lines (k, 2), to a hundredth of a point, each point relative to its predecessor.

    Places in the whole picture, of sixteen digits, make a file five times as long.
    """
    path, letter, at = "", "", np.zeros(2)
    for run in runs:
        points = np.rint(100.0 * np.asarray(run))
        steps, at = np.diff(points, axis=0, prepend=[at]), points[-1]
        for k, (x, y) in enumerate(steps):
            if k and not (x or y):
                continue
            before, letter = letter, "m" if k == 0 else "h" if y == 0 else "v" if x == 0 else "l"
            words = " ".join(_decimal(v) for v in (x, y) if letter in "ml" or v)
            # After a move, and after a letter, the same is meant where none stands.
            same = letter == before != "m" or (before, letter) == ("m", "l")
            path += (" " if same else letter) + words
    return path.replace(" -", "-")


def _decimal(hundredths: float) -> str:
    """Hundredths as a decimal number of SVG, which needs no zero before its point."""
    return re.sub(r"^(-?)0\.", r"\1.", f"{hundredths / 100.0 + 0.0:.10g}")


def inline_svg(svg: str, words: str) -> Markup:
    """Return SVG to stand inside a page: ink takes the page's colour, no background, no styles.

    Fonts, names of groups and groups without attributes are removed. If the figure has an image,
    whose colours stay on a dark page, all colours are in capitals, which the rules of the page do
    not replace. ``words`` describe the figure to readers who do not see it.
    """
    root = fromstring(svg.replace(INK, "currentColor"))
    _lean(root, {name: set() for name in re.findall(r"#(\w+)", svg)})
    numbers = count()
    for group in (root, *root.iter("g")):
        _mark(group, numbers)
    if root.find(".//image") is not None:
        for element in root.iter():
            ink = {key: element.get(key, "").upper() for key in ("fill", "stroke")}
            element.attrib |= {key: v for key, v in ink.items() if v.startswith("#")}
    root.attrib = {"role": "img", "aria-label": words, **root.attrib}
    return Markup(tostring(root, encoding="unicode"))


def _lean(element: Element, used: dict[str, set[str]]) -> None:
    """Remove from the element, in place, what the page does not need; groups without attributes.

    ``used`` has the identifiers that are referred to, with the attributes of their elements.
    """
    element.tag = element.tag.rpartition("}")[2]
    element.attrib = _attributes(element, used)
    element.text = (element.text or "").strip() and element.text
    children: list[Element] = []
    for child in element:
        if child.get("id") != "patch_1" and not child.tag.endswith(("}style", "}metadata")):
            _lean(child, used)
            child.tail = (child.tail or "").strip() and child.tail
            children += [*child] if child.tag == "g" and not child.attrib else [child]
    element[:] = children


def _mark(group: Element, numbers: Iterator[int]) -> None:
    """Make many uses of one symbol a line without ink that the symbol marks."""
    uses: dict[tuple[tuple[str, str], ...], list[Element]] = {}
    for use in group.findall("use"):
        common = tuple(item for item in use.items() if item[0] not in "xy")
        uses.setdefault(common, []).append(use)
    for common, same in uses.items():
        if len(same) >= LEAST_USES:
            places = [[float(use.get(key, 0.0)) for key in "xy"] for use in same]
            name = f"{dict(common)['href'].removeprefix('#')}-{next(numbers)}"
            marker = Element("marker", id=name, overflow="visible", markerUnits="userSpaceOnUse")
            SubElement(marker, "use", dict(common))
            ends = {f"marker-{place}": f"url(#{name})" for place in ("start", "mid", "end")}
            ink = {"fill": "none", "stroke": "none"}
            line = Element("path", {"d": _path([places]), **ink, **ends})
            first = [*group].index(same[0])
            group[first:] = [marker, line, *(e for e in group[first:] if e not in same)]


def _attributes(element: Element, used: dict[str, set[str]]) -> dict[str, str]:
    """The attributes that matter in a page, its style among them, which the policy forbids."""
    own = {key.rpartition("}")[2]: value for key, value in element.items()}  # href of a use
    styles = [part.split(":", 1) for part in own.pop("style", "").split(";") if ":" in part]
    own |= {key.strip(): value.strip() for key, value in styles}
    if font := re.search(r"([0-9.]+px)", own.pop("font", "")):
        own["font-size"] = font[1]
    dropped = {"font-family"}
    if own.get("transform", "").startswith("rotate(-0 "):
        dropped.add("transform")
    if own.get("stroke-dashoffset") == "0":
        dropped.add("stroke-dashoffset")
    if element.tag == "use":
        dropped |= used[own["href"].removeprefix("#")] - {"x", "y"}  # the symbol's own hold
    if own.get("id") in used:
        used[own["id"]] |= {*own}
    else:
        dropped.add("id")
    return {key: value for key, value in own.items() if key not in dropped}
