"""This program: hp elements and the quadrature of (11) at several tolerances, from the system on.

Nothing is remembered from one solve to the next: the system is built afresh, so that its modes,
contact energies and quadratures are in the time. The estimate of the error is, too. "hp on the
peers' coefficients" is the same solver on what the other programs are given.
"""

from functools import partial

from measure import Sampled, Setting, measure_all  # first: NumPy then has one thread

# isort: split

import numpy as np
from problems import ALPHA, DAMPING, NOISE, PROBLEMS

from averaging.energy_process import energy_process
from averaging.zero_flux import solve_by_quadrature
from fpk.numeric.quadrature import panel_rule
from fpk.solvers.line.stationary import solve_stationary
from fpk.solvers.plane.stationary import solve_plane
from fpk.system.process import Coefficients, Process

TOLERANCES = (1e-4, 1e-6, 1e-8, 1e-10, 1e-12)
GIVEN = "hp on the peers' coefficients"
JUDGED = 20
"""Gauss points on each element on which an answer is compared with the exact density."""


def line(problem, tol):
    """Return the hp solution in one energy."""
    return solve_stationary(energy_process(problem.system), tol=tol)


def quadrature(problem, tol):
    """Return the quadrature of (11)."""
    return solve_by_quadrature(energy_process(problem.system), tol=tol)


def plane(problem, tol):
    """Return the hp solution in two energies."""
    return solve_plane(problem.process, tol=tol)


def line_given(problem, tol):
    """Return the hp solution in one energy with the coefficients that the peers are given."""

    def coefficients(energy):
        slope, states, volume = problem.level_integrals(energy)
        tau = volume / states
        return Coefficients(
            drift=NOISE - DAMPING * tau,
            diffusion=2.0 * NOISE * tau,
            divergence=2.0 * NOISE * (1.0 - tau * slope / states),
            dissipation=-DAMPING * tau,
            log_density_of_states=np.log(states),
            relative_error=np.zeros_like(energy),
        )

    process = Process(coefficients, (2.0 / ALPHA,), problem.contact_energies, 2)
    return solve_stationary(process, tol=tol)


def line_sampled(solution):
    """Return p_h on Gauss points of its elements."""
    x, w = (a.ravel() for a in panel_rule(solution.nodes, JUDGED))
    found = solution.density if hasattr(solution, "density") else None
    values = found(x) if found else np.exp(solution.log_density(x))
    return Sampled(x[None], w, values, (float(solution.nodes[-1]),))


def plane_sampled(solution):
    """Return p_h at a tensor of Gauss points."""
    (x, wx), (y, wy) = ((a.ravel() for a in panel_rule(n, JUDGED)) for n in solution.panels)
    points = np.array([a.ravel() for a in np.meshgrid(x, y, indexing="ij")])
    values = solution.density(x[:, None], y).ravel()
    ends = tuple(float(n[-1]) for n in solution.nodes)
    return Sampled(points, np.outer(wx, wy).ravel(), values, ends)


def estimated(solution):
    """Return the words on the solution's own estimate of its error."""
    words = f"estimate {solution.l1_error:.1e}"
    certificate = getattr(solution, "certificate", None)
    return words if certificate is None or certificate.certified else f"{words}, not certified"


def settings():
    """Return the ladder of each problem."""
    in_line = {"hp": line, "quadrature": quadrature, GIVEN: line_given}
    found = []
    for name, problem in PROBLEMS.items():
        one = problem.dimension == 1
        for kind, solve in (in_line if one else {"hp": plane}).items():
            for tol in TOLERANCES:
                setting = Setting(
                    name,
                    f"{kind}, tol {tol:.0e}",
                    partial(solve, problem, tol),
                    line_sampled if one else plane_sampled,
                    lambda s: s.unknowns if hasattr(s, "unknowns") else 16 * (s.nodes.size - 1),
                    words=estimated,
                )
                found.append(setting)
    return found


if __name__ == "__main__":
    measure_all("vibro-fpk", "vibro-fpk", settings())
