"""Certificates of the Gaussian and of modal densities: measured, and judged by the tolerance."""

import numpy as np
import pytest
from asked import solved
from references import LinearReference, chain_of, mp

from averaging import Integrable, Linear
from averaging.modal.analysis import ModalAnalysis
from fpk.answer.names import parse_observable
from fpk.system.linear import linear_covariance
from fpk.system.system import System

# What is computed of modes that a weak spring splits by little loses digits.
NEARLY_ALIKE = System([1.0, 1.0], [1.0, 1e-7], [0.04, 0.08], [0.01, 0.02])
# Noise that all but misses one motion: its share is known to round-off of the other's.
NEARLY_ONE = np.array([[1.0, 1.0 - 1e-9], [1.0 - 1e-9, 1.0]])


@pytest.mark.parametrize(
    ("method", "system", "names"),
    [
        # ω1 and ω2 differ by 1e-7 of their size: θ is known to 1e-9 or so.
        (
            Integrable,
            NEARLY_ALIKE,
            ("H2,H1", "H", "q1,q2"),
        ),
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


@pytest.mark.parametrize(
    "seed", [1, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (20261122, 2, 3, 4, 5))]
)
def test_random_linear_systems_keep_to_their_error(seed):
    rng = np.random.default_rng(seed)
    system = linear_system(rng)
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
    densities = solved(Linear(), system, "q1", f"p{system.n}")
    for density, i in zip(densities, (0, 2 * system.n - 1), strict=True):
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
