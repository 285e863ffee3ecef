"""The density at a point from bins: exact for what it says, free of the width of the bins."""

from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import norm

from fpk.certificate import Measured, certify
from fpk.observable import parse_observable
from fpk.reconstruction import local_fit, windows
from fpk.sampled_density import SampledDensity

PASSED = certify(Measured(0.0, 0.0, 0.0, 0.0, 0.0), tol=1.0)
Q1 = parse_observable("q1", 1)


def of_bins(edges, content, *, batches=4, samples=1e9, references=()) -> SampledDensity:
    """A histogram of exactly these contents, every batch the same."""
    values = content / np.diff(edges)
    return SampledDensity(
        Q1, (edges,), values, np.tile(values, (batches, 1)), PASSED,
        one_sample=1.0 / (samples * (edges[1] - edges[0])), log_references=references,
    )  # fmt: skip


@pytest.mark.parametrize("bins", [3, 16, 128, 1024])
def test_polynomials_by_the_reference_are_exact_everywhere(bins):
    """Of degree 4 times r, beside both ends, too; the tilt is part of r and drops out at t = 0."""
    edges, log_r = np.linspace(0.0, 2.0, bins + 1), lambda y: -3.0 * y
    degree = min(4, bins - 1)

    def p(y):
        return np.exp(-3.0 * y) * (1.0 + 0.3 * y**degree)

    content = np.array([quad(p, a, b, epsabs=1e-15)[0] for a, b in pairwise(edges)])
    x = np.linspace(0.0, 2.0, 37)
    index = windows(edges, x)
    # What the reference itself would hold: no tilt.
    own = np.array([np.exp(-3.0 * a) - np.exp(-3.0 * b) for a, b in pairwise(edges)])
    weights, _ = local_fit(edges, x, index, 1e12 * own[index], log_reference=log_r)
    found = np.sum(weights * (content / np.diff(edges))[index], axis=1)
    np.testing.assert_allclose(found, p(x), rtol=1e-8)


@pytest.mark.parametrize("width", [0.25, 0.08, 0.02])
def test_the_width_of_a_stop_in_bins_does_not_show(width):
    """A normal density cut off by a Hertz stop, ``width`` standard deviations of it to e⁻¹.

    Linear between bins smoothed by a local quadratic it was wrong by 2 % at the stop, and by ten
    times itself where p is 1e-6; the sampling error of 60 s is 3e-4 there and 0.4.
    """

    def log_r(q):
        return -(np.maximum((q - 0.5) / width, 0.0) ** 2.5)

    def p(q):
        return norm.pdf(q) * np.exp(log_r(q))

    edges = np.linspace(-5.0, 3.0, 1025)
    content = [
        quad(p, a, b, points=[0.5] if a < 0.5 < b else None, epsabs=1e-18, epsrel=1e-10)[0]
        for a, b in pairwise(edges)
    ]
    depth = 0.5 + width * np.array([-1.0, -0.3, -0.05, 0.0, 0.05, 0.2, 0.5, 1.0, 1.5, 2.0, 2.7])
    x = np.concatenate([np.linspace(-4.0, 0.0, 33), depth])
    content = np.array(content)
    # One standard error of 1e9 independent samples in five bins, about what a minute gives.
    error = np.sqrt(p(x) / (5e9 * (edges[1] - edges[0])))
    exact_reference = of_bins(edges, content, references=(log_r,)).at(x)[0]
    assert np.abs((exact_reference - p(x)) / error).max() < 1.0 / 3.0
    # The reference need not be right: half the steepness, as of twice the temperature.
    half = of_bins(edges, content, references=(lambda q: 0.5 * log_r(q),)).at(x)[0]
    assert np.abs((half - p(x)) / error).max() < 1.0


def test_the_weights_stay_bounded_in_empty_bins_and_steep_flanks():
    """No point of the axis is worth less than one bin's contents: Σ w² < 30."""
    edges, rng = np.linspace(-2.0, 2.0, 1025), np.random.default_rng(5)
    x = np.linspace(-2.0, 2.0, 4001)
    index = windows(edges, x)
    held = np.diff(norm.cdf(edges, scale=0.2)) * 1e9
    for log_r in (np.zeros_like, lambda q: -100.0 * np.maximum(q - 0.5, 0.0) ** 2.5):
        held_there = rng.poisson(held)[index]
        weights, shares = local_fit(edges, x, index, held_there, log_reference=log_r)
        assert np.sum(weights**2, axis=1).max() < 30.0
        np.testing.assert_allclose(shares.sum(axis=1), 1.0, rtol=1e-12)


def excursions(*, batches, per_visit, rng, edges, visits):
    """Counts of samples (batches, bins) that come ``per_visit`` at a time, Poisson many times."""
    share = norm.pdf(0.5 * (edges[1:] + edges[:-1]))
    times = rng.poisson(visits / batches * share / share.max(), size=(batches, share.size))
    # A visit stays near where it turned: its samples within three bins.
    where = np.repeat(np.arange(times.size), per_visit * times.ravel())
    where += rng.integers(-1, 2, where.size)
    return np.bincount(where, minlength=times.size).reshape(times.shape)


def test_rare_bins_are_worth_their_visits_not_their_samples():
    """Twelve samples a visit: |z| where the expected number of visits is 0.2 to 20, 40 seeds.

    With the floor of one sample the mean square is above 20.
    """
    edges, squares, per_visit = np.linspace(-6.0, 6.0, 481), [], 12
    x = np.linspace(2.0, 5.0, 13)
    for seed in range(40):
        rng = np.random.default_rng(seed)
        counts = excursions(batches=64, per_visit=per_visit, rng=rng, edges=edges, visits=400.0)
        h, whole = edges[1] - edges[0], counts.sum()
        sampled = SampledDensity(
            Q1, (edges,), counts.sum(axis=0) / (whole * h), 64 * counts / (whole * h), PASSED,
            one_sample=1.0 / (whole * h),
        )  # fmt: skip
        assert 5.0 < sampled.samples_per_visit < 13.0
        value, error = sampled.at(x)
        squares.append(((value - norm.pdf(x)) / error) ** 2)
    assert 0.3 < np.mean(squares) < 1.25
    assert np.mean(squares, axis=0).max() < 2.0
