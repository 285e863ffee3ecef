"""Sketch of a chain of masses with its springs, dampers and stops, as SVG for a page."""

from markupsafe import Markup, escape

from cases.scene.units import NO_UNITS, Units
from cases.show.pictures.style import SUBSCRIPTS
from fpk.system.system import System

SHOWN_MASSES = 8
"""Masses that are drawn; of a longer chain the first ones, and the words say so."""

CELL, BOX, FLOOR, TOP = 150, 46, 96, 40
"""Width of a mass with what joins it to the one before, width of its box, height of the floor and
of the top of a box, in pixels."""


def chain_svg(system: System, units: Units = NO_UNITS) -> Markup:
    """Return the chain from its wall on the left; stops are shaded walls at their masses.

    Lengths are not to scale; clearances are in ``units``.
    """
    unit = f" {units.quantity('displacement')}" if units else ""
    count = min(system.n, SHOWN_MASSES)
    clearances = [f"δ = {stop.clearance:g}{unit}" for stop in system.stops]
    # Letters of 13 px are 8 px wide at the most; the last clearance begins 2 px before the end.
    width = 24 + CELL * count + max([64, *(8 * len(words) for words in clearances)])
    parts = [_wall(4, 24, 30, FLOOR), _line((24, FLOOR), (width, FLOOR))]
    for k in range(count):
        left = 24 + CELL * k
        box = left + CELL - BOX - 32
        index = str(k + 1).translate(SUBSCRIPTS)
        parts += [_spring(left, box, 54), _damper(left, box, 80)]
        parts += [
            f'<rect x="{box}" y="{TOP}" width="{BOX}" height="{FLOOR - TOP}" class="mass"/>',
            _text(box + BOX / 2, 73, f"m{index}"),
            _text((left + box) / 2, 43, f"k{index}"),
            _text((left + box) / 2, 112, f"c{index}"),
        ]
        for stop, words in zip(system.stops, clearances, strict=True):
            if stop.index != k:
                continue
            x = box + BOX + 14 if stop.sign > 0 else box - 26
            parts.append(_wall(x, x + 12, 4, 30))
            # From the edge of the mass to the stop.
            parts.append(_line((x + 6, 30), (x + 6, TOP)))
            parts.append(_text(x + 6, 13 if stop.sign > 0 else 28, words, side=stop.sign))
        if k + 1 < count or system.n > count:
            parts.append(_line((box + BOX, 54), (left + CELL, 54)))
            parts.append(_line((box + BOX, 80), (left + CELL, 80)))
    more = f", the first {count} are drawn" if system.n > count else ""
    words = f"Chain of {system.n} masses with {len(system.stops)} stops{more}; not to scale"
    label = f'<svg class="chain" role="img" aria-label="{escape(words)}"'
    return Markup(f'{label} viewBox="0 0 {width} 118" width="{width}">{"".join(parts)}</svg>')


def _wall(left: float, right: float, top: float, bottom: float) -> str:
    size = f'width="{right - left}" height="{bottom - top}"'
    return f'<rect x="{left}" y="{top}" {size} class="wall"/>'


def _line(*points: tuple[float, float]) -> str:
    return f'<polyline points="{" ".join(f"{x:g},{y:g}" for x, y in points)}"/>'


def _spring(left: float, right: float, y: float) -> str:
    ends, turns = (left + 8, right - 8), 8
    step = (ends[1] - ends[0]) / turns
    zigzag = [(ends[0] + (i + 0.5) * step, y + (5 if i % 2 else -5)) for i in range(turns)]
    return _line((left, y), (ends[0], y), *zigzag, (ends[1], y), (right, y))


def _damper(left: float, right: float, y: float) -> str:
    middle = (left + right) / 2
    return (
        _line((left, y), (middle - 6, y))
        + _line((middle + 8, y - 7), (middle - 6, y - 7), (middle - 6, y + 7), (middle + 8, y + 7))
        + _line((middle + 3, y - 5), (middle + 3, y + 5))
        + _line((middle + 3, y), (right, y))
    )


def _text(x: float, y: float, words: str, *, side: float = 0.0) -> str:
    anchor = {0.0: "middle", 1.0: "start", -1.0: "end"}[side]
    return f'<text x="{x + 10 * side:g}" y="{y}" text-anchor="{anchor}">{escape(words)}</text>'
