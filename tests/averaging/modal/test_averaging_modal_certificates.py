"""Certificates of the Gaussian and of modal densities: measured, and judged by the tolerance."""

import mpmath
import numpy as np
import pytest
from asked import solved
from modal_terms import modal_van_der_pol
from systems import fig6

from averaging import Integrable, Linear
from averaging.modal.analysis import ModalAnalysis, modal_analysis
from averaging.zero_flux import flux_residual
from fpk.answer.names import parse_observable
from fpk.numeric.errors import InvalidInput
from fpk.system.linear import diffusion_matrix, drift_matrix, linear_covariance
from fpk.system.system import System

METHODS = [Linear(), *(Integrable(solver) for solver in ("closed-form", "quadrature", "fem"))]


def nearly_alike(split):
    """Two modes that a weak spring splits by little: what is computed of them loses digits."""
    D = np.array([0.01, 0.02])
    return System([1.0, 1.0], [1.0, split], 4.0 * D, D)


@pytest.mark.parametrize("name", ["H2,H1", "H", "q1", "q1,q2"])
def test_a_closed_form_is_judged_by_the_tolerance(name):
    # ω1 and ω2 differ by 1e-7 of their size: θ is known to 1e-9 or so.
    for tol, certified in ((1e-6, True), (1e-12, False)):
        (density,) = solved(Integrable(tol=tol), nearly_alike(1e-7), name)
        assert density.certificate.certified == certified, density.certificate
        assert sum("exceeds" in words for words in density.certificate.failures) == 1 - certified
        assert 1e-12 < density.l1_error < 1e-6


@pytest.mark.parametrize("name", ["H", "q1", "q1,p2"])
def test_the_gaussian_is_judged_by_the_tolerance(name):
    # Noise that all but misses one motion: its share is known to round-off of the other's.
    D = np.array([[1.0, 1.0 - 1e-9], [1.0 - 1e-9, 1.0]])
    system = System([1.0, 1.0], [1.0, 1e-6], [0.1, 0.1], D)
    for tol in (1e-3, 1e-12):
        (density,) = solved(Linear(tol=tol), system, name)
        assert density.certificate.certified == (density.l1_error <= tol)
    assert not density.certificate.certified


@pytest.mark.parametrize("method", METHODS, ids=lambda m: f"{m.method}/{m.solver}")
def test_what_is_certified_was_measured(method):
    name = "q1" if isinstance(method, Linear) else "H1"
    (density,) = solved(method, fig6(), name)
    c = density.certificate
    assert c.certified
    assert c.residual < 1e-12 and 0.0 < c.tail_mass < 1e-10
    assert c.mass_defect <= density.l1_error + 1e-14


def test_residual_of_a_wrong_density_is_not_round_off():
    modes = modal_analysis(fig6())
    process, theta = modes.process((0,)), modes.temperature[0]
    nodes = theta * np.linspace(0.0, 30.0, 11)
    assert flux_residual(process, nodes, lambda H: -H / theta) < 1e-15
    assert flux_residual(process, nodes, lambda H: -H / (1.001 * theta)) > 1e-4


@pytest.mark.parametrize("tol", [1e-13, 1.0])
def test_a_tolerance_out_of_range_is_refused(tol):
    with pytest.raises(InvalidInput, match="tol"):
        Linear(tol=tol)
    assert Linear(tol=1e-8).refined().tol == pytest.approx(1e-9)


def test_negative_values_of_waves_are_within_the_stated_error():
    system = modal_van_der_pol(others=0.0, mass=(0.5, 2.0))
    (density,) = solved(Integrable("quadrature", 1e-5), system, "q2,p2")
    x, y = (np.linspace(p[0], p[-1], 101) for p in density.panels)
    p, error = density.at(x[:, None], y)
    assert density.certificate.certified and density.certificate.minimum < 0.0
    assert np.all(p + error >= 0.0)


def linear_system(rng):
    """Chains of 1 to 4 masses: springs over six decades, damping over three, full noise."""
    n = int(rng.integers(1, 5))
    f = rng.normal(size=(n, n))
    D = 0.01 * f @ f.T
    return System(
        rng.uniform(0.5, 2.0, n),
        10.0 ** rng.uniform(-3.0, 3.0, n),
        10.0 ** rng.uniform(-3.0, 0.0, n),
        0.5 * (D + D.T),
    )


def exact_covariance(system):
    """Covariance of (q, p) in forty digits: A Σ + Σ Aᵀ + b = 0 as a system of (2n)² equations."""
    n, mp = 2 * system.n, mpmath
    A = mp.matrix(drift_matrix(system).tolist())
    m, k = ([mp.mpf(float(x)) for x in y] for y in (system.mass, system.stiffness))
    for i in range(system.n):  # entries that are rounded in double
        A[i, system.n + i] = 1 / m[i]
        A[system.n + i, i] = -k[i] - (k[i + 1] if i + 1 < system.n else 0)
        for j in range(system.n):
            A[system.n + i, system.n + j] = -mp.mpf(float(system.damping[i, j])) / m[j]
    M, one = mp.matrix(n * n, n * n), mp.eye(n)
    for i, j, a, c in np.ndindex(n, n, n, n):
        M[n * i + j, n * a + c] = A[i, a] * one[j, c] + one[i, a] * A[j, c]
    x = mp.lu_solve(M, mp.matrix((-diffusion_matrix(system).ravel()).tolist()))
    return mp.matrix([[x[n * i + j] for j in range(n)] for i in range(n)])


@pytest.mark.parametrize(
    "seed", [1, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (20261122, 2, 3, 4, 5))]
)
def test_random_linear_systems_keep_to_their_error(seed):
    rng = np.random.default_rng(seed)
    system = linear_system(rng)
    with mpmath.workdps(40):
        S = exact_covariance(system)
        modal = system.fact(linear_covariance)
        momenta = system.mass[:, None] * modal.shapes
        back = np.kron(np.diag([1.0, 0.0]), modal.shapes / modal.omega)
        back += np.kron(np.diag([0.0, 1.0]), momenta)
        factor = mpmath.matrix((back @ modal.axes * np.sqrt(modal.variance)).tolist())
        # Relative error as a quadratic form: the largest eigenvalue of L⁻¹ (F Fᵀ − Σ) L⁻ᵀ.
        inverse = mpmath.inverse(mpmath.cholesky(S))
        form = inverse * (factor * factor.T - S) * inverse.T
        error = max(abs(float(x)) for x in mpmath.eigsy(form, eigvals_only=True))
        assert error <= modal.relative_error < 1e-9, (error, modal.relative_error)
        for name in ("q1", f"p{system.n}", f"q{system.n},p1", f"q1,p{system.n}"):
            observable = parse_observable(name, system.n)
            (density,) = Linear().solve(system, [observable]).densities
            rows = [(c.index or 0) + (system.n if c.kind == "p" else 0) for c in observable]
            part = mpmath.matrix([[S[i, j] for j in rows] for i in rows])
            for y in rng.normal(size=(3, len(rows))):
                x = [float(mpmath.sqrt(part[i, i])) * float(v) for i, v in enumerate(y)]
                at = mpmath.matrix(x)
                exact = mpmath.exp(-(at.T * mpmath.inverse(part) * at)[0] / 2)
                exact /= mpmath.sqrt((2 * mpmath.pi) ** len(rows) * mpmath.det(part))
                p, stated = density.at(*(np.array([v]) for v in x))
                assert abs(p[0] - float(exact)) <= stated[0], name
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
