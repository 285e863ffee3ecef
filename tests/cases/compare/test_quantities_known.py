"""Every quantity of exact and linear scenes errs by no more than it states."""

import numpy as np
import pytest
from known_quantities import ROUND_OFF, Gibbs
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
DEFAULT = {"fig3a", "one-mass", "unequal-sides", "cir"}


def assert_within(system, *observables):
    """Hold every quantity of the exact density to the true one within its stated error."""
    truths = {}
    for name in observables:
        row = next(iter(system.contact_masses), 0 if name == "H" else int(name[1:]) - 1)
        truths[name] = Gibbs(system, 1.0 / compatibility(system)[0], row).truth(name)
    quantities = face.solve(system, observables, methods=["exact"]).quantities
    assert len(quantities) >= 16
    for q in quantities:
        known, cdf = truths[q.observable]
        value, error = q.number.value, q.number.error
        if q.quantity in QUANTILES:
            p = QUANTILES[q.quantity]
            low, high, density = cdf(value)
            off = abs(min(low - p, 1.0 - p - high, key=abs)) / density
            size = abs(value) + 1.0 / density
        elif np.isfinite(error):
            true, size = known[q.quantity]
            off = abs(value - true)
        else:  # of a stop that is never touched
            continue
        assert off - ROUND_OFF * size <= error, (q.observable, q.quantity)


def scenes():
    """Scenes with a Gibbs state and stops at one mass at the most."""
    for name in sorted(shipped_scenes()):
        for k, curve in enumerate(load_scene(name).curves):
            system, marks = curve.system, [pytest.mark.slow]
            try:
                method_for("exact").prepare(system)
            except NotApplicable:
                continue
            if len(system.contact_masses) < 2 and not system.damping_terms:
                marks = [] if name in DEFAULT and k == 0 else marks
                yield pytest.param(system, marks=marks, id=f"{name}-{k}")


@pytest.mark.parametrize("system", [*scenes()])
def test_quantities_of_a_shipped_scene(system):
    at = next(iter(system.contact_masses), 0) + 1
    assert_within(system, "H", f"q{at}", f"p{at}")


def solved_in_units(m, x, t):
    """One mass of 2 m at a stop, solved by two routes in units of mass, length and time."""
    stop = Contact(1, "right", 10.0 * (m * x / t**2) / x**1.5, 0.3 * x)
    D = 0.024 * m / t * (m * x**2 / t**2)
    system = System([2.0 * m], [m / t**2], [0.08 * m / t], [D], contacts=(stop,))
    return face.solve(system, ["q1", "H", "q1,p1"], methods=["exact", "nonintegrable/fem"])


@pytest.fixture(scope="module")
def plain():
    return solved_in_units(1.0, 1.0, 1.0)


@pytest.mark.parametrize("unit", [pytest.param(1e-30, marks=pytest.mark.slow), 1e30])
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


@pytest.mark.parametrize(
    "seed", [0, *(pytest.param(k, marks=pytest.mark.slow) for k in range(1, 10))]
)
def test_quantities_of_a_random_system(seed):
    rng = np.random.default_rng(seed)
    n, (mass, length, time) = int(rng.integers(1, 4)), 10.0 ** rng.uniform(-4, 4, 3)
    T = mass * length**2 / time**2
    units = mass, mass / time**2, 0.1 * mass / time
    m, k, c = (unit * 10.0 ** rng.uniform(-0.7, 0.7, n) for unit in units)
    row = int(rng.integers(1, n + 1))
    rms = np.sqrt(np.sum(1.0 / k[:row]) * T)
    law, power = [("hertz", 1.5), ("bilinear", 1.0), ("power", 2.5)][int(rng.integers(3))]
    own = {"law": law, **({"exponent": power} if law == "power" else {})}
    stiffness = float(k.mean() * rms ** (1.0 - power) * 10.0 ** rng.uniform(-1, 3))
    side = ["left", "right", "both"][int(rng.integers(3))]
    stop = Contact(row, side, stiffness, float(rms * rng.uniform(0.0, 1.5)), **own)
    assert_within(System(m, k, c, c * T, contacts=(stop,)), "H", f"q{row}", f"p{row}")


@pytest.mark.parametrize("route", ["linear", "exact", "nonintegrable/fem"])
def test_a_rare_exceedance_and_its_quantile_are_within_their_errors(route):
    density, scale = face.solve(FREE, ["q1"], methods=[route])["q1"], np.sqrt(0.3)
    for p in (1e-300, 1e-100, 1e-30, 1e-18, 1e-12):
        x = stats.norm.isf(p) * scale
        number = density.exceedance(x)
        assert abs(number.value - p) <= number.error and number.error < 1e-13
        for share, true in ((p, -x), (1.0 - p, stats.norm.ppf(1.0 - p) * scale)):
            if 0.0 < share < 1.0:
                quantile = density.quantile(share)
                assert abs(quantile.value - true) <= quantile.error
