"""Transient densities of averaged energies by simulation, against exact ones."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from sim_systems import fig6, linear
from test_sim_passage import oscillator

from cases.compare.averaged import AveragedSimulation
from cases.compare.routes import method_for
from fpk.answer.dynamics import Transient
from fpk.answer.method import silent
from fpk.answer.names import parse_observable, parse_start
from fpk.numeric.errors import InvalidInput, NotApplicable
from fpk.solvers.square_root import SquareRoot
from fpk.system.system import System

Z = 4.5
"""|z| that chance explains: of some 40 points 3e-4."""

SEEDS = (50361, 11846, 77250)


def sampled(
    theory: Any, system: System, of: str, start: str, times: Any, *at: Any, **settings: Any
) -> Transient:
    return AveragedSimulation(theory, **({"threads": 1, "paths": 4096} | settings)).transient(
        system,
        parse_observable(of, system.n),
        parse_start(start, system),
        np.array(times, dtype=float),
        tuple(np.asarray(x, dtype=float) for x in at),
        tol=None,
        progress=silent,
    )


@pytest.mark.parametrize(("theory", "of"), [("integrable", "H1"), ("nonintegrable", "H")])
def test_z_scores_of_the_noncentral_chi_square(theory: Any, of: str) -> None:
    # dH = (0.05 − 0.1 H) dt + √(0.1 H) dB from 0.4. One error is about a percent: noise 10 %
    # larger changes p by up to 10 % of it in the middle and more in the tail. Of 72 nearly normal z
    # of unit variance the rms is 1 ± 0.1; the width of the bins in the errors makes it less.
    times, at = [0.5, 5.0, 100.0], np.linspace(0.05, 1.4, 8)
    right, wrong = (
        np.array([SquareRoot(1, 0.1, noise).density(0.4, None, t, at)[0] for t in times])
        for noise in (0.05, 0.055)
    )
    z, off = [], []
    for seed in SEEDS:
        system = oscillator(0.1)
        answer = sampled(theory, system, of, "H=0.4", times, at, seed=seed, paths=1 << 17)
        assert answer.certificate.certified and answer.error_kind == "sampling"
        z.append((answer.values - right) / answer.errors)
        off.append(np.max(np.abs(answer.values - wrong) / answer.errors))
    assert 0.5 < np.sqrt(np.mean(np.square(z))) < 1.3 and np.max(np.abs(z)) < Z
    assert np.min(off) > Z


def test_a_pair_of_energies_and_their_sum_from_rest() -> None:
    # H1 and H2 are independent and exponential of one θ(t): their sum is a gamma density.
    system, t = System([1.0, 1.0], [1.0, 2.0], [0.1, 0.1], [0.05, 0.05]), 4.0
    rates = np.array([0.2, 0.7])
    x, y = (a.ravel() for a in np.meshgrid(rates, rates))
    pair = sampled("integrable", system, "H1,H2", "rest", [t], x, y, paths=1 << 18)
    form = AveragedSimulation("integrable")._form(AveragedSimulation("integrable")._process(system))
    theta = form.noise / form.linear * -np.expm1(-form.linear * t)
    assert theta[0] == pytest.approx(theta[1], rel=1e-9)
    answer = sampled("integrable", system, "H", "rest", [t], rates, paths=1 << 18)

    def largest(factor: float) -> Any:
        """The largest |z| of the pair and of the sum if θ(t) were so many times what it is."""
        a, b = factor * theta
        of_pair = np.exp(-x / a - y / b) / (a * b) - pair.values[0]
        of_sum = rates * np.exp(-rates / a) / a**2 - answer.values[0]
        return [np.max(np.abs(of_pair) / pair.errors[0]), np.max(np.abs(of_sum) / answer.errors[0])]

    assert max(largest(1.0)) < Z < min(largest(1.2))


def test_with_contact_the_step_is_in_the_error() -> None:
    system, at, times = fig6(), np.array([0.05, 0.2, 0.5, 0.9]), [3.0, 60.0]
    asked = parse_observable("H", 2), parse_start("rest", system), np.array(times), (at,)
    louder = replace(system, noise_intensity=1.2 * system.noise_intensity)
    right, wrong = (
        method_for("nonintegrable", "fem")
        .transient(s, *asked, tol=1e-8, progress=silent)  # type: ignore[attr-defined]
        .values
        for s in (system, louder)
    )
    for step in (0.1, 0.5):
        answer = sampled("nonintegrable", system, "H", "rest", times, at, step=step, paths=1 << 15)
        assert answer.settings["coarse dt"] > answer.settings["dt"]
        assert np.all(np.abs(answer.values - right) < Z * answer.errors)
        assert np.max(np.abs(answer.values - wrong) / answer.errors) > Z


def test_an_answer_depends_on_the_seed_alone() -> None:
    asked: Any = "integrable", linear(2), "H1", "noise=0.5", [1.0, 2.0], [0.1, 0.2]
    one, two = (sampled(*asked, threads=threads) for threads in (1, 2))
    assert np.array_equal(one.values, two.values) and np.array_equal(one.errors, two.errors)
    assert not np.array_equal(one.values, sampled(*asked, seed=8).values)


@pytest.mark.parametrize(
    ("theory", "of", "start", "times", "error"),
    [
        ("integrable", "q1", "rest", [1.0], NotApplicable),
        ("nonintegrable", "H1", "rest", [1.0], NotApplicable),
        ("integrable", "H", "rest", [2.0, 1.0], InvalidInput),
        ("integrable", "H", "rest", [0.0], InvalidInput),  # one value: no density
    ],
)
def test_what_has_no_density_is_refused(
    theory: Any, of: str, start: str, times: Any, error: Any
) -> None:
    with pytest.raises(error):
        sampled(theory, linear(2), of, start, times, [0.1])
