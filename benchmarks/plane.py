"""Measure what the stationary density of two energies costs: uncoupled (fig8) and coupled.

    python benchmarks/plane.py [--out docs/benchmarks/plane.md]

One thread, warm-up, medians of processor times of repeats, coefficients and the enriched solution
of the error estimate included. The error is the L1 distance to the closed form, on finer panels; of
one-sided coupling, where there is none, to the solution for the tolerance 1e-12.
"""

import os

os.environ.update(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1")

from functools import partial
from time import thread_time

import numpy as np
from report import markdown_table, medians, write_page

from averaging.modal.analysis import modal_analysis
from cases.scene.scene import load_scene
from fpk.numeric.quadrature import panel_rule
from fpk.solvers.plane.solution import PlaneSolution
from fpk.solvers.plane.stationary import solve_plane
from fpk.system.process import Coefficients, Process

REPEATS = 5
LONGEST = 1.0
"""Seconds of processor time after which a solve is not repeated."""
TOLERANCES = (1e-4, 1e-6, 1e-8, 1e-10, 1e-12)
SCENES = ("fig8a", "fig8b")
STATE_DAMPED = "vanderpol"


# γ, α_i, cross, d of s_i = d_i − (γ_i + α_i H_i + d_i cross H_j) H_i, b_ii = 2 d_i H_i.
COUPLED = {
    "weak coupling": ((0.1, 0.2), (0.1, 0.1), 0.5, (0.1, 0.1)),
    "strong coupling": ((0.1, 0.2), (0.1, 0.1), 10.0, (0.1, 0.1)),
    "Gibbs of H1 + H2": ((0.05, 0.15), (0.03, 0.09), 0.3, (0.1, 0.3)),
    "ridge, weak noise": ((-0.3, 0.2), (0.3, 0.1), 10.0, (0.01, 0.01)),
    "one of two modes": ((-0.2, -0.2), (0.2, 0.2), 13.0, (0.03, 0.03)),
}


ONE_SIDED = {
    "one-sided": ((0.1, 0.2), (0.1, 0.1), (0.3, 0.05), (0.1, 0.1)),
    "one-sided, strong": ((0.1, 0.2), (0.1, 0.1), (2.0, 0.3), (0.1, 0.1)),
    "one-sided ridge": ((-0.3, 0.2), (0.3, 0.1), (0.3, 0.05), (0.03, 0.03)),
}
"""γ, α_i, c_i, d of s_i = d_i − (γ_i + α_i H_i + c_i H_j) H_i, c_1/d_1 ≠ c_2/d_2: flux."""
SWIRL = 0.2


def coupled_process(gamma, own, cross, noise):
    """Return the process of s_i = d_i − (γ_i + α_i H_i + c_i H_j) H_i, b_ii = 2 d_i H_i."""
    g, a, d = np.array(gamma), np.array(own), np.array(noise)
    coupling = np.diag(a) + np.array([[0.0, cross[0]], [cross[1], 0.0]])
    return Process(
        lambda H: Coefficients(
            d - (g + H @ coupling.T) * H,
            2.0 * d * H[:, :, None] * np.eye(2),
            np.broadcast_to(2.0 * d, H.shape),
        ),
        tuple((np.sqrt(g**2 + 4.0 * a * d) - g) / (2.0 * a)),
    )


def closed_form(linear, square, cross):
    """Return ln p = −Σ(linear H + square H²) − cross H1 H2, up to a constant."""

    def log_p(x, y):
        first, second = (linear[i] * H + square[i] * H**2 for i, H in enumerate((x, y)))
        return -first - second - cross * x * y

    return log_p


def circulating_process():
    """Return a process with p = exp(−H1 − 1.5 H2 − 0.3 H1 H2), b_ii = 2 H_i and circulation.

    J = (∂ψ/∂H2, −∂ψ/∂H1), ψ = swirl H1 H2 p, is free of divergence and tangential to the axes.
    """

    def drift(H):
        x, y = H.T
        first, second = 1.0 + 0.3 * y, 1.5 + 0.3 * x
        return np.stack(
            [
                1.0 - x * first + SWIRL * x * (1.0 - y * second),
                1.0 - y * second - SWIRL * y * (1.0 - x * first),
            ],
            axis=1,
        )

    process = Process(
        lambda H: Coefficients(drift(H), 2.0 * H[:, :, None] * np.eye(2), np.full(H.shape, 2.0)),
        (1.0, 0.7),
    )
    return process, closed_form((1.0, 1.5), (0.0, 0.0), 0.3)


def l1_distance(solution: PlaneSolution, exact, ends) -> float:
    """Return ∫|p_h − p| as far as ``ends`` with p the function ``exact`` scaled to mass 1."""
    nodes = (
        np.union1d(x, np.linspace(0.0, end, 40))
        for x, end in zip(solution.panels, ends, strict=True)
    )
    (x, wx), (y, wy) = ((a.ravel(), w.ravel()) for a, w in (panel_rule(n, 20) for n in nodes))
    p = exact(x[:, None], y)
    p = p / (wx @ p @ wy)
    return float(wx @ np.abs(solution.density(x[:, None], y) - p) @ wy)


def measured_cases():
    """Return names, processes and closed forms of ln p, None where there is none."""
    cases = {}
    for name in SCENES:
        system = load_scene(name).system
        rates = 1.0 / modal_analysis(system).temperature
        cases[name] = modal_analysis(system).process(), closed_form(rates, np.zeros(2), 0.0)
    for name, (gamma, own, cross, noise) in COUPLED.items():
        g, a, d = np.array(gamma), np.array(own), np.array(noise)
        process = coupled_process(gamma, own, cross * d, noise)
        cases[name] = process, closed_form(g / d, 0.5 * a / d, cross)
    cases["circulating"] = circulating_process()
    cases |= {name: (coupled_process(*v), None) for name, v in ONE_SIDED.items()}
    modes = modal_analysis(load_scene(STATE_DAMPED).system)
    return cases | {STATE_DAMPED: (modes.process((0, 1)), None)}


def expanded(solution) -> str:
    """Return what is a polynomial: nothing where p = C w, else u or p on each of the panels."""
    if solution.weight.plain:
        return "p"
    return "u" if solution.degree else "–"


WORDS = (
    f"One thread, medians of the processor time of {REPEATS} solves (fewer of long ones) after a"
    " warm-up, coefficients and error estimate included.\n\n"
    "fig8a and fig8b are two uncoupled modes; the next five have van der Pol damping,"
    " s_i = d_i − (γ_i + α_i H_i + d_i c H_j) H_i, with no flux; in the others probability"
    " circulates: by construction with a closed form, or by a coupling that is stronger one way"
    " than the other, in the scene vanderpol too. The error is ∫|p_h − p| dH1 dH2 against the"
    " closed form, of one-sided"
    f" coupling against the solution for the tolerance {TOLERANCES[-1]:.0e}. Least p: relative"
    " to the largest, 0 where none is negative; below −1e-14 nothing is certified. Expanded: in"
    " p = w u, u as a polynomial on each of few panels, or p itself on plain elements where no"
    " weight w gets there; – where no probability flows and p = C w."
)


def body() -> str:
    """Return the table."""
    rows = []
    product: dict[float, float] = {}
    for name, (process, log_p) in measured_cases().items():
        best = solve_plane(process, tol=TOLERANCES[-1])
        ends = [2.0 * x[-1] for x in best.nodes]
        exact = best.density if log_p is None else lambda x, y, f=log_p: np.exp(f(x, y))
        for tol in TOLERANCES:
            work = partial(solve_plane, process, tol=tol)
            seconds = medians(work, repeats=REPEATS, longest=LONGEST, clock=thread_time)
            solution = work()
            if name == "fig8b":
                product[tol] = seconds
            own = log_p is None and tol == TOLERANCES[-1]
            cells = [name, f"{tol:.0e}", expanded(solution), str(solution.degree)]
            cells += [str(solution.unknowns), f"{1e3 * seconds:.1f}"]
            cells += [f"{seconds / product[tol]:.1f}" if tol in product else "–"]
            cells += ["–" if own else f"{l1_distance(solution, exact, ends):.1e}"]
            cells += [f"{solution.l1_error:.1e}", f"{min(solution.certificate.minimum, 0.0):.0e}"]
            rows.append([*cells, "yes" if solution.certificate.certified else "no"])
    header = ["scene", "tol", "expanded", "degree", "unknowns", "median ms", "of fig8b's"]
    return markdown_table([*header, "L1 error", "estimate", "least p", "certified"], rows)


if __name__ == "__main__":
    title = "Stationary density of two modal energies"
    write_page(title, "plane.py", WORDS, body, "docs/benchmarks/plane.md")
