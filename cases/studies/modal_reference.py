"""What a study of (17) needs beside its solvers: meshes of two energies, and what is true."""

import numpy as np

from averaging.modal.analysis import ModalAnalysis
from averaging.modal.observables import modal_densities
from cases.studies.answer import Answer
from fpk.density import Array
from fpk.errors import NotCertified
from fpk.observable import Observable
from fpk.plane.mesh import axis_nodes
from fpk.plane.probe import probed
from fpk.plane.stationary import PlaneSolution, solve_plane
from fpk.process import Process

BEYOND = 1e-9
"""Share of the probability beyond given meshes: less than any error that their levels reach; it is
part of the floor."""
REFERENCE_DEGREE = 12
REFERENCE_TOLERANCES = (1e-5, 1e-8, 1e-11)
"""One after the other: the last takes 0.2 s and 3 s in the van der Pol scenes, where a tenth of it
takes up to 10 s and brings no more, as round-off then is most of the estimate."""
MAX_UNKNOWNS = 30_000
"""Unknowns beyond which the reference is not refined: the next took 10 s in a ring of modes."""
GOOD = 1e-9
"""L1 error of the reference above which its description says why it is not less."""


def modal_reference(
    modes: ModalAnalysis, process: Process, observable: Observable
) -> tuple[Answer, str]:
    """Return p(H1, H2) by another way than the route that is steered by a tolerance, in words, too.

    Constant damping has (34). Where damping depends on the state it is the plain elements of one
    degree (p itself is the polynomial, w = 1) on a mesh of their own, refined until their estimate
    is met. They share the coefficients and the weak form with the route and nothing else: neither
    weight nor expansion, places nor degree. ``l1_error`` is their own estimate, met or not, and
    with it the study judges.

    Raises ``NotCertified`` where the elements have no finite estimate.
    """
    if modes.state is None:
        (closed,) = modal_densities(modes, [observable], "closed-form", tol=1e-12, provenance={})
        return Answer(closed.panels, closed.pdf, closed.l1_error, 0), "closed form (34)"
    solution = _plain_elements(process)
    if not np.isfinite(solution.l1_error):
        raise NotCertified("plain elements, the reference of (17), have no finite error estimate")
    count = " x ".join(str(nodes.size - 1) for nodes in solution.nodes)
    words = f"plain elements (w = 1) of degree {REFERENCE_DEGREE}, {count} on a mesh of their own"
    if solution.l1_error > GOOD:
        words += f"; the floor: a finer one takes more than {MAX_UNKNOWNS} unknowns"
    return of_plane(solution), words


def _plain_elements(process: Process) -> PlaneSolution:
    best: PlaneSolution | None = None
    for tol in REFERENCE_TOLERANCES:
        try:
            solution = solve_plane(process, tol=tol, degree=REFERENCE_DEGREE)
        except NotCertified:  # more elements than are affordable
            if best is None:
                raise
            return best
        if best is None or solution.l1_error < best.l1_error:
            best = solution
        if solution.unknowns > MAX_UNKNOWNS:
            break
    assert best is not None
    return best


def mesh_ends(modes: ModalAnalysis, process: Process) -> Array:
    """Return where given meshes end along both axes, in units of the scales, (2,)."""
    if modes.state is None:
        return np.full(2, -np.log(BEYOND))
    probe = probed(process)
    nodes = [axis_nodes(probe, k, tail=BEYOND, tol=BEYOND, degree=4) for k in (0, 1)]
    return np.array([x[-1] for x in nodes])


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


def of_plane(s: PlaneSolution) -> Answer:
    """Return a solution of two energies as an answer; plain elements are marked w = 1."""
    made = "w = 1" if s.answer.weight is None else ""
    return Answer(s.nodes, s.density, s.l1_error, s.unknowns, made)
