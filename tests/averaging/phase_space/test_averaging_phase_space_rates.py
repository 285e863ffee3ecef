"""Relaxation rates of the unreduced equation: the slowest of all, each as often as it occurs."""

import numpy as np
import pytest
from asked import TURNED, ask
from scipy import sparse
from scipy.optimize import linear_sum_assignment
from scipy.sparse.linalg import eigs

import fpk
from averaging.gaussian import Linear
from averaging.phase_space.dynamics import resolvent
from averaging.phase_space.method import PhaseSpace
from fpk.answer.method import silent

ONE_SIDED = fpk.Contact(mass=1, side="right", stiffness=10.0, clearance=0.3)
GIBBS = fpk.System([2.0], [1.0], [0.4], [0.1], contacts=(ONE_SIDED,))
SOFT = fpk.Contact(
    mass=1, side="right", stiffness=0.1312, clearance=0.2304, law="bilinear"
)  # fmt: skip
LIGHT = fpk.System([20.9445], [0.309604], [0.47115], [0.00865627], contacts=(SOFT,))
"""Damping ratio 0.09: the fourth slowest rate turns three times as fast as the first."""
ALIKE = fpk.System([1, 1], [1, 1], [0.05, 0.05], [0.01, 0.02])
"""Both modes decay alike, and their energies, too: the rate 0.05 occurs twice."""


def by_differences(system, count, points=300, levels=24, reach=6.5):
    """Slowest eigenvalues of −L of one mass with c/D, by finite differences of second order.

    With p = φ Σ c_n(q) φ h_n(v), φ² the density of q and h_n Hermite functions,
    dc_n/dt = −n (c/m) c_n − √n a c_(n−1) + √(n+1) aᵀ c_(n+1), a f = √(T/m) φ ∂(f/φ)/∂q; c_n of
    even n stand on nodes, of odd n between them.
    """
    m, k, c, D = (
        float(np.ravel(x)[0])
        for x in (system.mass, system.stiffness_matrix, system.damping, system.noise_matrix)
    )
    T = D / c

    def potential(q):
        return 0.5 * k * q * q + system.contact_energy(0, q)

    far = reach * np.sqrt(T / k) * np.linspace(-1.0, 1.0, 4001)
    far = far[potential(far) < 0.5 * reach**2 * T]
    q = np.linspace(far[0], far[-1], 2 * points + 1)
    phi, rate = np.exp(-0.5 * potential(q) / T), np.sqrt(T / m) / (q[2] - q[0])
    nodes, middle, one = phi[::2], phi[1::2], np.ones(points)
    up = sparse.diags_array([-one, one], offsets=[0, 1], shape=(points, points + 1))
    slopes = [
        sparse.diags_array(rate * middle) @ up @ sparse.diags_array(1.0 / nodes),
        sparse.diags_array(rate * nodes) @ -up.T @ sparse.diags_array(1.0 / middle),
    ]
    blocks = [[None] * levels for _ in range(levels)]
    for n in range(levels):
        blocks[n][n] = n * c / m * sparse.eye_array(points + 1 - n % 2)
        if n:
            a = np.sqrt(n) * slopes[(n - 1) % 2]
            blocks[n][n - 1], blocks[n - 1][n] = a, -a.T
    A = sparse.block_array(blocks, format="csc").astype(complex)
    frequency, found = np.sqrt(k / m), np.zeros(0, dtype=complex)
    for at in range(0, 8, 2):
        # Off the axis, as A is singular at 0.
        sigma = (1j * at - 0.05) * frequency
        rates = eigs(A, k=40, sigma=sigma, return_eigenvectors=False)
        rates = rates[(np.abs(rates) > 1e-8) & (rates.imag > -1e-8)]
        apart = np.abs(rates[:, None] - found) < 1e-6 * np.abs(rates)[:, None]
        found = np.concatenate([found, rates[~apart.any(axis=1)]])
    return found[np.argsort(found.real)][:count]


def paired(values, exact):
    """Distances of values to exact ones, each of which is taken once."""
    apart = np.abs(np.asarray(values)[:, None] - exact)
    rows, columns = linear_sum_assignment(apart)
    assert rows.size == len(values)
    return apart[rows, columns]


def relaxation(system, count, tol):
    return ask(PhaseSpace(threads=1), "relaxation", system, count, tol=tol)


@pytest.mark.parametrize(
    ("system", "count"),
    [
        (fpk.System([2.0], [1.0], [0.4], [0.1]), 4),
        (fpk.System([1.0], [1.0], [0.02], [0.01]), 9),
        (fpk.System([1.0], [2.0], [4.0], [1.0]), 6),
        pytest.param(TURNED, 6, marks=pytest.mark.slow),
        pytest.param(ALIKE, 8, marks=pytest.mark.slow),
    ],
)  # fmt: skip
def test_rates_of_a_linear_system_are_the_slowest_sums_of_eigenvalues(system, count):
    exact = ask(Linear(), "relaxation", system, 60).values
    answer = relaxation(system, count, tol=1e-6)
    assert len(answer.values) == count
    assert np.all(paired(answer.values, exact) <= answer.errors)
    # No slower one is left out: sums of equal real parts may stand for each other.
    assert np.asarray(answer.values).real == pytest.approx(exact[:count].real, rel=1e-6)


@pytest.mark.parametrize(
    ("system", "count"),
    [
        (LIGHT, 4),
        pytest.param(GIBBS, 8, marks=pytest.mark.slow),
        pytest.param(LIGHT, 8, marks=pytest.mark.slow),
        pytest.param(
            fpk.System([1.0], [1.0], [0.3], [0.3], contacts=(fpk.Contact(1, "both", 4.0, 0.5),)), 8,
            marks=pytest.mark.slow,
        ),
    ],
)  # fmt: skip
def test_rates_of_one_mass_are_those_of_finite_differences(system, count):
    other = by_differences(system, count)
    answer = relaxation(system, count, tol=5e-3)
    # The differences err by the square of a step of 0.04 standard deviations and less.
    allowed = answer.errors + 2e-3 * np.abs(answer.values)
    assert np.all(paired(answer.values, other) <= allowed)


def test_rates_keep_to_their_error_against_a_finer_solution():
    coarse, fine = (relaxation(GIBBS, 4, tol=tol) for tol in (3e-2, 1e-3))
    assert np.all(np.abs(coarse.values - fine.values) <= coarse.errors + fine.errors)
    assert np.all(fine.values.real > 0.0) and np.all(fine.values.imag >= 0.0)


def test_what_is_not_sought_is_said(monkeypatch):
    monkeypatch.setattr(resolvent, "DISCS", 1)
    monkeypatch.setattr(resolvent, "VECTORS", 50)
    answer = PhaseSpace().relaxation(LIGHT, 12, tol=0.5, progress=silent)
    (words,) = [x for x in answer.certificate.failures if "not sought" in x]
    assert words.startswith(f"{len(answer.values)} of 12 rates are found: rates of angular freq")


def test_a_rate_that_occurs_as_often_as_can_be_seen_is_said_to(monkeypatch):
    monkeypatch.setattr(resolvent, "BLOCK", 1)
    answer = PhaseSpace().relaxation(LIGHT, 1, tol=0.1, progress=silent)
    assert any("occurs 1 times or more" in x for x in answer.certificate.failures)
