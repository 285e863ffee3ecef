"""The record of one hard case, and what every density has to hold, whatever makes it hard."""

from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from systems import in_units, mirrored

from averaging.energy_process import energy_process
from averaging.nonintegrable import NonIntegrable
from fpk.answer.density import l1_distance
from fpk.answer.names import parse_observable
from fpk.numeric.quadrature import panel_rule
from fpk.solvers.line.stationary import solve_on_mesh, solve_stationary

TOL = 1e-8
"""L1 tolerance of hard cases: of some the coefficients themselves are not known to 1e-10."""
LEAST, MASS = -1e-14, 1e-12
"""Smallest p / max p that is round-off; departure of the mass from one that is round-off of its
sum. Beside that it may be off by the stated L1 error, as |∫p − 1| <= ∫|p − p_exact|."""
UNITS = 3.7, 0.13, 11.0
"""Factors of mass, length and time: no powers of two, so that round-off has its say."""
UNIT_ERROR, ROUND_OFF = 1e-10, 1e-12
"""L1 change by other units; L1 error at which refinement has nothing left to improve."""
DEGREE, LEVELS = 4, 4


class Check(NamedTuple):
    """One thing that must hold, with what was measured."""

    what: str
    holds: bool
    measured: str


class HardCase(NamedTuple):
    """What makes a case hard, what this program gave and says of it, what a plain method gave."""

    name: str
    hard: str
    ours: str
    certificate: str
    checks: list[Check]
    plain: str = "not run"

    @property
    def failures(self):
        """The checks that do not hold, in words."""
        return tuple(f"{c.what}: {c.measured}" for c in self.checks if not c.holds)


def energy_density(system, solver, observable="H", *, tol=TOL):
    """One density of the averaged energy by ``solver``."""
    method = NonIntegrable(solver=solver, tol=tol)
    return method.solve(system, [parse_observable(observable, system.n)]).densities[0]


def solver_checks(system, tol):
    """Certificates of the three solvers and their distances; the closed form and the elements."""
    closed, elements, quadrature = (
        energy_density(system, solver, tol=tol) for solver in ("closed-form", "fem", "quadrature")
    )
    checks = []
    for name, answer in (("finite elements", elements), ("quadrature", quadrature)):
        c, error = answer.certificate, l1_distance(answer, closed)
        allowed, defect = answer.l1_error + closed.l1_error, c.mass_defect
        stated = f"{error:.1e}, stated {allowed:.1e}"
        checks += [
            Check(f"{name} certified", c.certified, "; ".join(c.failures) or "yes"),
            Check(f"{name}: mass one", defect <= MASS + answer.l1_error, f"defect {defect:.1e}"),
            Check(f"{name}: not negative", c.minimum >= LEAST, f"minimum {c.minimum:.1e}"),
            Check(
                f"{name}: true error within the stated one", error <= allowed + ROUND_OFF, stated
            ),
        ]
    return checks, closed, elements


def refinement_check(system, closed):
    """Error under bisection of a coarse mesh: at least halved each time, down to a floor."""
    process = energy_process(system)
    nodes, errors = solve_stationary(process, tol=1e-2, degree=DEGREE).nodes, []
    for _ in range(LEVELS):
        solution = solve_on_mesh(process, nodes, DEGREE)
        H, w = (x.ravel() for x in panel_rule(nodes, 20))
        errors.append(float(np.sum(w * np.abs(solution.density(H) - closed.pdf(H)))))
        nodes = np.sort(np.concatenate([nodes, 0.5 * (nodes[1:] + nodes[:-1])]))
    # What lies beyond the mesh is renormalised into it: that part does not fall with the cells.
    floor = ROUND_OFF + closed.l1_error + 2.0 * solution.certificate.tail_mass
    floor += solution.common_error
    falls = all(b <= 0.5 * a or b <= floor for a, b in pairwise(errors))
    return Check("error halved by every bisection", falls, ", ".join(f"{e:.1e}" for e in errors))


def units_check(system, elements):
    """The same density in other units, its change in L1."""
    mass, length, time = UNITS
    energy, other = mass * (length / time) ** 2, energy_density(in_units(system, *UNITS), "fem")
    panels = tuple(x / energy for x in other.panels)
    rescaled = replace(other, panels=panels, pdf=lambda x: energy * other.pdf(energy * x))
    # Meshes of one tolerance differ by roundings alone, but that may move a bisection.
    change = l1_distance(rescaled, elements)
    allowed = UNIT_ERROR + elements.l1_error + other.l1_error
    return Check("the same in other units", change <= allowed, f"{change:.1e}")


def mirror_check(system, observable):
    """p(q) of the mirrored system at −q, beside p(q)."""
    sides = system, mirrored(system)
    answer, other = (energy_density(s, "closed-form", observable) for s in sides)
    q = np.linspace(answer.panels[0][0], answer.panels[0][-1], 2001)
    worst = float(np.max(np.abs(answer.pdf(q) - other.pdf(-q))) / np.max(answer.pdf(q)))
    return Check("mirror image to round-off", worst <= 1e-13, f"{worst:.1e} of the maximum")
