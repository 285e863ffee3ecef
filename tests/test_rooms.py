"""Imports point down only: cases > averaging, sim > fpk; averaging and sim stay apart.

One exception: ``fpk/__init__.py`` is the face, which loads what comes from ``cases`` when it is
first used. Late imports, those for type checkers, and those by name count as all others do.
"""

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
BELOW = {
    "fpk": {"fpk"},
    "averaging": {"averaging", "fpk"},
    "sim": {"sim", "fpk"},
    "cases": {"cases", "averaging", "sim", "fpk"},
}

FACE = ROOT / "fpk" / "__init__.py"
"""The one module that points up: to ``cases.api``, for type checkers and in ``__getattr__``."""


def imported_rooms(source: str) -> set[str]:
    names = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            names |= {alias.name.partition(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, "relative import: names are explicit here"
            names.add((node.module or "").partition(".")[0])
    return names & BELOW.keys()


@pytest.mark.parametrize("room", BELOW)
def test_imports_point_down(room):
    files = sorted((ROOT / room).rglob("*.py"))
    assert len(files) >= 2
    for file in files:
        upward = imported_rooms(file.read_text(encoding="utf-8")) - BELOW[room]
        if file == FACE:
            assert upward == {"cases"}
            continue
        assert not upward, f"{file.relative_to(ROOT)} imports {sorted(upward)}"


def test_an_upward_import_is_seen():
    assert imported_rooms("def f():\n    from sim.montecarlo import MonteCarlo") - BELOW["fpk"]


def named_by_call(call):
    """The module that a call of ``import_module`` is given as a literal, in a set, else nothing."""
    literal = call.args and isinstance(call.args[0], ast.Constant)
    return {call.args[0].value} if "import_module" in ast.unparse(call.func) and literal else set()


def rooms_imported_by_name(source):
    """First parts of the names that calls of ``import_module`` are given as literals."""
    calls = [node for node in ast.walk(ast.parse(source)) if isinstance(node, ast.Call)]
    names = set().union(*map(named_by_call, calls))
    return {str(name).partition(".")[0] for name in names} & BELOW.keys()


@pytest.mark.parametrize("room", ["fpk", "averaging", "sim"])
def test_imports_by_name_point_down(room):
    for file in sorted((ROOT / room).rglob("*.py")):
        upward = rooms_imported_by_name(file.read_text(encoding="utf-8")) - BELOW[room]
        assert not upward, f"{file.relative_to(ROOT)} imports {sorted(upward)}"


def test_an_upward_import_by_name_is_seen():
    assert rooms_imported_by_name("importlib.import_module('cases.api')") == {"cases"}


INSIDE = {
    "fpk": ("numeric", "system", "answer", "solvers"),
    "sim": ("step", "sample", "questions"),
    "cases": ("scene", "compare", "show", "study", "command"),
}
"""Rooms of a package: each imports from those before it, and from itself."""


def modules(*packages):
    """Each module of the packages by name, with the names that it imports, late ones included."""
    found = {}
    for package in packages:
        for file in (ROOT / package).rglob("*.py"):
            parts = file.relative_to(ROOT).with_suffix("").parts
            name = ".".join(parts[:-1] if parts[-1] == "__init__" else parts)
            found[name] = set()
            for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
                if isinstance(node, ast.Import):
                    found[name] |= {alias.name for alias in node.names}
                elif isinstance(node, ast.ImportFrom):
                    found[name] |= {f"{node.module}.{alias.name}" for alias in node.names}
                    found[name].add(node.module)
                elif isinstance(node, ast.Call):
                    found[name] |= named_by_call(node)
    return found


@pytest.mark.parametrize("package", INSIDE)
def test_rooms_inside_a_package_import_from_those_before(package):
    rooms = INSIDE[package]
    for name, imported in modules(package).items():
        own = name.split(".")[1] if "." in name else None
        if own not in rooms:
            continue
        for other in imported:
            parts = other.split(".")
            if parts[0] != package or other == package:
                continue
            before = rooms[: rooms.index(own) + 1]
            # What belongs to no room, as ``cases.api``, stands above all rooms.
            assert parts[1] in before or package != "cases", f"{name} imports {other}"
            assert parts[1] in before or parts[1] not in rooms, f"{name} imports {other}"


def circles(graph):
    """Names that reach themselves by the names that they lead to."""

    def reached(start):
        seen, left = set(), [start]
        while left:
            for name in graph.get(left.pop(), ()):
                if name in graph and name not in seen:
                    seen.add(name)
                    left.append(name)
        return seen

    return {name for name in graph if name in reached(name)}


def test_no_files_import_each_other():
    graph = modules(*BELOW)
    graph = {name: {m for m in imported if m in graph} for name, imported in graph.items()}
    for name, imported in graph.items():  # a package is no part of what is in it
        imported -= {m for m in imported if name == m or name.startswith(f"{m}.")}
    graph["fpk"] = set()  # the face
    assert circles(graph) == set()


def test_a_circle_is_seen():
    assert circles({"a": {"b"}, "b": {"c"}, "c": {"b"}}) == {"b", "c"}
