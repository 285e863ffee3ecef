"""The readable operator against the solvers and against what is known of its matrices."""

from dataclasses import replace

import numpy as np
import pytest
from fpk_processes import both, chain, cox_ingersoll_ross
from processes import process_of
from scikit_operator import Operator
from scipy.linalg import eig

from averaging.energy_process import energy_process
from fpk.solvers.line.stationary import solve_on_mesh
from fpk.solvers.plane.solution import solve_plane_on_mesh
from fpk.system.process import Process

H = np.random.default_rng(20260705).uniform(0.05, 2.0, (200, 2))


@pytest.mark.parametrize("degree", [1, 2, 5, 8])
@pytest.mark.parametrize("contact", [False, True])
def test_the_stationary_vector_of_one_energy_is_that_of_single_elements(degree, contact):
    process = energy_process(chain(2, both(10.0) if contact else ()))
    nodes = np.unique([*np.linspace(0.0, 4.0, 9), *process.nonsmooth])
    solved = solve_on_mesh(process, nodes, degree)
    # The points of an element are degree + MORE_POINTS.
    operator = Operator(process, (nodes,), degree, degree + 4, flux_form=True)
    u = operator.stationary()
    p, expected = operator.density(u, H[:, 0]), solved.density(H[:, 0])
    if contact:
        # Above the contact the solver takes the mass from points of its own, one factor of p.
        p = p * (expected @ p) / (p @ p)
    np.testing.assert_allclose(p, expected, rtol=1e-10, atol=1e-12 * expected.max())


def coupled(cross: float = 0.3) -> Process:
    """p = exp(−H1 − 1.5 H2 − 0.3 H1 H2) with noises that are correlated by ``cross``, no flux."""

    def diffusion(H):
        x, y = H.T
        b = np.empty((x.size, 2, 2))
        b[:, 0, 0], b[:, 1, 1] = 2.0 * x, y
        b[:, 0, 1] = b[:, 1, 0] = cross * x * y / (1.0 + x + y)
        return b

    def divergence(H):
        x, y = H.T
        q = 1.0 + x + y
        return np.stack(
            [2.0 + cross * x * (1.0 + x) / q**2, 1.0 + cross * y * (1.0 + y) / q**2], axis=1
        )

    def drift(H):
        slope = np.stack([-1.0 - 0.3 * H[:, 1], -1.5 - 0.3 * H[:, 0]], axis=1)
        return 0.5 * divergence(H) + 0.5 * np.einsum("nij,nj->ni", diffusion(H), slope)

    return process_of(drift, diffusion, divergence, (1.0, 0.7))


@pytest.mark.parametrize("degree", [2, 4, 5])
def test_the_stationary_vector_of_two_energies_is_that_of_the_factored_solver(degree):
    nodes = np.linspace(0.0, 6.0, 5), np.linspace(0.0, 5.0, 4)
    solved = solve_plane_on_mesh(coupled(), nodes, degree)
    operator = Operator(coupled(), nodes, degree, degree + 2)
    expected = solved.density(*H.T)
    p = operator.density(operator.stationary(), *H.T)
    np.testing.assert_allclose(p, expected, rtol=1e-9, atol=1e-11 * expected.max())


def test_no_probability_is_made_or_lost_and_an_absorbing_end_loses_some():
    process, nodes = cox_ingersoll_ross(a=2.0), (np.linspace(0.0, 12.0, 13),)
    closed = Operator(process, nodes, 6, 9)
    # Vertex functions sum to one: v = 1 is in the null space of the backward operator Aᵀ.
    one = np.where(np.arange(closed.basis.N) < 13, 1.0, 0.0)
    assert np.max(np.abs(closed.A.T @ one)) < 1e-12 * np.max(np.abs(closed.A.data))
    u = closed.stationary()
    assert closed.shares @ u == pytest.approx(1.0, abs=1e-13)
    opened = replace(closed, absorbing=(0,))
    assert opened.A.shape[0] == closed.basis.N - 1


def test_the_rates_of_the_square_root_process_are_multiples_of_its_damping():
    # dH = (2 − H) dt + √(2 H) dB: Laguerre polynomials, e^(−40) of the mass beyond the mesh.
    operator = Operator(cox_ingersoll_ross(a=2.0), (np.linspace(0.0, 40.0, 21),), 8, 12)
    rates = np.sort(-eig(operator.A.toarray(), operator.M.toarray(), right=False).real)
    np.testing.assert_allclose(rates[:4], np.arange(4.0), atol=1e-7)
