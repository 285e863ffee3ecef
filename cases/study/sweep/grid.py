"""A grid of one or two parameters, read from text.

One parameter on the command line is ``contact.stiffness=0.01:1000:log25``, or a list of numbers.
"""

import re
from collections.abc import Sequence
from itertools import pairwise
from math import nan, prod

import numpy as np

from cases.scene.errors import BadInput, toml_value
from cases.scene.numbers import VARIED, place_of, with_numbers
from cases.scene.schema import LARGEST
from cases.scene.units import NO_UNITS, Units
from cases.show.variables import Axis
from fpk.numeric.arrays import Array
from fpk.numeric.errors import InvalidInput
from fpk.system.system import System

GRID_POINTS = 2000
"""Largest number of points of a grid; each may be a simulation of about a second."""
WIDE = 30.0
"""Ratio of the ends of a list of values from which its axis is logarithmic."""
GRID_FORMS = "low:high:count, low:high:logCOUNT for equal ratios, or a list such as 0.1,0.2"


def place_words(axes: Sequence[Axis], values: Sequence[float]) -> str:
    """Return the ``values`` of a grid point, one for each axis, in words: ``B = 10, δ = 0.5``."""
    return ", ".join(f"{a.symbol} = {v:g}" for a, v in zip(axes, values, strict=True))


def parse_axes(texts: Sequence[str], system: System, units: Units = NO_UNITS) -> tuple[Axis, ...]:
    """Return one or two axes from ``texts`` "PATH=GRID"; raise ``BadInput`` for an unusable text.

    Every value of a single parameter must give a valid system; the caller checks pairs of values.
    """
    if not 1 <= len(texts) <= 2:
        raise BadInput(f"--vary is given {len(texts)} times; give one parameter or two")
    axes = tuple(_axis(text, system, units) for text in texts)
    places = [place_of(axis.key, system) for axis in axes]
    if len(axes) == 2 and places[0].overlaps(places[1]):
        raise _bad_vary(texts[1], f"{axes[0].key} is varied already")
    if (count := prod(a.values.size for a in axes)) > GRID_POINTS:
        raise BadInput(f"--vary: the grid has {count} points; at most {GRID_POINTS}")
    for value in axes[0].values.tolist() if len(axes) == 1 else ():  # a pair may do, one not
        try:
            with_numbers(system, {axes[0].key: value})
        except InvalidInput as error:
            raise _bad_vary(texts[0], f"{value:g} {error.remedy}") from None
    return axes


def _axis(text: str, system: System, units: Units) -> Axis:
    key, equals, grid = (part.strip() for part in text.partition("="))
    if not equals:
        raise _bad_vary(text, f"write PATH=GRID; a grid is {GRID_FORMS}")
    try:
        place = place_of(key, system)
    except InvalidInput as error:
        raise _bad_vary(text, f"{toml_value(key)} {error.remedy}") from None
    powers = place.powers(system)
    unit = "" if powers is None else units.of(powers)
    symbol = VARIED.get(key, key) if place.name else f"{key} (factor)" if place.factor else key
    match = re.fullmatch(r"([^:,]+):([^:,]+):(log)?([0-9]{1,5})", grid)
    if match is None:
        values = _values_of(text, grid)
        return Axis(key, symbol, values, bool(values[-1] >= WIDE * values[0] > 0.0), unit)
    low, high = _float_of(match[1]), _float_of(match[2])
    logarithmic, count = match[3] is not None, int(match[4])
    for holds, remedy in (
        (abs(low) <= LARGEST and abs(high) <= LARGEST, "both ends must be finite numbers"),
        (low < high, f"{low:g} is not below {high:g}"),
        (2 <= count <= GRID_POINTS, f"a count of {count} cannot be used; use 2 to {GRID_POINTS}"),
        (low > 0 or not logarithmic, "equal ratios need a low end > 0"),
    ):
        if not holds:
            raise _bad_vary(text, remedy)
    values = np.geomspace(low, high, count) if logarithmic else np.linspace(low, high, count)
    # Twelve digits: the same grid point has the same value on any grid that contains it.
    rounded = np.array([float(f"{v:.12g}") for v in values])
    return Axis(key, symbol, rounded, logarithmic, unit)


def _values_of(text: str, grid: str) -> Array:
    values = [_float_of(item) for item in grid.split(",")]
    if not all(abs(v) <= LARGEST for v in values):
        raise _bad_vary(text, f"{toml_value(grid)} is no grid; a grid is {GRID_FORMS}")
    if len(values) < 2 or not all(a < b for a, b in pairwise(values)):
        raise _bad_vary(text, "a list must ascend and have at least two numbers")
    return np.array(values)


def _float_of(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return nan


def _bad_vary(text: str, remedy: str) -> BadInput:
    return BadInput(f"--vary {toml_value(text)}: {remedy}")
