"""Every quantity of exact and linear scenes errs by no more than it states."""

import numpy as np
import pytest
from known_gaussian import Linear
from known_quantities import ROUND_OFF, Exact
from scipy import stats

import fpk as face
from averaging.energy_process import compatibility
from cases.compare.quantity import QUANTILES
from cases.compare.routes import method_for
from cases.scene.scene import load_scene, shipped_scenes
from fpk.numeric.errors import NotApplicable
from fpk.system.contact import Contact
from fpk.system.system import System

FREE = System([1.0], [1.0], [0.08], [0.08 * 0.3])
STOPPED = System([2.0], [1.0], [0.08], [0.024], contacts=(Contact(1, "right", 10.0, 0.3),))
LINEAR = System([1.0, 2.0], [1.0, 0.5], [0.08, 0.04], [0.01, 0.02])
SAMPLED = [
    (STOPPED, ["q1", "H", "q1,p1"], "exact"),
    (LINEAR, ["q2", "p1", "q1,q2"], "linear"),
]
DEFAULT = {"fig3a", "fig4a", "one-mass", "near-resonance", "unequal-sides", "cir"}


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
                row = next(iter(system.contact_masses), 0)
                if q.observable != "H":
                    row = int(q.observable[1:]) - 1
                own = Exact(system, compatibility(system), row)
            references[q.observable] = own.truth(q.observable)
        known, cdf = references[q.observable]
        value, error = q.number.value, q.number.error
        if q.quantity in QUANTILES:
            if cdf is None:
                continue  # of several masses at stops moments of the energy are known alone
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
    for name in sorted(shipped_scenes().keys() - {"three-contact-masses"}):  # a grid of three axes
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
        if name == "silent-mode":
            with pytest.raises(NotApplicable, match="no joint density"):
                shares_of(system, ["q1,q2"], route)
        else:
            observables.append("q1,q2")
    used = shares_of(system, observables, route)
    assert len(used) >= (5 if many else 16)
    worst = max(used, key=used.get)
    assert used[worst] <= 1.0, (worst, used[worst])


def solved_in_units(m, x, t):
    """One mass of 2 m at a stop, solved by two routes in units of mass, length and time."""
    stop = Contact(1, "right", 10.0 * (m * x / t**2) / x**1.5, 0.3 * x)
    D = 0.024 * m / t * (m * x**2 / t**2)
    system = System([2.0 * m], [m / t**2], [0.08 * m / t], [D], contacts=(stop,))
    return face.solve(system, ["q1", "H", "q1,p1"], methods=["exact", "nonintegrable/fem"])


@pytest.fixture(scope="module")
def plain():
    return solved_in_units(1.0, 1.0, 1.0)


@pytest.mark.parametrize("unit", [1e-30, 1e30])
@pytest.mark.parametrize("of", range(3))
def test_units_of_mass_length_and_time_are_free(plain, of, unit):
    """The same system in other units: quantities differ by the unit and by round-off in errors."""
    m, x, t = np.where(np.arange(3) == of, unit, 1.0)
    force, energy = m * x / t**2, m * x**2 / t**2
    powers = {"skewness": 1.0, "kurtosis": 1.0, "correlation": 1.0, "contact probability": 1.0}
    powers |= {"covariance": x * m * x / t, "upcrossing rate": 1.0 / t, "mean force": force}
    powers |= {"force in contact": force, "mean overlap": x, "overlap in contact": x}

    scaled = solved_in_units(m, x, t)
    assert not scaled.problems
    for own, known in zip(scaled.quantities, plain.quantities, strict=True):
        scale = powers.get(own.quantity.partition(",")[0], energy if own.observable == "H" else x)
        off = abs(own.number.value / scale - known.number.value)
        assert off <= own.number.error / scale + known.number.error, (own.observable, own.quantity)
        # Round-off depends on the unit; errors of quantiles begin at 1e-14 of the support.
        assert own.number.error / scale <= 30.0 * known.number.error + 1e-12


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
    assert used[worst] <= 1.0, (worst, used[worst])


@pytest.mark.parametrize("p", [1e-300, 1e-100, 1e-30, 1e-18, 1e-12])
@pytest.mark.parametrize("route", ["linear", "exact", "nonintegrable/fem"])
def test_a_rare_exceedance_and_its_quantile_are_within_their_errors(route, p):
    density = face.solve(FREE, ["q1"], methods=[route])["q1"]
    x = stats.norm.isf(p) * np.sqrt(0.3)
    number = density.exceedance(x)
    assert abs(number.value - p) <= number.error and number.error < 1e-13
    for share, true in ((p, -x), (1.0 - p, stats.norm.ppf(1.0 - p) * np.sqrt(0.3))):
        if 0.0 < share < 1.0:
            quantile = density.quantile(share)
            assert abs(quantile.value - true) <= quantile.error


SEEDS = range(100, 110)


@pytest.mark.slow
@pytest.mark.parametrize(("system", "observables", "route"), SAMPLED, ids=["stop", "linear"])
def test_simulation_scatters_about_the_truth_by_its_standard_errors(system, observables, route):
    """Ten seeds: no |z| beyond what Student's t of the batches exceeds in 1e-4 of such tests.

    Nor is the mean of z over the seeds, a normal of 1/√10, beyond its own such bound, or the mean
    of z² of all: of quantities that vary together no better than χ² of ten, whose quantile it is.
    """
    exact = face.solve(system, observables, methods=[route])
    true = {(q.observable, q.quantity): q.number for q in exact.quantities}
    z: dict[tuple[str, str], list[float]] = {}
    for seed in SEEDS:
        method = method_for("montecarlo", paths=4096, relaxations=8.0, seed=seed)
        for q in face.solve(system, observables, methods=[method]).quantities:
            known = true[q.observable, q.quantity]
            error = np.hypot(q.number.error, known.error)
            z.setdefault((q.observable, q.quantity), []).append(
                (q.number.value - known.value) / error
            )
    assert {*z} == {*true}
    values = np.array([*z.values()])
    largest = -stats.t.ppf(1e-4 / (2 * values.size), 4096 // 128 - 1)
    assert np.abs(values).max() < largest
    mean = -stats.norm.ppf(1e-4 / (2 * len(values))) / np.sqrt(len(SEEDS))
    assert np.abs(values.mean(axis=1)).max() < mean
    squares = np.mean(values**2, axis=1)
    assert squares.max() < stats.chi2.isf(1e-4 / len(values), len(SEEDS)) / len(SEEDS)
