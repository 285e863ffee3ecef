"""The elimination of the chain of levels: without pairs, in single precision, and repeated."""

import numpy as np
import pytest

import fpk
from averaging.phase_space.equation import elimination
from averaging.phase_space.equation.basis import basis
from averaging.phase_space.equation.chain import chain_of
from averaging.phase_space.equation.degrees import Degrees
from averaging.phase_space.equation.elimination import expand
from averaging.phase_space.equation.frame import contact_frame, gaussian_start, gibbs_reference

DEGREES = Degrees(total=16, others=6, outer=18)


def frame_of():
    both = fpk.Contact(mass=2, side="both", stiffness=10.0, clearance=0.5)
    return contact_frame(fpk.System([1, 1], [1, 1], [0.08, 0.04], [0.01, 0.02], contacts=(both,)))


def light(B):
    c = fpk.Contact(mass=2, side="both", stiffness=B, clearance=0.1)
    return contact_frame(fpk.System([1, 1], [1, 1], [0.008, 0.004], [0.001, 0.002], contacts=(c,)))


@pytest.mark.parametrize("frame", [frame_of(), light(10.0), light(100.0)])
def test_an_elimination_in_single_precision_is_refined_to_double(frame, monkeypatch):
    about = gibbs_reference(frame)
    refined = expand(frame, about, DEGREES, memory=0.0)
    monkeypatch.setattr(elimination, "ELIMINATED_IN", np.float64)
    double = expand(frame, about, DEGREES, memory=0.0)
    for a, b in zip(refined.levels, double.levels, strict=True):
        # A residual of 1e-14 is an error of as much times the condition of the equations: with
        # damping ratios of 0.004 some 1e4.
        assert a == pytest.approx(b, abs=1e-10)
    assert max(refined.residual, double.residual) < 1e-13


@pytest.mark.parametrize("frame", [frame_of(), light(10.0)])
def test_pairs_left_out_of_the_elimination_are_in_the_solution(frame):
    about = gaussian_start(frame)
    chain = chain_of(basis(frame, about, DEGREES))
    one = chain.basis.of_one
    answers = []
    for paired in (True, False):
        solve, scale = elimination.eliminate(chain, paired=paired)
        answers.append(elimination._refine(chain, solve, scale, paired=paired))
    for u, residual in answers:
        assert residual < 1e-13
        assert u == pytest.approx(answers[0][0], abs=1e-9)
    # Without the Krylov space it would be that of other equations.
    right = np.concatenate([scale * one, np.zeros(chain.ends[-1] - one.size)])
    assert np.abs(solve(right) - answers[0][0]).max() > 1e-3


def test_stages_of_a_chain_meet_only_the_one_above_and_two_below():
    frame = frame_of()
    about = gibbs_reference(frame)
    chain = chain_of(basis(frame, about, DEGREES))
    rng = np.random.default_rng(20261125)
    u = rng.normal(size=chain.ends[-1])
    parts, product = (np.split(x, chain.ends[:-1]) for x in (u, chain.matrix @ u))
    for n in range(chain.top + 1):
        expected = chain.within(n) @ parts[n]
        for away in (1, -1, -2):
            if 0 <= n + away <= chain.top:
                block = chain.blocks(chain.matrix, away)[n + min(away, 0)]
                expected += block @ parts[n + away]
        assert product[n] == pytest.approx(expected, abs=1e-9)
    assert chain.pack(chain.unpack(u)) == pytest.approx(u, abs=0.0)


def test_where_refinement_fails_the_elimination_is_repeated_in_double(monkeypatch):
    kinds, refined = [], elimination._refine

    def failing(chain, solve, scale, **options):
        kinds.append(solve(np.zeros(chain.ends[-1])).dtype)
        u, residual = refined(chain, solve, scale, **options)
        return u, residual if kinds[-1] == np.float64 else np.nan

    monkeypatch.setattr(elimination, "_refine", failing)
    assert expand(frame_of(), gibbs_reference(frame_of()), DEGREES).residual < 1e-13
    assert kinds == [np.float32, np.float64]
    assert np.isnan(expand(frame_of(), gibbs_reference(frame_of()), DEGREES, memory=0.0).residual)
