"""Values at points against exact densities, by default settings: z in the bulk, at stops, in tails.

``SECONDS_OF_POINTWISE`` and ``SEEDS_OF_POINTWISE`` in the environment: 60 and 10 are what the claim
is of, half an hour.
"""

import os
from math import sqrt
from typing import Any

import numpy as np
import pytest
from random_stops import exact_density, random_stops

from averaging.theory import Exact
from fpk.answer.density import Density
from fpk.answer.dynamics import upcrossings
from fpk.answer.names import parse_observable
from fpk.numeric.arrays import Array
from fpk.system.contact import Contact
from fpk.system.system import System
from sim.montecarlo import MonteCarlo
from sim.sample.settings import default_step
from sim.step.step_size import JOINT_BIAS, chosen_step, expected_error, samples_in, step_for

SECONDS = float(os.environ.get("SECONDS_OF_POINTWISE", "6"))
SEEDS = int(os.environ.get("SEEDS_OF_POINTWISE", "4"))

EXACT = {
    # Two unequal masses, a stiff stop at a third of the rms: 18 bins of the histogram to e⁻¹.
    "stiff": System(
        [1.0, 0.6], [1.0, 1.5], [0.2, 0.1], [0.1, 0.05], contacts=(Contact(2, "right", 200.0, 0.5),)
    ),
    "mirror": System(
        [1.0, 1.0], [1.0, 1.0], [0.2, 0.4], [0.1, 0.2], contacts=(Contact(2, "both", 10.0, 0.5),)
    ),
    "bilinear": System(
        [1.0], [1.0], [0.2], [0.1], contacts=(Contact(1, "left", 30.0, 0.4, law="bilinear"),)
    ),
}


def points_of(system: System, exact: Density) -> Array:
    """Points in the bulk, five at the stop, and six from there to 1e-6 of the maximum."""
    stop = system.stops[0]
    q = np.linspace(0.0, 3.0, 3001)
    p = exact(stop.sign * (stop.clearance + q))
    least = 1e-6 * float(exact(np.linspace(-2.0, 2.0, 401)).max())
    last = q[p > least][-1]
    bulk, at_stop = np.linspace(-2.5, -0.3, 8), np.linspace(-0.05, 0.05, 5)
    tail = last * np.linspace(0.2, 1.0, 6)
    x = stop.sign * (stop.clearance + np.concatenate([bulk, at_stop, tail]))
    return np.asarray(x[exact(x) > 0.99 * least])


def z_scores(system: System, *, seconds: float, seed: int) -> Array:
    observable = [parse_observable(f"q{system.n}", system.n)]
    (exact,) = Exact().solve(system, observable).densities
    assert isinstance(exact, Density)
    x = points_of(system, exact)
    (sampled,) = (
        MonteCarlo(seconds=seconds, threads=1, seed=seed).solve(system, observable).densities
    )
    value, error = sampled.at(x)
    return np.asarray((value - exact(x)) / error)


@pytest.mark.slow
@pytest.mark.parametrize("name", EXACT)
def test_stated_errors_at_points_are_the_real_ones(name: str) -> None:
    """Mean square z between 0.8 and 1.25 of ten seeds (0.6 and 1.5 of fewer); no bias of a point.

    Points of a run are correlated, and rare ones state one visit more.
    """
    z = np.array([z_scores(EXACT[name], seconds=SECONDS, seed=7001 + k) for k in range(SEEDS)])
    low, high = (0.8, 1.25) if SEEDS >= 10 else (0.6, 1.5)
    assert low < np.mean(z**2) < high
    assert np.abs(z.mean(axis=0)).max() * sqrt(SEEDS) < 4.0


@pytest.mark.parametrize("fields", [{"time": 1e5}, {"seconds": 60.0}, {"tol": 1e-4}], ids=str)
def test_the_step_follows_the_accuracy_that_a_run_will_reach(fields: dict[str, Any]) -> None:
    """It is shorter for a longer run, never longer than the contact allows."""
    for name, system in EXACT.items():
        short, long = chosen_step(system), default_step(MonteCarlo(threads=1, **fields), system)
        assert long < 0.9 * short, name
        key, value = next(iter(fields.items()))
        longer = {key: value * (0.1 if key == "tol" else 100.0)}
        shorter = {key: value * (1e4 if key == "tol" else 1e-5)}
        assert default_step(MonteCarlo(threads=1, **longer), system) < 0.75 * long
        assert default_step(MonteCarlo(threads=1, **shorter), system) == short


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
    system = random_stops(36)[1]
    q, both = (parse_observable(name, 1) for name in ("q1", "q1,p1"))
    method = MonteCarlo(paths=4096, tol=1e-3, longest=0.2)
    steps = [
        method.solve(system, [q], beside=beside).report.dt  # type: ignore[union-attr]
        for beside in ([], [both])
    ]
    assert steps[1] < 0.9 * steps[0]


@pytest.mark.slow
def test_rates_at_a_soft_stop() -> None:
    """At the step that p(q) alone allows they were four of their errors off in the mean."""
    exact, system = random_stops(36)
    at, z = np.array([exact.stops[0][1]]), []
    q, both = (parse_observable(name, 1) for name in ("q1", "q1,p1"))
    for seed in range(8):
        result = MonteCarlo(seconds=5.0, seed=seed).solve(system, [q], beside=[both])
        (density,) = result.beside
        value, error = upcrossings(density, exact.mass[0], at)  # type: ignore[arg-type]
        z.append(float((value - exact.upcrossings(at[0]))[0] / error[0]))
    assert np.max(np.abs(z)) < 5.0 and abs(np.mean(z)) < 5.0 / sqrt(8.0), z


@pytest.mark.slow
def test_a_joint_density_at_a_soft_stop() -> None:
    """One mass, p where the error of a step as long as p(q) allows was 2.2e-3 of it, 4 errors."""
    exact, system = random_stops(36)
    at = (np.array([0.1233439468]), np.array([1.6557215]))
    z = []
    for seed in range(8):
        method = MonteCarlo(seconds=5.0, seed=seed)
        (density,) = method.solve(system, [parse_observable("q1,p1", 1)]).densities
        value, error = density.at(*at)
        z.append(float((value - exact_density(exact, "q1,p1", *at))[0] / error[0]))
    assert np.max(np.abs(z)) < 5.0 and abs(np.mean(z)) < 5.0 / sqrt(8.0)


def test_the_step_of_a_run_by_wall_time_fits_the_samples_it_leaves_time_for() -> None:
    system = EXACT["bilinear"]
    dt = default_step(MonteCarlo(threads=1, seconds=60.0), system)
    assert dt == pytest.approx(
        step_for(system, expected_error(samples_in(system, dt, 60.0))), rel=1e-3
    )


def test_the_step_of_a_checkpoint_does_not_depend_on_the_limit(tmp_path: Any) -> None:
    method = {"threads": 1, "checkpoint": tmp_path}
    steps = {default_step(MonteCarlo(seconds=s, **method), EXACT["mirror"]) for s in (1.0, 900.0)}
    assert len(steps) == 1
