"""Imports point down only: cases > averaging, sim > fpk; averaging and sim stay apart.

One exception: ``fpk/__init__.py`` is the face, which loads what comes from ``cases`` when it is
first used. Late imports, those for type checkers, and those by name count as all others do.
"""

import ast
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
BELOW = {
    "fpk": {"fpk"},
    "averaging": {"averaging", "fpk"},
    "sim": {"sim", "fpk"},
    "cases": {"cases", "averaging", "sim", "fpk"},
}
FACE = "fpk"
"""The one module that points up: to ``cases.api``, for type checkers and in ``__getattr__``."""
INSIDE = {
    "fpk": ("numeric", "system", "answer", "solvers"),
    "sim": ("step", "sample", "questions"),
    "cases": ("scene", "compare", "show", "study", "command"),
}
"""Rooms of a package: each imports from those before it, and from itself."""


def imported(source):
    """The names that a source imports, late ones and literals of ``import_module`` included."""
    names = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, "relative import: names are explicit here"
            names |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
        elif isinstance(node, ast.Call) and "import_module" in ast.unparse(node.func):
            names |= {x.value for x in node.args[:1] if isinstance(x, ast.Constant)}
    return names


@cache
def modules():
    """Each module by name, with the names that it imports."""
    found = {}
    for file in (file for room in BELOW for file in (ROOT / room).rglob("*.py")):
        name = ".".join(file.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")
        found[name] = imported(file.read_text(encoding="utf-8"))
    return found


def upward(room, names):
    return {name.partition(".")[0] for name in names} & BELOW.keys() - BELOW[room]


@pytest.mark.parametrize("room", BELOW)
def test_imports_point_down(room):
    own = {name: names for name, names in modules().items() if name.partition(".")[0] == room}
    assert len(own) >= 2
    for name, names in own.items():
        assert upward(room, names) == ({"cases"} if name == FACE else set()), name


def test_an_upward_import_is_seen():
    late = "def f():\n    from sim.montecarlo import MonteCarlo"
    for source in (late, "importlib.import_module('cases.api')", "import averaging.theory as a"):
        assert upward("fpk", imported(source))


@pytest.mark.parametrize("package", INSIDE)
def test_rooms_inside_a_package_import_from_those_before(package):
    rooms = INSIDE[package]
    for name, names in modules().items():
        own = name.split(".")[1] if "." in name else None
        if name.partition(".")[0] != package or own not in rooms:
            continue
        for other in names:
            parts = other.split(".")
            if parts[0] == package and len(parts) > 1:
                before = rooms[: rooms.index(own) + 1]
                # What belongs to no room, as ``cases.api``, stands above all rooms.
                allowed = parts[1] in before or (package != "cases" and parts[1] not in rooms)
                assert allowed, f"{name} imports {other}"


def circles(graph):
    """Names that reach themselves by the names that they lead to."""

    def reached(start):
        seen, left = set(), [start]
        while left:
            new = graph.get(left.pop(), set()) & graph.keys() - seen
            seen |= new
            left += new
        return seen

    return {name for name in graph if name in reached(name)}


def test_no_files_import_each_other():
    assert circles({"a": {"b"}, "b": {"c"}, "c": {"b"}}) == {"b", "c"}
    graph = {  # a package is no part of what is in it
        name: {other for other in names if not f"{name}.".startswith(f"{other}.")}
        for name, names in modules().items()
        if name != FACE
    }
    assert circles(graph) == set()
