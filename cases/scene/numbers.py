"""Numbers of a system by their path in a scene, such as ``contact[1].clearance``."""

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from cases.scene.units import DERIVED, NUMBER, Powers
from fpk.arrays import Array
from fpk.contact import Contact
from fpk.damping import DampingTerm
from fpk.errors import InvalidInput
from fpk.system import System

ARRAYS = ("mass", "stiffness", "damping", "noise_intensity", "noise_gain")
RECORDS = {
    "contact": ("contacts", ("stiffness", "clearance", "exponent")),
    "damping_term": ("damping_terms", ("coefficient",)),
}
"""By the name of a table its field of ``System``, and the numbers that it holds."""
PATH = re.compile(r"(\w+)(?:\[([0-9]{1,4})\])?\.(\w+)(?:\[([0-9]{1,4})(?:,([0-9]{1,4}))?\])?")


@dataclass(frozen=True)
class Place:
    """Where a number stands in a ``System``.

    ``field`` is an array, ``name`` then empty, or a list of records (``contacts``,
    ``damping_terms``) that have the number ``name``. ``index`` counts from 0: (i,) is an entry of a
    vector or a record, (i, j) an entry of a matrix, None the whole array or all records.
    """

    field: str
    name: str
    index: tuple[int, ...] | None

    @property
    def factor(self) -> bool:
        """Whether the number is a factor of a whole array."""
        return not self.name and self.index is None

    def read(self, system: System) -> Array:
        """Return the whole array of the field, or the number of every record."""
        own = getattr(system, self.field)
        return np.array([getattr(record, self.name) for record in own] if self.name else own)

    def powers(self, system: System) -> Powers | None:
        """Powers of length, mass and time of the number; None where its records differ in them."""
        if self.factor:
            return NUMBER
        if not self.name:
            return {"mass": (0, 1, 0), "noise_gain": NUMBER, **DERIVED}[self.field]
        records = getattr(system, self.field)
        chosen = records if self.index is None else [records[self.index[0]]]
        different = {_powers_of(record, self.name) for record in chosen}
        return different.pop() if len(different) == 1 else None

    def overlaps(self, other: "Place") -> bool:
        """Whether both change the same number."""
        same = (self.field, self.name) == (other.field, other.name)
        return same and (self.index == other.index or None in (self.index, other.index))


def _powers_of(record: Contact | DampingTerm, name: str) -> Powers:
    """Powers of a number of a contact, g = B x^e, or of a damping term, c qᵐ vⁿ Hᵏ."""
    if isinstance(record, Contact):
        own = {"clearance": (1, 0, 0), "exponent": NUMBER, "stiffness": (1 - record.power, 1, -2)}
        return own[name]
    q, v = (sum(power for _, power in pairs) for pairs in (record.q, record.v))
    H = record.energy
    return -q - v - 2 * H, 1 - H, v + 2 * H - 1


def place_of(path: str, system: System) -> Place:
    """Return the place of the number that ``path`` names.

    ``system.mass[2]`` and ``contact[1].clearance`` count from 1, of a matrix ``[2]`` is an entry of
    the diagonal and ``[1,2]`` any; ``contact.stiffness`` is that of all contacts,
    ``system.damping`` a factor of the whole matrix. ``damping_term[1]`` is the first that depends
    on the state: constant ones are part of ``system.damping``.

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
    raise InvalidInput("path", path, f"is no number of the system; there are {_listed(system)}")


def _listed(system: System) -> str:
    """All paths of the system in one line, a range of indices in the place of each."""
    counts = {table: len(getattr(system, field)) for table, (field, _) in RECORDS.items()}
    words = [f"{t}[1..{n}].{name}" for t, n in counts.items() if n for name in RECORDS[t][1]]
    for name in ARRAYS:
        sizes = ",".join(f"1..{size}" for size in getattr(system, name).shape)
        words.append(f"system.{name}[{sizes}]")
    words += [] if counts["contact"] else ["no [[contact]]"]
    return f"{', '.join(words)}; without [..]: all contacts or terms, or a factor of an array"


def with_numbers(system: System, values: Mapping[str, float]) -> System:
    """Return the system with other numbers at paths that do not overlap.

    Raises ``InvalidInput`` as ``place_of``, or for a number that the system cannot take.
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
