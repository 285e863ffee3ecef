"""Convergence studies: orders against theory, what they are called, Richardson, and the command."""

import json
from dataclasses import replace

import numpy as np
import pytest

from cases.scene.scene import load_scene
from cases.show.pictures.draw import study_figure
from cases.show.pictures.panel import Curve, Panel
from cases.study.converge import ConvergenceStudy, families
from cases.study.equations import (
    DENSITY_NORMS,
    DENSITY_ROUND_OFF,
    FUNCTIONALS,
    P_DEGREES,
    energy_density,
    energy_equation,
    errors,
    modal_equation,
)
from cases.study.levels import Ladder, Level, Study
from cases.study.orders import NEAR_THEORY, convergence, grid_convergence, observed_orders
from cases.study.simulation import (
    ORDER_ERROR,
    Run,
    WeakOrder,
    displacement_of_study,
    full_density,
    sample_slope,
    weak_order,
    with_order,
)
from sim.montecarlo import MonteCarlo

SIZES = 2.0 ** -np.arange(6.0)
STEPS = 0.4 / np.sqrt(2.0) ** np.arange(5.0)


def test_a_power_shows_its_order_and_an_exponential_its_rate():
    for order in (1.0, 5.0):
        found = convergence(SIZES, 3.0 * SIZES**order, theory=order, floor=0.0)
        np.testing.assert_allclose(found.orders, order, rtol=1e-12)
        assert found.kind == "asymptotic" and found.spread < 1e-12
    degrees = np.arange(1.0, 7.0)
    found = convergence(np.exp(-degrees), np.exp(-1.7 * degrees), theory=None, floor=0.0)
    np.testing.assert_allclose(found.orders, 1.7)
    assert found.kind == "asymptotic"
    slowing = convergence(np.exp(-degrees), np.exp(-np.sqrt(degrees) * 3), theory=None, floor=0.0)
    assert np.all(np.diff(slowing.orders) < 0.0)


@pytest.mark.parametrize(
    ("errors", "kind"),
    [
        ([1.0, 0.3, 0.1, 0.03], "pre-asymptotic"),
        ([1.0, 0.25, 0.06, 1e-12], "at the floor"),
        ([1.0, 0.1, 0.2, 0.05], "oscillating"),
        ([1.0, 0.5, 1.0, 2.0], "diverging"),
        ([1.0, 0.1, np.nan, np.nan], "diverging"),
        ([1.0, 0.25, 0.0625, 0.015625], "asymptotic"),
    ],
)
def test_sequences_are_called_what_they_are(errors, kind):
    assert convergence(SIZES[:4], errors, theory=2.0, floor=1e-12).kind == kind


def test_richardson_finds_the_limit_and_the_index_covers_it():
    values = 7.0 + 0.3 * SIZES**2 + 0.01 * SIZES**3
    found = grid_convergence(values, theory=2.0, floor=0.0)
    assert found.safety == 1.25 and found.kind == "asymptotic"
    assert abs(values[-1] - 7.0) <= found.index
    assert abs(found.value - 7.0) < 0.1 * abs(values[-1] - 7.0)
    far = grid_convergence(7.0 + 0.3 * SIZES, theory=2.0, floor=0.0)
    assert far.safety == 3.0 and abs(far.used - 1.0) < 1e-9 and 0.3 * SIZES[-1] <= far.index
    swinging = grid_convergence([1.0, 0.9, 0.95], theory=2.0, floor=0.0)
    assert swinging.kind == "oscillating" and swinging.safety == 3.0
    assert grid_convergence([1.0] * 6, theory=2.0, floor=1e-15).kind == "at the floor"
    # Differences that fall on are no sign that the error does: the reference resolves no more.
    assert grid_convergence([1.0, 1e-4, 1e-8], theory=13.3, floor=9e-5).index == 9e-5


@pytest.fixture(scope="module")
def energy_ladders():
    ladders = map(Study.ladder, families(energy_equation(load_scene("fig6b").system)))
    return {ladder.name: ladder for ladder in ladders}


def test_energy_orders_are_those_of_theory_with_contact(energy_ladders):
    for degree in (1, 2, 4):
        verdict = energy_ladders[f"h, p = {degree}"].verdicts["L1"]
        assert verdict.kind == "asymptotic" and len(verdict.orders) >= 4
        assert np.all(np.abs(np.array(verdict.orders[-2:]) - (degree + 1)) <= NEAR_THEORY)


def test_every_level_is_within_its_own_estimate_and_a_trusted_index_covers_the_error(
    energy_ladders,
):
    trusted = 0
    for ladder in energy_ladders.values():
        assert len(ladder.levels) >= 4
        for level in ladder.levels:
            assert level.honest, (ladder.name, level)
            assert set(level.errors) == {*DENSITY_NORMS, *FUNCTIONALS}
        for key, g in ladder.grid.items():
            if g.safety == 1.25:
                trusted += 1
                # The index knows nothing of round-off, where the finest level has arrived: that of
                # p counts twice in ∫p².
                allowed = g.index + 2.0 * DENSITY_ROUND_OFF * abs(g.value)
                assert ladder.levels[-1].errors[key] <= allowed
    assert len(energy_ladders) == 5 and trusted


@pytest.mark.parametrize("contacts", [True, False])
def test_convergence_in_p_is_exponential_with_contact_and_without(energy_ladders, contacts):
    found = energy_ladders["p on a fixed mesh"]
    if not contacts:
        free = energy_equation(replace(load_scene("fig6b").system, contacts=()))
        found = free.study(free.degrees()).ladder()
    rates = found.verdicts["L1"].orders
    assert len(rates) >= 4
    # A straight line on log-lin paper: what a degree takes off does not shrink. Of an algebraic
    # error p^-k the step from a to b takes off k ln(b/a)/(b - a) a degree.
    a, b = np.array(P_DEGREES[: len(rates)]), np.array(P_DEGREES[1 : len(rates) + 1])
    algebraic = np.log(b / a) / (b - a)
    assert rates[-1] / rates[-3] > 0.5 * (1.0 + algebraic[-1] / algebraic[-3])
    assert all(level.honest for level in found.levels)


def test_an_equation_that_is_not_the_right_one_does_not_converge():
    equation = energy_equation(load_scene("fig6b").system)

    def coefficients(energy):
        c = equation.process.coefficients(energy)
        return c._replace(dissipation=1.1 * c.dissipation, drift=c.drift + 0.1 * c.dissipation)

    wrong = replace(equation, process=replace(equation.process, coefficients=coefficients))
    found = wrong.study(wrong.elements(2)).ladder()
    assert found.verdicts["L1"].kind != "asymptotic" and not found.levels[-1].honest


@pytest.mark.parametrize(
    "scene", ["fig6b", pytest.param("vanderpol-modal", marks=pytest.mark.slow)]
)
def test_two_energies_show_the_order_of_theory(scene):
    """Equation (34) and, with damping that depends on the energies, plain elements as reference."""
    equation = modal_equation(load_scene(scene).system)
    levels = [level for _, level in equation.study(equation.elements(2)).levels()]
    assert all(level.honest for level in levels)
    off = {
        key: np.abs(observed_orders(SIZES[:5], [e.errors[key] for e in levels]) - 3.0)
        for key in ("L1", "max")
    }
    assert scene != "fig6b" or off["max"][-1] <= NEAR_THEORY
    assert np.all(off["L1"][-3:] <= NEAR_THEORY) and off["L1"].argmin() == off["L1"].size - 1


@pytest.mark.parametrize(
    "scene", ["vanderpol-modal", pytest.param("vanderpol", marks=pytest.mark.slow)]
)
def test_damping_terms_have_a_reference_by_another_method(scene):
    equation = modal_equation(load_scene(scene).system)
    assert equation.reference_words.startswith("plain elements (w = 1)")
    assert equation.reference.l1_error < 1e-10
    for tol in (1e-4, 1e-8):
        (solve,) = equation.by_tolerance.values()
        solution = solve(equation.process, tol=tol)
        assert not solution.weight.plain  # and on a mesh of its own
        answer = energy_density(equation.reference.observable, solution)
        meshes = (answer.panels, equation.reference.panels)
        assert [x.size for x in meshes[0]] != [x.size for x in meshes[1]]
        true = errors(answer, equation.reference)["L1"]
        assert true <= answer.l1_error + equation.reference.l1_error
        assert true > equation.reference.l1_error  # what is seen is the answer's error


def judged_order(theory, levels, truth=None):
    return with_order(WeakOrder("x", "E q1²", theory), levels, truth)


def levels_of(order, error, noise=0.0, rng=None):
    """Levels with a bias dt^order, the standard error that they state, and as much noise."""
    values = 1.0 + STEPS**order + (noise * rng.normal(size=5) if noise else 0.0)
    return [Run(dt, value, error, 1.0, 1.0) for dt, value in zip(STEPS, values, strict=True)]


@pytest.mark.parametrize(("theory", "truth"), [(1, None), (2, 1.0), (4, None)])
def test_the_error_that_is_wanted_gives_the_order_as_well_as_is_wanted(theory, truth):
    rng = np.random.default_rng(20261121)
    error = judged_order(theory, levels_of(theory, 0.1 * STEPS[1] ** theory), truth).wanted
    again = judged_order(theory, levels_of(theory, error), truth)
    # The smaller the error, the more nearly is the profile a parabola.
    assert error == pytest.approx(again.wanted, rel=0.3) and again.short < 1.3
    orders = [
        judged_order(theory, levels_of(theory, error, error, rng), truth).order for _ in range(40)
    ]
    # The spread is ORDER_ERROR, its own error 1/sqrt(2 39) = 11 %; three of those, and 40 % for
    # what the profile at first is not.
    assert 0.5 * ORDER_ERROR < np.std(orders) < 1.8 * ORDER_ERROR


def test_an_order_that_is_known_badly_or_is_none_is_said_to_be():
    rng = np.random.default_rng(7)
    sharp = judged_order(2, levels_of(2, 1e-5, 1e-5, rng))
    assert sharp.verdict == "as theory" and abs(sharp.order - 2.0) < 0.1 and not sharp.beyond
    blunt = judged_order(2, levels_of(2, 1e-2, 1e-2, rng))
    low, high = blunt.order_error
    assert max(blunt.order - low, high - blunt.order) > 0.5 and blunt.verdict == "not resolved"
    assert judged_order(2, levels_of(4, 1e-6, 1e-6, rng)).verdict == "pre-asymptotic"
    # The bias of the two largest of five steps only: no power does that.
    values = [1.0 + b for b in (1.0, 0.03, 0.0, 0.0, 0.0)]
    levels = [Run(dt, v, 1e-4, 1.0, 1.0) for dt, v in zip(STEPS, values, strict=True)]
    result = judged_order(2, levels)
    assert result.beyond and result.verdict == "pre-asymptotic"


def test_an_exact_scene_knows_its_moment_and_derives_its_sample():
    system, unsolved = load_scene("fig3a").system, load_scene("fig6b").system
    assert full_density(unsolved, displacement_of_study(unsolved)) is None
    slope = sample_slope(load_scene("cir").system, MonteCarlo(paths=4096))
    assert abs(slope.slope + 0.5) < 4.0 * slope.slope_error
    found = weak_order(system, MonteCarlo(scheme="baoab", paths=4096), seconds=0.5)
    assert found.known and found.limit_error < 1e-5 * found.levels[0].error
    assert found.verdict in ("as theory", "not resolved", "pre-asymptotic")
    low, high = found.order_error
    assert low <= found.order <= high and len(found.levels) == 5
    largest = max(level.error for level in found.levels)
    assert found.short == pytest.approx(max(1.0, largest / found.wanted))
    assert found.verdict == "not resolved" or low - 1.0 <= 2.0 <= high + 1.0


def test_the_command_prints_one_object_and_leaves_files(fpk, tmp_path):
    status, out, _ = fpk("converge", "fig6b", "--of", "H", "--json", "--out", tmp_path)
    record = json.loads(out)
    assert status == 0 and record["scene"] == "fig6b"
    names = {ladder["name"] for ladder in record["equations"][0]["ladders"]}
    own = {"h, p = 1", "h, p = 2", "h, p = 4", "p on a fixed mesh", "nonintegrable/fem"}
    assert names == own and "not a bound" in record["limits_of_the_index"]
    for ending in ("md", "nc", "svg"):
        assert (tmp_path / f"converge.{ending}").stat().st_size > 1000
    assert "asymptotic" in (tmp_path / "converge.md").read_text(encoding="utf-8")


@pytest.mark.parametrize("bar", [None, np.array([0.5, 0.5, 1e-6])])
def test_the_axis_of_errors_is_that_of_the_curves_however_long_their_bars(bar):
    curve = Curve("a", [1.0, 2.0, 4.0], [1e-1, 1e-3, 1e-5], bar)
    (axes,) = study_figure([Panel("title", "x", "y", [curve])]).axes
    low, high = axes.get_ylim()
    assert 1e-8 < low < 1e-5 and 1e-1 < high < 10.0


def test_a_density_without_a_number_is_said_to_have_none():
    level = Level("p = 2", error=float("nan"), stated=1e3, seconds=0.0, estimate=1.5e3)
    ladder = Ladder("p", "(24)", 1, "p", None, (level,), {}, {})
    study = ConvergenceStudy(load_scene("sdof"), [{"equation": "(24)", "ladders": [ladder]}])
    (problem,) = study.problems
    assert problem.startswith("(24), p, p = 2: the density is no number") and "1.5e+03" in problem
