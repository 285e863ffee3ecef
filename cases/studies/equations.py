"""The averaged equations of a system as subjects of a study: their solvers and a reference."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from time import process_time
from typing import Any

import numpy as np

from averaging.energy_process import energy_process
from averaging.modal.analysis import modal_analysis
from averaging.modal.internal import internal_refusal
from averaging.modal.process import modes_process
from averaging.modal.resonance import resonance_refusal
from averaging.polynomial_rate import averaged_density
from averaging.quadrature import solve_by_quadrature
from cases.studies.answer import Answer
from cases.studies.modal_parts import COARSEST as COARSEST_AXIS
from cases.studies.modal_parts import graded, mesh_ends, modal_reference, of_plane
from fpk.density import Array
from fpk.errors import NotApplicable
from fpk.line.stationary import StationarySolution, solve_on_mesh, solve_stationary
from fpk.observable import Observable, parse_observable
from fpk.plane.stationary import solve_plane, solve_plane_on_mesh
from fpk.probe import probed
from fpk.process import Process
from fpk.system import System

BEYOND = 1e-14
"""Share of the probability beyond given meshes of one energy: far less than any error that their
levels reach; it is part of the floor."""
FINEST = 1e-12
"""Tolerance of the numerical reference where there is no closed form."""
COARSEST = {1: 8, 2: 8, 4: 8, 8: 2}
"""Elements of the coarsest mesh of one energy, by degree."""


class Clock:
    """Seconds of processor time spent in the functions given to it."""

    def __init__(self) -> None:
        """Start from zero."""
        self.seconds = 0.0

    def timed(self, function: Callable[[Array], Any]) -> Callable[[Array], Any]:
        """Return ``function``, its time added to the clock at each call."""

        def wrapped(energy: Array) -> Any:
            start = process_time()
            found = function(energy)
            self.seconds += process_time() - start
            return found

        return wrapped


@dataclass(frozen=True, eq=False)
class Equation:
    """One averaged equation: how it is solved on a mesh, to a tolerance, and what is true of it.

    ``coarsest`` gives the nodes of each axis of the first mesh by degree; ``coefficients`` is the
    clock of the process's coefficients within every solution.
    """

    theory: str
    name: str
    observable: Observable
    reference: Answer
    reference_words: str
    coarsest: Callable[[int], tuple[Array, ...]]
    on_mesh: Callable[[tuple[Array, ...], int], Answer]
    adaptive: Callable[[float], Answer]
    quadrature: Callable[[float], Answer] | None
    coefficients: Clock

    @property
    def dimension(self) -> int:
        """Number of energies."""
        return len(self.observable)


Changed = Callable[[Process], Process]


def unchanged(process: Process) -> Process:
    """Return the process itself; tests put a wrong one in its place."""
    return process


def energy_equation(system: System, *, changed: Changed = unchanged) -> Equation:
    """Return (24) for p(H); its reference never sees ``changed``. ``NotApplicable`` as the theory.

    The closed form (29) is the reference; where damping depends on q or v it is the
    drift-diffusion form by hp elements at 1e-12, in which p itself is the polynomial, not p/T.
    """
    right = energy_process(system)
    clock = Clock()
    process = changed(right)
    process = replace(process, coefficients=clock.timed(process.coefficients))
    reference, words = _energy_reference(system, right)
    # The mesh must reach as far as the true density does: it comes from the right process.
    end = probed(right).extent(BEYOND)

    def coarsest(degree: int) -> tuple[Array, ...]:
        inside = [H for H in right.nonsmooth if end > H]
        nodes = np.linspace(0.0, end, COARSEST.get(degree, 4) + 1)
        return (np.unique(np.concatenate([nodes, inside])),)

    def quadrature(tol: float) -> Answer:
        found = solve_by_quadrature(process, tol=tol)

        def density(energy: Array) -> Array:
            return np.asarray(np.exp(found.log_density(energy)))

        return Answer((found.nodes,), density, found.l1_error, 16 * (found.nodes.size - 1))

    return Equation(
        theory="nonintegrable",
        name="averaged equation (24)",
        observable=parse_observable("H", system.n),
        reference=reference,
        reference_words=words,
        coarsest=coarsest,
        on_mesh=lambda nodes, degree: _of_line(solve_on_mesh(process, nodes[0], degree)),
        adaptive=lambda tol: _of_line(solve_stationary(process, tol=tol)),
        quadrature=quadrature,
        coefficients=clock,
    )


def _energy_reference(system: System, process: Process) -> tuple[Answer, str]:
    try:
        closed = averaged_density(system, process)
    except NotApplicable:
        solved = solve_stationary(process, tol=FINEST, form="drift-diffusion")
        return _of_line(solved), f"drift-diffusion hp elements, tol {FINEST:g}"
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
    plain = modes_process(modes, [0, 1])
    clock = Clock()
    process = replace(plain, coefficients=clock.timed(plain.coefficients))
    reference, words = modal_reference(modes, plain, observable)
    ends = mesh_ends(modes, plain)

    def coarsest(degree: int) -> tuple[Array, ...]:
        first, second = (
            graded(end, COARSEST_AXIS.get(degree, 1), degree) * scale
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
        adaptive=lambda tol: of_plane(solve_plane(process, tol=tol)),
        quadrature=None,
        coefficients=clock,
    )


def _of_line(s: StationarySolution) -> Answer:
    return Answer((s.nodes,), s.density, s.l1_error, s.unknowns, s.degree)
