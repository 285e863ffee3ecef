"""Solutions with damping terms: limits, exact densities over phase space, limit cycles."""

from dataclasses import replace

import numpy as np
import pytest
from asked import solved
from modal_terms import modal_van_der_pol, noise_proportional
from scipy.integrate import quad

from averaging.integrable import Integrable
from averaging.modal.analysis import modal_analysis
from fpk import Contact, DampingTerm, System
from fpk.answer.density import l1_distance
from fpk.answer.names import parse_observable

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


@pytest.mark.parametrize("tol", [1e-5, pytest.param(1e-10, marks=pytest.mark.slow)])
def test_decoupled_modes_are_solved_one_by_one(tol):
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
    modes = modal_analysis(system)
    rate = 0.03 / (2 * modes.natural_frequency[0] ** 2)

    def fall(H):
        return np.exp((0.004 * H - 0.5 * rate * H**2) / 2e-4 - (0.004**2 / (2 * rate)) / 2e-4)

    norm = quad(fall, 0.0, 3.0, epsabs=0.0, epsrel=1e-13, limit=200)[0]
    H = np.linspace(0.0, 0.5, 21)
    p, error = three[2][1].at(H)
    assert np.all(np.abs(p - fall(H) / norm) <= error + 1e-11 * p.max())


EXACT = {"settled": (0.4, 2.0), "limit sphere": (-6.0, 40.0)}


def exact_factor(h0, h1, freedoms, x2):
    """∫exp(−E(½x² + R)) R^(f/2 − 1) dR for E = h0 H + ½ h1 H², over f coordinates of R."""

    def density(half):
        def value(R):
            H = half + R
            return np.exp(-h0 * H - 0.5 * h1 * H * H - (0.5 * h0**2 / h1 if h0 < 0 else 0.0))

        if freedoms == 0:
            return float(value(0.0))
        # R = r²: the weight R^(f/2 − 1) dR is 2 r^(f − 1) dr.
        end = 2.0 * (np.sqrt(abs(h0) / h1) + np.sqrt(12.0 / np.sqrt(h1)))
        tols = {"epsabs": 0.0, "epsrel": 1e-12, "limit": 200}
        return quad(lambda r: 2.0 * r ** (freedoms - 1) * value(r * r), 0.0, end, **tols)[0]

    return np.array([density(half) for half in np.ravel(x2)]).reshape(np.shape(x2))


@pytest.mark.parametrize(
    ("case", "tol"),
    [
        ("limit sphere", 1e-6),
        *(
            pytest.param(c, t, marks=pytest.mark.slow)
            for c, t in (("settled", 1e-6), ("settled", 1e-10))
        ),
    ],
)
def test_exact_density_over_phase_space(case, tol):
    # c = h(H) f D fᵀ: the averaged equations keep C exp(−∫h dH), whatever masses and noise.
    h0, h1 = EXACT[case]
    system = noise_proportional(h0, h1)
    names = ("H1,H2", "H2", "H", "q1", "p2", "q2,p2", "q1,q2")
    energies, one, total, q1, p2, pair, both = solved(Integrable("fem", tol), system, *names)
    rng = np.random.default_rng(20040801)
    compliance = np.linalg.inv(system.stiffness_matrix)
    scale = float(np.mean(modal_analysis(system).temperature))

    def compare(density, points, unnormalised, norm):
        p, error = density.at(*points)
        assert density.l1_error <= tol and density.certificate.certified, density.name
        assert np.all(np.abs(p - unnormalised / norm) <= error + 1e-11 * p.max()), density.name

    # E = ½ Σ y² over 2n = 4 scaled coordinates: each observed one takes a freedom away.
    H = scale * np.linspace(0.0, 4.0, 9)
    whole = exact_factor(h0, h1, 4, np.array([0.0]))[0]
    compare(total, [H], H * exact_factor(h0, h1, 0, H), whole)
    compare(one, [H], exact_factor(h0, h1, 2, H), whole)
    x, y = scale * rng.exponential(size=(2, 20))
    compare(energies, [x, y], exact_factor(h0, h1, 0, x + y), whole)
    # Over directions: the share of one of 4 coordinates y is Γ(2)/(Γ(½) Γ(3/2)) = 2/π of it, with
    # dy = √2 d√(½y²) and of a pair 1/(2π).
    y1 = np.sqrt(scale) * np.linspace(-3.0, 3.0, 13)
    single = exact_factor(h0, h1, 3, 0.5 * y1**2) * np.sqrt(2.0) / np.pi
    for density, size in ((q1, compliance[0, 0]), (p2, system.mass[1])):
        compare(density, [y1 * np.sqrt(size)], single / np.sqrt(size), whole)
    y2 = np.sqrt(scale) * rng.normal(size=(2, 20))
    double = exact_factor(h0, h1, 2, 0.5 * np.sum(y2**2, axis=0)) / (2.0 * np.pi)
    L = np.diag(np.sqrt([compliance[1, 1], system.mass[1]]))
    compare(pair, list(L @ y2), double / np.linalg.det(L), whole)
    L = np.linalg.cholesky(compliance)
    compare(both, list(L @ y2), double / np.linalg.det(L), whole)
    # A density of another h must not pass.
    off = exact_factor(1.01 * h0, h1, 3, 0.5 * y1**2) * np.sqrt(2.0) / np.pi
    p, error = p2.at(y1 * np.sqrt(system.mass[1]))
    off = off / np.sqrt(system.mass[1]) / exact_factor(1.01 * h0, h1, 4, np.array([0.0]))[0]
    assert np.max(np.abs(p - off) / (error + 1e-11)) > 100.0


def test_contacts_are_left_out_with_the_rule():
    stop = (Contact(2, "both", 5.0, 0.3),)
    system = replace(modal_van_der_pol(others=0.0), contacts=stop)
    result = Integrable("closed-form", 1e-6).solve(system, [parse_observable("H1", 2)])
    assert "does not hold" in result.neglected
