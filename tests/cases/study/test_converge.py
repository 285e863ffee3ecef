"""Convergence studies: orders against theory, what they are called, Richardson, and the command."""

import json
from dataclasses import replace

import numpy as np
import pytest

from cases.scene.errors import BadInput
from cases.scene.scene import load_scene
from cases.show.pictures.draw import study_figure
from cases.show.pictures.panel import Curve, Panel
from cases.study.converge import ConvergenceStudy, chosen_routes, families
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


@pytest.mark.parametrize("order", [1.0, 2.0, 5.0])
def test_a_pure_power_shows_its_order(order):
    found = convergence(SIZES, 3.0 * SIZES**order, theory=order, floor=0.0)
    np.testing.assert_allclose(found.orders, order, rtol=1e-12)
    assert found.kind == "asymptotic" and found.spread < 1e-12


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


def test_exponential_convergence_shows_its_rate():
    degrees = np.arange(1.0, 7.0)
    found = convergence(np.exp(-degrees), np.exp(-1.7 * degrees), theory=None, floor=0.0)
    np.testing.assert_allclose(found.orders, 1.7)
    assert found.kind == "asymptotic"
    slowing = convergence(np.exp(-degrees), np.exp(-np.sqrt(degrees) * 3), theory=None, floor=0.0)
    assert np.all(np.diff(slowing.orders) < 0.0)


def test_richardson_finds_the_limit_and_the_index_covers_it():
    values = 7.0 + 0.3 * SIZES**2 + 0.01 * SIZES**3
    found = grid_convergence(values, theory=2.0, floor=0.0)
    assert found.safety == 1.25 and found.kind == "asymptotic"
    assert abs(values[-1] - 7.0) <= found.index
    assert abs(found.value - 7.0) < 0.1 * abs(values[-1] - 7.0)
    far = grid_convergence(7.0 + 0.3 * SIZES, theory=2.0, floor=0.0)
    assert far.safety == 3.0 and abs(far.used - 1.0) < 1e-9
    assert 0.3 * SIZES[-1] <= far.index
    swinging = grid_convergence([1.0, 0.9, 0.95], theory=2.0, floor=0.0)
    assert swinging.kind == "oscillating" and swinging.safety == 3.0
    assert grid_convergence([1.0] * 6, theory=2.0, floor=1e-15).kind == "at the floor"


@pytest.fixture(scope="module")
def energy_ladders():
    return {
        ladder.name: ladder
        for ladder in map(Study.ladder, families(energy_equation(load_scene("fig6b").system)))
    }


@pytest.mark.parametrize("degree", [1, 2, 4])
def test_energy_orders_are_those_of_theory_with_contact(energy_ladders, degree):
    verdict = energy_ladders[f"h, p = {degree}"].verdicts["L1"]
    assert verdict.kind == "asymptotic" and len(verdict.orders) >= 4
    assert np.all(np.abs(np.array(verdict.orders[-2:]) - (degree + 1)) <= NEAR_THEORY)


def test_every_level_of_every_family_is_within_its_own_estimate(energy_ladders):
    assert len(energy_ladders) == 5
    for ladder in energy_ladders.values():
        assert len(ladder.levels) >= 4
        for level in ladder.levels:
            assert level.honest, (ladder.name, level)
            assert set(level.errors) == {*DENSITY_NORMS, *FUNCTIONALS}


@pytest.mark.parametrize("contacts", [True, False])
def test_convergence_in_p_is_exponential_with_contact_and_without(energy_ladders, contacts):
    system = load_scene("fig6b").system
    found = energy_ladders["p on a fixed mesh"]
    if not contacts:
        free = energy_equation(replace(system, contacts=()))
        found = free.study(free.degrees()).ladder()
    rates = found.verdicts["L1"].orders
    assert len(rates) >= 4
    # A straight line on log-lin paper: what a degree takes off does not shrink. Of an algebraic
    # error p^-k the step from a to b takes off k ln(b/a)/(b - a) a degree.
    a, b = np.array(P_DEGREES[: len(rates)]), np.array(P_DEGREES[1 : len(rates) + 1])
    algebraic = np.log(b / a) / (b - a)
    assert rates[-1] / rates[-3] > 0.5 * (1.0 + algebraic[-1] / algebraic[-3])
    assert all(level.honest for level in found.levels)


STEPS = 0.4 / np.sqrt(2.0) ** np.arange(5.0)


def levels_of(order, error, noise=0.0, rng=None):
    """Levels with a bias dt^order, the standard error that they state, and as much noise."""
    chance = noise * rng.normal(size=5) if noise else np.zeros(5)
    return [Run(dt, 1.0 + dt**order + x, error, 1.0, 1.0)
            for dt, x in zip(STEPS, chance, strict=True)]  # fmt: skip


def judged_order(theory, levels, truth=None):
    return with_order(WeakOrder("x", "E q1²", theory), levels, truth)


@pytest.mark.parametrize("known", [True, False])
@pytest.mark.parametrize("theory", [1, 2, 4])
def test_the_error_that_is_wanted_gives_the_order_as_well_as_is_wanted(theory, known):
    rng = np.random.default_rng(20261121)
    truth = 1.0 if known else None
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


def test_an_order_that_is_known_badly_is_not_resolved():
    rng = np.random.default_rng(7)
    sharp = judged_order(2, levels_of(2, 1e-5, 1e-5, rng))
    assert sharp.verdict == "as theory" and abs(sharp.order - 2.0) < 0.1
    blunt = judged_order(2, levels_of(2, 1e-2, 1e-2, rng))
    low, high = blunt.order_error
    assert max(blunt.order - low, high - blunt.order) > 0.5 and blunt.verdict == "not resolved"
    other = judged_order(2, levels_of(4, 1e-6, 1e-6, rng))
    assert other.verdict == "pre-asymptotic"


def test_a_trusted_index_covers_the_true_error(energy_ladders):
    trusted = 0
    for ladder in energy_ladders.values():
        for key, g in ladder.grid.items():
            if g.safety == 1.25:
                trusted += 1
                # The index knows nothing of round-off, where the finest level has arrived: that of
                # p counts twice in ∫p².
                assert ladder.levels[-1].errors[key] <= g.index + 2.0 * DENSITY_ROUND_OFF * abs(
                    g.value
                )
    assert trusted


def test_an_equation_that_is_not_the_right_one_does_not_converge():
    system = load_scene("fig6b").system

    def wrong(process):
        def coefficients(energy):
            c = process.coefficients(energy)
            return c._replace(dissipation=1.1 * c.dissipation, drift=c.drift + 0.1 * c.dissipation)

        return replace(process, coefficients=coefficients)

    equation = energy_equation(system)
    equation = replace(equation, process=wrong(equation.process))
    found = equation.study(equation.elements(2)).ladder()
    assert found.verdicts["L1"].kind != "asymptotic"
    assert not found.levels[-1].honest


def plane_errors(equation, degree):
    first = equation.elements(degree)
    levels = [level for _, level in equation.study(first).levels()]
    assert all(level.honest for level in levels)
    return {key: [level.errors[key] for level in levels] for key in DENSITY_NORMS}


@pytest.mark.parametrize(
    "scene", ["fig6b", pytest.param("vanderpol-modal", marks=pytest.mark.slow)]
)
def test_two_energies_show_the_order_of_theory(scene):
    # Equation (34) and, with damping that depends on the energies, plain elements as reference.
    found = plane_errors(modal_equation(load_scene(scene).system), 2)
    orders = observed_orders(SIZES[:5], found["L1"])
    distance = np.abs(orders - 3.0)
    assert np.all(distance[-3:] <= NEAR_THEORY) and distance.argmin() == distance.size - 1


@pytest.mark.parametrize("degree", [1, 2, 3])
def test_the_largest_error_has_the_order_of_theory_on_a_mesh_even_in_the_amplitude(degree):
    # On a mesh even in H the point H1 = H2 = 0, where b vanishes, costs degree 1 a factor |ln h|.
    found = plane_errors(modal_equation(load_scene("fig6b").system), degree)
    orders = observed_orders(SIZES[:5], found["max"])
    assert np.all(np.abs(orders[-1:] - (degree + 1)) <= NEAR_THEORY)


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


def test_a_discretisation_refines_itself_and_states_its_level():
    equation = energy_equation(load_scene("fig6b").system)
    first = equation.elements(2)
    finer = first.refined().refined()
    coarse, fine = (int(d.settings.split()[0]) for d in (first, finer))
    assert fine == 4 * coarse and (finer.size, finer.degree) == (0.25, 2)
    by_tolerance = equation.to_tolerance(next(iter(equation.by_tolerance)), 2, 2)
    assert by_tolerance.name == "nonintegrable/fem" and by_tolerance.refined().promised == 1e-4


def test_the_exact_scene_knows_its_moment_and_the_samples_their_slope():
    scene = load_scene("fig3a")
    assert full_density(scene.system, displacement_of_study(scene.system)) is not None
    unsolved = load_scene("fig6b").system
    assert full_density(unsolved, displacement_of_study(unsolved)) is None
    found = sample_slope(scene.system, MonteCarlo(paths=4096, threads=2))
    assert abs(found.slope + 0.5) < 4.0 * found.slope_error


def test_weak_order_on_an_exact_scene_derives_its_sample():
    method = MonteCarlo(scheme="baoab", paths=4096, threads=2)
    found = weak_order(load_scene("fig3a").system, method, seconds=0.5)
    assert found.known and found.limit_error < 1e-5 * found.levels[0].error
    assert found.verdict in ("as theory", "not resolved", "pre-asymptotic")
    low, high = found.order_error
    assert low <= found.order <= high
    largest = max(level.error for level in found.levels)
    assert found.short == pytest.approx(max(1.0, largest / found.wanted))
    assert len(found.levels) == 5
    if found.verdict != "not resolved":
        assert low - 1.0 <= 2.0 <= high + 1.0


def test_routes_are_chosen_by_name_or_observable():
    assert chosen_routes(None, "H") == ("nonintegrable",)
    assert chosen_routes("integrable", None) == ("integrable",)
    assert len(chosen_routes(None, None)) == 3
    for route, of in (("fem", None), (None, "q7"), ("integrable", "H")):
        with pytest.raises(BadInput):
            chosen_routes(route, of)


def test_the_command_prints_one_object_and_leaves_files(fpk, tmp_path):
    status, out, _ = fpk("converge", "fig6b", "--of", "H", "--json", "--out", tmp_path)
    record = json.loads(out)
    assert status == 0 and record["scene"] == "fig6b"
    families = {ladder["name"] for ladder in record["equations"][0]["ladders"]}
    assert families == {"h, p = 1", "h, p = 2", "h, p = 4", "p on a fixed mesh"} | {
        "nonintegrable/fem"
    }
    assert "not a bound" in record["limits_of_the_index"]
    for ending in ("md", "nc", "svg"):
        assert (tmp_path / f"converge.{ending}").stat().st_size > 1000
    assert "asymptotic" in (tmp_path / "converge.md").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("scene", "words"), [("one-mass", "one mass"), ("near-resonance", "internal resonance")]
)
def test_a_route_that_alone_is_asked_for_and_does_not_apply_is_refused(fpk, scene, words):
    status, out, err = fpk("converge", scene, "--route", "integrable", "--json")
    assert status == 2 and not out and words in err and err.count("\n") == 1


def test_a_fit_at_the_end_of_the_orders_tried_is_called_none():
    # The bias of the two largest of five steps only: no power does that.
    values = [1.0 + b for b in (1.0, 0.03, 0.0, 0.0, 0.0)]
    levels = [Run(dt, v, 1e-4, 1.0, 1.0) for dt, v in zip(STEPS, values, strict=True)]
    result = judged_order(2, levels)
    assert result.beyond and result.verdict == "pre-asymptotic"
    assert not judged_order(2, levels_of(2, 1e-5, 1e-5, np.random.default_rng(7))).beyond


@pytest.mark.parametrize("bar", [None, np.array([0.5, 0.5, 1e-6])])
def test_the_axis_of_errors_is_that_of_the_curves_however_long_their_bars(bar):
    curve = Curve("a", [1.0, 2.0, 4.0], [1e-1, 1e-3, 1e-5], bar)
    (axes,) = study_figure([Panel("title", "x", "y", [curve])]).axes
    low, high = axes.get_ylim()
    assert 1e-8 < low < 1e-5 and 1e-1 < high < 10.0


def test_a_wrong_route_is_refused_in_one_line(fpk):
    status, out, err = fpk("converge", "fig6b", "--route", "magic")
    assert status == 2 and not out and "nonintegrable" in err


@pytest.mark.slow
def test_steps_at_which_trajectories_are_lost_give_no_warning(fpk, scene_text, tmp_path):
    """Of one mass without stops; warnings are errors in tests."""
    path = tmp_path / "one.toml"
    path.write_text(
        "[system]\nmass = [1.0]\nstiffness = [1.0]\ndamping = [0.1]\nnoise_intensity = [0.1]\n"
    )
    _, out, err = fpk("converge", path, "--route", "montecarlo", "--seconds", 3)
    assert "dt" in out and "Warning" not in err


def test_a_density_without_a_number_is_said_to_have_none():
    level = Level("p = 2", error=float("nan"), stated=1e3, seconds=0.0, estimate=1.5e3)
    ladder = Ladder("p", "(24)", 1, "p", None, (level,), {}, {})
    study = ConvergenceStudy(load_scene("sdof"), [{"equation": "(24)", "ladders": [ladder]}])
    (problem,) = study.problems
    assert problem.startswith("(24), p, p = 2: the density is no number") and "1.5e+03" in problem
