"""Measure how strong the tests are: change the program at random places and count what they notice.

    python benchmarks/mutants.py [--count 100] [--seed 1] [--about PATTERN] [--out mutants.json]

Run it in a clone of its own, installed by ``pip install -e ".[test]" pytest-cov``: files are
changed in place and put back. A mutant has one change in ``fpk``, ``averaging`` or ``sim``: a
comparison that is strict or not, or turned round; a sum for a difference; a product for a quotient;
``and`` for ``or``; a condition negated; a number that is doubled, or 1 for 0. Texts, annotations
and docstrings stay. First the default tests run once, to record which of them reach a line; a
mutant is then judged by those that do, and by all tests of its package where no line is recorded,
as of compiled functions. It survives if all of them pass; one that does not end in ``PATIENCE``
seconds is killed. ``--about "error|bound|SAFETY"`` changes only lines that a pattern is found in.
"""

import argparse
import ast
import json
import random
import re
import signal
import sqlite3
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from time import perf_counter

from coverage.numbits import numbits_to_nums

ROOT = Path(__file__).parent.parent
PACKAGES = ("fpk", "averaging", "sim")
PATIENCE = 1200
"""Seconds for the tests of one mutant."""
SPECIFIC = 40
"""Tests that run first: those that reach the fewest lines, which say the most about each."""
COMPARISONS = {
    ast.Lt: ast.GtE, ast.GtE: ast.Lt, ast.Gt: ast.LtE, ast.LtE: ast.Gt,
    ast.Eq: ast.NotEq, ast.NotEq: ast.Eq, ast.Is: ast.IsNot, ast.IsNot: ast.Is,
    ast.In: ast.NotIn, ast.NotIn: ast.In,
}  # fmt: skip
BOUNDARIES = {ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt}
ARITHMETIC = {
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult,
    ast.Pow: ast.Mult, ast.FloorDiv: ast.Mult, ast.Mod: ast.Mult,
}  # fmt: skip


def changes(tree: ast.Module) -> Iterator[tuple[ast.expr, ast.expr, str]]:
    """Yield an expression, what replaces it, and the change in words, for every possible change."""
    skipped: set[ast.AST] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.AnnAssign | ast.arg) and node.annotation:
            skipped |= set(ast.walk(node.annotation))
        if isinstance(node, ast.FunctionDef) and node.returns:
            skipped |= set(ast.walk(node.returns))
        if isinstance(node, ast.JoinedStr | ast.match_case):
            skipped |= set(ast.walk(node if isinstance(node, ast.JoinedStr) else node.pattern))
    for node in ast.walk(tree):
        if node not in skipped:
            for old, new in _replacements(node):
                yield old, new, f"{ast.unparse(old)[:60]}  ->  {ast.unparse(new)[:60]}"


def _replacements(node: ast.AST) -> Iterator[tuple[ast.expr, ast.expr]]:
    def changed(**fields: object) -> tuple[ast.expr, ast.expr]:
        return node, type(node)(**{**vars(node), **fields})

    match node:
        case ast.Compare(ops=[operator]):
            tables = COMPARISONS, BOUNDARIES
            yield from (changed(ops=[t[type(operator)]()]) for t in tables if type(operator) in t)
        case ast.BinOp(op=operator) if type(operator) in ARITHMETIC:
            if not any(isinstance(n, ast.JoinedStr) for n in ast.walk(node)):
                yield changed(op=ARITHMETIC[type(operator)]())
        case ast.BoolOp(op=operator):
            yield changed(op=ast.Or() if isinstance(operator, ast.And) else ast.And())
        case ast.If(test=test) | ast.While(test=test):
            yield test, ast.UnaryOp(op=ast.Not(), operand=test)
        case ast.IfExp(test=test):
            yield changed(test=ast.UnaryOp(op=ast.Not(), operand=test))
        case ast.Constant(value=value) if isinstance(value, int | float):
            if not isinstance(value, bool):
                yield node, ast.Constant(value=2 * value if value else 1)


def mutant(file: Path, number: int) -> tuple[str, int, int, str]:
    """Return the source of a file with its change of this number, its lines, and it in words."""
    source = file.read_text()
    old, new, words = list(changes(ast.parse(source)))[number]
    lines = source.splitlines(keepends=True)
    first, last = old.lineno - 1, old.end_lineno - 1
    head = lines[first].encode()[: old.col_offset].decode()
    tail = lines[last].encode()[old.end_col_offset :].decode()
    text = [*lines[:first], f"{head}({ast.unparse(new)}){tail}", *lines[last + 1 :]]
    return "".join(text), old.lineno, old.end_lineno, words


def recorded(folder: Path) -> dict[str, dict[int, set[str]]]:
    """Run the default tests once and return, for each file and line, the tests that reach it."""
    data = folder / ".coverage"
    if not data.exists():
        sources = [f"--cov={package}" for package in PACKAGES]
        command = [*sources, "--cov-context=test", "--cov-report=", "-q", "-n", "2"]
        subprocess.run([sys.executable, "-m", "pytest", *command], cwd=folder, check=True)
    reached: dict[str, dict[int, set[str]]] = {}
    with sqlite3.connect(data) as database:
        rows = database.execute(
            "select path, context, numbits from line_bits join file on file.id = file_id "
            "join context on context.id = context_id where context <> ''"
        )
        for path, context, bits in rows:
            lines = reached.setdefault(str(Path(path).relative_to(folder)), {})
            for line in numbits_to_nums(bits):
                lines.setdefault(line, set()).add(context.rpartition("|")[0])
    return reached


def judged(folder: Path, tests: list[str], patience: float) -> str:
    """Return ``survived`` if all tests pass, else the test that fails, or ``endless``."""
    listed = folder / "tests" / "chosen.txt"
    listed.write_text("\n".join(tests))
    command = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", "--no-header"]
    try:
        run = subprocess.run(
            [*command, "-n", "1", f"@{listed}"],
            cwd=folder, capture_output=True, text=True, timeout=patience,
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        return "endless"
    finally:
        listed.unlink()
    if run.returncode == 0:
        return "survived"
    failed = [line for line in run.stdout.splitlines() if line.startswith(("FAILED", "ERROR"))]
    return (failed or run.stdout.splitlines()[-1:] or ["does not start"])[0][:160]


def main() -> None:
    """Judge mutants, one after the other, and write each result at once."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=100)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--about", type=re.compile, default=re.compile(""))
    parser.add_argument("--out", type=Path, default=Path("mutants.json"))
    asked = parser.parse_args()
    # A shell starts work in the background with Ctrl-C ignored, and tests of it would fail.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    reached = recorded(ROOT)
    breadth = Counter(t for lines in reached.values() for tests in lines.values() for t in tests)
    files = sorted(f for package in PACKAGES for f in (ROOT / package).rglob("*.py"))
    places = []
    for file in files:
        source = file.read_text()
        text = source.splitlines()
        places += [
            (file, number)
            for number, (old, _, _) in enumerate(changes(ast.parse(source)))
            if any(asked.about.search(line) for line in text[old.lineno - 1 : old.end_lineno])
        ]
    chosen = random.Random(asked.seed).sample(places, asked.count)
    results = json.loads(asked.out.read_text()) if asked.out.exists() else []
    for file, number in chosen[len(results) :]:
        name, original = str(file.relative_to(ROOT)), file.read_text()
        changed, first, last, words = mutant(file, number)
        lines = reached.get(name, {})
        tests = set().union(*(lines.get(line, set()) for line in range(first, last + 1)))
        tests = tests or {
            t for t in sorted(breadth) if t.startswith(f"tests/{name.partition('/')[0]}/")
        }
        order, start = sorted(tests, key=breadth.__getitem__), perf_counter()
        try:
            file.write_text(changed)
            verdict = "survived"
            for part in (order[:SPECIFIC], order[SPECIFIC:]):
                if part and verdict == "survived":
                    verdict = judged(ROOT, part, PATIENCE)
        finally:
            file.write_text(original)
        seconds = round(perf_counter() - start)
        row = {"file": name, "line": first, "change": words, "tests": len(tests)}
        results.append({**row, "verdict": verdict, "seconds": seconds})
        asked.out.write_text(json.dumps(results, indent=1))
        killed = sum(r["verdict"] != "survived" for r in results)
        about = f"{name}:{first} {words}: {verdict} ({seconds} s)"
        print(f"{killed}/{len(results)} {about}", flush=True)


if __name__ == "__main__":
    main()
