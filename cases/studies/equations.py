"""The averaged equations (24) of one energy and (17) of two modal energies, to be studied."""

from collections.abc import Callable, Mapping

import numpy as np

from averaging.closed_form import averaged_density
from averaging.energy_process import energy_process
from averaging.integrable import Integrable
from averaging.modal.analysis import modal_analysis
from averaging.modal.observables import modal_densities
from averaging.modal.resonance import require_no_resonance
from averaging.nonintegrable import NonIntegrable
from averaging.quadrature import POINTS, solve_by_quadrature
from cases.studies.answer import Answer, answer_of
from cases.studies.levels import Equation
from cases.studies.timing import Clock
from fpk.errors import NotApplicable, NotCertified
from fpk.line.stationary import solve_stationary
from fpk.observable import parse_observable
from fpk.plane.probe import probed as probed_plane
from fpk.plane.stationary import solve_plane
from fpk.probe import probed
from fpk.process import Process
from fpk.system import System

BEYOND = {1: 1e-14, 2: 1e-9}
"""Probability beyond given meshes, by the number of energies: below the errors of their levels."""
REFERENCE_TOL = {1: 1e-12, 2: 1e-11}
"""Tolerance of a numerical reference by the number of energies; round-off is most of the rest."""
REFERENCE_DEGREE = 12
"""Degree of the plain elements that are the reference of two energies."""


def energy_equation(system: System) -> Equation:
    """Return (24) for p(H). Raises ``NotApplicable`` where the theory does.

    The closed form (29) is the reference; where damping depends on q or v it is the
    drift-diffusion form by hp elements, in which p itself is the polynomial, not p/T.
    """
    process, clock = energy_process(system), Clock()
    try:
        closed = averaged_density(system)
        reference = Answer((closed.nodes,), closed.energy_pdf, closed.l1_error)
        words = "closed form (29)"
    except NotApplicable:
        tol = REFERENCE_TOL[1]
        reference = answer_of(solve_stationary(process, tol=tol, form="drift-diffusion"))
        words = f"drift-diffusion hp elements, tol {tol:g}"

    def by_quadrature(process: Process, tol: float) -> Answer:
        s = solve_by_quadrature(process, tol=tol)
        return Answer((s.nodes,), s.density, s.l1_error, POINTS * (s.nodes.size - 1))

    return Equation(
        theory="nonintegrable",
        name="averaged equation (24)",
        observable=parse_observable("H", system.n),
        process=clock.timed(process),
        clock=clock,
        reference=reference,
        reference_words=words,
        ends=[probed(process).extent(BEYOND[1])],
        by_tolerance={
            NonIntegrable("fem").route: lambda p, tol: answer_of(solve_stationary(p, tol=tol)),
            NonIntegrable("quadrature").route: by_quadrature,
        },
        words="elements whose number and degree follow from the tolerance, cut until it is met.",
    )


def modal_equation(system: System) -> Equation:
    """Return (17) for p(H1, H2) of the first two modes; raise ``NotApplicable`` as the theory does.

    Constant damping has the closed form (34) as reference. Where damping depends on the state it is
    plain elements of one degree (p itself is the polynomial, w = 1) on a mesh of their own, which
    share with the route the coefficients and the weak form only.
    """
    modes = modal_analysis(system)
    if modes.n < 2:
        raise NotApplicable("one mass has one modal energy: nothing to solve in two dimensions")
    if not modes.constant and modes.n > 2:
        raise NotApplicable("damping terms couple more than two modal energies")
    require_no_resonance(system, modes)
    observable = parse_observable("H1,H2", system.n)
    process, clock = modes.process([0, 1]), Clock()
    if modes.constant:
        (closed,) = modal_densities(modes, [observable], "closed-form", tol=1e-12)
        reference = Answer(closed.panels, closed.pdf, closed.l1_error)
        words = "closed form (34)"
    else:
        solution = solve_plane(process, tol=REFERENCE_TOL[2], degree=REFERENCE_DEGREE)
        if not np.isfinite(solution.l1_error):
            raise NotCertified("plain elements, the reference of (17), have no finite error")
        reference = answer_of(solution)
        count = " x ".join(str(nodes.size - 1) for nodes in solution.nodes)
        words = f"plain elements (w = 1), degree {solution.degree}, {count} on a mesh of their own"
    ends = probed_plane(process).extent(BEYOND[2]) * process.energy_scales
    return Equation(
        theory="integrable",
        name="averaged equation (17)",
        observable=observable,
        process=clock.timed(process),
        clock=clock,
        reference=reference,
        reference_words=words,
        ends=ends.tolist(),
        by_tolerance={Integrable("fem").route: lambda p, tol: answer_of(solve_plane(p, tol=tol))},
        words=(
            "p = w u with a positive weight w near p and u a polynomial of high degree on few"
            " panels; plain elements (levels marked w = 1) where that misses the tolerance. With"
            " constant damping w itself is the density, (34)."
        ),
    )


EQUATIONS: Mapping[str, tuple[str, Callable[[System], Equation]]] = {
    "nonintegrable": ("H", energy_equation),
    "integrable": ("H1,H2", modal_equation),
}
"""By theory: the observable that its equation is studied for, and what makes the equation."""
