"""Moments, probabilities and quantiles of densities against closed forms."""

import pickle
from functools import partial

import numpy as np
import pytest
from scipy import stats
from scipy.linalg import solve_continuous_lyapunov

from averaging.gaussian import Linear
from averaging.nonintegrable import NonIntegrable
from averaging.theory import Exact
from fpk.answer.bins import BinAxis
from fpk.answer.certificate import Certificate, Measured
from fpk.answer.contacts import contact_quantities
from fpk.answer.density import Density, certify_density
from fpk.answer.names import parse_observable
from fpk.answer.quantities import Number
from fpk.answer.sampled_density import SampledDensity
from fpk.numeric.errors import InvalidInput
from fpk.system.contact import Contact
from fpk.system.system import System
from sim.montecarlo import MonteCarlo

LINEAR = System([1.0, 2.0], [1.0, 0.5], [0.08, 0.04], [0.01, 0.02])
STOP = Contact(2, "right", 10.0, 0.3)
EXACT = System([1.0, 1.0], [1.0, 1.0], [0.08, 0.04], [0.08 * 0.3, 0.04 * 0.3], contacts=(STOP,))


def deviation(system: System, name: str) -> float:
    """Standard deviation of q or p without contact, from the Lyapunov equation of (q, p)."""
    n, v = system.n, np.diag(1.0 / system.mass)
    A = np.block([[np.zeros((n, n)), v], [-system.stiffness_matrix, -system.damping @ v]])
    b = np.zeros((2 * n, 2 * n))
    b[n:, n:] = 2.0 * system.noise_matrix
    row = "qp".index(name[0]) * n + int(name[1]) - 1
    return float(np.sqrt(solve_continuous_lyapunov(A, -b)[row, row]))


def assert_within(number: Number, true: float, most: float = 1.0) -> None:
    assert abs(number.value - true) <= most * number.error, (number, true)


def solved(method, system, name):
    (density,) = method.solve(system, [parse_observable(name, system.n)]).densities
    return density


GAUSSIAN = solved(Linear(), LINEAR, "q1")


@pytest.mark.parametrize("name", ["q1", "q2", "p1"])
def test_quantities_of_a_gaussian_are_those_of_scipy(name):
    density = solved(Linear(), LINEAR, name)
    normal = stats.norm(scale=deviation(LINEAR, name))
    for number, true in (
        (density.mean(), 0.0),
        (density.rms(), normal.std()),
        (density.std(), normal.std()),
        (density.skewness(), 0.0),
        (density.kurtosis(), 3.0),
        (density.moment(6), 15.0 * normal.var() ** 3),
        (density.cdf(0.3), normal.cdf(0.3)),
        (density.exceedance(4.0 * normal.std()), normal.sf(4.0 * normal.std())),
        *((density.quantile(p), normal.ppf(p)) for p in (1e-6, 0.1, 0.5, 0.9, 1.0 - 1e-6)),
    ):
        assert_within(number, true)
        assert number.error < 1e-7 * max(normal.std(), abs(true), 1.0)


def gamma_energies() -> tuple[Density, object]:
    """H of two masses in equilibrium at the temperature 0.3: a gamma distribution."""
    free = System([1.0, 1.0], [1.0, 1.0], [0.08, 0.04], [0.08 * 0.3, 0.04 * 0.3])
    return solved(NonIntegrable(solver="fem", tol=1e-9), free, "H"), stats.gamma(2, scale=0.3)


def test_quantities_of_finite_elements_err_by_what_they_state():
    density, gamma = gamma_energies()
    mean, variance, skewness, excess = (float(x) for x in gamma.stats("mvsk"))
    assert_within(density.mean(), mean)
    assert_within(density.variance(), variance)
    assert_within(density.skewness(), skewness)
    assert_within(density.kurtosis(), 3.0 + excess)
    for x in (0.01, 0.5, 2.0, 5.0):
        assert_within(density.exceedance(x), gamma.sf(x))
        assert_within(density.cdf(x), gamma.cdf(x))
        assert_within(density.probability(x, 2.0 * x), gamma.cdf(2.0 * x) - gamma.cdf(x))
    for p in (1e-3, 0.5, 0.999):
        assert_within(density.quantile(p), gamma.ppf(p))
    assert density.exceedance(5.0).error < 1e-2 * density.exceedance(5.0).value


def test_quantiles_of_a_momentum_by_averaging():
    """Nothing lies below the support, where such a density takes no empty list of points."""
    stop = Contact(1, "both", 10.0, 0.3)
    one = System([1.0], [1.0], [0.08], [0.08 * 0.3], contacts=(stop,))
    density = solved(NonIntegrable(solver="fem"), one, "p1")
    low, high = density.panels[0][[0, -1]]
    assert_within(density.cdf(low), 0.0)
    assert_within(density.exceedance(2.0 * high), 0.0)
    assert_within(density.quantile(0.01), stats.norm.ppf(0.01, scale=np.sqrt(0.3)))


def test_a_wrong_density_is_seen_by_its_moments():
    density, gamma = gamma_energies()
    assert abs(density.mean().value - 1.001 * gamma.mean()) > 100.0 * density.mean().error


@pytest.mark.parametrize("power", [1, 2, 4])
def test_an_l1_error_that_is_at_no_point_is_in_the_moments(power):
    """A Gaussian wider by 1e-6 of itself and shifted as much, which states its L1 error alone."""
    normal, wrong = stats.norm(0.0, 1.0), stats.norm(1e-6, 1.0 + 1e-6)
    nodes = np.linspace(-9.0, 9.0, 37)
    x = np.linspace(-9.0, 9.0, 20001)
    l1 = float(np.trapezoid(np.abs(normal.pdf(x) - wrong.pdf(x)), x))
    density = Density(
        parse_observable("q1", 2), (nodes,), wrong.pdf, np.zeros_like, l1,
        Certificate(l1_error=0.0, mass_defect=0.0, minimum=0.0, residual=0.0, tail_mass=0.0),
    )  # fmt: skip
    number = density.moment(power)
    assert_within(number, normal.moment(power))
    assert number.error < 1e3 * abs(number.value - normal.moment(power))


def test_contact_in_an_exact_scene_against_quadrature():
    density = solved(Exact(), EXACT, "q2")

    def weight(q: np.ndarray) -> np.ndarray:
        # q1 is Gaussian given q2: the springs in series have the stiffness 1/2.
        overlap = np.maximum(q - STOP.clearance, 0.0)
        return np.exp(-(0.25 * q**2 + STOP.energy(overlap)) / 0.3)

    x, w = np.polynomial.legendre.leggauss(2000)
    low, high = -9.0, 4.0
    parts = []
    for a, b in ((low, STOP.clearance), (STOP.clearance, high)):
        # The squares of distances from the stop: the force is smooth in their roots.
        y, v = 0.5 * (x + 1.0), 0.5 * w
        parts.append(
            (b + (a - b) * y**2, (b - a) * 2.0 * y * v)
            if b == STOP.clearance
            else (a + (b - a) * y**2, (b - a) * 2.0 * y * v)
        )
    total = sum(w @ weight(q) for q, w in parts)
    (q, w) = parts[1]
    force = w @ (weight(q) * STOP.force(q - STOP.clearance)) / total
    touching = w @ weight(q) / total
    felt = contact_quantities(STOP, density)
    assert_within(felt["contact probability"], touching)
    assert_within(felt["mean overlap"], w @ (weight(q) * (q - STOP.clearance)) / total)
    assert_within(felt["mean force"], force)
    assert_within(felt["force in contact"], force / touching)
    assert felt["mean force"].error < 1e-8 * force


def test_the_mean_force_of_stops_and_springs_balances():
    """In any stationary state K E q + E g = 0: with one stop on the right the mean q2 is −g/k."""
    density = solved(Exact(), EXACT, "q2")
    force = contact_quantities(STOP, density)["mean force"]
    assert_within(
        Number(2.0 * force.value, 2.0 * force.error + density.mean().error), -density.mean().value
    )


def test_a_stop_that_is_never_reached_has_no_force_in_contact():
    far = Contact(2, "left", 10.0, 1e3)
    felt = contact_quantities(far, solved(Exact(), EXACT, "q2"))
    assert felt["contact probability"].value == 0.0
    assert np.isinf(felt["force in contact"].error)


def test_joint_densities_have_expectations_but_no_quantiles():
    joint = solved(Exact(), EXACT, "q2,p2")
    assert_within(joint.expectation(lambda q, p: p**2), 0.3)
    assert_within(joint.moment(0, 2), 0.3)
    for powers in ((2,), (2, -1), (1, 1, 1), (0.5, 1), ("2", 1)):
        with pytest.raises(InvalidInput, match="each coordinate"):
            joint.moment(*powers)
    with pytest.raises(InvalidInput, match="two coordinates"):
        joint.quantile(0.5)
    with pytest.raises(InvalidInput, match="two coordinates"):
        joint.mean()


@pytest.mark.parametrize("p", [-0.1, 0.0, 1.0])
def test_no_quantile_of_what_is_no_probability(p):
    with pytest.raises(InvalidInput, match="probability"):
        solved(Linear(), LINEAR, "q1").quantile(p)


@pytest.mark.parametrize("value", [[0.1, 0.2], np.array([0.1]), "0.1", None, True, float("nan")])
@pytest.mark.parametrize("name", ["cdf", "exceedance", "quantile"])
@pytest.mark.parametrize("sampled", [False, True], ids=["function", "histogram"])
def test_anything_but_one_number_is_refused_by_name(value, name, sampled):
    density = histogram(np.random.default_rng(1).normal(size=800), 20, 4.0) if sampled else GAUSSIAN
    with pytest.raises(InvalidInput, match=r"^[xp] = .*must be one number"):
        getattr(density, name)(value)
    with pytest.raises(InvalidInput, match=r"^high = .*must be one number"):
        density.probability(-1.0, value)


@pytest.mark.parametrize("x", [1, np.float32(1.0), np.int64(1)])
def test_any_real_number_will_do(x):
    assert GAUSSIAN.cdf(x) == GAUSSIAN.cdf(1.0)


def histogram(samples: np.ndarray, bins: int, reach: float) -> SampledDensity:
    """Histogram of independent normal samples in eight batches, made as a simulation makes one."""
    edges = np.linspace(-reach, reach, bins + 1)
    width = edges[1] - edges[0]
    batches = np.array([np.histogram(s, edges)[0] for s in np.split(samples, 8)])
    values = batches / (samples.size / 8) / width
    outside = float(np.mean(np.abs(samples) > reach))
    return SampledDensity(
        parse_observable("q1", 2),
        (BinAxis(edges),),
        values.mean(axis=0),
        values,
        Certificate(l1_error=0.0, mass_defect=0.0, minimum=0.0, residual=0.0, tail_mass=outside),
        samples=samples.size,
    )


def test_sampled_quantities_scatter_by_their_standard_error():
    """z of 60 samples: of a mean square of 1 the 1e-5 quantile of chi² is 0.42, beyond is wrong.

    The correction for the bins makes errors larger, so that z² may be somewhat below 1.
    """
    rng = np.random.default_rng(5)
    normal = stats.norm()
    asked = {
        "variance": (lambda d: d.variance(), 1.0),
        "kurtosis": (lambda d: d.kurtosis(), 3.0),
        "exceedance": (lambda d: d.exceedance(1.03), normal.sf(1.03)),
        "quantile": (lambda d: d.quantile(0.9), normal.ppf(0.9)),
    }
    z = {name: [] for name in asked}
    for _ in range(60):
        density = histogram(rng.standard_normal(16_000), 120, 6.0)
        for name, (ask, true) in asked.items():
            number = ask(density)
            z[name].append((number.value - true) / number.error)
    for name, values in z.items():
        assert 0.42 < np.mean(np.square(values)) < 2.0, name
        assert abs(np.mean(values)) < 4.0 / np.sqrt(60.0), name


def test_wide_bins_do_not_bias_moments():
    """Bins of half a standard deviation: were samples spread evenly the variance would err by 2 %.

    By the fitted density the quadratic has no error left: three standard errors are 0.7 %.
    """
    rng = np.random.default_rng(6)
    number = histogram(rng.standard_normal(400_000), 24, 6.0).variance()
    assert abs(number.value - 1.0) < 3.0 * np.sqrt(2.0 / 400_000)
    assert_within(number, 1.0, most=3.0)


def test_what_no_sample_saw_is_not_zero_for_certain():
    density = histogram(np.random.default_rng(7).standard_normal(800), 120, 6.0)
    number = density.exceedance(5.0)
    assert number.value == 0.0
    assert number.error >= 1.0 / 800.0


def test_quantities_of_simulation_lie_within_its_errors():
    """4.5 standard errors of a normal estimate: by chance of one in 1e5.

    As the trajectories are independent, errors are no larger than those of as many samples.
    """
    paths, sigma = 4096, deviation(LINEAR, "q2")
    density = solved(MonteCarlo(paths=paths, relaxations=10.0, seed=3), LINEAR, "q2")
    tail = stats.norm.sf(1.0)
    for number, true, deviation_of_one in (
        (density.mean(), 0.0, sigma),
        (density.std(), sigma, sigma / np.sqrt(2.0)),
        (density.kurtosis(), 3.0, np.sqrt(24.0)),
        (density.exceedance(sigma), tail, np.sqrt(tail * (1.0 - tail))),
    ):
        assert_within(number, true, most=4.5)
        assert number.error < deviation_of_one / np.sqrt(paths)


def test_quantities_can_be_asked_of_a_copy():
    density = solved(Linear(), LINEAR, "q1")
    again = pickle.loads(pickle.dumps(density))
    assert again.cdf(0.1) == density.cdf(0.1)
    assert partial(again.moment, 2)() == density.moment(2)


def gaussian(mean: float, mass: float, tail: float) -> Density:
    """A Gaussian density of the variance 1 whose integral is ``mass``, not 1."""

    def pdf(x):
        return mass * np.exp(-0.5 * (x - mean) ** 2) / np.sqrt(2.0 * np.pi)

    nodes = (mean + np.linspace(-8.0, 8.0, 33),)
    measured = Measured(abs(mass - 1.0) + 1e-12, None, 0.0, 0.0, tail)
    q = parse_observable("q1", 1)
    return certify_density(q, nodes, pdf, lambda x: 1e-8 * pdf(x), measured=measured, tol=0.1)


@pytest.mark.parametrize("mass", [0.999, 1.001])
def test_central_moments_hold_where_the_mass_is_off_and_the_mean_is_large(mass):
    p = gaussian(100.0, mass, 0.0)
    for number, true in (
        (p.std(), 1.0),
        (p.variance(), 1.0),
        (p.skewness(), 0.0),
        (p.kurtosis(), 3.0),
    ):
        # The stated error is of the first order in what the mass is off by, 1e-3.
        assert abs(number.value - true) <= (1.0 + 1e-2) * number.error


def test_an_unknown_tail_does_not_spoil_an_interval_within_the_support():
    error = gaussian(0.0, 1.0, np.inf).probability(-1.0, 1.0).error
    assert type(error) is float and error < 1e-8  # the relative error of p, times P < 1


@pytest.mark.parametrize("clearance", [8.0, 30.0, 300.0])
def test_a_stop_far_beyond_the_support_is_not_known_to_have_no_force(clearance):
    """The true force is e^(−δ²/2 ...), not 0: the error has to be above it, however far it is."""
    far = Contact(1, "right", 10.0, clearance)
    sampled = histogram(np.random.default_rng(8).standard_normal(800), 120, 6.0)
    for density in (solved(Linear(), LINEAR, "q1"), gamma_energies()[0], sampled):
        felt = contact_quantities(far, density)
        assert felt["mean force"].error > 0.0 and felt["mean overlap"].error > 0.0
