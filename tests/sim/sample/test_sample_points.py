"""Values at points, at stops and at energies of stops, against exact densities: z, and the step."""

from functools import partial
from itertools import pairwise
from math import sqrt
from typing import Any

import numpy as np
import pytest
from asked import solved
from scipy.integrate import quad
from sim_systems import exact, exact_density, one_mass, slow, transient

from fpk.answer.contacts import contact_quantities
from fpk.answer.dynamics import upcrossings
from fpk.answer.names import parse_observable
from fpk.numeric.arrays import Array
from fpk.system.contact import Contact
from fpk.system.system import System
from sim.montecarlo import MonteCarlo
from sim.sample.settings import default_step
from sim.step.step_size import (
    JOINT_BIAS,
    chosen_step,
    relative_sampling_error,
    samples_in,
    step_for,
)

Z = 5.0
"""|z| that chance explains: of 5000 values by 32 batches 0.1."""
AROUND = np.array([-0.3, -0.1, -0.03, -0.01, -1e-3, 0.0, 1e-3, 0.01, 0.03, 0.1, 0.3])
"""Distances of the points from a kink, in units of its own scale."""

EXACT = {
    # Two unequal masses, a stiff stop at a third of the rms: 18 bins of the histogram to e⁻¹.
    "stiff": System(
        [1.0, 0.6], [1.0, 1.5], [0.2, 0.1], [0.1, 0.05], contacts=(Contact(2, "right", 200.0, 0.5),)
    ),
    "mirror": exact(),
    "bilinear": System(
        [1.0], [1.0], [0.2], [0.1], contacts=(Contact(1, "left", 30.0, 0.4, law="bilinear"),)
    ),
}


def free_energy_density(system: System) -> Any:
    """The exact density of the energy H_1 that one mass would have without its stops.

    Its displacement is √(2 H_1/k) cos φ with the uniform phase φ.
    """
    kT, k = float(system.noise_matrix[0, 0] / system.damping[0, 0]), float(system.stiffness[0])
    stops = np.array([stop.sign * stop.clearance for stop in system.stops])
    free = 1.0 / np.sqrt(2.0 * np.pi * kT / k)  # p(q = 0) without stops: the ratio of the norms
    ratio = float(exact_density(system, "q1")(0.0)) / free

    def density(H: Array) -> Array:
        p = np.exp(-H / kT) / kT * ratio / np.pi
        for k_H, size in enumerate(np.sqrt(2.0 * H / k)):
            ends = np.arccos(stops[np.abs(stops) < size] / size)
            f = partial(lambda x, a: np.exp(-system.contact_energy(0, a * np.cos(x)) / kT), a=size)
            panels = [0.0, *np.clip([*ends, *(ends + 0.05), *(ends - 0.05)], 0.0, np.pi), np.pi]
            p[k_H] *= sum(quad(f, a, b)[0] for a, b in pairwise(sorted(panels)))
        return p

    return density


def random_stops(seed: int) -> tuple[System, float]:
    """Return a system whose densities are known, and its kT: stops on one of one or two masses.

    Stiffness of the stops 1e-2 to 1e8 of the spring's at the rms displacement without them,
    clearance 0 to 3 of these rms, all laws, on one side or both.
    """
    stream = np.random.default_rng([20261126, seed])
    n = 1 + seed % 2
    mass, stiffness = (tuple(10.0 ** stream.uniform(*x, n)) for x in ((-0.5, 0.5), (-0.7, 0.7)))
    contact, kT = int(stream.integers(n)), 10.0 ** stream.uniform(-1.0, 1.0)
    spring = 1.0 / sum(1.0 / k for k in stiffness[: contact + 1])
    rms = np.sqrt(kT / spring)
    law = str(stream.choice(["hertz", "bilinear", "power"]))
    exponent = {"hertz": 1.5, "bilinear": 1.0}.get(law, float(stream.choice([1.2, 2.0, 2.5, 3.0])))
    both, alike = stream.random() < 0.5, stream.random() < 0.7
    own = {"exponent": exponent} if law == "power" else {}

    def stop(sign: float) -> tuple[float, float]:
        gap = stream.choice([0.0, stream.uniform(0.0, 0.3), stream.uniform(0.0, 3.0)])
        B = 10.0 ** stream.uniform(-2.0, 8.0) * spring * rms ** (1.0 - exponent)
        return float(B), float(gap * rms)

    sides = ("left", "right") if stream.choice([-1.0, 1.0]) < 0.0 else ("right", "left")
    numbers = [stop(1.0)]
    if both:
        numbers.append(numbers[0] if alike else stop(-1.0))
    contacts = tuple(
        Contact(contact + 1, side, *own_numbers, law=law, **own)
        for side, own_numbers in zip(sides, numbers, strict=False)
    )
    damping = 2.0 * 10.0 ** stream.uniform(-1.5, -0.3) * np.sqrt(np.multiply(mass, stiffness))
    return System(mass, stiffness, damping, kT * damping, contacts=contacts), kT


def points_at_kinks(system: System, kT: float) -> dict[str, tuple[Array, ...]]:
    """Return the points at which the densities are judged, eleven around each of their kinks."""
    row = system.stops[0].index
    i, momentum, compliance = row + 1, sqrt(system.mass[row] * kT), system.compliance[row, row]
    rms, q, levels = sqrt(kT * compliance), [], []
    for stop in system.stops:
        scale = np.where(AROUND < 0.0, rms, min(6.0 * stop.overlap_at(kT), rms))
        q.append(stop.sign * (stop.clearance + AROUND * scale))
        levels.append(0.5 * stop.clearance**2 / compliance)
    low = [e for e in sorted({*levels}) if e < 8.0 * kT] or [kT]
    H = np.concatenate([e + AROUND * kT for e in low])
    H = H[H >= 0.0]
    p = momentum * np.array([0.0, 1.0, -0.3, 0.7, -2.0, 0.0, 1.5, 0.2, -0.8, 0.0, 0.5])
    return {
        f"q{i}": (np.concatenate(q),),
        f"p{i}": (momentum * np.linspace(-2.5, 2.5, 11),),
        "H": (H,),
        **({"H1": (H,)} if system.n == 1 else {}),
        f"q{i},p{i}": (q[0], p),
    }


def add_deviations(
    seed: int, method: MonteCarlo, z: list[float], ratios: list[float], refusals: list[str]
) -> None:
    """Add z of all certified answers, L1 distance over what is stated, and refusals in words.

    Densities at ``points_at_kinks`` and every quantity at the stops of ``random_stops``.
    """
    system, kT = random_stops(seed)
    names, refused = points_at_kinks(system, kT), len(refusals)
    densities = dict(zip(names, solved(method, system, *names), strict=True))
    exact = {name: exact_density(system, name) for name in names if name != "H1"}
    if "H1" in names:
        exact["H1"] = free_energy_density(system)
    for name, points in names.items():
        density = densities[name]
        if not density.certificate.certified:
            refusals += [f"{name}: {words}" for words in density.certificate.failures]
            continue
        value, error = density.at(*points)
        assert np.all(value >= -error)
        z += ((value - exact[name](*points)) / error).tolist()
        if name in ("H", f"q{system.stops[0].index + 1}"):
            edges = density.edges[0][:: 4 if name[0] == "H" else 1]
            x, width = 0.5 * (edges[1:] + edges[:-1]), np.diff(edges)
            value = density(x)
            seen = value > 1e-6 * value.max()
            off = np.abs(value - np.where(seen, exact[name](x), value))
            ratios.append(float(off @ width) / density.l1_error)
    if len(refusals) > refused:
        return
    of_q, pair = (name for name in names if name[0] == "q")
    for stop in system.stops:
        right = contact_quantities(stop, exact[of_q])
        found = contact_quantities(stop, densities[of_q])
        z += [(x.value - right[name].value) / x.error for name, x in found.items()]
        at, mass = np.array([stop.sign * stop.clearance]), float(system.mass[stop.index])
        rates = [upcrossings(joint[pair], mass, at) for joint in (densities, exact)]
        z.append(float((rates[0][0][0] - rates[1][0][0]) / rates[0][1][0]))


@pytest.mark.parametrize("fields", [{"time": 1e5}, {"seconds": 60.0}, {"tol": 1e-4}], ids=str)
def test_the_step_follows_the_accuracy_that_a_run_will_reach(fields: dict[str, Any]) -> None:
    """It is shorter for a longer run, never longer than the contact allows."""
    ((key, value),) = fields.items()
    for name, system in EXACT.items():

        def step(factor: float, system: System = system) -> float:
            own = {key: value * (1.0 / factor**0.5 if key == "tol" else factor)}
            return default_step(MonteCarlo(threads=1, **own), system)  # type: ignore[arg-type]

        assert step(1.0) < 0.9 * chosen_step(system), name
        assert step(100.0) < 0.75 * step(1.0) and step(1e-8) == chosen_step(system)


@pytest.mark.parametrize(
    ("name", "joint"),
    [("q1", False), ("H", False), ("q1,p2", False), ("q1,q2", False), ("q2,p2", False),
     ("H1,H2", False), ("q1,p1", True), ("p1,H", True), ("q1,H2", True)],
)  # fmt: skip
def test_the_step_of_a_joint_density_is_shorter_at_a_stop(name: str, joint: bool) -> None:
    """At a stop the bias of p(q, p) is of the first order in X, that of p(q) of the order e."""
    stop = Contact(1, "right", 3.0, 0.0, law="bilinear")
    system, error = System([1.0] * 2, [1.0] * 2, [0.3] * 2, [0.3] * 2, contacts=(stop,)), 1e-4
    alone = step_for(system, error)
    dt = step_for(system, error, observables=[parse_observable(name, 2)])
    assert dt == (pytest.approx(sqrt(error / (3.0 * JOINT_BIAS * 3.0))) if joint else alone)
    assert dt <= alone


def test_the_step_follows_from_the_densities_that_rates_are_read_from() -> None:
    system, _ = random_stops(36)
    q, both = (parse_observable(name, 1) for name in ("q1", "q1,p1"))
    method = MonteCarlo(paths=4096, tol=1e-3, longest=0.2)
    alone, joint = (method.solve(system, [q], beside=beside).report for beside in ([], [both]))
    assert joint.dt < 0.9 * alone.dt  # type: ignore[union-attr]


def test_the_step_of_a_run_by_wall_time_fits_the_samples_it_leaves_time_for(tmp_path: Any) -> None:
    """With a checkpoint it does not depend on the limit."""
    system = EXACT["bilinear"]
    dt = default_step(MonteCarlo(threads=1, seconds=60.0), system)
    right = step_for(system, relative_sampling_error(samples_in(system, dt, 60.0)))
    assert dt == pytest.approx(right, rel=1e-3)
    one, other = (MonteCarlo(threads=1, seconds=s, checkpoint=tmp_path) for s in (1.0, 900.0))
    assert default_step(one, EXACT["mirror"]) == default_step(other, EXACT["mirror"])


def between(times: float) -> tuple[System, float, list[float]]:
    """One mass between stops ``times`` as stiff as twelve springs, relaxation times, energies."""
    gap = 0.35355339059327373
    system = one_mass(0.5, "both", 11.89207115002721 * times, gap)
    return system, 10.0 / times**0.3, [1e-4, 0.03, 0.5 * gap**2, 0.07, 0.2]


STIFF = System(
    [1.0] * 2, [1.0] * 2, [0.1] * 2, [0.05] * 2, contacts=(Contact(2, "left", 5e3, 0.5),)
)


@pytest.mark.parametrize(
    ("system", "relaxations", "at", "most"),
    [
        (*between(1.0), 0.1),
        slow(*between(100.0 / 12.0), 0.1),
        (*between(1000.0 / 12.0), 0.1),
        (STIFF, 60.0, [1e-4], 1.0),  # p(H) ~ H
    ],
)
def test_energies_between_stops(
    system: System, relaxations: float, at: list[float], most: float
) -> None:
    """At the energy of the stop and down to H = 0."""
    method = MonteCarlo(paths=4096, relaxations=relaxations)
    (density,), exact = solved(method, system, "H"), exact_density(system, "H")
    (value, error), right = density.at(np.array(at)), exact(np.array(at))
    assert density.certificate.certified and np.all(value > 0.0)
    assert np.all(error < most * right) and np.all(np.abs(value - right) < Z * error)
    edges = density.edges[0]
    middle = 0.5 * (edges[1:] + edges[:-1])
    middle = middle[middle < 3.0]
    off = np.abs(density(middle) - exact(middle)) @ np.diff(edges)[: middle.size]
    assert off < 3.0 * density.l1_error


@pytest.mark.parametrize(
    ("law", "B"),
    [("hertz", 1e5), slow("hertz", 1e6), slow("bilinear", 1e6)],
)
def test_impacts_of_a_stiff_stop(law: str, B: float) -> None:
    """√(kT/(2 π m)) p(q = stop) per unit of time, where p falls within 1e-3 of a clearance."""
    system = one_mass(1.0, "right", B, 0.37, law)
    rate = float(exact_density(system, "q1")(0.37)) / sqrt(2.0 * np.pi)
    (density,) = solved(MonteCarlo(paths=4096, relaxations=2.0, burn_in=2.0), system, "q1,p1")
    value, error = upcrossings(density, 1.0, np.array([0.37]))
    assert abs(value[0] - rate) < Z * error[0] < 0.3 * rate


@pytest.mark.parametrize("name", ["q1", "H", "q1,p1"])
def test_kinks_after_a_long_time(name: str) -> None:
    """After 8 relaxation times from rest a transient is the stationary density."""
    gap, system = 0.35, one_mass(0.5, "both", 1e3, 0.35)
    q, p = np.array([0.0, 0.33, 0.35, 0.36, 0.37]), np.array([0.0, 0.3, -0.5, 1.0, 0.1])
    H = np.array([1e-3, 0.05, 0.5 * gap**2, 0.065, 0.1])
    points = {"q1": (q,), "H": (H,), "q1,p1": (q, p)}[name]
    right = exact_density(system, name)(*points)
    answer = transient(system, name, "rest", [20.0], *points)
    assert answer.certificate.certified
    assert np.all(np.abs(answer.values[0] - right) < Z * answer.errors[0])
    assert np.all(answer.errors[0] < 0.2 * right)


@pytest.mark.parametrize(
    ("seeds", "fields", "least", "known"),
    [
        # Two whose stops are not stiff, one or two masses, hardly a second.
        ((0, 5), {"paths": 4096, "relaxations": 20.0}, 100, set()),
        # In these seconds a busy machine samples too little of the stiffest.
        slow(range(80), {"seconds": 4.0}, 3000, {"give it more time", "sample for longer"}),
    ],
)
def test_random_stops(seeds: Any, fields: Any, least: int, known: set[str]) -> None:
    """No certified value beyond five of its errors, |z| as large as chance makes them."""
    z, ratios, refusals = list[float](), list[float](), list[str]()
    for seed in seeds:
        add_deviations(seed, MonteCarlo(**fields), z, ratios, refusals)
    assert len(z) > least and {words.rpartition("; ")[2] for words in refusals} <= known
    assert np.max(np.abs(z)) < Z and 0.8 < np.sqrt(np.mean(np.square(z))) < 1.2
    assert np.max(ratios) < 3.0
