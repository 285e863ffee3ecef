"""Measure ns per particle-step of the simulation: stepping, with histograms, without contact.

    python benchmarks/montecarlo.py [--json] [--out docs/benchmarks/montecarlo.md]

Warm-up, seven repeats, medians; one thread, and all of them. A figure is wall time times one core
of work: with several threads it is wall time per particle-step of the whole machine.
"""

import argparse
import json
import os
import statistics
import subprocess
import sys
from pathlib import Path
from shutil import which
from tempfile import TemporaryDirectory
from time import perf_counter

import numpy as np
from report import machine, markdown_table

import sim.schemes  # noqa: F401  (its modules register the integrators)
from fpk.contact import Contact
from fpk.observable import parse_observable
from fpk.system import System
from sim.ensemble import Ensemble
from sim.histogram import ranged
from sim.plan import step_arrays
from sim.scheme import SCHEMES
from sim.statistics import moment_products
from sim.step_size import chosen_step

PATHS, STEPS, REPEATS = 8192, 500, 7
Row = dict[str, str | int | float]


def scene(*, contact: bool) -> System:
    """Return fig6 with B = 10, δ = 0.5, or the same without contact."""
    contacts = (Contact(1, "both", 10.0, 0.5),) if contact else ()
    return System([1.0, 1.0], [1.0, 1.0], [0.08, 0.04], [0.01, 0.02], contacts=contacts)


def measured(
    system: System, scheme: str, names: tuple[str, ...], *, moments: bool, stride: int, threads: int
) -> Row:
    """Return one row of the table."""
    dt = 0.01 if scheme == "euler_maruyama" else min(0.2, chosen_step(system))
    ensemble = Ensemble(system, SCHEMES[scheme], dt, PATHS, 1, threads)
    reach = np.array([[-3.0, -3.0], [3.0, 3.0]])
    observables = [parse_observable(name, 2) for name in names]
    histograms = ranged(system, observables, reach, reach, mirror=True)
    ensemble.watch(histograms, moment_products(2) if moments else ())
    ensemble.advance(20)
    times = []
    for _ in range(REPEATS):
        start = perf_counter()
        ensemble.advance(STEPS, stride=stride)
        times.append(perf_counter() - start)
    observed = ", ".join(names) + (" and moments" if moments else "")
    return {
        "scheme": scheme,
        "contact": "yes" if system.stops else "no",
        "observed": f"{observed} every {stride}" if observed else "nothing",
        "threads": threads,
        "ns": 1e9 * statistics.median(times) / (PATHS * STEPS),
        "fastest": 1e9 * min(times) / (PATHS * STEPS),
    }


def measured_in_c() -> Row | None:
    """Return the row of ``stepping.c``, the same step built by gcc; None without a compiler."""
    compiler = which("gcc")
    if compiler is None:
        return None
    step = step_arrays(scene(contact=True), SCHEMES["exact_flow"], 0.2)
    numbers = [
        *step.matrix.ravel(), step.dt, step.stop_clearance[0], step.stop_stiffness[0],
        step.slot_shift[0],
    ]  # fmt: skip
    flags = "-O3 -march=native -mprefer-vector-width=512 -ffast-math -fno-finite-math-only"
    with TemporaryDirectory() as folder:
        program, source = str(Path(folder) / "stepping"), str(Path(__file__).parent / "stepping.c")
        subprocess.run([compiler, *flags.split(), "-o", program, source, "-lm"], check=True)
        out = subprocess.run(
            [program, str(PATHS // 128), str(STEPS), str(REPEATS)],
            input=" ".join(repr(float(x)) for x in numbers),
            capture_output=True,
            text=True,
            check=True,
        ).stdout.split()
    return {
        "scheme": "exact_flow in C (gcc)",
        "contact": "yes",
        "observed": "nothing",
        "threads": 1,
        "ns": float(out[0]),
        "fastest": float(out[1]),
    }


def main() -> None:
    """Measure and print the table, or JSON with --json."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--out", type=Path, default=Path("docs/benchmarks/montecarlo.md"))
    arguments = parser.parse_args()
    in_c = measured_in_c()
    rows = [in_c] if in_c else []
    if in_c is None:
        print("no gcc: the C program is left out", file=sys.stderr)
    for threads in sorted({1, len(os.sched_getaffinity(0))}):
        for scheme in sorted(SCHEMES):
            for contact in (True, False):
                rows.append(
                    measured(
                        scene(contact=contact), scheme, (), moments=False, stride=1, threads=threads
                    )
                )
        for names, moments, stride in (
            (("q2",), False, 1),
            (("q2",), False, 3),
            (("q2",), True, 3),
            (("H",), False, 3),
            (("q2,p2",), False, 3),
        ):
            rows.append(
                measured(
                    scene(contact=True),
                    "exact_flow",
                    names,
                    moments=moments,
                    stride=stride,
                    threads=threads,
                )
            )
    if arguments.json:
        print(json.dumps({"machine": machine(), "rows": rows}))
        return
    cells = [
        [str(r[k]) for k in ("scheme", "contact", "observed", "threads")]
        + [f"{r['ns']:.2f}", f"{r['fastest']:.2f}"]
        for r in rows
    ]
    arguments.out.write_text(
        "# Speed of the simulation\n\n"
        "Written by `benchmarks/montecarlo.py`: fig6, B = 10, float64, medians and fastest of"
        f" {REPEATS} repeats after a warm-up; wall time per particle-step. {machine()}.\n\n"
        + markdown_table(
            ["scheme", "contact", "observed", "threads", "median ns", "fastest ns"], cells
        )
    )
    print(arguments.out.read_text())


if __name__ == "__main__":
    main()
