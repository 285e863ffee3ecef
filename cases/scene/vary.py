"""The curves of a figure: the scene's own system and those in which one key takes other values."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from cases.scene.errors import BadInput, refused
from fpk.errors import InvalidInput
from fpk.system import System


@dataclass(frozen=True)
class Curve:
    """One curve of a figure: its label such as ``B = 10`` (empty for a lone one) and its system.

    ``value`` is what is varied as one number: B, δ, the common ratio c/D, or else the trace of the
    matrix; None for a lone curve.
    """

    label: str
    system: System
    value: float | None = None


Varied = tuple[str, Callable[[System, Any], System], Callable[[System], Any]]


def _of_contacts(symbol: str, key: str) -> Varied:
    """A number that every contact takes."""

    def changed(system: System, value: Any) -> System:
        return replace(system, contacts=tuple(replace(c, **{key: value}) for c in system.contacts))

    return symbol, changed, lambda system: [getattr(c, key) for c in system.contacts]


def _of_system(symbol: str, key: str) -> Varied:
    """A matrix of the system."""
    return (
        symbol,
        lambda system, value: replace(system, **{key: value}),
        lambda system: getattr(system, key),
    )


VARIED = {
    "contact.stiffness": _of_contacts("B", "stiffness"),
    "contact.clearance": _of_contacts("δ", "clearance"),
    "system.noise_intensity": _of_system("D", "noise_intensity"),
    "system.damping": _of_system("c", "damping"),
}
"""What ``[vary]`` may vary: symbol, how a value enters the system, how it is read from one."""


def curves_of(
    system: System, vary: Mapping[str, Mapping[str, Any]] | None, label: str
) -> tuple[Curve, ...]:
    """Return the curves, the system's own first; values equal to its own are not doubled.

    Raises ``BadInput`` for a value that the system cannot take.
    """
    if vary is None:
        return (Curve("", system),)
    given = [
        (f"{table}.{key}", values) for table, part in vary.items() for key, values in part.items()
    ]
    if len(given) != 1:
        raise BadInput(f"{label}: vary: must have exactly one of {', '.join(VARIED)}")
    key, values = given[0]
    if key.startswith("contact.") and not system.contacts:
        raise BadInput(f"{label}: vary.{key}: the scene has no [[contact]] to vary")
    symbol, changed, read = VARIED[key]
    systems = [system]
    for i, value in enumerate(values):
        try:
            other = changed(system, value)
        except InvalidInput as error:
            raise refused(label, f"vary.{key}[{i + 1}]", value, error.remedy) from None
        if other.n != system.n:
            raise refused(label, f"vary.{key}[{i + 1}]", value, f"must fit {system.n} masses")
        if not any(np.array_equal(read(other), read(s)) for s in systems):
            systems.append(other)
    if key == "system.damping" and all(_common_ratio(s) is not None for s in systems):
        return tuple(Curve(f"c/D = {_common_ratio(s):g}", s, _common_ratio(s)) for s in systems)
    return tuple(Curve(f"{symbol} = {_words(read(s))}", s, _size(read(s))) for s in systems)


def _size(value: Any) -> float:
    """One number for a value: a contact's own (the first contact's), the trace of a matrix."""
    array = np.asarray(value, dtype=float)
    return float(np.trace(array) if array.ndim == 2 else array[0])


def _common_ratio(system: System) -> float | None:
    """The ratio c_i/D_i where both are diagonal and it is the same for all i."""
    c, d = system.damping, system.noise_matrix
    diagonal = all(np.array_equal(m, np.diag(np.diag(m))) for m in (c, d))
    if not (diagonal and np.all(np.diag(d))):
        return None
    ratios = np.diag(c) / np.diag(d)
    return float(ratios[0]) if np.allclose(ratios, ratios[0], rtol=1e-12) else None


def _words(value: Any) -> str:
    array = np.asarray(value)
    if array.ndim == 2 and np.array_equal(array, np.diag(np.diag(array))):
        array = np.diag(array)
    elif array.ndim == 1 and np.ptp(array) == 0:  # the same value at every contact
        array = array[:1]
    entries = [f"{x:g}" for x in array.ravel()]
    return entries[0] if len(entries) == 1 else f"({', '.join(entries)})"
