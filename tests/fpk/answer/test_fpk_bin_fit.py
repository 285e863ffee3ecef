"""The density between the edges of bins: exact for what it says, with the errors that it states."""

from functools import reduce
from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import norm

from fpk.answer.bins import BinAxis
from fpk.answer.certificate import Measured, certify
from fpk.answer.names import parse_observable
from fpk.answer.sampled_density import SampledDensity

PASSED = certify(Measured(0.0, 0.0, 0.0, 0.0, 0.0), tol=1.0)
Q1, PAIR = parse_observable("q1", 1), parse_observable("q1,p1", 1)
BATCHES = 64


def contents(p, edges):
    """Integrals of ``p`` over the bins between ``edges``, which hold its kinks."""
    return np.array([quad(p, a, b, epsabs=1e-18, epsrel=1e-11)[0] for a, b in pairwise(edges)])


def drawn(axes, share, samples, seed, observable=Q1, *, batches=BATCHES):
    """A density of independent samples in equal batches, of the probabilities ``share`` of bins."""
    shape, each = share.shape, int(samples) // batches
    share = np.append(share, max(1.0 - share.sum(), 0.0))
    counts = np.random.default_rng(seed).multinomial(each, share / share.sum(), size=batches)
    area = reduce(np.multiply.outer, [np.diff(axis.edges) for axis in axes])
    values = counts[:, :-1].reshape(batches, *shape) / each / area
    return SampledDensity(observable, axes, values.mean(axis=0), values, PASSED, samples=samples)


def drawn_normal(samples, seed, *, bins, batches):
    """Samples of the standard normal density: the first displacement of two masses."""
    axis = BinAxis(np.linspace(-6.0, 6.0, bins + 1))
    share = np.diff(norm.cdf(axis.edges))
    return drawn((axis,), share, samples, seed, parse_observable("q1", 2), batches=batches)


def test_polynomials_of_ln_p_are_exact_everywhere(bins=24):
    """Times the reference, at both ends, too: of exact contents only the quadrature is left."""
    axis = BinAxis(np.linspace(0.0, 2.0, bins + 1), (), lambda y, bins: -3.0 * y**2)

    def p(y):
        return np.exp(-3.0 * y**2 + 0.4 * y - 0.3 * y**3 + 0.001 * y**8) / 2.0

    values = contents(p, axis.edges) / np.diff(axis.edges)
    density = SampledDensity(
        Q1, (axis,), values, np.tile(values, (BATCHES, 1)), PASSED, samples=1e14
    )
    x = np.linspace(0.0, 2.0, 37)
    # Newton's method ends 1e-2 standard errors from the maximum, 3e-4 of p where it is least; three
    # Gauss points a bin of h = 1/12 integrate e^(−12 h t), the steepest, to 3e-6.
    np.testing.assert_allclose(density(x), p(x), rtol=1e-5)


@pytest.mark.parametrize("width", [0.25, 1e-3])
def test_a_layer_of_any_width_beyond_a_stop_is_right(width):
    """A normal density cut off by a Hertz stop, ``width`` standard deviations of it to e⁻¹.

    Bins end at the stop and, beyond it, are on the scale of the layer. The temperature of the
    reference is off by a factor of two. Of 40 independent z a mean square of 1 lies between .45 and
    1.85 but for 1e-3.
    """

    def log_r(q):
        return -(np.maximum((q - 0.5) / width, 0.0) ** 2.5)

    def p(q):
        return norm.pdf(q) * np.exp(log_r(q))

    below, beyond = np.linspace(-5.0, 0.5, 513), 0.5 + 4.0 * width * np.linspace(0.0, 1.0, 257)[1:]
    axis = BinAxis(np.concatenate([below, beyond]), (0.5,), lambda q, bins: 0.5 * log_r(q))
    whole = contents(p, axis.edges)
    x = np.array(
        [-3.0, -1.0, 0.3, 0.5 - 1e-6, 0.5, 0.5 + 0.3 * width, 0.5 + width, 0.5 + 2 * width]
    )
    z = []
    for seed in range(5):
        density = drawn((axis,), whole / whole.sum(), 64e6, seed)
        value, error = density.at(x)
        z.append((value - p(x) / whole.sum()) / error)
        assert not density.are_unresolved(x[None]).any() and np.all(error[:5] < 0.01 * value[:5])
    assert 0.45 < np.mean(np.square(z)) < 1.85 and np.abs(z).max() < 5.0


def test_a_spike_within_a_bin_is_unresolved():
    edges = np.linspace(-1.0, 1.0, 257)
    share = np.diff(norm.cdf(edges, 0.3, 1e-4)) * 0.5 + np.diff(norm.cdf(edges, 0.0, 0.2)) * 0.5
    density = drawn((BinAxis(edges),), share, 64e4, 1)
    x = np.array([-0.5, 0.3, 0.9])
    assert density.are_unresolved(x[None]).tolist() == [False, True, False]


def test_two_coordinates_have_the_errors_they_state():
    """A normal pair of correlation 0.6 with a kink at x = 0.5: z of nine points, ten seeds."""
    edges = np.concatenate([np.linspace(-5.0, 0.5, 65), np.linspace(0.5, 4.0, 33)[1:]])
    axes = BinAxis(edges, (0.5,)), BinAxis(np.linspace(-5.0, 5.0, 97))

    def p(x, y):
        slope = np.exp(-np.maximum(x - 0.5, 0.0))
        return slope * np.exp(-0.5 * (x * x - 1.2 * x * y + y * y) / 0.64)

    nodes, w = np.polynomial.legendre.leggauss(4)
    grids = [
        0.5 * (a.edges[1:] + a.edges[:-1])[:, None] + 0.5 * np.diff(a.edges)[:, None] * nodes
        for a in axes
    ]
    weight = [0.5 * np.diff(a.edges)[:, None] * w for a in axes]
    values = p(grids[0].ravel()[:, None], grids[1].ravel()) * np.outer(*(v.ravel() for v in weight))
    share = values.reshape(96, 4, 96, 4).sum(axis=(1, 3))
    whole = share.sum()
    x, y = (g.ravel() for g in np.meshgrid([-1.0, 0.5, 0.8], [-1.0, 0.0, 1.5]))
    z = []
    for seed in range(10):
        density = drawn(axes, share / whole, 6.4e6, seed, PAIR)
        value, error = density.at(x, y)
        z.append((value - p(x, y) / whole) / error)
        assert not density.are_unresolved(np.stack([x, y])).any()
    # Of 90 nearly independent z the mean square is between .6 and 1.5 but for 1e-3.
    assert 0.6 < np.mean(np.square(z)) < 1.5 and np.abs(z).max() < 5.0


def test_rare_bins_are_worth_their_visits_not_their_samples():
    """Twelve samples a visit: |z| where the expected number of visits is 0.2 to 20, 40 seeds.

    There are Poisson many visits, and each stays near where it turned: within three bins.

    With the floor of one sample the mean square is above 20.
    """
    edges, squares = np.linspace(-6.0, 6.0, 481), []
    h, x = edges[1] - edges[0], np.linspace(2.0, 5.0, 13)
    share = norm.pdf(0.5 * (edges[1:] + edges[:-1]))
    for seed in range(40):
        rng = np.random.default_rng(seed)
        visits = rng.poisson(400.0 / 64 * share / share.max(), size=(64, share.size))
        where = np.repeat(np.arange(visits.size), 12 * visits.ravel())
        where += rng.integers(-1, 2, where.size)
        counts = np.bincount(where, minlength=visits.size).reshape(visits.shape)
        whole = counts.sum()
        sampled = SampledDensity(
            Q1, (BinAxis(edges),), counts.sum(axis=0) / (whole * h), 64 * counts / (whole * h),
            PASSED, samples=whole,
        )  # fmt: skip
        assert 5.0 < sampled.visit * sampled.samples < 13.0
        value, error = sampled.at(x)
        squares.append(((value - norm.pdf(x)) / error) ** 2)
    assert 0.2 < np.mean(squares) < 1.25
    assert np.mean(squares, axis=0).max() < 2.5
