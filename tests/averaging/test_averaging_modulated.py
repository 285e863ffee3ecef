"""Modulated noise that ends with any strength: exact square-root processes against elements."""

from dataclasses import replace

import numpy as np
import pytest

from averaging.energy_process import energy_process
from averaging.integrable import Integrable
from averaging.nonintegrable import NonIntegrable
from fpk.answer.method import silent
from fpk.answer.names import parse_limit, parse_observable, parse_start
from fpk.numeric.errors import InvalidInput, NotApplicable
from fpk.numeric.quadrature import panel_rule
from fpk.solvers.line.time.elements import element_pair
from fpk.solvers.line.time.modulated import radau_steps
from fpk.system.contact import Contact
from fpk.system.damping import DampingTerm
from fpk.system.modulation import Modulation
from fpk.system.system import System

FREE = System([1.0, 2.0], [1.0, 3.0], [0.1, 0.3], [0.02, 0.05])
FADING = replace(FREE, modulation=Modulation([0.0, 4.0, 10.0], [0.2, 1.4, 0.0]))
TOL = 1e-6


def transient(system, times, at, name="H", start="rest", method=None, solver="fem", tol=TOL):
    method = method or NonIntegrable(solver)
    asked = parse_observable(name, system.n), parse_start(start, system), np.array(times)
    points = tuple(np.array(x) for x in (at if isinstance(at, tuple) else (at,)))
    return method.transient(system, *asked, points, tol=tol, progress=silent)


def passage(system, times, start="rest", limit="H=0.9"):
    asked = parse_limit(limit, system.n), parse_start(start, system), np.array(times)
    return NonIntegrable("fem").passage(system, *asked, tol=1e-5, progress=silent)


def drawn(seed):
    """Draw a modulation of 2 to 5 times, with pauses at the start and at the end in turn."""
    rng = np.random.default_rng(seed)
    count = int(rng.integers(2, 6))
    factor = rng.uniform(0.2, 2.0, count)
    factor[-1] *= seed % 2
    if seed % 3 == 0:
        factor = np.concatenate([[0.0, 0.0], factor])
    times = np.append(0.0, np.cumsum(rng.uniform(0.5, 6.0, factor.size - 1)))
    return Modulation(times, factor)


def spread_of(modulation, time, c=0.125, d=0.0225):
    """∫ d e² exp(−c (t − s)) ds by quadrature, which a gamma density from rest is scaled by."""
    nodes = np.unique(np.append(modulation.times[modulation.times < time], time))
    s, w = panel_rule(nodes, 30)
    return float((w * d * modulation(s) ** 2 * np.exp(-c * (time - s))).sum())


@pytest.mark.parametrize(
    ("seed", "start"),
    [
        (0, "rest"),
        (1, "noise=0.3"),
        pytest.param(2, "H=0.2", marks=pytest.mark.slow),
        pytest.param(5, "H=0.2", marks=pytest.mark.slow),
    ],
)
def test_random_modulations_by_both_solvers(seed, start):
    modulation = drawn(seed)
    system = replace(FREE, modulation=modulation)
    last = float(modulation.times[-1])
    times, at = [0.4 * last, last, last + 3.0, last + 50.0], [0.0, 1e-3, 0.05, 0.3, 0.9]
    times = [t for t in times if start != "rest" or t > modulation.quiet]
    exact, solved = (
        transient(system, times, at, start=start, solver=s) for s in ("closed-form", "fem")
    )
    assert exact.certificate.certified and solved.certificate.certified
    assert np.all(np.abs(solved.values - exact.values) <= solved.errors + exact.errors)
    if start == "rest":
        theta = np.array([[spread_of(modulation, t)] for t in times])
        gamma = np.array(at) / theta**2 * np.exp(-np.array(at) / theta)
        # Tables of the judge: the exponent counts.
        np.testing.assert_allclose(exact.values, gamma, rtol=1e-10)


@pytest.mark.parametrize("factor", [1e-6, pytest.param(1e-3, marks=pytest.mark.slow), 3.0])
def test_modulated_noise_after_much_less_or_more_noise(factor):
    # From the stationary state it stays a gamma density; no element saw a narrow one.
    at = np.array([1e-8, 1e-3, 0.02, 0.1, 0.3])
    solved = transient(FADING, [0.3], at, start=f"noise={factor}", tol=1e-9)
    assert solved.certificate.certified
    theta = spread_of(FADING.modulation, 0.3) + factor * 0.18 * np.exp(-0.125 * 0.3)
    exact = at / theta**2 * np.exp(-at / theta)
    assert np.all(np.abs(solved.values[0] - exact) <= solved.errors[0])
    assert solved.errors.max() < 1e-8 * exact.max()
    if factor < 1.0:  # more than two halvings of the steps: Radau IIA of five stages
        assert solved.settings["observed order"] == pytest.approx(9.0, abs=0.6)


def test_modulation_is_of_what_begins_only():
    names = [parse_observable("H", 2)]
    a, b = (NonIntegrable().solve(s, names).densities[0] for s in (FREE, FADING))
    assert a(0.3) == b(0.3)
    with pytest.raises(NotApplicable, match="modulated"):
        NonIntegrable("closed-form").passage(
            FADING, parse_limit("H=1", 2), parse_start("rest", FADING), np.ones(1),
            tol=None, progress=silent,
        )  # fmt: skip


def test_free_decay_shrinks_what_there_was():
    # Damping c of all energies: p(H, t) = e^(ct) p(e^(ct) H, 0).
    grown, at = np.exp(0.125 * 20.0), np.array([0.001, 0.01, 0.03])
    end = transient(FADING, [10.0], at * grown)
    late = transient(FADING, [30.0], at)
    bound = late.errors + grown * end.errors
    assert np.all(np.abs(late.values - grown * end.values) <= bound)
    assert late.certificate.certified and np.all(bound < 1e-4 * late.values)


def test_states_by_elements_are_the_exact_gaussian_from_rest():
    # From rest each coordinate is Gaussian: θ(t) times its variance at temperature one.
    at = np.array([0.0, 0.3, 0.8])
    theta = np.array([[spread_of(FADING.modulation, t)] for t in (5.0, 10.0)])
    for name, unit in (("q1", FREE.compliance[0, 0]), ("p2", 2.0)):
        solved = transient(FADING, [5.0, 10.0], at, name)
        variance = theta * unit
        exact = np.exp(-0.5 * at**2 / variance) / np.sqrt(2.0 * np.pi * variance)
        assert solved.certificate.certified
        assert np.all(np.abs(solved.values - exact) <= solved.errors)
        assert np.max(solved.errors) < 1e-3


def test_modal_energies_and_states_in_closed_form():
    system = FADING
    modes = Integrable("closed-form")
    at = np.array([0.0, 0.1, 0.4])
    joint = transient(system, [6.0, 30.0], (at, at), "H1,H2", method=modes)
    each = [transient(system, [6.0, 30.0], at, f"H{i}", method=modes) for i in (1, 2)]
    np.testing.assert_allclose(joint.values, each[0].values * each[1].values, rtol=1e-12)
    state = transient(system, [6.0], at, "q1", method=modes)
    assert joint.certificate.certified and state.certificate.certified
    for method in (modes, Integrable("fem")):
        with pytest.raises(NotApplicable, match="modulated"):
            method.passage(
                system, parse_limit("H1=1", 2), parse_start("rest", system), np.ones(1),
                tol=None, progress=silent,
            )  # fmt: skip


@pytest.mark.parametrize("start", ["rest", "noise=0.5"])
def test_constant_modulation_is_constant_noise(start):
    times = [5.0, 20.0, 50.0]
    steady = passage(FREE, times, start)
    held = passage(replace(FREE, modulation=Modulation([0.0, 1.0], [1.0, 1.0])), times, start)
    for a, b in (
        (held.mean, steady.mean),
        (held.variance, steady.variance),
        (held.rate, steady.rate),
    ):
        assert abs(a.value - b.value) <= a.error + b.error
    assert np.all(
        np.abs(held.survival - steady.survival) <= held.survival_error + steady.survival_error
    )
    assert held.certificate.certified and held.survival_error.max() < 1e-5


def test_what_has_failed_at_the_start_has_an_error_of_its_own():
    # A gamma density of two masses beyond the limit: e^(−x)(1 + x), x = H/θ, θ = 0.3 d/c.
    x = 0.9 / (0.3 * 0.0225 / 0.125)
    answer = passage(FADING, [0.0, 5.0], "noise=0.3")
    off = abs(answer.survival[0] - (1.0 - np.exp(-x) * (1.0 + x)))
    # The digits of d and c as they are written here are those of 1 of the survival.
    assert off <= answer.survival_error[0] + 1e-15
    assert answer.survival_error[0] < 1e-12


@pytest.mark.parametrize("name", ["H", "q1"])
def test_the_tolerance_that_is_asked_for_is_the_one_that_judges(name, monkeypatch):
    # Steps halved once: their error is above 1e-10, and nothing may loosen that.
    monkeypatch.setattr("fpk.solvers.line.time.modulated.STEP_HALVINGS", (0, 1))
    answer = transient(FADING, [5.0], [0.1], name, tol=1e-10)
    assert answer.settings["tol"] == 1e-10 and answer.certificate.missed > 1e-10


def test_steps_of_nothing_have_no_residual_and_one_that_is_no_number_stays(recwarn):
    process = energy_process(FREE)
    e, _ = element_pair(process, np.linspace(0.0, 4.0 * process.energy_scale, 9), 6)
    always, times = Modulation([0.0], [1.0]), np.array([1.0])
    nothing = np.zeros(e.load.shape)
    evolved, _, _, mass = radau_steps(e, nothing, always, 1.0, times, level=0)
    assert evolved.residual == 0.0 and not evolved.values.any() and not recwarn.list
    assert not mass.any()
    nothing[2, 1] = np.nan
    assert np.isnan(radau_steps(e, nothing, always, 1.0, times, level=0)[0].residual)


def test_after_the_noise_none_fails():
    answer = passage(FADING, [0.0, 5.0, 10.0, 100.0])
    assert answer.certificate.certified
    assert answer.survival[0] == 1.0 and 0.0 < answer.survival[2] < answer.survival[1]
    assert answer.survival[2] == answer.survival[3]
    assert answer.mean.value == np.inf and answer.rate is None
    # The same and noise again: the reliability until then is the same.
    again = Modulation([0.0, 4.0, 10.0, 12.0, 14.0], [0.2, 1.4, 0.0, 0.0, 1.0])
    other = passage(replace(FREE, modulation=again), [5.0, 10.0])
    bound = other.survival_error + answer.survival_error[1:3]
    assert np.all(np.abs(other.survival - answer.survival[1:3]) <= bound)
    assert np.isfinite(other.mean.value) and other.rate is not None


def test_a_pause_before_the_noise_only_shifts_what_begins_at_rest():
    at_once, later = (
        Modulation(t, e) for t, e in (([0.0, 4.0], [0.0, 1.0]), ([0.0, 3.0, 7.0], [0.0, 0.0, 1.0]))
    )
    a = passage(replace(FREE, modulation=at_once), [5.0, 20.0])
    b = passage(replace(FREE, modulation=later), [2.0, 8.0, 23.0])
    assert b.survival[0] == 1.0
    np.testing.assert_allclose(b.survival[1:], a.survival, rtol=1e-14)
    assert b.mean.value - a.mean.value == pytest.approx(3.0, abs=2.0 * a.mean.error)
    assert b.variance.value == pytest.approx(a.variance.value, rel=1e-12)


QUIET = replace(FREE, modulation=Modulation([0.0, 3.0, 4.0], [0.0, 0.0, 1.0]))
SILENT = replace(FREE, modulation=Modulation([0.0], [0.0]))
FED = System(
    [1.0], [1.0], [-0.1], [0.02], damping_terms=(DampingTerm(1, 1, 0.2, q=((1, 2),)),),
    modulation=Modulation([0.0, 10.0], [1.0, 0.0]),
)  # fmt: skip
TOUCHING = replace(FADING, contacts=(Contact(2, "both", 10.0, 0.5),))


@pytest.mark.parametrize(
    ("ask", "error", "words"),
    [
        (
            lambda: transient(QUIET, [5.0], [0.1], start="H=0.2"),
            InvalidInput,
            "decays without noise",
        ),
        (lambda: transient(QUIET, [2.0], [0.1]), InvalidInput, "no noise has acted"),
        (
            lambda: transient(QUIET, [2.0], [0.1], solver="closed-form"),
            InvalidInput,
            "no noise has",
        ),
        (lambda: passage(QUIET, [5.0], "H=0.2"), InvalidInput, "decays without noise"),
        (lambda: passage(SILENT, [5.0]), NotApplicable, "no noise at any time"),
        (
            lambda: transient(FADING, [20.0], [0.1], "q1"),
            NotApplicable,
            "after the end of the noise",
        ),
        (lambda: transient(FED, [12.0], [0.1]), NotApplicable, "feeds energy in"),
        (lambda: passage(FED, [12.0], limit="H=0.05"), NotApplicable, "feeds energy in"),
    ],
)
def test_what_is_refused(ask, error, words):
    with pytest.raises(error, match=words) as caught:
        ask()
    assert "\n" not in str(caught.value)


@pytest.mark.slow
def test_with_contact_it_decays_and_fails_less():
    at = [0.05, 0.2]
    answer = transient(TOUCHING, [8.0, 40.0], at)
    assert answer.certificate.certified and answer.values[1, 1] < 1e-3 * answer.values[0, 1]
    held = passage(TOUCHING, [40.0]), passage(replace(TOUCHING, modulation=None), [40.0])
    assert held[0].certificate.certified and held[0].survival[0] > held[1].survival[0]
