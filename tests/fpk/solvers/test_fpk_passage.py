"""One energy in time: first passage, densities, relaxation rates, and the contour behind them."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from processes import cox_ingersoll_ross, density, failure, moments, mp, rate
from systems import both, fig6

from averaging.energy_process import energy_process
from fpk.numeric.errors import InvalidInput, NotApplicable
from fpk.numeric.quadrature import panel_rule
from fpk.solvers.line.stationary import solve_stationary
from fpk.solvers.line.time import resolvent
from fpk.solvers.line.time.passage import chain_first_passage, fem_passage
from fpk.solvers.line.time.resolvent import contours, relaxation_spectrum
from fpk.solvers.line.time.transition import Source, transition
from fpk.solvers.square_root import SquareRoot
from fpk.system.contact import Contact

NONE = np.zeros(0)


def process(n, c=1.0, d=1.0):
    return cox_ingersoll_ross(a=n * d, c=c, d=d)


# Masses, limit in temperatures: mean times of 1e-4 to 4e291 units.
CASES = [(1, 1e-4), (2, 30.0), (4, 680.0), (100, 150.0)]


@pytest.mark.parametrize(("n", "x"), CASES)
@pytest.mark.parametrize("solver", ["fem", "closed-form"])
def test_mean_and_variance_keep_their_digits_at_any_size(n, x, solver):
    c, d = 2.0, 0.5
    exact = moments(n, x)
    for share in (0.0, 0.5, 0.95):
        start = share * x * d / c
        if solver == "fem":
            answer = fem_passage(process(n, c, d), x * d / c, Source(start), NONE, tol=1e-10)
        else:
            answer = SquareRoot(n, c, d).passage(x * d / c, start, NONE, tol=1e-10)
        assert answer.certificate.certified
        below = moments(n, share * x)
        for number, power in ((answer.mean, 1), (answer.variance, 2)):
            true = (exact[power - 1] - below[power - 1]) / mp.mpf(c) ** power
            if true > 1e308:
                assert number.value == np.inf
                continue
            # Roundings: eight for each unit of ln π, of which π ~ H^(n−1) has hundreds, too.
            assert number.error < 1e-11 * true * (1.0 + (n + x) / 100.0)
            assert abs(number.value - true) <= number.error


@pytest.mark.parametrize(("n", "x"), CASES)
def test_the_failure_rate_is_the_least_zero_of_the_confluent_function(n, x):
    value, error = chain_first_passage(process(n), x, times=NONE).rate()
    closed = SquareRoot(n, 1.0, 1.0).passage(x, 0.0, NONE, tol=1e-10).rate
    assert error < 1e-11 * value and closed.error < 1e-11 * value
    assert abs(value - closed.value) <= error + closed.error
    if x < 100.0:
        assert abs(value - rate(n, x, value)) <= error


def test_the_probability_of_failure_at_any_time():
    n, x = 4, 12.0
    times, starts = np.array([0.0, 1e-2, 0.1, 1.0, 100.0]), np.array([0.0, 0.3, 0.99]) * x
    p, error = chain_first_passage(process(n), x, times=times).failure(times, starts)
    assert error.max() < 1e-10
    assert np.all(p[0] == 0.0)
    for i, t in enumerate(times[1:], start=1):
        for j, start in enumerate(starts):
            assert abs(p[i, j] - float(failure(n, start, x, t))) <= error[i, j]


def test_a_failure_far_below_round_off_keeps_its_digits():
    """Once the energies below are filled, P(T <= t) of 1e-22 grows at the failure rate."""
    rare = chain_first_passage(process(2), 60.0, times=np.array([20.0, 30.0]))
    p, error = rare.failure(np.array([20.0, 30.0]), np.zeros(1))
    assert np.all(error < 1e-9 * p)
    assert_allclose(np.diff(p[:, 0]), 10.0 * rare.rate()[0], rtol=1e-6)


def test_a_closed_form_that_cancels_is_refused():
    with pytest.raises(NotApplicable, match="cancels"):
        SquareRoot(2, 1.0, 1.0).passage(4.0, 3.9, np.array([1e-6]), tol=1e-10)


def nested(process, limit, start):
    """∫dx/m ∫π by Gauss panels graded to both sides of all singular points; u = e^(−αH)."""
    nodes = np.unique([*np.linspace(0.0, limit, 31), start])
    for H in (0.0, *process.nonsmooth):
        gaps = 0.01 * 0.25 ** np.arange(20)
        nodes = np.unique([*nodes, H, *(H + gaps), *(H - gaps[gaps < H])])
    x, w = panel_rule(nodes, 24)
    t = np.polynomial.legendre.leggauss(24)[0]
    V = np.polynomial.legendre.legvander
    inner = V(t, 24) @ np.polynomial.legendre.legint(np.linalg.inv(V(t, 23)), lbnd=-1)
    c = process.coefficients(x.ravel())
    pi = np.exp(c.log_density_of_states + np.median(2.0 * c.dissipation / c.diffusion) * x.ravel())
    m, pi = 0.5 * c.diffusion.reshape(x.shape) * pi.reshape(x.shape), pi.reshape(x.shape)
    below = np.append(0.0, np.cumsum((w * pi).sum(axis=1)))[:-1, None]
    running = below + 0.5 * np.diff(nodes)[:, None] * (pi @ inner.T)
    return float((w * running / m).sum(axis=1)[nodes[:-1] >= start].sum())


CONTACTS = {
    "two masses": fig6(both(10.0)),
    "one mass": fig6((Contact(1, "both", 10.0, 0.3),), n=1),
    "stiff": fig6(both(1e6, 0.3)),
    "no clearance": fig6(both(10.0, 0.0)),
}
IN_TIME = ["one mass", "stiff", pytest.param("no clearance", marks=pytest.mark.slow)]


@pytest.mark.parametrize("name", IN_TIME)
def test_contacts_by_the_formula_of_the_mean_and_the_forward_equation(name):
    p = energy_process(CONTACTS[name])
    limit, start = 3.0 * p.energy_scale, 0.6 * p.energy_scale
    answer = fem_passage(p, limit, Source(start), np.array([0.5, 5.0, 50.0, 500.0]), tol=1e-10)
    assert answer.certificate.certified
    # The reliability by the backward equation is the mass that the forward equation leaves.
    assert answer.certificate.mass_defect < 1e-10 and answer.certificate.residual < 1e-13
    # Gauss panels that end in layers of 1e-14 have the round-off of as many sums.
    assert answer.mean.value == pytest.approx(nested(p, limit, start), rel=1e-12)
    assert answer.mean.error < 1e-11 * answer.mean.value


def test_starts_at_once_and_stationary_starts():
    curve = fem_passage(process(2), 5.0, Source(0.0), NONE, tol=1e-10).starts
    for k in (0, 30, 99):
        one = fem_passage(process(2), 5.0, Source(curve["starts"][k]), NONE, tol=1e-10)
        assert one.mean.value == pytest.approx(curve["mean"][k], rel=1e-12)
        assert one.variance.value == pytest.approx(curve["variance"][k], rel=1e-12)
    assert curve["mean"][-1] <= curve["mean_error"][-1] < 1e-12
    assert curve["variance"][-1] <= curve["variance_error"][-1] < 1e-10


@pytest.mark.parametrize("noise", [1e-9, 1e-2, 1.0, 1e6])
def test_a_start_under_much_less_or_more_noise_is_seen(noise):
    source = Source(process=process(2, d=noise))
    answer = fem_passage(process(2), 5.0, source, np.array([0.0, 1.0]), tol=1e-10)
    # A gamma density of shape 2 and scale ``noise``; the part beyond the limit has failed.
    beyond = (1.0 + 5.0 / noise) * np.exp(-5.0 / noise)
    assert abs(answer.failure[0] - beyond) <= answer.failure_error[0] < 1e-12
    x, w = panel_rule(np.linspace(0.0, min(5.0, 60.0 * noise), 41), 20)
    x, w = x.ravel(), (w * x * np.exp(-x / noise)).ravel() / noise**2
    solved = chain_first_passage(process(2), 5.0, times=np.ones(1))
    mean = w @ solved.moments(x)[0] * solved.longest
    failed = w @ solved.failure(np.ones(1), x)[0][0] + beyond
    # The reference states 1e-12 of its own, besides.
    assert abs(answer.mean.value - mean) <= answer.mean.error + 1e-12 * mean
    assert abs(answer.failure[1] - failed) <= answer.failure_error[1] + 1e-12
    assert answer.certificate.certified


@pytest.mark.parametrize("limit", [800.0, 1e10])
def test_a_limit_whose_mean_time_is_beyond_double_precision_is_refused(limit):
    with pytest.raises(InvalidInput, match="beyond the range"):
        fem_passage(process(1), limit, Source(), NONE, tol=1e-10)
    with pytest.raises(InvalidInput, match="beyond the range"):
        SquareRoot(1, 1.0, 1.0).passage(limit, 0.0, NONE, tol=1e-10)


DECADES = np.array([1e-3, 0.1, 1.0, 1e3])


@pytest.mark.parametrize("rate", [0.0, 1e-4, 1.0, 1e4])
def test_the_contour_gives_exponentials_at_all_times(rate):
    times = np.geomspace(1e-3, 1e3, 40)[::-1]
    value = np.empty(40)
    for places, z, factors in contours(times):
        value[places] = (factors @ (1.0 / (z + rate))).imag
    # Some seventy terms of the size e^3.
    np.testing.assert_allclose(value, np.exp(-rate * times), atol=1e-14)


@pytest.mark.parametrize(("n", "start"), [(1, 0.0), (2, 8.0), (20, 0.5)])
def test_the_transition_density_of_the_square_root_process(n, start):
    c, d = 0.5, 0.2
    theta, h = d / c, start * n * d / c
    p = cox_ingersoll_ross(a=n * d, c=c, d=d)
    solved = transition(p, Source(h), DECADES / c)
    assert solved.certificate.certified
    for k, t in enumerate(DECADES):
        left, grown = h * np.exp(-t), -theta * np.expm1(-t)
        width = np.sqrt(grown * (n * grown + 2.0 * left))
        x = np.abs(n * grown + left + width * np.array([-5.0, -2.0, -0.5, 1.0, 6.0]))
        exact = np.array([float(density(n, a / theta, h / theta, t)) for a in x]) / theta
        values, errors = solved.density(x)
        assert np.all(np.abs(values[k] - exact) <= errors[k])
        assert errors[k].max() < 1e-9 * exact.max()
        closed, stated = SquareRoot(n, c, d).density(h, None, float(t) / c, x)
        assert stated.max() < 1e-10 * exact.max()
        assert np.all(np.abs(closed - exact) <= stated)


@pytest.mark.parametrize("factor", [1e-9, 2.5])
def test_from_the_stationary_state_of_another_noise_it_stays_a_gamma_density(factor):
    n, c, d = 2, 0.5, 0.2
    process, other = (cox_ingersoll_ross(a=n * f * d, c=c, d=f * d) for f in (1.0, factor))
    x, times = np.linspace(0.0, 6.0, 25), DECADES / c
    solved = transition(process, Source(process=other), times)
    values, errors = solved.density(x)
    each = [SquareRoot(n, c, d).density(0.0, factor, t, x) for t in times.tolist()]
    exact, stated = np.array(each).swapaxes(0, 1)
    assert solved.certificate.certified
    assert np.all(np.abs(values - exact) <= errors + stated)
    assert errors.max() < 1e-9


def test_a_start_under_noise_too_loud_for_double_precision_is_refused():
    for factor in (1e3, 1e90):
        source = Source(process=cox_ingersoll_ross(a=2.0 * factor, d=factor))
        with pytest.raises(InvalidInput, match="out of the range"):
            transition(cox_ingersoll_ross(a=2.0), source, np.ones(1))


@pytest.mark.parametrize("name", IN_TIME)
def test_contacts_the_stationary_end_and_time_reversal(name):
    process = energy_process(CONTACTS[name])
    scale = process.energy_scale
    x = np.linspace(0.05, 4.0, 12) * scale
    stationary = solve_stationary(process, tol=1e-11)
    pi = stationary.density(x)
    late = transition(process, Source(0.0), np.array([3e3]))
    values, errors = late.density(x)
    assert late.certificate.certified
    assert np.all(np.abs(values[0] - pi) <= errors[0] + stationary.pointwise_error(x))
    # π(x) p(y, t | x) = π(y) p(x, t | y), two solutions on two meshes.
    a, b, times = 0.3 * scale, 1.4 * scale, np.array([0.3, 3.0, 30.0])
    forth, back = transition(process, Source(a), times), transition(process, Source(b), times)
    (p, p_error), (q, q_error) = forth.density(np.array([b])), back.density(np.array([a]))
    at_a, at_b = stationary.density(np.array([a, b]))
    bound = at_a * p_error + at_b * q_error
    bound += 2e-11 * (at_a * p + at_b * q) + 1e-300
    assert np.all(np.abs(at_a * p - at_b * q) <= bound)


def test_a_time_too_short_for_double_precision_is_said():
    process = cox_ingersoll_ross(a=2.0)
    solved = transition(process, Source(1.0), np.array([1e-24]))
    assert not solved.certificate.certified
    with pytest.raises(InvalidInput, match="out of the range"):
        transition(process, Source(800.0), np.array([1.0]))


@pytest.mark.parametrize(("n", "count"), [(2, 25), (100, 3)])
def test_the_rates_of_the_square_root_process(n, count):
    solved = relaxation_spectrum(cox_ingersoll_ross(a=n * 0.3, c=2.0, d=0.3), count)
    exact = 2.0 * np.arange(1.0, count + 1.0)
    assert solved.certificate.certified and solved.errors.max() < 1e-10 * exact[-1]
    assert np.all(np.abs(solved.values - exact) <= solved.errors)


@pytest.mark.parametrize("k", [0, 1])
def test_nan_is_not_lost_where_the_largest_residual_of_contours_is_taken(monkeypatch, k):
    own, made = resolvent.chain_resolvent, []

    def chain_resolvent(*asked, **how):
        made.append(np.nan if len(made) == k else 0.0)
        return own(*asked, **how)[0], made[-1]

    e = transition(cox_ingersoll_ross(a=2.0), Source(0.0), np.ones(1)).elements
    monkeypatch.setattr(resolvent, "chain_resolvent", chain_resolvent)
    # Times so far apart that no contour serves both.
    assert np.isnan(resolvent.inverse_laplace(e, Source().load(e), np.array([1.0, 100.0])).residual)
