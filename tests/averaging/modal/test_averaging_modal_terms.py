"""Averaged drift of damping terms: brute phase averages, time averages, resonances, refusals."""

import numpy as np
import pytest
from modal_terms import (
    modal_van_der_pol,
    noise_proportional,
    random_system,
    solved,
    three_to_one,
    van_der_pol,
)
from state_damping import damping_at

from averaging.integrable import Integrable
from averaging.modal.analysis import modal_analysis
from averaging.modal.resonance import (
    flow_amplitudes,
    require_no_resonance,
    resonance_order,
    resonances,
)
from fpk.answer.names import parse_observable
from fpk.numeric.errors import NotApplicable
from fpk.system.damping import DampingTerm
from fpk.system.system import System


def flows(system, modes, Q, V):
    """F_m Q̇_k and 2 D*_mk Q̇_m Q̇_k at modal states (points, n), by the physical damping matrix."""
    q, v = Q @ modes.mode_shapes.T, V @ modes.mode_shapes.T
    force = np.einsum("xij,xj->xi", damping_at(system, q, v * system.mass), v) @ modes.mode_shapes
    return np.einsum("xm,xk->xmk", force, V), 2 * modes.modal_noise * np.einsum("xm,xk->xmk", V, V)


def state(modes, energies, phase):
    Q = np.sqrt(2 * energies) / modes.natural_frequency * np.cos(phase)
    return Q, -np.sqrt(2 * energies) * np.sin(phase)


@pytest.mark.parametrize("n", [1, 2, 3])
@pytest.mark.parametrize("seed", [20040801, 7, 8])
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


@pytest.mark.parametrize("make", [van_der_pol, modal_van_der_pol])
def test_drift_is_the_time_average_of_the_undamped_motion(make):
    # The linear flow is exact in time; a smooth window exp(−1/(t(1−t))) averages a frequency ω
    # over the time τ to about exp(−√(2ωτ)): with the least |Σ l ω| = 0.236 of order 4 and
    # τ = 4000 that is e^−43. The step of 0.05 resolves the fastest, 4 ω2 = 6.5, to round-off.
    system = make()
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


@pytest.mark.parametrize("integers", [(3, -1), (2, -2), (1, 3), (0, 4)])
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


PAIR = [1.0, 1.0]
CASES = {
    "H1: the density does not fall off": System([1.0], [1.0], [0.1], [0.01], damping_terms=(
        DampingTerm(1, 1, 0.2, ((1, 2),)), DampingTerm(1, 1, -1e-3, ((1, 4),)))),
    "does not balance": System([1.0], [1.0], [-0.1], [0.01], damping_terms=(
        DampingTerm(1, 1, -0.2, ((1, 2),)),)),
    "mode 1 .*no noise": System([1.0], [1.0], [0.1], [0.0], damping_terms=(
        DampingTerm(1, 1, 0.2, ((1, 2),)),)),
    "H1 and H2 and H3.*more than two": System(np.ones(3), np.ones(3), np.full(3, 0.01),
        np.full(3, 1e-3), damping_terms=(DampingTerm(1, 1, 0.1, ((1, 2),)),)),
}  # fmt: skip


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
    def chain(n, term):
        ones = np.ones(n)
        return System(ones, ones, 0.1 * ones, 0.1 * ones, damping_terms=(term,))

    term = DampingTerm(1, 1, 0.1, ((1, 4),), ((2, 4),))
    assert modal_analysis(chain(8, term)).process().coefficients(np.ones((2, 8))).drift.shape == (
        2,
        8,
    )
    with pytest.raises(NotApplicable, match="more than"):
        modal_analysis(chain(40, term))
