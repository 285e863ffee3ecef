"""Files and names that the documents mention exist."""

import ast
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
DOCUMENTS = [ROOT / "docs" / name for name in ("theory.md", "glossary.md", "design.md")]
DOCUMENTS += [ROOT / "CONTRIBUTING.md", ROOT / "README.md"]
REFERENCE = re.compile(r"([a-z_0-9/]+\.py)::(\w+)")
FILE = re.compile(r"`((?:fpk|averaging|sim|cases|tests|docs|examples)/[\w/.-]*)`")


def names_in(source):
    """Functions, classes and constants of a module, and the methods of its classes."""
    return {n.name for n in ast.walk(ast.parse(source)) if hasattr(n, "name")} | {
        target.id
        for n in ast.walk(ast.parse(source))
        if isinstance(n, ast.Assign | ast.AnnAssign)
        for target in (n.targets if isinstance(n, ast.Assign) else [n.target])
        if isinstance(target, ast.Name)
    }


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
    assert len(REFERENCE.findall(DOCUMENTS[0].read_text(encoding="utf-8"))) > 25
