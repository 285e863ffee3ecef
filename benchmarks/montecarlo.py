"""Measure the simulation: ns per particle-step, stiff stops, threads, error against time.

    python benchmarks/montecarlo.py [--json] [--out docs/benchmarks/montecarlo.md]

Warm-up, seven repeats, medians; one thread, and all of them. A figure is wall time times one core
of work: with several threads it is wall time per particle-step of the whole machine. What is
compared is measured in turns, so that it meets the same machine.
"""

import argparse
import json
import os
import statistics
import subprocess
import sys
from functools import partial
from pathlib import Path
from shutil import which
from tempfile import TemporaryDirectory
from time import perf_counter, process_time

import numpy as np
from accuracy import error_against_time
from report import machine, markdown_table

from fpk.answer.names import parse_observable
from fpk.system.contact import Contact
from fpk.system.system import System
from sim.sample.diagnostics import moment_products
from sim.sample.ensemble import Ensemble
from sim.sample.histogram import axis_of, covering
from sim.sample.plan import step_arrays, with_long_steps
from sim.step.schemes import SCHEMES
from sim.step.step_size import chosen_step

PATHS, STEPS, REPEATS = 8192, 500, 7
Row = dict[str, str | int | float]


def scene(*, contact: bool, stiffness: float = 10.0) -> System:
    """Return fig6 with δ = 0.5, or the same without contact."""
    contacts = (Contact(2, "both", stiffness, 0.5),) if contact else ()
    return System([1.0, 1.0], [1.0, 1.0], [0.08, 0.04], [0.01, 0.02], contacts=contacts)


def measured(
    system: System, scheme: str, names: tuple[str, ...], *, moments: bool, stride: int, threads: int
) -> Row:
    """Return one row of the table."""
    dt = 0.01 if scheme == "euler_maruyama" else min(0.2, chosen_step(system))
    ensemble = Ensemble(system, SCHEMES[scheme], dt, PATHS, 1, threads)
    observables = [parse_observable(name, 2) for name in names]
    # Far beyond what is reached: kT is 1/4.
    reached = [(-3.0, 9.0 if c.kind == "H" else 3.0) for o in observables for c in o]
    histograms = covering(observables, np.array(reached), partial(axis_of, system))
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
        *step.matrix.ravel(), step.dt, step.stops[0, 1], step.stops[0, 2],
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


def stiff(stiffness: float) -> Row:
    """Return ns per particle and unit time, one thread: small steps for all, and near a stop."""
    system, scheme = scene(contact=True, stiffness=stiffness), SCHEMES["exact_flow"]
    h = chosen_step(system)
    some, H, _ = with_long_steps(system, scheme, h)
    both = [Ensemble(system, s, dt, PATHS, 1, 1) for s, dt in ((scheme, h), (some, H))]
    both[1].advance(round(40.0 / H))
    both[0].restore({**both[0].saved(), "states": both[1].states})
    both[0].advance(1)
    lengths, times = (STEPS, STEPS // 4), np.empty((REPEATS, 2))
    for repeat in range(REPEATS):
        for k, (ensemble, steps) in enumerate(zip(both, lengths, strict=True)):
            start = process_time()
            ensemble.advance(steps)
            times[repeat, k] = 1e9 * (process_time() - start) / (PATHS * steps * ensemble.dt)
    uniform, near = np.median(times, axis=0)
    row: Row = {"B": stiffness, "dt": h, "small": some.small, "uniform": uniform, "near": near}
    return row | {"gain": float(np.median(times[:, 0] / times[:, 1]))}


def two_threads() -> float:
    """Return the time of one thread over that of two, median of turns; 4 x the paths."""
    both = [
        Ensemble(scene(contact=True), SCHEMES["exact_flow"], 0.128, 4 * PATHS, 1, threads)
        for threads in (1, 2)
    ]
    ratios = []
    for _ in range(REPEATS + 1):
        times = []
        for ensemble in both:
            start = perf_counter()
            ensemble.advance(STEPS)
            times.append(perf_counter() - start)
        ratios.append(times[0] / times[1])
    return statistics.median(ratios[1:])


def more_tables(found: dict[str, object]) -> str:
    """Return the tables beside that of particle-steps, as Markdown."""
    stiff_rows: list[Row] = found["stiff"]  # type: ignore[assignment]
    errors: list[Row] = found["errors"]  # type: ignore[assignment]
    text = "\n## Stiff stops\n\nns of processor time per particle and unit time, one thread.\n\n"
    text += markdown_table(
        ["B", "small step", "in a long one", "small steps for all", "near a stop", "gain"],
        [
            [f"{r['B']:.0e}", f"{r['dt']:.2e}", str(r["small"]), f"{r['uniform']:.0f}",
             f"{r['near']:.0f}", f"{r['gain']:.2f}"]
            for r in stiff_rows
        ],
    )  # fmt: skip
    text += f"\n## Threads\n\nTime of one thread over that of two: {found['threads']:.2f}.\n"
    text += "\n## Error against time\n\nL1 of p(q2) in 64 bins against the closed form, 8192"
    text += f" trajectories, one thread. Slope of the logarithms: {found['slope']:.2f}; theory"
    text += " −1/2.\n\n"
    return text + markdown_table(
        ["sampled time", "seconds", "L1"],
        [[f"{r['time']:.0f}", f"{r['seconds']:.3f}", f"{r['L1']:.2e}"] for r in errors],
    )


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
    errors, slope = error_against_time()
    found: dict[str, object] = {
        "stiff": [stiff(B) for B in (1e3, 1e5, 1e7)],
        "threads": two_threads(),
        "errors": errors,
        "slope": slope,
    }
    if arguments.json:
        print(json.dumps({"machine": machine(), "rows": rows, **found}))
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
        + more_tables(found)
    )
    print(arguments.out.read_text())


if __name__ == "__main__":
    main()
