"""Modal energies in time: finite elements against closed forms, and refusals."""

import numpy as np
import pytest
from asked import (
    assert_agree,
    assert_known,
    assert_near,
    modal_van_der_pol,
    noise_proportional,
    passage,
    solved,
    transient,
)
from numpy.testing import assert_allclose
from processes import rate
from references import Chain, EnergyReference, Term, chain_of

from averaging.integrable import Integrable
from averaging.modal.analysis import modal_analysis
from fpk import DampingTerm, System
from fpk.answer.density import l1_distance
from fpk.answer.method import silent
from fpk.solvers.square_root import SquareRoot

FIG8 = System([1.0, 1.0], [1.0, 1.0], [0.05, 0.07], [0.015, 0.015])
UNLIKE = System([1.0, 2.0], [1.0, 3.0], [0.1, 0.3], [0.02, 0.05])
ALIKE = System([1.0, 1.0], [1.0, 1.0], [0.1, 0.1], [0.05, 0.05])
CLOSED, FEM = Integrable("closed-form"), Integrable("fem")
PAIR = [0.0, 0.1, 0.4], [0.0, 0.3, 0.1]


@pytest.mark.parametrize(
    ("name", "start", "at"),
    [
        ("H2,H1", "H1=0.2,H2=0.1", PAIR),
        ("H1", "q1=0.4,p2=0.5", ([0.0, 0.2, 1.0],)),
        ("H", "rest", ([0.01, 0.3, 1.0],)),
        ("H2", "noise=0.5", ([0.0, 0.2, 1.0],)),
        ("q1", "H1=0.1,H2=0.3", (np.linspace(-1.0, 1.0, 10),)),
    ],
)
def test_finite_elements_give_the_closed_form_in_time(name, start, at):
    exact, fem = (
        transient(m, UNLIKE, name, start, [20.0, 80.0, 300.0], *at, tol=1e-8) for m in (CLOSED, FEM)
    )
    assert exact.certificate.certified, exact.certificate.failures
    assert_near(fem, exact)
    assert np.all(fem.errors <= 1e-8 * exact.values.max(axis=1, keepdims=True))


def test_a_time_too_short_for_the_mesh_is_reported():
    answer = transient(FEM, FIG8, "H1", "H1=0.3,H2=0.2", [0.02], [0.3], tol=1e-3)
    exact = transient(CLOSED, FIG8, "H1", "H1=0.3,H2=0.2", [0.02], [0.3])
    assert not answer.certificate.certified
    assert "too short" in " ".join(answer.certificate.failures)
    error = abs(answer.values - exact.values)[0, 0]
    assert 1e-3 * exact.values[0, 0] < error <= answer.errors[0, 0]


@pytest.mark.parametrize("limit", ["H1=0.6", "H1=0.6,H2=0.5"])
def test_first_passage_by_elements_is_that_of_the_product(limit):
    times = [0.0, 3.0, 10.0, 40.0]
    exact, fem = (passage(m, FIG8, limit, "H1=0.2,H2=0.1", times) for m in (CLOSED, FEM))
    assert exact.certificate.certified, exact.certificate.failures
    assert_agree(fem, exact)
    for number in (fem.mean, fem.variance, fem.rate):
        assert number.error <= 1e-6 * abs(number.value)


@pytest.mark.parametrize("folds", [0.5, 3.0, pytest.param(20.0, marks=pytest.mark.slow)])
def test_the_sum_of_like_modes_is_a_gamma_process_of_two(folds):
    modes = ALIKE.fact(modal_analysis)
    theta, c = modes.temperature[0], 2.0 * modes.half_bandwidth[0]
    limit, start = f"H={folds * theta}", f"H1={0.1 * folds * theta},H2={0.3 * folds * theta}"
    guess = SquareRoot(2, 1.0, 1.0).rate(folds).value
    root = float(c * rate(2, folds, guess))
    closed, fem = (passage(method, ALIKE, limit, start, [1.0]) for method in (CLOSED, FEM))
    assert_agree(fem, closed)
    for found in (closed.rate, fem.rate):
        assert abs(found.value - root) <= found.error <= 1e-8 * found.value


def test_relaxation_rates_are_sums_of_multiples_of_the_decays():
    exact, fem = (m.relaxation(FIG8, 6, tol=1e-8, progress=silent) for m in (CLOSED, FEM))
    decays = 2.0 * FIG8.fact(modal_analysis).half_bandwidth
    assert_allclose(exact.values[0].real, decays.min(), rtol=1e-14)
    assert_near(fem, exact)


NAMES = ("H2,H1", "H1", "H", "q1", "p2", "q1,q2", "q1,p2")


def tiny(coefficient):
    terms = (DampingTerm(1, 1, coefficient, ((1, 2),)), DampingTerm(2, 1, coefficient, ((2, 2),)))
    c, D = [0.008, 0.004], [0.001, 0.002]
    return System([1.0, 1.0], [1.0, 1.0], c, D, damping_terms=terms)


def test_without_terms_in_the_limit_it_is_the_gaussian():
    # Terms of 1e-14: through blocks, plane elements and waves to (34) and (36).
    for one, two in zip(
        solved(Integrable("fem"), tiny(1e-14), *NAMES),
        solved(Integrable(), tiny(0.0), *NAMES),
        strict=True,
    ):
        assert one.certificate.certified and one.l1_error < 1e-10, one.name
        # 1e-14 on the damping 0.004 shifts the density by a relative 1e-11 or less.
        assert l1_distance(one, two) <= one.l1_error + two.l1_error + 1e-11, one.name


def test_decoupled_modes_are_solved_one_by_one(tol=1e-5):
    system = modal_van_der_pol(others=0.0, mass=(0.5, 2.0))
    names = ("H2,H1", "H1", "H", "q1", "q2,p2")
    three = [
        solved(Integrable(s, tol), system, *names) for s in ("closed-form", "quadrature", "fem")
    ]
    for closed, quadrature, fem in zip(*three, strict=True):
        for other in (quadrature, fem):
            assert other.l1_error <= tol and other.certificate.certified, other.name
            assert l1_distance(closed, other) <= closed.l1_error + other.l1_error, other.name
        assert closed.moment(*len(closed.panels) * (0,)).value == pytest.approx(1.0, abs=1e-9)
    # Mode 1 is C exp(−∫γ M*/d dH) with γ = −0.004 + 0.03 H/(2 K* M*), d = 2e-4 (M* = 1).
    terms = (Term(0, 0.03 / (2 * modal_analysis(system).natural_frequency[0] ** 2), "H"),)
    numbers = np.ones(1), np.ones(1), np.array([[-0.004]]), np.array([[2e-4]])
    H = np.linspace(0.01, 0.5, 21)
    exact, _ = EnergyReference(Chain(*numbers, terms=terms)).of_energy(H)
    assert_known(three[2][1], [H], exact, rounding=1e-11 * exact.max())


@pytest.mark.parametrize(
    ("h0", "h1", "tol"),
    [(-6.0, 40.0, 1e-6), pytest.param(0.4, 2.0, 1e-10, marks=pytest.mark.slow)],
    ids=["limit sphere", "settled"],
)
def test_exact_density_over_phase_space(h0, h1, tol):
    # c = h(H) f D fᵀ: the averaged equations keep C exp(−∫h dH), whatever masses and noise.
    system = noise_proportional(h0, h1)
    names = ("H1,H2", "H2", "H", "q1", "p2", "q1,q2")
    energies, one, total, q1, p2, both = solved(Integrable("fem", tol), system, *names)
    rng = np.random.default_rng(20040801)
    compliance = np.linalg.inv(system.stiffness_matrix)
    scale = float(np.mean(modal_analysis(system).temperature))

    def compare(density, points, unnormalised, norm):
        exact = unnormalised / norm
        assert_known(density, points, exact, rounding=1e-11 * exact.max())
        assert density.l1_error <= tol

    terms = tuple(Term(i, h1 * system.noise_matrix[i, i], "H") for i in range(2))
    reference = EnergyReference(chain_of(system, terms))
    # E = ½ Σ y² over 2n = 4 scaled coordinates: each observed one takes a freedom away.
    H = scale * np.linspace(0.0, 4.0, 9)
    whole = reference.weyl(2.0, np.zeros(1))[0]
    compare(total, [H], H * reference.weyl(0.0, H), whole)
    compare(one, [H], reference.weyl(1.0, H), whole)
    x, y = scale * rng.exponential(size=(2, 20))
    compare(energies, [x, y], reference.weyl(0.0, x + y), whole)
    y1 = np.sqrt(scale) * np.linspace(-3.0, 3.0, 13)
    single = reference.weyl(1.5, 0.5 * y1**2) / np.sqrt(2.0 * np.pi)
    for density, size in ((q1, compliance[0, 0]), (p2, system.mass[1])):
        compare(density, [y1 * np.sqrt(size)], single / np.sqrt(size), whole)
    y2 = np.sqrt(scale) * rng.normal(size=(2, 20))
    double = reference.weyl(1.0, 0.5 * np.sum(y2**2, axis=0)) / (2.0 * np.pi)
    L = np.linalg.cholesky(compliance)
    compare(both, list(L @ y2), double / np.linalg.det(L), whole)
