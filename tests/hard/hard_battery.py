"""What every density has to hold, whatever makes its system hard."""

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise

import numpy as np
from hard_case import Check
from hard_units import in_units, mirrored

from averaging.energy_process import energy_process
from averaging.nonintegrable import NonIntegrable
from fpk.answer.density import Density, l1_distance
from fpk.answer.names import Observable, parse_observable
from fpk.numeric.quadrature import panel_rule
from fpk.solvers.line.stationary import solve_on_mesh, solve_stationary
from fpk.system.system import System

TOL = 1e-8
"""L1 tolerance of hard cases: of some the coefficients themselves are not known to 1e-10."""
LEAST, MASS = -1e-14, 1e-12
"""Smallest p / max p that is round-off; departure of the mass from one that is round-off of its
sum. Beside that it may be off by the stated L1 error, as |∫p − 1| <= ∫|p − p_exact|."""
UNITS = {"mass": 3.7, "length": 0.13, "time": 11.0}
"""Factors that are no powers of two, so that round-off has its say."""
UNIT_ERROR = 1e-10
DEGREE, LEVELS = 4, 4
ROUND_OFF = 1e-12
"""L1 error at which refinement has nothing left to improve: some thousand roundings."""


def energy_density(
    system: System, solver: str, observable: str = "H", *, tol: float = TOL
) -> Density:
    """Return one density of the averaged energy by ``solver``."""
    method = NonIntegrable(solver=solver, tol=tol)  # type: ignore[arg-type]  # checked there
    wanted: Observable = parse_observable(observable, system.n)
    answer = method.solve(system, [wanted]).densities[0]
    assert isinstance(answer, Density)
    return answer


def solver_checks(system: System, tol: float) -> tuple[list[Check], Density, Density]:
    """Certificates of the three solvers and their distances; the closed form and the elements."""
    closed, elements, quadrature = (
        energy_density(system, solver, tol=tol) for solver in ("closed-form", "fem", "quadrature")
    )
    checks = []
    for name, answer in (("finite elements", elements), ("quadrature", quadrature)):
        c = answer.certificate
        checks += [
            Check(f"{name} certified", c.certified, "; ".join(c.failures) or "yes"),
            Check(
                f"{name}: mass one",
                c.mass_defect <= MASS + answer.l1_error,
                f"defect {c.mass_defect:.1e}",
            ),
            Check(f"{name}: not negative", c.minimum >= LEAST, f"minimum {c.minimum:.1e}"),
        ]
        error, allowed = l1_distance(answer, closed), answer.l1_error + closed.l1_error
        checks.append(
            Check(
                f"{name}: true error within the stated one",
                bool(np.isfinite(error)) and error <= allowed + ROUND_OFF,
                f"{error:.1e}, stated {allowed:.1e}",
            )
        )
    return checks, closed, elements


def refinement_check(system: System, closed: Density) -> Check:
    """Error under bisection of a coarse mesh: at least halved each time, down to a floor."""
    process = energy_process(system)
    nodes, errors = solve_stationary(process, tol=1e-2, degree=DEGREE).nodes, []
    for _ in range(LEVELS):
        solution = solve_on_mesh(process, nodes, DEGREE)
        H, w = panel_rule(nodes, 20)
        H, w = H.ravel(), w.ravel()
        inside = float(np.sum(w * np.abs(solution.density(H) - closed.pdf(H))))
        errors.append(inside)
        nodes = np.sort(np.concatenate([nodes, 0.5 * (nodes[1:] + nodes[:-1])]))
    # What lies beyond the mesh is renormalised into it: that part does not fall with the cells.
    floor = ROUND_OFF + closed.l1_error + 2.0 * solution.certificate.tail_mass
    floor += solution.common_error
    falls = all(b <= 0.5 * a or b <= floor for a, b in pairwise(errors))
    measured = ", ".join(f"{e:.1e}" for e in errors)
    return Check(
        "error halved by every bisection", falls and bool(np.isfinite(errors).all()), measured
    )


def units_check(system: System, elements: Density) -> Check:
    """The same density in other units, its change in L1."""
    energy = UNITS["mass"] * (UNITS["length"] / UNITS["time"]) ** 2
    other = energy_density(in_units(system, **UNITS), "fem")
    rescaled = replace(
        other,
        panels=tuple(x / energy for x in other.panels),
        pdf=_stretched(other.pdf, energy),
    )
    # Meshes of one tolerance differ by roundings alone, but that may move a bisection.
    change = l1_distance(rescaled, elements)
    allowed = UNIT_ERROR + elements.l1_error + other.l1_error
    return Check("the same in other units", change <= allowed, f"{change:.1e}")


def mirror_check(system: System, observable: str) -> Check:
    """p(q) of the mirrored system at −q, beside p(q)."""
    answer, other = (
        energy_density(s, "closed-form", observable) for s in (system, mirrored(system))
    )
    q = np.linspace(answer.panels[0][0], answer.panels[0][-1], 2001)
    worst = float(np.max(np.abs(answer.pdf(q) - other.pdf(-q))) / np.max(answer.pdf(q)))
    return Check("mirror image to round-off", worst <= 1e-13, f"{worst:.1e} of the maximum")


def _stretched(pdf: Callable[..., np.ndarray], factor: float) -> Callable[..., np.ndarray]:
    return lambda x: np.asarray(factor * pdf(factor * x))
