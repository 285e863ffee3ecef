"""Numbers of a system by their path, as ``contact[1].clearance``; curves in which one varies."""

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from cases.scene.errors import about_key
from cases.scene.units import DERIVED, NUMBER, Powers
from fpk.numeric.arrays import Array
from fpk.numeric.errors import InvalidInput, require
from fpk.system.contact import Contact
from fpk.system.damping import DampingTerm
from fpk.system.system import System

ARRAYS = ("mass", "stiffness", "damping", "noise_intensity", "noise_gain")
RECORDS = {
    "contact": ("contacts", ("stiffness", "clearance", "exponent")),
    "damping_term": ("damping_terms", ("coefficient",)),
}
"""Table of a scene: the field of ``System`` with its records, and numbers that a path can name."""
PATH = re.compile(r"(\w+)(?:\[([0-9]{1,4})\])?\.(\w+)(?:\[([0-9]{1,4})(?:,([0-9]{1,4}))?\])?")


@dataclass(frozen=True)
class Place:
    """Where a number stands in a ``System``.

    ``field`` is an array (``name`` is then empty), or a list of records (``contacts``,
    ``damping_terms``) with the number ``name``. ``index`` counts from 0: (i,) is an entry of a
    vector or a record, (i, j) an entry of a matrix, None the whole array or all records.
    """

    field: str
    name: str
    index: tuple[int, ...] | None

    @property
    def factor(self) -> bool:
        """Whether the number multiplies a whole array, as ``system.damping``: no name, no index."""
        return not self.name and self.index is None

    def read(self, system: System) -> Array:
        """Return the whole array of the field, or the number of every record, for any ``index``."""
        own = getattr(system, self.field)
        return np.array([getattr(record, self.name) for record in own] if self.name else own)

    def powers(self, system: System) -> Powers | None:
        """Return the exponents of length, mass and time in the unit of the number; 0 for a factor.

        None if the records of a list differ in them, and for entries of D and of the noise gain if
        the gain is not the identity: a scene does not define their dimensions then.
        """
        if self.factor:
            return NUMBER
        if self.field in ("noise_intensity", "noise_gain") and not has_unit_gain(system):
            return None
        if not self.name:
            return {"mass": (0, 1, 0), "noise_gain": NUMBER, **DERIVED}[self.field]
        records = getattr(system, self.field)
        chosen = records if self.index is None else [records[self.index[0]]]
        different = {_powers_of(record, self.name) for record in chosen}
        return different.pop() if len(different) == 1 else None

    def overlaps(self, other: "Place") -> bool:
        """Whether setting either changes the other; an array or list overlaps its entries."""
        same = (self.field, self.name) == (other.field, other.name)
        return same and (self.index == other.index or None in (self.index, other.index))


def has_unit_gain(system: System) -> bool:
    """Return whether the noise gain is the identity, so that D is the intensity of forces."""
    return np.array_equal(np.asarray(system.noise_gain), np.eye(system.n))


def _powers_of(record: Contact | DampingTerm, name: str) -> Powers:
    """Return the exponents of length, mass and time of a number of ``record``.

    ``name``: clearance, exponent e or stiffness B of a contact, force B x^e; of a damping term
    c qᵐ vⁿ Hᵏ it is not read, the number is the coefficient c.
    """
    if isinstance(record, Contact):
        own = {"clearance": (1, 0, 0), "exponent": NUMBER, "stiffness": (1 - record.power, 1, -2)}
        return own[name]
    q, v = (sum(power for _, power in pairs) for pairs in (record.q, record.v))
    H = record.energy
    return -q - v - 2 * H, 1 - H, v + 2 * H - 1


def place_of(path: str, system: System) -> Place:
    """Return the place of the number that ``path`` names.

    ``system.mass[2]`` and ``contact[1].clearance`` count from 1. In a matrix ``[2]`` is an entry of
    the diagonal, ``[1,2]`` any entry. ``contact.stiffness`` is the stiffness of all contacts,
    ``system.damping`` a factor of the whole matrix. ``damping_term[1]`` is the first term that
    depends on the state: constant terms are part of ``system.damping``.

    Raises ``InvalidInput`` with the list of all paths of the system.
    """
    if match := PATH.fullmatch(path):
        table, record, name, *entry = match.groups()
        if table == "system" and name in ARRAYS and record is None:
            index = tuple(int(i) - 1 for i in entry if i is not None)
            shape = getattr(system, name).shape
            if len(index) == 1 and len(shape) == 2:
                index *= 2
            index = tuple(sorted(index)) if name == "noise_intensity" else index
            inside = all(0 <= i < size for i, size in zip(index, shape, strict=False))
            if not index or (len(index) == len(shape) and inside):
                return Place(name, "", index or None)
        elif table in RECORDS and name in RECORDS[table][1] and entry[0] is None:
            count = len(getattr(system, RECORDS[table][0]))
            if count and (record is None or 1 <= int(record) <= count):
                return Place(RECORDS[table][0], name, (int(record) - 1,) if record else None)
    raise InvalidInput("path", path, f"is no number of the system; there are {_all_paths(system)}")


def _all_paths(system: System) -> str:
    """Return all paths of the system in one line, with ranges: ``contact[1..2].stiffness, …``."""
    counts = {table: len(getattr(system, field)) for table, (field, _) in RECORDS.items()}
    words = [f"{t}[1..{n}].{name}" for t, n in counts.items() if n for name in RECORDS[t][1]]
    for name in ARRAYS:
        sizes = ",".join(f"1..{size}" for size in getattr(system, name).shape)
        words.append(f"system.{name}[{sizes}]")
    words += [] if counts["contact"] else ["no [[contact]]"]
    return f"{', '.join(words)}; without [..]: all contacts or terms, or a factor of an array"


def with_numbers(system: System, values: Mapping[str, float]) -> System:
    """Return a new system with the numbers ``values``, by paths (``place_of``) without overlap.

    A path of a whole array multiplies it; a path of all contacts sets each; D_ij sets D_ji, too.
    Raises ``InvalidInput`` for an unknown path, or for a number that the system cannot take.
    """
    fields: dict[str, Any] = {}
    for path, value in values.items():
        place = place_of(path, system)
        own = getattr(system, place.field)
        held = fields.setdefault(place.field, list(own) if place.name else np.array(own))
        if place.factor:
            held *= value
        elif place.name:
            for i in range(len(held)) if place.index is None else place.index:
                held[i] = replace(held[i], **{place.name: value})
        else:
            held[place.index] = value
            if place.field == "noise_intensity":
                held[place.index[::-1]] = value  # type: ignore[index]  # not None: no factor
    return replace(system, **fields)


@dataclass(frozen=True)
class Curve:
    """One curve of a figure: its ``label``, such as ``B = 10``, and its system.

    ``key`` is the varied key, as ``contact.stiffness``, and ``value`` its value as one number: B
    or δ of the first contact, the ratio c/D if ``system.damping`` is varied and every curve has a
    common ratio, or else the trace of the matrix. A lone curve has an empty label and the value
    None.
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


def curves_of(system: System, vary: Mapping[str, Mapping[str, Any]] | None) -> tuple[Curve, ...]:
    """Return the curves: first ``system`` itself, then it with each value of the varied key.

    ``vary`` is the table [vary], {table: {key: values}}; None: ``system`` alone. A value that
    ``system`` or an earlier curve has makes no curve. Raises ``InvalidInput`` unless there is
    exactly one key, for a key of contacts without contacts, and for a value that the system cannot
    take.
    """
    if vary is None:
        return (Curve("", system),)
    given = [
        (f"{table}.{key}", values) for table, part in vary.items() for key, values in part.items()
    ]
    require(len(given) == 1, "vary", vary, f"must have exactly one of {', '.join(VARIED)}")
    key, values = given[0]
    if key.startswith("contact.") and not system.contacts:
        raise InvalidInput(f"vary.{key}", values, "the scene has no [[contact]] to vary")
    place, systems = place_of(key, system), [system]
    for i, value in enumerate(values, start=1):
        with about_key(f"vary.{key}[{i}]", value):
            if place.factor:  # [vary] gives the whole matrix, not a factor of the system's matrix
                other = replace(system, **{place.field: value})
            else:
                other = with_numbers(system, {key: value})
        if not any(np.array_equal(place.read(other), place.read(s)) for s in systems):
            systems.append(other)
    ratios = [_common_ratio(s) for s in systems]
    curves = []
    for s, ratio in zip(systems, ratios, strict=True):
        v = place.read(s)
        label, number = f"{VARIED[key]} = {_words(v)}", float(np.trace(v) if v.ndim == 2 else v[0])
        if key == "system.damping" and ratio is not None and None not in ratios:
            label, number = f"c/D = {ratio:g}", ratio
        curves.append(Curve(label, s, number, key))
    return tuple(curves)


def _common_ratio(system: System) -> float | None:
    """Return c_i/D_i if c and f D fᵀ are diagonal, no D_i is 0 and all ratios agree, else None."""
    matrices = system.damping, system.noise_matrix
    c, d = map(np.diag, matrices)
    if not all(map(np.array_equal, matrices, map(np.diag, (c, d)))) or not np.all(d):
        return None
    ratios = c / d
    return float(ratios[0]) if np.allclose(ratios, ratios[0], rtol=1e-12, atol=0.0) else None


def _words(value: Array) -> str:
    if value.ndim == 2 and np.array_equal(value, np.diag(np.diag(value))):
        value = np.diag(value)
    elif value.ndim == 1 and np.ptp(value) == 0:  # the same value at every contact
        value = value[:1]
    words = ", ".join(f"{x:g}" for x in value.ravel())
    return words if value.size == 1 else f"({words})"
