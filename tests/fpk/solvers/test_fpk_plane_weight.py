"""Spectral solutions p = w u: other weights, circulating probability, no weight at all."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from numpy.testing import assert_allclose
from processes import process_of
from test_fpk_plane import (
    COUPLED,
    ROUND_OFF,
    assert_strictly_certified,
    assert_within,
    l1_error,
    manufactured,
    square_root_process,
)

from fpk.numeric.errors import NotCertified
from fpk.numeric.quadrature import panel_rule
from fpk.solvers.plane import stationary
from fpk.solvers.plane.elements import by_element, flux_coefficients
from fpk.solvers.plane.solution import solve_plane_on_mesh
from fpk.solvers.plane.stationary import (
    RUNGS,
    detailed_balance,
    next_rung,
    solve_by_elements,
    solve_plane,
    solve_with_weight,
)
from fpk.solvers.plane.weight import (
    Weight,
    fit_weight,
    fits_by_degree,
    flux_free_weight,
    inverse_diffusion,
)


def one_sided(first, second):
    """s_i = d − (γ_i + α H_i + c_i H_j) H_i with c_1 ≠ c_2: probability circulates."""
    d, g = 0.1, np.array([0.1, 0.2])
    coupling = np.array([[0.1, first], [second, 0.1]])
    return process_of(
        lambda H: d - (g + H @ coupling.T) * H,
        lambda H: 2.0 * d * H[:, :, None] * np.eye(2),
        lambda H: np.full(H.shape, 2.0 * d),
        (0.6, 0.4),
    )


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
    [
        ((0.3, 0.05), (0.3, 0.06), 1e-4),
        (STRONG, (STRONG[0] * (1.0 + 1e-5), STRONG[1]), 1e-10),
        pytest.param((0.3, 0.05), (0.3, 0.06), 1e-8, marks=pytest.mark.slow),
        pytest.param(STRONG, (STRONG[0] * (1.0 + 1e-5), STRONG[1]), 1e-6, marks=pytest.mark.slow),
    ],
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


@pytest.mark.parametrize(("tilt", "tol"), [(0.1, 1e-10), (0.4, 1e-6)])
def test_weighted_elements_within_an_honest_estimate_from_any_weight(tilt, tol: float):
    process, log_p = manufactured(0.4, 1.0)
    phi = np.array([[0.0, 30.0 * (1.0 + tilt)], [20.0 * (1.0 - tilt), 120.0]])
    for solution in solve_with_weight(process, Weight(phi, (20.0, 20.0)), tol=tol):
        error = l1_error(solution, log_p)
        assert error <= solution.l1_error <= 100.0 * error + ROUND_OFF
        if solution.certificate.certified:
            break
    assert_strictly_certified(solution)


def test_flux_free_weight_is_the_density_where_no_probability_flows():
    process, log_p = COUPLED["ridge"]
    weight = flux_free_weight(process)
    x, y = np.random.default_rng(3).exponential(0.3, (2, 50))
    found = -weight.exponent(x, y)
    assert_allclose(found - found[0], log_p(x, y) - log_p(x, y)[0], rtol=1e-9, atol=1e-9)


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


def test_a_fit_that_would_not_fall_off_is_not_taken():
    grid = np.linspace(0.0, 1.0, 30), np.linspace(0.0, 1.0, 30)
    known = np.ones((30, 30), dtype=bool)
    x, y = grid[0][:, None], grid[1]
    # Rises again beyond H1 = 1.25; then what falls everywhere.
    bent = fit_weight(grid, -5.0 * x + 2.0 * x**2 - y, known, 5.0)
    assert bent is None or np.all(
        np.diff(bent.exponent(np.linspace(1.0, 30.0, 50), 0.0 * x[0])) > 0
    )
    assert fit_weight(grid, 0.0 * x + y, known, 5.0) is None
    straight = fit_weight(grid, -5.0 * x - y, known, 5.0)
    assert straight is not None
    assert_allclose(straight.exponent(np.array(2.0), np.array(3.0)), 13.0, rtol=1e-9)


def mixture(
    shares=(0.6, 0.4),
    means=((1.0, 0.5), (0.4, 1.25)),
    noise=(1.0, 0.5),
    common=0.25,
    swirl=0.3,
):
    """Full diffusion diag(2 d_i H_i) + 2 κ H Hᵀ, with p a mixture of exponentials.

    One energy is large or the other: ln p is no polynomial. J = (∂ψ/∂H2, −∂ψ/∂H1),
    ψ = swirl H1 H2 p, circulates.
    """
    d, slopes = np.array(noise), -1.0 / np.array(means)
    heights = np.log(np.array(shares) * slopes.prod(axis=1))

    def log_p(x, y):
        parts = heights + np.stack(np.broadcast_arrays(x, y), axis=-1) @ slopes.T
        return np.asarray(np.logaddexp.reduce(parts, axis=-1))

    def diffusion(H):
        return 2.0 * (d * H)[:, :, None] * np.eye(2) + 2.0 * common * H[:, :, None] * H[:, None]

    def divergence(H):
        return 2.0 * d + 6.0 * common * H

    def drift(H):
        parts = heights + H @ slopes.T
        slope = np.exp(parts - np.logaddexp.reduce(parts, axis=1)[:, None]) @ slopes
        s = 0.5 * divergence(H) + 0.5 * np.einsum("nij,nj->ni", diffusion(H), slope)
        turned = np.stack([H[:, 0], -H[:, 1]], axis=1) * (1.0 + (H * slope)[:, ::-1])
        return np.asarray(s + swirl * turned)

    scales = np.array(shares) @ np.array(means)
    return process_of(drift, diffusion, divergence, (scales[0], scales[1])), log_p


RANDOM = {
    "zero flux at the far edges is the largest error": mixture(
        (0.231, 0.071, 0.698),
        ((0.398, 1.059), (0.922, 0.417), (1.327, 2.024)),
        (1.204, 0.619),
        common=0.0,
        swirl=0.2104,
    ),
    "far out the enriched solution has as much of an error": mixture(
        (0.3766520204109022, 0.4429957374412642, 0.1803522421478335),
        (
            (1.1994846193385102, 3.1047751604110245),
            (0.7822225912539174, 1.1657084714944481),
            (2.0782337219192284, 0.35377847519836914),
        ),
        (0.497970082504682, 0.6215967303194793),
        swirl=0.05,
    ),
    "p falls more slowly than its weight": mixture(
        (0.20693550393107532, 0.6396998779291954, 0.15336461813972935),
        (
            (1.075103304842027, 1.4302296839805433),
            (1.0231767238442393, 0.3984859624877532),
            (1.1925693846240069, 0.448921001317787),
        ),
        (0.5350871019099219, 1.117031888282538),
        swirl=0.24937340842652359,
    ),
}
"""Of random draws, for which earlier estimates were below the error."""


@pytest.mark.parametrize(
    ("name", "tol"), list(zip(RANDOM, (1e-6, 1e-9, 1e-7), strict=True)), ids=("edge", "far", "slow")
)
def test_the_estimate_holds_where(name, tol):
    process, log_p = RANDOM[name]
    solution = solve_plane(process, tol=tol)
    assert solution.certificate.certified
    assert l1_error(solution, log_p) <= solution.l1_error <= tol


def test_the_estimate_of_plain_elements_holds_where_the_mesh_ends():
    means = (1.841, 2.528), (0.497, 0.965), (2.202, 0.857)
    process, log_p = mixture((0.54, 0.16, 0.3), means, (1.196, 0.386), common=0.0, swirl=0.067)
    solution = solve_by_elements(process, flux_free_weight(process), tol=1e-8)
    assert_within(solution, log_p, 1e-8)


@pytest.mark.parametrize(
    "process",
    [
        one_sided(0.3, 0.05),
        *(pytest.param(p, marks=pytest.mark.slow) for p in (mixture()[0], one_sided(*STRONG))),
    ],
)
def test_a_looser_tolerance_takes_no_more_attempts_and_no_more_work(
    process, monkeypatch: pytest.MonkeyPatch
):
    attempts = []

    def noted(*args, **kwargs):
        attempts.append(solve_plane_on_mesh(*args, **kwargs))
        return attempts[-1]

    monkeypatch.setattr(stationary, "solve_plane_on_mesh", noted)
    counts, work = [], []
    for tol in (1e-4, 1e-7, 1e-10):
        attempts.clear()
        assert_strictly_certified(solve_plane(process, tol=tol))
        counts.append(len(attempts))
        work.append(sum(a.unknowns for a in attempts))
    # A density that is refused because it is negative is so at any tolerance: no expansion after
    # expansion is tried at a loose one.
    assert all(a <= b for a, b in pairwise(counts)), counts
    assert all(a <= b for a, b in pairwise(work)), work


def test_what_is_not_affordable_is_said_so(monkeypatch):
    process = square_root_process((0.1, 0.1), (0.1, 0.1))
    monkeypatch.setattr(stationary, "BLOCK_SIZE", 0)
    with pytest.raises(NotCertified, match="affordable"):
        solve_by_elements(process, flux_free_weight(process), tol=1e-6)


def test_circulation_without_any_potential_is_solved_from_exponentials():
    # The slopes without flux fall off along no path.
    process, log_p = manufactured(0.4, 1.0)
    x, y = np.array([1.0, 2.0]), np.array([0.5, 3.0])
    means = process.energy_scales
    first = flux_free_weight(process).exponent(x, y)
    assert_allclose(first, x / means[0] + y / means[1], rtol=1e-12)
    solution = solve_plane(process, tol=1e-6)
    assert_within(solution, log_p, 1e-6)


def test_what_misses_the_rule_is_returned_without_a_certificate(
    monkeypatch,
):
    # Few panels of low degree and no plain elements: inaccurate, and said so in words.
    monkeypatch.setattr(stationary, "RUNGS", ((2, 6), (4, 18)))
    monkeypatch.setattr(stationary, "next_rung", lambda *_, **__: 2)
    monkeypatch.setattr(stationary, "BLOCK_SIZE", 0)
    solution = solve_plane(one_sided(0.3, 0.05), tol=1e-10)
    assert not solution.certificate.certified
    assert any("exceeds the tolerance" in words for words in solution.certificate.failures)


def test_a_density_that_does_not_fall_off_at_the_edges_takes_five_rungs_at_the_most():
    after = [next_rung(rung, np.inf, most=5) for rung in range(len(RUNGS))]
    assert [RUNGS[k] for k in after[:3]] == [(4, 8), (4, 12), (4, 13)]
    assert all(k == rung + 1 for rung, k in enumerate(after) if RUNGS[rung][1] == 18)
    assert after == sorted(after)
    # Half a digit takes one degree more, six digits all that four panels have.
    assert RUNGS[next_rung(RUNGS.index((4, 8)), 3.0, most=99)] == (4, 9)
    assert RUNGS[next_rung(RUNGS.index((4, 8)), 1e6, most=99)] == (4, 18)


PROCESS, LOG_P = manufactured(0.4, 0.2)
X, Y = np.linspace(0.1, 3.0, 7), np.linspace(0.2, 2.0, 5)
WEIGHT = Weight(np.array([[0.0, 1.2, 0.1], [0.8, 0.2, 0.0], [0.05, 0.0, 0.0]]), (1.0, 2.0))


@pytest.mark.parametrize("balanced", [False, True])
def test_coefficients_at_gauss_points_are_those_of_their_formulas(balanced: bool):
    H = np.stack(np.meshgrid(X, Y, indexing="ij"), axis=-1).reshape(-1, 2)
    at, weight = PROCESS.coefficients(H), replace(WEIGHT, floor=0.01)
    value, slope = weight(*H.T), np.stack(weight.slopes(*H.T), axis=-1)
    # A slope of −ln w, and but for the floor −b⁻¹ (2s − ∇·b) where no probability flows.
    share = 1.0 - 0.01 / value
    a = at.drift - 0.5 * at.divergence
    if balanced:
        a = -0.5 * np.einsum("nij,nj->ni", at.diffusion, slope)
    a = a + 0.5 * np.einsum("nij,nj->ni", at.diffusion, share[:, None] * slope)
    b = at.diffusion
    expected = (a[:, 0], a[:, 1], b[:, 0, 0], b[:, 0, 1], b[:, 1, 1])
    got, *parts = flux_coefficients(PROCESS, X[:, None], Y, weight, balanced=balanced)
    assert_allclose(got.ravel(), value, rtol=1e-13)
    for part, values in zip(parts, expected, strict=True):
        assert_allclose(part.ravel(), values * value, rtol=1e-12, atol=1e-15)


def test_elements_run_along_the_second_energy_fastest():
    grid = np.arange(2.0 * 3 * 3 * 4).reshape(6, 12)
    blocks = by_element(grid, (2, 3))
    assert blocks.shape == (6, 3, 4)
    assert np.array_equal(blocks[4], grid[3:6, 4:8])


def test_slopes_without_flux_are_those_of_a_linear_system():
    grid = np.stack(np.meshgrid(X, Y, indexing="ij"), axis=-1).reshape(-1, 2)
    c = PROCESS.coefficients(grid)
    expected = np.linalg.solve(c.diffusion, c.drift[..., None])[..., 0]
    assert_allclose(inverse_diffusion(c.drift, c.diffusion), expected, rtol=1e-9, atol=1e-12)


def test_noise_that_leaves_a_combination_alone_is_refused():
    def diffusion(H):
        return np.asarray(2.0 * H[:, :, None] * H[:, None])

    process = process_of(lambda H: 1.0 - H, diffusion, lambda H: 6.0 * H, (1.0, 1.0))
    with pytest.raises(NotCertified, match="gets no noise"):
        flux_free_weight(process)


def powers_to(degree):
    return np.array([(i, k - i) for k in range(degree + 1) for i in range(k + 1)])


def test_fits_of_rising_degree_are_least_squares_fits():
    target = -LOG_P(X[:, None], Y).ravel() + np.sin(3.0 * np.add.outer(X, Y)).ravel()
    powers = powers_to(4)
    x, y = (a.ravel() for a in np.broadcast_arrays(X[:, None], Y))
    columns = x[:, None] ** powers[:, 0] * y[:, None] ** powers[:, 1]
    fitted = list(fits_by_degree(columns, target, powers))
    assert len(fitted) == 4
    for degree, (c, misfit) in enumerate(fitted, start=1):
        matrix = columns[:, powers.sum(axis=1) <= degree]
        best = matrix @ np.linalg.lstsq(matrix, target, rcond=None)[0]
        values = np.polynomial.polynomial.polyval2d(x, y, c)
        assert_allclose(values, best, rtol=0.0, atol=1e-9)
        expected = np.linalg.norm(best - target) / np.linalg.norm(target)
        assert_allclose(misfit, expected, rtol=1e-9)


def test_fits_end_where_the_points_do_not_tell_columns_apart():
    x = np.linspace(0.0, 1.0, 8)
    columns = np.column_stack([np.ones(8), x, x, x**2, x**2, x**2])
    assert not list(fits_by_degree(columns, x, powers_to(2)))


def test_a_weight_on_a_grid_is_that_at_its_points_and_its_slopes():
    on_grid, slopes = WEIGHT(X[:, None], Y), WEIGHT.slopes(X[:, None], Y)
    at, step = np.broadcast_arrays(X[:, None], Y), 1e-5
    assert_allclose(on_grid, WEIGHT(*at), rtol=1e-13)
    for axis, slope in enumerate(slopes):
        near = [
            -np.log(WEIGHT(at[0] + k * (axis == 0), at[1] + k * (axis == 1))) for k in (-step, step)
        ]
        assert_allclose(slope, (near[1] - near[0]) / (2.0 * step), rtol=1e-6, atol=1e-6)
