"""Diagnostics against theory, arviz-stats, and runs that are wrong. Seeds were drawn once."""

from itertools import pairwise
from math import exp, inf, sqrt

import numpy as np
import pytest
from arviz_stats.base import array_stats
from scipy.integrate import quad
from sim_systems import exact, fig6, ranged

from fpk.answer.names import parse_observable
from sim.montecarlo import MonteCarlo
from sim.sample.diagnostics import (
    diagnosis,
    drift_limit,
    drifts,
    effective_of_paths,
    effective_of_shares,
    moment_products,
    octiles,
    split_r_hat,
    variance_error,
)
from sim.sample.ensemble import Ensemble
from sim.sample.histogram import mirrored, sampled_density
from sim.sample.simulation import Record
from sim.step.arrays import LANES
from sim.step.schemes import SCHEMES


def autoregression(phi: float, chains: int, draws: int, seed: int) -> np.ndarray:
    """Stationary x' = φ x + √(1 − φ²) z: correlation φ^k, so that Σ_k φ^|k| = (1 + φ)/(1 − φ)."""
    rng = np.random.default_rng(seed)
    x = np.empty((chains, draws))
    x[:, 0] = rng.normal(size=chains)
    for k in range(1, draws):
        x[:, k] = phi * x[:, k - 1] + sqrt(1.0 - phi * phi) * rng.normal(size=chains)
    return x


@pytest.mark.parametrize("phi", [-0.5, 0.0, 0.8])
def test_effective_samples_of_an_autoregression(phi: float) -> None:
    x = autoregression(phi, 1024, 500, seed=61)
    (samples,), (error,) = effective_of_paths(
        x.mean(axis=1)[None], np.array([x.var()]), variance_error(x[:, :1].T)
    )
    expected = x.size * (1.0 - phi) / (1.0 + phi)
    assert error < 0.1
    # Ends of a finite series: the correlation beyond them is missed, 5/500 of the time or less.
    assert abs(samples / expected - 1.0) < 4.0 * error + 0.02
    theirs = float(array_stats.ess(x[:128], method="mean")) * x.shape[0] / 128
    # Theirs is of 64000 samples: some per cent.
    assert abs(samples / theirs - 1.0) < 4.0 * error + 0.1


def test_effective_samples_of_independent_shares_are_all() -> None:
    rng = np.random.default_rng(8)
    x = rng.normal(size=(64, 5000))
    shares = np.stack([(x < c).mean(axis=1) for c in (-1.0, -0.3, 0.3, 1.0)], axis=1)
    samples, error = effective_of_shares(shares)
    assert abs(samples / x.size - 1.0) < 4.0 * error


@pytest.mark.parametrize("draws", [8, 21, 40])
@pytest.mark.parametrize("shift", [0.0, 0.5])
def test_split_r_hat_is_that_of_arviz(draws: int, shift: float) -> None:
    x = np.random.default_rng(draws).normal(size=(64, draws))
    x[:5] += shift
    theirs = float(array_stats.rhat(x, method="split"))
    assert split_r_hat(x) == pytest.approx(theirs, rel=1e-12)
    assert np.isnan(split_r_hat(x[:, :3]))


def test_error_of_trajectories_is_that_of_the_correlogram_and_of_arviz() -> None:
    """400 samples of q2² of 1024 trajectories of fig6, an eighth of a period apart.

    The correlation swings: Geyer's sequence, which arviz cuts at the first negative pair, finds
    three times the effective samples that there are. Of means over 20 samples, more than
    a period, it does not swing, and arviz's error of the mean is right.
    """
    system, dt, stride = fig6(), 0.16, 3
    ensemble = Ensemble(system, SCHEMES["exact_flow"], dt, 1024, 17, 2)
    ensemble.advance(3000)
    products = moment_products(2)
    ensemble.watch((), products)
    k, draws = products.index(("q", 1, "q", 1)), []
    record = Record(ensemble)
    for number in range(400):
        before = ensemble.sums.copy()
        if number % 100 == 0:
            record.snapshot(stride)  # one step of them
        ensemble.advance(stride - (number % 100 == 0), stride=stride)
        draws.append((ensemble.sums - before)[:, k].ravel())
        if len(draws) % 20 == 0:
            record.chunk_ends()
    x = np.array(draws).T
    found = next(e for e in record.effective() if e[0] == "q2²")
    assert found[2] < 0.12
    y = x - x.mean()
    lags = range(1, 120)
    rho = [float(np.mean(y[:, :-k] * y[:, k:])) / float(np.mean(y * y)) for k in lags]
    summed = x.size / (1.0 + 2.0 * sum(rho))
    # Both are one variance over 1024 trajectories; 120 of 400 lags are summed.
    assert abs(found[1] / summed - 1.0) < 4.0 * found[2] + 0.05
    error = np.sqrt(np.mean(record.variances, axis=0)[0, 1] / found[1])
    theirs = float(array_stats.mcse(x.reshape(1024, 20, 20).mean(axis=2), method="mean"))
    assert abs(error / theirs - 1.0) < 4.0 * 0.5 * found[2] + 0.05
    assert float(array_stats.ess(x, method="mean")) > 2.0 * found[1]
    # And the chunks of the record are means of these draws.
    column = record.names.index("q2²")
    chunk_means = x.reshape(-1, LANES, 20, 20).mean(axis=(1, 3))
    np.testing.assert_allclose(record.means()[column], chunk_means, rtol=1e-9)


def test_drift_is_found_where_it_is_and_seldom_where_it_is_not() -> None:
    rng = np.random.default_rng(3)
    limit = drift_limit(64, 20)
    for _ in range(200):
        assert np.abs(drifts(rng.normal(size=(10, 64, 20)))).max() < limit
    z = drifts(rng.normal(size=(2000, 64, 20)))
    # Student's t of 63 degrees of freedom has the variance 63/61; 2000 of them show it to 3 %.
    assert np.var(z, axis=0) == pytest.approx([63 / 61] * 2, rel=0.15)
    means = rng.normal(size=(1, 64, 20))
    means[0, :, 0] += 1.0
    assert np.abs(drifts(means)).max() > limit


def test_a_short_run_is_refused() -> None:
    few, _ = effective_of_shares(np.random.default_rng(2).normal(0.5, 0.1, (64, 1)))
    assert few * 64 > 50 and few < 64 * 50
    one = ("x", 49.0, 0.1)
    means = np.random.default_rng(4).normal(size=(1, 64, 20))
    found = diagnosis([one], ["x"], means, time=98.0, paths=1, burn_in=10.0)
    assert found.autocorrelation_time == 1.0
    (words,) = found.failures
    assert "fewer than 50" in words and "sample for longer" in words
    (words,) = diagnosis([("x", 1e4, 0.1)], ["x"], means, time=2e4, paths=1, burn_in=4.0).failures
    assert "burn-in of 4" in words


def test_a_sample_without_any_effective_sample_is_refused() -> None:
    """The squares of tiny numbers have a variance that underflows, their means may not."""
    means = np.random.default_rng(4).normal(size=(1, 64, 20))
    found = diagnosis([("x", 0.0, 0.1)], ["x"], means, time=98.0, paths=1, burn_in=10.0)
    assert found.autocorrelation_time == inf and found.times_per_path == 0.0
    assert "fewer than 50" in found.failures[0] and "longer burn_in" in found.failures[1]


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
    products = moment_products(2)
    ensemble = Ensemble(fig6(), SCHEMES["exact_flow"], 0.12, 4096, 5, 2)
    ensemble.watch((), products)
    record = Record(ensemble)
    for chunk in range(20):
        if chunk % 5 == 0:
            record.snapshot(4)
        ensemble.advance(400 - (chunk % 5 == 0), stride=4)
        record.chunk_ends()
    found = diagnosis(
        record.effective(), record.names, record.means(),
        time=960.0, paths=4096, burn_in=400.0,
    )  # fmt: skip
    assert found.drift > found.drift_limit
    assert "drifts" in found.failures[-1]


def test_mirrored_counts() -> None:
    q = np.array([[-1.0, -1.0], [1.0, 1.0]])
    asked = [parse_observable(name, 2) for name in ("q1", "q2,p1", "H", "q1,H")]
    for histogram in ranged(exact(), asked, q, q):
        shape = [e.size - 1 for e in histogram.edges]
        counts = np.random.default_rng(1).integers(0, 9, (3, histogram.size + 1))
        found = mirrored(histogram, counts)
        assert np.all(found.sum(axis=1) == 2 * counts.sum(axis=1))
        assert np.all(found[:, -1] == 2 * counts[:, -1])
        flips = tuple(k + 1 for k, c in enumerate(histogram.observable) if c.kind != "H")
        bins = found[:, :-1].reshape(-1, *shape)
        np.testing.assert_array_equal(bins, np.flip(bins, axis=flips))


def test_octiles_cut_at_eighths() -> None:
    cuts = octiles(np.cumsum(np.full(800, 3)))
    np.testing.assert_array_equal(cuts, np.arange(1, 8) * 100 - 1)
    assert octiles(np.cumsum([0, 0, 50, 0])).size == 0


def exact_bins(edges: np.ndarray) -> np.ndarray:
    """Density of q2 of the exact system, exp(−2 V) with q1 integrated out, averaged over bins."""

    def weight(q: float) -> float:
        return exp(-2.0 * (0.25 * q * q + 4.0 * max(abs(q) - 0.5, 0.0) ** 2.5))

    norm = 2.0 * quad(weight, 0.0, 6.0, points=[0.5])[0]
    return np.array([quad(weight, a, b)[0] / norm / (b - a) for a, b in pairwise(edges)])


def test_the_stated_error_is_the_real_one_and_the_mirror_gains() -> None:
    """L1 to the exact density, 16 seeds; the ratio scatters by 0.24, so that 0.24 is 4 errors."""
    ratios, gains = [], []
    for seed in range(1000, 1016):
        ensemble = Ensemble(exact(), SCHEMES["exact_flow"], 0.11, 4096, seed, 2)
        reach = np.array([[-2.5, -2.5], [2.5, 2.5]])
        (histogram,) = ranged(exact(), [parse_observable("q2", 2)], reach, reach)
        ensemble.watch([histogram], moment_products(2))  # the kernel of the other tests
        ensemble.advance(900, stride=0)
        ensemble.advance(1200, stride=4)
        taken = ensemble.paths * ensemble.samples
        plain = sampled_density(histogram, ensemble.counts, taken=taken)
        both = sampled_density(histogram, ensemble.counts, taken=taken, mirror=True)
        # The error is that of the density as it is returned at points.
        edges = both.edges[0]
        distance = np.abs(both(0.5 * (edges[1:] + edges[:-1])) - exact_bins(edges))
        ratios.append(distance @ np.diff(edges) / both.l1_error)
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
