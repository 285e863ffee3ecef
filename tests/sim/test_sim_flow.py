"""The exact linear flow and the factor of its covariance."""

import numpy as np
import pytest
from scipy.linalg import solve_continuous_lyapunov
from sim_systems import linear, mixed

from fpk.system.linear import diffusion_matrix, drift_matrix
from fpk.system.system import System
from sim.step.schemes import exact_flow, factored, flow_covariance


@pytest.mark.parametrize("dt", [0.01, 1.0, 10.0])
@pytest.mark.parametrize("steps", [1, 7, 64])
def test_covariance_after_any_number_of_steps_is_that_of_one_long_step(
    dt: float, steps: int
) -> None:
    for system in (linear(2), mixed()):
        flow = exact_flow(system, dt)
        covariance = np.zeros((2 * system.n, 2 * system.n))
        for _ in range(steps):
            covariance = (
                flow.propagator @ covariance @ flow.propagator.T + flow.factor @ flow.factor.T
            )
        A, b = drift_matrix(system), diffusion_matrix(system)
        _, expected = flow_covariance(A, b, steps * dt)
        np.testing.assert_allclose(
            covariance, expected, rtol=0, atol=1e-12 * np.abs(expected).max()
        )
        stationary = solve_continuous_lyapunov(A, -b)
        E = flow.propagator
        np.testing.assert_allclose(
            E @ stationary @ E.T + flow.factor @ flow.factor.T,
            stationary,
            rtol=0,
            atol=1e-12 * np.abs(stationary).max(),
        )


@pytest.mark.parametrize("dt", [1e-3, 0.2, 10.0])
def test_noise_on_one_mass_of_five_and_no_noise(dt: float) -> None:
    D = np.zeros(5)
    D[0] = 0.3
    for intensity in (D, np.zeros(5)):
        system = System([1.0] * 5, [1.0] * 5, [0.1] * 5, intensity)
        _, covariance = flow_covariance(drift_matrix(system), diffusion_matrix(system), dt)
        L = factored(covariance)
        assert np.all(np.isfinite(L))
        np.testing.assert_allclose(L @ L.T, covariance, rtol=0, atol=1e-13 * covariance.max())
    assert L.shape[1] == 0


def test_singular_covariance_draws_as_many_normals_as_its_rank() -> None:
    X = np.array([[1.0, 2.0, 0.0], [1e-6, 0.0, 3e-6], [3.0, 6.0, 0.0], [0.0, 0.0, 0.0]])
    L = factored(X @ X.T)
    assert L.shape == (4, 2)
    np.testing.assert_allclose(L @ L.T, X @ X.T, rtol=1e-12, atol=1e-25)


@pytest.mark.parametrize("units", [(1e60, 1.0, 1e90), (1e-50, 1e-25, 1e-70), (1e-3, 1e7, 1e5)])
@pytest.mark.parametrize("dt", [0.1, 3.0])
def test_the_flow_is_the_same_in_any_units(units: tuple[float, float, float], dt: float) -> None:
    # Units of mass, time and noise; a displacement has √(noise time) time/mass, a momentum √(…).
    m, t, noise = units
    one = System([1.0, 1.3], [1.0, 2.0], [0.1, 0.2], [0.05, 0.1])
    other = System(
        m * one.mass,
        [m / t**2, m / t**2 * 2.0],
        [m / t * 0.1, m / t * 0.2],
        [noise * 0.05, noise * 0.1],
    )
    p = np.sqrt(noise * t)
    size = np.array([p * t / m, p * t / m, p, p])
    flows = [
        flow_covariance(drift_matrix(s), diffusion_matrix(s), h)
        for s, h in ((one, dt), (other, t * dt))
    ]
    (A, C), (B, D) = flows
    # Some hundred roundings of numbers of size 1; doublings add up those of the covariance.
    assert np.max(np.abs(B / size[:, None] * size - A)) < 1e-13
    assert np.max(np.abs(D / size[:, None] / size - C)) < 1e-11 * np.max(C)
