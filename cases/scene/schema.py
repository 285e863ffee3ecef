"""The scene format: every key with the check of its value.

A check takes a value and its key, ``contact[1].clearance`` say, counted from 1. It returns the
value in the form that the program uses or raises ``InvalidInput`` with what would be right.
"""

from collections.abc import Callable, Mapping
from difflib import get_close_matches
from typing import Any
from unicodedata import category

from cases.scene.expect import RELATIONS
from fpk.contact import Contact
from fpk.damping import DampingTerm
from fpk.errors import InvalidInput

Check = Callable[[Any, str], Any]
Checks = Mapping[str, Check]

MAX_MASSES = 500
"""Matrices are full: a chain longer than this is not what they are for."""

MAX_TERMS = 200
"""A van der Pol damping of four modes has a hundred monomials."""

LONGEST_TEXT = 1000
"""Characters of a title, a source or a name."""

LARGEST, SMALLEST = 1e100, 1e-100
"""Beyond these a product of three inputs leaves the range of double precision."""


def validated(data: dict[str, Any]) -> dict[str, Any]:
    """Return the checked tables of a scene; raise ``InvalidInput`` with what is wrong first."""
    tables: dict[str, Any] = SCENE(data, "")
    if "system" not in tables:
        raise InvalidInput("[system]", None, "give mass, stiffness, damping, noise_intensity")
    return tables


def _rules(*rules: tuple[Callable[[Any], bool], str], make: Callable[[Any], Any]) -> Check:
    """Every rule must hold, or its remedy is given; ``make`` converts the value."""

    def check(value: Any, key: str) -> Any:
        for holds, remedy in rules:
            if not holds(value):
                raise InvalidInput(key, value, remedy)
        return make(value)

    return check


def _one_of(*names: str) -> Check:
    quoted = " or ".join(f'"{name}"' for name in names)
    return _rules((lambda value: value in names, f"use {quoted}"), make=str)


def _list(
    item: Check,
    *,
    least: int = 1,
    most: int = MAX_MASSES,
    distinct: bool = False,
    remedy: str = "must be a list, in square brackets",
) -> Check:
    lengths = _rules(
        (lambda value: isinstance(value, list), remedy),
        (lambda value: len(value) >= least, f"must have at least {least} entries"),
        (lambda value: len(value) <= most, f"must have at most {most} entries"),
        (lambda value: not distinct or value[0] not in value[1:], "names the same theory twice"),
        make=list,
    )
    return lambda value, key: [
        item(entry, f"{key}[{i}]") for i, entry in enumerate(lengths(value, key), start=1)
    ]


def _table(required: Checks, optional: Checks, make: Callable[..., Any] = dict) -> Check:
    """A table with these keys and no others, which are the keyword arguments of ``make``."""
    checks = {**required, **optional}

    def check(value: Any, key: str) -> Any:
        if not isinstance(value, dict):
            raise InvalidInput(key, value, "must be a table")
        dot = f"{key}." if key else ""
        # A misspelt key is also a missing one: the cause comes first, then the consequence.
        for name in value:
            if name not in checks:
                raise InvalidInput(dot + name, value[name], _known_keys(name, checks))
        for name in required:
            if name not in value:
                raise InvalidInput(dot + name, None, "add it")
        entries = {name: checks[name](entry, dot + name) for name, entry in value.items()}
        try:
            return make(**entries)
        except InvalidInput as error:
            raise InvalidInput(dot + error.key, error.value, error.remedy) from None

    return check


def _known_keys(name: str, checks: Checks) -> str:
    if close := get_close_matches(name, checks, n=1):
        return f'is not a key of a scene; did you mean "{close[0]}"?'
    return f"is not a key of a scene; here are known: {', '.join(checks)}"


def _text(value: Any, key: str) -> str:
    if not isinstance(value, str):
        raise InvalidInput(key, value, "must be text in quotes")
    if len(value) > LONGEST_TEXT:
        raise InvalidInput(key, value, f"is too long; at most {LONGEST_TEXT} characters")
    for c in value:  # a control character acts on a terminal and cannot stand in XML or netCDF
        if (category(c) == "Cc" and c not in "\t\n") or c in "\ufffe\uffff":
            raise InvalidInput(key, value, f"holds the character U+{ord(c):04X}; leave it out")
    return value


def _powers(value: Any, key: str) -> tuple[tuple[int, int], ...]:
    """The powers of a damping term as pairs (mass, power)."""
    if not isinstance(value, dict):
        raise InvalidInput(key, value, "must be a table")
    for mass in value:
        if not (mass.isascii() and mass.isdigit() and len(mass) < 10 and mass[0] != "0"):
            raise InvalidInput(key, mass, "is not the number of a mass; masses are counted from 1")
    return tuple((int(mass), _whole(power, f"{key}.{mass}")) for mass, power in value.items())


def _numbers_or_matrix(value: Any, key: str) -> Any:
    nested = isinstance(value, list) and value and isinstance(value[0], list)
    return (_matrix if nested else _numbers)(value, key)


_NUMBER = (
    (lambda value: type(value) in (int, float), "must be a number"),
    (
        lambda value: value == 0 or SMALLEST <= abs(value) <= LARGEST,
        "must be a finite number, 0 or between 1e-100 and 1e100 in size",
    ),
)
_WHOLE = (lambda value: type(value) is int, "must be a whole number, written without a point")
_number = _rules(*_NUMBER, make=float)
_positive = _rules(*_NUMBER, (lambda value: value > 0, "must be > 0"), make=float)
_whole = _rules(_WHOLE, make=int)
_mass = _rules(
    _WHOLE, (lambda value: value >= 1, "must be 1 or more; masses are counted from 1"), make=int
)
_numbers = _list(_number)
_matrix = _list(_numbers)
_theory = _one_of("nonintegrable", "integrable")
_range = _table({}, dict.fromkeys(RELATIONS, _number))
_values, _matrices = _list(_number, most=12), _list(_numbers_or_matrix, most=12)

SYSTEM = _table(
    {
        "mass": _numbers,
        "stiffness": _numbers,
        "damping": _numbers_or_matrix,
        "noise_intensity": _numbers_or_matrix,
    },
    {"noise_gain": _matrix},
)
CONTACT = _table(
    {"mass": _mass, "side": _text, "stiffness": _number, "clearance": _number},
    {"law": _text, "exponent": _number},
    make=Contact,
)
TERM = _table(
    {"i": _mass, "j": _mass, "coefficient": _number},
    {"q": _powers, "v": _powers, "energy": _whole},
    make=DampingTerm,
)
VARY = {
    "contact": _table({}, {"stiffness": _values, "clearance": _values}),
    "system": _table({}, {"noise_intensity": _matrices, "damping": _matrices}),
}
EXPECT = {
    "of": _text,
    "non_gaussian": _range,
    "almost_gaussian": _range,
    "nonintegrable_better_with": _one_of("larger", "smaller"),
    "better": _list(_theory, least=2, most=2, distinct=True),
    "acceptable": _list(_theory, most=2, distinct=True),
    "clearance_rule": _positive,
}
SCENE = _table(
    {},
    {
        "system": SYSTEM,
        "title": _text,
        "source": _text,
        "contact": _list(CONTACT, least=0, remedy="must be written as [[contact]]"),
        "damping_term": _list(
            TERM, least=0, most=MAX_TERMS, remedy="must be written as [[damping_term]]"
        ),
        "observe": _table({"densities": _list(_text, most=16)}, {}),
        "vary": _table({}, VARY),
        "expect": _table({}, EXPECT),
    },
)
"""The whole file."""
