"""Histograms of spikes have the errors that they state, judged by exact densities."""

import numpy as np
import pytest
from scipy.linalg import block_diag
from sim_systems import linear
from test_sim_transient import gaussian, sampled

from fpk.numeric.arrays import Array
from fpk.system.linear import natural_modes
from fpk.system.system import System

Z = 4.5
"""|z| that chance explains: of some 100 points 1e-3."""


def energy_density(system: System, t: float, E: Array) -> Array:
    """p(H) of one mass at rest before, m = k = 1: the mean of a Gaussian of (q, p) on a circle.

    In coordinates scaled by the standard deviations, ρ and φ, H = ρ² g(φ)/2; trapezoids in φ.
    """
    C = gaussian(system, t, [0.0, 0.0])[1]
    sizes = np.sqrt(np.diag(C))
    own = C / np.outer(sizes, sizes)
    phi = np.arange(0.5, 20000.0) * 2.0 * np.pi / 20000.0
    u = np.stack([np.cos(phi), np.sin(phi)])
    a = np.einsum("ik,ij,jk->k", u, np.linalg.inv(own), u)
    g = sizes**2 @ u**2
    exponents = -np.asarray(E)[:, None] * a / g
    return np.asarray(np.mean(np.exp(exponents) / g, axis=1) / np.sqrt(np.linalg.det(own)))


@pytest.mark.parametrize("t", [1e-9, 1e-3, 0.1, 0.2, 0.3, 1.0, 3.0])
def test_a_spike_of_the_energy_has_an_error(t: float) -> None:
    # At early times p(H) ~ H^(−1/2) down to H ~ D t³, where it ends at √3/(D t²).
    system, kT = linear(1), 2.0 * 0.05 * t
    x = kT * np.concatenate([[0.0, 1e-9, 1e-5], np.linspace(1e-3, 0.1, 30)])
    answer = sampled(system, "H", "rest", [t], x, paths=8192)
    exact, error = energy_density(system, t, x), answer.errors[0]
    assert np.all(np.abs(answer.values[0] - exact) < Z * error)
    assert answer.certificate.certified and np.all(error[-5:] < 0.1 * exact[-5:])


def test_a_pair_of_energies_has_an_error_at_a_spike() -> None:
    """p(0, 0) = 1/(ω₁ ω₂ √det C), C the covariance of the modes' displacements and momenta."""
    system = linear(2)
    shapes, omega = natural_modes(system)
    to_modes = block_diag(shapes.T * system.mass, shapes.T)
    for t in (1e-3, 30.0):
        C = to_modes @ gaussian(system, t, [0.0] * 4)[1] @ to_modes.T
        exact = 1.0 / (np.prod(omega) * np.sqrt(np.linalg.det(C)))
        answer = sampled(system, "H1,H2", "rest", [t], [0.0], [0.0])
        assert abs(answer.values[0, 0] - exact) < Z * answer.errors[0, 0]
    assert answer.errors[0, 0] < 0.2 * exact


def test_the_energy_of_two_masses_vanishes_at_rest_within_the_error() -> None:
    # p(H) ~ H at H = 0, in far less than a bin: 5 standard errors above 0 by the bins alone.
    answer = sampled(linear(2), "H", "rest", [1e-3, 30.0], [0.0], paths=8192)
    assert np.all(np.abs(answer.values) < Z * answer.errors)
