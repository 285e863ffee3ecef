"""The scene format as data for pydantic-core, and its errors in the user's own words.

The core alone is used: to import pydantic itself takes longer than many an answer. A refusal names
its key as the user would look for it, ``contact[1].clearance`` say, counted from 1.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, get_args
from unicodedata import category

from pydantic_core import ErrorDetails, PydanticCustomError, SchemaValidator, ValidationError
from pydantic_core import core_schema as core

from cases.scene.errors import misspelt
from cases.scene.expect import RELATIONS
from cases.scene.units import Units
from fpk.numeric.errors import InvalidInput
from fpk.system.contact import Contact, Side
from fpk.system.contact_law import LAWS
from fpk.system.damping import DampingTerm
from fpk.system.modulation import Modulation

MAX_MASSES = 500
"""Largest number of masses; matrices are full."""

MAX_TERMS = 200
"""Largest number of damping terms; van der Pol damping of four modes has a hundred monomials."""

MOST_LEVELS = 12
"""Largest number of exceedance levels of an observable."""

MOST_QUESTIONS, MOST_TIMES = 4, 50
"""Largest number of [[passage]] or [[transient]] tables, and of times in each."""

MOST_OBSERVED = 16
"""Largest number of densities of a scene."""

LARGEST, SMALLEST = 1e100, 1e-100
"""Range of the modulus of a number that is not 0: a product of three stays in double precision."""


def _list(items: core.CoreSchema, *, least: int = 1, most: int = MAX_MASSES) -> core.ListSchema:
    return core.list_schema(items, min_length=least, max_length=most, strict=True)


def _table(required: str, **keys: Any) -> core.TypedDictSchema:
    """Return the schema of a table with these ``keys``; any other key is an error.

    ``required``: names of keys that must be given, separated by blanks; other absent keys get no
    default. The value of a key is its schema, or (schema, description, further metadata).
    """
    fields = {
        key: core.typed_dict_field(
            _said(*schema) if isinstance(schema, tuple) else schema,
            required=key in required.split(),
        )
        for key, schema in keys.items()
    }
    return core.typed_dict_schema(fields, extra_behavior="forbid")


def _records(make: Callable[..., Any], table: core.CoreSchema, most: int = MAX_MASSES) -> Any:
    """Return the schema of a list of 0 to ``most`` tables, each replaced by ``make(**table)``."""
    return _list(_then(lambda keys: make(**keys), table), least=0, most=most)


def _in_range(value: float) -> float:
    if value != 0 and not SMALLEST <= abs(value) <= LARGEST:
        raise PydanticCustomError("finite_number", "out of range")
    return value


def _legible(text: str) -> str:
    for c in text:  # a control character acts on a terminal and cannot stand in XML or netCDF
        if (category(c) == "Cc" and c not in "\t\n") or c in "\ufffe\uffff":
            code = {"character": f"U+{ord(c):04X}"}
            raise PydanticCustomError(
                "hidden", "holds the character {character}; leave it out", code
            )
    return text


def _distinct(names: list[str]) -> list[str]:
    if len(set(names)) != len(names):
        raise PydanticCustomError("twice", "names the same theory twice")
    return names


def _list_or_matrix(value: Any) -> str:
    nested = isinstance(value, list) and value and isinstance(value[0], list)
    return "<matrix>" if nested else "<list>"


def _said(schema: Any, description: str, more: Mapping[str, Any] | None = None) -> Any:
    """Return a copy of ``schema`` with ``description`` and ``more`` as keys of its JSON Schema."""
    return {**schema, "metadata": {"description": description, **(more or {})}}


_then = core.no_info_after_validator_function
"""``_then(function, schema)``: the schema followed by a check or conversion in Python."""

WHOLE = core.int_schema(strict=True)
MASS = core.int_schema(strict=True, ge=1)
NUMBER = _then(_in_range, core.float_schema(strict=True, allow_inf_nan=False))
TEXT = _then(_legible, core.str_schema(strict=True, max_length=1000))
NUMBERS = _list(NUMBER)
MATRIX = _list(NUMBERS)
NUMBERS_OR_MATRIX = core.tagged_union_schema(
    {"<list>": NUMBERS, "<matrix>": MATRIX}, _list_or_matrix
)
POWERS = _then(
    lambda powers: tuple((int(mass), power) for mass, power in powers.items()),
    core.dict_schema(
        _said(core.str_schema(pattern=r"^[1-9][0-9]{0,8}$"), "mass"), WHOLE, max_length=MAX_MASSES
    ),
)
VALUES = _list(NUMBER, most=12)
MATRICES = _list(NUMBERS_OR_MATRIX, most=12)
RANGE = _table("", **{key: (NUMBER, f"claimed to be {key.replace('_', ' ')}") for key in RELATIONS})
THEORY = core.literal_schema(["nonintegrable", "integrable"])
TIMES = _list(NUMBER, most=MOST_TIMES)
UNIT = core.str_schema(strict=True, pattern=r"^[A-Za-zµμΩÅ]{1,16}$")

SCENE = _table(
    "system",
    system=_table(
        "mass stiffness damping noise_intensity",
        mass=(NUMBERS, "m_i of the chain, mass 1 nearest to the wall"),
        stiffness=(NUMBERS, "k_i joins mass i to mass i-1, k_1 to the wall"),
        damping=(NUMBERS_OR_MATRIX, "c_i, or a full matrix"),
        noise_intensity=(NUMBERS_OR_MATRIX, "D_l with E[W W'] = 2 D delta, or a full matrix"),
        noise_gain=(MATRIX, "f_il; the identity where it is left out"),
    ),
    title=(TEXT, "what the scene shows"),
    source=(TEXT, "where its values come from"),
    units=_then(
        lambda keys: Units(**keys),
        _table(
            "length mass time",
            **{key: (UNIT, f"name of the unit of {key}") for key in ("length", "mass", "time")},
        ),
    ),
    contact=_records(
        Contact,
        _table(
            "mass side stiffness clearance",
            mass=(MASS, "number of the mass, counted from 1"),
            side=(TEXT, "where the stop stands", {"enum": list(get_args(Side))}),
            stiffness=(NUMBER, "B: force / length**exponent"),
            clearance=(NUMBER, "gap at rest"),
            law=(TEXT, "hertz where it is left out", {"enum": sorted(LAWS)}),
            exponent=(NUMBER, "of the law power only"),
        ),
    ),
    damping_term=_records(
        DampingTerm,
        _table(
            "i j coefficient",
            i=(MASS, "row of the damping matrix: the mass that feels the force"),
            j=(MASS, "column: the mass whose velocity makes it"),
            coefficient=(NUMBER, "what c_ij gains, times the powers"),
            q=(POWERS, "powers of displacements by mass, as { 1 = 2 } for q_1^2"),
            v=(POWERS, "powers of velocities by mass"),
            energy=(WHOLE, "power of the total energy H"),
        ),
        MAX_TERMS,
    ),
    passage=_list(
        _table(
            "limit",
            limit=(TEXT, "H=1.5, H1=0.4,H2=0.6 (either), q2=1.2 (|q2|), q2>1.2, q2<-0.8 or v2=0.9"),
            start=(TEXT, "rest where it is left out; H=0.3, q1=0.2,p1=0.1 or noise=0.5"),
            times=(TIMES, "times of the reliability"),
            theory=(THEORY, "what the claims are about; nonintegrable where it is left out"),
            rate_error=RANGE,
            failure_error=RANGE,
        ),
        least=0,
        most=MOST_QUESTIONS,
    ),
    transient=_list(
        _table(
            "of times",
            of=(TEXT, "one coordinate, as H"),
            times=(TIMES, "times after the start"),
            start=(TEXT, "as of [[passage]]"),
        ),
        least=0,
        most=MOST_QUESTIONS,
    ),
    modulation=_then(
        lambda keys: Modulation(**keys),
        _table(
            "times factor",
            times=(NUMBERS, "ascending from 0"),
            factor=(NUMBERS, "e at these times, linear between and constant after: noise e(t)^2 D"),
        ),
    ),
    observe=_table(
        "densities",
        densities=(_list(TEXT, most=MOST_OBSERVED), "q1.., p1.., H, H1.., or a pair a,b"),
        exceedance=(
            core.dict_schema(
                _said(TEXT, "observable"), _list(NUMBER, most=MOST_LEVELS), max_length=MOST_OBSERVED
            ),
            "levels a of P(X > a), as { q2 = [0.6, 0.8] }; X is observed",
        ),
    ),
    vary=_table(
        "",
        contact=_table(
            "",
            stiffness=(VALUES, "B of every contact, a curve for each value"),
            clearance=(VALUES, "gap of every contact, a curve for each value"),
        ),
        system=_table(
            "",
            noise_intensity=(MATRICES, "D, a curve for each list or matrix"),
            damping=(MATRICES, "c, a curve for each list or matrix"),
        ),
    ),
    expect=_table(
        "",
        of=(TEXT, "the density that the claims are about; the first observed if left out"),
        non_gaussian=RANGE,
        almost_gaussian=RANGE,
        nonintegrable_better_with=(
            core.literal_schema(["larger", "smaller"]),
            "where along [vary] energy averaging is better",
        ),
        better=(
            _then(_distinct, _list(THEORY, least=2, most=2)),
            "the first is nearer to the full system",
        ),
        acceptable=(_then(_distinct, _list(THEORY, most=2)), "within 0.1 in L1 of the full system"),
        clearance_rule=(
            _then(_in_range, core.float_schema(strict=True, allow_inf_nan=False, gt=0)),
            "modal averaging is acceptable beyond so many rms",
        ),
    ),
)
"""Schema of a scene file. Validation replaces contacts, damping terms, units and the modulation by
their records."""

_VALIDATOR = SchemaValidator(SCENE)  # it checks the schema itself

REMEDIES = {
    "float_type": "must be a number",
    "finite_number": "must be a finite number, 0 or between 1e-100 and 1e100 in size",
    "int_type": "must be a whole number, written without a point",
    "int_from_float": "must be a whole number, written without a point",
    "string_type": "must be text in quotes",
    "list_type": "must be a list, in square brackets",
    "dict_type": "must be a table",
    "greater_than": "must be > 0",
    "greater_than_equal": "must be 1 or more; masses are counted from 1",
    "string_pattern_mismatch": "is not the number of a mass; masses are counted from 1",
    "string_too_long": "is too long; at most {max_length} characters",
    "too_short": "must have at least {min_length} entries",
    "too_long": "must have at most {max_length} entries",
    "literal_error": "use {expected}",
}


def validate_scene(data: dict[str, Any]) -> dict[str, Any]:
    """Return the tables ``data`` of a scene file, checked and with the records of ``SCENE``.

    Raises ``InvalidInput`` for an unknown key, else for the first mistake, naming the key as
    ``contact[1].clearance``, counted from 1.
    """
    try:
        tables: dict[str, Any] = _VALIDATOR.validate_python(data)
    except ValidationError as error:
        errors = error.errors(include_url=False)
        # A misspelt key is also a missing one: say the cause, not the consequence.
        raise _refusal(min(errors, key=lambda e: e["type"] != "extra_forbidden")) from None
    return tables


def _refusal(error: ErrorDetails) -> InvalidInput:
    kind, place = error["type"], [p for p in error["loc"] if not str(p).startswith(("<", "[key"))]
    parts = (f"[{part + 1}]" if isinstance(part, int) else f".{part}" for part in place)
    key, context = "".join(parts).removeprefix("."), error.get("ctx", {})
    if isinstance(inner := context.get("error"), InvalidInput):
        return InvalidInput(f"{key}.{inner.key}", inner.value, inner.remedy)
    if kind == "missing":
        if place == ["system"]:
            return InvalidInput("[system]", None, "give mass, stiffness, damping, noise_intensity")
        return InvalidInput(key, None, "add it")
    remedy = REMEDIES.get(kind, error["msg"]).format(**context).replace("'", '"')
    if kind == "extra_forbidden":
        remedy = _keys_at(place)
    if place[0] == "units" and kind == "string_pattern_mismatch":
        remedy = 'must be 1 to 16 letters, such as "mm"'
    if key in ("contact", "damping_term", "passage", "transient") and kind == "list_type":
        remedy = f"must be written as [[{key}]]"
    return InvalidInput(key, error["input"], remedy)


def _keys_at(place: Sequence[int | str]) -> str:
    table: Any = SCENE
    for part in place[:-1]:
        table = table["items_schema"] if isinstance(part, int) else table["fields"][part]
        while "schema" in table:
            table = table["schema"]
    if near := misspelt(str(place[-1]), table["fields"]):
        return f'is not a key of a scene; did you mean "{near}"?'
    known = ", ".join(table["fields"])
    return f"is not a key of a scene; here are known: {known}; docs/scene.md says what each means"
