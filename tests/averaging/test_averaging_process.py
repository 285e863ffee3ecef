"""The averaged process and its density: Eqs. (25), (28), (29) with their corrections, (11)."""

import numpy as np
import pytest
from processes import integral, refined_nodes
from scipy.integrate import dblquad, quad
from scipy.optimize import brentq
from systems import SKEW, TWO_MASSES, both, chain, exact_system, fig6

from averaging.energy_process import closed_form_density, damping_and_noise, energy_process
from averaging.shell.averages import log_linear_states, shell_averages
from averaging.zero_flux import flux_residual, solve_by_quadrature
from fpk import Contact, System
from fpk.numeric.errors import NotApplicable, NotCertified
from fpk.numeric.quadrature import panel_rule
from fpk.solvers.line.stationary import solve_stationary
from fpk.system.process import Process


def eq_25(system, energy, *, with_masses=True):
    """T, s and σ² of Eq. (25) by integrals over q1 and q2, contact of mass 2 only.

    As printed for unit masses; ``with_masses`` puts c_i/m_i, D_i/m_i and √(m1 m2) in.
    """
    m = system.mass if with_masses else np.ones(2)
    c, D = np.diag(system.damping) / m, np.diag(system.noise_intensity) / m
    k1, k2 = system.stiffness
    B1, B2 = -np.pi * c.sum(), np.pi * D.sum()

    def lowest(y):
        contact = float(system.contact_energy(1, y))
        return 0.5 * k1 * k2 / (k1 + k2) * y * y + contact - energy

    high, low = brentq(lowest, 0.0, 10.0), brentq(lowest, -10.0, 0.0)
    middle, half = 0.5 * (high + low), 0.5 * (high - low)

    def over_the_ellipse(function):
        # q2 = middle + half sin t; the limits of q1 are those of (26), corrected: U2(Q2) for G(Q2).
        def inner(x, t):
            q = np.array([x, middle + half * np.sin(t)])
            return function(energy - float(system.potential(q))) * half * np.cos(t)

        def limit(sign):
            def at(t):
                y = middle + half * np.sin(t)
                root = np.sqrt(max(-lowest(y) * 2.0 / (k1 + k2), 0.0))
                return k2 * y / (k1 + k2) + sign * root

            return at

        ends = -0.5 * np.pi, 0.5 * np.pi, limit(-1.0), limit(+1.0)
        return dblquad(inner, *ends, epsabs=1e-12, epsrel=1e-9)[0]

    area, kinetic = over_the_ellipse(lambda K: 1.0), over_the_ellipse(lambda K: K)
    T = np.pi * area
    return T * np.sqrt(np.prod(m)), (B1 * kinetic + B2 * area) / T, 2.0 * B2 * kinetic / T


@pytest.mark.parametrize(
    "mass, contacts, energy",
    [((0.5, 3.0), both(10.0), 0.2), ((1.0, 1.0), (Contact(2, "right", 10.0, 0.5),), 0.5)],
)
def test_coefficients_are_those_of_eq_25(mass, contacts, energy):
    system = fig6(contacts, mass=mass)
    T, s, b = eq_25(system, energy)
    c = energy_process(system).coefficients(np.array([energy]))
    # dblquad to 1e-9 over panels with half-integer powers: 1e-7.
    assert c.drift[0] == pytest.approx(s, rel=1e-7)
    assert c.diffusion[0] == pytest.approx(b, rel=1e-7)
    # T of (10), (25) counts ∂H/∂p_1 > 0 only: half the density of states.
    states = shell_averages(system, np.array([energy])).states
    density_of_states = np.exp(log_linear_states(system, np.array([energy]))) * states
    assert density_of_states[0] == pytest.approx(2.0 * T, rel=1e-7)
    if mass != (1.0, 1.0):
        T, s, b = eq_25(system, energy, with_masses=False)
        assert abs(c.drift[0] / s - 1.0) > 0.1 and abs(c.diffusion[0] / b - 1.0) > 0.1
        assert abs(density_of_states[0] / (2.0 * T) - 1.0) > 0.1


FULL = [[0.1, 0.03], [0.01, 0.2]], [[0.1, 0.02], [0.02, 0.05]]
SYSTEMS = {
    "no contact": fig6(),
    "masses": fig6(both(10.0), mass=(0.5, 3.0)),
    "stiff": fig6(both(1e4)),
    "skew": fig6(SKEW),
    "two contact masses": fig6(TWO_MASSES),
    "n = 1": chain(1, both(10.0, mass=1)),
    "n = 10": chain(10, both(10.0, mass=10)),
    "full noise": System([1.0, 2.0], [1.0, 1.0], *FULL, contacts=both(10.0)),
}
TIERED = [
    pytest.param(n, marks=[pytest.mark.slow] * (n in ("two contact masses", "stiff", "full noise")))
    for n in SYSTEMS
]


@pytest.mark.parametrize("name", SYSTEMS)
def test_noise_drift_is_half_the_slope_of_diffusion_times_states(name):
    # (σ² T)' = 2 s_noise T, s_noise = s − dissipation, integrated over a smooth panel; 1e-11 is
    # the accuracy of the ratios, over a panel on which σ² T changes by about its size.
    system = SYSTEMS[name]
    process = energy_process(system)
    begin = 1.5 * max((*process.nonsmooth, 0.1))
    x, w = panel_rule(np.array([begin, 1.5 * begin]), 20)
    c = process.coefficients(x.ravel())
    ends = process.coefficients(np.array([begin, 1.5 * begin]))
    T, T_ends = np.exp(c.log_density_of_states), np.exp(ends.log_density_of_states)
    rise = np.diff(ends.diffusion * T_ends)[0]
    assert w.ravel() @ (2.0 * (c.drift - c.dissipation) * T) == pytest.approx(rise, rel=1e-10)
    assert w.ravel() @ c.divergence == pytest.approx(np.diff(ends.diffusion)[0], rel=1e-10)
    damping, noise = damping_and_noise(system)
    np.testing.assert_allclose(c.drift - c.dissipation, noise, rtol=1e-12)
    np.testing.assert_allclose(-2.0 * c.dissipation / c.diffusion, damping / noise, rtol=1e-13)
    # Without contact ⟨v²⟩ carries H/n; with it, more than H/n and at most all of H is kinetic.
    tau = c.diffusion / (2.0 * noise)
    assert np.all(tau >= x.ravel() / system.n * (1.0 - 1e-12))
    assert np.all(tau <= 2.0 * x.ravel())


def eq_11(process, nodes, sign):
    """C/σ² exp(sign ∫2s/σ²) at ``nodes``, normalised over them by the trapezoidal rule."""

    def rate(x):
        c = process.coefficients(x.ravel())
        return (2.0 * c.drift / c.diffusion).reshape(x.shape)

    x, w = panel_rule(nodes, 12)
    exponent = np.concatenate([[0.0], np.cumsum(np.sum(w * rate(x), axis=1))])
    log_p = sign * exponent - np.log(process.coefficients(nodes).diffusion)
    p = np.exp(log_p - log_p.max())
    return p / np.trapezoid(p, nodes)


@pytest.mark.parametrize("name", ["masses", "n = 1"])
def test_the_printed_sign_of_eq_11_fails(name):
    system = SYSTEMS[name]
    process = energy_process(system)
    nodes = process.energy_scale * np.geomspace(1e-3, 10.0, 1500)
    nodes = np.union1d(nodes, process.nonsmooth)
    reference = closed_form_density(system).density(nodes)
    reference = reference / np.trapezoid(reference, nodes)
    # Gauss panels of 0.6 % width: 1e-12 each, graded to contact by the density of the nodes.
    np.testing.assert_allclose(eq_11(process, nodes, +1.0), reference, rtol=1e-8)
    wrong = eq_11(process, nodes, -1.0)
    assert np.trapezoid(np.abs(wrong - reference), nodes) > 1.0


def test_the_printed_sign_of_eq_28_is_not_confined():
    process = energy_process(SYSTEMS["masses"])

    def printed(energy):
        c = process.coefficients(energy)
        return c._replace(drift=c.drift - 2.0 * c.dissipation, dissipation=-c.dissipation)

    wrong = Process(printed, process.energy_scales, process.nonsmooth, 2)
    with pytest.raises(NotCertified, match="does not fall off"):
        solve_stationary(wrong)
    assert solve_stationary(process).certificate.certified


def test_eq_29_needs_the_masses():
    system = SYSTEMS["masses"]
    process, reference = energy_process(system), closed_form_density(system)
    solution = solve_stationary(process, tol=1e-10)
    printed = np.trace(system.damping) / np.trace(system.noise_intensity)

    def as_printed(H):
        log_states = process.coefficients(H.ravel()).log_density_of_states.reshape(H.shape)
        return np.exp(log_states - printed * H)

    norm = integral(as_printed, np.append(reference.nodes, 40.0))
    nodes = np.union1d(reference.nodes, solution.nodes)
    right = integral(lambda H: abs(solution.density(H) - reference.density(H)), nodes)
    wrong = integral(lambda H: abs(solution.density(H) - as_printed(H) / norm), nodes)
    assert right < 1e-10 < 0.1 < wrong


@pytest.mark.parametrize("name", TIERED)
def test_quadrature_of_eq_11_meets_its_estimate(name):
    system = SYSTEMS[name]
    process, reference = energy_process(system), closed_form_density(system)
    # Two contact masses take seconds at the tight tolerance.
    for tol in (1e-6,) if name in ("skew", "two contact masses") else (1e-6, 1e-10):
        solution = solve_by_quadrature(process, tol=tol)
        error = integral(
            lambda H, s=solution: abs(np.exp(s.log_density(H)) - reference.density(H)),
            refined_nodes(solution.nodes, reference.nodes),
        )
        assert error <= solution.l1_error + reference.l1_error
        assert solution.l1_error <= max(10.0 * tol, 1e-9)
        assert solution.measured.mass_defect <= solution.l1_error


@pytest.mark.parametrize("name", TIERED)
def test_the_closed_form_has_mass_one(name):
    density = closed_form_density(SYSTEMS[name])
    mass = sum(
        quad(lambda H: float(density.density(np.array(H))), a, b, epsrel=1e-11, epsabs=1e-13)[0]
        for a, b in zip(density.nodes[:-1], density.nodes[1:], strict=True)
    )
    # quad reaches 1e-10 where T starts as a root.
    assert mass == pytest.approx(1.0, abs=max(density.l1_error, 1e-9))


def test_the_residual_of_a_closed_form_sees_a_wrong_temperature():
    system = exact_system(both(10.0))
    right = closed_form_density(system)
    assert right.measured.residual < 1e-13

    def wrong(energy):
        return np.log(right.density(energy)) - 1e-9 * energy

    assert 1e-11 < flux_residual(energy_process(system), right.nodes, wrong) < 1e-8


def test_without_noise_or_damping_there_is_no_process():
    for damping, noise, reason in ((0.1, 0.0, "no noise"), (0.0, 0.1, "nothing is damped")):
        with pytest.raises(NotApplicable, match=reason):
            energy_process(System([1.0], [1.0], [damping], [noise]))
