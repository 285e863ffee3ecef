"""How cost grows: error and time with unknowns, time with masses and with stops.

    python benchmarks/growth.py [--out docs/benchmarks/growth.md]

One thread, medians of processor times after a warm-up, of stops on every mass one run: what runs
beside does not count. Errors are L1 distances to the closed forms (29).
"""

import os

os.environ.update(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1")

from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from report import markdown_table, write_page

from averaging.energy_process import energy_process
from averaging.nonintegrable import NonIntegrable
from averaging.theory import Exact
from cases.scene.scene import load_scene
from cases.study.equations import energy_density, energy_equation, errors, modal_equation, solve_on
from cases.study.levels import time_call, timing
from fpk.answer.names import parse_observable
from fpk.system.contact import Contact
from fpk.system.ends import classify
from fpk.system.process import Process
from fpk.system.system import System

MASSES = (2, 5, 10, 20, 50)
MASSES_WITH_STOPS = (2, 4, 10, 30)
TOLERANCES = tuple(10.0**-k for k in range(2, 13, 2))


def slope(x: list[float], y: list[float]) -> float:
    """Return the exponent of the power that fits best."""
    return float(np.polyfit(np.log(x), np.log(y), 1)[0])


def chain(n: int) -> System:
    """Return n unit masses, the last one between two stops."""
    stop = Contact(n, "both", 10.0, 0.5)
    one = np.ones(n)
    return System(one, one, 0.08 * one, 0.02 * one, contacts=(stop,))


def one_energy() -> str:
    """Return unknowns and error by tolerance, with contact and without."""
    system, rows = load_scene("fig6b").system, []
    for words, own in (("with contact", system), ("without", replace(system, contacts=()))):
        equation = energy_equation(own)
        solve = next(iter(equation.by_tolerance.values()))
        answers = [solve(equation.process, tol=tol) for tol in TOLERANCES]
        densities = [energy_density(equation.reference.observable, a) for a in answers]
        distance = [errors(p, equation.reference)["L1"] for p in densities]
        rows += [
            [
                words,
                f"{tol:.0e}",
                str(a.unknowns),
                f"{e:.1e}",
                f"{-np.log(e) / a.unknowns**0.5:.2f}",
            ]
            for tol, a, e in zip(TOLERANCES, answers, distance, strict=True)
        ]
    head = ["fig6b", "tol", "unknowns N", "L1 error", "ln(1/e)/√N"]
    words = "\nN = O(ln(1/e)²) at most: the last column does not fall.\n\n"
    return "## One energy: error and unknowns\n" + words + markdown_table(head, rows)


def two_energies() -> str:
    """Return the time of one solve at degree 8 against unknowns."""
    equation, rows, N, seconds = modal_equation(load_scene("fig8b").system), [], [], []
    for count in (2, 3, 4, 6, 8):
        nodes = tuple(np.linspace(0.0, end, count + 1) for end in equation.ends)
        work = partial(solve_on, equation.process, nodes, 8)
        answer, first = time_call(work)
        seconds.append(timing(work, first)["seconds"])
        N.append(float(answer.unknowns))
        rows.append([f"{count} x {count}", str(answer.unknowns), f"{1e3 * seconds[-1]:.1f}"])
    words = f"\nTime grows as N^{slope(N, seconds):.2f} (aim: at most N^1.5).\n\n"
    table = markdown_table(["elements", "unknowns N", "median ms"], rows)
    return "## Two energies: time and unknowns, p = 8, with its enriched solution\n" + words + table


def made(n: int) -> Process:
    """Return the process of a chain that nothing has been asked of before."""
    return energy_process(chain(n))


def masses() -> str:
    """Return the time of the coefficients of (24) from 2 to 50 masses with one contact."""
    rows, times = [], []
    energy = np.linspace(0.05, 5.0, 350)
    for n in MASSES:
        make = partial(made, n)
        process, first = time_call(make)
        seconds = timing(make, first)["seconds"]
        work = partial(process.coefficients, energy * process.energy_scale)
        _, warm = time_call(work)
        times.append(timing(work, warm)["seconds"])
        rows.append([str(n), f"{1e3 * seconds:.2f}", f"{1e3 * times[-1]:.2f}"])
    words = (
        f"\nFrom 2 to 50 masses the coefficients take {times[-1] / times[0]:.1f} times as long,"
        f" from 5 to 50 {times[-1] / times[1]:.1f} times. The masses without contact are integrated"
        " out, which leaves one integral of (H - V)^(n - 3/2) for any n, cut where it has died out,"
        " so that a few Gauss points serve any n. What grows is the closed form up to the stop, n"
        " products, and where neither the first nor the second rule is fine enough"
        " (`RAY_RULES` of `averaging/shell/averages.py`).\n\n"
    )
    head = ["masses", "process, factorisation included, ms", "coefficients at 350 energies, ms"]
    return "## Masses: averaging with one contact\n" + words + markdown_table(head, rows)


def chain_of_stops(n: int) -> System:
    """Return unequal masses with Hertz stops of growing clearance on both sides of each."""
    contacts = tuple(Contact(i, "both", 10.0, 0.4 + 0.03 * i) for i in range(1, n + 1))
    mass, damping = np.linspace(1.0, 1.5, n), np.full(n, 0.1)
    return System(mass, np.ones(n), damping, 0.5 * damping, contacts=contacts)


def answers_with_stops(n: int) -> list[str]:
    """Return the times of the first answers and the stated L1 errors of one chain."""
    _, seconds = time_call(lambda: classify(energy_process(chain_of_stops(n))))
    cells = [str(n), f"{seconds:.2f} s"]
    asked: list[tuple[Any, str]] = [(Exact(), f"q{n}"), (NonIntegrable(tol=1e-6), "H")]
    for method, name in asked:
        solve = partial(method.solve, chain_of_stops(n), [parse_observable(name, n)])
        result, seconds = time_call(solve)
        (density,) = result.densities
        certified = "" if density.certificate.certified else " (not certified)"
        cells += [f"{seconds:.2g} s", f"{density.l1_error:.1e}{certified}"]
    return cells


def stops_on_every_mass() -> str:
    """Return time and stated error with the number of masses, all of them between stops."""
    answers_with_stops(2)  # compiles
    head = ["masses", "ends of (24)", "exact q_n", "L1", "energy averaging p(H), tol 1e-6", "L1"]
    words = (
        "\nHertz stops on both sides of every mass; the first answer; L1 is the stated error.\n\n"
    )
    rows = [answers_with_stops(n) for n in MASSES_WITH_STOPS]
    return "## Stops on every mass\n" + words + markdown_table(head, rows)


def body() -> str:
    """Return the sections of the page."""
    return "\n".join([one_energy(), two_energies(), masses(), stops_on_every_mass()])


if __name__ == "__main__":
    write_page("How cost grows", "growth.py", "", body, "docs/benchmarks/growth.md")
