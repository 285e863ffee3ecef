"""Grids of parameters on the command line: ``contact.stiffness=0.01:1000:log25``."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from math import nan, prod

import numpy as np

from cases.scene.errors import BadInput, toml_value
from cases.scene.vary import VARIED, changed
from fpk.density import Array
from fpk.errors import InvalidInput
from fpk.system import System

KEYS = {"contact.stiffness": "contact stiffness $B$", "contact.clearance": "clearance $δ$"}
"""Keys of a scene that a map may vary, all of them numbers, with the label of their axis."""
MAX_POINTS = 2000
"""Points of a map; each is a simulation of about a second."""
LARGEST = 1e100
"""Largest size of an end of a grid: its square is still a number."""


@dataclass(frozen=True, eq=False)
class Axis:
    """One parameter and the values that it takes."""

    key: str
    values: Array
    logarithmic: bool

    @property
    def symbol(self) -> str:
        """The parameter's letter, such as B."""
        return VARIED[self.key]


def parse_axes(texts: Sequence[str], system: System) -> tuple[Axis, ...]:
    """Return one or two axes; raise ``BadInput`` for what cannot be used of them."""
    if not 1 <= len(texts) <= 2:
        raise BadInput(f"--vary is given {len(texts)} times; give one parameter or two")
    axes = tuple(map(_axis, texts))
    if len({a.key for a in axes}) != len(axes):
        raise BadInput(f'--vary "{texts[1]}": {axes[0].key} is varied already')
    if (count := prod(a.values.size for a in axes)) > MAX_POINTS:
        raise BadInput(f"--vary: the grid has {count} points; at most {MAX_POINTS}")
    if not system.contacts:
        raise BadInput(f"--vary {axes[0].key}: the scene has no [[contact]] to vary")
    for axis, text in zip(axes, texts, strict=True):
        for value in axis.values.tolist():
            try:
                changed(system, axis.key, value)
            except InvalidInput as error:
                raise _wrong(text, f"{value:g} {error.remedy}") from None
    return axes


def system_at(system: System, axes: Sequence[Axis], point: Sequence[float]) -> System:
    """Return the system with the parameters of one grid point."""
    for axis, value in zip(axes, point, strict=True):
        system = changed(system, axis.key, value)
    return system


def _axis(text: str) -> Axis:
    key, _, grid = (part.strip() for part in text.partition("="))
    if not grid or key not in KEYS:
        raise _wrong(text, f"write one of {', '.join(KEYS)}, then =low:high:count")
    match = re.fullmatch(r"([^:]+):([^:]+):(log)?([0-9]{1,5})", grid)
    if match is None:
        raise _wrong(text, "a grid is low:high:count, or low:high:logCOUNT for equal ratios")
    try:
        low, high = float(match[1]), float(match[2])
    except ValueError:
        low = high = nan
    logarithmic, count = match[3] is not None, int(match[4])
    for holds, remedy in (
        (abs(low) <= LARGEST and abs(high) <= LARGEST, "both ends must be finite numbers"),
        (low < high, f"{low:g} is not below {high:g}"),
        (2 <= count <= MAX_POINTS, f"a count of {count} cannot be used; use 2 to {MAX_POINTS}"),
        (low > 0 or not logarithmic, "equal ratios need a low end > 0"),
    ):
        if not holds:
            raise _wrong(text, remedy)
    values = np.geomspace(low, high, count) if logarithmic else np.linspace(low, high, count)
    # Twelve digits: the same grid point has the same value on any grid that contains it.
    return Axis(key, np.array([float(f"{v:.12g}") for v in values]), logarithmic)


def _wrong(text: str, remedy: str) -> BadInput:
    return BadInput(f"--vary {toml_value(text)}: {remedy}")
