"""The averaged equations (24) of one energy and (17) of two modal energies, to be studied."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from math import exp

import numpy as np

from averaging.energy_process import closed_form_density, energy_process
from averaging.integrable import Integrable
from averaging.modal.analysis import modal_analysis
from averaging.modal.observables import modal_densities
from averaging.modal.resonance import require_no_resonance
from averaging.nonintegrable import NonIntegrable
from averaging.zero_flux import solve_by_quadrature, solve_energies
from cases.study.levels import Discretisation, Solution, TimedCoefficients, density_of
from fpk.answer.density import Density
from fpk.answer.method import Route
from fpk.answer.names import parse_observable
from fpk.numeric.arrays import Array
from fpk.numeric.errors import NotApplicable, NotCertified
from fpk.solvers import operator
from fpk.solvers.line.mesh import probe_process
from fpk.solvers.line.stationary import solve_on_mesh
from fpk.solvers.operator import null_vectors, solve_by_scikit_fem
from fpk.solvers.plane.elements import null_function
from fpk.solvers.plane.solution import root_spaced_nodes, solve_plane_on_mesh
from fpk.solvers.plane.weight import flux_free_weight
from fpk.system.escape import require_held
from fpk.system.process import Process
from fpk.system.system import System

OF_ENERGY, OF_MODES = "averaged equation (24)", "averaged equation (17)"
ELEMENTS = {1: {1: 8, 2: 8, 4: 8, 8: 2}, 2: {1: 4, 2: 3, 3: 3, 4: 2, 8: 1}}
"""Elements an axis of the coarsest mesh, by the number of energies and the degree."""
P_DEGREES = (1, 2, 3, 4, 6, 8, 10, 12)
"""Degrees of a sweep in p on one mesh."""
BEYOND = {1: 1e-14, 2: 1e-9}
"""Probability beyond given meshes, by the number of energies: below the errors of their levels."""
REFERENCE_TOL = {1: 1e-12, 2: 1e-11}
"""Tolerance of a numerical reference by the number of energies; round-off is most of the rest."""
REFERENCE_DEGREE = 12
"""Degree of the elements of scikit-fem that are the reference of two energies."""
UNIFORM = "elements of scikit-fem of one degree, all halved until the tolerance is met or they end."


@dataclass(frozen=True, eq=False)
class Equation:
    """One averaged equation: its process, its reference, and the routes that solve it.

    ``ends`` are the last energies of given meshes along each axis; ``by_tolerance`` are the routes
    that are given a tolerance, elements first, which ``words`` are about; ``clock`` counts the time
    that all spend in the coefficients of ``process``. ``solver`` is that of the elements on given
    meshes.
    """

    name: str
    process: Process
    clock: TimedCoefficients
    reference: Density
    reference_words: str
    ends: Sequence[float]
    by_tolerance: Mapping[Route, Callable[..., Solution]]
    words: str
    solver: str = "fem"

    @property
    def dimension(self) -> int:
        """Number of energies."""
        return len(self.reference.observable)

    def elements(self, degree: int, halvings: int = 0) -> Discretisation:
        """Return elements of one degree, refined by bisection of the coarsest mesh."""
        nodes = self.mesh(degree, halvings)
        return Discretisation(
            "h",
            f"elements of degree {degree}",
            " x ".join(str(x.size - 1) for x in nodes) + " elements",
            partial(solve_on, self.process, nodes, degree, self.solver),
            partial(self.elements, degree, halvings + 1),
            size=2.0**-halvings,
            degree=degree,
        )

    def degrees(self, first: int = 0) -> Discretisation:
        """Return ``P_DEGREES`` on one mesh with the contact energies among its nodes."""
        degree, finer = P_DEGREES[first], partial(self.degrees, first + 1)
        solve = partial(solve_on, self.process, self.mesh(4, 1), degree, self.solver)
        name, words = "p on a fixed mesh", f"p = {degree}"
        return Discretisation("p", name, words, solve, finer, size=exp(-degree))

    def to_tolerance(self, route: Route, digits: int = 1, stride: int = 1) -> Discretisation:
        """Return a route at the tolerance 10^−``digits``, refined by ``stride`` digits."""
        tol = 10.0**-digits
        solve = partial(self.by_tolerance[route], self.process, tol=tol)
        finer = partial(self.to_tolerance, route, digits + stride, stride)
        return Discretisation("tol", route.label, f"tol = {tol:.0e}", solve, finer, promised=tol)

    def mesh(self, degree: int, halvings: int) -> tuple[Array, ...]:
        """Return the nodes of each axis of the coarsest mesh of a degree, its elements then halved.

        Of one energy they are equidistant, with the contact energies among them; of two they are
        equidistant in √H and are halved in it.
        """
        count = ELEMENTS[self.dimension][degree]
        if self.dimension == 2:
            return root_spaced_nodes(self.ends, count * 2**halvings)
        inside = [H for H in self.process.nonsmooth if self.ends[0] > H]
        nodes = np.union1d(np.linspace(0.0, self.ends[0], count + 1), inside)
        for _ in range(halvings):
            nodes = np.sort(np.append(nodes, 0.5 * (nodes[1:] + nodes[:-1])))
        return (nodes,)


def solve_on(
    process: Process, nodes: tuple[Array, ...], degree: int, solver: str = "fem"
) -> Solution:
    """Return the solution by elements of one degree on a given mesh."""
    slow = solver == "scikit-fem"
    if len(nodes) == 1:
        own = null_vectors if slow else None
        return solve_on_mesh(process, nodes[0], degree, null_vectors=own)
    solved = operator.plane_null_function if slow else null_function
    return solve_plane_on_mesh(process, (nodes[0], nodes[1]), degree, solved=solved)


def energy_equation(system: System, solver: str = "fem") -> Equation:
    """Return (24) for p(H) by elements of ``solver``; raise ``NotApplicable`` as the theory does.

    The closed form (29) is the reference; where damping depends on q or v it is the quadrature of
    (11), which shares with the elements the coefficients only.
    """
    require_held(system)
    process, observable = energy_process(system), parse_observable("H", system.n)
    clock = TimedCoefficients(process.coefficients)
    try:
        solution: Solution = closed_form_density(system)
        words = "closed form (29)"
    except NotApplicable:
        tol = REFERENCE_TOL[1]
        solution = solve_by_quadrature(process, tol=tol)
        words = f"quadrature of (11), tol {tol:g}"

    return Equation(
        name=OF_ENERGY,
        process=replace(process, coefficients=clock),
        clock=clock,
        reference=density_of(observable, solution),
        reference_words=words,
        ends=[probe_process(process).extent(BEYOND[1])],
        by_tolerance={
            NonIntegrable(solver).route: partial(solve_energies, solver=solver),
            NonIntegrable("quadrature").route: solve_by_quadrature,
        },
        solver=solver,
        words=UNIFORM
        if solver == "scikit-fem"
        else "elements whose number and degree follow from the tolerance, cut until it is met.",
    )


def modal_equation(system: System, solver: str = "fem") -> Equation:
    """Return (17) for p(H1, H2) of the first two modes; raise ``NotApplicable`` as the theory does.

    Constant damping has the closed form (34) as reference. Where damping depends on the state it is
    elements of scikit-fem of one degree (p itself is the polynomial, w = 1) on a mesh of their own,
    which share with the route the coefficients and the estimate of the error only.
    """
    require_held(system)
    modes = modal_analysis(system)
    if modes.n < 2:
        raise NotApplicable("one mass has one modal energy: nothing to solve in two dimensions")
    if not modes.constant and modes.n > 2:
        raise NotApplicable("damping terms couple more than two modal energies")
    require_no_resonance(system, modes)
    observable = parse_observable("H1,H2", system.n)
    process = modes.process([0, 1])
    clock = TimedCoefficients(process.coefficients)
    if modes.constant:
        (reference,) = modal_densities(modes, [observable], "closed-form", tol=1e-12)
        words = "closed form (34)"
    else:
        solution = solve_by_scikit_fem(
            process, tol=REFERENCE_TOL[2], degree=REFERENCE_DEGREE, marked=0.1
        )
        if not np.isfinite(solution.l1_error):
            raise NotCertified("plain elements, the reference of (17), have no finite error")
        reference = density_of(observable, solution)
        count = " x ".join(str(nodes.size - 1) for nodes in solution.nodes)
        words = f"plain elements (w = 1) of scikit-fem, degree {solution.degree}, {count} on a mesh"
        words += " of their own"
    ends = flux_free_weight(process).ends(-float(np.log(BEYOND[2])))
    return Equation(
        name=OF_MODES,
        process=replace(process, coefficients=clock),
        clock=clock,
        reference=reference,
        reference_words=words,
        ends=list(ends),
        by_tolerance={Integrable(solver).route: partial(solve_energies, solver=solver)},
        solver=solver,
        words=UNIFORM
        if solver == "scikit-fem"
        else (
            "p = w u with a positive weight w near p and u a polynomial of high degree on few"
            " panels; plain elements (levels marked w = 1) where that misses the tolerance. With"
            " constant damping w itself is the density, (34)."
        ),
    )


EQUATIONS: Mapping[str, tuple[str, str, Callable[..., Equation]]] = {
    "nonintegrable": (OF_ENERGY, "H", energy_equation),
    "integrable": (OF_MODES, "H1,H2", modal_equation),
}
"""By theory: its equation, the observable that this is studied for, and what makes it."""
