"""Modal averaging against Lyapunov, the square-root process and convolution; its certificates."""

import numpy as np
import pytest
from asked import assert_known, assert_refusal, solved
from references import LinearReference, ModalReference, chain_of, mp
from scipy.stats import expon
from systems import both, exact_system, fig6

from averaging import Exact, Integrable, Linear, NonIntegrable
from averaging.gaussian import gamma_sum
from averaging.modal.analysis import ModalAnalysis, modal_analysis
from averaging.modal.observables import gaussian_modes
from averaging.modal.resonance import (
    MAX_NEGLECTED,
    MIN_ORDER,
    correlations,
    nearest_resonance,
    require_no_resonance,
    resonances,
)
from fpk.answer.contacts import stop_clearances
from fpk.answer.density import l1_distance
from fpk.answer.names import parse_observable
from fpk.numeric.errors import InvalidInput, NotApplicable
from fpk.system.linear import linear_covariance, stationary_covariance
from fpk.system.system import System

FULL_C = np.array([[0.08, 0.01, 0.0], [-0.02, 0.04, 0.01], [0.0, 0.01, 0.06]])
FULL_D = np.array([[0.02, 0.01, 0.0], [0.01, 0.03, 0.005], [0.0, 0.005, 0.01]])
SYSTEMS = {
    "fig6": fig6(),
    "three, full": System([1.0, 0.5, 2.0], [1.0, 2.0, 1.5], FULL_C, FULL_D),
}


def modal_covariance(modes):
    factor = gaussian_modes(modes).factor
    return factor @ factor.T


def test_round_off_of_the_modes_is_covered():
    # In 40 digits: ω1² = 1e-5 is what is left of sums of springs that are near 1.
    system = System([1.0, 1.0], [1.0, 1e-5], [0.08, 0.04], [0.01, 0.05])
    modes, (_, _, exact) = modal_analysis(system), ModalReference(chain_of(system)).modes
    for theta, right in zip(modes.temperature, exact, strict=True):
        assert abs(float(theta / right - 1)) <= modes.relative_error
    assert 1e-15 < modes.relative_error < 1e-9


@pytest.mark.parametrize("solver", ["closed-form", "quadrature", "fem"])
@pytest.mark.parametrize("tol", [1e-4, 1e-10])
def test_energies_of_modes_are_exponential_to_the_stated_error(solver, tol):
    # dH = κ(θ − H) dt + √(2κθH) dB has a gamma density of shape 1.
    system = SYSTEMS["three, full"]
    one, joint = solved(Integrable(solver, tol), system, "H2", "H3,H1")
    theta = modal_analysis(system).temperature
    assert one.l1_error <= tol
    H = np.linspace(0.0, 0.999 * one.panels[0][-1], 2001)
    assert_known(one, [H], expon.pdf(H, scale=theta[1]))
    x, y = np.linspace(0.0, 8.0, 40)[:, None] * theta[2], np.linspace(0.0, 8.0, 40) * theta[0]
    assert_known(joint, [x, y], expon.pdf(x, scale=theta[2]) * expon.pdf(y, scale=theta[0]))


@pytest.mark.parametrize("theta", [[1.0, 1.0 + 1e-9], [0.3, 0.30001, 0.3], [1.0, 1e-6, 0.5]])
def test_sum_of_exponentials_against_convolution_in_forty_digits(theta):
    # Partial fractions of the characteristic function cancel; forty digits can afford it.
    H, exact = np.concatenate([[0.0], np.geomspace(1e-4, 45.0, 24)]), []
    with mp.workdps(60):
        rates = [1 / mp.mpf(t) + mp.mpf(10) ** -22 * i for i, t in enumerate(theta)]
        for x in H:
            total = mp.mpf(0)
            for a in rates:
                others = mp.fprod(b / (b - a) for b in rates if b is not a)
                total += a * others * mp.exp(-a * mp.mpf(x))
            exact.append(float(total))
    scales = np.array(theta)
    p, error = gamma_sum(scales, 1.0, 0.0 * scales, H)
    np.testing.assert_allclose(p, exact, rtol=2e-13, atol=1e-50)
    assert np.all(np.abs(p - exact) <= error + 1e-50)


ALL = ("q1", "q2", "p1", "p2", "H", "q2,p2", "q1,q2", "q1,p2")


def test_for_equal_modal_temperatures_four_theories_agree():
    system = exact_system()
    np.testing.assert_allclose(modal_analysis(system).temperature, 0.5, rtol=1e-14)
    methods = (Exact(), Linear(), NonIntegrable(tol=1e-11), Integrable())
    for four in zip(*(solved(m, system, *ALL) for m in methods), strict=True):
        for other in four[:3]:
            assert l1_distance(other, four[3]) < 1e-10, other.name


def test_strongly_correlated_displacements_keep_to_their_error():
    # exp(−h V) with V = ½ k1 q1² + ½ k2 (q2 − q1)², k2 = 1e6 k1: correlated to 1 − 5e-7.
    k2, h = 1e6, 2.0
    D = np.array([0.1, 0.2])
    system = System([1.0, 2.0], [1.0, k2], h * D, D)
    x, y = np.meshgrid(np.linspace(-2.0, 2.0, 9), np.linspace(-3e-3, 3e-3, 7))
    exact = h * np.sqrt(k2) / (2 * np.pi) * np.exp(-0.5 * h * (x**2 + k2 * y**2))
    for method in (Integrable(), Linear()):
        (density,) = solved(method, system, "q1,q2")
        assert np.max(assert_known(density, [x, x + y], exact) / exact) < 1e-2


def test_without_contact_what_is_left_is_the_averaging_error():
    # Unequal c/D: of the order (bandwidth/detuning)², a tenth of damping and noise, a hundredth.
    def left(factor):
        c, D = factor * np.array([0.08, 0.04]), factor * np.array([0.01, 0.02])
        system = System([1.0, 1.0], [1.0, 1.0], c, D)
        return l1_distance(*(solved(m, system, "q2")[0] for m in (Integrable(), Linear())))

    assert left(1.0) / left(0.1) == pytest.approx(100.0, rel=0.05)
    assert left(0.1) / left(0.01) == pytest.approx(100.0, rel=0.005)


@pytest.mark.parametrize("split", [1.0, 0.1, 1e-3])
def test_neglected_correlation_is_that_of_the_lyapunov_equation(split):
    # Weakly coupled modes at several detunings, resonance included: first order in the coupling.
    base = System([1.0, 1.0], [1.0, split], [0.02, 0.03], [0.01, 0.02])
    T = modal_analysis(base).mode_shapes
    Tm = np.linalg.inv(T)
    c, D = np.array([[0.02, 1e-6], [1e-6, 0.03]]), np.array([[0.01, 3e-6], [3e-6, 0.02]])
    system = System([1.0, 1.0], [1.0, split], Tm.T @ c @ Tm, Tm.T @ D @ Tm)
    modal = np.block([[Tm, np.zeros((2, 2))], [np.zeros((2, 2)), T.T]])
    S = modal @ stationary_covariance(system) @ modal.T
    size = np.sqrt(np.diag(S))
    R = np.abs(S / np.outer(size, size))
    largest = max(R[0, 1], R[2, 3], R[0, 3], R[1, 2])
    assert correlations(modal_analysis(system))[0, 1] == pytest.approx(largest, rel=1e-3)


@pytest.mark.parametrize("name", ["fig6", "three, full"])
def test_nearest_resonance_by_going_through_all(name):
    system = SYSTEMS[name]
    modes = modal_analysis(system)
    reach = np.arange(-MIN_ORDER, MIN_ORDER + 1)
    grid = np.stack(np.meshgrid(*[reach] * system.n), axis=-1).reshape(-1, system.n)
    size = np.abs(grid).sum(axis=1)
    grid = grid[(size > 0) & (size <= MIN_ORDER)]
    integers, detuning = resonances(modes.natural_frequency, MIN_ORDER, range(1, MIN_ORDER + 1))[0]
    detunings = np.abs(grid @ modes.natural_frequency)
    assert detuning == pytest.approx(detunings.min(), abs=1e-13)
    assert abs(np.dot(integers, modes.natural_frequency)) == pytest.approx(detuning)
    words = nearest_resonance(system, modes)
    assert f"= {detuning:.4g} for" in words
    assert words.endswith(f"bandwidth {np.abs(integers) @ modes.half_bandwidth:.4g}")


def near(damping, noise, k2=1e-3):
    """Two modes that the weak spring k_2 splits by little: 1:1 where k_1 = k_2/m_2."""
    return System([1.0, k2], [1.0, k2], damping, noise)


def test_resonance_is_refused_only_where_it_matters():
    # ω1, ω2 = 1 ∓ 0.016; half-bandwidths of the same order.
    noise = np.array([0.01, 1e-5])
    unequal = near([0.04, 1e-5], noise)
    assert_refusal(Integrable(), unequal, "q1", "internal resonance")
    # It had to be: the density of the full system is far away.
    S, modes = stationary_covariance(unequal), modal_analysis(unequal)
    assert abs(modal_covariance(modes)[0, 0] / S[0, 0] - 1) > MAX_NEGLECTED
    # The same frequencies, damping and noise in proportion: averaging is exact.
    harmless = near(4.0 * noise, noise)
    modes = modal_analysis(harmless)
    require_no_resonance(harmless, modes)
    exact = stationary_covariance(harmless)
    np.testing.assert_allclose(modal_covariance(modes), exact, rtol=1e-9, atol=1e-11)
    # Equal temperatures alone do not make it harmless: correlated noise on one mode of two.
    modes = modal_analysis(near(4.0 * noise, noise))
    inverse = np.linalg.inv(modes.mode_shapes)
    D = np.diag(modes.noise) + 0.5 * np.sqrt(np.prod(modes.noise)) * (1 - np.eye(2))
    c = np.diag(np.diag(modes.modal_damping))
    correlated = near(inverse.T @ c @ inverse, inverse.T @ D @ inverse)
    np.testing.assert_allclose(modal_analysis(correlated).temperature, 0.25, rtol=1e-9)
    with pytest.raises(NotApplicable, match="internal resonance"):
        require_no_resonance(correlated, modal_analysis(correlated))


def test_what_is_left_out_is_said():
    system = fig6(both(10.0, 1.5))
    result = Integrable().solve(system, [parse_observable("q2", 2)])
    assert "rule clearance > 2 rms does not hold" in result.neglected
    wide = Integrable().solve(fig6(both(10.0, 2.5)), [parse_observable("q2", 2)])
    assert "rule clearance > 2 rms holds" in wide.neglected
    free = Integrable().solve(fig6(), [parse_observable("q2", 2)])
    assert free.neglected == ""
    assert l1_distance(result.densities[0], free.densities[0]) == 0.0
    ratios = [s.ratio for s in stop_clearances(system)]
    assert ratios[0] == pytest.approx(1.5 / np.sqrt(stationary_covariance(system)[1, 1]))


@pytest.mark.parametrize("method", [Integrable, NonIntegrable, Linear])
@pytest.mark.parametrize("tol", [0.0, 1e-13, 1.0])
def test_a_bad_tolerance_is_refused_and_refinement_tightens_it(method, tol):
    with pytest.raises(InvalidInput, match=r"^tol = "):
        method(tol=tol)
    if method is not Linear:
        with pytest.raises(InvalidInput, match=r"^solver = "):
            method(solver="magic")
    assert method(tol=1e-8).refined().tol == pytest.approx(1e-9)
    assert method(tol=1e-12).refined().tol == 1e-12


# ω1² = 1e-7 beside ω2² = 1: what is computed of the slow mode loses digits.
FAR_APART = System([1.0, 1.0], [1.0, 1e-7], [0.04, 0.08], [0.01, 0.02])
# Noise that all but misses one motion: its share is known to round-off of the other's.
NEARLY_ONE = np.array([[1.0, 1.0 - 1e-9], [1.0 - 1e-9, 1.0]])


@pytest.mark.parametrize(
    ("method", "system", "names"),
    [
        (Integrable, FAR_APART, ("H2,H1", "H", "q1,q2")),
        (Linear, System([1.0, 1.0], [1.0, 1e-6], [0.1, 0.1], NEARLY_ONE), ("H", "q1,p2")),
    ],
)
def test_a_closed_form_is_judged_by_the_tolerance(method, system, names):
    for loose, strict in zip(
        solved(method(tol=1e-3), system, *names),
        solved(method(tol=1e-12), system, *names),
        strict=True,
    ):
        assert loose.certificate.certified and 1e-12 < loose.l1_error < 1e-3
        assert ["exceeds" in words for words in strict.certificate.failures] == [True]


@pytest.mark.parametrize(
    "seed", [1, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (20261122, 2, 3, 4, 5))]
)
def test_random_linear_systems_keep_to_their_error(seed):
    """Springs differ by six decades, dampings by three."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(1, 5))
    f = rng.normal(size=(n, n))
    D = 0.01 * f @ f.T
    mass, stiffness = rng.uniform(0.5, 2.0, n), 10.0 ** rng.uniform(-3.0, 3.0, n)
    system = System(mass, stiffness, 10.0 ** rng.uniform(-3.0, 0.0, n), 0.5 * (D + D.T))
    S = LinearReference(chain_of(system)).covariance
    modal = system.fact(linear_covariance)
    momenta = system.mass[:, None] * modal.shapes
    back = np.kron(np.diag([1.0, 0.0]), modal.shapes / modal.omega)
    back += np.kron(np.diag([0.0, 1.0]), momenta)
    factor = mp.matrix((back @ modal.axes * np.sqrt(modal.variance)).tolist())
    # Relative error as a quadratic form: the largest eigenvalue of L⁻¹ (F Fᵀ − Σ) L⁻ᵀ.
    inverse = mp.inverse(mp.cholesky(S))
    form = inverse * (factor * factor.T - S) * inverse.T
    error = max(abs(float(x)) for x in mp.eigsy(form, eigvals_only=True))
    assert error <= modal.relative_error < 1e-9, (error, modal.relative_error)
    densities = solved(Linear(), system, "q1", f"p{n}")
    for density, i in zip(densities, (0, 2 * n - 1), strict=True):
        for y in rng.normal(size=3):
            exact = mp.npdf(float(y)) / mp.sqrt(S[i, i])
            p, stated = density.at(np.array([float(y * mp.sqrt(S[i, i]))]))
            assert abs(p[0] - float(exact)) <= stated[0], density.name
        assert density.certificate.certified, density.certificate


@pytest.mark.parametrize("name", ["q1", "p2", "H"])
def test_the_residual_sees_wrong_modal_temperatures(name, monkeypatch):
    system = System([1.0, 2.0], [1.0, 3.0], [0.08, 0.04], [0.01, 0.02])
    observable = parse_observable(name, 2)
    (right,) = Integrable().solve(system, [observable]).densities
    assert right.certificate.certified
    temperature = ModalAnalysis.temperature
    wrong = property(lambda modes: temperature.__get__(modes) * (1.0 + 1e-9))
    monkeypatch.setattr(ModalAnalysis, "temperature", wrong)
    (density,) = Integrable().solve(system, [observable]).densities
    assert any("residual of the equation" in words for words in density.certificate.failures)
