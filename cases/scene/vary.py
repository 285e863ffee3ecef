"""The curves of a figure: the scene's own system and those in which one key takes other values."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from cases.scene.errors import refused_as
from cases.scene.numbers import place_of, with_numbers
from fpk.arrays import Array
from fpk.errors import InvalidInput
from fpk.system import System


@dataclass(frozen=True)
class Curve:
    """One curve of a figure: its label such as ``B = 10`` (empty for a lone one) and its system.

    ``value`` is what is varied as one number: B, δ, the common ratio c/D, or else the trace of the
    matrix; None for a lone curve. ``key`` is what is varied, as ``contact.stiffness``.
    """

    label: str
    system: System
    value: float | None = None
    key: str = ""


VARIED = {
    "contact.stiffness": "B",
    "contact.clearance": "δ",
    "system.noise_intensity": "D",
    "system.damping": "c",
}
"""Keys of ``[vary]`` with their symbols: one number for all contacts, or a whole matrix."""


def changed(system: System, key: str, value: Any) -> System:
    """Return the system in which ``key`` of ``VARIED`` has the value, a number or a matrix."""
    place = place_of(key, system)
    if place.factor:
        return replace(system, **{place.field: value})
    return with_numbers(system, {key: value})


def _read(system: System, key: str) -> Array:
    """The matrix of the system, or the number of every contact."""
    return place_of(key, system).read(system)


def curves_of(system: System, vary: Mapping[str, Mapping[str, Any]] | None) -> tuple[Curve, ...]:
    """Return the curves, the system's own first; values equal to its own are not doubled.

    Raises ``InvalidInput`` for a value that the system cannot take.
    """
    if vary is None:
        return (Curve("", system),)
    given = [
        (f"{table}.{key}", values) for table, part in vary.items() for key, values in part.items()
    ]
    if len(given) != 1:
        raise InvalidInput("vary", vary, f"must have exactly one of {', '.join(VARIED)}")
    key, values = given[0]
    if key.startswith("contact.") and not system.contacts:
        raise InvalidInput(f"vary.{key}", values, "the scene has no [[contact]] to vary")
    systems = [system]
    for i, value in enumerate(values, start=1):
        with refused_as(f"vary.{key}[{i}]", value):
            other = changed(system, key, value)
        if not any(np.array_equal(_read(other, key), _read(s, key)) for s in systems):
            systems.append(other)
    if key == "system.damping" and all(_common_ratio(s) is not None for s in systems):
        ratios = [_common_ratio(s) for s in systems]
        return tuple(Curve(f"c/D = {r:g}", s, r, key) for r, s in zip(ratios, systems, strict=True))
    values = [_read(s, key) for s in systems]
    return tuple(
        Curve(f"{VARIED[key]} = {_words(v)}", s, float(np.trace(v) if v.ndim == 2 else v[0]), key)
        for s, v in zip(systems, values, strict=True)
    )


def _common_ratio(system: System) -> float | None:
    """The ratio c_i/D_i where both are diagonal and it is the same for all i."""
    c, d = system.damping, system.noise_matrix
    diagonals = np.diag(c), np.diag(d)
    if not all(map(np.array_equal, (c, d), map(np.diag, diagonals))) or not np.all(diagonals[1]):
        return None
    ratios = diagonals[0] / diagonals[1]
    return float(ratios[0]) if np.allclose(ratios, ratios[0], rtol=1e-12) else None


def _words(value: Array) -> str:
    if value.ndim == 2 and np.array_equal(value, np.diag(np.diag(value))):
        value = np.diag(value)
    elif value.ndim == 1 and np.ptp(value) == 0:  # the same value at every contact
        value = value[:1]
    entries = [f"{x:g}" for x in value.ravel()]
    return entries[0] if len(entries) == 1 else f"({', '.join(entries)})"
