"""Spectral solutions p = w u: other weights, circulating probability, no weight at all."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from processes import competing, process_of
from test_fpk_plane import (
    COUPLED,
    assert_strictly_certified,
    assert_within,
    manufactured,
    mixture,
    square_root_process,
)

from fpk.numeric.errors import NotCertified
from fpk.numeric.quadrature import panel_rule
from fpk.solvers.plane import stationary
from fpk.solvers.plane.elements import flux_coefficients
from fpk.solvers.plane.solution import solve_plane_on_mesh
from fpk.solvers.plane.stationary import detailed_balance, solve_by_elements, solve_plane
from fpk.solvers.plane.weight import Weight, fits_by_degree, flux_free_weight, inverse_diffusion


def one_sided(first, second):
    """The effect of one energy on the damping of the other differs: probability circulates."""
    coupling = [[0.1, first], [second, 0.1]]
    return competing([0.1, 0.2], coupling, [0.1, 0.1], (0.6, 0.4))


STRONG = (2.0, 0.3)


def distance(first, second):
    """∫|p − q| as far as the longer of the meshes, to some per cent: bounds are held against it."""
    rules = [
        panel_rule(np.union1d(a, b), 8) for a, b in zip(first.panels, second.panels, strict=True)
    ]
    (x, wx), (y, wy) = ((a.ravel(), w.ravel()) for a, w in rules)
    gap = np.abs(first.density(x[:, None], y) - second.density(x[:, None], y))
    return float(wx @ gap @ wy)


# Each coupling beside another that is not taken for it, as far as it can be told.
@pytest.mark.parametrize(
    ("coupling", "other", "tol"),
    [((0.3, 0.05), (0.3, 0.06), 1e-4), (STRONG, (STRONG[0] * (1.0 + 1e-5), STRONG[1]), 1e-10)],
)
def test_spectral_and_plain_solutions_agree_where_probability_circulates(coupling, other, tol):
    process = one_sided(*coupling)
    found = solve_plane(process, tol=tol)
    plain = solve_by_elements(process, flux_free_weight(process), tol=1e-8 if tol < 1e-8 else 1e-7)
    assert_strictly_certified(found)
    assert not found.weight.plain and plain.l1_error <= 1e-7
    assert distance(found, plain) <= found.l1_error + plain.l1_error
    wrong = solve_plane(one_sided(*other), tol=tol)
    assert distance(wrong, plain) > wrong.l1_error + plain.l1_error


@pytest.mark.parametrize("name", COUPLED)
def test_detailed_balance_is_solved_in_closed_form(name):
    process, log_p = COUPLED[name]
    weight = flux_free_weight(process)
    solution = detailed_balance(process, weight, tol=1e-9)
    assert solution is not None
    assert_within(solution, log_p, 1e-12)
    # It rests on the drift of this process: another one is not taken for it.
    other = manufactured(0.4, 0.0)[0]
    assert detailed_balance(other, weight, tol=1e-9) is None


def test_circulating_probability_is_no_detailed_balance():
    process, _ = manufactured(0.4, 1e-8)
    weight = Weight(np.array([[0.0, 30.0], [20.0, 120.0]]), (20.0, 20.0))
    for tol in (1e-3, 1e-4):
        # p is right, but that is not known: the flux bounds the error only so far.
        solution = detailed_balance(process, weight, tol=tol)
        assert solution is not None and solution.l1_error > 1e-7
    assert detailed_balance(process, weight, tol=1e-8) is None


def test_a_flux_across_a_barrier_is_no_detailed_balance():
    # Two wells with little probability between: where p is small the slope of ln p matters, too.
    process, _ = COUPLED["one of two modes"]
    weight = flux_free_weight(process)
    within = process.coefficients

    def moved(H):
        c = within(H)
        barrier = np.exp(-0.5 * np.sum((H / 0.4 - 0.5) ** 2, axis=1) / 0.1**2)
        return c._replace(drift=c.drift + 1e-3 * (barrier * H[:, 0] / 0.4)[:, None] * [1.0, -1.0])

    assert detailed_balance(replace(process, coefficients=moved), weight, tol=1e-3) is None
    assert detailed_balance(process, weight, tol=1e-3) is not None


def test_the_estimate_holds_where_it_once_did_not():
    # Of random draws: zero flux at the far edges is the largest error.
    means = (0.398, 1.059), (0.922, 0.417), (1.327, 2.024)
    process, log_p = mixture((0.231, 0.071, 0.698), means, (1.204, 0.619), common=0.0, swirl=0.2104)
    assert_within(solve_plane(process, tol=1e-6), log_p, 1e-6)


def test_a_looser_tolerance_takes_no_more_attempts_and_no_more_work(monkeypatch):
    attempts = []

    def noted(*args, **kwargs):
        attempts.append(solve_plane_on_mesh(*args, **kwargs))
        return attempts[-1]

    monkeypatch.setattr(stationary, "solve_plane_on_mesh", noted)
    counts, work = [], []
    for tol in (1e-4, 1e-7, 1e-10):
        attempts.clear()
        assert_strictly_certified(solve_plane(one_sided(0.3, 0.05), tol=tol))
        counts.append(len(attempts))
        work.append(sum(a.unknowns for a in attempts))
    # A density that is refused because it is negative is so at any tolerance: no expansion after
    # expansion is tried at a loose one.
    assert counts == sorted(counts) and work == sorted(work)


def test_what_is_not_affordable_is_said_so(monkeypatch):
    process = square_root_process((0.1, 0.1), (0.1, 0.1))
    monkeypatch.setattr(stationary, "BLOCK_SIZE", 0)
    with pytest.raises(NotCertified, match="affordable"):
        solve_by_elements(process, flux_free_weight(process), tol=1e-6)


def test_noise_that_leaves_a_combination_alone_is_refused():
    def diffusion(H):
        return np.asarray(2.0 * H[:, :, None] * H[:, None])

    process = process_of(lambda H: 1.0 - H, diffusion, lambda H: 6.0 * H, (1.0, 1.0))
    with pytest.raises(NotCertified, match="gets no noise"):
        flux_free_weight(process)


X, Y = np.linspace(0.1, 3.0, 7), np.linspace(0.2, 2.0, 5)


def test_the_flux_of_a_balanced_weight_needs_no_drift():
    process, _ = COUPLED["Gibbs of H1 + H2"]
    weight = replace(flux_free_weight(process), floor=0.01)
    by_weight, by_drift = (
        flux_coefficients(process, X[:, None], Y, weight, balanced=balanced)
        for balanced in (True, False)
    )
    assert_allclose(by_weight, by_drift, rtol=1e-8, atol=1e-10)


def test_slopes_without_flux_are_those_of_a_linear_system():
    c = manufactured(0.4, 0.2)[0].coefficients(np.stack([X[:5], Y], axis=1))
    expected = np.linalg.solve(c.diffusion, c.drift[..., None])[..., 0]
    assert_allclose(inverse_diffusion(c.drift, c.diffusion), expected, rtol=1e-9, atol=1e-12)


def test_fits_end_where_the_points_do_not_tell_columns_apart():
    x, powers = np.linspace(0.0, 1.0, 8), np.array([(0, 0), (0, 1), (1, 0), (0, 2), (1, 1), (2, 0)])
    columns = np.column_stack([np.ones(8), x, x, x**2, x**2, x**2])
    assert not list(fits_by_degree(columns, x, powers))
