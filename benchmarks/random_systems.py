"""Random systems by the full equation: answered or not, true over stated error, time and memory.

    python benchmarks/random_systems.py [--masses 1] [--first 0] [--count 100] [--tol 1e-3]
        [--truth 400] [--out random_systems.jsonl]

Every system is solved for the densities of all its displacements and momenta, on one thread, in a
process of its own that ends after twice ``SECONDS``. The true error is the distance to the exact
density where there is one, else to a finer solution, else, where that is not certain enough, to a
simulation; ``--truth`` limits its seconds, with 0 it is not sought. A line a system is appended to
``--out``; systems there are not solved again.
"""

import os

os.environ.update(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1")

import argparse
import json
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from resource import RUSAGE_SELF, getrusage
from statistics import median
from time import perf_counter
from typing import Any

import numpy as np

from averaging.gaussian import Linear
from averaging.phase_space.method import PhaseSpace
from averaging.theory import Exact
from cases.compare.compare import distance_between
from fpk import Contact, DampingTerm, System
from fpk.answer.density import distance_with_error
from fpk.answer.method import silent
from fpk.answer.names import Observable, parse_observable
from fpk.numeric.errors import NotApplicable, NotCertified
from sim.montecarlo import MonteCarlo

SEED = 20261128
SECONDS, GIGABYTES, SAMPLING_SECONDS = 60.0, 4.0, 40.0
FINER, KNOWN = {1: 20.0, 2: 6.0, 3: 4.0}, 0.25
"""Least stated error over the tolerance of the finer solution, by the number of masses, and largest
error of a true error over the stated one with which it is known."""
MASS_RATIO, TEMPERATURE_RATIO, DAMPING_RATIOS = 100.0, 30.0, (0.003, 0.5)
ONE_NOISE, FREE, DAMPED_BY_STATE = 0.25, 0.15, {1: 0.7, 2: 0.15, 3: 0.0}
"""Shares of systems with noise on one mass only, without stops, and with damping terms."""
STIFFEST = {1: 1e5, 2: 1e3, 3: 1e3}
"""Largest force of a stop over that of the springs, both at the rms displacement without stops."""


def drawn(n: int, number: int) -> System:
    """Return the random system of ``n`` masses with a ``number``."""
    rng = np.random.default_rng([SEED, n, number])

    def between(low: float, high: float, size: int | None = None) -> Any:
        return np.exp(rng.uniform(np.log(low), np.log(high), size))

    mass, stiffness = between(MASS_RATIO**-0.5, MASS_RATIO**0.5, n), between(0.3, 3.0, n)
    springs = System(mass, stiffness, np.ones(n), np.ones(n))
    frequency = np.sqrt(np.diag(springs.stiffness_matrix) / mass)
    damping = 2.0 * between(*DAMPING_RATIOS, n) * mass * frequency
    noise = damping * between(TEMPERATURE_RATIO**-0.5, TEMPERATURE_RATIO**0.5, n)
    if n > 1 and rng.random() < ONE_NOISE:
        noise *= np.arange(n) == rng.integers(n)
    row, mean = int(rng.integers(n)), float(noise.sum() / damping.sum())
    q, v = (float(np.sqrt(mean * x)) for x in (springs.compliance[row, row], 1.0 / mass[row]))
    contacts: Any = ()
    terms: list[DampingTerm] = []
    if rng.random() > FREE:
        law = str(rng.choice(["hertz", "bilinear", "power"]))
        side: Any = str(rng.choice(["left", "right", "both"]))
        exponent = float(rng.choice([1.2, 2.0, 2.5, 3.0])) if law == "power" else None
        clearance = float(rng.choice([0.0, 0.1, 1.0, 2.0]) * rng.random() * q)
        stop = Contact(row + 1, side, 1.0, clearance, law, exponent)
        stiff = between(0.1, STIFFEST[n]) * mean / q / float(stop.force(q))
        contacts = (replace(stop, stiffness=stiff),)
    if rng.random() < DAMPED_BY_STATE[n]:
        i, c = row + 1, float(damping[row] * between(0.1, 10.0))
        kinds: Any = [(c / mean, (), (), 1)]
        for k in (2, 4)[: 3 - n]:
            kinds += [(c / q**k, ((i, k),), (), 0), (c / v**k, (), ((i, k),), 0)]
        terms.append(DampingTerm(i, i, *kinds[rng.integers(len(kinds))]))
        if n == 1 and rng.random() < 0.5:  # a limit cycle, as of van der Pol
            damping = -damping
        if n == 1 and rng.random() < 0.3:  # without symmetry
            terms.append(DampingTerm(i, i, rng.uniform(-0.3, 0.3) * c / q, ((i, 1),)))
    return System(mass, stiffness, damping, noise, contacts=contacts, damping_terms=tuple(terms))


def solve_alone(n: int, number: int, tol: float, truth: int) -> None:
    """Print a record of the answer as JSON, and then, within ``truth`` seconds, of its errors."""
    system, start = drawn(n, number), perf_counter()
    observables = [parse_observable(f"{k}{i + 1}", n) for k in "qp" for i in range(n)]
    method = PhaseSpace(tol=tol, threads=1)
    signal.alarm(int(2.0 * SECONDS))
    record: dict[str, Any] = {"refused": None, "failures": []}
    answer: Any = ()
    try:
        answer = method.solve(system, observables).densities
        record["stated"] = [a.l1_error for a in answer]
        record["failures"] = sorted({words for a in answer for words in a.certificate.failures})
    except NotApplicable as error:
        record["refused"] = str(error)
    except NotCertified as error:
        record["failures"] = [str(error)]
    record["seconds"] = round(perf_counter() - start, 2)
    if not answer and not record["refused"]:  # said by check if its solutions already show it
        record["refused"] = method.prepare(system).attempt(observables, silent)
    record["gigabytes"] = round(getrusage(RUSAGE_SELF).ru_maxrss / 1e6, 2)
    print(json.dumps(record), flush=True)
    if truth and answer:
        signal.alarm(truth)
        print(json.dumps(true_errors(system, observables, answer)), flush=True)


def true_errors(system: System, observables: list[Observable], answer: Any) -> dict[str, Any]:
    """Return the distances of the ``answer`` to the truth, their errors, and by what it is known.

    By a simulation the errors are exceeded at ``cases.compare.compare.FALSE_ALARMS``.
    """
    tol = max(min(a.l1_error for a in answer) / FINER[system.n], 1e-12)
    finer = PhaseSpace(tol=tol, threads=1)
    for method in (Exact(), Linear(), finer):
        try:
            truth: Any = method.solve(system, observables).densities
        except (NotApplicable, NotCertified):
            continue
        both = [distance_with_error(a, b) for a, b in zip(answer, truth, strict=True)]
        doubt = [error + b.l1_error for (_, error), b in zip(both, truth, strict=True)]
        if all(e <= KNOWN * a.l1_error for e, a in zip(doubt, answer, strict=True)):
            return {"true": [d for d, _ in both], "doubt": doubt, "by": method.method}
    sampled = MonteCarlo(seconds=SAMPLING_SECONDS, threads=1, seed=1).solve(system, observables)
    found = [distance_between(a, b) for a, b in zip(answer, sampled.densities, strict=True)]
    doubt = [most - a.l1_error for (_, _, most), a in zip(found, answer, strict=True)]
    return {"true": [d for d, *_ in found], "doubt": doubt, "by": "montecarlo"}


def outcome(r: dict[str, Any]) -> str:
    """Return "answered", or why the system of a record is not."""
    large = r["seconds"] > SECONDS or r["gigabytes"] > GIGABYTES
    words = "; ".join(r["failures"] + ["too long or too large"] * large)
    return f"refused: {r['refused']}" if r["refused"] else words or "answered"


def errors(r: dict[str, Any]) -> list[tuple[float, float, float]]:
    """Return the true errors of a record, their own errors, and the stated errors."""
    return list(zip(*(r.get(key, ()) for key in ("true", "doubt", "stated")), strict=False))


def line(r: dict[str, Any]) -> str:
    """Return a line about a record."""
    words = [f"{true:.1e}/{stated:.1e}" for true, _, stated in errors(r)]
    words += [r.get("by", ""), "ABOVE" * r["above"], outcome(r)]
    return f"{r['number']:4d} {r['seconds']:5.1f} s {r['gigabytes']:4.2f} GB {' '.join(words)}"


def summary(records: list[dict[str, Any]]) -> str:
    """Return counts, true over stated errors where they are known, and the largest costs."""
    let = [r for r in records if not r["refused"]]
    ratios = [t / s for r in let for t, doubt, s in errors(r) if doubt <= KNOWN * s] or [0.0]
    seconds, gigabytes = (max(r[k] for r in [*let, *records[:1]]) for k in ("seconds", "gigabytes"))
    answered = sum(outcome(r) == "answered" for r in let)
    return (
        f"{len(records)} systems, {len(records) - len(let)} refused by check, {answered} answered;"
        f" {sum('by' in r for r in let)} compared, {sum(r['above'] for r in let)} above the stated"
        f" error; true/stated: median {median(ratios):.2g}, largest {max(ratios):.2g}; at most"
        f" {seconds:.0f} s and {gigabytes:.2g} GB"
    )


def main() -> None:
    """Solve the systems that are not in the file, and print the summary of all that are."""
    parser = argparse.ArgumentParser()
    numbers = {"masses": 1, "first": 0, "count": 100, "tol": 1e-3, "truth": 400}
    for name, default in numbers.items():
        parser.add_argument(f"--{name}", type=type(default), default=default)
    parser.add_argument("--out", type=Path, default=Path("random_systems.jsonl"))
    parser.add_argument("--alone", type=int, help="solve this system and print its record")
    given = parser.parse_args()
    if given.alone is not None:
        return solve_alone(given.masses, given.alone, given.tol, given.truth)
    given.out.touch()
    key = {"masses": given.masses, "tol": given.tol}
    records = [json.loads(text) for text in given.out.read_text().splitlines()]
    records = [r for r in records if key.items() <= r.items()]
    wanted = set(range(given.first, given.first + given.count)) - {r["number"] for r in records}
    for number in sorted(wanted):
        command = [sys.executable, __file__, f"--masses={given.masses}", f"--tol={given.tol}"]
        command += [f"--alone={number}", f"--truth={given.truth}"]
        run = subprocess.run(command, capture_output=True, text=True, check=False)
        words = (run.stderr.splitlines() or ["ended by its alarm"])[-1]
        record = {**key, "number": number, "refused": None, "failures": [words]}
        record |= {"seconds": 2.0 * SECONDS, "gigabytes": 0.0}
        for text in run.stdout.splitlines():
            record |= json.loads(text)
        record["above"] = any(true - doubt > stated for true, doubt, stated in errors(record))
        records.append(record)
        with given.out.open("a") as file:
            file.write(json.dumps(record) + "\n")
        print(line(record), flush=True)
    print(summary(records))


if __name__ == "__main__":
    main()
