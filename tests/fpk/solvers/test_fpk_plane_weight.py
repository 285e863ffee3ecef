"""Spectral solutions p = w u: other weights, circulating probability, no weight at all."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from numpy.typing import NDArray
from processes import process_of
from test_fpk_plane import (
    COUPLED,
    ROUND_OFF,
    Log,
    assert_strictly_certified,
    l1_error,
    manufactured,
    square_root_process,
    van_der_pol,
)

from fpk.numeric.errors import NotCertified
from fpk.numeric.quadrature import panel_rule
from fpk.solvers.plane import stationary
from fpk.solvers.plane import weight as weight_module
from fpk.solvers.plane.solution import PlaneSolution, solve_plane_on_mesh
from fpk.solvers.plane.stationary import (
    RUNGS,
    detailed_balance,
    next_rung,
    solve_by_elements,
    solve_plane,
    solve_with_weight,
)
from fpk.solvers.plane.weight import Weight, fit_weight, flux_free_weight
from fpk.system.process import Coefficients, Process

Array = NDArray[np.float64]


def one_sided(first: float, second: float) -> Process:
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


def distance(first: PlaneSolution, second: PlaneSolution) -> float:
    """∫|p − q| as far as the longer of the meshes, to some per cent: bounds are held against it."""
    rules = [
        panel_rule(np.union1d(a, b), 8) for a, b in zip(first.panels, second.panels, strict=True)
    ]
    (x, wx), (y, wy) = ((a.ravel(), w.ravel()) for a, w in rules)
    gap = np.abs(first.density(x[:, None], y) - second.density(x[:, None], y))
    return float(wx @ gap @ wy)


@pytest.mark.parametrize("tol", [1e-4, pytest.param(1e-8, marks=pytest.mark.slow)])
def test_spectral_and_plain_solutions_agree_where_probability_circulates(tol: float) -> None:
    process = one_sided(0.3, 0.05)
    found = solve_plane(process, tol=tol)
    elements = solve_by_elements(process, flux_free_weight(process), tol=1e-8)
    assert_strictly_certified(found)
    assert_strictly_certified(elements)
    assert distance(found, elements) <= found.l1_error + elements.l1_error
    # Another coupling is not taken for it.
    other = solve_plane(one_sided(0.3, 0.06), tol=tol)
    assert distance(other, elements) > 10.0 * (other.l1_error + elements.l1_error)


@pytest.mark.parametrize("tol", [pytest.param(1e-6, marks=pytest.mark.slow), 1e-10])
def test_strong_circulation_takes_a_weight_on_a_few_elements(tol: float) -> None:
    process = one_sided(*STRONG)
    found = solve_plane(process, tol=tol)
    assert_strictly_certified(found)
    assert not found.weight.plain
    plain = solve_by_elements(process, flux_free_weight(process), tol=1e-7)
    assert plain.l1_error <= 1e-7
    assert distance(found, plain) <= found.l1_error + plain.l1_error
    # A coupling 1e-5 of it away is not taken for it, as far as it can be told.
    other = solve_plane(one_sided(STRONG[0] * (1.0 + 1e-5), STRONG[1]), tol=tol)
    assert distance(other, plain) > found.l1_error + plain.l1_error


@pytest.mark.parametrize(("tilt", "tol"), [(0.1, 1e-10), (-0.2, 1e-6), (0.4, 1e-6)])
def test_weighted_elements_within_an_honest_estimate_from_any_weight(
    tilt: float, tol: float
) -> None:
    process, log_p = manufactured(0.4, 1.0)
    phi = np.array([[0.0, 30.0 * (1.0 + tilt)], [20.0 * (1.0 - tilt), 120.0]])
    for solution in solve_with_weight(process, Weight(phi, (20.0, 20.0)), tol=tol):
        error = l1_error(solution, log_p)
        assert error <= solution.l1_error <= 100.0 * error + ROUND_OFF
        if solution.certificate.certified:
            break
    assert_strictly_certified(solution)


def test_weighted_elements_converge_in_the_elements_with_their_order() -> None:
    process, log_p = manufactured(0.4, 0.0)
    # Any weight will do, not that of the density: the order is that of u = p/w on even elements.
    weight = Weight(np.array([[0.0, 1.2], [0.8, 0.2]]), (1.0, 1.0))
    errors, counts = [], (8, 12, 18, 27)
    for count in counts:
        nodes = (np.linspace(0.0, 5.0, count + 1), np.linspace(0.0, 4.0, count + 1))
        solution = solve_plane_on_mesh(process, nodes, 3, weight=weight)
        errors.append(l1_error(solution, log_p, beyond=1.0))
    orders = np.log(np.array(errors[:-1]) / errors[1:]) / np.log(np.divide(counts[1:], counts[:-1]))
    assert_allclose(orders, 4.0, atol=0.15)


def test_values_on_a_grid_are_those_at_its_points() -> None:
    process = one_sided(*STRONG)
    weight = flux_free_weight(process)
    nodes = np.array([0.0, 0.4, 1.5, 5.0]), np.array([0.0, 1.0, 4.0])
    for w in (weight_module.UNIT_WEIGHT, weight):
        p = solve_plane_on_mesh(process, nodes, 6, weight=w).density
        x, y = np.linspace(-0.5, 5.5, 25), np.linspace(-0.5, 4.5, 17)
        at_points = p(*(a.ravel() for a in np.meshgrid(x, y, indexing="ij"))).reshape(25, 17)
        for grid in (p(x[:, None], y), p(x[:, None], y[None]), p(x, y[:, None]).T):
            assert_allclose(grid, at_points, rtol=1e-10, atol=1e-13 * np.abs(at_points).max())
        assert np.all(at_points[0] == 0.0) and np.all(at_points[:, -1] == 0.0)


@pytest.mark.parametrize("tilt", [0.0, 0.1, -0.2])
def test_any_weight_gives_the_same_density(tilt: float) -> None:
    process, log_p = manufactured(0.4, 0.2)
    phi = np.array([[0.0, 1.5 * (1.0 + tilt)], [1.0 - tilt, 0.3]])
    weight = Weight(phi * np.array([[1.0, 20.0], [20.0, 400.0]]), (20.0, 20.0))
    nodes = tuple(end * np.linspace(0.0, 1.0, 5) ** 2 for end in weight.ends(36.0))
    errors = []
    for degree in (4, 8, 12, 16):
        solution = solve_plane_on_mesh(process, (nodes[0], nodes[1]), degree, weight=weight)
        x, y = (np.linspace(0.0, H[-1], 150) for H in solution.nodes)
        p, p_h = np.exp(log_p(x[:, None], y)), solution.density(x[:, None], y)
        errors.append(np.abs(p_h - p_h.sum() / p.sum() * p).max())
        assert solution.measured.residual < 1e-14
    # Geometric in the degree, down to what zero flux at the far edges costs.
    floor = 1e-10
    assert all(b <= max(0.2 * a, floor) for a, b in pairwise(errors)), errors


def test_flux_free_weight_is_the_density_where_no_probability_flows() -> None:
    process, log_p = COUPLED["ridge"]
    weight = flux_free_weight(process)
    x, y = np.random.default_rng(3).exponential(0.3, (2, 50))
    found = -weight.exponent(x, y)
    assert_allclose(found - found[0], log_p(x, y) - log_p(x, y)[0], rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("name", COUPLED)
@pytest.mark.parametrize("tol", [1e-4, 1e-9, 1e-12])
def test_detailed_balance_is_solved_in_closed_form(name: str, tol: float) -> None:
    process, log_p = COUPLED[name]
    weight = flux_free_weight(process)
    solution = detailed_balance(process, weight, tol=tol)
    assert solution is not None
    assert_strictly_certified(solution)
    assert l1_error(solution, log_p) <= solution.l1_error <= 1e-12
    # It rests on the drift of this process: another one is not taken for it.
    other = manufactured(0.4, 0.0)[0]
    assert detailed_balance(other, weight, tol=tol) is None


def test_circulating_probability_is_no_detailed_balance() -> None:
    process, _ = manufactured(0.4, 1e-8)
    weight = Weight(np.array([[0.0, 30.0], [20.0, 120.0]]), (20.0, 20.0))
    for tol in (1e-3, 1e-4):
        # p is right, but that is not known: the flux bounds the error only so far.
        solution = detailed_balance(process, weight, tol=tol)
        assert solution is not None and solution.l1_error > 1e-7
    assert detailed_balance(process, weight, tol=1e-8) is None


def test_a_flux_across_a_barrier_is_no_detailed_balance() -> None:
    # Two wells with little probability between: where p is small the slope of ln p matters, too.
    process, _ = van_der_pol((-0.2, -0.2), (0.2, 0.2), 13.0, (0.03, 0.03))
    weight = flux_free_weight(process)
    within = process.coefficients

    def moved(H: Array) -> Coefficients:
        c = within(H)
        barrier = np.exp(-0.5 * np.sum((H / 0.4 - 0.5) ** 2, axis=1) / 0.1**2)
        return c._replace(drift=c.drift + 1e-3 * (barrier * H[:, 0] / 0.4)[:, None] * [1.0, -1.0])

    assert detailed_balance(replace(process, coefficients=moved), weight, tol=1e-3) is None
    assert detailed_balance(process, weight, tol=1e-3) is not None


def test_a_fit_that_would_not_fall_off_is_not_taken() -> None:
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
    shares: Sequence[float] = (0.6, 0.4),
    means: Sequence[Sequence[float]] = ((1.0, 0.5), (0.4, 1.25)),
    noise: tuple[float, float] = (1.0, 0.5),
    common: float = 0.25,
    swirl: float = 0.3,
) -> tuple[Process, Log]:
    """Full diffusion diag(2 d_i H_i) + 2 κ H Hᵀ, with p a mixture of exponentials.

    One energy is large or the other: ln p is no polynomial. J = (∂ψ/∂H2, −∂ψ/∂H1),
    ψ = swirl H1 H2 p, circulates.
    """
    d, slopes = np.array(noise), -1.0 / np.array(means)
    heights = np.log(np.array(shares) * slopes.prod(axis=1))

    def log_p(x: Array, y: Array) -> Array:
        parts = heights + np.stack(np.broadcast_arrays(x, y), axis=-1) @ slopes.T
        return np.asarray(np.logaddexp.reduce(parts, axis=-1))

    def diffusion(H: Array) -> Array:
        return 2.0 * (d * H)[:, :, None] * np.eye(2) + 2.0 * common * H[:, :, None] * H[:, None]

    def divergence(H: Array) -> Array:
        return 2.0 * d + 6.0 * common * H

    def drift(H: Array) -> Array:
        parts = heights + H @ slopes.T
        slope = np.exp(parts - np.logaddexp.reduce(parts, axis=1)[:, None]) @ slopes
        s = 0.5 * divergence(H) + 0.5 * np.einsum("nij,nj->ni", diffusion(H), slope)
        turned = np.stack([H[:, 0], -H[:, 1]], axis=1) * (1.0 + (H * slope)[:, ::-1])
        return np.asarray(s + swirl * turned)

    scales = np.array(shares) @ np.array(means)
    return process_of(drift, diffusion, divergence, (scales[0], scales[1])), log_p


THREE = (
    ((0.231, 0.071, 0.698), ((0.398, 1.059), (0.922, 0.417), (1.327, 2.024)), (1.204, 0.619)),
    ((0.54, 0.16, 0.3), ((1.841, 2.528), (0.497, 0.965), (2.202, 0.857)), (1.196, 0.386)),
)
"""Three exponentials, of a random draw: zero flux at the far edges is the largest error."""


def test_the_estimate_holds_what_ending_the_mesh_costs() -> None:
    process, log_p = mixture(*THREE[0], common=0.0, swirl=0.2104)
    solution = solve_plane(process, tol=1e-6)
    assert_strictly_certified(solution)
    assert l1_error(solution, log_p) <= solution.l1_error <= 1e-6


HARDLY_BETTER = {
    0.05: (
        (0.3766520204109022, 0.4429957374412642, 0.1803522421478335),
        (
            (1.1994846193385102, 3.1047751604110245),
            (0.7822225912539174, 1.1657084714944481),
            (2.0782337219192284, 0.35377847519836914),
        ),
        (0.497970082504682, 0.6215967303194793),
    ),
    0.3: (
        (0.8111095543720233, 0.03731048729077429, 0.15157995833720236),
        (
            (1.4656196380832576, 0.6952196208040213),
            (0.7404945454489816, 3.0106135890609296),
            (1.0421845505938963, 0.7676735320756612),
        ),
        (1.0132702626020935, 0.6060188099673974),
    ),
}
"""By swirl, of a random draw: far out the enriched solution has as much of an error."""


@pytest.mark.parametrize("swirl", HARDLY_BETTER)
def test_the_estimate_holds_where_the_enriched_solution_is_hardly_better(swirl: float) -> None:
    process, log_p = mixture(*HARDLY_BETTER[swirl], common=0.25, swirl=swirl)
    solution = solve_plane(process, tol=1e-9)
    assert_strictly_certified(solution)
    assert l1_error(solution, log_p) <= solution.l1_error <= 1e-9


@pytest.mark.parametrize("tol", [1e-8, 1e-10])
def test_the_estimate_of_plain_elements_holds_it_too(tol: float) -> None:
    process, log_p = mixture(*THREE[1], common=0.0, swirl=0.067)
    solution = solve_by_elements(process, flux_free_weight(process), tol=tol)
    assert_strictly_certified(solution)
    assert l1_error(solution, log_p) <= solution.l1_error <= tol


@pytest.mark.parametrize("process", [mixture()[0], one_sided(*STRONG), one_sided(0.3, 0.05)])
def test_a_looser_tolerance_takes_no_more_attempts_and_no_more_work(
    process: Process, monkeypatch: pytest.MonkeyPatch
) -> None:
    attempts: list[PlaneSolution] = []

    def noted(*args: Any, **kwargs: Any) -> PlaneSolution:
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


def test_without_any_weight_the_elements_obey_the_same_rule(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(stationary, "detailed_balance", lambda *_, **__: None)
    monkeypatch.setattr(stationary, "solve_with_weight", lambda *_, **__: ())
    process, log_p = COUPLED["Gibbs of H1 + H2"]
    solution = solve_plane(process, tol=1e-6)
    assert solution.weight.plain
    assert_strictly_certified(solution)
    assert l1_error(solution, log_p) <= solution.l1_error <= 1e-6


def test_what_is_not_affordable_is_said_so(monkeypatch: pytest.MonkeyPatch) -> None:
    process = square_root_process((0.1, 0.1), (0.1, 0.1))
    monkeypatch.setattr(stationary, "BLOCK_SIZE", 0)
    with pytest.raises(NotCertified, match="affordable"):
        solve_by_elements(process, flux_free_weight(process), tol=1e-6)


def test_a_weight_that_is_not_fitted_serves_as_well(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(weight_module, "_chosen", lambda *_: None)
    process, log_p = mixture()
    assert np.count_nonzero(flux_free_weight(process).coefficients) == 2
    solution = solve_plane(process, tol=1e-6)
    assert_strictly_certified(solution)
    assert l1_error(solution, log_p) <= solution.l1_error <= 1e-6


def test_circulation_without_any_potential_is_solved_from_exponentials() -> None:
    # The slopes without flux fall off along no path.
    process, log_p = manufactured(0.4, 1.0)
    x, y = np.array([1.0, 2.0]), np.array([0.5, 3.0])
    means = process.energy_scales
    first = flux_free_weight(process).exponent(x, y)
    assert_allclose(first, x / means[0] + y / means[1], rtol=1e-12)
    solution = solve_plane(process, tol=1e-6)
    assert_strictly_certified(solution)
    assert l1_error(solution, log_p) <= solution.l1_error <= 1e-6


def test_what_misses_the_rule_is_returned_without_a_certificate(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    # Few panels of low degree and no plain elements: inaccurate, and said so in words.
    monkeypatch.setattr(stationary, "RUNGS", ((2, 6), (4, 18)))
    monkeypatch.setattr(stationary, "next_rung", lambda *_, **__: 2)
    monkeypatch.setattr(stationary, "BLOCK_SIZE", 0)
    solution = solve_plane(one_sided(0.3, 0.05), tol=1e-10)
    assert not solution.certificate.certified
    assert any("exceeds the tolerance" in words for words in solution.certificate.failures)


def test_a_density_that_does_not_fall_off_at_the_edges_takes_five_rungs_at_the_most() -> None:
    after = [next_rung(rung, np.inf, most=5) for rung in range(len(RUNGS))]
    assert [RUNGS[k] for k in after[:3]] == [(4, 8), (4, 12), (4, 13)]
    assert all(k == rung + 1 for rung, k in enumerate(after) if RUNGS[rung][1] == 18)
    assert after == sorted(after)
    # Half a digit takes one degree more, six digits all that four panels have.
    assert RUNGS[next_rung(RUNGS.index((4, 8)), 3.0, most=99)] == (4, 9)
    assert RUNGS[next_rung(RUNGS.index((4, 8)), 1e6, most=99)] == (4, 18)


@pytest.mark.parametrize("tol", [1e-4, 1e-5, 1e-6, 1e-7, 1e-8])
def test_the_estimate_holds_it_where_p_falls_more_slowly_than_its_weight(tol: float) -> None:
    process, log_p = mixture(
        (0.20693550393107532, 0.6396998779291954, 0.15336461813972935),
        (
            (1.075103304842027, 1.4302296839805433),
            (1.0231767238442393, 0.3984859624877532),
            (1.1925693846240069, 0.448921001317787),
        ),
        (0.5350871019099219, 1.117031888282538),
        common=0.25,
        swirl=0.24937340842652359,
    )
    solution = solve_plane(process, tol=tol)
    assert solution.certificate.certified
    assert l1_error(solution, log_p) <= solution.l1_error <= tol
