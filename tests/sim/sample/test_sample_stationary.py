"""The method: against exact densities, identities, refusals, limits of time. Seeds drawn once."""

from dataclasses import replace
from math import inf, sqrt
from typing import Any

import numpy as np
import pytest
from scipy.linalg import solve_continuous_lyapunov
from sim_systems import curve, exact, exact_density, exact_square, fig6, linear, mixed

from fpk.answer.names import parse_observable
from fpk.answer.sampled_density import SampledDensity
from fpk.numeric.errors import InvalidInput, NotApplicable
from fpk.system.contact import Contact
from fpk.system.linear import diffusion_matrix, drift_matrix, natural_modes
from fpk.system.system import System
from sim.montecarlo import MonteCarlo
from sim.sample.plan import Setup, observation_arrays
from sim.sample.simulation import simulate
from sim.sample.workers import workers_of
from sim.step.schemes import SCHEMES
from sim.step.step_size import chosen_step, contact_frequency, relaxation_time

Q2 = (parse_observable("q2", 2),)


def test_moments_and_density_of_the_exact_system_and_not_of_another_clearance() -> None:
    result: Any = MonteCarlo(paths=8192, time=600.0, seed=20406).solve(exact(), Q2)
    (density,), moments = result.densities, result.report.moments
    known = ("q2²", exact_square(), 4e-4), ("v1²", 0.5, 2e-3), ("v2²", 0.5, 2e-3)
    for name, right, most in known:
        assert abs(moments[name].value - right) < 4.0 * moments[name].error < 4.0 * most
    assert all(abs(identity.z) < 4.0 for identity in result.identities)
    assert isinstance(density, SampledDensity)
    assert density.certificate.certified and density.certificate.tail_mass < 1e-6
    np.testing.assert_allclose(density.batch_values, density.batch_values[:, ::-1], rtol=1e-12)
    # Points at no particular place in their bins. Smoothing makes z dependent over eleven bins, so
    # that 200 points are some 40 independent ones: rms 1 ± 0.11, and 1.6 is beyond five of these.
    x = np.linspace(-1.0, 1.0, 200) + 0.00123
    value, error = density.at(x)
    for clearance, near in ((0.5, True), (0.55, False)):
        p = exact_density(exact(clearance=clearance), "q2")(x)
        assert (np.sqrt(np.mean(((value - p) / error) ** 2)) < 1.6) == near


def small(**fields: object) -> MonteCarlo:
    return MonteCarlo(**{"paths": 4096, "time": 150.0, "seed": 733, **fields})  # type: ignore[arg-type]


def test_other_systems_keep_their_identities() -> None:
    names = ["q1", "p3", "H", "q3,p3"]
    result = small().solve(mixed(), [parse_observable(name, 3) for name in names])
    assert len(result.identities) == 7
    assert all(identity.error > 0 and abs(identity.z) < 4.5 for identity in result.identities)
    for density in result.densities:
        assert density.certificate.certified, density.certificate
        assert density.certificate.mass_defect < 1e-12


def test_modal_energies_of_a_linear_system_against_its_gaussian() -> None:
    # E H_m of the Lyapunov covariance; 4.5 standard errors.
    system = linear(3)
    asked = [parse_observable(name, 3) for name in ("H1", "H3", "H1,H2")]
    *single, joint = MonteCarlo(paths=8192, time=400.0, seed=77).solve(system, asked).densities
    shapes, omega = natural_modes(system)
    cov = solve_continuous_lyapunov(drift_matrix(system), -diffusion_matrix(system))
    for density, m in zip(single, (0, 2), strict=True):
        a, b = system.mass * shapes[:, m] * omega[m], shapes[:, m]
        right = 0.5 * (a @ cov[:3, :3] @ a + b @ cov[3:, 3:] @ b)
        e = density.edges[0]
        assert e[0] == 0.0 and density.certificate.certified
        means = density.batch_values @ (0.5 * (e[1:] + e[:-1]) * np.diff(e))
        assert abs(means.mean() - right) < 4.5 * means.std(ddof=1) / np.sqrt(means.size)
    # The same samples in coarser bins: a bin's midpoint stands for its samples, error h²/12 p'.
    assert joint.values.shape == (128, 128)
    centres, widths = zip(*((0.5 * (e[1:] + e[:-1]), np.diff(e)) for e in joint.edges), strict=True)
    mean = (joint.values @ widths[1]) @ (centres[0] * widths[0])
    assert mean == pytest.approx(single[0].moment(1).value, rel=0.01)


def test_damping_term_of_the_observed_momentum(monkeypatch: pytest.MonkeyPatch) -> None:
    """The kinetic balance of the mass in contact holds with (h²/12) c_ik g_k/m_k only."""
    contacts = (Contact(2, "both", 10.0, 0.5),)
    system = System([1.0, 1.0], [1.0, 1.0], [0.8, 0.8], [0.4, 0.4], contacts=contacts)
    method = small(paths=8192, dt=0.2, time=400.0)
    assert abs(method.solve(system, Q2).identities[-1].z) < 4.0

    def without(*arguments: Any, **settings: Any) -> Any:
        key, arrays = observation_arrays(*arguments, **settings)
        return key, arrays._replace(cross=0.0 * arrays.cross)

    monkeypatch.setattr("sim.sample.ensemble.observation_arrays", without)
    assert abs(method.solve(system, Q2).identities[-1].z) > 7.0


def test_euler_is_biased_and_the_reported_mean_is_that_of_the_histogram() -> None:
    """Euler at 0.02 is off by 8 %, and so is the mean that is reported.

    A sample lies within w/2 of the middle m of its bin: ``|q² − m²| <= w |q| + w²/4``, and the
    moment of the density has w²/12 more.
    """
    result = small(scheme="euler_maruyama", dt=0.02, seed=5).solve(exact(), Q2)
    moments, (density,) = result.report.moments, result.densities  # type: ignore[attr-defined]
    assert moments["v2²"].value - 0.5 > 8.0 * moments["v2²"].error
    assert any("standard errors" in f for f in density.certificate.failures)
    square, w = moments["q2²"], float(np.diff(density.edges[0])[0])
    tail = density.certificate.tail_mass * (3.0 * float(density.edges[0][-1])) ** 2
    assert abs(square.value - density.moment(2).value) < w * sqrt(square.value) + w**2 / 3.0 + tail
    assert square.value / exact_square() - 1.0 > 5.0 * square.error


def test_refusals() -> None:
    silent, undamped = (System([1.0], [1.0], [c], [D]) for c, D in ((0.1, 0.0), (0.0, 0.1)))
    q1 = parse_observable("q1", 1)
    assert "no noise" in (MonteCarlo().refusal(silent, q1) or "")
    assert "not damped" in (MonteCarlo().refusal(undamped, q1) or "")
    assert MonteCarlo().refusal(fig6(), Q2[0]) is None
    with pytest.raises(NotApplicable, match="no noise"):
        MonteCarlo().solve(silent, [q1])
    with pytest.raises(InvalidInput, match="more random numbers"):
        small(dt=1e-300).solve(fig6(), Q2)


def test_step_choice_and_its_limit() -> None:
    # By hand: kT = 0.03/0.12 = ¼; at 5 kT of ¼ q² + 4 (q − ½)^2.5 the mass is at q = 1.0664, where
    # the stop is as stiff as 15 √0.5664 = 11.29 and the springs as K_22 = 1: ω = 3.51 with m = 1.
    assert pytest.approx(1.25, rel=1e-3) == 0.25 * 1.0664**2 + 4.0 * 0.5664**2.5
    assert chosen_step(fig6()) == pytest.approx(0.45 / sqrt(11.29 + 1.0), rel=1e-3)
    limit = 2.0 / contact_frequency(fig6())
    for name in sorted(SCHEMES):
        with pytest.raises(InvalidInput, match="stability limit"):
            small(scheme=name, dt=1.01 * limit).solve(fig6(), Q2)


def test_fields_are_checked() -> None:
    for key, value in (
        ("scheme", "rk4"), ("paths", 10), ("seed", -1), ("seed", 2**64), ("threads", 0),
        ("threads", 100_000), ("relaxations", 0.0), ("most_steps", 0), ("time", 0.0),
        ("seconds", 0.0), ("dt", inf), ("tol", -1.0), ("burn_in", float("nan")),
    ):  # fmt: skip
        with pytest.raises(InvalidInput, match=key):
            small(**{key: value})


def test_target_error_is_met_or_the_certificate_says_so_for_any_number_of_threads() -> None:
    calls: list[tuple[int, int, str]] = []
    one, two = (
        small(tol=0.02, time=60.0, threads=k).solve(
            exact(), Q2, progress=lambda *c: calls.append(c)
        )
        for k in (1, 2)
    )
    assert list(dict.fromkeys(what for *_, what in calls)) == ["burn-in", "simulation"]
    assert all(d <= t for d, t, _ in calls)
    a, b = one.densities[0], two.densities[0]
    np.testing.assert_array_equal(a.batch_values, b.batch_values)
    for part in ("diagnosis", "moments"):
        assert getattr(one.report, part) == getattr(two.report, part)
    assert a.certificate.certified and a.l1_error == b.l1_error <= 0.02
    missed = small(tol=1e-9, longest=0.01, time=40.0).solve(exact(), Q2)
    assert any("exceeds the tolerance" in f for f in missed.densities[0].certificate.failures)
    timed = small(time=60.0, seconds=0.05).solve(exact(), Q2)
    assert not any("tolerance" in f for f in timed.densities[0].certificate.failures)
    assert small(tol=0.1).refined().tol == 0.05


def test_pair_of_steps_sees_euler_and_not_the_exact_flow() -> None:
    euler = small(seed=9, step_pair=True, scheme="euler_maruyama", dt=0.02).solve(exact(), Q2)
    bias = euler.report.step_biases["q2"]  # type: ignore[attr-defined]
    assert bias.value > 2.5 * bias.error
    report: Any = small(seed=9, step_pair=True).solve(exact(), Q2).report
    assert report.step_biases["q2"].value < 2.0 * report.step_biases["q2"].error
    for name in report.moments:
        assert abs(report.step_biases[name].value) < 4.5 * report.step_biases[name].error
    assert report.step_pair == report.settings(())["step bias"] == "dt against dt/2"


def test_the_settings_of_a_result_are_those_of_its_frozen_report() -> None:
    result = MonteCarlo(paths=4096, time=40.0, seed=3).solve(fig6(), Q2)
    report: Any = result.report
    (density,) = result.densities
    settings = report.settings([density])
    assert dict(result.settings) == settings == dict(density.provenance)
    assert settings["sampling error of q2"] == density.l1_error
    assert settings["E q2²"] == report.moments["q2²"].value
    assert report.step_pair == settings["step bias"] == "not measured" and not report.step_biases
    assert not report.interrupted and not result.partial and report.limited_by == ""
    assert relaxation_time(fig6()) == report.relaxation_time


@pytest.mark.slow
def test_weak_order_of_the_displacement_in_the_step() -> None:
    """At large steps, where the bias of the plain mean stands above the sampling error.

    The error of the order is that of the two biases; the stability limit is 0.55, and higher orders
    add to the fourth.
    """
    steps, biases, errors = (0.32, 0.42), [], []
    scheme = SCHEMES["exact_flow"]
    for dt in steps:
        setup = Setup(MonteCarlo(paths=65536, seed=97), exact(), (), scheme, dt=dt, time=6000.0)
        with workers_of(None, 2) as workers:
            square = simulate(setup, workers=workers).report.moments["q2²"]
        biases.append(square.value / exact_square() - 1.0)
        errors.append(square.error / abs(square.value - exact_square()))
    wide = np.log(steps[1] / steps[0])
    order, error = np.log(biases[1] / biases[0]) / wide, np.hypot(*errors) / wide
    assert error < 0.35 and order > scheme.weak_order - 0.5


SHORT = MonteCarlo(paths=4096, threads=1, seconds=0.5)


def stiff() -> System:
    """The burn-in takes 4e6 steps, tens of seconds."""
    return System([1.0], [1.0], [0.1], [0.05], contacts=(Contact(1, "both", 1e8, 0.0),))


@pytest.mark.parametrize(
    ("system", "fields", "words"),
    [
        (fig6(), {"dt": 1e-6, "step_pair": True}, "of the burn-in"),
        # A chunk that takes 1e5 times the limit; a first sample that is far from stationary.
        (fig6(), {"time": 1e9, "burn_in": 0.01, "seconds": 1.0}, "in its first chunk, before any"),
        (stiff(), {"burn_in": 1e-4, "seconds": 1e-9}, "after all of the burn-in; give it more"),
    ],
)
def test_the_limit_holds_for_the_burn_in_and_the_first_chunk(
    system: System, fields: Any, words: str
) -> None:
    result: Any = replace(SHORT, **fields).solve(system, [parse_observable("q1", system.n)])
    (density,), report = result.densities, result.report
    assert report.diagnosis is None and not result.partial
    (failure,) = density.certificate.failures  # and no step is blamed
    assert failure.startswith("the limit of") and words in failure
    assert words != "of the burn-in" or report.burn_in < 10.0 * report.relaxation_time
    assert np.all(np.isfinite(density(np.linspace(-0.5, 0.5, 5))))


def test_the_limit_holds_for_the_second_simulation_of_a_pair(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A second simulation that is ten thousand times as slow ends when its share is over."""
    setups: list[Setup] = []

    def slow(setup: Setup, **options: Any) -> Any:
        if setups:
            setup = replace(setup, dt=1e-4 * setup.dt)
        setups.append(setup)
        return simulate(setup, **options)

    monkeypatch.setattr("sim.sample.simulation.simulate", slow)
    method = replace(SHORT, step_pair=True, burn_in=0.1, seconds=3.0)
    report: Any = method.solve(fig6(), Q2).report
    assert report.diagnosis is not None
    assert [s.seconds for s in setups] == pytest.approx([1.0, 2.0])
    assert report.step_pair == "not measured: the limit of time came" and not report.step_biases


def test_seconds_that_end_in_the_burn_in_of_a_question_are_refused() -> None:
    for question in ("crossings", "spectrum", "correlation"):
        with pytest.raises(InvalidInput, match=r"burn-in, which takes about .* s; give it more"):
            curve(question, stiff(), 0, [0.0], seconds=0.05)
