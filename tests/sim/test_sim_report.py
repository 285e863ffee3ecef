"""The report of a simulation: means with honest errors, step bias apart. Seeds were drawn once."""

from collections.abc import Sequence
from dataclasses import FrozenInstanceError
from math import exp, sqrt

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.linalg import solve_continuous_lyapunov
from scipy.stats import chi2
from sim_systems import exact, fig6, linear, mixed, report_of

from fpk.answer.names import parse_observable
from fpk.answer.quantities import Number
from fpk.answer.sampled_density import SampledDensity
from fpk.system.damping import DampingTerm
from fpk.system.linear import diffusion_matrix, drift_matrix
from fpk.system.system import System
from sim.montecarlo import MonteCarlo
from sim.sample.diagnostics import Report, batch_moments, moment_identities, moment_products
from sim.sample.ensemble import Ensemble
from sim.sample.simulation import Record
from sim.step.schemes import SCHEMES
from sim.step.step_size import chosen_step, relaxation_time

Q2 = [parse_observable("q2", 2)]


def exact_square(clearance: float = 0.5) -> float:
    def weight(q: float) -> float:
        return exp(-2.0 * (0.25 * q * q + 4.0 * max(abs(q) - clearance, 0.0) ** 2.5))

    norm = quad(weight, 0, 6, points=[clearance])[0]
    return float(quad(lambda q: q * q * weight(q), 0, 6, points=[clearance])[0] / norm)


def watched(
    system: System, *, blocks: int = 64, steps: int = 4000, burn_in: int = 3000
) -> Ensemble:
    dt = min(0.12, chosen_step(system))
    ensemble = Ensemble(system, SCHEMES["exact_flow"], dt, 128 * blocks, 4711, 2)
    ensemble.watch((), moment_products(system.n, terms=bool(system.damping_terms)))
    ensemble.advance(burn_in, stride=0)  # by the same kernel
    ensemble.advance(steps, stride=4)
    return ensemble


SEEDS = {"adjacent": range(640, 704), "random": np.random.default_rng(82).integers(2**63, size=64)}


def moments_of_run(seed: int, relaxations: float) -> dict[str, Number]:
    """Moments of 1024 trajectories of the exact system, after a burn-in of 10 relaxation times."""
    system, dt = exact(), 0.12
    steps = relaxation_time(system) / dt
    ensemble = Ensemble(system, SCHEMES["exact_flow"], dt, 1024, seed, 2)
    ensemble.watch((), moment_products(2))
    ensemble.advance(round(10.0 * steps), stride=0)
    ensemble.advance(round(relaxations * steps), stride=round(0.4 / dt))
    return Record(ensemble).moments()


def chi_square(moments: Sequence[Number], truth: float) -> float:
    return float(sum(((m.value - truth) / m.error) ** 2 for m in moments))


@pytest.mark.parametrize(
    ("seeds", "relaxations"),
    [("adjacent", 15.0), ("random", 0.5)]
    + [
        pytest.param(*pair, marks=pytest.mark.slow)
        for pair in (("adjacent", 0.5), ("random", 15.0))
    ],
)
def test_stated_errors_are_right_over_seeds(seeds: str, relaxations: float) -> None:
    """64 runs, short and long: Σ z² of each mean is χ²_64.

    Each end of χ² at a false-alarm rate of 1e-5 (24 of them: 2.4e-4). The bias of the step is 1e-5,
    an error at least 4e-4. A clearance of 0.55 instead of 0.5 fails.
    """
    runs = [moments_of_run(int(seed), relaxations) for seed in SEEDS[seeds]]
    for name, truth in (("q2²", exact_square()), ("v1²", 0.5), ("v2²", 0.5)):
        moments = [run[name] for run in runs]
        assert chi2.ppf(1e-5, 64) < chi_square(moments, truth) < chi2.isf(1e-5, 64), name
    wrong = chi_square([run["q2²"] for run in runs], exact_square(0.55))
    assert wrong > 2.0 * chi2.isf(1e-5, 64)


def test_the_mean_in_the_report_is_that_of_the_histogram() -> None:
    """Euler at 0.01 is off by 4 %, and so is the mean that is reported.

    A sample lies within w/2 of the middle m of its bin: ``|q² − m²| <= w |q| + w²/4``, and the
    moment of the density has w²/12 more.
    """
    method = MonteCarlo(paths=4096, time=100.0, dt=0.01, scheme="euler_maruyama", seed=41)
    result = method.solve(exact(), Q2)
    density, report = result.densities[0], result.report
    assert isinstance(density, SampledDensity) and isinstance(report, Report)
    w = float(np.diff(density.edges[0])[0])
    square = report.moments["q2²"]
    tail = density.certificate.tail_mass * (3.0 * float(density.edges[0][-1])) ** 2
    assert abs(square.value - density.moment(2).value) < w * sqrt(square.value) + w**2 / 3.0 + tail
    assert square.value / exact_square() - 1.0 > 5.0 * square.error


@pytest.mark.parametrize(
    "system",
    [
        pytest.param(mixed(), marks=pytest.mark.slow),
        pytest.param(linear(5), marks=pytest.mark.slow),
        pytest.param(System([1.0], [1.0], [0.2], [0.1]), marks=pytest.mark.slow),
        System([1.0, 2.0], [1.0, 1.0], [0.2, 0.2], [0.2, 0.0]),
        pytest.param(
            System(
                [1.0], [1.0], [-0.1], [0.02], damping_terms=(DampingTerm(1, 1, 0.2, q=((1, 2),)),)
            ),
            marks=pytest.mark.slow,
        ),
    ],
    ids=["mixed", "five", "one", "noise-on-one", "van-der-pol"],
)
def test_identities_hold(system: System) -> None:
    """The moment identities, and that q_i v_j + q_j v_i, the rate of change of q_i q_j, is zero.

    Up to 26 z-scores below 4.5: a false alarm in 2e-4 of the seeds.
    """
    ensemble = watched(system, blocks=16, steps=2000)
    means = ensemble.batch_means()
    moments = batch_moments(system, means)
    assert all(abs(identity.z) < 4.5 for identity in moment_identities(system, means))
    for i in range(system.n):
        for j in range(i, system.n):
            rate = moments["q", i, "p", j] / system.mass[j]
            rate = rate + moments["q", j, "p", i] / system.mass[i]
            assert abs(rate.mean()) < 4.5 * rate.std(ddof=1) / sqrt(rate.size)


def test_gaussian_means() -> None:
    system = linear()
    covariance = solve_continuous_lyapunov(drift_matrix(system), -diffusion_matrix(system))
    variances = np.diag(covariance) / np.array([1.0, 1.0, *system.mass**2])
    report = report_of(MonteCarlo(paths=4096, time=300.0, seed=4711), system)
    for m, truth in zip(report.moments.values(), variances, strict=True):
        assert abs(m.value - truth) < 4.5 * m.error


def test_pair_of_steps_sees_euler_and_not_the_exact_flow() -> None:
    fields = {"paths": 4096, "time": 150.0, "seed": 9, "step_pair": True}
    euler = MonteCarlo(**fields, scheme="euler_maruyama", dt=0.02)  # type: ignore[arg-type]
    bias = report_of(euler, exact(), Q2).step_biases["q2"]
    assert bias.value > 2.5 * bias.error
    report = report_of(MonteCarlo(**fields), exact(), Q2)  # type: ignore[arg-type]
    assert report.step_biases["q2"].value < 2.0 * report.step_biases["q2"].error
    assert [*report.moments] == ["q1²", "q2²", "v1²", "v2²"]
    for name in report.moments:
        bias = report.step_biases[name]
        assert abs(bias.value) < 4.5 * bias.error
    assert report.step_pair == report.settings(())["step bias"] == "dt against dt/2"
    alone = report_of(MonteCarlo(time=20.0), linear())
    assert alone.step_pair == alone.settings(())["step bias"] == "not measured"
    assert not alone.step_biases


def test_any_number_of_threads_and_a_stop_by_seconds() -> None:
    one, two = (
        MonteCarlo(paths=4096, time=60.0, seed=12, threads=k, tol=0.02).solve(exact(), Q2)
        for k in (1, 2)
    )
    a, b = one.densities[0], two.densities[0]
    assert isinstance(a, SampledDensity) and isinstance(b, SampledDensity)
    np.testing.assert_array_equal(a.batch_values, b.batch_values)
    assert isinstance(one.report, Report) and isinstance(two.report, Report)
    for part in ("diagnosis", "moments"):
        assert getattr(one.report, part) == getattr(two.report, part)
    assert a.l1_error == b.l1_error <= 0.02
    timed = MonteCarlo(paths=4096, time=60.0, seed=12, seconds=0.05).solve(exact(), Q2)
    assert not any("tolerance" in f for f in timed.densities[0].certificate.failures)


def test_the_settings_of_a_result_are_those_of_its_frozen_report() -> None:
    result = MonteCarlo(paths=4096, time=40.0, seed=3).solve(fig6(), Q2)
    report, density = result.report, result.densities[0]
    assert isinstance(report, Report) and isinstance(density, SampledDensity)
    settings = report.settings([density])
    assert dict(result.settings) == settings == dict(density.provenance)
    assert settings["sampling error of q2"] == density.l1_error
    assert "returned at points" in str(settings["sampling error"])
    assert not report.interrupted and not result.partial
    with pytest.raises(FrozenInstanceError):
        report.interrupted = "no"  # type: ignore[misc]
    assert report.limited_by == ""
    assert relaxation_time(fig6()) == report.relaxation_time
