"""Every quantity of exact and linear scenes errs by no more than it states."""

import numpy as np
import pytest

import fpk as face
from cases.comparison.quantities import QUANTILES
from cases.comparison.routes import method_for
from cases.scene.scene import load_scene, shipped_scenes
from fpk.contact import Contact
from fpk.errors import NotApplicable
from fpk.system import System
from tests.cases.known_quantities import ROUND_OFF, Exact, Linear

DEFAULT = {"fig3a", "fig4a", "one-mass", "bistable", "near-resonance", "unequal-sides", "cir"}


def rate_of(system):
    from averaging.exact import compatibility

    return compatibility(system)


def shares_of(system, observables, route):
    """How much of each stated error is used, by observable and quantity."""
    answers = face.solve(system, observables, methods=[route])
    references = {}
    used = {}
    for q in answers.quantities:
        if q.observable not in references:
            if route == "linear":
                own = Linear(system)
            else:
                row = int(q.observable[1:]) - 1 if q.observable != "H" else (
                    system.contact_masses[0] if system.contact_masses else 0
                )
                own = Exact(system, rate_of(system), row)
            references[q.observable] = own.truth(q.observable)
        known, cdf = references[q.observable]
        value, error = q.number.value, q.number.error
        if q.quantity in QUANTILES:
            p = QUANTILES[q.quantity]
            low, high, density = cdf(value)
            off, size = min(low - p, 1.0 - p - high, key=abs) / density, abs(value)
            off, size = abs(off), size + 1.0 / density
        elif q.quantity in known:
            true, size = known[q.quantity]
            off = abs(value - true)
        else:
            assert not np.isfinite(error), (q.observable, q.quantity)
            continue
        used[q.observable, q.quantity] = max(off - ROUND_OFF * size, 0.0) / error
    return used


def scenes():
    found = []
    for name in shipped_scenes():
        for k, curve in enumerate(load_scene(name).curves):
            for route in ("exact", "linear"):
                try:
                    method_for(route).prepare(curve.system)
                except NotApplicable:
                    continue
                marks = [] if name in DEFAULT and k == 0 else [pytest.mark.slow]
                found.append(pytest.param(name, k, route, marks=marks, id=f"{name}-{k}-{route}"))
    return found


@pytest.mark.parametrize(("name", "curve", "route"), scenes())
def test_quantities_of_a_shipped_scene(name, curve, route):
    system = load_scene(name).curves[curve].system
    at = system.contact_masses[0] + 1 if system.contact_masses else 1
    many = len(system.contact_masses) > 1
    of_state = system.damping_terms
    observables = ["H"] if many else ["H", f"q{at}", *([] if of_state else [f"p{at}"])]
    if route == "linear" and system.n > 1:
        observables.append("q1,q2")
    used = shares_of(system, observables, route)
    assert len(used) >= 8 * (1 if many else 2)
    worst = max(used, key=used.get)
    print(f"USED {name} {curve} {route} {used[worst]:.3g} {worst} of {len(used)}")
    assert used[worst] <= 1.0, (worst, used[worst])


def random_system(seed, *, contact):
    rng = np.random.default_rng(seed)
    n = int(rng.integers(1, 4))
    mass, length, time = 10.0 ** rng.uniform(-4, 4, 3)

    def draw(unit):
        return unit * 10.0 ** rng.uniform(-0.7, 0.7, n)

    m, k, c = draw(mass), draw(mass / time**2), draw(0.1 * mass / time)
    T = mass * length**2 / time**2
    D = c * T if contact else draw(0.1 * mass * T / time)
    if not contact:
        return System(m, k, c, D)
    row = int(rng.integers(1, n + 1))
    free = System(m, k, c, D)
    rms = np.sqrt(np.linalg.inv(free.stiffness_matrix)[row - 1, row - 1] * T)
    law, power = [("hertz", 1.5), ("bilinear", 1.0), ("power", 2.5)][int(rng.integers(3))]
    own = {"exponent": power} if law == "power" else {}
    stiffness = float(k.mean() * rms ** (1.0 - power) * 10.0 ** rng.uniform(-1, 3))
    side = ["left", "right", "both"][int(rng.integers(3))]
    stop = Contact(row, side, stiffness, float(rms * rng.uniform(0.0, 1.5)), law=law, **own)
    return System(m, k, c, D, contacts=(stop,))


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("contact", [True, False])
def test_quantities_of_a_random_system(seed, contact):
    system = random_system(seed, contact=contact)
    at = system.contact_masses[0] + 1 if contact else 1
    used = shares_of(system, ["H", f"q{at}", f"p{at}"], "exact" if contact else "linear")
    worst = max(used, key=used.get)
    print(f"USED random {seed} {contact} {used[worst]:.3g} {worst} of {len(used)}")
    assert used[worst] <= 1.0, (worst, used[worst])
