"""Densities and histograms: integrals, cell averages, standard errors, smoothing, refusals."""

import numpy as np
import pytest
from scipy.stats import norm
from test_fpk_bin_fit import PASSED, drawn_normal

from fpk.answer.bins import BinAxis
from fpk.answer.certificate import Measured, largest_measured
from fpk.answer.density import (
    Density,
    bin_differences,
    certify_density,
    distance_with_error,
    l1_distance,
)
from fpk.answer.dynamics import certify_curve
from fpk.answer.method import Method
from fpk.answer.names import Coordinate, observable_name, parse_observable
from fpk.answer.sampled_density import SampledDensity
from fpk.numeric.errors import InvalidInput
from fpk.system.system import System

REACH = 9.0
SEED = 30577


def normal(shift=0.0, scale=1.0, *, panels=36, name="q1"):
    def pdf(x):
        return norm.pdf(x, shift, scale)

    nodes = np.linspace(shift - REACH * scale, shift + REACH * scale, panels + 1)
    return Density(parse_observable(name, 2), (nodes,), pdf, lambda x: 0.0 * x, 0.0, PASSED)


def correlated(r=0.6, scale=1.0):
    """Two normal variables of one standard deviation ``scale`` with the correlation ``r``."""

    def pdf(x, y):
        form = (x * x - 2.0 * r * x * y + y * y) / (1.0 - r * r) / scale**2
        return np.exp(-0.5 * form) / (2.0 * np.pi * scale**2 * np.sqrt(1.0 - r * r))

    nodes = np.linspace(-REACH * scale, REACH * scale, 37)
    pair = parse_observable("q1,p1", 1)
    return Density(pair, (nodes, nodes), pdf, lambda x, y: 0.0 * x * y, 0.0, PASSED)


def histogram(*, bins=480):
    return drawn_normal(1e7, SEED, bins=bins, batches=100)


# 20 Gauss points per half a standard deviation: only round-off is left, some 1e-15.


@pytest.mark.parametrize("scale", [1.01, 2.7])
def test_the_error_of_a_distance_holds_where_densities_cross_between_nodes(scale):
    # p_1 = p_2 at r² = 2 ln(σ²)/(1 − 1/σ²) in two coordinates, of half as much in one: there the
    # probabilities within, erf(r/√2) and 1 − e^(−r²/2), differ by half of the distance.
    square = np.log(scale**2) / (1.0 - scale**-2)
    within = [2.0 * norm.cdf(np.sqrt(square) / s) - 1.0 for s in (1.0, scale)]
    found, error = distance_with_error(normal(), normal(scale=scale))
    assert abs(found - 2.0 * (within[0] - within[1])) <= error + 1e-14 and error < 1e-12
    within = [1.0 - np.exp(-square / s**2) for s in (1.0, scale)]
    found, error = distance_with_error(correlated(0.0), correlated(0.0, scale))
    assert abs(found - 2.0 * (within[0] - within[1])) <= error and error < 1e-3 * found


def test_cell_averages_of_a_normal_density():
    edges = np.array([-4.0, -1.3, 0.1, 0.2, 2.7, 8.0])
    expected = np.diff(norm.cdf(edges)) / np.diff(edges)
    np.testing.assert_allclose(normal().cell_averages(edges), expected, rtol=1e-12)
    assert correlated(0.6).moment(2, 2).value == pytest.approx(1.0 + 2.0 * 0.36, rel=1e-13)
    two = correlated(0.0).cell_averages(edges, edges[1:])
    np.testing.assert_allclose(two, np.outer(expected, expected[1:]), rtol=1e-12)


def test_standard_errors_are_those_of_the_multinomial():
    sampled = histogram()
    (edges,) = sampled.edges
    share = np.diff(norm.cdf(edges))
    samples = 100 * 100_000
    exact = np.sqrt(share * (1.0 - share) / samples) / np.diff(edges)
    full = share * samples > 1000.0
    assert full.sum() > 200
    # The ratio of each is known to 1/√(2·99) = 7 %; the mean of some 240 to 0.4 %: 5 σ = 2 %.
    ratio = sampled.standard_error[full] / exact[full]
    assert ratio.mean() == pytest.approx(1.0, abs=0.02)
    z = bin_differences(sampled, normal())[full] / exact[full]
    # χ² of some 240 bins: 5 σ is 5 √(2/300); the largest of 240 |z| stays below 5 (1 in 5000).
    assert np.mean(z * z) == pytest.approx(1.0, abs=5.0 * np.sqrt(2.0 / full.sum()))
    assert np.abs(z).max() < 5.0


def test_coarser_bins_hold_the_same_mass(factor=48):
    sampled = histogram()
    coarse = sampled.joined(factor)
    assert coarse.moment(0).value == pytest.approx(sampled.moment(0).value, rel=1e-14)
    assert coarse.values.size * factor == sampled.values.size
    # The errors are those of the joined counts, and the differences stay linear.
    np.testing.assert_allclose(coarse.batch_values.mean(axis=0), coarse.values, rtol=1e-12)
    differences = bin_differences(sampled, normal()).reshape(-1, factor).mean(axis=1)
    np.testing.assert_allclose(bin_differences(coarse, normal()), differences, atol=1e-14)
    assert sampled.joined(7).values.size * 6 == sampled.values.size
    axis, values = BinAxis(np.linspace(0.0, 1.0, 7)), np.random.default_rng(SEED).random((6, 6))
    batches = np.stack([values, values])
    two = SampledDensity(parse_observable("q1,p1", 1), (axis, axis), values, batches, PASSED)
    assert two.joined(3).values[1, 0] == pytest.approx(values[3:, :3].mean(), rel=1e-14)


def test_distance_to_a_histogram_is_that_of_the_bins():
    sampled = histogram()
    # Expected L1 of pure sampling noise: Σ √(2/π) σ_bin · width.
    expected = np.sqrt(2.0 / np.pi) * np.sum(sampled.standard_error * np.diff(sampled.edges[0]))
    assert l1_distance(sampled, normal()) == pytest.approx(expected, rel=0.25)
    assert l1_distance(normal(), sampled) == l1_distance(sampled, normal())
    assert l1_distance(sampled, normal(0.5)) > 0.3


def test_what_lies_outside_the_bins_counts():
    # The densities N(0, 1) and N(0, 3²) cross at ±x; a tenth of the latter is beyond ±5.
    edges = np.linspace(-5.0, 5.0, 1001)
    values = np.diff(norm.cdf(edges)) / np.diff(edges)
    q1, batches = parse_observable("q1", 2), np.tile(values, (4, 1))
    sampled = SampledDensity(q1, (BinAxis(edges),), values, batches, PASSED)
    x = np.sqrt(2.0 * np.log(3.0) / (1.0 - 1.0 / 9.0))
    expected = 4.0 * (norm.cdf(x) - norm.cdf(x / 3.0))
    assert l1_distance(sampled, normal(scale=3.0)) == pytest.approx(expected, rel=1e-4)
    inside = np.abs(bin_differences(sampled, normal(scale=3.0))) @ np.diff(edges)
    assert expected - inside == pytest.approx(2.0 * norm.sf(5.0 / 3.0), rel=1e-3)


def test_what_cannot_be_compared_is_refused():
    with pytest.raises(ValueError, match="q1 and of q2"):
        l1_distance(normal(), normal(name="q2"))
    with pytest.raises(ValueError, match="same bins"):
        l1_distance(histogram(), histogram(bins=240))
    with pytest.raises(ValueError, match="q2 and of q1"):
        l1_distance(normal(name="q2"), histogram())


@pytest.mark.parametrize("density", [normal(), correlated(), histogram()])
def test_points_of_another_number_of_coordinates_are_refused(density):
    points = np.zeros((3, 3))
    with pytest.raises(InvalidInput, match="one for each coordinate"):
        density.at(*points)


@pytest.mark.parametrize(("error", "certified"), [(2e-6, True), (5e-7, False)])
def test_a_density_may_be_negative_within_its_stated_error(error, certified):
    # A wave of 1e-6 of the maximum: negative in the tails by as much.
    def pdf(x):
        return norm.pdf(x) + 1e-6 * norm.pdf(0.0) * np.sin(3.0 * x)

    made = certify_density(
        parse_observable("q1", 1),
        (np.linspace(-REACH, REACH, 37),),
        pdf,
        lambda x: np.full(np.shape(x), error * norm.pdf(0.0)),
        measured=Measured(1e-4, np.nan, np.inf, 0.0, 0.0),
        tol=1e-3,
    )
    assert made.certificate.minimum == pytest.approx(-1e-6, rel=0.01)
    assert made.certificate.certified is certified
    assert certified or "falls to -1e-06" in made.certificate.failures[0]


def test_the_worst_of_several_measurements_is_nan_if_any_is():
    assert np.isnan(largest_measured([1.0, np.nan])) and np.isnan(
        largest_measured([np.nan, None, 1.0])
    )
    assert largest_measured([None, 2.0, 1.0]) == 2.0 and largest_measured([None]) is None


def test_a_curve_inherits_the_failures_of_its_density_but_not_its_tolerance():
    measured = Measured(1e-3, 0.0, 0.0, 0.0, 0.0, failures=("the ladder ended",))
    q1, nodes = parse_observable("q1", 1), (np.array([0.0, 1.0]),)
    density = certify_density(q1, nodes, np.ones_like, np.zeros_like, measured=measured, tol=1e-6)
    assert density.certificate.missed is not None and not density.certificate.certified
    curve = certify_curve(np.ones(1), np.zeros(1), scale=1.0, of=density, tol=1e-6)
    assert curve.certificate.failures == ("the ladder ended",)


@pytest.mark.parametrize(
    "text", ["q1", "p3", "H", "H3", "q2,p2", "p1,p3", "q1,q2", "H,q1", "H1,H2"]
)
def test_names_survive_the_round_trip(text):
    assert observable_name(parse_observable(text, 3)) == text


def test_indices_count_from_zero_inside():
    assert parse_observable(" q2 , p1", 2) == (Coordinate("q", 1), Coordinate("p", 0))
    assert parse_observable("H", 1) == (Coordinate("H"),)
    assert parse_observable("q1000", 1000) == (Coordinate("q", 999),)


@pytest.mark.parametrize(
    "text",
    [
        *("", "q", "p", "q0", "q4", "p4", "H4", "x1", "Q1", "q1,", ",q1", "q1,q1", "q1,q2,q3"),
        *("q-1", "q1.0", "q01", "q²", "q１", "q1 p1", "h", "q1;p1", "q99999"),
    ],
)
def test_what_is_not_an_observable_is_refused_by_name(text):
    with pytest.raises(InvalidInput, match=r"^observable = ") as caught:
        parse_observable(text, 3)
    assert caught.value.value == text


@pytest.mark.parametrize("observables", [["q2"], "q2", [3], [()], [("q", 1)]])
def test_a_method_refuses_an_observable_that_is_not_parsed(observables):
    system = System([1, 1], [1, 1], [0.08, 0.04], [0.01, 0.02])

    class Never(Method):
        route = refined = None

        def prepare(self, system):
            raise AssertionError("prepared")

    with pytest.raises(InvalidInput, match="is not parsed; use parse_observable"):
        Never().solve(system, observables)
