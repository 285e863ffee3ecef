"""Measure what the stationary density of two energies costs: uncoupled (fig8) and coupled damping.

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
from fpk.vector_process import VectorProcess

REPEATS = 9
SCENES = ("fig8a", "fig8b")


# γ, α_i, cross, d of s_i = d_i − (γ_i + α_i H_i + d_i cross H_j) H_i, b_ii = 2 d_i H_i.
COUPLED = {
    "weak coupling": ((0.1, 0.2), (0.1, 0.1), 0.5, (0.1, 0.1)),
    "strong coupling": ((0.1, 0.2), (0.1, 0.1), 10.0, (0.1, 0.1)),
    "Gibbs of H1 + H2": ((0.05, 0.15), (0.03, 0.09), 0.3, (0.1, 0.3)),
    "ridge, weak noise": ((-0.3, 0.2), (0.3, 0.1), 10.0, (0.01, 0.01)),
    "one of two modes": ((-0.2, -0.2), (0.2, 0.2), 13.0, (0.03, 0.03)),
}


def coupled_process(gamma, own, cross, noise):
    """Return a coupled process without flux and the coefficients of its −ln p, by powers."""
    g, a, d = np.array(gamma), np.array(own), np.array(noise)
    coupling = np.diag(a) + cross * np.array([[0.0, d[0]], [d[1], 0.0]])
    process = VectorProcess(
        lambda H: d - (g + H @ coupling.T) * H,
        lambda H: 2.0 * d * H[:, :, None] * np.eye(2),
        lambda H: np.broadcast_to(2.0 * d, H.shape),
        tuple((np.sqrt(g**2 + 4.0 * a * d) - g) / (2.0 * a)),
    )
    return process, (g / d, 0.5 * a / d, cross)


def l1_error(solution: PlaneSolution, linear, square, cross) -> float:
    """Return ∫|p − exp(−Σ(linear H + square H²) − cross H1 H2)/Z| as far as twice the mesh."""
    rules = [panel_rule(np.append(x, 2.0 * x[-1]), 24) for x in solution.nodes]
    (x, wx), (y, wy) = ((a.ravel(), w.ravel()) for a, w in rules)
    first, second = (linear[i] * H + square[i] * H**2 for i, H in enumerate((x, y)))
    log_p = -first[:, None] - second - cross * x[:, None] * y
    p = np.exp(log_p - log_p.max())
    p /= wx @ p @ wy
    return float(wx @ np.abs(solution.density(x[:, None], y) - p) @ wy)


def main() -> None:
    """Measure, and write the page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("docs/benchmarks/plane.md"))
    arguments = parser.parse_args()
    rows = []
    cases = {}
    for name in SCENES:
        system = load_scene(name).system
        rates = 1.0 / modal_analysis(system).temperature
        cases[name] = modal_process(system), (rates, np.zeros(2), 0.0)
    cases |= {name: coupled_process(*values) for name, values in COUPLED.items()}
    product: dict[float, float] = {}
    for name, (process, exponent) in cases.items():
        for tol in (1e-4, 1e-6, 1e-8, 1e-10, 1e-12):
            work = partial(solve_plane, process, tol=tol)
            solution, times = work(), []
            for _ in range(REPEATS):
                start = perf_counter()
                work()
                times.append(perf_counter() - start)
            median = statistics.median(times)
            if name == "fig8b":
                product[tol] = median
            elements = " × ".join(str(x.size - 1) for x in solution.nodes)
            rows.append(
                [
                    name,
                    f"{tol:.0e}",
                    f"{solution.answer.degree}, {elements}",
                    str(solution.unknowns),
                    f"{1e3 * median:.1f}",
                    f"{median / product[tol]:.1f}" if tol in product else "–",
                    f"{l1_error(solution, *exponent):.1e}",
                    f"{solution.l1_error:.1e}",
                ]
            )
    header = ["scene", "tol", "degree, elements", "unknowns", "median ms"]
    header += ["of fig8b's", "L1 error", "estimate"]
    arguments.out.write_text(
        "# Stationary density of two modal energies by finite elements\n\n"
        f"Written by `benchmarks/plane.py`, one thread, medians of {REPEATS} solves after a"
        f" warm-up, coefficients and error estimate included. {machine()}.\n\n"
        "fig8a and fig8b are two uncoupled modes; the others have van der Pol damping,"
        " s_i = d_i − (γ_i + α_i H_i + d_i c H_j) H_i. The error is ∫|p_h − p| dH1 dH2 against the"
        " closed form.\n\n" + markdown_table(header, rows)
    )
    print(arguments.out.read_text())


if __name__ == "__main__":
    main()
