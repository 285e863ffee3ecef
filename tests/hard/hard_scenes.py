"""The scenes of ``cases/hard``: the battery on every curve, and what is expected of each."""

from collections.abc import Callable
from functools import partial

import numpy as np
from hard_battery import (
    TOL,
    energy_density,
    mirror_check,
    refinement_check,
    solver_checks,
    units_check,
)
from hard_case import Check, HardCase
from hard_plain import plain_elements

from averaging.energy_process import energy_process
from averaging.integrable import Integrable
from cases.scene.numbers import Curve
from cases.scene.scene import Scene, load_scene, shipped_scenes
from fpk.answer.density import Density, l1_distance
from fpk.answer.names import observable_name, parse_observable
from fpk.system.system import System

TOLERANCES = {"three-contact-masses": 1e-4}
"""Tolerance where it is not that of the battery: of three contact masses the coefficients, inverse
Laplace transforms on lines of finite length, are known to some 1e-6."""
PLAIN_MASSES = 2
"""Contact masses from which plain elements are not run: their coefficients cost minutes."""


def hard_scenes() -> list[Scene]:
    """Return the scenes of ``cases/hard``."""
    return [load_scene(n) for n, path in shipped_scenes().items() if path.parent.name == "hard"]


def curve_case(scene: Scene, curve: Curve) -> HardCase:
    """Run the battery on one curve of a hard scene."""
    system = curve.system
    checks, closed, elements = solver_checks(system, TOLERANCES.get(scene.name, TOL))
    few = len(system.contact_masses) < PLAIN_MASSES
    if few:
        checks += [refinement_check(system, closed), units_check(system, elements)]
    displacement = next((o for o in scene.observables if o[0].kind == "q"), None)
    if displacement is not None:
        checks.append(mirror_check(system, observable_name(displacement)))
    checks += EXPECTED.get(scene.name, _nothing)(system, closed)
    plain = "not run: its coefficients take minutes"
    if few:
        error, minimum = plain_elements(energy_process(system), closed)
        plain = f"L1 {error:.1e}, minimum {minimum:.0e} of the maximum"
    c = elements.certificate
    return HardCase(
        name=f"{scene.name}: {curve.label}" if curve.label else scene.name,
        hard=scene.source.removeprefix("Hard: "),
        plain=plain,
        ours=f"L1 {l1_distance(elements, closed):.1e}, stated {elements.l1_error:.1e}",
        certificate="certified" if c.certified else "; ".join(c.failures),
        checks=tuple(checks),
    )


def _nothing(system: System, density: Density) -> list[Check]:
    return []


def _as_without_contact(system: System, density: Density) -> list[Check]:
    free = System(system.mass, system.stiffness, system.damping, system.noise_intensity)
    change = l1_distance(density, energy_density(free, "closed-form"))
    return [Check("a stop that is never reached changes nothing", change <= 1e-12, f"{change:.1e}")]


def _refused(words: str) -> Callable[[System, Density], list[Check]]:
    def check(system: System, density: Density) -> list[Check]:
        wanted = parse_observable("q1", system.n)
        reason = Integrable(tol=TOL).refusal(system, wanted) or "taken"
        return [Check("the integrable theory refuses", words in reason, reason)]

    return check


def _decades(system: System, density: Density) -> list[Check]:
    H = np.geomspace(1e-3, 1.0, 400) * density.panels[0][-1]
    p = density.pdf(H)
    seen = p[p > 0.0]
    spanned = float(np.log10(seen.max()) - np.log10(seen.min()))
    return [Check("p(H) rises by more than 100 decades", spanned > 100.0, f"{spanned:.0f}")]


def _two_humps(system: System, density: Density) -> list[Check]:
    p = density.pdf(np.linspace(0.0, density.panels[0][-1], 4001)[1:])
    humps = int(np.sum((p[1:-1] > p[:-2]) & (p[1:-1] > p[2:])))
    return [Check("two humps", humps == 2, f"{humps} maxima")]


EXPECTED: dict[str, Callable[[System, Density], list[Check]]] = {
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
