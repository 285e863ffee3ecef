"""Averaged drift of damping terms: phase and time averages, resonances, growth, refusals."""

import numpy as np
import pytest
from asked import solved
from modal_terms import (
    by_modes,
    in_masses,
    modal_van_der_pol,
    noise_proportional,
    random_system,
    refusal,
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


def flows(system, modes, Q, V):
    """F_m Q̇_k and 2 D*_mk Q̇_m Q̇_k at modal states (points, n), by the physical damping matrix."""
    q, v = Q @ modes.mode_shapes.T, V @ modes.mode_shapes.T
    force = np.einsum("xij,xj->xi", damping_at(system, q, v * system.mass), v) @ modes.mode_shapes
    return np.einsum("xm,xk->xmk", force, V), 2 * modes.modal_noise * np.einsum("xm,xk->xmk", V, V)


def state(modes, energies, phase):
    Q = np.sqrt(2 * energies) / modes.natural_frequency * np.cos(phase)
    return Q, -np.sqrt(2 * energies) * np.sin(phase)


@pytest.mark.parametrize("n", [1, 2, 3])
@pytest.mark.parametrize("seed", [7, pytest.param(8, marks=pytest.mark.slow)])
def test_drift_is_the_phase_average(n, seed):
    # Trapezoidal rule of 12 phases: exact for trigonometric polynomials of degree 10 and less.
    rng = np.random.default_rng(seed)
    system = random_system(rng, n)
    modes = modal_analysis(system)
    phase = np.linspace(0.0, 2 * np.pi, 12, endpoint=False)
    phases = np.stack(np.meshgrid(*[phase] * n), axis=-1).reshape(-1, n)
    for energies in rng.exponential(size=(3, n)) * modes.temperature:
        flow, b = (x.mean(axis=0) for x in flows(system, modes, *state(modes, energies, phases)))
        process = modes.process()
        drift = modes.noise - np.diag(flow)
        size = np.max(np.abs(flow)) + np.max(modes.noise)
        np.testing.assert_allclose(process.at(energies[None]).drift[0], drift, atol=1e-13 * size)
        np.testing.assert_allclose(process.at(energies[None]).diffusion[0], b, atol=1e-13 * b.max())
        # All of Γ_mk, of which resonance takes the rest: linear in it.
        monomials = np.append(1.0, energies)[modes.averaged.factors].prod(axis=1)
        Gamma = np.einsum("rmk,r->mk", modes.averaged.values, monomials)
        np.testing.assert_allclose(Gamma * energies, flow, atol=1e-13 * size)


def test_drift_is_the_time_average_of_the_undamped_motion():
    # The linear flow is exact in time; a smooth window exp(−1/(t(1−t))) averages a frequency ω
    # over the time τ to about exp(−√(2ωτ)): with the least |Σ l ω| = 0.236 of order 4 and
    # τ = 4000 that is e^−43. The step of 0.05 resolves the fastest, 4 ω2 = 6.5, to round-off.
    system = van_der_pol()
    modes = modal_analysis(system)
    energies = np.array([0.11, 0.05])
    t = np.arange(0.05, 4000.0, 0.05)
    window = np.exp(-1.0 / (t / 4000.0 * (1.0 - t / 4000.0)))
    window /= window.sum()
    phases = np.multiply.outer(t, modes.natural_frequency) + np.array([0.3, 1.1])
    flow, b = (
        np.einsum("x,xmk->mk", window, x)
        for x in flows(system, modes, *state(modes, energies, phases))
    )
    process = modes.process()
    drift = modes.noise - np.diag(flow)
    accuracy = 1e-11
    np.testing.assert_allclose(process.at(energies[None]).drift[0], drift, atol=accuracy)
    np.testing.assert_allclose(process.at(energies[None]).diffusion[0], b, atol=accuracy)
    # The same against one energy 10 % off must fail: the average sees both.
    off = process.at(energies[None] * [1.0, 1.1]).drift[0]
    assert np.max(np.abs(off - drift)) > 1e6 * accuracy


def test_balance_is_that_of_the_gibbs_state():
    # h = h0 + h1 H, c = h D: all modes have one θ, the root of θ E[h H_k]/θ² … = 1.
    h0, h1, n = -1.0, 30.0, 2
    modes = modal_analysis(noise_proportional(h0, h1))
    # E[H H_k]/θ = (n + 1) θ for n exponential energies of mean θ.
    theta = (-h0 + np.sqrt(h0**2 + 4 * h1 * (n + 1))) / (2 * h1 * (n + 1))
    np.testing.assert_allclose(modes.temperature, theta, rtol=1e-12)


def test_modes_that_damping_couples():
    assert modal_analysis(van_der_pol()).averaged.groups == ((0, 1),)
    one_way = modal_analysis(modal_van_der_pol())
    assert one_way.averaged.groups == ((0, 1),)
    alone = modal_analysis(modal_van_der_pol(others=0.0))
    assert alone.averaged.groups == ((0,), (1,))
    energies = np.array([[0.1, 0.2], [0.1, 0.4]])
    gamma = alone.averaged.rates([0, 1])(energies)
    np.testing.assert_allclose(gamma[0], gamma[1], rtol=1e-14)
    # ⟨Q² Q̇²⟩ = H²/(2 K* M*): γ_1 = −0.004 + 0.03 H_1/(2 K*_1) for M* = 1.
    expected = -0.004 + 0.03 * 0.1 / (2 * alone.natural_frequency[0] ** 2)
    assert gamma[0, 0] == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("integers", [(3, -1), (0, 4)])
def test_amplitudes_of_the_flow_by_quadrature(integers):
    system = van_der_pol()
    modes, order = modal_analysis(system), np.array(integers)
    t, weight = np.polynomial.laguerre.laggauss(24)
    phase = np.linspace(0.0, 2 * np.pi, 12, endpoint=False)
    phases = np.stack(np.meshgrid(phase, phase), axis=-1).reshape(-1, 2)
    total = np.zeros(2, dtype=complex)
    for x, wx in zip(t, weight, strict=True):
        for y, wy in zip(t, weight, strict=True):
            energies = modes.temperature * [x, y]
            flow, _ = flows(system, modes, *state(modes, energies, phases))
            wave = (
                np.exp(-1j * phases @ order) * x ** (abs(order[0]) / 2) * y ** (abs(order[1]) / 2)
            )
            total += wx * wy * np.einsum("xmm,x->m", flow, wave) / wave.size
    norm = np.sqrt(np.prod([float(np.prod(np.arange(1, abs(k) + 1))) for k in integers]))
    # Half powers of the energies make Gauss-Laguerre converge slowly: 24 points give 1e-4 or more.
    flow = flow_amplitudes(system, modes, order)
    np.testing.assert_allclose(flow, np.abs(total) / norm, rtol=1e-3, atol=1e-4 * flow.max())


def nearest(modes, order):
    return resonances(modes.natural_frequency, order, range(1, order + 1))[0]


def test_resonance_of_order_four_is_refused_where_it_is_excited():
    asked = parse_observable("H1", 2)
    excited = three_to_one(0.05)
    reason = Integrable("fem").refusal(excited, asked)
    assert reason is not None and "l = (3, -1)" in reason and "\n" not in reason
    with pytest.raises(NotApplicable, match="internal resonance"):
        solved(Integrable("fem"), excited, "H1,H2")
    modes = modal_analysis(excited)
    integers, detuning = nearest(modes, resonance_order(excited))
    assert tuple(integers) == (3, -1) and detuning < 1e-12
    # Terms that know of H alone, in proportion to the noise, excite no frequency.
    harmless = three_to_one(0.05, energy=True)
    require_no_resonance(harmless, modal_analysis(harmless))
    assert Integrable("fem").refusal(harmless, asked) is None
    # An odd term excites 2:1 and not 3:1.
    odd = three_to_one(0.05, power=1)
    require_no_resonance(odd, modal_analysis(odd))


def test_high_order_reaches_further():
    base = van_der_pol()
    high = System(
        base.mass, base.stiffness, [0.01, 0.01], [1e-3, 1e-3],
        damping_terms=(DampingTerm(1, 1, 1e-3, ((1, 4),), ((2, 2),)),),
    )  # fmt: skip
    assert (resonance_order(base), resonance_order(high)) == (4, 8)
    integers, detuning = nearest(modal_analysis(high), 8)
    assert np.abs(integers).sum() <= 8
    assert detuning < nearest(modal_analysis(high), 4)[1]


def one(damping, noise, *terms):
    return System([1.0], [1.0], [damping], [noise], damping_terms=terms)


def square(coefficient, power=2):
    return DampingTerm(1, 1, coefficient, ((1, power),))


CASES = {
    "H1: the density does not fall off": one(0.1, 0.01, square(0.2), square(-1e-3, 4)),
    "does not balance": one(-0.1, 0.01, square(-0.2)),
    "mode 1 .*no noise": one(0.1, 0.0, square(0.2)),
    "H1 and H2 and H3.*more than two": System(
        np.ones(3), np.ones(3), np.full(3, 0.01), np.full(3, 1e-3), damping_terms=(square(0.1),)
    ),
}


@pytest.mark.parametrize("reason", CASES)
def test_a_refusal_gives_its_reason(reason):
    system = CASES[reason]
    given = Integrable("fem").refusal(system, parse_observable("H1", system.n))
    assert given is not None and "\n" not in given
    with pytest.raises(NotApplicable, match=reason):
        solved(Integrable("fem"), system, "H1")


@pytest.mark.parametrize("solver", ["closed-form", "quadrature"])
def test_coupled_energies_need_finite_elements(solver):
    with pytest.raises(NotApplicable, match=r"H1 and H2.*use fem"):
        solved(Integrable(solver), van_der_pol(), "H1")


def test_many_modes_of_a_high_degree_are_averaged_and_too_many_refused():
    term = DampingTerm(1, 1, 0.1, ((1, 4),), ((2, 4),))
    process = modal_analysis(chain(8, damping_terms=(term,))).process()
    assert process.coefficients(np.ones((2, 8))).drift.shape == (2, 8)
    with pytest.raises(NotApplicable, match="more than"):
        modal_analysis(chain(40, damping_terms=(term,)))


def pair(*terms):
    return System([1.0, 1.0], [1.0, 1.0], [0.1, 0.1], [0.05, 0.05], damping_terms=terms)


GROWING = {
    "-0.01 q1²": pair(DampingTerm(1, 1, -0.01, ((1, 2),))),
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
    ],
)
def test_two_modes_that_drive_each_other(matrix, grows):
    system = competing(np.array(matrix))
    reason = refusal(Integrable("fem"), system, "H1")
    assert (reason is not None and "for ever" in reason) == grows, reason


@pytest.mark.parametrize(("mass", "stiffness"), [(1.0, 1.0), (1.3, 0.7), (7.1, 0.9)])
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
        p, error = density.at(H)
        assert np.all(np.abs(p - 2.0 * np.exp(-2.0 * H)) <= error + 1e-14)
        assert density.certificate.certified
