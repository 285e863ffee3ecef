"""Measure what the stationary density of two energies costs: fig8b by finite elements.

    python benchmarks/plane.py [--out docs/benchmarks/plane.md]

One thread, warm-up, medians of repeats, coefficients and the enriched solution of the error
estimate included. The error is the L1 distance to (34), on finer panels.
"""

import argparse
import os

os.environ.update(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1")

import statistics
from functools import partial
from pathlib import Path
from time import perf_counter

import numpy as np
from report import machine, markdown_table

from averaging.modal.analysis import modal_analysis
from averaging.modal.process import modal_process
from cases.scene import load_scene
from fpk.plane.stationary import PlaneSolution, solve_plane
from fpk.quadrature import panel_rule

REPEATS = 9
SCENES = ("fig8a", "fig8b")


def l1_error(solution: PlaneSolution, rates: np.ndarray) -> float:
    """Return ∫|p − p_(34)| as far as twice the mesh."""
    rules = [panel_rule(np.append(x, 2.0 * x[-1]), 24) for x in solution.nodes]
    (x, wx), (y, wy) = ((a.ravel(), w.ravel()) for a, w in rules)
    p = np.prod(rates) * np.exp(-rates[0] * x[:, None] - rates[1] * y)
    return float(wx @ np.abs(solution.density(x[:, None], y) - p) @ wy)


def main() -> None:
    """Measure, and write the page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("docs/benchmarks/plane.md"))
    arguments = parser.parse_args()
    rows = []
    for name in SCENES:
        system = load_scene(name).system
        process, rates = modal_process(system), 1.0 / modal_analysis(system).temperature
        for tol in (1e-4, 1e-6, 1e-8, 1e-10, 1e-12):
            work = partial(solve_plane, process, tol=tol)
            solution, times = work(), []
            for _ in range(REPEATS):
                start = perf_counter()
                work()
                times.append(perf_counter() - start)
            elements = " × ".join(str(x.size - 1) for x in solution.nodes)
            rows.append(
                [
                    name,
                    f"{tol:.0e}",
                    f"{solution.answer.degree}, {elements}",
                    str(solution.unknowns),
                    f"{1e3 * statistics.median(times):.1f}",
                    f"{l1_error(solution, rates):.1e}",
                    f"{solution.l1_error:.1e}",
                ]
            )
    header = ["scene", "tol", "degree, elements", "unknowns", "median ms", "L1 error", "estimate"]
    arguments.out.write_text(
        "# Stationary density of two modal energies by finite elements\n\n"
        f"Written by `benchmarks/plane.py`, one thread, medians of {REPEATS} solves after a"
        f" warm-up, coefficients and error estimate included. {machine()}.\n\n"
        "The error is ∫|p − p₍₃₄₎| dH1 dH2 against the closed form.\n\n"
        + markdown_table(header, rows)
    )
    print(arguments.out.read_text())


if __name__ == "__main__":
    main()
