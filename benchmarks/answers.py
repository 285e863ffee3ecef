"""Save the answers of the program, and compare those of a later version with them.

    python benchmarks/answers.py save answers.json
    python benchmarks/answers.py compare answers.json [later.json]

An answer is the exit status and the JSON object of a command, for every command on twelve scenes,
or the SHA-256 of the densities of a simulation of given seed, step and length, for twelve of them.
``compare`` computes all of them again and prints each difference: of keys, words and certificates;
of values by more than the sum of both stated errors, or by more than round-off where no error is
stated; of stated errors by more than a factor of two. Times are not compared. Exit status 1 if
there is a difference.
"""

import argparse
import hashlib
import io
import json
import re
import sys
from collections.abc import Iterator
from contextlib import redirect_stderr, redirect_stdout
from functools import partial
from pathlib import Path
from time import perf_counter
from typing import Any
from unittest.mock import patch

import numpy as np

import fpk
from cases.command.app import run_app
from fpk.answer.method import silent
from fpk.answer.names import parse_observable
from sim import MonteCarlo

ROUND_OFF = 1e-10
"""Relative distance of two numbers, without a stated error, that is taken for round-off: relative
to the largest number of their list."""
TIMES = re.compile(r"seconds|_ms$|^ms$|time_|speed|cost|memory|version|processor")
"""Keys of times, which differ from run to run, and of the machine."""
SAMPLED = "--seconds"
"""Commands that simulate for a given wall time: only their keys and words are compared."""
SCENES = """
fig6a fig3a fig7 fig8a sdof three-mass vanderpol vanderpol-modal two-modes cir bistable
unequal-sides
"""
LAST = {"sdof": 1, "three-mass": 3, "cir": 1}
"""The mass whose displacement q is asked for, where it is not the second."""
OF_EACH = """
show SCENE
check SCENE
run SCENE --no-simulation
density SCENE --method {exact|linear|nonintegrable|integrable|phase-space} --of q --at 0,0.3,0.6
density SCENE --method {exact|nonintegrable|integrable} --of H --at 0.01,0.2,1
crossings SCENE --method {exact|nonintegrable|integrable} --of q --at 0,0.3
density SCENE --method integrable --of H1,H2 --at 0.01,0.1x0.02,0.2
density SCENE --method nonintegrable --solver {closed-form|quadrature|fem} --of H --at 0.1,0.4
density SCENE --method nonintegrable --solver simulation --seconds 1 --of H --at 0.1,0.4
transient SCENE --method nonintegrable --start {rest|H=0.2} --of H --times 1,5,20 --at 0.05,0.2,0.5
passage SCENE --method nonintegrable --start {rest|H=0.2} --limit H=1.2 --times 5,50
transient SCENE --method integrable --start {rest|H1=0.1,H2=0.05} --of H --times 1,5,20 --at 0.05,0.2,0.5
passage SCENE --method integrable --start {rest|H1=0.1,H2=0.05} --limit H=1.2 --times 5,50
relaxation SCENE --method {linear|nonintegrable|integrable} --rates 3
"""  # noqa: E501
OTHERS = """
list
schema
passage two-modes --method integrable --limit H1=0.4,H2=0.6 --times 10,100
transient modulated --method nonintegrable --of H --times 5,20,60 --at 0.05,0.2,0.5
passage modulated --method nonintegrable --limit H=1 --times 5,20,60
transient fig8a --method integrable --of q2 --start H1=0.1,H2=0.2 --times 5 --at 0,0.3
transient fig8a --method integrable --of H1,H2 --times 5 --at 0.05,0.1x0.02
transient cir --method linear --of q1 --times 1,3 --at 0,0.5
relaxation fig3a --method phase-space --rates 3
spectrum fig3a --method phase-space --of q2 --at 0:2:0.5
spectrum cir --method linear --of q1 --at 0:2:0.5
correlation fig3a --method phase-space --of q2 --at 0:4:1
crossings fig6a --method phase-space --of q2 --at 0,0.3
density fig6a --method montecarlo --of q2 --at 0,0.3,0.6 --seconds 2
passage fig6a --method montecarlo --limit H=0.8 --times 10 --seconds 2
transient fig6a --method montecarlo --of H --times 1,5 --at 0.1,0.2 --seconds 2
crossings fig6a --method montecarlo --of q2 --at 0,0.3 --seconds 2
spectrum fig6a --method montecarlo --of q2 --at 0.5,1 --seconds 2
correlation fig6a --method montecarlo --of q2 --at 0,1 --seconds 2
passage fig6a --method nonintegrable --solver simulation --limit H=0.5 --seconds 2
converge {fig6a --route nonintegrable|vanderpol-modal --route integrable}
sweep fig6a --vary contact.clearance=0.3:1:3 --quantity rms(q2) --method nonintegrable
density {fig6a --method nosuch --of q2|fig6a --method exact --of q9|nosuch --method exact --of q1} --at 0
passage fig6a --method nonintegrable --limit H=-1
transient fig6a --method nonintegrable --of H --times -1 --at 0.1
"""  # noqa: E501


def commands() -> list[str]:
    """Return every command line, without ``--json``: each of the words in braces."""
    lines = [
        line.replace("SCENE", scene).replace("--of q ", f"--of q{LAST.get(scene, 2)} ")
        for scene in SCENES.split()
        for line in OF_EACH.strip().splitlines()
    ]
    found = []
    for line in [*lines, *OTHERS.strip().splitlines()]:
        before, _, rest = line.partition("{")
        choices, _, after = rest.partition("}")
        found += [f"{before}{choice}{after}" for choice in choices.split("|")]
    return found


def answer(line: str) -> dict[str, Any]:
    """Return the exit status of a command and its JSON object, or its text where it gives none."""
    words = ["fpk", *line.split(), *([] if line == "schema" else ["--json"])]
    printed, said, status = io.StringIO(), io.StringIO(), 0
    with patch.object(sys, "argv", words), redirect_stdout(printed), redirect_stderr(said):
        try:
            run_app()
        except SystemExit as end:
            status = end.code or 0
        except Exception as error:
            said.write(repr(error))
    try:
        return {"status": status, "json": json.loads(printed.getvalue())}
    except ValueError:
        return {"status": status, "text": said.getvalue().strip() + printed.getvalue()}


SIMULATIONS = [
    ("fig6a", "q2 H", {}),
    ("fig6a", "q2,p2 H1 p1", {"seed": 7}),
    ("fig6a", "q2 H", {"scheme": "baoab", "dt": 0.02}),
    ("fig6a", "q2 H", {"scheme": "euler_maruyama", "dt": 0.005, "relaxations": 0.5}),
    ("fig3a", "q2 p2", {}),
    ("fig7", "q2,p2", {}),
    ("sdof", "q1 p1 H", {}),
    ("three-mass", "q1 q3 H", {}),
    ("vanderpol", "H1,H2 H q1", {}),
    ("vanderpol-modal", "H1 H2", {"seed": 3}),
    ("bistable", "H q2", {}),
    ("stiff-stops", "q2 H", {"threads": 2}),
]
"""Scene, observables and settings of the simulations whose bits are kept."""


def bits(scene: str, names: str, settings: dict[str, Any]) -> str:
    """Return the SHA-256 of the densities of a short simulation, their errors and bins."""
    system = fpk.load(scene).system
    short = {"paths": 4096, "relaxations": 2.0, "burn_in": 2.0, "threads": 1, "most_steps": 20_000}
    method = MonteCarlo(**(short | settings))
    observables = [parse_observable(name, system.n) for name in names.split()]
    digest = hashlib.sha256()
    for density in method.prepare(system).solve(observables, silent).densities:
        for array in (density.values, density.batch_values, *density.edges):
            digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()


def all_answers(words: str) -> dict[str, Any]:
    """Return the answers of all commands that contain ``words``, and the bits of simulations."""
    asked = {line: partial(answer, line) for line in commands()}
    asked |= {f"simulation {' '.join(map(str, s))}": partial(bits, *s) for s in SIMULATIONS}
    answers: dict[str, Any] = {}
    for line, call in asked.items():
        if words in line:
            start = perf_counter()
            answers[line] = call()
            print(f"{perf_counter() - start:6.1f} s  {line}", file=sys.stderr, flush=True)
    return answers


def leaves(tree: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    """Yield every leaf of a JSON object with its path; a list of numbers is a leaf."""
    if isinstance(tree, dict):
        for key, value in tree.items():
            if not TIMES.search(key):
                yield from leaves(value, f"{path}.{key}")
    elif isinstance(tree, list) and not all(_is_number(x) for x in tree):
        for k, value in enumerate(tree):
            yield from leaves(value, f"{path}[{k}]")
    else:
        yield path, tree


def _is_number(x: Any) -> bool:
    return isinstance(x, int | float) and not isinstance(x, bool)


def differences(line: str, old: Any, new: Any) -> Iterator[str]:
    """Yield what differs between two answers of one command."""
    before, after = dict(leaves(old)), dict(leaves(new))
    for path in before.keys() ^ after.keys():
        yield f"{path}: only {'before' if path in before else 'now'}"
    study = "converge" in line
    for path in before.keys() & after.keys():
        a, b = before[path], after[path]
        numbers = all(_is_number(x) or isinstance(x, list) for x in (a, b))
        key = re.sub(r"\[\d+\]", "", path).rpartition(".")[2]
        if SAMPLED in line or (numbers and ".settings." in path) or ".certificate." in path:
            if not numbers and a != b and path.endswith("certified"):
                yield f"{path}: {a} -> {b}"
        elif not numbers:
            if re.sub(r"[\d.e+-]+", "#", str(a)) != re.sub(r"[\d.e+-]+", "#", str(b)):
                yield f"{path}: {a} -> {b}"
        elif np.shape(a) != np.shape(b):
            yield f"{path}: {np.shape(a)} -> {np.shape(b)}"
        elif "error" in key or study:
            # Errors of a study fall to round-off, where they are not the same twice.
            floor = 1e-9 if study else 1e-14
            if np.any(np.asarray(b) > 2.0 * np.abs(np.asarray(a)) + floor):
                yield f"{path}: stated {np.max(a):.1e} -> {np.max(b):.1e}"
        elif np.size(a):
            x, y = np.asarray(a, float), np.asarray(b, float)
            index = path[path.rindex("[") :] if path.endswith("]") else ""
            stem = path.removesuffix(index).rpartition(".")
            names = (f"{stem[0]}.{stem[2]}_error{index}", f"{stem[0]}.error{index}")
            error = next((n for n in names if n in before and n in after), None)
            allowed: Any = ROUND_OFF * np.max(np.abs(x))
            if error and np.shape(before[error]) == np.shape(a):
                allowed = allowed * 1e-4 + np.asarray(before[error]) + np.asarray(after[error])
            if np.any(np.abs(x - y) > allowed):
                yield f"{path}: {np.max(np.abs(x - y)):.1e} apart, {np.max(allowed):.1e} allowed"


def main() -> None:
    """Save answers, or compare two files of them."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("what", choices=["save", "compare"])
    parser.add_argument("file", type=Path)
    parser.add_argument("other", type=Path, nargs="?", help="a later file; left out, all run again")
    parser.add_argument("--of", default="", help="only commands that contain these words")
    asked = parser.parse_args()
    text = asked.other.read_text() if asked.other else json.dumps(all_answers(asked.of), indent=1)
    if asked.what == "save":
        asked.file.write_text(text)
        return
    saved, later = json.loads(asked.file.read_text()), json.loads(text)
    found = [
        f"{line}\n    {x}" for line in later for x in differences(line, saved[line], later[line])
    ]
    print(*found, f"{len(later)} answers, {len(found)} differences", sep="\n")
    sys.exit(bool(found))


if __name__ == "__main__":
    main()
