"""Modal energies: shapes, exact exponentials of a linear system, pairs."""

import numpy as np
import pytest
from scipy.linalg import solve_continuous_lyapunov
from sim_systems import fig6, linear, mixed

from fpk.answer.names import parse_observable
from fpk.system.linear import diffusion_matrix, drift_matrix, natural_modes, stationary_covariance
from sim.montecarlo import MonteCarlo


def test_modes_are_normalised_and_their_energies_add_up() -> None:
    system = mixed()
    shapes, omega = natural_modes(system)
    np.testing.assert_allclose(shapes.T @ np.diag(system.mass) @ shapes, np.eye(3), atol=1e-14)
    q, p = np.array([0.3, -0.2, 0.7]), np.array([0.1, 0.5, -0.4])
    Q, P = shapes.T @ (system.mass * q), shapes.T @ p
    springs = 0.5 * q @ system.stiffness_matrix @ q
    H = 0.5 * np.sum(P**2 + (omega * Q) ** 2)
    assert pytest.approx(0.5 * np.sum(p * p / system.mass) + springs, rel=1e-13) == H


def test_modal_energies_of_a_linear_system_against_its_gaussian() -> None:
    # E H_m of the Lyapunov covariance; 4.5 standard errors.
    system = linear(3)
    result = MonteCarlo(paths=8192, time=400.0, seed=77).solve(
        system, [parse_observable(name, 3) for name in ("H1", "H3", "H1,H2")]
    )
    shapes, omega = natural_modes(system)
    cov = solve_continuous_lyapunov(drift_matrix(system), -diffusion_matrix(system))
    np.testing.assert_allclose(cov, stationary_covariance(system), rtol=1e-10, atol=1e-14)
    for density, m in zip(result.densities, (0, 2), strict=False):
        a, b = system.mass * shapes[:, m] * omega[m], shapes[:, m]
        exact = 0.5 * (a @ cov[:3, :3] @ a + b @ cov[3:, 3:] @ b)
        e = density.edges[0]
        assert e[0] == 0.0
        centre = 0.5 * (e[1:] + e[:-1])
        means = density.batch_values @ centre * (e[1] - e[0])
        assert abs(means.mean() - exact) < 4.5 * means.std(ddof=1) / np.sqrt(means.size)
        assert density.certificate.certified
    assert result.densities[2].values.shape == (128, 128)
    joint = result.densities[2]
    h = [e[1] - e[0] for e in joint.edges]
    own = joint.values.sum(axis=1) * h[1]
    centre = 0.5 * (joint.edges[0][1:] + joint.edges[0][:-1])
    # The same samples in coarser bins: a bin's midpoint stands for its samples, error h²/12 p'.
    fine = result.densities[0]
    f = 0.5 * (fine.edges[0][1:] + fine.edges[0][:-1])
    mean = np.sum(fine.values * f) * (fine.edges[0][1] - fine.edges[0][0])
    assert np.sum(own * centre) * h[0] == pytest.approx(mean, rel=0.01)


@pytest.mark.slow
def test_modal_energies_with_contact_are_sampled_and_cost_no_row_otherwise() -> None:
    result = MonteCarlo(paths=4096, time=60.0, seed=3).solve(fig6(), [parse_observable("H1,H2", 2)])
    assert result.densities[0].certificate.mass_defect < 1e-12
