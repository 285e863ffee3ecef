"""Imports point down only: cases > averaging, sim > fpk; averaging and sim stay apart."""

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
        assert not upward, f"{file.relative_to(ROOT)} imports {sorted(upward)}"


def test_an_upward_import_is_seen():
    assert imported_rooms("def f():\n    from sim.montecarlo import MonteCarlo") - BELOW["fpk"]
