"""Files and names that the documents mention exist."""

import ast
import re
from pathlib import Path

import pytest

from cases.comparison.routes import listed_routes

ROOT = Path(__file__).parent.parent
THEORY = ROOT / "docs" / "theory.md"
DOCUMENTS = [*sorted((ROOT / "docs").glob("**/*.md")), ROOT / "CONTRIBUTING.md", ROOT / "README.md"]
REFERENCE = re.compile(r"([a-z_0-9/]+\.py)::(\w+)")
FILE = re.compile(r"`((?:fpk|averaging|sim|cases|tests|docs|examples)/[\w/.-]*)`")


def names_in(source):
    """Functions, classes and constants of a module, and the methods of its classes."""
    nodes = list(ast.walk(ast.parse(source)))
    assigned = [
        target
        for n in nodes
        if isinstance(n, ast.Assign | ast.AnnAssign)
        for target in (n.targets if isinstance(n, ast.Assign) else [n.target])
    ]
    names = {n.id for target in assigned for n in ast.walk(target) if isinstance(n, ast.Name)}
    return names | {n.name for n in nodes if hasattr(n, "name")}


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: path.name)
def test_names_in_documents_exist(document):
    for file, name in REFERENCE.findall(document.read_text(encoding="utf-8")):
        path = ROOT / file
        assert path.is_file(), f"{document.name} mentions {file}"
        assert name in names_in(path.read_text(encoding="utf-8")), f"{file} has no {name}"


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: path.name)
def test_files_in_documents_exist(document):
    for file in FILE.findall(document.read_text(encoding="utf-8")):
        assert (ROOT / file).exists(), f"{document.name} mentions {file}"


def test_the_theory_names_code():
    assert THEORY in DOCUMENTS
    assert len(REFERENCE.findall(THEORY.read_text(encoding="utf-8"))) > 25


def test_the_command_line_page_has_every_method_and_solver():
    page = (ROOT / "docs" / "command-line.md").read_text(encoding="utf-8")
    rows = [line.split("|") for line in page.split("\n") if line.startswith("| `")]
    solvers = {row[1].strip(): row[3] for row in rows if len(row) == 5}
    routes = listed_routes()
    assert routes
    for route in routes:
        assert f"`{route.solver}`" in solvers[f"`{route.method}`"], route.label
