"""The work-precision study: wrong routes are caught and not timed, prices follow from points."""

from dataclasses import replace

import numpy as np
import pytest

from cases.scene.scene import load_scene
from cases.show.study_page import Table
from cases.study import prices
from cases.study.cost import CostStudy, coarsest_routes, equation_routes
from cases.study.equations import energy_equation
from cases.study.law import FULL, Law, price_schemes, price_solutions
from cases.study.levels import Level
from cases.study.prices import NotTimed, Priced, crossovers, passage_routes, price_list
from cases.study.simulation import full_reference
from fpk.solvers.line.stationary import solve_stationary

EMPTY = CostStudy(load_scene("fig6b"))


def test_the_sign_of_28_as_printed_is_caught_by_every_route_and_not_timed():
    """Damping that feeds the energy has no stationary density: every route refuses the process."""
    equation = energy_equation(load_scene("fig6b").system)

    def as_printed(energy):
        c = equation.process.coefficients(energy)
        return c._replace(drift=c.drift - 2.0 * c.dissipation, dissipation=-c.dissipation)

    wrong = replace(equation, process=replace(equation.process, coefficients=as_printed))
    bad = equation_routes(wrong, coarsest_routes(wrong))
    assert {n.route for n in bad} == {c.name for c in coarsest_routes(wrong)}
    assert all(isinstance(n, NotTimed) and "drift points outwards" in n.reason for n in bad)


def test_a_slightly_wrong_answer_is_named_with_what_it_disagrees_by():
    equation = energy_equation(load_scene("fig6b").system)
    *_, fem, quadrature = coarsest_routes(equation)
    right = solve_stationary(equation.process, tol=1e-8)
    # Mass moved by 1e-6 while 1e-8 is stated: a factor 1 + 1e-6 moves L1 by 1e-6.
    moved = replace(right.answer, coefficients=(1 + 1e-6) * right.answer.coefficients)
    wrong = replace(right, answer=moved, measured=replace(right.measured, l1_error=1e-8))
    offered = [quadrature, replace(fem, name="wrong/fem", solve=lambda: wrong)]
    good, caught = equation_routes(equation, offered)
    assert caught.route == "wrong/fem" and caught.wrong and not caught.baseline
    assert abs(caught.distance - 1e-6) < 2e-8 and caught.allowed < 2e-8
    assert isinstance(good, Priced) and good.route == "nonintegrable/quadrature"
    found = replace(EMPTY, routes=[good], not_timed=[caught])
    assert len(found.problems) == 1 and "wrong" in found.problems[0]


@pytest.mark.slow
def test_a_simulation_of_another_system_is_not_timed(monkeypatch):
    monkeypatch.setattr("cases.study.simulation.REFERENCE_RELAXATIONS", 60.0)
    system = load_scene("fig6b").system
    stops = tuple(replace(s, clearance=0.8 * s.clearance) for s in system.contacts)
    reference = full_reference(replace(system, contacts=stops), seed=5)
    results, _ = price_schemes(system, reference, seed=6)
    caught = {n.route for n in results if isinstance(n, NotTimed) and n.distance > n.allowed}
    assert "exact_flow" in caught
    assert not any("exact_flow" in r.route for r in results if isinstance(r, Priced))


def test_a_baseline_without_a_usable_step_is_told_and_is_no_failure():
    wrong = NotTimed("exact_flow", FULL, "dt 0.1", 0.5, 0.1, "differs")
    for bad, failures in (
        (replace(wrong, route="baoab", baseline=True), 0),
        (NotTimed("euler_maruyama", FULL, reason="no usable step", baseline=True), 0),
        (wrong, 1),
    ):
        found = replace(EMPTY, not_timed=[bad])
        assert len(found.problems) == failures
        assert any("not timed" in table.title for table in found.page().tables)


def test_json_says_null_where_a_route_states_an_infinite_error_and_files_are_named(
    fpk, answer, refusal, monkeypatch, tmp_path
):
    endless = Level("4", 0.1, float("inf"), float("inf"))
    untimed = NotTimed("w", "e", "4", float("nan"), float("inf"), "no finite error")
    found = replace(EMPTY, routes=[Priced("r", "e", "axis", (endless,))], not_timed=[untimed])
    monkeypatch.setattr("cases.study.cost.study_cost", lambda *a, **k: found)
    record = answer("cost", "fig6b", "--out", tmp_path)
    assert record["scene"] == "fig6b" and record["routes"][0]["points"][0]["stated"] is None
    assert record["not_timed"][0]["allowed"] is None
    status, out, err = fpk("cost", "fig6b", "--out", tmp_path)
    assert status == 0 and out.count("wrote ") == 4 and not err
    refusal("cost", "fig6b", "--out", "/dev/null", "--json")


def route(name, pairs):
    points = tuple(Level(f"{e:g}", e, e, t) for e, t in pairs)
    return Priced(name, "equation", "axis", points)


CHEAP = route("cheap", [(1e-1, 1e-3), (1e-2, 1e-2), (1e-3, 1e-1), (1e-4, 1.0)])
GOOD = route("good", [(1e-2, 3e-2), (1e-6, 4e-2), (1e-10, 5e-2)])


def test_prices_take_the_cheapest_point_that_is_good_enough():
    found = {row["digits"]: row for row in price_list([CHEAP, GOOD])}
    assert found[1]["route"] == "cheap" and found[2]["route"] == "cheap"
    assert found[3]["route"] == "good" and found[3]["point"].settings == "1e-06"
    assert found[10]["point"].seconds == 5e-2
    assert {row["digits"]: row["point"] for row in price_list([CHEAP])}[5] is None
    # A tolerance is priced by its promise, not by what it happened to reach.
    lucky = Level("1e-02", 1e-9, 1e-8, 1.0, promised=1e-2)
    mesh = Level("24", 1e-9, 1e-8, 0.1)
    own = price_list([Priced("hp", "e", "axis", (lucky, mesh))], promised=True)[:3]
    points = [row["point"] for row in own]
    assert [p and p.settings for p in points] == ["1e-02", "1e-02", None]


def test_the_crossover_lies_where_the_laws_meet():
    (found,) = crossovers([CHEAP, GOOD])
    # cheap: t = 1e-4/e; good: t = 3e-2 (e/1e-2)^(−log10(4/3)/4): equal near e = 3.1e-3.
    e = found["error"]
    assert (found["above"], found["below"]) == ("cheap", "good")
    ours, theirs = 1e-4 / e, 3e-2 * (e / 1e-2) ** (-np.log10(4 / 3) / 4)
    assert abs(np.log(ours / theirs)) < 0.1  # a tenth: three steps of the scan


@pytest.mark.parametrize("order", [1, 4])
def test_the_cheapest_path_of_a_law_meets_its_error_and_is_the_cheapest(order):
    law = Law("x", 4.0, 0.2, True, order, 1e-8, 1.0, 0.0)
    dt, sampled = law.cheapest(1e-3)
    assert law.error(sampled, dt) == pytest.approx(1e-3, rel=1e-12)
    for other in (0.8 * dt, 1.2 * dt):
        left = 1e-3 - law.bias * other**order
        if left > 0:
            assert law.seconds((law.noise / left) ** 2, other) > law.seconds(sampled, dt)


@pytest.mark.slow
def test_the_command_prices_ten_digits_and_leaves_a_diagram(answer, tmp_path):
    record = answer("cost", "fig6b", "--out", tmp_path)
    assert record["problems"] == []
    assert {r["equation"] for r in record["routes"]} >= {FULL, "averaged equation (24)"}
    own = [p for p in record["prices"] if p["equation"] == "averaged equation (24)"]
    assert [p["digits"] for p in own] == list(range(1, 11))
    for price in own:
        assert price["point"]["error"] <= 10.0 ** -price["digits"]
    for ending in ("md", "html", "nc", "svg"):
        assert (tmp_path / f"cost.{ending}").stat().st_size > 1000


def test_a_table_is_markdown_in_aligned_columns_without_repeats():
    """First cells equal to those of the row above are left out, the last cell never."""
    cells = [("x", 4, 1.0), ("x", 4, None), ("y", 4, (0.5, 2000.0)), ("y", 5, float("nan"))]
    cells.append(cells[-1])
    rows = [dict(zip(("first", "second", "third"), row, strict=True)) for row in cells]
    assert (
        "\n".join(Table("t", "T", rows, ("why",)).markdown())
        == """\
## T

| first | second |          third |
| ----- | -----: | -------------: |
| x     |      4 |           1.00 |
|       |        |              – |
| y     |      4 | 0.500 2.00e+03 |
|       |      5 |              – |
|       |        |              – |

why
"""
    )


def test_the_full_system_is_priced_where_it_is_solved_and_nothing_else_knows_its_density(
    monkeypatch,
):
    """Two small solutions of weak contact; each tolerance is met by the answer that it gave."""
    monkeypatch.setattr("cases.study.law.TOLERANCES", (1e-1, 1e-2))
    monkeypatch.setattr("cases.study.levels.LONG_RUN", 0.0)  # no repeats: no time is looked at
    (priced,), best = price_solutions(load_scene("fig8a").system)
    assert isinstance(priced, Priced) and priced.route == best.words == "phase-space"
    assert [p.promised for p in priced.points] == [1e-1, 1e-2]
    assert all(p.honest and p.stated <= p.promised and not p.modelled for p in priced.points)
    assert best.density.l1_error == min(p.stated for p in priced.points)
    (lost,), best = price_solutions(load_scene("fig3a").system)
    assert best is None and "exact has the same density" in lost.reason and not lost.wrong


@pytest.mark.parametrize(
    ("solved", "where"),
    [
        # Sampling takes 1e-6/e²: equal to 1e-3/e at e = 1e-3.
        ([(1e-1, 1e-2), (1e-5, 1e2)], 1e-3),
        ([(1e-1, 1e-5), (1e-5, 1e-3)], None),  # the cheapest at every error
        ([(1e-1, 1e3), (1e-5, 1e5)], None),
    ],
)
def test_the_page_says_where_a_solution_overtakes_sampling(solved, where):
    law = tuple(Level("N", e, e, 1e-6 / e**2, modelled=True) for e in np.geomspace(1e-6, 0.3, 100))
    routes = [replace(route("p", solved), equation=FULL), Priced("s", FULL, "axis", law)]
    (table,) = [t for t in replace(EMPTY, routes=routes).page().tables if t.name == "crossings"]
    at = [row["error"] for row in table.rows if row["below"] == "p"]
    assert at == ([] if where is None else [pytest.approx(where, rel=0.05)])


def test_a_wrong_failure_rate_is_not_timed(monkeypatch):
    scene = load_scene("cir")
    right = prices._rate

    def wrong(method, *asked):
        rate = right(method, *asked)
        return replace(rate, value=(1.001 if method.solver == "fem" else 1.0) * rate.value)

    monkeypatch.setattr(prices, "_rate", wrong)
    own = [route for route in prices.all_routes() if route.method == "nonintegrable"]
    monkeypatch.setattr(prices, "all_routes", lambda: own)
    routes = passage_routes(scene.system, scene.passages[0], simulate=False, seed=1)
    (caught,) = (route for route in routes if isinstance(route, NotTimed) and route.wrong)
    # Which of both is wrong nobody knows: the one is caught that states the larger error.
    assert caught.distance == pytest.approx(1e-3, rel=0.01)
    priced = [route for route in routes if isinstance(route, Priced)]
    assert all("relative error of the failure rate" in route.axis for route in priced)
    assert {"nonintegrable/fem", "nonintegrable/closed-form"} > {route.route for route in priced}
    assert priced and all(p.honest and p.error < 1e-10 for r in priced for p in r.points)
    refused = {route.route: route.reason for route in routes if isinstance(route, NotTimed)}
    assert "quadrature" in refused["nonintegrable/quadrature"]
