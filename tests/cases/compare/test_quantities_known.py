"""Quantities of exact scenes err by no more than they state; units are free; rare events."""

import numpy as np
import pytest
from scipy import stats
from systems import in_units

import fpk as face
from fpk.numeric.quadrature import panel_rule
from fpk.system.contact import Contact
from fpk.system.system import System

FREE = System([1.0], [1.0], [0.08], [0.08 * 0.3])
STOPPED = System([2.0], [1.0], [0.08], [0.024], contacts=(Contact(1, "right", 10.0, 0.3),))


@pytest.mark.parametrize("unit", [pytest.param(1e-30, marks=pytest.mark.slow), 1e30])
def test_units_of_mass_length_and_time_are_free(unit):
    """The same system in other units: quantities differ by the unit and by round-off in errors."""
    routes = ["exact", "nonintegrable/fem"]
    observables = ["q1", "H", "q1,p1"]
    plain = face.solve(STOPPED, observables, methods=routes)
    for m, x, t in np.where(np.eye(3), unit, 1.0):
        force, energy = m * x / t**2, m * x**2 / t**2
        powers = {
            "skewness": 1.0,
            "kurtosis": 1.0,
            "correlation": 1.0,
            "covariance": x * m * x / t,
            "contact probability": 1.0,
            "upcrossing rate": 1.0 / t,
            "mean force": force,
            "force in contact": force,
            "mean overlap": x,
            "overlap in contact": x,
        }
        scaled = face.solve(in_units(STOPPED, m, x, t), observables, methods=routes)
        assert not scaled.problems
        for own, known in zip(scaled.quantities, plain.quantities, strict=True):
            kind = own.quantity.partition(",")[0]
            scale = powers.get(kind, energy if own.observable == "H" else x)
            off = abs(own.number.value / scale - known.number.value)
            assert off <= own.number.error / scale + known.number.error, (own.observable, kind)
            # Round-off depends on the unit; errors of quantiles begin at 1e-14 of the support.
            assert own.number.error / scale <= 30.0 * known.number.error + 1e-12


@pytest.mark.parametrize(
    "seed", [0, 1, *(pytest.param(k, marks=pytest.mark.slow) for k in range(2, 10))]
)
def test_quantities_of_a_random_equilibrium_err_by_no_more_than_stated(seed):
    """exp(−H/T), stops at one mass: p(q) ∝ exp(−W/T), W the least potential at its q."""
    rng = np.random.default_rng(seed)
    n, (mass, length, time) = int(rng.integers(1, 4)), 10.0 ** rng.uniform(-4, 4, 3)
    T = mass * length**2 / time**2
    units = mass, mass / time**2, 0.1 * mass / time
    m, k, c = (unit * 10.0 ** rng.uniform(-0.7, 0.7, n) for unit in units)
    row = int(rng.integers(1, n + 1))
    compliance = np.sum(1.0 / k[:row])
    rms = np.sqrt(compliance * T)
    law, e = [("hertz", 1.5), ("bilinear", 1.0), ("power", 2.5)][int(rng.integers(3))]
    B = float(k.mean() * rms ** (1.0 - e) * 10.0 ** rng.uniform(-1, 3))
    clearance = float(rms * rng.uniform(0.0, 1.5))
    side = ["left", "right"][seed % 2]
    stop = Contact(row, side, B, clearance, law, e if law == "power" else None)
    # Gauss points on panels that crowd about the stop, up to where e^−91 of the whole is left.
    sign = 1.0 if side == "right" else -1.0
    steps = 13.5 * rms * 2.0 ** -np.arange(30.0)
    crowd = sign * clearance + np.concatenate([-steps, [0.0], steps])
    nodes = np.unique(np.clip([*np.linspace(-steps[0], steps[0], 25), *crowd], -steps[0], steps[0]))
    q, w = (array.ravel() for array in panel_rule(nodes, 20))
    overlap = np.maximum(sign * q - clearance, 0.0)
    weight = w * np.exp(-(0.5 * q * q / compliance + B * overlap ** (e + 1.0) / (e + 1.0)) / T)
    share = weight / weight.sum()
    mean, touching, depth, force = (
        share @ values for values in (q, overlap > 0.0, overlap, B * overlap**e)
    )
    second, third, fourth = (share @ (q - mean) ** power for power in (2, 3, 4))
    std = np.sqrt(second)
    beside = np.exp(-0.5 * clearance**2 / compliance / T) / weight.sum()
    contact = {
        "contact probability": touching,
        "mean overlap": depth,
        "mean force": force,
        "overlap in contact": depth / touching,
        "force in contact": force / touching,
        "upcrossing rate": beside * np.sqrt(T / (2.0 * np.pi * m[row - 1])),
    }
    sizes = {  # each number with the size that its round-off is relative to
        "mean": (mean, std),
        "rms": (np.hypot(mean, std), std),
        "std": (std, std),
        "skewness": (third / std**3, 1.0),
        "kurtosis": (fourth / second**2, 4.0),
        **{f"{name}, {side} stop": (value, value) for name, value in contact.items()},
    }
    answers = face.solve(System(m, k, c, c * T, contacts=(stop,)), [f"q{row}"], methods=["exact"])
    found = {quantity.quantity: quantity.number for quantity in answers.quantities}
    assert len(sizes) == 11 and sizes.keys() <= found.keys()
    for name, (value, size) in sizes.items():
        assert abs(found[name].value - value) <= found[name].error + 4e-15 * size, name


@pytest.mark.parametrize("route", ["linear", "nonintegrable/fem"])
def test_a_rare_exceedance_and_its_quantile_are_within_their_errors(route):
    density, scale = face.solve(FREE, ["q1"], methods=[route])["q1"], np.sqrt(0.3)
    for p in (1e-300, 1e-30, 1e-12):
        x = stats.norm.isf(p) * scale
        number = density.exceedance(x)
        assert abs(number.value - p) <= number.error and number.error < 1e-13
        for share, true in ((p, -x), (1.0 - p, stats.norm.ppf(1.0 - p) * scale)):
            if 0.0 < share < 1.0:
                quantile = density.quantile(share)
                assert abs(quantile.value - true) <= quantile.error
