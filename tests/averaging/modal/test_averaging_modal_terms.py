"""Averaged drift of damping terms: phase averages, resonances, growth, refusals."""

import numpy as np
import pytest
from asked import (
    assert_known,
    assert_refusal,
    assert_refused,
    by_modes,
    in_masses,
    refusal,
    solved,
    three_to_one,
    van_der_pol,
)
from systems import chain, damping_at

from averaging import Integrable, NonIntegrable
from averaging.modal.analysis import modal_analysis
from averaging.modal.resonance import (
    flow_amplitudes,
    require_no_resonance,
    resonance_order,
    resonances,
)
from fpk import DampingTerm, System
from fpk.answer.names import parse_observable
from fpk.numeric.errors import NotApplicable
from sim import MonteCarlo


def flows(system, modes, energies):
    """F_m Q̇_k and 2 D*_mk Q̇_m Q̇_k at 12 phases a mode (points, n, n), and the phases (points, n).

    By the physical damping matrix. The trapezoidal rule is exact for trigonometric polynomials of
    degree 10 and less.
    """
    phase = np.linspace(0.0, 2 * np.pi, 12, endpoint=False)
    phases = np.stack(np.meshgrid(*[phase] * system.n), axis=-1).reshape(-1, system.n)
    Q = np.sqrt(2 * energies) / modes.natural_frequency * np.cos(phases)
    V = -np.sqrt(2 * energies) * np.sin(phases)
    q, v = Q @ modes.mode_shapes.T, V @ modes.mode_shapes.T
    force = np.einsum("xij,xj->xi", damping_at(system, q, v * system.mass), v) @ modes.mode_shapes
    noise = 2 * modes.modal_noise * np.einsum("xm,xk->xmk", V, V)
    return np.einsum("xm,xk->xmk", force, V), noise, phases


@pytest.mark.parametrize("n", [1, 2, 3])
def test_drift_is_the_phase_average(n):
    """Full damping, terms with odd powers and energies, off the diagonal, too."""
    rng = np.random.default_rng(7)
    terms = [DampingTerm(i + 1, i + 1, 0.3, energy=e) for i in range(n) for e in (1, 3)]
    for _ in range(6):
        i, j, *at = (int(k) + 1 for k in rng.integers(n, size=4))
        a, b, e = (int(k) for k in rng.integers([1, 1, 0], [4, 3, 2]))
        size, q = 0.01 * rng.normal(), ((at[0], a),)
        terms += [DampingTerm(i, j, size, q, v, e) for v in ((), ((at[1], b),))]
    c = np.diag(rng.uniform(0.05, 0.1, n)) + 0.01 * rng.normal(size=(n, n))
    f = rng.normal(size=(n, n))
    mass, stiffness = rng.uniform(0.5, 2.0, n), rng.uniform(0.5, 2.0, n)
    system = System(mass, stiffness, c, 0.02 * (f @ f.T + np.eye(n)), damping_terms=terms)
    modes = modal_analysis(system)
    for energies in rng.exponential(size=(3, n)) * modes.temperature:
        flow, b = (x.mean(axis=0) for x in flows(system, modes, energies)[:2])
        process = modes.process()
        drift = modes.noise - np.diag(flow)
        size = np.max(np.abs(flow)) + np.max(modes.noise)
        np.testing.assert_allclose(process.at(energies[None]).drift[0], drift, atol=1e-13 * size)
        np.testing.assert_allclose(process.at(energies[None]).diffusion[0], b, atol=1e-13 * b.max())
        # All of Γ_mk, of which resonance takes the rest: linear in it.
        monomials = np.append(1.0, energies)[modes.averaged.factors].prod(axis=1)
        Gamma = np.einsum("rmk,r->mk", modes.averaged.values, monomials)
        np.testing.assert_allclose(Gamma * energies, flow, atol=1e-13 * size)


@pytest.mark.parametrize("integers", [(3, -1), (0, 4)])
def test_amplitudes_of_the_flow_by_quadrature(integers):
    system = van_der_pol()
    modes, order = modal_analysis(system), np.array(integers)
    t, weight = np.polynomial.laguerre.laggauss(24)
    total = np.zeros(2, dtype=complex)
    for i, j in np.ndindex(t.size, t.size):
        flow, _, phases = flows(system, modes, modes.temperature * t[[i, j]])
        wave = np.exp(-1j * phases @ order) * np.prod(t[[i, j]] ** (np.abs(order) / 2))
        total += weight[i] * weight[j] * np.einsum("xmm,x->m", flow, wave) / wave.size
    norm = np.sqrt(np.prod([float(np.prod(np.arange(1, abs(k) + 1))) for k in integers]))
    # Half powers of the energies make Gauss-Laguerre converge slowly: 24 points give 1e-4 or more.
    flow = flow_amplitudes(system, modes, order)
    np.testing.assert_allclose(flow, np.abs(total) / norm, rtol=1e-3, atol=1e-4 * flow.max())


def test_resonance_of_order_four_is_refused_where_it_is_excited():
    excited = three_to_one(0.05)
    assert_refusal(Integrable("fem"), excited, "H1,H2", r"internal resonance.* l = \(3, -1\)")
    modes = modal_analysis(excited)
    order = resonance_order(excited)
    integers, detuning = resonances(modes.natural_frequency, order, range(1, order + 1))[0]
    assert tuple(integers) == (3, -1) and detuning < 1e-12
    # Terms that know of H alone, in proportion to the noise, excite no frequency.
    harmless = three_to_one(0.05, energy=True)
    assert Integrable("fem").refusal(harmless, parse_observable("H1", 2)) is None
    # An odd term excites 2:1 and not 3:1.
    odd = three_to_one(0.05, power=1)
    require_no_resonance(odd, modal_analysis(odd))
    # A term of the degree 6 reaches further.
    high = (DampingTerm(1, 1, 1e-3, ((1, 4),), ((2, 2),)),)
    assert resonance_order(chain(2)) == 4 < resonance_order(chain(2, damping_terms=high)) == 8


def one(damping, noise, *terms):
    return System([1.0], [1.0], [damping], [noise], damping_terms=terms)


def square(coefficient, power=2):
    return DampingTerm(1, 1, coefficient, ((1, power),))


THREE = System(
    np.ones(3), np.ones(3), np.full(3, 0.01), np.full(3, 1e-3), damping_terms=(square(0.1),)
)


@pytest.mark.parametrize(
    ("solver", "system", "reason"),
    [
        ("fem", one(0.1, 0.01, square(0.2), square(-1e-3, 4)), "H1: the density does not fall off"),
        ("fem", one(-0.1, 0.01, square(-0.2)), "does not balance"),
        ("fem", one(0.1, 0.0, square(0.2)), "mode 1 .*no noise"),
        ("fem", THREE, "H1 and H2 and H3.*more than two"),
        ("closed-form", van_der_pol(), r"H1 and H2.*use fem"),
        ("quadrature", van_der_pol(), r"H1 and H2.*use fem"),
    ],
)
def test_a_refusal_gives_its_reason(solver, system, reason):
    assert_refused(NotApplicable, reason, solved, Integrable(solver), system, "H1")


def test_many_modes_of_a_high_degree_are_averaged_and_too_many_refused():
    term = DampingTerm(1, 1, 0.1, ((1, 4),), ((2, 4),))
    process = modal_analysis(chain(8, damping_terms=(term,))).process()
    assert process.coefficients(np.ones((2, 8))).drift.shape == (2, 8)
    with pytest.raises(NotApplicable, match="more than"):
        modal_analysis(chain(40, damping_terms=(term,)))


@pytest.mark.parametrize("solver", ["closed-form", "quadrature", "fem"])
@pytest.mark.parametrize(
    "terms",
    [
        (DampingTerm(1, 1, -0.01, ((1, 2),)),),
        # H1' rises again far out.
        (DampingTerm(1, 1, 0.1, energy=1), DampingTerm(1, 1, -1e-6, energy=2)),
    ],
)
def test_energies_that_the_damping_lets_grow_have_no_density(solver, terms):
    system = chain(2, damping_terms=terms)
    reason = refusal(Integrable(solver), system, "H1")
    assert reason is not None and "for ever" in reason and "\n" not in reason
    assert_refused(NotApplicable, "for ever", solved, Integrable(solver), system, "H1,H2")


def competing(matrix):
    """γ_m = 0.01 + Σ_k A_mk H_k of two modes."""
    base, terms = System([1.0, 1.0], [1.0, 1.3], [0.1, 0.1], [1.0, 1.0]), []
    K = modal_analysis(base).natural_frequency ** 2
    for m, k in np.ndindex(2, 2):
        # ⟨Q_k² Q̇_m²⟩ is H_k H_m/(K_k M_m) for k ≠ m, half of that for k = m.
        share = (2.0 if k == m else 1.0) * K[k] * matrix[m][k]
        terms += in_masses(base, np.diag(np.eye(2)[m]), k, share)
    return by_modes(base, [0.01, 0.01], [2e-4, 2e-4], terms)


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
        # The energy of mode 2 stays where it is.
        ([[1.0, 1.0], [0.0, 0.0]], False),
        ([[1.0, -1.0], [0.0, 0.0]], False),
        ([[-1.0, 1.0], [0.0, 0.0]], True),
    ],
)
def test_two_modes_that_drive_each_other(matrix, grows):
    system = competing(np.array(matrix))
    reason = refusal(Integrable("fem"), system, "H1")
    assert (reason is not None and "for ever" in reason) == grows, reason


@pytest.mark.parametrize(("mass", "stiffness"), [(1.0, 1.0), (7.1, 0.9)])
def test_terms_that_cancel_on_average_leave_the_constant_damping(mass, stiffness):
    """0.3 κ q² − 0.1 μ v² averages to exactly zero: c is 0.1 on average, and p(H) exponential."""
    terms = (
        DampingTerm(1, 1, 0.3 * stiffness, q=((1, 2),)),
        DampingTerm(1, 1, -0.1 * mass, v=((1, 2),)),
    )
    system = System([mass], [stiffness], [0.1], [0.05], damping_terms=terms)
    MonteCarlo().prepare(system)
    H = np.linspace(0.0, 4.0, 9)
    for method, name in ((Integrable("fem"), "H1"), (NonIntegrable(), "H")):
        (density,) = solved(method, system, name)
        assert_known(density, [H], 2.0 * np.exp(-2.0 * H), rounding=1e-14)
