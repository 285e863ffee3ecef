"""Sketch of a chain of masses with its springs, dampers and stops, as SVG for a page."""

from markupsafe import Markup, escape

from cases.scene.units import NO_UNITS, Units
from cases.show.pictures.style import SUBSCRIPTS
from fpk.system.system import System

SHOWN_MASSES = 8
"""Largest number of masses drawn: the first of a longer chain, as its description says."""

CELL, BOX, CEILING, TOP, FLOOR = 150, 46, 4, 52, 108
"""Width of a mass with its spring, width of its box, and distances from the top of the picture to
the frame from which stops hang, to the top of a box and to the floor, in pixels."""


def chain_svg(system: System, units: Units = NO_UNITS) -> Markup:
    """Return an ``<svg>`` element with the chain from its wall on the left, not to scale.

    Stops hang from a frame that is joined to the wall, on both sides of a rod on their mass.
    ``units`` name the unit of the clearances, which are written beside the stops.
    """
    unit = f" {units.quantity('displacement')}" if units else ""
    count = min(system.n, SHOWN_MASSES)
    stops = [stop for stop in system.stops if stop.index < count]
    clearances = [f"δ = {stop.clearance:g}{unit}" for stop in stops]
    # Letters of 13 px are at most 8 px wide; labels end or begin 28 px beside the middle of a box.
    longest = max((8 * len(words) for words in clearances), default=0)
    first = 24 + max(0, longest - 67)
    width = first + CELL * count + max(40, longest - 20)
    parts = [
        _wall(4, 24, CEILING if stops else TOP - 10, FLOOR),
        _line((24, FLOOR), (width, FLOOR)),
    ]
    if stops:
        parts.append(_line((24, CEILING), (width, CEILING)))
    for k in range(count):
        right = first + CELL * (k + 1)
        left, box = right - CELL if k else 24, right - BOX - 32
        index = str(k + 1).translate(SUBSCRIPTS)
        parts += [_spring(left, box, TOP + 14), _damper(left, box, TOP + 40)]
        parts += [
            f'<rect x="{box}" y="{TOP}" width="{BOX}" height="{FLOOR - TOP}" class="mass"/>',
            _text(box + BOX / 2, TOP + 33, f"m{index}"),
            _text((left + box) / 2, TOP + 4, f"k{index}"),
            _text((left + box) / 2, TOP + 72, f"c{index}"),
        ]
        own = [(s, w) for s, w in zip(stops, clearances, strict=True) if s.index == k]
        for stop, words in own:
            x = box + BOX / 2 + 14 * stop.sign
            parts.append(_wall(min(x, x + 9 * stop.sign), max(x, x + 9 * stop.sign), CEILING, 34))
            parts.append(_text(x + 14 * stop.sign, 32 if stop.sign < 0 else 18, words, stop.sign))
        if own:
            parts.append(_line((box + BOX / 2, TOP), (box + BOX / 2, 20)))
        if k + 1 < count or system.n > count:
            parts.append(_line((box + BOX, TOP + 14), (right, TOP + 14)))
            parts.append(_line((box + BOX, TOP + 40), (right, TOP + 40)))
    more = f", the first {count} are drawn" if system.n > count else ""
    words = f"Chain of {system.n} masses with {len(system.stops)} stops{more}; not to scale"
    label = f'<svg class="chain" role="img" aria-label="{escape(words)}"'
    top = 0 if stops else TOP - 16
    frame = f'viewBox="0 {top} {width} {130 - top}" width="{width}"'
    return Markup(f"{label} {frame}>{''.join(parts)}</svg>")


def _wall(left: float, right: float, top: float, bottom: float) -> str:
    size = f'width="{right - left:g}" height="{bottom - top:g}"'
    return f'<rect x="{left:g}" y="{top:g}" {size} class="wall"/>'


def _line(*points: tuple[float, float]) -> str:
    return f'<polyline points="{" ".join(f"{x:g},{y:g}" for x, y in points)}"/>'


def _spring(left: float, right: float, y: float) -> str:
    ends, turns = (left + 8, right - 8), 8
    step = (ends[1] - ends[0]) / turns
    zigzag = [(ends[0] + (i + 0.5) * step, y + (5 if i % 2 else -5)) for i in range(turns)]
    return _line((left, y), (ends[0], y), *zigzag, (ends[1], y), (right, y))


def _damper(left: float, right: float, y: float) -> str:
    x = (left + right) / 2
    cup = (x + 8, y - 7), (x - 6, y - 7), (x - 6, y + 7), (x + 8, y + 7)
    rods = _line((left, y), (x - 6, y)) + _line((x + 3, y), (right, y))
    return rods + _line(*cup) + _line((x + 3, y - 5), (x + 3, y + 5))


def _text(x: float, y: float, words: str, sign: float = 0.0) -> str:
    anchor = {0.0: "middle", 1.0: "start", -1.0: "end"}[sign]
    return f'<text x="{x:g}" y="{y:g}" text-anchor="{anchor}">{escape(words)}</text>'
