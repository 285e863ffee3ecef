"""How the tests of averaging ask: densities by name, and questions in time."""

import numpy as np
from systems import TURNED as TURNED

from fpk.answer.method import silent
from fpk.answer.names import Coordinate, parse_limit, parse_observable, parse_start


def solved(method, system, *names):
    """Densities of the observables named, also where the motion itself escapes far out."""
    observables = [parse_observable(name, system.n) for name in names]
    return method.prepare(system).solve(observables, silent).densities


def ask(method, question, system, *arguments, tol=None):
    """The certified answer; the first argument is the number of a mass, from 0, but for rates."""
    if question != "relaxation":
        row, *arguments = arguments
        arguments = [(Coordinate("q", row),), *arguments]
    answer = getattr(method, question)(system, *arguments, tol=tol, progress=silent)
    assert answer.certificate.certified, answer.certificate.failures
    return answer


def transient(method, system, name, start, times, *at, tol=1e-8):
    points = tuple(np.asarray(x, float) for x in at)
    observable, begin = parse_observable(name, system.n), parse_start(start, system)
    times = np.asarray(times, float)
    return method.transient(system, observable, begin, times, points, tol=tol, progress=silent)


def passage(method, system, limit, start="rest", times=(), tol=1e-8):
    end, begin = parse_limit(limit, system.n), parse_start(start, system)
    return method.passage(system, end, begin, np.asarray(times, float), tol=tol, progress=silent)


def assert_agree(one, other):
    """Two first passages agree within the sum of their errors; ``one`` is certified."""
    assert one.certificate.certified, one.certificate.failures
    for name in ("mean", "variance", "rate"):
        a, b = getattr(one, name), getattr(other, name)
        assert abs(a.value - b.value) <= a.error + b.error, name
    gap = np.abs(one.survival - other.survival)
    assert np.all(gap <= one.survival_error + other.survival_error)


def assert_near(one, other, rounding=0.0):
    """Two certified answers at points agree within the sum of their errors."""
    assert one.certificate.certified, one.certificate.failures
    assert np.all(np.abs(one.values - other.values) <= one.errors + other.errors + rounding)
