"""Diagnostics against theory, arviz-stats, and runs that are wrong. Seeds were drawn once."""

from math import inf, sqrt

import numpy as np
import pytest
from arviz_stats.base import array_stats
from scipy.stats import chi2
from sim_systems import exact, exact_density, exact_square, fig6, ranged, slow

from fpk.answer.names import parse_observable
from fpk.answer.quantities import Number
from sim.montecarlo import MonteCarlo
from sim.sample.diagnostics import (
    diagnosis,
    drifts,
    effective_of_paths,
    effective_of_shares,
    largest_by_chance,
    moment_products,
    octiles,
    split_r_hat,
    variance_error,
)
from sim.sample.ensemble import Ensemble
from sim.sample.histogram import add_mirror_images, density_of_counts
from sim.sample.simulation import Record
from sim.step.schemes import SCHEMES
from sim.step.step_size import relaxation_time

EXACT_FLOW = SCHEMES["exact_flow"]


@pytest.mark.parametrize("phi", [-0.5, 0.8])
def test_effective_samples_of_an_autoregression(phi: float) -> None:
    """Stationary x' = φ x + √(1 − φ²) z: correlation φ^k, so that Σ_k φ^|k| = (1 + φ)/(1 − φ)."""
    rng, x = np.random.default_rng(61), np.empty((1024, 500))
    x[:, 0] = rng.normal(size=1024)
    for k in range(1, 500):
        x[:, k] = phi * x[:, k - 1] + sqrt(1.0 - phi * phi) * rng.normal(size=1024)
    (samples,), (error,) = effective_of_paths(
        x.mean(axis=1)[None], np.array([x.var()]), variance_error(x[:, :1].T)
    )
    expected = x.size * (1.0 - phi) / (1.0 + phi)
    # Ends of a finite series: the correlation beyond them is missed, 5/500 of the time or less.
    assert error < 0.1 and abs(samples / expected - 1.0) < 4.0 * error + 0.02
    theirs = float(array_stats.ess(x[:128], method="mean")) * x.shape[0] / 128
    # Theirs is of 64000 samples: some per cent.
    assert abs(samples / theirs - 1.0) < 4.0 * error + 0.1


def test_effective_samples_of_independent_shares_are_all() -> None:
    x = np.random.default_rng(8).normal(size=(1024, 400))
    shares = np.stack([(x < c).mean(axis=1) for c in (-1.0, -0.3, 0.3, 1.0)], axis=1)
    samples, error = effective_of_shares(shares)
    assert abs(samples / x.size - 1.0) < 4.0 * error


def test_split_r_hat_is_that_of_arviz() -> None:
    for draws, shift in ((8, 0.0), (21, 0.5)):
        x = np.random.default_rng(draws).normal(size=(64, draws))
        x[:5] += shift
        theirs = float(array_stats.rhat(x, method="split"))
        assert split_r_hat(x) == pytest.approx(theirs, rel=1e-12)
    assert np.isnan(split_r_hat(x[:, :3]))


def test_drift_is_found_where_it_is_and_seldom_where_it_is_not() -> None:
    rng = np.random.default_rng(3)
    limit = largest_by_chance(64, 20)
    for _ in range(200):
        assert np.abs(drifts(rng.normal(size=(10, 64, 20)))).max() < limit
    # Student's t of 63 degrees of freedom has the variance 63/61; 2000 of them show it to 3 %.
    z = drifts(rng.normal(size=(2000, 64, 20)))
    assert np.var(z, axis=0) == pytest.approx([63 / 61] * 2, rel=0.15)
    means = rng.normal(size=(1, 64, 20))
    means[0, :, 0] += 1.0
    assert np.abs(drifts(means)).max() > limit


def test_a_short_run_is_refused() -> None:
    means = np.random.default_rng(4).normal(size=(1, 64, 20))
    for samples, time, burn_in, words in (
        (49.0, 98.0, 10.0, ["fewer than 50"]),
        (1e4, 2e4, 4.0, ["burn-in of 4"]),
        # The squares of tiny numbers have a variance that underflows, their means may not.
        (0.0, 98.0, 10.0, ["fewer than 50", "longer burn_in"]),
    ):
        found = diagnosis([("x", samples, 0.1)], ["x"], means, time=time, paths=1, burn_in=burn_in)
        assert found.autocorrelation_time == (1.0 if samples else inf)
        assert len(found.failures) == len(words)
        assert all(word in failure for word, failure in zip(words, found.failures, strict=True))


def test_a_burn_in_too_short_is_seen_and_said() -> None:
    asked = [parse_observable("q2", 2), parse_observable("p2", 2)]
    method = {"paths": 4096, "time": 800.0, "seed": 311}
    good = MonteCarlo(**method).solve(fig6(), asked)  # type: ignore[arg-type]
    assert all(d.certificate.certified for d in good.densities), good.densities[0].certificate
    assert str(good.settings["burn_in_check"]).startswith("holds")
    assert float(good.settings["time in autocorrelation times"]) > 50.0
    assert abs(float(good.settings["r_hat"]) - 1.0) < 0.1
    bad = MonteCarlo(**method, burn_in=1e-3).solve(fig6(), asked)  # type: ignore[arg-type]
    assert any("longer burn_in" in f for f in bad.densities[1].certificate.failures)
    # From q = 0, without even the pilot's time.
    ensemble = Ensemble(fig6(), EXACT_FLOW, 0.12, 4096, 5, 2)
    ensemble.watch((), moment_products(2))
    record = Record(ensemble)
    for chunk in range(20):
        if chunk % 5 == 0:
            record.snapshot(4)
        ensemble.advance(400 - (chunk % 5 == 0), stride=4)
        record.chunk_ends()
    known = record.effective(), record.names, record.means()
    found = diagnosis(*known, time=960.0, paths=4096, burn_in=400.0)
    assert found.drift > found.drift_limit and "drifts" in found.failures[-1]


def test_counts_of_mirror_images() -> None:
    for histogram in ranged(exact(), ("q1", "q2,p1", "H", "q1,H")):
        counts = np.random.default_rng(1).integers(0, 9, (3, histogram.size + 1))
        found = add_mirror_images(histogram, counts)
        assert np.all(found.sum(axis=1) == 2 * counts.sum(axis=1))
        assert np.all(found[:, -1] == 2 * counts[:, -1])
        flips = tuple(k + 1 for k, c in enumerate(histogram.observable) if c.kind != "H")
        bins = found[:, :-1].reshape(-1, *histogram.shape)
        np.testing.assert_array_equal(bins, np.flip(bins, axis=flips))


def test_octiles_cut_at_eighths() -> None:
    cuts = octiles(np.cumsum(np.full(800, 3)))
    np.testing.assert_array_equal(cuts, np.arange(1, 8) * 100 - 1)
    assert octiles(np.cumsum([0, 0, 50, 0])).size == 0


def test_the_stated_error_is_the_real_one_and_the_mirror_gains() -> None:
    """L1 to the exact density, 16 seeds; the ratio scatters by 0.24, so that 0.24 is 4 errors."""
    ratios, gains = [], []
    (histogram,) = ranged(exact(), ("q2",), 2.5)
    middle = 0.5 * (histogram.edges[0][1:] + histogram.edges[0][:-1])
    right = exact_density(exact(), "q2")(middle)  # bins are 0.006 wide
    for seed in range(1000, 1016):
        ensemble = Ensemble(exact(), EXACT_FLOW, 0.11, 4096, seed, 2)
        ensemble.watch([histogram], moment_products(2))  # the kernel of the other tests
        ensemble.advance(900, stride=0)
        ensemble.advance(1200, stride=4)
        taken = ensemble.paths * ensemble.samples
        plain = density_of_counts(histogram, ensemble.counts, taken=taken)
        both = density_of_counts(histogram, ensemble.counts, taken=taken, mirror=True)
        # The error is that of the density as it is returned at points.
        ratios.append(np.abs(both(middle) - right) @ np.diff(both.edges[0]) / both.l1_error)
        gains.append((plain.l1_error / both.l1_error) ** 2)
    assert np.mean(ratios) == pytest.approx(1.0, abs=0.24)
    # Twice the samples, but for the correlation of x and −x on one trajectory.
    assert 1.4 < np.median(gains) < 2.4


def test_the_relative_error_of_a_variance_is_free_of_units() -> None:
    samples = np.random.default_rng(20261122).standard_normal((2, 64))
    expected = variance_error(samples)
    for unit in (1e-120, 1e-60, 1e100, 1e150):
        np.testing.assert_allclose(variance_error(unit * samples), expected, rtol=1e-12)
    assert not variance_error(np.ones((1, 8))).any()


def moments_of_run(seed: int, relaxations: float) -> dict[str, Number]:
    """Moments of 1024 trajectories of the exact system, after a burn-in of 10 relaxation times."""
    system, dt = exact(), 0.12
    steps = relaxation_time(system) / dt
    ensemble = Ensemble(system, EXACT_FLOW, dt, 1024, seed, 2)
    ensemble.watch((), moment_products(2))
    ensemble.advance(round(10.0 * steps), stride=0)
    ensemble.advance(round(relaxations * steps), stride=round(0.4 / dt))
    return Record(ensemble).moments()


@pytest.mark.parametrize(("seeds", "relaxations"), [("random", 0.5), slow("adjacent", 15.0)])
def test_stated_errors_are_right_over_seeds(seeds: str, relaxations: float) -> None:
    """64 runs, short and long: Σ z² of each mean is χ²_64.

    Each end of χ² at a false-alarm rate of 1e-5 (24 of them: 2.4e-4). The bias of the step is 1e-5,
    an error at least 4e-4. A clearance of 0.55 instead of 0.5 fails.
    """
    drawn = np.random.default_rng(82).integers(2**63, size=64)
    own = range(640, 704) if seeds == "adjacent" else drawn
    runs = [moments_of_run(int(seed), relaxations) for seed in own]

    def chi_square(name: str, truth: float) -> float:
        return sum(((run[name].value - truth) / run[name].error) ** 2 for run in runs)

    for name, truth in (("q2²", exact_square()), ("v1²", 0.5), ("v2²", 0.5)):
        assert chi2.ppf(1e-5, 64) < chi_square(name, truth) < chi2.isf(1e-5, 64), name
    assert chi_square("q2²", exact_square(0.55)) > 2.0 * chi2.isf(1e-5, 64)
