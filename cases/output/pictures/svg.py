"""Figures as SVG: short files that are the same every time, and shorter ones inside a page."""

import re
from io import StringIO
from itertools import pairwise
from xml.etree.ElementTree import Element, fromstring, tostring

from markupsafe import Markup
from matplotlib import rc_context
from matplotlib.figure import Figure

from cases.output.pictures.style import INK, STYLE

NUMBERS = re.compile(r'( (?:d|x|y)=")([^"]*)"')
LINES = re.compile(r"(?=M)([ML]-?\d+(\.\d+)? -?\d+(\.\d+)?)+z?")
DIGITS, BLANKS = re.compile(r"(\.\d\d)\d+"), re.compile(r"\s*([A-Za-z])\s+(?=[-\d.])|\s*\n")

INHERITED = {
    "fill", "fill-opacity", "font-size", "stroke", "stroke-dasharray", "stroke-dashoffset",
    "stroke-linecap", "stroke-linejoin", "stroke-opacity", "stroke-width", "text-anchor",
}  # fmt: skip
"""Attributes that an element of SVG has from the group in which it is."""


def svg_text(figure: Figure, *, salt: str) -> str:
    """Return the figure as SVG that is the same every time, with identifiers of its own."""
    stream = StringIO()
    with rc_context({**STYLE, "svg.hashsalt": salt}):
        nothing = dict.fromkeys(("Creator", "Date", "Format", "Type"))
        figure.savefig(stream, format="svg", metadata=nothing)
    return NUMBERS.sub(_short, stream.getvalue())


def _short(attribute: re.Match[str]) -> str:
    """Coordinates to a hundredth of a point, which nobody sees; of lines each from the one before.

    Sixteen digits make a file three times as long, places in the whole picture one and a half.
    """
    text = BLANKS.sub(r"\1", DIGITS.sub(r"\1", attribute[2]))
    if not LINES.fullmatch(text):
        return f'{attribute[1]}{text}"'
    parts = []
    for run in text.removesuffix("z").split("M")[1:]:
        points = [[round(100.0 * float(v)) for v in pair.split()] for pair in run.split("L")]
        steps = [_number(b - a) for p, q in pairwise(points) for a, b in zip(p, q, strict=True)]
        line = " ".join(steps).replace(" -", "-")
        parts.append(f"M{' '.join(map(_number, points[0]))}{'l' if steps else ''}{line}")
    return f'{attribute[1]}{"".join(parts)}{"z" * text.endswith("z")}"'


def _number(hundredths: int) -> str:
    """Hundredths as a decimal number of SVG, which needs no zero before its point."""
    return re.sub(r"^(-?)0\.", r"\1.", f"{hundredths / 100.0:.10g}")


def inline_svg(svg: str, words: str) -> Markup:
    """Return SVG to stand inside a page: ink takes the page's colour, no background, no styles.

    Nothing is in it that the page says already or nobody reads: fonts, names of groups, groups
    without attributes. ``words`` describe it to those who do not see it.
    """
    root = fromstring(svg.replace(INK, "currentColor"))
    _lean(root, {*re.findall(r"#(\w+)", svg)})
    root.attrib = {"role": "img", "aria-label": words, **root.attrib}
    return Markup(tostring(root, encoding="unicode"))


def _lean(element: Element, used: set[str]) -> None:
    """Make the element and all in it lean; ``used`` are the identifiers that are referred to."""
    element.tag = element.tag.rpartition("}")[2]
    element.attrib = own = _attributes(element, used)
    children: list[Element] = []
    for child in element:
        if child.get("id") != "patch_1" and not child.tag.endswith(("}style", "}metadata")):
            _lean(child, used)
            children += child if child.tag == "g" and not child.attrib else [child]
    drawn = [child for child in children if child.tag != "defs"]
    if element.tag == "g" and len(drawn) > 1:
        common = set.intersection(*({*child.attrib.items()} for child in drawn))
        for key, value in sorted(common):
            if key in INHERITED:
                own[key] = value
                for child in drawn:
                    del child.attrib[key]
    element[:] = children
    element.text = (element.text or "").strip() and element.text
    for child in children:
        child.tail = (child.tail or "").strip() and child.tail


def _attributes(element: Element, used: set[str]) -> dict[str, str]:
    """The attributes that matter in a page, its style among them, which the policy forbids."""
    own = {key.rpartition("}")[2]: value for key, value in element.items()}  # href of a use
    styles = [part.split(":", 1) for part in own.pop("style", "").split(";") if ":" in part]
    own |= {key.strip(): value.strip() for key, value in styles}
    if font := re.search(r"([0-9.]+px)", own.pop("font", "")):
        own["font-size"] = font[1]
    dropped = {"font-family"} if own.get("id", "") in used else {"font-family", "id"}
    if own.get("transform", "").startswith("rotate(-0 "):
        dropped.add("transform")
    return {key: value for key, value in own.items() if key not in dropped}
