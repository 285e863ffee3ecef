"""The scene format as data for pydantic-core, and its errors in one line of the user's own words.

The core alone is used: to import pydantic itself takes longer than many an answer.
"""

from collections.abc import Callable, Mapping, Sequence
from difflib import get_close_matches
from typing import Any
from unicodedata import category

from pydantic_core import ErrorDetails, PydanticCustomError, SchemaValidator, ValidationError

from cases.scene.errors import BadInput, refused
from cases.scene.expect import RELATIONS, Range
from fpk.contact import Contact
from fpk.damping import DampingTerm
from fpk.errors import InvalidInput

Schema = dict[str, Any]

MAX_MASSES = 500
"""Matrices are full: a chain longer than this is not what they are for."""

MAX_TERMS = 200
"""A van der Pol damping of four modes has a hundred monomials."""

LARGEST, SMALLEST = 1e100, 1e-100
"""Beyond these a product of three inputs leaves the range of double precision."""


def _then(schema: Schema, function: Callable[[Any], Any]) -> Schema:
    """The schema followed by a check or conversion in Python."""
    after = {"type": "no-info", "function": function}
    return {"type": "function-after", "schema": schema, "function": after}


def _list(items: Schema, *, least: int = 1, most: int = MAX_MASSES) -> Schema:
    lengths = {"min_length": least, "max_length": most}
    return {"type": "list", "strict": True, "items_schema": items, **lengths}


def _table(required: Mapping[str, Schema], optional: Mapping[str, Schema]) -> Schema:
    """A table that refuses keys it does not know; what is left out is not in it."""
    fields = {
        key: {"type": "typed-dict-field", "schema": schema, "required": key in required}
        for key, schema in {**required, **optional}.items()
    }
    return {"type": "typed-dict", "fields": fields, "extra_behavior": "forbid"}


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


def _range(ends: dict[str, float]) -> Range:
    if len(ends) != 1:
        one = "must have exactly one of above, below, at_least, at_most"
        raise PydanticCustomError("range", one)
    return Range(*next(iter(ends.items())))


def _distinct(names: list[str]) -> tuple[str, ...]:
    if len(set(names)) != len(names):
        raise PydanticCustomError("twice", "names the same theory twice")
    return tuple(names)


def _list_or_matrix(value: Any) -> str:
    nested = isinstance(value, list) and value and isinstance(value[0], list)
    return "<matrix>" if nested else "<list>"


WHOLE = {"type": "int", "strict": True}
MASS = {"type": "int", "strict": True, "ge": 1}
FINITE = {"type": "float", "strict": True, "allow_inf_nan": False}
NUMBER = _then(FINITE, _in_range)
TEXT = _then({"type": "str", "strict": True, "max_length": 1000}, _legible)
NUMBERS = _list(NUMBER)
MATRIX = _list(NUMBERS)
NUMBERS_OR_MATRIX = {
    "type": "tagged-union",
    "choices": {"<list>": NUMBERS, "<matrix>": MATRIX},
    "discriminator": _list_or_matrix,
}
POWERS = _then(
    {
        "type": "dict",
        "keys_schema": {"type": "str", "pattern": r"^[1-9][0-9]{0,8}$"},
        "values_schema": WHOLE,
        "max_length": MAX_MASSES,
    },
    lambda powers: tuple((int(mass), power) for mass, power in powers.items()),
)
VALUES = _list(NUMBER, most=12)
MATRICES = _list(NUMBERS_OR_MATRIX, most=12)
RANGE = _then(_table({}, dict.fromkeys(RELATIONS, NUMBER)), _range)
THEORY = {"type": "literal", "expected": ["nonintegrable", "integrable"]}

SYSTEM = _table(
    {
        "mass": NUMBERS,
        "stiffness": NUMBERS,
        "damping": NUMBERS_OR_MATRIX,
        "noise_intensity": NUMBERS_OR_MATRIX,
    },
    {"noise_gain": MATRIX},
)
CONTACT = _table(
    {"mass": MASS, "side": TEXT, "stiffness": NUMBER, "clearance": NUMBER},
    {"law": TEXT, "exponent": NUMBER},
)
DAMPING_TERM = _table(
    {"i": MASS, "j": MASS, "coefficient": NUMBER}, {"q": POWERS, "v": POWERS, "energy": WHOLE}
)
VARY = _table(
    {},
    {
        "contact": _table({}, {"stiffness": VALUES, "clearance": VALUES}),
        "system": _table({}, {"noise_intensity": MATRICES, "damping": MATRICES}),
    },
)
EXPECT = _table(
    {},
    {
        "of": TEXT,
        "non_gaussian": RANGE,
        "almost_gaussian": RANGE,
        "nonintegrable_better_with": {"type": "literal", "expected": ["larger", "smaller"]},
        "better": _then(_list(THEORY, least=2, most=2), _distinct),
        "acceptable": _then(_list(THEORY, most=2), _distinct),
        "clearance_rule": _then({**FINITE, "gt": 0}, _in_range),
    },
)
SCENE = _table(
    {"system": SYSTEM},
    {
        "title": TEXT,
        "source": TEXT,
        "contact": _list(_then(CONTACT, lambda keys: Contact(**keys)), least=0),
        "damping_term": _list(
            _then(DAMPING_TERM, lambda keys: DampingTerm(**keys)), least=0, most=MAX_TERMS
        ),
        "observe": _table({"densities": _list(TEXT, most=16)}, {}),
        "vary": VARY,
        "expect": EXPECT,
    },
)
"""The whole file."""

_VALIDATOR = SchemaValidator(SCENE)  # it checks the schema itself

REMEDIES = {
    "float_type": "must be a number",
    "finite_number": "must be a finite number",
    "int_type": "must be a whole number",
    "int_from_float": "must be a whole number, written without a point",
    "string_type": "must be text in quotes",
    "list_type": "must be a list, in square brackets",
    "dict_type": "must be a table",
    "greater_than": "must be > 0",
    "greater_than_equal": "must be 1 or more; masses are counted from 1",
    "string_pattern_mismatch": "is not the number of a mass; masses are counted from 1",
    "string_too_long": "is too long; at most 1000 characters",
    "too_short": "must have at least {min_length} entries",
    "too_long": "must have at most {max_length} entries",
    "literal_error": "use {expected}",
}


def validated(data: dict[str, Any], label: str) -> dict[str, Any]:
    """Return the checked tables; raise ``BadInput`` with the first thing that is wrong."""
    try:
        tables: dict[str, Any] = _VALIDATOR.validate_python(data)
    except ValidationError as error:
        errors = error.errors(include_url=False)
        # A misspelt key is also a missing one: say the cause, not the consequence.
        errors.sort(key=lambda e: e["type"] != "extra_forbidden")
        raise _refusal(errors[0], label) from None
    return tables


def refused_value(label: str, place: str, error: InvalidInput) -> BadInput:
    """Return the refusal of what the table at ``place`` was made of."""
    key = f"{place}.{error.key}" if place else error.key
    if error.value is None:
        return BadInput(f"{label}: {key} is missing: {error.remedy}")
    return refused(label, key, error.value, error.remedy)


def _refusal(error: ErrorDetails, label: str) -> BadInput:
    kind, place = error["type"], [p for p in error["loc"] if not str(p).startswith(("<", "[key"))]
    key, context = toml_key(place), error.get("ctx", {})
    if isinstance(invalid := context.get("error"), InvalidInput):
        return refused_value(label, key, invalid)
    if kind == "missing":
        if place == ["system"]:
            return BadInput(
                f"{label}: [system] is missing: give mass, stiffness, damping, noise_intensity"
            )
        return BadInput(f"{label}: {key} is missing; add it")
    if kind == "extra_forbidden":
        return refused(label, key, error["input"], _known_keys(place))
    if key in ("contact", "damping_term") and kind == "list_type":
        return refused(label, key, error["input"], f"must be written as [[{key}]]")
    remedy = REMEDIES.get(kind, error["msg"]).format(**context).replace("'", '"')
    return refused(label, key, error["input"], remedy)


def toml_key(place: Sequence[int | str]) -> str:
    """Return the key as a user would look for it: ``contact[1].clearance``, counted from 1."""
    key = ""
    for part in place:
        key += f"[{part + 1}]" if isinstance(part, int) else f".{part}" if key else part
    return key or "scene"


def _known_keys(place: Sequence[int | str]) -> str:
    table: Schema = SCENE
    for part in place[:-1]:
        table = table["items_schema"] if isinstance(part, int) else table["fields"][part]
        while "schema" in table:
            table = table["schema"]
    close = get_close_matches(str(place[-1]), table["fields"], n=1, cutoff=0.6)
    if close:
        return f'is not a key of a scene; did you mean "{close[0]}"?'
    return f"is not a key of a scene; here are known: {', '.join(table['fields'])}"
