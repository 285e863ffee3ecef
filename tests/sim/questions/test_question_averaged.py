"""Averaged energies by simulation: their steps, densities, first passage and transients."""

from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pytest
from asked import assert_refused
from processes import competing
from scipy.stats import chi2, ncx2
from sim_systems import (
    CIR_MEAN,
    CIR_RATE,
    averaged,
    fig6,
    linear,
    oscillator,
    passed,
    slow,
    slow_clock,
    transient,
)

from cases.compare.averaged import AveragedSimulation
from cases.compare.compare import chance_l1, compare_densities
from cases.compare.routes import method_for
from cases.scene.scene import load_scene
from fpk.answer.names import Coordinate
from fpk.numeric.errors import InvalidInput, NotApplicable, NotCertified
from fpk.solvers.square_root import SquareRoot
from fpk.system.process import Process
from fpk.system.system import System
from sim.questions.averaged.paths import simulate_energies
from sim.questions.averaged.square_root import square_root_form, square_root_step

H1, H2, TOTAL = Coordinate("H", 0), Coordinate("H", 1), Coordinate("H")
Z = 4.5
"""|z| that chance explains: of some 40 points 3e-4."""


def form_of(theory: Any, system: System) -> Any:
    simulation = AveragedSimulation(theory)
    return simulation._form(simulation._process(system))


def coupled(strength: float, energies: int = 2) -> Process:
    """Each mode is damped by the energy of all, b diagonal: ln p = −0.8 ΣH − strength (ΣH)²."""
    ones = np.ones(energies)
    return competing(0.4 * ones, strength * np.outer(ones, ones), 0.5 * ones, (0.7,) * energies)


def test_agrees_with_the_exact_density_and_rejects_a_wrong_coefficient() -> None:
    # The band is that of chance alone at 1e-4; the step bias must stay inside it, and a coefficient
    # that is a quarter too strong must not.
    method = averaged("integrable", paths=4096)
    (sampled,) = simulate_energies(method, square_root_form(coupled(0.8)), [(H1, H2)]).densities
    joined = sampled.joined(4)
    (x, first), (y, second) = ((0.5 * (e[1:] + e[:-1]), np.diff(e)) for e in joined.edges)
    total, area = x[:, None] + y, first[:, None] * second

    def distance(strength: float) -> float:
        p = np.exp(-0.8 * total - strength * total**2)
        return float(np.sum(np.abs(joined.values - p / np.sum(p * area)) * area))

    assert distance(0.8) < chance_l1(joined)[1] < distance(1.0)
    assert sampled.certificate.mass_defect < 1e-12 and sampled.certificate.certified


def test_one_step_of_an_uncoupled_mode_is_the_noncentral_chi_square_at_any_dt() -> None:
    # The transition law of the CIR process, as scipy knows it; χ² over 20 bins of equal
    # probability, false-alarm rate 1e-4 for each mode.
    form = square_root_form(coupled(0.0))
    assert form.damping is None and square_root_form(coupled(0.1)).damping
    start, dt, count = 0.9, 3.0, 40_000
    H = square_root_step(form, np.full((count, 2), start), dt, np.random.default_rng(11))
    k = 0.25 * -np.expm1(-0.4 * dt) / 0.4
    share = ncx2(2.0, start * np.exp(-0.4 * dt) / k, scale=k).cdf(H)
    for mode in (0, 1):
        counts = np.histogram(share[:, mode], bins=20, range=(0.0, 1.0))[0]
        assert np.sum((counts - count / 20) ** 2) / (count / 20) < chi2(19).isf(1e-4)


def test_step_bias_of_the_mean_is_of_second_order() -> None:
    # E H after a fixed time from one start; halving dt twice, differences fall by four. Strong
    # damping makes them large: 8, 2 and less than 1 standard errors or more apart.
    form = square_root_form(coupled(2.0, energies=1))

    def mean(dt: float) -> tuple[float, float]:
        stream, X = np.random.default_rng(7), np.full((700_000, 1), 1.0)
        for _ in range(round(1.6 / dt)):
            X = square_root_step(form, X, dt, stream)
        return float(X.mean()), float(X.std() / np.sqrt(X.size))

    (a, e1), (b, e2), (c, e3) = mean(1.6), mean(0.8), mean(0.2)
    far, near = a - c, b - c
    assert abs(far) > 8.0 * np.hypot(e1, e3)
    # Second order: (1.6² − 0.2²)/(0.8² − 0.2²) = 4.2; first order would give 2.3.
    assert abs(near) < abs(far) / 3.0 + 4.0 * np.hypot(e2, e3)


@pytest.mark.parametrize(
    ("scene", "theory", "solver", "observables"),
    [
        ("fig8b", "integrable", "closed-form", [(H1,), (TOTAL,), (H1, H2)]),
        slow("vanderpol", "integrable", "fem", [(H1, H2)]),
        slow("vanderpol", "nonintegrable", "fem", [(TOTAL,)]),
        slow("fig6a", "nonintegrable", "fem", [(TOTAL,)]),
    ],
)
def test_as_a_method_it_agrees_with_another_solver_and_is_judged(
    scene, theory, solver, observables
) -> None:
    system = load_scene(scene).system
    results = [method_for(theory, s).solve(system, observables) for s in ("simulation", solver)]
    comparisons = compare_densities(results, averaging_is_exact=False)
    assert len(comparisons) == len(observables)
    for found in comparisons:
        assert found.measures == "sampling"
        assert found.holds and found.band is not None and found.band < 0.1


def test_what_is_not_an_energy_or_a_square_root_process_is_refused() -> None:
    system = load_scene("fig8b").system
    for theory, observable, words in (
        ("integrable", (Coordinate("q", 0),), "energies only"),
        ("integrable", (H1, TOTAL), "both must be modal"),
        ("nonintegrable", (H1,), "total energy only"),
    ):
        assert words in (AveragedSimulation(theory).refusal(system, observable) or "")
    own = coupled(0.1).coefficients

    def correlated(H):
        noise = H[:, :, None] * np.eye(2) + 0.1 * H.prod(1)[:, None, None]
        return own(H)._replace(diffusion=noise)

    def pulled(H):
        return own(H)._replace(drift=own(H).drift + H[:, ::-1])

    for changed, words in ((correlated, "correlated"), (pulled, "H1 at 0 depends on the other")):
        with pytest.raises(NotApplicable, match=words):
            square_root_form(replace(coupled(0.1), coefficients=changed))
    with pytest.raises(InvalidInput, match="paths"):
        simulate_energies(
            averaged("integrable", paths=100), square_root_form(coupled(0.1)), [(H1,)]
        )
    with pytest.raises(InvalidInput, match="step"):
        AveragedSimulation("integrable", step=0.0)


def test_the_answers_do_not_depend_on_threads() -> None:
    form, few = square_root_form(coupled(0.8)), {"paths": 256, "step": 0.8}
    alone, both = (
        simulate_energies(averaged("integrable", threads=k, **few), form, [(H1,)]).densities[0]
        for k in (1, 2)
    )
    assert np.array_equal(alone.batch_values, both.batch_values)
    asked: Any = linear(2), "H1", "noise=0.5", [1.0, 2.0], [0.1, 0.2]
    one, two, other = (
        transient(*asked, method=averaged("integrable", threads=k, seed=seed, paths=4096))
        for k, seed in ((1, 1), (2, 1), (1, 8))
    )
    assert np.array_equal(one.values, two.values) and np.array_equal(one.errors, two.errors)
    assert not np.array_equal(one.values, other.values)


def test_energies_stay_positive_at_a_coarse_step_and_are_inverted() -> None:
    stream, form = np.random.default_rng(3), square_root_form(coupled(0.8))
    H = np.full((2000, 2), 1e-12)
    for _ in range(20):
        H = square_root_step(form, H, 2.0, stream)
        assert np.all(H >= 0) and np.isfinite(H).all()
    form, H = form_of("nonintegrable", fig6()), np.array([[1e-6], [0.1], [0.4], [1.3]])
    assert form.energies(form.inverse(H)) == pytest.approx(H, rel=1e-12)


@pytest.mark.parametrize("theory", ["integrable", "nonintegrable"])
def test_failure_rate_of_the_square_root_process_is_the_exact_one(theory: Any) -> None:
    # c = 0.1, kT = 0.5, Hf = 3 kT: λ = 0.013742123052434; 4 errors, which hold the step's bias.
    method = averaged(theory, paths=4096)
    answer = passed(oscillator(0.1), "H=1.5", times=[10.0, 80.0], method=method)
    assert answer.certificate.certified
    for number, exact in ((answer.rate, 0.1 * CIR_RATE), (answer.mean, CIR_MEAN / 0.1)):
        assert abs(number.value - exact) < 4.0 * number.error < 0.2 * exact


def test_with_contact_and_from_any_start() -> None:
    level = float(fig6().hamiltonian(np.array([0.0, 0.5]), np.zeros(2)))
    rest, state, energy, noise = (
        passed(fig6(), "H=0.5", start, [1000.0], method=averaged("nonintegrable"))
        for start in ("rest", "q2=0.5", f"H={level!r}", "noise=0.2")
    )
    assert state.mean == energy.mean
    assert state.mean.value < noise.mean.value < rest.mean.value + 4.0 * rest.mean.error
    assert rest.survival[0] == 0.0 and rest.certificate.certified


def test_the_integrable_theory_knows_each_mode_and_their_sum() -> None:
    system = linear(2)
    both, one, two = (
        passed(system, limit, "H1=0.1,H2=0.2", [20.0], method=averaged("integrable", seed=seed))
        for limit, seed in (("H1=0.9,H2=1.0", 1), ("H1=0.9", 2), ("H2=1.0", 3))
    )
    product = one.survival[0] * two.survival[0]
    error = np.hypot(both.survival_error[0], np.hypot(one.survival_error[0], two.survival_error[0]))
    assert abs(both.survival[0] - product) < 4.0 * error
    # Equal decay of both modes: H is the same process in both theories, but for c_ij of the modes.
    spread, line = (
        passed(system, "H=1.2", "H=0.5", method=averaged(theory)).mean.value
        for theory in ("integrable", "nonintegrable")
    )
    assert abs(spread - line) < 0.1 * line


def test_seconds_end_it_without_bias_and_enough_of_them_change_nothing(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    # Steps are exact without contact, and of two kinds with it; as many paths at both.
    for asked in ((oscillator(0.1), "H=1.5"), (fig6(), "H=0.5")):
        short, long, whole = (
            passed(*asked, method=averaged("nonintegrable", seconds=s)) for s in (1e-9, 1e6, None)
        )
        assert float(short.settings["followed until"]) <= float(short.settings["coarse dt"])
        assert not short.certificate.certified
        assert (long.mean, long.rate) == (whole.mean, whole.rate) and long.certificate.certified
    slow_clock(monkeypatch)
    method = averaged("integrable", paths=8192, seconds=0.3)
    answer = passed(oscillator(0.1), "H=1.5", method=method)
    assert int(answer.settings["not failed"]) > 200 and answer.certificate.certified
    assert abs(answer.mean.value - CIR_MEAN / 0.1) < 4.0 * answer.mean.error


def test_the_averaged_energy_is_stepped_by_the_limit_and_the_times() -> None:
    # In closed form: dH = D dt + √(2 D H) dB, to 1e-4 of it.
    loose = System([1.0], [1e-4], [1e-4], [0.5])
    method = AveragedSimulation("nonintegrable", threads=1, paths=2048)
    answer = passed(loose, "H=0.5", times=[0.01, 1.0], method=method)
    assert answer.certificate.certified and answer.survival[0] == 1.0
    assert abs(answer.survival[1] - 0.376849) < 5.0 * answer.survival_error[1] < 0.1


def test_bad_input_is_one_line() -> None:
    for error, words, change in (
        (NotApplicable, "limits of H only", {"limit": "q2=1"}),
        (NotApplicable, "limits of H only", {"limit": "H1=1"}),
        (NotApplicable, "leave H open", {"start": "H1=0.1,H2=0.1"}),
        (InvalidInput, "beyond", {"start": "H=2"}),
        (InvalidInput, "ascend", {"times": [1.0, 1.0]}),
    ):
        asked: Any = {"system": fig6(), "limit": "H=1"} | change
        assert_refused(error, words, partial(passed, **asked, method=averaged("nonintegrable")))
    for theory, of, times, error in (
        ("integrable", "q1", [1.0], NotApplicable),
        ("nonintegrable", "H1", [1.0], NotApplicable),
        ("integrable", "H", [2.0, 1.0], InvalidInput),
        ("integrable", "H", [0.0], InvalidInput),  # one value: no density
    ):
        with pytest.raises(error):
            transient(linear(2), of, "rest", times, [0.1], method=averaged(theory))


def test_z_scores_of_the_noncentral_chi_square() -> None:
    # dH = (0.05 − 0.1 H) dt + √(0.1 H) dB from 0.4. One error is about a percent: noise 10 %
    # larger changes p by up to 10 % of it in the middle and more in the tail. Of 72 nearly normal z
    # of unit variance the rms is 1 ± 0.1; the width of the bins in the errors makes it less.
    times, at = [0.5, 5.0, 100.0], np.linspace(0.05, 1.4, 8)
    right, wrong = (
        np.array([SquareRoot(1, 0.1, noise).density(0.4, None, t, at)[0] for t in times])
        for noise in (0.05, 0.055)
    )
    z, off = [], []
    for seed in (50361, 11846, 77250):
        method = averaged("integrable", seed=seed, paths=1 << 17)
        answer = transient(oscillator(0.1), "H1", "H=0.4", times, at, method=method)
        assert answer.certificate.certified and answer.error_kind == "sampling"
        z.append((answer.values - right) / answer.errors)
        off.append(np.max(np.abs(answer.values - wrong) / answer.errors))
    assert 0.5 < np.sqrt(np.mean(np.square(z))) < 1.3 and np.max(np.abs(z)) < Z
    assert np.min(off) > Z


def test_a_pair_of_energies_and_their_sum_from_rest() -> None:
    # H1 and H2 are independent and exponential of one θ(t): their sum is a gamma density.
    system, t, rates = System([1.0, 1.0], [1.0, 2.0], [0.1, 0.1], [0.05, 0.05]), 4.0, [0.2, 0.7]
    x, y = (a.ravel() for a in np.meshgrid(rates, rates))
    method, form = averaged("integrable", paths=1 << 18), form_of("integrable", system)
    pair = transient(system, "H1,H2", "rest", [t], x, y, method=method)
    whole = transient(system, "H", "rest", [t], rates, method=method)
    theta = form.noise / form.linear * -np.expm1(-form.linear * t)
    assert theta[0] == pytest.approx(theta[1], rel=1e-9)
    for factor, near in ((1.0, True), (1.2, False)):  # of θ(t)
        a, b = factor * theta
        of_pair = np.exp(-x / a - y / b) / (a * b) - pair.values[0]
        of_sum = rates * np.exp(-np.array(rates) / a) / a**2 - whole.values[0]
        for off, error in ((of_pair, pair.errors[0]), (of_sum, whole.errors[0])):
            assert (np.max(np.abs(off) / error) < Z) == near


def test_with_contact_the_step_is_in_the_error() -> None:
    system, at, times = fig6(), np.array([0.05, 0.2, 0.5, 0.9]), [3.0, 60.0]
    louder = replace(system, noise_intensity=1.2 * system.noise_intensity)
    fem = method_for("nonintegrable", "fem")
    right, wrong = (
        transient(s, "H", "rest", times, at, method=fem, tol=1e-8).values for s in (system, louder)
    )
    method = averaged("nonintegrable", step=0.5, paths=1 << 15)
    answer = transient(system, "H", "rest", times, at, method=method)
    assert answer.settings["coarse dt"] > answer.settings["dt"]
    assert np.all(np.abs(answer.values - right) < Z * answer.errors)
    assert np.max(np.abs(answer.values - wrong) / answer.errors) > Z


def test_energies_that_overflow_are_refused_without_a_warning() -> None:
    form = square_root_form(coupled(-0.8))  # the coupling feeds the energies
    with pytest.raises(NotCertified, match="unstable; use a smaller step"):
        square_root_step(form, np.full((8, 2), 1e3), 2.0, np.random.default_rng(3))
