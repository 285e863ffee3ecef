"""This program: hp elements and the quadrature of (11) at several tolerances, from the system on.

Nothing is remembered from one solve to the next: the system is built afresh, so that its modes,
contact energies and quadratures are in the time. The estimate of the error is, too. "from the
averaged process on" leaves out what the peers are given as well: the system, its reduced potential
and its contact energies; its quadratures are in the time, as theirs are. "coefficients alone" is
what the hp solution spends on its coefficients, the same energies asked for again.
"""

from dataclasses import replace
from functools import lru_cache, partial

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
PROCESS = "hp from the averaged process on"
GIVEN = "hp on the peers' coefficients"
JUDGED = 20
"""Gauss points on each element on which an answer is judged."""


def fresh(problem):
    """Return the averaged process, nothing of it remembered."""
    return energy_process(problem.system)


def line(problem, tol):
    """Return the hp solution in one energy."""
    return solve_stationary(fresh(problem), tol=tol)


def quadrature(problem, tol):
    """Return the quadrature of (11)."""
    return solve_by_quadrature(fresh(problem), tol=tol)


def plane(problem, tol):
    """Return the hp solution in two energies."""
    return solve_plane(problem.process, tol=tol)


def lean(problem):
    """Return the process with the peers' coefficients: the same solver on what they are given."""

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

    return Process(coefficients, (2.0 / ALPHA,), problem.contact_energies, 2)


@lru_cache
def kept(problem):
    """Return the averaged process, the same one each time."""
    return fresh(problem)


def line_from_process(problem, tol):
    """Return the hp solution in one energy of a process that is there already."""
    return solve_stationary(kept(problem), tol=tol)


def line_given(problem, tol):
    """Return the hp solution in one energy with the peers' coefficients."""
    return solve_stationary(lean(problem), tol=tol)


class Asked:
    """A process's coefficients, which note every energy they are asked for."""

    def __init__(self, problem, tol):
        """Solve once, and keep the process and the energies."""
        self.batches = []
        process = fresh(problem)
        own = process.coefficients

        def noted(energy):
            self.batches.append(np.array(energy))
            return own(energy)

        solution = solve_stationary(replace(process, coefficients=noted), tol=tol)
        self.solution = replace(solution, process=process)
        self.coefficients = own

    def again(self):
        """Ask for the same energies again, and return the solution that they gave."""
        for energy in self.batches:
            self.coefficients(energy)
        return self.solution


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
    found = []
    for name, problem in PROBLEMS.items():
        if problem.dimension == 2:
            found += [_setting(name, "hp", tol, plane, plane_sampled) for tol in TOLERANCES]
            continue
        found += [_setting(name, "hp", tol, line, line_sampled) for tol in TOLERANCES]
        found += [_setting(name, "quadrature", tol, quadrature, line_sampled) for tol in TOLERANCES]
        ways = ((PROCESS, line_from_process), (GIVEN, line_given))
        found += [_setting(name, k, t, f, line_sampled) for k, f in ways for t in TOLERANCES]
    asked = Asked(PROBLEMS["W1"], 1e-10)
    alone = Setting(
        "W1", "coefficients alone, as hp at tol 1e-10", asked.again, line_sampled,
        lambda _: sum(batch.size for batch in asked.batches),
        note="a part of hp's time, not a solver; unknowns: energies",
    )  # fmt: skip
    return [*found, alone]


def _setting(name, kind, tol, solve, sampled):
    return Setting(
        name,
        f"{kind}, tol {tol:.0e}",
        partial(solve, PROBLEMS[name], tol),
        sampled,
        lambda s: s.unknowns if hasattr(s, "unknowns") else 16 * (s.nodes.size - 1),
        words=estimated,
    )


if __name__ == "__main__":
    measure_all("vibro-fpk", "vibro-fpk", settings())
