"""Modulated noise by simulation: the exact covariance, the order of its step, first passage."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from scipy.linalg import expm
from sim_systems import averaged, fig6, passed, transient

from averaging.nonintegrable import NonIntegrable
from cases.compare.averaged import STEP
from fpk.answer.names import REST, parse_limit
from fpk.numeric.errors import NotApplicable
from fpk.numeric.quadrature import panel_rule
from fpk.system.linear import diffusion_matrix, drift_matrix, flow_covariance
from fpk.system.modulation import Modulation
from fpk.system.system import System
from sim.questions.passing import spread_of
from sim.questions.rounds import motions, states_of
from sim.sample.ensemble import ensemble_from

ENVELOPE = Modulation([0.0, 2.0, 4.0, 9.0], [0.0, 1.5, 1.5, 0.0])
ONE = System([1.5], [2.0], [0.3], [0.03], modulation=ENVELOPE)
TIMES = np.array([1.0, 3.0, 9.0, 15.0])
PATHS = 1 << 16
TWO = fig6()
LIGHT = System([1.5], [2.0], [0.03], [0.003])
RISING = Modulation([0.0, 20.0, 40.0, 90.0], [0.0, 1.5, 1.5, 1.0])
FADING = Modulation([0.0, 20.0, 40.0, 90.0], [0.0, 1.5, 1.5, 0.0])


def modulated(system, times, factors):
    return replace(system, modulation=Modulation(times, factors))


def covariance(system, time):
    """∫ e² e^(A(t−s)) b e^(A'(t−s)) ds, the solution of dΣ/dt = AΣ + ΣA' + e² b."""
    A, b, e = drift_matrix(system), diffusion_matrix(system), system.modulation
    ends = np.linspace(0.0, time, 1 + int(np.ceil(time / 0.25)))
    nodes = np.unique(np.append(ends, e.times[e.times < time]))
    s, w = (part.ravel() for part in panel_rule(nodes, 10))
    flows = np.array([expm(A * (time - x)) for x in s])
    return np.einsum("s,sij,jk,slk->il", w * e(s) ** 2, flows, b, flows)


def by_steps(system, time, dt):
    """The covariance that steps with the mean of e² give, in NumPy."""
    P, Q = flow_covariance(drift_matrix(system), diffusion_matrix(system), dt)
    S, e = np.zeros_like(P), system.modulation
    for k in range(round(time / dt)):
        S = P @ S @ P.T + float(e.energy((k + 1) * dt) - e.energy(k * dt)) / dt * Q
    return S


def test_steps_of_modulated_noise_have_the_covariance_of_their_rule_which_is_of_second_order():
    rest = np.zeros((PATHS, 1))
    begun = partial(ensemble_from, ONE, rest, rest, seed=3, modulation=ENVELOPE)
    rows = list(motions(begun, np.hstack([rest, rest]), states_of, TIMES, 0.5))
    for time, (fine, coarse) in zip(TIMES, rows, strict=True):
        for states, dt in ((fine, 0.25), (coarse, 0.5)):
            right = by_steps(ONE, time, dt)
            spread = np.sqrt((right**2 + np.outer(np.diag(right), np.diag(right))) / PATHS)
            # Of 24 entries one is beyond 4.5 standard errors in 1 of 6000 samples.
            assert np.all(np.abs(np.cov(states.T) - right) <= 4.5 * spread)
    # Without the envelope it would not be: twice the noise of the end.
    assert by_steps(ONE, 15.0, 0.25)[0, 0] < 0.5 * by_steps(ONE, 4.0, 0.25)[0, 0]
    exact = covariance(ONE, 3.0)
    errors = [np.abs(by_steps(ONE, 3.0, 0.5 / 2**k) - exact).max() for k in range(5)]
    ratios = np.log2(np.array(errors[:-1]) / errors[1:])
    np.testing.assert_allclose(ratios, 2.0, atol=0.15)


def test_transient_densities_are_within_their_errors():
    at = np.linspace(-0.3, 0.3, 5)
    variance = np.array([[covariance(ONE, t)[0, 0]] for t in TIMES])
    exact = np.exp(-0.5 * at**2 / variance) / np.sqrt(2.0 * np.pi * variance)
    answer, steady = (
        transient(system, "q1", "rest", TIMES, at, paths=8192)
        for system in (ONE, replace(ONE, modulation=None))
    )
    # Of 20 points one is beyond 4.4 standard errors in 1 of 4600 samples.
    assert np.all(np.abs(answer.values - exact) <= 4.4 * answer.errors)
    assert np.any(np.abs(steady.values - exact) > 10.0 * steady.errors)


def test_a_constant_factor_is_that_much_more_noise():
    # The same random numbers and steps: the bridges between steps see the same noise, too.
    half = modulated(replace(TWO, noise_intensity=0.25 * TWO.noise_intensity), [0.0], [2.0])
    a, b = (passed(system, "H=0.4", times=[5.0, 10.0, 20.0]) for system in (TWO, half))
    # Factors are single precision: a trajectory or two may pass in another step.
    assert np.all(np.abs(a.survival - b.survival) <= 2.0 / 4096)
    assert a.mean.value == pytest.approx(b.mean.value, rel=1e-3)


@pytest.mark.parametrize("modulation", [RISING, FADING])
def test_the_averaged_equation_fails_as_the_elements_say(modulation):
    system = replace(LIGHT, modulation=modulation)
    asked = parse_limit("H=0.15", 1), REST, np.array([20.0, 40.0, 90.0, 150.0])
    solved = NonIntegrable("fem").passage(system, *asked, tol=1e-4)
    sampled = averaged("nonintegrable", step=0.05, paths=4096).passage(system, *asked)
    assert solved.certificate.certified and sampled.certificate.certified
    # Of six numbers one is beyond 4.2 standard errors in 1 of 6000 samples.
    assert np.all(np.abs(sampled.survival - solved.survival) <= 4.2 * sampled.survival_error)
    if modulation is RISING:
        for a, b in ((sampled.mean, solved.mean), (sampled.rate, solved.rate)):
            assert abs(a.value - b.value) <= 4.2 * a.error
    else:
        assert sampled.mean.value == np.inf and sampled.rate is None
        assert sampled.survival[2] == sampled.survival[3]


def test_the_averaged_transient_is_that_of_the_elements():
    system, at = modulated(TWO, [0.0, 5.0, 10.0, 20.0], [0.0, 0.0, 1.5, 0.0]), [0.02, 0.1, 0.3]
    asked = system, "H", "rest", [8.0, 20.0, 30.0], at
    solved = transient(*asked, method=NonIntegrable("fem"), tol=1e-5)
    sampled = transient(*asked, method=averaged("nonintegrable", step=STEP, paths=16384))
    assert solved.certificate.certified
    # Of nine points one is beyond 4.4 standard errors in 1 of 10,000 samples.
    error = np.hypot(sampled.errors, solved.errors)
    assert np.all(np.abs(sampled.values - solved.values) <= 4.4 * error)


def test_full_system_after_the_noise():
    system, times = modulated(TWO, [0.0, 2.0, 6.0], [0.0, 2.0, 0.0]), [3.0, 6.0, 30.0]
    answer = passed(system, "H=0.4", times=times)
    assert answer.certificate.certified and answer.mean.value == np.inf and answer.rate is None
    assert 0.0 < answer.survival[1] < answer.survival[0]
    assert answer.survival[1] == answer.survival[2]
    with pytest.raises(NotApplicable, match="no noise"):
        passed(modulated(TWO, [0.0], [0.0]), "H=0.4", times=times)
    # Moments are infinite though all of the sample failed.
    loud = modulated(ONE, [0.0, 3.0, 4.0], [3.0, 3.0, 0.0])
    answer = passed(loud, "H=0.01", times=[1.0], method=averaged("nonintegrable", step=0.02))
    assert answer.settings["not failed"] == 0
    assert answer.mean.value == answer.variance.value == np.inf and answer.rate is None


def test_what_comes_after_the_simulation_ended_is_not_known_while_noise_changes():
    answer = passed(modulated(TWO, [0.0, 40.0], [0.2, 2.0]), "H=0.4", times=[2.0, 60.0], time=4.0)
    assert answer.survival_error[0] < 0.1 and answer.survival_error[1] == np.inf
    assert not answer.certificate.certified


def test_a_noise_that_ends_does_not_override_the_time_or_the_cost_that_a_user_allows():
    # 2e7 units of time are 4e8 steps: the array of all their strengths would be 3 GB.
    long = modulated(TWO, [0.0, 2e7, 3e7], [1.0, 1.0, 0.0])
    for bound, most in (({"time": 2.0}, 2.0), ({"dt": 0.02, "most_steps": 3000}, 20.0)):
        answer = passed(long, "H=5", times=[1.0], **bound)
        # Trajectories go on to the end of the step in which the time ends.
        assert 1.0 <= answer.settings["followed until"] <= most + answer.settings["coarse dt"]
        assert answer.mean.value == np.inf


def test_the_spread_of_a_chunk_is_that_of_its_own_steps():
    e, dt = Modulation([0.0, 2.0, 5.0], [0.0, 1.5, 0.5]), 0.25
    right = np.diff(e.energy(dt * np.arange(7, 24)))
    np.testing.assert_allclose(spread_of(e, dt, 7, 16), right, rtol=1e-12)
    assert np.all(spread_of(None, dt, 7, 16) == dt)
