"""The scenes of ``cases/hard``: the battery on every curve, and what is expected of each."""

import warnings
from functools import partial

import numpy as np
from hard_battery import (
    TOL,
    Check,
    HardCase,
    energy_density,
    mirror_check,
    refinement_check,
    solver_checks,
    units_check,
)
from scipy.sparse.linalg import MatrixRankWarning, spsolve
from skfem import Basis, BilinearForm, ElementLineP2, LinearForm, MeshLine

from averaging.energy_process import energy_process
from averaging.integrable import Integrable
from cases.scene.scene import load_scene, shipped_scenes
from fpk.answer.density import l1_distance
from fpk.answer.names import observable_name, parse_observable
from fpk.system.system import System

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
