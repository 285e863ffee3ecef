"""Lists of points on the command line: ``-1.5:1.5:0.1``, ``-1,0,0.3`` and pairs ``A x B``."""

import re
from decimal import Decimal, InvalidOperation

import numpy as np

from cases.scene.errors import BadInput, toml_value
from fpk.numeric.arrays import Array

MAX_POINTS = 200_000
"""Largest number of points, beyond any table or picture; catches typing errors in a step."""


def parse_points(text: str, axes: int, *, option: str = "at") -> tuple[Array, ...]:
    """Return the points in ``text`` as an array (points,) for each of ``axes`` coordinates.

    Two lists, separated by x or ×, give all combinations, the second varying faster. ``option`` is
    the name of the option in messages, without dashes. Raises ``BadInput`` naming the part that
    cannot be used, and for more than ``MAX_POINTS`` points.
    """
    given = f"--{option} {toml_value(text)}"
    parts = [p.strip() for p in re.split(r"[x×]", text)]
    if len(parts) != axes:
        form = "one list such as -1:1:0.1" if axes == 1 else "two lists such as -1:1:0.1 x 0,0.5"
        raise _wrong(given, f"this observable needs {form}")
    lists = [_list(part, given) for part in parts]
    _require_few(float(np.prod([float(a.size) for a in lists])), given)
    return tuple(grid.ravel() for grid in np.meshgrid(*lists, indexing="ij"))


def _list(part: str, given: str) -> Array:
    """Return the points of a list such as ``-1:1:0.1,3``, in the order in which they are written.

    An item is a number or start:end:step. Steps are added in decimal arithmetic, so that the end is
    a point if a whole number of steps leads to it. Raises ``BadInput`` that begins with ``given``,
    also for a step of 0, away from the end or beyond it.
    """
    points: list[Decimal] = []
    for item in part.split(","):
        match [_number(n, given) for n in item.split(":")]:
            case [start]:
                end, step = start, Decimal(1)
            case [start, end, step]:
                if not step or (start != end and (end - start) / step < 1):
                    remedy = f"a step of {step} does not lead from {start} to {end}"
                    raise _wrong(given, f"{remedy}; a list is start:end:step")
            case _:
                raise _wrong(given, f"{toml_value(item)} is not start:end:step")
        _require_few(float(len(points) + (end - start) / step), given)
        points += [start + i * step for i in range(int((end - start) / step) + 1)]
    return np.array(points, dtype=float)


def _require_few(count: float, given: str) -> None:
    if not count <= MAX_POINTS:
        raise _wrong(given, f"asks for more than {MAX_POINTS} points; use larger steps")


def _number(item: str, given: str) -> Decimal:
    try:
        number = Decimal(item.strip())
    except InvalidOperation:
        number = Decimal("nan")
    if not number.is_finite():
        raise _wrong(given, f"{toml_value(item.strip())} is not a finite number")
    if number != 0 and not -100 <= number.adjusted() < 100:
        raise _wrong(given, f"{item.strip()} is neither 0 nor between 1e-100 and 1e100 in size")
    return number


def _wrong(given: str, remedy: str) -> BadInput:
    return BadInput(f"{given}: {remedy}")
