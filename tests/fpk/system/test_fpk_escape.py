"""Damping terms that let the motion escape: by mathematics, by integration, and over all routes."""

import re

import numpy as np
import pytest
from asked import assert_refused
from scipy.integrate import solve_ivp
from systems import in_units

from averaging import Integrable, NonIntegrable
from averaging.phase_space.method import PhaseSpace
from cases.compare.routes import all_routes
from cases.study.equations import energy_equation
from fpk import Contact, DampingTerm, System
from fpk.answer.names import REST, parse_limit, parse_observable, parse_start
from fpk.numeric.errors import InvalidInput, NotApplicable, NotCertified
from fpk.system.escape import escape
from sim import MonteCarlo


def damped(*terms, n=1, contacts=()):
    """c = 0.1 on each of n unit masses and terms such as (0.4, "q1 v2 v2 H") in c_11.

    "21: q1" stands in c_21.
    """
    records = []
    for coefficient, text in terms:
        place, _, factors = text.rpartition(":")
        i, j = (int(k) for k in place or "11")
        powers = {"q": {}, "v": {}, "H": {}}
        for kind, *mass in factors.split():
            own, at = powers[kind], int("".join(mass) or 0)
            own[at] = own.get(at, 0) + 1
        q, v = (tuple(powers[kind].items()) for kind in "qv")
        records.append(DampingTerm(i, j, coefficient, q, v, powers["H"].get(0, 0)))
    one = [1.0] * n
    damping, noise = [0.1] * n, [0.2] * n
    return System(one, one, damping, noise, contacts=contacts, damping_terms=tuple(records))


def stop(side, exponent, stiffness=4.0):
    return (Contact(1, side, stiffness, 0.5, "power", exponent),)


ODD = damped((0.4, "q1"))
ESCAPES = "the motion escapes"

CASES = {
    # dv/dq = −f(q, v) − q/v, q' = v: outwards on the left, v ~ −0.2 q².
    "odd in q": (True, ODD),
    "odd in v": (True, damped((0.4, "v1"))),  # v' = −0.4 v² for v < 0
    "negative": (True, damped((-0.3, "v1 v1"))),
    "outwards": (True, damped((-0.4, "q1 v1"))),  # v ~ exp(0.2 q²)
    # Between v = 0.38 q and v = 2.6 q, where v settles: q' = 2.6 q.
    "cone outwards": (True, damped((1, "q1 q1"), (-3, "q1 v1"), (1, "v1 v1"))),
    "cone inwards": (False, damped((1, "q1 q1"), (3, "q1 v1"), (1, "v1 v1"))),
    # v = C exp(−0.2 q) + a polynomial; on the axis q = 0 alone −0.2 v³ leads.
    "exponential": (True, damped((0.4, "q1 q1"), (0.2, "v1"))),
    # 0 < −q < 1.4: v' = −0.55 q v³ + 0.4 q² v³ is positive at any speed.
    "in a strip": (True, damped((0.4, "q1 q1 v1 v1"), (0.55, "q1 v1 v1"))),
    # |q| < √(0.6/v) is crossed before v grows by more than its square root.
    "across a strip": (False, damped((0.4, "q1 q1 v1 v1"), (-0.6, "v1"))),
    "van der Pol": (False, damped((1, "q1 q1"))),
    "odd below even": (False, damped((-0.2, "q1"), (0.3, "q1 q1"))),
    "rotating": (False, damped((0.3, "12: q1"), (-0.3, "21: q1"), n=2)),  # does no work
    "energy": (False, damped((0.1, "H"), (0.4, "q1"), (-0.4, "v1"))),
    "of another mass": (True, damped((0.4, "q2"), n=2)),
    "force on another mass": (True, damped((0.4, "21: q1"), n=2)),
    # A burst ends with q1 so far on the other side that q2 swings out farther, to the next one.
    "bursts": (True, damped((1, "q1 q1"), (-0.3, "q2 q2"), n=2)),
    "kept on the left": (False, damped((0.4, "q1"), contacts=stop("left", 5.0))),
    "kept on the right": (True, damped((0.4, "q1"), contacts=stop("right", 5.0))),
    "too soft a stop": (True, damped((0.4, "q1"), contacts=stop("both", 1.5, 50.0))),
    # Force B x³: v = −s x² with 2 s² − 0.4 s + B = 0 has no root beyond B = 0.02.
    "just too soft": (True, damped((0.4, "q1"), contacts=stop("left", 3.0, 0.01))),
    "just stiff enough": (False, damped((0.4, "q1"), contacts=stop("left", 3.0, 0.04))),
    "no stop keeps v": (True, damped((0.4, "v1"), contacts=stop("both", 5.0))),
}


@pytest.mark.parametrize("name", CASES)
def test_what_escapes_is_known_from_the_motion_far_out(name):
    escapes, system = CASES[name]
    assert (system.fact(escape) is not None) == escapes, system.fact(escape)


def goes_out(start):
    """Whether the motion of ``ODD`` without noise from ``start`` (q, v) ends at infinity.

    Where it does so, v ~ −0.2 q²: it is there after a finite time.
    """

    def far(t, z):
        return abs(z[0]) - 1e9

    def change(t, z):
        return [z[1], -(0.1 + 0.4 * z[0]) * z[1] - z[0]]

    far.terminal = True
    path = solve_ivp(change, (0.0, 1e3), start, method="LSODA", rtol=1e-6, events=far)
    return bool(path.t_events[0].size)


def test_the_reason_names_the_term_and_states_from_which_the_motion_escapes():
    reason = ODD.fact(escape) or ""
    words = "damping term 0.4 q1 of c_11 feeds energy in for q1 < -0.25 without bound: the motion "
    assert reason.startswith(words + "escapes") and "\n" not in reason
    start = np.array([float(x) for x in re.findall(r"[qv]\d = (\S+?)[, ]", reason)])
    assert goes_out(start) and not goes_out(-start)
    for system, words in (
        (CASES["negative"][1], "-0.3 v1^2 of c_11 feeds energy in for |v1| > 0.577 without bound"),
        (damped((-0.3, "q1 q1 H")), "-0.3 q1^2 H of c_11 feeds energy in without bound"),
        (CASES["force on another mass"][1], "of c_21 feeds energy in where q1 < 0 and v1 < 0 and"),
    ):
        assert words in (system.fact(escape) or "")


@pytest.mark.parametrize("name", ["odd in v", "of another mass"])
def test_no_route_gives_a_density_of_a_motion_that_escapes(name):
    _, system = CASES[name]
    density = [parse_observable(name, system.n) for name in ("q1", "H")]
    refusals = [r.make().refusal(system, o) for r in all_routes() for o in density]
    assert len(refusals) > 20 and all(refusals)
    q1 = parse_observable("q1", system.n)
    for method in (NonIntegrable(), PhaseSpace(), MonteCarlo()):
        assert_refused(NotApplicable, ESCAPES, method.solve, system, [q1])
    assert_refused(NotApplicable, ESCAPES, MonteCarlo().crossings, system, q1, np.zeros(1))


def test_what_does_not_need_a_stationary_state_is_answered():
    times, at = np.array([1.0]), (np.array([0.0]),)
    H, q1 = (parse_observable(name, 1) for name in ("H", "q1"))
    averaged = NonIntegrable().passage(ODD, parse_limit("H=1", 1), REST, times)
    assert averaged.certificate.certified
    for method in (NonIntegrable(), Integrable()):
        assert_refused(NotApplicable, ESCAPES, method.transient, ODD, H, REST, times, at)
    for method in (NonIntegrable(), Integrable(), PhaseSpace()):
        assert_refused(NotApplicable, ESCAPES, method.relaxation, ODD, 2)
    assert_refused(NotApplicable, ESCAPES, energy_equation, ODD)
    assert_refused(InvalidInput, "no stationary state", parse_start, "noise=0.5", ODD)
    # After 10 time units most trajectories are gone: no smaller step brings them back.
    method = MonteCarlo(paths=4096, seconds=0.5)
    with pytest.raises(NotCertified, match="left the range that the energy allows: damping term"):
        method.transient(ODD, q1, REST, np.array([10.0]), at)


@pytest.mark.parametrize("name", ["across a strip", "just stiff enough", "odd in q"])
def test_units_do_not_matter(name):
    escapes, system = CASES[name]
    assert (escape(in_units(system, 1e3, 1e-4, 1e5)) is not None) == escapes
