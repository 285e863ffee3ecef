"""The averaged equations of a system as subjects of a study: their solvers and a reference."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from averaging.energy_process import energy_process
from averaging.integrable import Integrable
from averaging.modal.analysis import modal_analysis
from averaging.modal.internal import internal_refusal
from averaging.modal.process import modes_process
from averaging.modal.resonance import resonance_refusal
from averaging.nonintegrable import NonIntegrable
from averaging.polynomial_rate import averaged_density
from averaging.quadrature import solve_by_quadrature
from cases.studies.answer import Answer
from cases.studies.modal_reference import graded, mesh_ends, modal_reference, of_plane
from cases.studies.timing import Clock
from fpk.density import Array
from fpk.errors import NotApplicable
from fpk.line.stationary import StationarySolution, solve_on_mesh, solve_stationary
from fpk.observable import Observable, parse_observable
from fpk.plane.stationary import solve_plane, solve_plane_on_mesh
from fpk.probe import probed
from fpk.process import Process
from fpk.route import Route
from fpk.system import System

BEYOND = 1e-14
"""Share of the probability beyond given meshes of one energy: far less than any error that their
levels reach; it is part of the floor."""
REFERENCE_TOL = 1e-12
"""Tolerance of the numerical reference where there is no closed form."""
COARSEST = {1: {1: 8, 2: 8, 4: 8, 8: 2}, 2: {1: 4, 2: 3, 3: 3, 4: 2, 8: 1}}
"""Elements an axis of the coarsest mesh, by the number of energies and the degree."""


@dataclass(frozen=True)
class Steered:
    """A route that is given a tolerance: ``solve(tol)``; ``words`` say how it discretises."""

    route: Route
    solve: Callable[[float], Answer]
    words: str


@dataclass(frozen=True, eq=False)
class Equation:
    """One averaged equation: how it is solved on a mesh, to a tolerance, and its reference.

    ``coarsest`` gives the nodes of each axis of the first mesh by degree; ``steered`` are the
    routes by tolerance, elements first; ``coefficients`` is the clock of the process's coefficients
    within every solution.
    """

    theory: str
    name: str
    observable: Observable
    reference: Answer
    reference_words: str
    coarsest: Callable[[int], tuple[Array, ...]]
    on_mesh: Callable[[tuple[Array, ...], int], Answer]
    steered: tuple[Steered, ...]
    coefficients: Clock

    @property
    def dimension(self) -> int:
        """Number of energies."""
        return len(self.observable)


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
    reference, words = _energy_reference(system, right)
    # The mesh must reach as far as the true density does: it comes from the right process.
    end = probed(right).extent(BEYOND)

    def coarsest(degree: int) -> tuple[Array, ...]:
        inside = [H for H in right.nonsmooth if end > H]
        nodes = np.linspace(0.0, end, COARSEST[1].get(degree, 4) + 1)
        return (np.unique(np.concatenate([nodes, inside])),)

    def quadrature(tol: float) -> Answer:
        solution = solve_by_quadrature(process, tol=tol)

        def density(energy: Array) -> Array:
            return np.asarray(np.exp(solution.log_density(energy)))

        nodes = solution.nodes
        return Answer((nodes,), density, solution.l1_error, 16 * (nodes.size - 1))

    def elements(tol: float) -> Answer:
        return _of_line(solve_stationary(process, tol=tol))

    return Equation(
        theory="nonintegrable",
        name="averaged equation (24)",
        observable=parse_observable("H", system.n),
        reference=reference,
        reference_words=words,
        coarsest=coarsest,
        on_mesh=lambda nodes, degree: _of_line(solve_on_mesh(process, nodes[0], degree)),
        steered=(
            Steered(
                NonIntegrable("fem").route,
                elements,
                "elements whose number and degree follow from the tolerance, cut until it is met.",
            ),
            Steered(NonIntegrable("quadrature").route, quadrature, "quadrature of (11)."),
        ),
        coefficients=clock,
    )


def _energy_reference(system: System, process: Process) -> tuple[Answer, str]:
    try:
        closed = averaged_density(system, process)
    except NotApplicable:
        solved = solve_stationary(process, tol=REFERENCE_TOL, form="drift-diffusion")
        return _of_line(solved), f"drift-diffusion hp elements, tol {REFERENCE_TOL:g}"
    return Answer((closed.nodes,), closed.energy_pdf, closed.l1_error, 0), "closed form (29)"


def modal_equation(system: System) -> Equation:
    """Return (17) for p(H1, H2) of the first two modes, its reference by ``modal_reference``.

    Raises ``NotApplicable`` where the theory does, or n < 2.
    """
    modes = modal_analysis(system)
    if modes.n < 2:
        raise NotApplicable("one mass has one modal energy: nothing to solve in two dimensions")
    if modes.state is not None and modes.n > 2:
        raise NotApplicable("damping terms couple more than two modal energies")
    if reason := resonance_refusal(modes) or internal_refusal(system, modes):
        raise NotApplicable(reason)
    observable = parse_observable("H1,H2", system.n)
    plain, clock = modes_process(modes, [0, 1]), Clock()
    process = replace(plain, coefficients=clock.timed(plain.coefficients))
    reference, words = modal_reference(modes, plain, observable)
    ends = mesh_ends(modes, plain)

    def coarsest(degree: int) -> tuple[Array, ...]:
        first, second = (
            graded(end, COARSEST[2].get(degree, 1), degree) * scale
            for end, scale in zip(ends, plain.energy_scales, strict=True)
        )
        return first, second

    return Equation(
        theory="integrable",
        name="averaged equation (17)",
        observable=observable,
        reference=reference,
        reference_words=words,
        coarsest=coarsest,
        on_mesh=lambda nodes, degree: of_plane(
            solve_plane_on_mesh(process, (nodes[0], nodes[1]), degree)
        ),
        steered=(
            Steered(
                Integrable("fem").route,
                lambda tol: of_plane(solve_plane(process, tol=tol)),
                "p = w u with a positive weight w near p and u a polynomial of high degree on each"
                " of few panels; where that does not reach the tolerance (levels marked w = 1)"
                " plain elements take over. Where no probability flows, as with constant damping,"
                " w itself is the density, (34).",
            ),
        ),
        coefficients=clock,
    )


def _of_line(s: StationarySolution) -> Answer:
    return Answer((s.nodes,), s.density, s.l1_error, s.unknowns)
