"""Control variates and the pair of steps: right, honest, and worth it. Seeds were drawn once."""

from collections.abc import Iterable, Sequence
from math import exp, sqrt

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.linalg import solve_continuous_lyapunov
from scipy.stats import binom, chi2
from sim_systems import exact, fig6, linear, mixed

from fpk.damping import DampingTerm
from fpk.density import SampledDensity, moment
from fpk.observable import parse_observable
from fpk.system import System
from sim.control import (
    FALSE_ALARMS,
    ControlledMean,
    Controls,
    PathMeans,
    displacement_square,
    path_means,
    velocity_square,
)
from sim.ensemble import Ensemble
from sim.flow import linear_diffusion, linear_drift
from sim.montecarlo import MonteCarlo
from sim.relaxation import relaxation_time
from sim.scheme import SCHEMES
from sim.statistics import Moments, moment_products
from sim.step_size import chosen_step

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


def test_stated_errors_are_right_for_few_trajectories() -> None:
    """64 blocks, each a sample of 128 trajectories with its own fit: Σ z² of each mean is χ²_64.

    Student's t of some 119 degrees of freedom has 1.7 % more variance than a normal. Both ends at
    a false-alarm rate of 1e-4 for four means; a clearance of 0.55 instead of 0.5 is found out.
    """
    system = exact()
    ensemble = watched(system)
    values: dict[str, list[tuple[float, float]]] = {"q2": [], "v1": [], "v2": []}
    for b in range(64):
        part = slice(b, b + 1)
        one = path_means(system, ensemble.sums[part], ensemble.live[part], ensemble.samples)
        for name, mean in (
            ("q2", displacement_square(one, 1)),
            ("v1", velocity_square(one, 0)),
            ("v2", velocity_square(one, 1)),
        ):
            values[name].append((mean.value, mean.error))
    for name, truth in (("q2", exact_square()), ("v1", 0.5), ("v2", 0.5)):
        value, error = np.array(values[name]).T
        square = float(np.sum(((value - truth) / error) ** 2))
        assert chi2.ppf(1e-4, 64) < square < 1.03 * chi2.isf(1e-4, 64), name
    value, error = np.array(values["q2"]).T
    assert np.sum(((value - exact_square(0.55)) / error) ** 2) > 2.0 * chi2.isf(1e-4, 64)


SEEDS = {"adjacent": range(640, 704), "random": np.random.default_rng(82).integers(2**63, size=64)}


def over_seeds(seeds: Iterable[int], relaxations: float, scheme: str, dt: float) -> list[PathMeans]:
    """Means of 1024 trajectories of the exact system, after a burn-in of 10 relaxation times."""
    found, system = [], exact()
    steps = relaxation_time(system) / dt
    for seed in seeds:
        ensemble = Ensemble(system, SCHEMES[scheme], dt, 1024, int(seed), 2)
        ensemble.watch((), moment_products(system.n))
        ensemble.advance(round(10.0 * steps), stride=0)
        ensemble.advance(round(relaxations * steps), stride=max(1, round(0.4 / dt)))
        found.append(path_means(system, ensemble.sums, ensemble.live, ensemble.samples))
    return found


def chi_square(values: Sequence[float], errors: Sequence[float], truth: float) -> float:
    return float(np.sum(((np.array(values) - truth) / np.array(errors)) ** 2))


@pytest.mark.parametrize("seeds", SEEDS)
@pytest.mark.parametrize("relaxations", [0.5, 15.0])
def test_stated_errors_are_right_over_seeds(seeds: str, relaxations: float) -> None:
    """64 runs, short and long: Σ z² of each mean is χ²_64, and so many controls are refused.

    Each end of χ² at a false-alarm rate of 1e-5 (48 of them: 5e-4), refusals at 1e-4. The bias of
    the step is 1e-5, an error at least 4e-4.
    """
    runs = over_seeds(SEEDS[seeds], relaxations, "exact_flow", 0.12)
    for mean_of, i, truth in (
        (displacement_square, 1, exact_square()),
        (velocity_square, 0, 0.5),
        (velocity_square, 1, 0.5),
    ):
        means: list[ControlledMean] = [mean_of(paths, i) for paths in runs]
        plain = chi_square([m.plain.value for m in means], [m.plain.error for m in means], truth)
        ours = chi_square([m.value for m in means], [m.error for m in means], truth)
        for square in (plain, ours):
            assert chi2.ppf(1e-5, 64) < square < chi2.isf(1e-5, 64)
        assert sum(not m.held for m in means) <= binom.isf(1e-4, 64, FALSE_ALARMS)
        # What the module says: there is no gain where the controls' bias is unknown.
        assert all(m.plain.error < 1.02 * np.hypot(m.error, m.unseen) for m in means)


def test_a_step_that_biases_the_controls_is_found_out_and_the_plain_mean_stays_right() -> None:
    """BAOAB at h = 0.3, a bias of −0.7 %: all 64 runs refuse their controls.

    The plain means scatter as they say, Σ z² about their own mean being χ²_63. Controlled ones lie
    elsewhere by more than the false-alarm rate of 1e-5 allows.
    """
    means = [displacement_square(p, 1) for p in over_seeds(SEEDS["adjacent"], 15.0, "baoab", 0.3)]
    assert not any(m.held for m in means)
    values, errors = ([getattr(m.plain, k) for m in means] for k in ("value", "error"))
    square = chi_square(values, errors, float(np.mean(values)))
    assert chi2.ppf(1e-5, 63) < square < chi2.isf(1e-5, 63)
    moved = np.mean([m.value for m in means]) - np.mean(values)
    assert abs(moved) > 4.4 * np.mean([m.unseen for m in means]) / 8.0


def test_errors_are_those_of_regression_on_the_controls() -> None:
    """Intercept of least squares where all controls have the means they are said to have."""
    (paths,) = over_seeds([5], 2.0, "baoab", 0.3)
    system, dt = exact(), 0.3
    ensemble = Ensemble(system, SCHEMES["baoab"], dt, 1024, 5, 1)
    ensemble.watch((), moment_products(system.n))
    steps = relaxation_time(system) / dt
    ensemble.advance(round(10.0 * steps), stride=0)
    ensemble.advance(round(2.0 * steps), stride=1)
    each = ensemble.sums.transpose(1, 0, 2).reshape(ensemble.sums.shape[1], -1) / ensemble.samples
    controls = Controls(system)
    rows, expected = controls.identities
    X = np.column_stack([np.ones(1024), (rows @ each).T - expected])
    y = controls.row((1.0, "q", 1, "q", 1)) @ each
    solution, residual, rank, _ = np.linalg.lstsq(X, y)
    covariance = residual[0] / (1024 - rank) * np.linalg.inv(X.T @ X)
    mean = displacement_square(paths, 1)
    assert rank == X.shape[1]
    assert mean.value == pytest.approx(solution[0], rel=1e-9)
    assert mean.error == pytest.approx(sqrt(covariance[0, 0]), rel=1e-7)
    assert mean.plain.value == pytest.approx(y.mean(), rel=1e-12)
    assert mean.plain.error == pytest.approx(y.std(ddof=1) / 32.0, rel=1e-7)


def test_a_mean_that_its_controls_determine_has_the_error_of_round_off() -> None:
    """One mass without contact: E v² follows from its energy balance alone, m c E v² = N."""
    ensemble = watched(System([1.0], [1.0], [0.2], [0.1]), blocks=8, steps=1000)
    paths = path_means(ensemble.system, ensemble.sums, ensemble.live, ensemble.samples)
    mean = velocity_square(paths, 0)
    assert 0.0 < mean.error < 1e-5 * mean.plain.error
    assert abs(mean.value - 0.5) < 4.0 * mean.error


def test_the_mean_that_is_told_is_that_of_the_histogram() -> None:
    """Euler at 0.01 is off by 4 %; the mean by control variates is not, and is not told.

    A sample lies within w/2 of the middle m of its bin: ``|q² − m²| <= w |q| + w²/4``, and the
    moment of the density has w²/12 more.
    """
    method = MonteCarlo(paths=4096, time=100.0, dt=0.01, scheme="euler_maruyama", seed=41)
    result = method.solve(exact(), Q2)
    density, s = result.densities[0], result.settings
    assert isinstance(density, SampledDensity)
    w = float(np.diff(density.edges[0])[0])
    told = float(s["E q2²"])
    assert abs(told - moment(density, 2)) < w * sqrt(told) + w**2 / 3.0 + density_tail(density)
    assert told / exact_square() - 1.0 > 5.0 * float(s["standard error of E q2²"])
    assert "E q2² by control variates" not in s
    assert str(s["control variates"]).startswith("not used for")
    s = MonteCarlo(paths=4096, time=100.0, seed=41).solve(exact(), Q2).settings
    assert str(s["control variates"]).startswith("used")
    assert float(s["standard error of E q2² by control variates"]) > 0


def density_tail(density: SampledDensity) -> float:
    """What samples beyond the bins may hold, each below three times the last edge."""
    return density.certificate.tail_mass * (3.0 * float(density.edges[0][-1])) ** 2


def test_controls_gain_and_agree_with_the_plain_means() -> None:
    for system, least in ((fig6(), 2.5), (exact(), 2.5)):
        ensemble = watched(system, blocks=16)
        paths = path_means(system, ensemble.sums, ensemble.live, ensemble.samples)
        moments = Moments(system, ensemble.batch_means())
        for i in range(2):
            for mean, plain in (
                (displacement_square(paths, i), moments.displacement_square(i)),
                (velocity_square(paths, i), moments.velocity_square(i)),
            ):
                assert mean.gain > least - 0.5
                assert abs(mean.value - plain.value) < 4.5 * plain.error


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
def test_controls_have_the_means_that_they_are_said_to_have(system: System) -> None:
    """Up to 27 z-scores below 4.5: a false alarm in 2e-4 of the seeds."""
    ensemble = watched(system, blocks=16, steps=2000)
    rows, expected = Controls(system).identities
    batches = ensemble.batch_means() @ rows.T
    error = batches.std(axis=0, ddof=1) / sqrt(batches.shape[0])
    z = np.divide(batches.mean(axis=0) - expected, error, out=np.zeros_like(error), where=error > 0)
    assert np.abs(z).max() < 4.5
    assert np.all(error > 0)


def test_gaussian_means_by_controls() -> None:
    system = linear()
    covariance = solve_continuous_lyapunov(linear_drift(system), -linear_diffusion(system))
    ensemble = watched(system, blocks=16)
    paths = path_means(system, ensemble.sums, ensemble.live, ensemble.samples)
    for i in range(2):
        mean = displacement_square(paths, i)
        assert abs(mean.value - covariance[i, i]) < 4.5 * mean.error
        mean = velocity_square(paths, i)
        truth = covariance[2 + i, 2 + i] / system.mass[i] ** 2
        assert abs(mean.value - truth) < 4.5 * mean.error


def test_pair_of_steps_sees_euler_and_not_the_exact_flow() -> None:
    fields = {"paths": 4096, "time": 150.0, "seed": 9, "step_pair": True}
    euler = MonteCarlo(**fields, scheme="euler_maruyama", dt=0.02).solve(exact(), Q2)  # type: ignore[arg-type]
    s = euler.settings
    assert float(s["step bias of q2"]) > 3.0 * float(s["step bias of q2 by chance"])
    s = MonteCarlo(**fields).solve(exact(), Q2).settings  # type: ignore[arg-type]
    assert float(s["step bias of q2"]) < 2.0 * float(s["step bias of q2 by chance"])
    for name in ("q1²", "q2²", "v1²", "v2²"):
        error = float(s[f"standard error of step bias of E {name}"])
        assert abs(float(s[f"step bias of E {name}"])) < 4.5 * error
    assert MonteCarlo(time=20.0).solve(linear(), []).settings["step bias"] == "not measured"


def test_any_number_of_threads_and_a_stop_by_seconds() -> None:
    one, two = (
        MonteCarlo(paths=4096, time=60.0, seed=12, threads=k, tol=0.02).solve(exact(), Q2)
        for k in (1, 2)
    )
    a, b = one.densities[0], two.densities[0]
    assert isinstance(a, SampledDensity) and isinstance(b, SampledDensity)
    np.testing.assert_array_equal(a.batch_values, b.batch_values)
    told = {k for k in one.settings if k.startswith(("E ", "standard", "effective", "r_hat"))}
    assert len(told) > 8 and all(one.settings[k] == two.settings[k] for k in told)
    assert float(one.settings["sampling error of q2"]) <= 0.02
    timed = MonteCarlo(paths=4096, time=60.0, seed=12, seconds=0.05).solve(exact(), Q2)
    assert not any("tol" in f for f in timed.densities[0].certificate.failures)
