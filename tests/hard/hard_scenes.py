"""The scenes of ``cases/hard``: what each density has to hold, and what is expected of which."""

import warnings
from dataclasses import replace
from functools import partial
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy.sparse.linalg import MatrixRankWarning, spsolve
from skfem import Basis, BilinearForm, ElementLineP2, LinearForm, MeshLine
from systems import in_units, mirrored

from averaging.energy_process import energy_process
from averaging.integrable import Integrable
from averaging.nonintegrable import NonIntegrable
from cases.scene.scene import load_scene, shipped_scenes
from fpk.answer.density import l1_distance
from fpk.answer.names import observable_name, parse_observable
from fpk.numeric.quadrature import panel_rule
from fpk.solvers.line.stationary import solve_on_mesh, solve_stationary
from fpk.system.system import System

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


TOLERANCES = {"three-contact-masses": 1e-4}
"""Tolerance where it is not that of the battery: of three contact masses the coefficients, inverse
Laplace transforms on lines of finite length, are known to some 1e-6."""
PLAIN_MASSES = 2
"""Contact masses from which plain elements are not run: their coefficients cost minutes."""
CELLS, REACH = 1000, 20.0
"""Cells of the plain solution, and its box in units of the energy scale: what one would guess."""


def plain_elements(process, reference):
    """Return the L1 error and the minimum, relative to the maximum, of plain P2 elements.

    ``CELLS`` equal cells, the weak form of the FPK equation as it stands, one row of the matrix
    replaced by the mass: scikit-fem as its examples use it.
    """
    mesh = MeshLine(np.linspace(0.0, REACH * process.energy_scale, CELLS + 1))
    basis = Basis(mesh, ElementLineP2())

    def flux(u, v, w):
        H = w.x[0]
        c = process.coefficients(H.ravel())
        a = (c.drift - 0.5 * c.divergence).reshape(H.shape)
        return (a * u - 0.5 * c.diffusion.reshape(H.shape) * u.grad[0]) * v.grad[0]

    matrix = BilinearForm(flux).assemble(basis).tolil()
    mass = LinearForm(lambda v, w: v).assemble(basis)
    row, right = CELLS // 20, np.zeros(mass.size)
    matrix[row], right[row] = mass, 1.0
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", MatrixRankWarning)
        p = spsolve(matrix.tocsr(), right)
    x, values = basis.global_coordinates(), np.asarray(basis.interpolate(p))
    truth = np.where(x[0] > 0.0, reference.pdf(np.maximum(x[0], np.finfo(float).tiny)), 0.0)
    error = float(np.sum(np.abs(values - truth) * basis.dx))
    return error, float(values.min() / values.max())


def hard_scenes():
    """Return the scenes of ``cases/hard``."""
    return [load_scene(n) for n, path in shipped_scenes().items() if path.parent.name == "hard"]


def curve_case(scene, curve):
    """Run the battery on one curve of a hard scene."""
    system = curve.system
    checks, closed, elements = solver_checks(system, TOLERANCES.get(scene.name, TOL))
    plain = "not run: its coefficients take minutes"
    if len(system.contact_masses) < PLAIN_MASSES:
        checks += [refinement_check(system, closed), units_check(system, elements)]
        error, minimum = plain_elements(energy_process(system), closed)
        plain = f"L1 {error:.1e}, minimum {minimum:.0e} of the maximum"
    displacement = next((o for o in scene.observables if o[0].kind == "q"), None)
    if displacement is not None:
        checks.append(mirror_check(system, observable_name(displacement)))
    if scene.name in EXPECTED:
        checks.append(Check(*EXPECTED[scene.name](system, closed)))
    c = elements.certificate
    return HardCase(
        f"{scene.name}: {curve.label}" if curve.label else scene.name,
        scene.source.removeprefix("Hard: "),
        f"L1 {l1_distance(elements, closed):.1e}, stated {elements.l1_error:.1e}",
        "certified" if c.certified else "; ".join(c.failures),
        checks,
        plain,
    )


def _as_without_contact(system, density):
    free = System(system.mass, system.stiffness, system.damping, system.noise_intensity)
    change = l1_distance(density, energy_density(free, "closed-form"))
    return "a stop that is never reached changes nothing", change <= 1e-12, f"{change:.1e}"


def _refused(words):
    def check(system, density):
        reason = Integrable(tol=TOL).refusal(system, parse_observable("q1", system.n)) or "taken"
        return "the integrable theory refuses", words in reason, reason

    return check


def _decades(system, density):
    p = density.pdf(np.geomspace(1e-3, 1.0, 400) * density.panels[0][-1])
    spanned = float(np.ptp(np.log10(p[p > 0.0])))
    return "p(H) rises by more than 100 decades", spanned > 100.0, f"{spanned:.0f}"


def _two_humps(system, density):
    p = density.pdf(np.linspace(0.0, density.panels[0][-1], 4001)[1:])
    humps = int(np.sum((p[1:-1] > p[:-2]) & (p[1:-1] > p[2:])))
    return "two humps", humps == 2, f"{humps} maxima"


EXPECTED = {
    "never-reached": _as_without_contact,
    "near-resonance": _refused("internal resonance"),
    "silent-mode": _refused("gets no noise"),
    "limit-cycle": _decades,
    "bistable": _two_humps,
}
"""What else must hold of a scene, by its name."""

SLOW_SCENES = ("chain-50", "limit-cycle", "three-contact-masses", "two-contact-masses")
CURVES = tuple((scene, curve) for scene in hard_scenes() for curve in scene.curves)
CASES = tuple(partial(curve_case, scene, curve) for scene, curve in CURVES)
