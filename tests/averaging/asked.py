"""How the tests of averaging ask, and the systems with damping terms that they share."""

import re

import numpy as np
import pytest
from systems import by_energy

from averaging.modal.analysis import modal_analysis
from fpk import DampingTerm, System
from fpk.answer.method import silent
from fpk.answer.names import Coordinate, parse_limit, parse_observable, parse_start
from fpk.numeric.errors import NotApplicable


def solved(method, system, *names):
    """Densities of the observables named, also where the motion itself escapes far out."""
    observables = [parse_observable(name, system.n) for name in names]
    return method.prepare(system).solve(observables, silent).densities


def ask(method, question, system, *arguments, tol=None):
    """The certified answer of ``question``; the first argument is a mass, from 0, but for rates."""
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
    """``one`` is certified and agrees with ``other`` within ``rounding`` and both errors."""
    assert one.certificate.certified, one.certificate.failures
    assert np.all(np.abs(one.values - other.values) <= one.errors + other.errors + rounding)


def assert_known(density, at, exact, rounding=0.0):
    """``density`` at ``at`` is ``exact`` within ``rounding`` and its error, which is returned."""
    value, error = density.at(*at)
    assert density.certificate.certified, density.certificate.failures
    assert np.all(np.abs(value - exact) <= error + rounding)
    return error


def assert_refused(error, words, asked, *arguments):
    """``asked(*arguments)`` raises ``error``; its message is one line with the regex ``words``."""
    with pytest.raises(error, match=words) as caught:
        asked(*arguments)
    assert "\n" not in str(caught.value)


def assert_refusal(method, system, name, reason):
    """``method.refusal`` and ``NotApplicable`` of ``solve`` have one text, with ``reason``."""
    observable = parse_observable(name, system.n)
    given = method.refusal(system, observable)
    assert given is not None
    assert_refused(NotApplicable, reason, method.solve, system, [observable])
    with pytest.raises(NotApplicable, match=re.escape(given)):
        method.solve(system, [observable])


def refusal(method, system, name):
    """Why ``method`` has no density ``name``, None if it has, whether or not the motion escapes."""
    try:
        return method.prepare(system).refusal(parse_observable(name, system.n))
    except NotApplicable as reason:
        return str(reason)


def van_der_pol(coefficient=0.1, damping=(-0.02, 0.01), noise=(8e-4, 8e-4)):
    """c_11 += ``coefficient`` (q1² + q2²); the constant ``damping`` feeds energy into mode 2."""
    terms = tuple(DampingTerm(1, 1, coefficient, ((k + 1, 2),)) for k in (0, 1))
    return System([1.0, 1.0], [1.0, 1.0], damping, noise, damping_terms=terms)


def in_masses(base, matrix, monomial, coefficient):
    """Terms ``coefficient`` ``matrix`` Q_k² of modal damping, k = ``monomial``, in the masses' q.

    c = T⁻ᵀ c* T⁻¹ and Q_k = Σ_a T⁻¹_ka q_a: a monomial q_a q_b for every entry.
    """
    inverse = np.linalg.inv(modal_analysis(base).mode_shapes)
    physical = coefficient * inverse.T @ matrix @ inverse
    terms = []
    for i, j, a, b in np.ndindex(*(4 * (base.n,))):
        powers = ((a + 1, 2),) if a == b else ((a + 1, 1), (b + 1, 1))
        size = physical[i, j] * inverse[monomial, a] * inverse[monomial, b]
        terms.append(DampingTerm(i + 1, j + 1, size, powers))
    return terms


def by_modes(base, damping, noise, terms):
    """The masses and springs of ``base`` with diagonal modal damping and noise, and ``terms``."""
    inverse = np.linalg.inv(modal_analysis(base).mode_shapes)
    c, D = (inverse.T @ np.diag(x) @ inverse for x in (damping, noise))
    return System(base.mass, base.stiffness, c, 0.5 * (D + D.T), damping_terms=tuple(terms))


def modal_van_der_pol(own=0.03, others=0.03, mass=(1.0, 1.0)):
    """c*_11 = −0.004 + own Q1² + others Q2², c*_22 = 0.01, as monomials in the masses' q."""
    base, first = System(mass, [1.0, 1.0], [0.1, 0.1], [1.0, 1.0]), np.diag([1.0, 0.0])
    terms = in_masses(base, first, 0, own) + in_masses(base, first, 1, others)
    return by_modes(base, [-0.004, 0.01], [2e-4, 2e-4], terms)


def noise_proportional(h0, h1, contacts=(), *, scale=1.0):
    """c = (h0 + h1 H) f D fᵀ: condition (8), so the density is C exp(−h0 H − h1 H²/2)."""
    D = scale * np.array([[0.02, 0.005], [0.005, 0.01]])
    return by_energy([h0, h1], D, contacts, mass=(1.0, 2.0), stiffness=(1.0, 1.5))


def three_to_one(coefficient, *, energy=False, power=2):
    """Two unit masses, ω2 = 3 ω1, with damping ``coefficient`` q1^``power``, or H if ``energy``."""
    least = (10.0 - np.sqrt(28.0)) / 36.0  # λ, 9λ are the roots for 18λ² − 10λ + 1 = 0, k_2 = 9λ²
    D = np.array([1e-3, 1e-3])
    if energy:
        terms = tuple(DampingTerm(i + 1, i + 1, coefficient, energy=1) for i in (0, 1))
    else:
        terms = (DampingTerm(1, 1, coefficient, ((1, power),)),)
    return System([1.0, 1.0], [1.0, 9.0 * least**2], 10.0 * D, D, damping_terms=terms)
