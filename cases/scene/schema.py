"""The scene format as pydantic models, and its errors in one line of the user's own words."""

from collections.abc import Mapping, Sequence
from difflib import get_close_matches
from typing import Annotated, Any
from unicodedata import category

from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Discriminator,
    Field,
    Tag,
    ValidationError,
)
from pydantic_core import ErrorDetails, PydanticCustomError

from cases.scene.errors import BadInput, refused

MAX_MASSES = 500
"""Matrices are full: a chain longer than this is not what they are for."""

MAX_TERMS = 200
"""A van der Pol damping of four modes has a hundred monomials."""

LARGEST, SMALLEST = 1e100, 1e-100
"""Beyond these a product of three inputs leaves the range of double precision."""


def _in_range(value: float) -> float:
    if value != 0 and not SMALLEST <= abs(value) <= LARGEST:
        raise PydanticCustomError("size", "must be 0 or between 1e-100 and 1e100 in size")
    return value


def _legible(text: str) -> str:
    controls = (c for c in text if category(c) == "Cc" or c in "\ufffe\uffff")
    hidden = next((c for c in controls if c not in "\t\n"), None)
    if hidden is not None:  # acts on a terminal, cannot stand in XML or netCDF
        code = {"character": f"U+{ord(hidden):04X}"}
        raise PydanticCustomError("hidden", "holds the character {character}; leave it out", code)
    return text


def _list_or_matrix(value: Any) -> str:
    nested = isinstance(value, list) and value and isinstance(value[0], list)
    return "<matrix>" if nested else "<list>"


Number = Annotated[float, Field(strict=True, allow_inf_nan=False), AfterValidator(_in_range)]
Numbers = Annotated[list[Number], Field(min_length=1, max_length=MAX_MASSES)]
Matrix = Annotated[list[Numbers], Field(min_length=1, max_length=MAX_MASSES)]
NumbersOrMatrix = Annotated[
    Annotated[Numbers, Tag("<list>")] | Annotated[Matrix, Tag("<matrix>")],
    Discriminator(_list_or_matrix),
]
Powers = Annotated[dict[str, int], Field(max_length=MAX_MASSES)]
Text = Annotated[str, Field(strict=True, max_length=1000), AfterValidator(_legible)]


class Table(BaseModel):
    """A table that refuses keys it does not know."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)


class SystemTable(Table):
    """``[system]``: the chain of Eq. (1)."""

    mass: Numbers
    stiffness: Numbers
    damping: NumbersOrMatrix
    noise_intensity: NumbersOrMatrix
    noise_gain: Matrix | None = None


class ContactTable(Table):
    """``[[contact]]``: one stop or a pair of stops, Eq. (2)."""

    mass: Annotated[int, Field(ge=1)]
    side: Text
    stiffness: Number
    clearance: Number
    law: Text = "hertz"
    exponent: Number | None = None


class DampingTermTable(Table):
    """``[[damping_term]]``: what the entry c_ij of the damping gains with the state."""

    i: Annotated[int, Field(ge=1)]
    j: Annotated[int, Field(ge=1)]
    coefficient: Number
    q: Powers = {}
    v: Powers = {}
    energy: int = 0


class ObserveTable(Table):
    """``[observe]``: what is looked at."""

    densities: Annotated[list[Text], Field(min_length=1, max_length=16)]


Values = Annotated[list[Number], Field(min_length=1, max_length=12)]
Lists = Annotated[list[NumbersOrMatrix], Field(min_length=1, max_length=12)]


class VaryContactTable(Table):
    """``contact.…`` in ``[vary]``: values that every contact takes in turn."""

    stiffness: Values | None = None
    clearance: Values | None = None


class VarySystemTable(Table):
    """``system.…`` in ``[vary]``: values of the system's own key, one after the other."""

    noise_intensity: Lists | None = None
    damping: Lists | None = None


class VaryTable(Table):
    """``[vary]``: the further curves of a figure; exactly one key takes several values."""

    contact: VaryContactTable | None = None
    system: VarySystemTable | None = None


class RangeTable(Table):
    """Values of the varied key for which a claim is made; exactly one end is given."""

    above: Number | None = None
    below: Number | None = None
    at_least: Number | None = None
    at_most: Number | None = None


class ExpectTable(Table):
    """``[expect]``: what the source claims of the figure, as checks on numbers."""

    of: Text | None = None
    non_gaussian: RangeTable | None = None
    almost_gaussian: RangeTable | None = None
    nonintegrable_better_with: Text | None = None
    better: Annotated[list[Text], Field(min_length=2, max_length=2)] | None = None
    acceptable: Annotated[list[Text], Field(min_length=1, max_length=2)] | None = None
    clearance_rule: Number | None = None


class SceneTable(Table):
    """The whole file."""

    title: Text = ""
    source: Text = ""
    system: SystemTable
    contact: Annotated[list[ContactTable], Field(max_length=MAX_MASSES)] = []
    damping_term: Annotated[list[DampingTermTable], Field(max_length=MAX_TERMS)] = []
    observe: ObserveTable | None = None
    vary: VaryTable | None = None
    expect: ExpectTable | None = None


TABLES: Mapping[tuple[str, ...], type[Table]] = {
    (): SceneTable,
    ("system",): SystemTable,
    ("contact",): ContactTable,
    ("damping_term",): DampingTermTable,
    ("observe",): ObserveTable,
    ("vary",): VaryTable,
    ("vary", "contact"): VaryContactTable,
    ("vary", "system"): VarySystemTable,
    ("expect",): ExpectTable,
    ("expect", "non_gaussian"): RangeTable,
    ("expect", "almost_gaussian"): RangeTable,
}

REMEDIES = {
    "float_type": "must be a number",
    "finite_number": "must be a finite number",
    "int_type": "must be a whole number",
    "int_from_float": "must be a whole number, written without a point",
    "string_type": "must be text in quotes",
    "list_type": "must be a list, in square brackets",
    "model_type": "must be a table",
    "dict_type": "must be a table",
    "greater_than_equal": "must be 1 or more; masses are counted from 1",
    "string_too_long": "is too long; at most 1000 characters",
}


def validated(data: dict[str, Any], label: str) -> SceneTable:
    """Return the checked tables; raise ``BadInput`` with the first thing that is wrong."""
    try:
        return SceneTable.model_validate(data)
    except ValidationError as error:
        errors = error.errors(include_url=False)
        # A misspelt key is also a missing one: say the cause, not the consequence.
        errors.sort(key=lambda e: e["type"] != "extra_forbidden")
        raise _refusal(errors[0], label) from None


def _refusal(error: ErrorDetails, label: str) -> BadInput:
    kind, place = error["type"], [p for p in error["loc"] if not str(p).startswith("<")]
    key = toml_key(place)
    if kind == "missing":
        if place == ["system"]:
            return BadInput(
                f"{label}: [system] is missing: give mass, stiffness, damping, noise_intensity"
            )
        return BadInput(f"{label}: {key} is missing; add it")
    if kind == "extra_forbidden":
        return refused(label, key, error["input"], _known_keys(place))
    if kind in ("too_short", "too_long"):
        ctx = error["ctx"]
        limit = ctx.get("max_length") if kind == "too_long" else ctx.get("min_length")
        words = "at most" if kind == "too_long" else "at least"
        return refused(label, key, error["input"], f"must have {words} {limit} entries")
    if key in ("contact", "damping_term") and kind in ("list_type", "model_type"):
        return refused(label, key, error["input"], f"must be written as [[{key}]]")
    return refused(label, key, error["input"], REMEDIES.get(kind, error["msg"]))


def toml_key(place: Sequence[int | str]) -> str:
    """Return the key as a user would look for it: ``contact[1].clearance``, counted from 1."""
    key = ""
    for part in place:
        key += f"[{part + 1}]" if isinstance(part, int) else f".{part}" if key else part
    return key or "scene"


def _known_keys(place: Sequence[int | str]) -> str:
    table = TABLES.get(tuple(p for p in place[:-1] if isinstance(p, str)), SceneTable)
    known = list(table.model_fields)
    close = get_close_matches(str(place[-1]), known, n=1, cutoff=0.6)
    if close:
        return f'is not a key of a scene; did you mean "{close[0]}"?'
    return f"is not a key of a scene; here are known: {', '.join(known)}"
