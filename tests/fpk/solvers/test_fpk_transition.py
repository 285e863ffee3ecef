"""Densities of one energy in time, relaxation rates, and the contour that makes them."""

import numpy as np
import pytest
from processes import cox_ingersoll_ross, density
from test_fpk_passage import CONTACTS, IN_TIME

from averaging.energy_process import energy_process
from fpk.numeric.errors import InvalidInput
from fpk.solvers.line.stationary import solve_stationary
from fpk.solvers.line.time import resolvent
from fpk.solvers.line.time.resolvent import contours, relaxation_spectrum
from fpk.solvers.line.time.transition import Source, transition
from fpk.solvers.square_root import SquareRoot

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
        closed = SquareRoot(n, c, d).transient(h, None, DECADES[k : k + 1] / c, x, tol=1e-10)
        assert closed.certificate.certified and closed.errors.max() < 1e-10 * exact.max()
        assert np.all(np.abs(closed.values[0] - exact) <= closed.errors[0])


@pytest.mark.parametrize("factor", [1e-9, 2.5])
def test_from_the_stationary_state_of_another_noise_it_stays_a_gamma_density(factor):
    n, c, d = 2, 0.5, 0.2
    process, other = (cox_ingersoll_ross(a=n * f * d, c=c, d=f * d) for f in (1.0, factor))
    x, times = np.linspace(0.0, 6.0, 25), DECADES / c
    solved = transition(process, Source(process=other), times)
    values, errors = solved.density(x)
    exact = SquareRoot(n, c, d).transient(0.0, factor, times, x, tol=1e-10)
    assert solved.certificate.certified and exact.certificate.certified
    assert np.all(np.abs(values - exact.values) <= errors + exact.errors)
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
