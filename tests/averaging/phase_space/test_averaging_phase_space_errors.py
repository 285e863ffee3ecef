"""Stated errors of the unreduced equation against finer solutions, and what ends the solutions."""

import re
import tracemalloc
from collections.abc import Iterator
from contextlib import nullcontext
from dataclasses import replace
from itertools import islice, product

import numpy as np
import pytest
from systems import both, fig6
from test_averaging_phase_space import ONE_NOISE, common, drawn, stop, two

import fpk
from averaging.phase_space import refinement
from averaging.phase_space.equation import elimination
from averaging.phase_space.equation.basis import basis
from averaging.phase_space.equation.degrees import Degrees
from averaging.phase_space.equation.elimination import LEAF, expand, inverse_by_quarters
from averaging.phase_space.equation.frame import contact_frame, gibbs_reference, make_reference
from averaging.phase_space.method import PhaseSpace
from averaging.phase_space.refinement import SOLUTION_WORK, Ladder, Options, solution_ladder
from fpk.answer.density import l1_distance
from fpk.answer.method import silent
from fpk.answer.names import parse_observable
from fpk.numeric.errors import InvalidInput, NotApplicable, NotCertified

SINGLE = [parse_observable(o, 2) for o in ("q1", "q2", "p1", "p2")]
SYSTEM = fig6(both(10.0))


def lighter(factor, B=10.0, clearance=0.5):
    """Fig. 6 with damping and noise divided by ``factor``."""
    system = fig6(both(B, clearance))
    damping, noise = system.damping / factor, system.noise_intensity / factor
    return replace(system, damping=damping, noise_intensity=noise)


def solutions(system, work, *, observables=SINGLE, threads=None) -> Iterator[Ladder]:
    """Solutions of rising degrees, whatever their errors."""
    options = Options(4.0, work, threads)
    found = solution_ladder(contact_frame(system), observables, options)
    # The last one comes again with what ends them.
    return (ladder for ladder in found if not ladder.limit)


@pytest.mark.slow
@pytest.mark.parametrize(("seed", "count", "coldest"), [(20261124, 24, 0.3), (20261125, 16, 0.05)])
def test_errors_of_random_systems_are_within_the_stated_ones(seed, count, coldest):
    """Other systems than those by which the factor on the error was chosen."""
    rng = np.random.default_rng(seed)
    for _ in range(count):
        *coarser, finest = islice(solutions(drawn(rng, coldest=coldest), 8e11, threads=1), 4)
        assert coarser
        for ladder, o in product(coarser, SINGLE):
            distance = refinement.solution_distance(ladder.finest, finest.finest, o)
            assert distance <= ladder.errors[o]


DAMPED = fpk.DampingTerm(1, 1, 0.3, v=((1, 2),))
MANY = {
    "one mass, v²": fpk.System(
        [1.0], [1.0], [0.05], [0.2], damping_terms=(DAMPED,),
        contacts=stop(1, "right", 3.0, 0.0, law="bilinear"),
    ),
    "left": common(stop(1, "left", 10.0, 0.3)),
    "a tenth of the damping": lighter(10.0),
    "random, unlike temperatures": drawn(np.random.default_rng(20261126), coldest=0.1),
}  # fmt: skip


@pytest.mark.parametrize(
    ("name", "work"),
    [("one mass, v²", 8e9)]
    + [pytest.param(name, 2e10, marks=pytest.mark.slow) for name in list(MANY)[2:]],
)
def test_a_smaller_tolerance_gives_no_larger_error_and_none_below_the_true_one(
    name, work, monkeypatch
):
    made, solve, system = {}, refinement.expand, MANY[name]

    def expand(frame, about, degrees, **options):
        # Solutions do not depend on the tolerance.
        if degrees not in made:
            made[degrees] = solve(frame, about, degrees, **options)
        return made[degrees]

    monkeypatch.setattr(refinement, "expand", expand)
    observables = [parse_observable(f"{c}{i + 1}", system.n) for c in "qp" for i in range(system.n)]
    references = PhaseSpace(tol=1e-12, work=4.0 * work).solve(system, observables).densities
    before = np.full(len(observables), np.inf)
    for tol in (1e-2, 1e-3, 1e-4, 1e-5, 1e-6):
        answers = PhaseSpace(tol=tol, work=work).solve(system, observables).densities
        errors = np.array([p.l1_error for p in answers])
        assert np.all(errors <= 1.01 * before)
        distances = [l1_distance(p, q) for p, q in zip(answers, references, strict=True)]
        assert np.all(distances <= errors)
        before = errors


def test_an_earlier_density_is_kept_unless_a_later_one_contradicts_it():
    observables = [parse_observable("q1", 2)]
    coarse, fine = islice(solutions(MANY["left"], 1e12, observables=observables), 2)
    (o,) = observables
    own = refinement.solution_distance(coarse.finest, fine.finest, o)
    for error, kept in ((1.01 * own, coarse), (0.99 * own, fine)):
        first = replace(coarse, errors={o: error})
        worse, better = (replace(fine, errors={o: x * error}) for x in (2.0, 0.5))
        assert refinement.better(first, worse, o).finest is kept.finest
        assert refinement.better(first, better, o) is better


@pytest.mark.parametrize("factor", [0.3, 3.0])
def test_the_reference_does_not_depend_on_the_one_it_begins_with(factor):
    frame = contact_frame(ONE_NOISE)
    found = refinement.fit_reference(frame, gibbs_reference(frame))
    start = gibbs_reference(frame)
    start = make_reference(frame, start.slope, start.offset, factor * start.covariance)
    other = refinement.fit_reference(frame, start)
    assert other.slope == pytest.approx(found.slope, abs=0.02)
    assert other.covariance == pytest.approx(found.covariance, abs=0.02)


@pytest.mark.parametrize(
    ("n", "side", "degrees", "kind"),
    [(2, "right", (21, 7, 20), np.float32), (3, "both", (13, 5, 13), np.float64)],
)
def test_a_solution_takes_no_more_memory_than_stated(n, side, degrees, kind, monkeypatch):
    damping, noise = np.linspace(0.08, 0.04, n), np.linspace(0.01, 0.02, n)
    system = fpk.System(np.ones(n), np.ones(n), damping, noise, contacts=stop(2, side))
    frame, degrees = contact_frame(system), Degrees(*degrees)
    about = gibbs_reference(frame)
    functions = basis(frame, about, degrees)
    stated, _ = elimination.solution_cost(functions, numbers=kind)
    monkeypatch.setattr(elimination, "ELIMINATED_IN", kind)
    tracemalloc.start()
    try:
        expand(frame, about, degrees, memory=0.0)
        _, most = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    # A statement of twice as much would refuse solutions that fit.
    assert 0.4 * stated < most < stated


def test_more_memory_is_more_work_too():
    for memory, work in ((4.0, SOLUTION_WORK), (16.0, 8.0 * SOLUTION_WORK)):
        assert PhaseSpace(memory=memory)._options() == Options(memory, work)
    assert Options(16.0, 1e9).refusal(1.7e10, 1.0) == (
        "a finer solution needs 17 GB of memory, at most 16"
    )
    assert "2e+09 operations, at most 1e+09" in Options(16.0, 1e9).refusal(1.6e10, 2e9)
    assert not Options(16.0, 1e9).refusal(1.6e10, 1e9)
    for memory in (0.0, -1.0, np.nan, np.inf):
        with pytest.raises(InvalidInput, match="positive number of GB"):
            PhaseSpace(memory=memory)


def test_a_distance_that_falls_by_chance_is_not_believed():
    first, error = refinement.error_by_distances(1e-3, None)
    safety = refinement.DISTANCE_SAFETY
    assert first == 1e-3 and error == pytest.approx(refinement.FIRST_SAFETY * safety * 1e-3)
    believed, error = refinement.error_by_distances(1e-5, first)
    assert believed == pytest.approx(2.5e-4)
    assert error == pytest.approx(safety * 2.5e-4)


def test_what_is_out_of_reach_is_refused_after_its_first_solutions():
    """A hot mass beside a contact mass without noise of its own, which is light, or overdamped."""
    hot = two([1.58, 0.184], [0.465, 1.05], [0.224, 0.0581], [0.378, 0.0],
              2, "left", 31.4, 0.469, "bilinear")  # fmt: skip
    method, words = PhaseSpace(tol=1e-3), "would not fall to 0.01 before memory or work end"
    assert words in method.prepare(hot).attempt(SINGLE, silent)
    assert method.prepare(ONE_NOISE).attempt(SINGLE, silent) is None
    slaved = two([0.228, 2.4], [1.3, 1.77], [0.391, 0.0282], [0.0, 0.0457],
                 1, "left", 779.0, 0.151, "bilinear")  # fmt: skip
    assert "are of no distribution" in method.prepare(slaved).attempt(SINGLE, silent)


def test_an_error_above_one_is_refused_after_two_solutions():
    found = solution_ladder(FRAME, SINGLE, Options(4.0, 1e13))
    ladder, options = next(found), Options(4.0, 1e13)
    for error, refused in ((0.9, False), (1e9, True)):
        large = replace(ladder, errors=dict.fromkeys(SINGLE, error))
        with pytest.raises(NotApplicable) if refused else nullcontext():
            refinement.require_reach(large, None, options, 1e-3)
    # A third solution whose error has not fallen decides, however small the work.
    third = replace(large, errors=dict.fromkeys(SINGLE, 0.02), solutions=3)
    with pytest.raises(NotApplicable, match=r"its error, 0\.02 at degree 17"):
        refinement.require_reach(third, replace(third, solutions=2), options, 1e-3)


def leave_unsolved(monkeypatch, low, high):
    """Make as if the equations of the degrees from ``low`` to ``high`` were not solved."""
    solved = refinement.expand

    def expand(frame, about, degrees, **options):
        e = solved(frame, about, degrees, **options)
        return replace(e, residual=np.nan) if low <= degrees.total <= high else e

    monkeypatch.setattr(refinement, "expand", expand)


def test_without_two_solved_systems_of_equations_there_is_no_answer(monkeypatch):
    leave_unsolved(monkeypatch, 17, 17)
    with pytest.raises(NotCertified, match="equations of degree 17 are not solved"):
        PhaseSpace(tol=1e-6).solve(SYSTEM, SINGLE[:1])


def test_a_solution_whose_equations_are_not_solved_is_not_used(monkeypatch):
    leave_unsolved(monkeypatch, 22, 99)
    result = PhaseSpace(tol=1e-6).solve(SYSTEM, SINGLE[:1])
    assert result.settings["highest degree"] == 21
    failures = " ".join(result.densities[0].certificate.failures)
    assert re.search(r"the equations of degree 27 are not solved", failures)


DEGREES = Degrees(total=16, others=6, outer=18)
FRAME = contact_frame(SYSTEM)


@pytest.mark.parametrize("system", [SYSTEM, lighter(10.0, 100.0, 0.1)])
def test_an_elimination_in_single_precision_is_refined_to_double(system, monkeypatch):
    frame = contact_frame(system)
    about = gibbs_reference(frame)
    refined = expand(frame, about, DEGREES, memory=0.0)
    monkeypatch.setattr(elimination, "ELIMINATED_IN", np.float64)
    double = expand(frame, about, DEGREES, memory=0.0)
    for a, b in zip(refined.levels, double.levels, strict=True):
        # A residual of 1e-14 is an error of as much times the condition of the equations: with
        # damping ratios of 0.004 some 1e4.
        assert a == pytest.approx(b, abs=1e-10)
    assert max(refined.residual, double.residual) < 1e-13


def test_where_refinement_fails_the_elimination_is_repeated_in_double(monkeypatch):
    kinds, solved = [], elimination._solve

    def failing(chain, solve, scale):
        kinds.append(solve(np.zeros(chain.ends[-1])).dtype)
        u, residual = solved(chain, solve, scale)
        return u, residual if kinds[-1] == np.float64 else np.nan

    monkeypatch.setattr(elimination, "_solve", failing)
    assert expand(FRAME, gibbs_reference(FRAME), DEGREES).residual < 1e-13
    assert kinds == [np.float32, np.float64]
    assert np.isnan(expand(FRAME, gibbs_reference(FRAME), DEGREES, memory=0.0).residual)


@pytest.mark.parametrize("odd", [False, True])
def test_derivatives_map_one_set_of_functions_onto_the_other(odd):
    b = basis(FRAME, gibbs_reference(FRAME), DEGREES, odd=odd)
    values, slopes = b.functions(b.points)
    D = (values @ b.broken).T @ (b.weights[:, None] * (slopes @ b.continuous))
    # The function 1 has no derivative; where all functions are odd it is not among them.
    assert b.broken.shape[1] == b.continuous.shape[1] - (not odd)
    # The slowest function between the ends of the support has one half-wave.
    sizes = np.linalg.svd(D, compute_uv=False)[: b.broken.shape[1]]
    assert sizes[-1] > 1.0 / (b.nodes[-1] - b.nodes[0])


@pytest.mark.parametrize("size", [1, LEAF + 1])
def test_the_inverse_by_quarters_is_the_inverse(size):
    rng = np.random.default_rng(20261123)
    A = rng.normal(size=(size, size)) / np.sqrt(size) - 3.0 * np.eye(size)
    assert inverse_by_quarters(A, range(0, size, 7)) @ A == pytest.approx(np.eye(size), abs=1e-12)


def test_a_block_that_is_singular_in_front_is_inverted_between_its_cuts():
    turn = np.array([[0.0, 1.0], [-1.0, -0.1]])
    A = np.kron(np.eye(300), turn)
    A[:300, 300:] += 0.1 * np.eye(300)
    assert inverse_by_quarters(A, range(0, 600, 2)) @ A == pytest.approx(np.eye(600), abs=1e-11)
