"""Measure the simulation: ns per particle-step, stiff stops, threads, error against time.

    python benchmarks/montecarlo.py [--out docs/benchmarks/montecarlo.md]

Warm-up, seven repeats, medians; one thread, and all of them. A figure is wall time times one core
of work: with several threads it is wall time per particle-step of the whole machine. What is
compared is measured in turns, so that it meets the same machine.
"""

import os
import statistics
import subprocess
import sys
from functools import partial
from itertools import product
from pathlib import Path
from shutil import which
from tempfile import TemporaryDirectory
from time import perf_counter, process_time

import numpy as np
from accuracy import error_against_time
from report import markdown_table, write_page

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


def scene(*, contact: bool, stiffness: float = 10.0) -> System:
    """Return fig6 with δ = 0.5, or the same without contact."""
    contacts = (Contact(2, "both", stiffness, 0.5),) if contact else ()
    return System([1.0, 1.0], [1.0, 1.0], [0.08, 0.04], [0.01, 0.02], contacts=contacts)


def measured(
    scheme: str, threads: int, name: str = "", stride: int = 1, contact: bool = True
) -> list[str]:
    """Return one row of the table; ``name``: of what is observed every ``stride``, and moments."""
    system, (names, moments) = scene(contact=contact), (name.split()[:1], "moments" in name)
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
        times.append(1e9 * (perf_counter() - start) / (PATHS * STEPS))
    words = f"{name} every {stride}" if name else "nothing"
    found = f"{statistics.median(times):.2f}", f"{min(times):.2f}"
    return [scheme, "yes" if contact else "no", words, str(threads), *found]


def measured_in_c() -> list[list[str]]:
    """Return the row of ``stepping.c``, the same step built by gcc; none without a compiler."""
    compiler = which("gcc")
    if compiler is None:
        print("no gcc: the C program is left out", file=sys.stderr)
        return []
    step = step_arrays(scene(contact=True), SCHEMES["exact_flow"], 0.2)
    stop = step.stops[0, 1], step.stops[0, 2], step.slot_shift[0]
    numbers = " ".join(repr(float(x)) for x in (*step.matrix.ravel(), step.dt, *stop))
    flags = "-O3 -march=native -mprefer-vector-width=512 -ffast-math -fno-finite-math-only"
    with TemporaryDirectory() as folder:
        program, source = str(Path(folder) / "stepping"), str(Path(__file__).parent / "stepping.c")
        subprocess.run([compiler, *flags.split(), "-o", program, source, "-lm"], check=True)
        arguments = [program, str(PATHS // 128), str(STEPS), str(REPEATS)]
        run = partial(subprocess.run, arguments, input=numbers, capture_output=True, text=True)
        out = run(check=True).stdout.split()
    return [["exact_flow in C (gcc)", "yes", "nothing", "1", *(f"{float(x):.2f}" for x in out[:2])]]


def stiff(stiffness: float) -> list[str]:
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
    gain = np.median(times[:, 0] / times[:, 1])
    row = [f"{stiffness:.0e}", f"{h:.2e}", str(some.small), f"{uniform:.0f}", f"{near:.0f}"]
    return [*row, f"{gain:.2f}"]


def two_threads() -> float:
    """Return the time of one thread over that of two, median of turns; 4 x the paths."""
    known = scene(contact=True), SCHEMES["exact_flow"], 0.128, 4 * PATHS, 1
    both, ratios = [Ensemble(*known, threads) for threads in (1, 2)], []
    for _ in range(REPEATS + 1):
        times = []
        for ensemble in both:
            start = perf_counter()
            ensemble.advance(STEPS)
            times.append(perf_counter() - start)
        ratios.append(times[0] / times[1])
    return statistics.median(ratios[1:])


def body() -> str:
    """Return the tables."""
    rows = measured_in_c()
    for threads in sorted({1, len(os.sched_getaffinity(0))}):
        for scheme, contact in product(sorted(SCHEMES), (True, False)):
            rows.append(measured(scheme, threads, contact=contact))
        rows.append(measured("exact_flow", threads, "q2"))
        for name in ("q2", "q2 and moments", "H", "q2,p2"):
            rows.append(measured("exact_flow", threads, name, 3))
    errors, slope = error_against_time()
    head = ["scheme", "contact", "observed", "threads", "median ns", "fastest ns"]
    of_stiff = ["B", "small step", "in a long one", "small steps for all", "near a stop", "gain"]
    cells = [[f"{r['time']:.0f}", f"{r['seconds']:.3f}", f"{r['L1']:.2e}"] for r in errors]
    return (
        markdown_table(head, rows)
        + "\n## Stiff stops\n\nns of processor time per particle and unit time, one thread.\n\n"
        + markdown_table(of_stiff, [stiff(B) for B in (1e3, 1e5, 1e7)])
        + f"\n## Threads\n\nTime of one thread over that of two: {two_threads():.2f}.\n"
        + "\n## Error against time\n\nL1 of p(q2) in 64 bins against the closed form, 8192"
        + f" trajectories, one thread. Slope of the logarithms: {slope:.2f}; theory −1/2.\n\n"
        + markdown_table(["sampled time", "seconds", "L1"], cells)
    )


if __name__ == "__main__":
    words = f"fig6, B = 10, float64, medians and fastest of {REPEATS} repeats after a warm-up; wall"
    words += " time per particle-step."
    out = "docs/benchmarks/montecarlo.md"
    write_page("Speed of the simulation", "montecarlo.py", words, body, out)
