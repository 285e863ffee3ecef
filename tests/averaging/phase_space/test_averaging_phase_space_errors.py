"""Stated errors of the unreduced equation against finer solutions, and what ends the solutions."""

import tracemalloc
from collections.abc import Iterator
from dataclasses import replace
from itertools import islice

import numpy as np
import pytest
from test_averaging_phase_space import FIG6, STOP, common, drawn, stop

import fpk
from averaging.phase_space import refinement
from averaging.phase_space.densities import expansion_density
from averaging.phase_space.dynamics import questions
from averaging.phase_space.equation import elimination
from averaging.phase_space.equation.basis import basis
from averaging.phase_space.equation.degrees import Degrees
from averaging.phase_space.equation.elimination import expand
from averaging.phase_space.equation.frame import contact_frame, gibbs_reference
from averaging.phase_space.method import PhaseSpace
from averaging.phase_space.refinement import SOLUTION_WORK, Ladder, Options, solution_ladder
from fpk.answer.density import l1_distance
from fpk.answer.names import parse_observable
from fpk.numeric.errors import InvalidInput, NotCertified

SINGLE = [parse_observable(o, 2) for o in ("q1", "q2", "p1", "p2")]
SYSTEM = fpk.System(**FIG6, noise_intensity=[0.01, 0.02], contacts=(STOP,))


def lighter(B, clearance, factor):
    """Fig. 6 with other stops, damping and noise divided by ``factor``."""
    stop = fpk.Contact(mass=2, side="both", stiffness=B, clearance=clearance)
    damping, noise = np.array([0.08, 0.04]) / factor, np.array([0.01, 0.02]) / factor
    return fpk.System([1, 1], [1, 1], damping, noise, contacts=(stop,))


def solutions(system, work, *, observables=SINGLE, threads=None) -> Iterator[Ladder]:
    """Solutions of rising degrees, whatever their errors."""
    options = Options(4.0, work, threads)
    found = solution_ladder(contact_frame(system), observables, options)
    # The last one comes again with what ends them.
    return (ladder for ladder in found if not ladder.limit)


def understated(coarser, finest):
    """Where the distance to the finest solution is more than the stated error, and how much."""
    return [
        (ladder.finest.basis.degrees, o, error / ladder.errors[o])
        for ladder in coarser
        for o in finest.errors
        if (error := refinement.solution_distance(ladder.finest, finest.finest, o))
        > ladder.errors[o]
    ]


@pytest.mark.slow
@pytest.mark.parametrize(("seed", "count", "coldest"), [(20261124, 24, 0.3), (20261125, 16, 0.05)])
def test_errors_of_random_systems_are_within_the_stated_ones(seed, count, coldest):
    """Other systems than those by which the factor on the error was chosen."""
    rng = np.random.default_rng(seed)
    for _ in range(count):
        *coarser, finest = islice(solutions(drawn(rng, coldest=coldest)[0], 8e11, threads=1), 4)
        assert coarser and not understated(coarser, finest)


def with_term(coefficient, **powers):
    """One mass with a bilinear stop, damped by 0.05 + ``coefficient`` times ``powers`` of v."""
    term = fpk.DampingTerm(1, 1, coefficient, **powers)
    contacts = stop(1, "right", 3.0, 0.0, law="bilinear")
    return fpk.System([1.0], [1.0], [0.05], [0.2], contacts=contacts, damping_terms=(term,))


rng = np.random.default_rng(20261126)
TWELVE = {
    "one mass": common(stop(1, "left", 10.0, 0.3), mass=(1.0,)),
    "one mass, v²": with_term(0.3, v=((1, 2),)),
    "one mass, |v| of fourth power": with_term(0.02, v=((1, 4),)),
    "Fig. 6": SYSTEM,
    "Fig. 6, soft stop": lighter(1.0, 0.5, 1),
    "Fig. 6, near stop": lighter(10.0, 0.1, 1),
    "Fig. 6, half the damping": lighter(10.0, 1.0, 2),
    "Fig. 6, a tenth of the damping": lighter(10.0, 0.5, 10),
    "far power stop on the left": fpk.System(
        [0.71, 1.575], [0.353, 0.381], [0.0486, 0.0261], [0.04443, 0.01799],
        contacts=stop(1, "left", 27.44, 1.9854, law="power", exponent=2.5),
    ),
    "Fig. 8(b), far stops": lighter(10.0, 1.5, 1),
    "random": drawn(rng)[0],
    "random, unlike temperatures": drawn(rng, coldest=0.1)[0],
}  # fmt: skip


@pytest.mark.parametrize(
    ("name", "work"),
    [("one mass", 1e6), ("one mass, v²", 1e8)]
    + [
        pytest.param(name, 1e9 if "one mass," in name else 2e10, marks=pytest.mark.slow)
        for name in TWELVE
    ],
)
def test_a_smaller_tolerance_gives_no_larger_error_and_none_below_the_true_one(
    name, work, monkeypatch
):
    made, solve, system = {}, refinement.expand, TWELVE[name]

    def expand(frame, about, degrees, **options):
        # Solutions do not depend on the tolerance.
        if degrees not in made:
            made[degrees] = solve(frame, about, degrees, **options)
        return made[degrees]

    monkeypatch.setattr(refinement, "expand", expand)
    observables = [parse_observable(f"{kind}{i + 1}", system.n) for kind in "qp"
                   for i in range(system.n)]  # fmt: skip
    *_, finest = solutions(system, 8.0 * work, observables=observables)
    references = [expansion_density(finest, o, np.inf) for o in observables]
    before = np.full(len(observables), np.inf)
    for tol in (1e-2, 1e-3, 1e-4, 1e-5, 1e-6):
        answers = PhaseSpace(tol=tol, work=work).solve(system, observables).densities
        errors = np.array([p.l1_error for p in answers])
        assert np.all(errors <= 1.01 * before)
        distances = [l1_distance(p, q) for p, q in zip(answers, references, strict=True)]
        assert np.all(distances <= errors)
        before = errors


def test_an_earlier_density_is_kept_unless_a_later_one_contradicts_it(monkeypatch):
    coarse, fine = islice(solutions(SYSTEM, 1e11, observables=SINGLE[:1]), 2)
    (o,), distance = SINGLE[:1], refinement.solution_distance
    own = distance(coarse.finest, fine.finest, o)
    for error, kept in ((1.01 * own, coarse), (0.99 * own, fine)):
        first = replace(coarse, errors={o: error})
        worse, better = (replace(fine, errors={o: x * error}) for x in (2.0, 0.5))
        assert refinement.better(first, worse, o).finest is kept.finest
        assert refinement.better(first, better, o) is better


@pytest.mark.parametrize("kind", [np.float32, np.float64])
@pytest.mark.parametrize(
    ("n", "side", "degrees"),
    [
        pytest.param(2, "both", (23, 8, 22), marks=pytest.mark.slow),
        (2, "right", (21, 7, 20)),
        (3, "both", (13, 5, 13)),
    ],
)
def test_a_solution_takes_no_more_memory_than_stated(n, side, degrees, kind, monkeypatch):
    stop = fpk.Contact(mass=2, side=side, stiffness=10.0, clearance=0.5)
    damping, noise = np.linspace(0.08, 0.04, n), np.linspace(0.01, 0.02, n)
    system = fpk.System(np.ones(n), np.ones(n), damping, noise, contacts=(stop,))
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


def test_where_damping_is_light_one_small_distance_says_less():
    one = contact_frame(fpk.System([1], [1], [0.6], [0.3]))
    half, light = (refinement.credible_ratio(contact_frame(lighter(10.0, 0.5, x))) for x in (2, 10))
    assert refinement.credible_ratio(one) == half == 0.25 and light == 0.6
    first, _ = refinement.error_by_distances(1e-3, None, light)
    # Distances that are believed to fall by 1/0.6 leave 1/(1/0.6 − 1) = 1.5 of the last one.
    believed, error = refinement.error_by_distances(1e-5, first, light)
    assert believed == pytest.approx(6e-4)
    assert error == pytest.approx(1.5 * refinement.DISTANCE_SAFETY * 6e-4)


@pytest.fixture
def failing(monkeypatch):
    """Makes the equations of one solution, counted from 1, unsolved; returns all that are made.

    Those that the reference is fit_reference to do not count.
    """

    def at(number):
        made, solved, fit = [], refinement.expand, refinement.fit_reference

        def fit_reference(*given):
            with monkeypatch.context() as patch:
                patch.setattr(refinement, "expand", solved)
                return fit(*given)

        def expand(*given, **options):
            made.append(solved(*given, **options))
            return replace(made[-1], residual=np.nan) if len(made) == number else made[-1]

        monkeypatch.setattr(refinement, "expand", expand)
        monkeypatch.setattr(refinement, "fit_reference", fit_reference)
        return made

    return at


@pytest.mark.parametrize(("number", "degree"), [(1, 17), (2, 23)])
def test_without_two_solutions_whose_equations_are_solved_there_is_no_answer(
    number, degree, failing
):
    failing(number)
    with pytest.raises(NotCertified, match=f"equations of degree {degree} are not solved"):
        PhaseSpace(tol=1e-6).solve(SYSTEM, SINGLE)


def test_a_solution_whose_equations_are_not_solved_is_not_used(failing):
    made = failing(3)
    result = PhaseSpace(tol=1e-6).solve(SYSTEM, SINGLE)
    assert result.settings["highest degree"] == made[1].basis.degrees.total
    (why,) = [f for f in result.densities[0].certificate.failures if "not solved" in f]
    assert why == f"the equations of degree {made[2].basis.degrees.total} are not solved"


def test_an_answer_ends_with_the_last_solution_whose_equations_are_solved(failing):
    made, compared = failing(3), []

    def compare(ladder, fine, coarse):
        assert (fine.compared, coarse.compared) == (ladder.finest, ladder.coarser)
        compared.append(ladder.finest)
        return np.array([0.1 ** len(compared)])

    ladder, found = questions.adapt(
        contact_frame(SYSTEM),
        SINGLE,
        lambda e, step: questions.Answer(np.ones(1), e, np.ones(1)),
        Options(4.0, SOLUTION_WORK),
        compare,
        tol=1e-2,
        what="",
    )
    # No two solutions are compared twice, which would look as if distances no longer fell.
    assert compared == made[1:2] and ladder.finest is made[1]
    assert found.limit == f"the equations of degree {made[2].basis.degrees.total} are not solved"
    first = refinement.FIRST_SAFETY * refinement.DISTANCE_SAFETY * 0.1
    assert found.errors == pytest.approx(first, rel=1e-6)
