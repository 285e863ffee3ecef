"""The averaged equation (17) of two modal energies as the subject of a study."""

from dataclasses import replace

import numpy as np

from averaging.integrable import Integrable
from averaging.modal.analysis import ModalAnalysis, modal_analysis
from averaging.modal.observables import modal_densities
from averaging.modal.resonance import require_no_resonance
from cases.studies.answer import Answer
from cases.studies.levels import ByTolerance, Equation, Nodes
from cases.studies.timing import Clock
from fpk.density import Array
from fpk.errors import NotApplicable, NotCertified
from fpk.observable import Observable, parse_observable
from fpk.plane.probe import probed
from fpk.plane.stationary import PlaneSolution, solve_plane, solve_plane_on_mesh
from fpk.process import Process
from fpk.system import System

BEYOND = 1e-9
"""Share of the probability beyond given meshes: less than any error that their levels reach; it is
part of the floor."""
COARSEST = {1: 4, 2: 3, 3: 3, 4: 2}
"""Elements an axis of the coarsest mesh by degree, 1 where not given."""
REFERENCE_DEGREE = 12
REFERENCE_TOLERANCES = (1e-5, 1e-8, 1e-11)
"""One after the other: the last takes 0.2 s and 3 s in the van der Pol scenes, where a tenth of it
takes up to 10 s and brings no more, as round-off then is most of the estimate."""
MAX_UNKNOWNS = 30_000
"""Unknowns beyond which the reference is not refined: the next took 10 s in a ring of modes."""
GOOD = 1e-9
"""L1 error of the reference above which its description says why it is not less."""
BY_TOLERANCE = (
    "p = w u with a positive weight w near p and u a polynomial of high degree on each of few"
    " panels; where that does not reach the tolerance (levels marked w = 1) plain elements take"
    " over. Where no probability flows, as with constant damping, w itself is the density, (34)."
)


def modal_equation(system: System) -> Equation:
    """Return (17) for p(H1, H2) of the first two modes, with a reference by another way.

    Raises ``NotApplicable`` where the theory does, or n < 2.
    """
    modes = modal_analysis(system)
    if modes.n < 2:
        raise NotApplicable("one mass has one modal energy: nothing to solve in two dimensions")
    if not modes.constant and modes.n > 2:
        raise NotApplicable("damping terms couple more than two modal energies")
    require_no_resonance(system, modes)
    observable = parse_observable("H1,H2", system.n)
    plain, clock = modes.process([0, 1]), Clock()
    process = replace(plain, coefficients=clock.timed(plain.coefficients))
    reference, words = _reference(modes, plain, observable)
    ends = _mesh_ends(modes, plain)

    def coarsest(degree: int) -> Nodes:
        axes = zip(ends, plain.energy_scales, strict=True)
        return tuple(graded(end, COARSEST.get(degree, 1), degree) * scale for end, scale in axes)

    def on_mesh(nodes: Nodes, degree: int) -> Answer:
        return _answer(solve_plane_on_mesh(process, (nodes[0], nodes[1]), degree))

    fem = ByTolerance(
        Integrable("fem").route, lambda tol: _answer(solve_plane(process, tol=tol)), BY_TOLERANCE
    )
    return Equation(
        theory="integrable",
        name="averaged equation (17)",
        observable=observable,
        reference=reference,
        reference_words=words,
        coarsest=coarsest,
        on_mesh=on_mesh,
        by_tolerance=(fem,),
        coefficients=clock,
    )


def _reference(
    modes: ModalAnalysis, process: Process, observable: Observable
) -> tuple[Answer, str]:
    """p(H1, H2) by another way than the route that is given a tolerance, and that way in words.

    Constant damping has (34). Where damping depends on the state it is the plain elements of one
    degree (p itself is the polynomial, w = 1) on a mesh of their own, refined until their estimate
    is met. They share the coefficients and the weak form with the route and nothing else: neither
    weight nor expansion, places nor degree. ``l1_error`` is their own estimate, met or not, and
    with it the study judges.

    Raises ``NotCertified`` where the elements have no finite estimate.
    """
    if modes.constant:
        (closed,) = modal_densities(modes, [observable], "closed-form", tol=1e-12)
        return Answer(closed.panels, closed.pdf, closed.l1_error, 0), "closed form (34)"
    solution = _plain_elements(process)
    if not np.isfinite(solution.l1_error):
        raise NotCertified("plain elements, the reference of (17), have no finite error estimate")
    count = " x ".join(str(nodes.size - 1) for nodes in solution.nodes)
    words = f"plain elements (w = 1) of degree {REFERENCE_DEGREE}, {count} on a mesh of their own"
    if solution.l1_error > GOOD:
        words += f"; the floor: a finer one takes more than {MAX_UNKNOWNS} unknowns"
    return _answer(solution), words


def _plain_elements(process: Process) -> PlaneSolution:
    """The solution with the least error estimate to any of the tolerances that are affordable."""
    solutions: list[PlaneSolution] = []
    for tol in REFERENCE_TOLERANCES:
        try:
            solutions.append(solve_plane(process, tol=tol, degree=REFERENCE_DEGREE))
        except NotCertified:
            if not solutions:
                raise
            break
        if solutions[-1].unknowns > MAX_UNKNOWNS:
            break
    return min(solutions, key=lambda s: s.l1_error)


def _mesh_ends(modes: ModalAnalysis, process: Process) -> Array:
    """Where given meshes end along both axes, in units of the scales, (2,)."""
    if modes.constant:
        return np.full(2, -np.log(BEYOND))
    return probed(process).extent(BEYOND)


def graded(end: float, count: int, degree: int) -> Array:
    """Return nodes from 0 to ``end``, for e^(−x) by elements of ``degree``.

    Equal shares h^(p+2) |f^(p+1)| of the L1 error ask for h ~ e^(x/(p+2)); taken is half that
    growth, h ~ e^(x/(2p+4)). The leading power of h rules where h is small against the length in
    which e^(−x) changes in *every* element, and with full growth the last ones are 14 of these
    lengths at first: orders in L1 of p = 1 in fig6b are 0.82, 1.53, 2.07 from 8 x 8 on with it, and
    1.86, 1.93, 1.97 with half of it, as are the errors smaller on as many elements.
    """
    c = 2.0 * (degree + 2.0)
    share = np.linspace(0.0, 1.0, count + 1)
    return np.asarray(-c * np.log1p(share * np.expm1(-end / c)))


def _answer(s: PlaneSolution) -> Answer:
    variant = "w = 1" if s.weight is None else ""
    return Answer(s.nodes, s.density, s.l1_error, s.unknowns, variant)
