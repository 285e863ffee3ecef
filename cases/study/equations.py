"""The averaged equations (24) of one energy and (17) of two modal energies, to be studied."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial, reduce
from math import exp, inf

import numpy as np

from averaging.energy_process import closed_form_density, energy_process
from averaging.integrable import Integrable
from averaging.modal.analysis import modal_analysis
from averaging.modal.observables import modal_densities
from averaging.modal.resonance import require_no_resonance
from averaging.nonintegrable import NonIntegrable
from averaging.zero_flux import (
    ENERGY_RULES,
    ZeroFluxDensity,
    density_of_energies,
    solve_by_quadrature,
    solve_energies,
)
from cases.study.levels import Discretisation, Level, Study, TimedCoefficients
from fpk.answer.density import Density
from fpk.answer.method import Route
from fpk.answer.names import Observable, parse_observable
from fpk.numeric.arrays import Array
from fpk.numeric.errors import NotApplicable, NotCertified
from fpk.numeric.quadrature import gauss_grid, integral
from fpk.solvers import operator
from fpk.solvers.line.mesh import probe_process
from fpk.solvers.line.stationary import StationarySolution, solve_on_mesh
from fpk.solvers.operator import null_vectors, solve_by_scikit_fem
from fpk.solvers.plane.elements import null_function
from fpk.solvers.plane.solution import PlaneSolution, root_spaced_nodes, solve_plane_on_mesh
from fpk.solvers.plane.weight import flux_free_weight
from fpk.system.escape import require_held
from fpk.system.process import Process
from fpk.system.system import System

ELEMENTS = {1: {1: 8, 2: 8, 4: 8, 8: 2}, 2: {1: 4, 2: 3, 3: 3, 4: 2, 8: 1}}
"""Number of elements on each axis of the coarsest mesh, by number of energies and degree."""
MESHES = {1: 7, 2: 5}
"""Number of meshes of a study in h, each the bisection of the previous, by number of energies."""
P_DEGREES = (1, 2, 3, 4, 6, 8, 10, 12)
"""Degrees of a study in p on one mesh."""
TOLERANCE_DIGITS = 12
"""A study by tolerance ends at 10^−TOLERANCE_DIGITS, the tolerance of the reference of (24)."""
MASS_BEYOND = {1: 1e-14, 2: 1e-9}
"""Probability beyond the end of given meshes, by the number of energies: less than the errors of
their levels."""
EQUATION_TOL = {1: 1e-12, 2: 1e-11}
"""Tolerance of a numerical reference by the number of energies; round-off is most of the rest."""
DENSITY_ROUND_OFF = 4e-15
"""Relative floor of any answer, some twenty roundings of its largest values: sums in another order,
as another processor takes them, differ by half of it."""
DENSITY_NORMS = ("L1", "L2", "max")
FUNCTIONALS = ("mean energy", "integral of p²")
"""Moments of a density: E H (of two energies, E H1 + E H2), and ∫p²."""
UNIFORM_WORDS = (
    "elements of scikit-fem of one degree, all halved until the tolerance is met or they end."
)
Solution = StationarySolution | ZeroFluxDensity | PlaneSolution
"""Density of one or two energies, with its error estimate, by finite elements or quadrature."""


def energy_density(observable: Observable, solution: Solution) -> Density:
    """Return the density of the energies of ``solution``, with the error that its solver states."""
    panels = solution.panels if isinstance(solution, PlaneSolution) else (solution.nodes,)
    return density_of_energies(
        observable, solution, panels, lambda *energies: np.zeros(1), tol=inf, added=False
    )


def errors(p: Density, reference: Density | None = None) -> dict[str, float]:
    """Return the norms of ``p`` − ``reference`` and the moduli of the errors of ``FUNCTIONALS``.

    ``reference`` None is zero: norms and moments of ``p`` itself. L1 is over all energies at which
    either is known, "max" the largest difference on the Gauss points of both meshes.
    """
    panels = p.panels if reference is None else map(np.union1d, p.panels, reference.panels)
    mesh, grids = gauss_grid(list(panels))
    a, b = p(*mesh), np.zeros(1) if reference is None else reference(*mesh)
    values = np.abs(a - b), (a - b) ** 2, (a - b) * sum(mesh), (a - b) * (a + b)
    L1, square, *moments = (integral(v, grids) for v in values)
    norms = dict(zip(DENSITY_NORMS, (L1, square**0.5, float(np.max(values[0]))), strict=True))
    return norms | dict(zip(FUNCTIONALS, map(abs, moments), strict=True))


def measure_density(solution: Solution, reference: Density) -> Level:
    """Return the errors of ``solution`` against ``reference``, without its time; see ``Study``.

    The unknowns of a quadrature are its points.
    """
    p = energy_density(reference.observable, solution)
    norms, moments, elements = errors(p, reference), errors(p), p.panels[0].size - 1
    return Level(
        settings=", w = 1" if isinstance(solution, PlaneSolution) and solution.weight.plain else "",
        error=norms["L1"],
        stated=p.l1_error,
        seconds=0.0,
        distance=norms["L1"],
        estimate=p.l1_error + reference.l1_error,
        unknowns=(
            ENERGY_RULES[0] * elements
            if isinstance(solution, ZeroFluxDensity)
            else solution.unknowns
        ),
        errors=norms,
        functionals={key: moments[key] for key in FUNCTIONALS},
    )


@dataclass(frozen=True, eq=False)
class Equation:
    """One averaged equation: its process, its reference, and the routes that solve it.

    ``ends`` are the last energies of given meshes along each axis; ``by_tolerance`` are the routes
    that are given a tolerance, elements first, which ``words`` describe for "fem"; ``clock`` counts
    the time that all spend in the coefficients of ``process``. ``solver``, "fem" or "scikit-fem",
    solves on given meshes.
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
        """Return elements of ``degree`` on the coarsest mesh after so many ``halvings``."""
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
        """Return elements of degree ``P_DEGREES[first]`` on a fixed mesh, refined by degree."""
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

    def study(self, first: Discretisation, tolerances: int = TOLERANCE_DIGITS) -> Study:
        """Return the study of the family of ``first``, by tolerance with ``tolerances`` levels.

        Theory: norms of order degree + 1, moments of order 2 · degree by Galerkin duality.
        """
        count = {"h": MESHES[self.dimension], "p": len(P_DEGREES)}.get(first.family, tolerances)
        orders = dict[str, float]()
        if first.degree:
            orders |= dict.fromkeys(DENSITY_NORMS, first.degree + 1.0)
            orders |= dict.fromkeys(FUNCTIONALS, 2.0 * first.degree)
        return Study(
            equation=self.name,
            first=first,
            count=count,
            measure=partial(measure_density, reference=self.reference),
            theory=orders,
            floor=self.floors(given_mesh=first.family != "tol"),
            dimension=self.dimension,
        )

    def floors(self, *, given_mesh: bool) -> dict[str, float]:
        """Return the size of each error below which the reference resolves nothing.

        It is the relative error of the reference times each norm and moment of p. A ``given_mesh``
        adds the probability beyond its end: that mass is missing there, and the rest is scaled up
        by as much; ∫p² takes twice that.
        """
        p, ends = self.reference, self.ends
        relative, sizes = p.l1_error + DENSITY_ROUND_OFF, errors(p)
        if not given_mesh:
            return {key: relative * size for key, size in sizes.items()}

        def beyond(*H: Array) -> Array:
            return np.where(reduce(np.logical_or, map(np.greater, H, ends)), p(*H), 0.0)

        cut = errors(replace(p, panels=tuple(map(np.union1d, p.panels, ends)), pdf=beyond))
        return {key: (relative + 2.0 * cut["L1"]) * size + cut[key] for key, size in sizes.items()}

    def mesh(self, degree: int, halvings: int) -> tuple[Array, ...]:
        """Return the nodes of each axis of the coarsest mesh of ``degree`` after ``halvings``.

        The nodes of one energy are equidistant, with the contact energies among them; the nodes of
        two energies are equidistant in √H and are halved in it.
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
    """Return the solution by elements of ``degree`` on the mesh of these ``nodes`` of each axis."""
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
        tol = EQUATION_TOL[1]
        solution = solve_by_quadrature(process, tol=tol)
        words = f"quadrature of (11), tol {tol:g}"

    return Equation(
        name=EQUATIONS["nonintegrable"][0],
        process=replace(process, coefficients=clock),
        clock=clock,
        reference=energy_density(observable, solution),
        reference_words=words,
        ends=[probe_process(process).extent(MASS_BEYOND[1])],
        by_tolerance={
            NonIntegrable(solver).route: partial(solve_energies, solver=solver),
            NonIntegrable("quadrature").route: solve_by_quadrature,
        },
        solver=solver,
        words="elements whose number and degree follow from the tolerance, cut until it is met.",
    )


def modal_equation(system: System, solver: str = "fem") -> Equation:
    """Return (17) for p(H1, H2) of the first two modes.

    Raises ``NotApplicable`` as the theory does, for one mass, and where damping terms couple more
    than two modal energies, ``NotCertified`` if the reference has no finite error.

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
            process, tol=EQUATION_TOL[2], degree=P_DEGREES[-1], marked=0.1
        )
        if not np.isfinite(solution.l1_error):
            raise NotCertified("plain elements, the reference of (17), have no finite error")
        reference = energy_density(observable, solution)
        count = " x ".join(str(nodes.size - 1) for nodes in solution.nodes)
        words = f"plain elements (w = 1) of scikit-fem, degree {solution.degree}, {count} on a mesh"
        words += " of their own"
    ends = flux_free_weight(process).ends(-float(np.log(MASS_BEYOND[2])))
    return Equation(
        name=EQUATIONS["integrable"][0],
        process=replace(process, coefficients=clock),
        clock=clock,
        reference=reference,
        reference_words=words,
        ends=list(ends),
        by_tolerance={Integrable(solver).route: partial(solve_energies, solver=solver)},
        solver=solver,
        words="p = w u with a positive weight w near p and u a polynomial of high degree on few"
        " panels; plain elements (levels marked w = 1) where that misses the tolerance. With"
        " constant damping w itself is the density, (34).",
    )


EQUATIONS: Mapping[str, tuple[str, str, Callable[..., Equation]]] = {
    "nonintegrable": ("averaged equation (24)", "H", energy_equation),
    "integrable": ("averaged equation (17)", "H1,H2", modal_equation),
}
"""Averaged equations by theory: name, the observable that is studied, and the constructor."""
