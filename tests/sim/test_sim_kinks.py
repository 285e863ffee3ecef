"""Sampled densities and rates at stops and at energies of stops, against exact values."""

from itertools import chain

import numpy as np
import pytest
from random_stops import deviations, exact_density, random_stops
from sim_gibbs import Gibbs
from test_sim_transient import sampled as transient

from fpk.answer.dynamics import upcrossings
from fpk.answer.names import parse_observable
from fpk.answer.sampled_density import SampledDensity
from fpk.system.contact import Contact
from fpk.system.system import System
from sim.montecarlo import MonteCarlo

Z = 5.0
"""|z| that chance explains: of 5000 values by 32 batches 0.1."""


def sampled(method: MonteCarlo, system: System, name: str) -> SampledDensity:
    (density,) = method.solve(system, [parse_observable(name, system.n)]).densities
    return density


def one_mass(kT: float, side: str, B: float, gap: float, law: str = "hertz") -> System:
    contact = Contact(1, side, B, gap, law=law)
    return System([1.0], [1.0], [0.4], [0.4 * kT], contacts=(contact,))


@pytest.mark.parametrize("times", [1.0, 100.0 / 12.0, 1000.0 / 12.0])
def test_energies_of_a_mass_between_stops(times: float) -> None:
    """12, 100 and 1000 times the spring: at the energy of the stop and down to H = 0."""
    gap, kT = 0.35355339059327373, 0.5
    B = 11.89207115002721 * times
    exact = Gibbs((1.0,), (1.0,), kT, 0, ((1.0, gap, B, 1.5), (-1.0, gap, B, 1.5)))
    method = MonteCarlo(paths=4096, relaxations=10.0 / times**0.3)
    density = sampled(method, one_mass(kT, "both", B, gap), "H")
    x = np.array([1e-4, 0.03, 0.5 * gap**2, 0.07, 0.2])
    value, error = density.at(x)
    right = exact.H(x)
    if times == 1.0:
        assert right[0] == pytest.approx(2.958, abs=5e-4)
    assert density.certificate.certified and np.all(error < 0.1 * right)
    assert np.all(np.abs(value - right) < Z * error)
    edges = density.edges[0]
    middle = 0.5 * (edges[1:] + edges[:-1])
    middle = middle[middle < 6.0 * kT]
    off = np.abs(density(middle) - exact.H(middle)) @ np.diff(edges)[: middle.size]
    assert off < 3.0 * density.l1_error


def test_the_lowest_energies_of_two_masses_are_positive() -> None:
    """p(H) ~ H: at 1e-4 it is 5.69e-4."""
    contact = Contact(2, "left", 5000.0, 0.5)
    system = System([1.0] * 2, [1.0] * 2, [0.1] * 2, [0.05] * 2, contacts=(contact,))
    density = sampled(MonteCarlo(paths=4096, relaxations=60.0), system, "H")
    value, error = density.at(np.array([1e-4]))
    right = Gibbs((1.0,) * 2, (1.0,) * 2, 0.5, 1, ((-1.0, 0.5, 5000.0, 1.5),)).H(np.array([1e-4]))
    assert right[0] == pytest.approx(5.69e-4, rel=2e-3)
    assert density.certificate.certified and value[0] > 0.0
    assert abs(value[0] - right[0]) < Z * error[0] < Z * right[0]


def test_a_low_quantile_of_the_energy() -> None:
    """1 % of the time a mass with hardly a clearance has less energy than 0.00153884."""
    system = one_mass(0.5, "both", 118.9207115002721, 0.014142135623730949)
    density = sampled(MonteCarlo(paths=4096, relaxations=40.0), system, "H")
    found = density.quantile(0.01)
    assert abs(found.value - 0.00153884) < Z * found.error < 0.1 * 0.00153884


@pytest.mark.parametrize(
    ("law", "B", "right"),
    [("hertz", 1e5, 0.2289840), ("hertz", 1e6, 0.2299971), ("bilinear", 1e6, None)],
)
def test_impacts_of_a_stiff_stop(law: str, B: float, right: float | None) -> None:
    """√(kT/(2 π m)) p(q = stop) per unit of time, where p falls within 1e-3 of a clearance."""
    exact = Gibbs((1.0,), (1.0,), 1.0, 0, ((1.0, 0.37, B, 1.5 if law == "hertz" else 1.0),))
    rate = exact.upcrossings(0.37)
    assert right is None or rate == pytest.approx(right, abs=1e-7)
    method = MonteCarlo(paths=4096, relaxations=2.0, burn_in=2.0)
    density = sampled(method, one_mass(1.0, "right", B, 0.37, law), "q1,p1")
    value, error = upcrossings(density, 1.0, np.array([0.37]))
    assert abs(value[0] - rate) < Z * error[0] < 0.3 * rate


def test_impacts_by_a_density_are_those_that_are_counted() -> None:
    """Of two masses against stiff stops there is no exact density."""
    contact = Contact(2, "both", 1e4, 0.37)
    system = System([1.0, 0.2], [1.0, 3.0], [0.4, 0.1], [0.4, 0.02], contacts=(contact,))
    method, at = MonteCarlo(paths=4096, time=10.0), np.array([-0.37, 0.37])
    density = sampled(method, system, "q2,p2")
    value, error = upcrossings(density, 0.2, at)
    counted = method.crossings(system, parse_observable("q2", 2), at)
    both = np.hypot(error, counted.errors)
    assert np.all(np.abs(value - counted.values) < Z * both)
    assert np.all(both < 0.1 * value)


@pytest.mark.parametrize("name", ["q1", "H", "q1,p1"])
def test_kinks_after_a_long_time(name: str) -> None:
    """After 8 relaxation times from rest a transient is the stationary density."""
    gap, kT, B = 0.35, 0.5, 1e3
    exact = Gibbs((1.0,), (1.0,), kT, 0, ((1.0, gap, B, 1.5), (-1.0, gap, B, 1.5)))
    points = {
        "q1": (np.array([0.0, 0.33, 0.35, 0.36, 0.37]),),
        "H": (np.array([1e-3, 0.05, 0.5 * gap**2, 0.065, 0.1]),),
        "q1,p1": (np.array([0.0, 0.33, 0.35, 0.36, 0.37]), np.array([0.0, 0.3, -0.5, 1.0, 0.1])),
    }[name]
    right = exact_density(exact, name, *points)
    answer = transient(one_mass(kT, "both", B, gap), name, "rest", [20.0], *points)
    assert answer.certificate.certified
    assert np.all(np.abs(answer.values[0] - right) < Z * answer.errors[0])
    assert np.all(answer.errors[0] < 0.2 * right)


def test_random_stops() -> None:
    """Some of the systems below whose stops are not stiff, one or two masses, hardly a second."""
    method = MonteCarlo(paths=4096, relaxations=20.0)
    every = [deviations(*random_stops(seed), method) for seed in (0, 5, 18)]
    z, ratios = (np.concatenate([row[k] for row in every]) for k in (0, 1))
    assert not any(row[2] for row in every) and z.size > 150
    assert np.max(np.abs(z)) < Z and np.max(ratios) < 3.0


@pytest.mark.slow
def test_eighty_random_systems_with_stops() -> None:
    """No certified value beyond five of its errors, |z| as large as chance makes them."""
    every = [deviations(*random_stops(seed), MonteCarlo(seconds=4.0)) for seed in range(80)]
    z, ratios = (np.array([*chain.from_iterable(row[k] for row in every)]) for k in (0, 1))
    assert z.size > 3000
    assert np.max(np.abs(z)) < Z and 0.8 < np.sqrt(np.mean(z**2)) < 1.2
    assert np.max(ratios) < 3.0
    # In these seconds a machine that is busy with other things samples too little of the stiffest.
    late = {words.rpartition("; ")[2] for row in every for words in row[2]}
    assert late <= {"give it more time", "sample for longer"}
