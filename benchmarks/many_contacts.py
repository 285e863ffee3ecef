"""Stops on every mass of a chain: time and stated error with the number of masses.

    python benchmarks/many_contacts.py [--out docs/benchmarks/many_contacts.md]

One thread, processor times of one run each, compiled code warm.
"""

import argparse
import os

os.environ.update(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1")

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from report import machine, markdown_table

from averaging.energy_process import energy_process
from averaging.nonintegrable import NonIntegrable
from averaging.theory import Exact
from cases.study.levels import timed_first
from fpk.answer.density import AnyDensity
from fpk.answer.method import Method
from fpk.answer.names import parse_observable
from fpk.system.contact import Contact
from fpk.system.ends import classify
from fpk.system.system import System

MASSES = (2, 4, 10, 30)


def chain(n: int) -> System:
    """Return unequal masses with Hertz stops of growing clearance on both sides of each."""
    contacts = tuple(Contact(i, "both", 10.0, 0.4 + 0.03 * i) for i in range(1, n + 1))
    mass, damping = np.linspace(1.0, 1.5, n), np.full(n, 0.1)
    return System(mass, np.ones(n), damping, 0.5 * damping, contacts=contacts)


def answer(method: Method, n: int, name: str) -> Callable[[], AnyDensity]:
    """Return what solves for one density of the chain of n masses, built afresh."""
    return lambda: method.solve(chain(n), [parse_observable(name, n)]).densities[0]


def row(n: int) -> list[str]:
    """Return the times and stated L1 errors of one chain."""
    cells, ends = [str(n)], timed_first(lambda: classify(energy_process(chain(n))))
    cells.append(f"{ends[1]:.2f} s")
    asked: list[tuple[Any, str]] = [(Exact(), f"q{n}"), (NonIntegrable(tol=1e-6), "H")]
    for method, name in asked:
        density, seconds = timed_first(answer(method, n, name))
        certified = "" if density.certificate.certified else " (not certified)"
        cells += [f"{seconds:.2g} s", f"{density.l1_error:.1e}{certified}"]
    return cells


def main() -> None:
    """Write the page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("docs/benchmarks/many_contacts.md"))
    out = parser.parse_args().out
    row(2)  # compiles
    head = ["masses", "ends of (24)", "exact q_n", "L1", "energy averaging p(H), tol 1e-6", "L1"]
    text = (
        "# Stops on every mass\n\nWritten by `benchmarks/many_contacts.py`. " + machine() + ".\n\n"
    )
    text += "Hertz stops on both sides of every mass; processor time on one thread, of the first"
    text += " answer; L1 is the stated error.\n\n"
    out.write_text(text + markdown_table(head, [row(n) for n in MASSES]))


if __name__ == "__main__":
    main()
