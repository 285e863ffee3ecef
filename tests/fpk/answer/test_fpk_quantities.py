"""Moments, probabilities and quantiles of densities against closed forms."""

from functools import cache, partial

import numpy as np
import pytest
from asked import solved
from references import EnergyReference, chain_of, pieces
from scipy import stats
from scipy.special import erfc
from test_fpk_bin_fit import drawn_normal

from averaging import Exact, Linear, NonIntegrable
from fpk import Contact, System
from fpk.answer.certificate import Certificate, Measured
from fpk.answer.contacts import contact_quantities
from fpk.answer.density import Density, certify_density
from fpk.answer.dynamics import upcrossings
from fpk.answer.names import parse_observable
from fpk.answer.quantities import Number
from fpk.numeric.errors import InvalidInput
from fpk.system.linear import stationary_covariance

LINEAR = System([1.0, 2.0], [1.0, 0.5], [0.08, 0.04], [0.01, 0.02])
STOP = Contact(2, "right", 10.0, 0.3)
FREE = System([1.0, 1.0], [1.0, 1.0], [0.08, 0.04], [0.08 * 0.3, 0.04 * 0.3])
EXACT = System([1.0, 1.0], [1.0, 1.0], FREE.damping, FREE.noise_intensity, contacts=(STOP,))
NORMAL = stats.norm()


def assert_within(number, true, most=1.0):
    assert abs(number.value - true) <= most * number.error, (number, true)


@cache
def known(name):
    """A Gaussian, one with contact, and by finite elements the energy of two masses at T = 0.3."""
    method, system, observable = {
        "gaussian": (Linear(), LINEAR, "q1"),
        "momentum": (Linear(), LINEAR, "p1"),
        "contact": (Exact(), EXACT, "q2"),
        "energy": (NonIntegrable(tol=1e-9), FREE, "H"),
    }[name]
    (density,) = solved(method, system, observable)
    return density


GAMMA = stats.gamma(2, scale=0.3)
MOMENTUM = stats.norm(scale=np.sqrt(stationary_covariance(LINEAR)[2, 2]))


SAMPLED = drawn_normal(800, 8, bins=120, batches=8)


def gaussian(mean, mass, tail):
    """A Gaussian density of the variance 1 whose integral is ``mass``, not 1."""

    def pdf(x):
        return mass * np.exp(-0.5 * (x - mean) ** 2) / np.sqrt(2.0 * np.pi)

    nodes = (mean + np.linspace(-8.0, 8.0, 33),)
    measured = Measured(abs(mass - 1.0) + 1e-12, None, 0.0, 0.0, tail)
    q = parse_observable("q1", 1)
    return certify_density(q, nodes, pdf, lambda x: 1e-8 * pdf(x), measured=measured, tol=0.1)


@pytest.mark.parametrize(
    ("name", "law", "most"), [("momentum", MOMENTUM, 1e-7), ("energy", GAMMA, 1e-5)]
)
def test_quantities_err_by_no_more_than_stated(name, law, most):
    density, (mean, variance, skewness, excess) = known(name), map(float, law.stats("mvsk"))
    tenth, high = law.ppf([0.1, 0.9]).tolist()
    for number, true in (
        (density.mean(), mean),
        (density.rms(), np.sqrt(variance + mean**2)),
        (density.std(), law.std()),
        (density.skewness(), skewness),
        (density.kurtosis(), 3.0 + excess),
        (density.moment(6), law.moment(6)),
        (density.cdf(tenth), 0.1),
        (density.probability(tenth, high), 0.8),
        (density.exceedance(2.0 * high), law.sf(2.0 * high)),
        *((density.quantile(p), law.ppf(p)) for p in (1e-3, 0.1, 0.5, 0.9, 0.999)),
    ):
        assert_within(number, true)
        assert number.error < most * max(law.std(), abs(true), 1.0)
    far = density.exceedance(4.0 * high)
    assert_within(far, law.sf(4.0 * high))
    assert far.error < 1e-2 * far.value
    # A deviation that is off by a thousandth is seen.
    assert abs(density.std().value - 1.001 * law.std()) > 100.0 * density.std().error


@pytest.mark.parametrize("power", [1, 2, 4])
def test_an_l1_error_that_is_at_no_point_is_in_the_moments(power):
    """A Gaussian wider by 1e-6 of itself and shifted as much, which states its L1 error alone."""
    wrong = stats.norm(1e-6, 1.0 + 1e-6)
    x = np.linspace(-9.0, 9.0, 20001)
    l1 = float(np.trapezoid(np.abs(NORMAL.pdf(x) - wrong.pdf(x)), x))
    certificate, q1 = Certificate(0.0, 0.0, 0.0, 0.0, 0.0), parse_observable("q1", 2)
    nodes = (np.linspace(-9.0, 9.0, 37),)
    number = Density(q1, nodes, wrong.pdf, np.zeros_like, l1, certificate).moment(power)
    assert_within(number, NORMAL.moment(power))
    assert number.error < 1e3 * abs(number.value - NORMAL.moment(power))


def test_contact_in_an_exact_scene_against_quadrature():
    reference = EnergyReference(chain_of(EXACT))

    def beyond(of):
        ends = STOP.clearance + np.array([0.0, 3.7])
        return pieces(lambda q: of(q - STOP.clearance) * reference.of_displacement(1, q)[0], ends)

    force, touching = beyond(STOP.force), beyond(np.ones_like)
    density = known("contact")
    felt = contact_quantities(STOP, density)
    assert_within(felt["contact probability"], touching)
    assert_within(felt["mean overlap"], beyond(lambda overlap: overlap))
    assert_within(felt["mean force"], force)
    assert_within(felt["force in contact"], force / touching)
    assert felt["mean force"].error < 1e-8 * force
    # In any stationary state K E q + E g = 0: with one stop on the right the mean q2 is −g/k.
    mean, force = density.mean(), felt["mean force"]
    assert_within(Number(2.0 * force.value, 2.0 * force.error + mean.error), -mean.value)
    # A stop that is never reached has no force in contact.
    felt = contact_quantities(Contact(2, "left", 10.0, 1e3), density)
    assert felt["contact probability"].value == 0.0
    assert np.isinf(felt["force in contact"].error)


def test_joint_densities_have_expectations_but_no_quantiles():
    (joint,) = solved(Exact(), EXACT, "q2,p2")
    assert_within(joint.expectation(lambda q, p: p**2), 0.3)
    assert_within(joint.moment(0, 2), 0.3)
    for powers in ((2,), (2, -1), (1, 1, 1), (0.5, 1), ("2", 1)):
        with pytest.raises(InvalidInput, match="each coordinate"):
            joint.moment(*powers)
    for ask in (joint.mean, partial(joint.quantile, 0.5)):
        with pytest.raises(InvalidInput, match="two coordinates"):
            ask()


@pytest.mark.parametrize("value", [[0.1, 0.2], np.array([0.1]), "0.1", None, True, float("nan")])
@pytest.mark.parametrize("name", ["gaussian", "sampled"])
def test_anything_but_one_number_is_refused_by_name(value, name):
    density = SAMPLED if name == "sampled" else known(name)
    for ask in (density.cdf, density.exceedance, density.quantile):
        with pytest.raises(InvalidInput, match=r"^[xp] = .*must be one number"):
            ask(value)
    with pytest.raises(InvalidInput, match=r"^high = .*must be one number"):
        density.probability(-1.0, value)
    for p in (-0.1, 0.0, 1.0):
        with pytest.raises(InvalidInput, match="probability"):
            density.quantile(p)


def test_sampled_quantities_scatter_by_their_standard_error():
    """z of 60 samples: of a mean square of 1 the 1e-5 quantile of chi² is 0.42, beyond is wrong.

    The correction for the bins makes errors larger, so that z² may be somewhat below 1.
    """
    true = np.array([1.0, 3.0, NORMAL.sf(1.03), NORMAL.ppf(0.9)])
    z = []
    for seed in range(60):
        d = drawn_normal(16_000, seed, bins=120, batches=8)
        numbers = d.variance(), d.kurtosis(), d.exceedance(1.03), d.quantile(0.9)
        value, error = np.transpose([(n.value, n.error) for n in numbers])
        z.append((value - true) / error)
    squares = np.mean(np.square(z), axis=0)
    assert np.all((squares > 0.42) & (squares < 2.0)), squares
    assert np.all(np.abs(np.mean(z, axis=0)) < 4.0 / np.sqrt(60.0))


def test_a_tail_without_samples_is_not_zero_for_certain():
    number = SAMPLED.exceedance(5.0)
    assert number.value == 0.0 and number.error >= 1.0 / 800.0


@pytest.mark.parametrize("mass", [0.999, 1.001])
def test_central_moments_hold_where_the_mass_is_off_and_the_mean_is_large(mass):
    p = gaussian(100.0, mass, 0.0)
    numbers = (p.std(), 1.0), (p.variance(), 1.0), (p.skewness(), 0.0), (p.kurtosis(), 3.0)
    for number, true in numbers:
        # The stated error is of the first order in the defect of the mass, 1e-3.
        assert_within(number, true, most=1.0 + 1e-2)


def test_an_unknown_tail_does_not_spoil_an_interval_within_the_support():
    error = gaussian(0.0, 1.0, np.inf).probability(-1.0, 1.0).error
    assert type(error) is float and error < 1e-8  # the relative error of p, times P < 1


@pytest.mark.parametrize("clearance", [8.0, 300.0])
@pytest.mark.parametrize("name", ["gaussian", "energy", "sampled"])
def test_a_stop_far_beyond_the_support_is_not_known_to_have_no_force(clearance, name):
    """The true force is e^(−δ²/2 ...), not 0: the error has to be above it, however far it is."""
    density = SAMPLED if name == "sampled" else known(name)
    felt = contact_quantities(Contact(1, "right", 10.0, clearance), density)
    assert felt["mean force"].error > 0.0 and felt["mean overlap"].error > 0.0


AT = np.array([-2.0, 0.0, 0.7, 5.0])


def joint_of(pdf, nodes, error=0.0, q=9.0):
    """The density ``pdf`` of q1 and p1 on panels to ±``q`` and between ``nodes``."""
    pair, measured = parse_observable("q1,p1", 1), Measured(1e-12, 0.0, 0.0, 0.0, 0.0)
    nodes = np.linspace(-q, q, 19), nodes
    return certify_density(
        pair, nodes, pdf, lambda q, p: error + 0.0 * (q + p), measured=measured, tol=1.0
    )


@pytest.mark.parametrize("panels", [1, 3, 40])
@pytest.mark.parametrize("reach", [1.5, 9.0, 50.0])
@pytest.mark.parametrize("correlation", [0.0, 0.6])
def test_the_error_holds_on_any_mesh(panels, reach, correlation):
    """Of a Gaussian known exactly: E max(p, 0) of a normal p | q, by its mean and deviation."""
    own = np.sqrt(1.0 - correlation**2)

    def pdf(q, p):
        square = (p - correlation * q) ** 2 / own**2 + q**2
        return np.exp(-0.5 * square) / (2.0 * np.pi * own)

    nodes = np.linspace(-reach, reach, 2 * panels + 1)
    joint = joint_of(pdf, nodes)
    values, errors = upcrossings(joint, 2.0, AT)
    z = correlation * AT / own
    flow = own * (np.exp(-0.5 * z * z) / np.sqrt(2.0 * np.pi) + 0.5 * z * erfc(-z / np.sqrt(2.0)))
    exact = np.exp(-0.5 * AT**2) / np.sqrt(2.0 * np.pi) * flow / 2.0
    # 1e-14: the round-off of both formulas.
    assert np.all(np.abs(values - exact) <= errors + 1e-14 * exact)
    if reach == 9.0 and panels == 40:
        assert np.all(errors <= 1e-12 * np.max(exact))


@pytest.mark.parametrize("power", [1.5, 2.5])
def test_a_kink_within_a_panel_is_in_the_error(power):
    """f = (1 − H)^power, H = (q² + p²)/2 < 1: the rate is (1 − q²/2)^(power + 1)/(power + 1)."""

    def pdf(q, p):
        return np.maximum(1.0 - 0.5 * (q**2 + p**2), 0.0) ** power

    joint = joint_of(pdf, np.linspace(-2.0, 2.0, 9), q=2.0)
    at = np.linspace(0.0, 1.2, 2001)
    values, errors = upcrossings(joint, 1.0, at)
    exact = np.maximum(1.0 - 0.5 * at**2, 0.0) ** (power + 1.0) / (power + 1.0)
    missed = np.abs(values - exact) / (errors + 1e-14)
    # As ``DISTANCE_FACTOR`` says of kinks: with one coarser rule up to 15 % are outside, by factors
    # of 200.
    assert np.mean(missed > 1.0) < 0.03 and missed.max() < 3.0


@pytest.mark.parametrize("slope", [0.0, 1e-18, -1e-18])
def test_round_off_at_the_end_does_not_decide_the_error(slope):
    """There f is 0 within its error 1e-12: whether it falls by round-off says nothing."""

    def pdf(q, p):
        end = 1e-14 * (1.0 + slope * 1e14 * (8.0 - p))
        return np.where(np.abs(p) < 7.0, np.exp(-0.5 * (q * q + p * p)) / (2.0 * np.pi), end)

    joint = joint_of(pdf, np.linspace(-8.0, 8.0, 17), error=1e-12)
    _, errors = upcrossings(joint, 1.0, np.zeros(1))
    assert errors[0] < 2e-10  # 1e-12 (e + l) l, l = 8, and what the momenta below that add
