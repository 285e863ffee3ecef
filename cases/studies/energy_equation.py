"""The averaged equation (24) of one energy as the subject of a study."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from averaging.energy_process import energy_process
from averaging.nonintegrable import NonIntegrable
from averaging.polynomial_rate import averaged_density
from averaging.quadrature import solve_by_quadrature
from cases.studies.answer import Answer
from cases.studies.levels import ByTolerance, Equation, Nodes
from cases.studies.timing import Clock
from fpk.errors import NotApplicable
from fpk.line.stationary import StationarySolution, solve_on_mesh, solve_stationary
from fpk.observable import parse_observable
from fpk.probe import probed
from fpk.process import Process
from fpk.system import System

BEYOND = 1e-14
"""Share of the probability beyond given meshes of one energy: far less than any error that their
levels reach; it is part of the floor."""
REFERENCE_TOL = 1e-12
"""Tolerance of the numerical reference where there is no closed form."""
COARSEST = {8: 2}
"""Elements of the coarsest mesh by degree, 8 where not given."""


def unchanged(process: Process) -> Process:
    """Return the process itself; tests put a wrong one in its place."""
    return process


def energy_equation(
    system: System, *, changed: Callable[[Process], Process] = unchanged
) -> Equation:
    """Return (24) for p(H); ``changed`` never reaches its reference. ``NotApplicable`` as theory.

    The closed form (29) is the reference; where damping depends on q or v it is the
    drift-diffusion form by hp elements at 1e-12, in which p itself is the polynomial, not p/T.
    """
    right, clock = energy_process(system), Clock()
    process = changed(right)
    process = replace(process, coefficients=clock.timed(process.coefficients))
    reference, words = _reference(system, right)
    # The mesh must reach as far as the true density does: it comes from the right process.
    end = probed(right).extent(BEYOND)

    def coarsest(degree: int) -> Nodes:
        inside = [H for H in right.nonsmooth if end > H]
        nodes = np.linspace(0.0, end, COARSEST.get(degree, 8) + 1)
        return (np.unique(np.concatenate([nodes, inside])),)

    def quadrature(tol: float) -> Answer:
        s = solve_by_quadrature(process, tol=tol)
        unknowns = 16 * (s.nodes.size - 1)
        return Answer((s.nodes,), s.density, s.l1_error, unknowns)

    return Equation(
        theory="nonintegrable",
        name="averaged equation (24)",
        observable=parse_observable("H", system.n),
        reference=reference,
        reference_words=words,
        coarsest=coarsest,
        on_mesh=lambda nodes, degree: _answer(solve_on_mesh(process, nodes[0], degree)),
        by_tolerance=(
            ByTolerance(
                NonIntegrable("fem").route,
                lambda tol: _answer(solve_stationary(process, tol=tol)),
                "elements whose number and degree follow from the tolerance, cut until it is met.",
            ),
            ByTolerance(NonIntegrable("quadrature").route, quadrature, "quadrature of (11)."),
        ),
        coefficients=clock,
    )


def _reference(system: System, process: Process) -> tuple[Answer, str]:
    try:
        closed = averaged_density(system, process)
    except NotApplicable:
        solved = solve_stationary(process, tol=REFERENCE_TOL, form="drift-diffusion")
        return _answer(solved), f"drift-diffusion hp elements, tol {REFERENCE_TOL:g}"
    return Answer((closed.nodes,), closed.energy_pdf, closed.l1_error, 0), "closed form (29)"


def _answer(s: StationarySolution) -> Answer:
    return Answer((s.nodes,), s.density, s.l1_error, s.unknowns)
