"""Behaviour of the averaged modal energies far out: what has no stationary density is refused."""

import numpy as np
import pytest
from modal_terms import in_masses, modal_van_der_pol, refusal, solved, van_der_pol

from averaging.integrable import Integrable
from averaging.modal.analysis import modal_analysis
from averaging.nonintegrable import NonIntegrable
from fpk.answer.names import parse_observable
from fpk.numeric.errors import NotApplicable
from fpk.system.damping import DampingTerm
from fpk.system.system import System


def pair(*terms):
    return System([1.0, 1.0], [1.0, 1.0], [0.1, 0.1], [0.05, 0.05], damping_terms=terms)


def of_q1(coefficient):
    return pair(DampingTerm(1, 1, coefficient, ((1, 2),)))


GROWING = {
    "-0.01 q1²": of_q1(-0.01),
    "-0.02 q1²": of_q1(-0.02),
    "-0.03 q1²": of_q1(-0.03),
    "0.1 H - 1e-6 H²": pair(DampingTerm(1, 1, 0.1, energy=1), DampingTerm(1, 1, -1e-6, energy=2)),
}


@pytest.mark.parametrize("solver", ["closed-form", "quadrature", "fem"])
@pytest.mark.parametrize("name", GROWING)
def test_energies_that_the_damping_lets_grow_have_no_density(solver, name):
    system = GROWING[name]
    reason = refusal(Integrable(solver), system, "H1")
    assert reason is not None and "for ever" in reason and "\n" not in reason
    with pytest.raises(NotApplicable, match="for ever"):
        solved(Integrable(solver), system, "H1,H2")
    with pytest.raises(NotApplicable, match="for ever"):
        modal_analysis(system)
    # So it is: from high enough energies the averaged drift leads up without a bound.
    drift = modal_process_without_judgement(system)
    H = np.array([[1.0, 1.0]]) * 10.0 ** np.arange(7.0, 10.0)[:, None]
    assert np.all(drift(H).sum(axis=1) > 0.0)


def modal_process_without_judgement(system):
    """The averaged drift of two unit modes, from averages over phases by the trapezoidal rule."""
    modes = modal_analysis(System(system.mass, system.stiffness, [0.1, 0.1], [0.05, 0.05]))
    phase = 2.0 * np.pi * np.arange(12) / 12
    phases = np.stack(np.meshgrid(phase, phase), axis=-1).reshape(-1, 2)
    T = modes.mode_shapes

    def drift(energies):
        total = []
        for H in energies:
            q = np.sqrt(2 * H) / modes.natural_frequency * np.cos(phases) @ T.T
            v = -np.sqrt(2 * H) * np.sin(phases) @ T.T
            c = sum(t.value(q, v, H.sum()) for t in system.damping_terms) + np.zeros(len(q))
            force = np.stack([c * v[:, 0], 0.0 * c], axis=1) + v @ system.damping.T
            flow = np.mean((force @ T) * (v @ np.linalg.inv(T).T), axis=0)
            total.append(modes.noise - flow)
        return np.array(total)

    return drift


@pytest.mark.parametrize(
    "own, others, grows",
    [
        (0.03, 0.03, False),
        # Mode 1 alone would grow, and mode 2 is damped: its energy stays, that of mode 1 does not.
        (-0.03, 0.03, True),
        (-0.03, -0.03, True),
        # Energy of mode 2 feeds mode 1, but less and less beside that of mode 1 itself.
        (0.03, -0.03, False),
    ],
)
def test_one_mode_driven_by_another(own, others, grows):
    # γ_1 = −0.004 + a H_1 + b H_2 with γ_2 = 0.01: H_2 stays where it is.
    system = modal_van_der_pol(own, others)
    reason = refusal(Integrable("fem"), system, "H1")
    assert (reason is not None) == grows, reason


def competing(matrix):
    """γ_m = 0.01 + Σ_k A_mk H_k of two modes."""
    base = System([1.0, 1.0], [1.0, 1.3], [0.1, 0.1], [1.0, 1.0])
    inverse = np.linalg.inv(modal_analysis(base).mode_shapes)
    terms = []
    K = modal_analysis(base).natural_frequency ** 2
    for m in (0, 1):
        for k in (0, 1):
            # ⟨Q_k² Q̇_m²⟩ is H_k H_m/(K_k M_m) for k ≠ m, half of that for k = m.
            share = (2.0 if k == m else 1.0) * K[k] * matrix[m][k]
            unit = np.diag([float(m == 0), float(m == 1)])
            terms += in_masses(base, unit, k, share)
    damping = inverse.T @ np.diag([0.01, 0.01]) @ inverse
    noise = inverse.T @ np.diag([2e-4, 2e-4]) @ inverse
    noise = 0.5 * (noise + noise.T)
    return System(base.mass, base.stiffness, damping, noise, damping_terms=tuple(terms))


@pytest.mark.parametrize(
    "matrix, grows",
    [
        # Lotka-Volterra: bounded iff both own terms are positive and, where both others are
        # negative, A_11 A_22 > A_12 A_21.
        ([[1.0, -0.9], [-0.9, 1.0]], False),
        ([[1.0, -1.1], [-1.1, 1.0]], True),
        ([[1.0, -5.0], [0.1, 1.0]], False),
        ([[1.0, 0.5], [0.5, -0.1]], True),
        ([[0.2, -3.0], [-0.02, 0.5]], False),
        ([[0.2, -6.0], [-0.02, 0.5]], True),
    ],
)
def test_two_modes_that_drive_each_other(matrix, grows):
    system = competing(np.array(matrix))
    reason = refusal(Integrable("fem"), system, "H1")
    assert (reason is not None and "for ever" in reason) == grows, reason


def test_what_settles_is_not_refused():
    assert Integrable("fem").refusal(van_der_pol(), parse_observable("H1", 2)) is None


def test_terms_that_cancel_on_average_leave_the_constant_damping():
    # n = 1, unit mass and spring: 0.3 ⟨q² v²⟩ = 0.1 ⟨v⁴⟩, so that (11) is that of c = 0.1 alone.
    terms = (DampingTerm(1, 1, 0.3, ((1, 2),)), DampingTerm(1, 1, -0.1, (), ((1, 2),)))
    system = System([1.0], [1.0], [0.1], [0.05], damping_terms=terms)
    H = np.linspace(0.0, 4.0, 9)
    for method, name in ((Integrable("fem"), "H1"), (NonIntegrable(), "H")):
        (density,) = solved(method, system, name)
        p, error = density.at(H)
        assert np.all(np.abs(p - 2.0 * np.exp(-2.0 * H)) <= error + 1e-14)
        assert density.certificate.certified
