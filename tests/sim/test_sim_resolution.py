"""Histograms whose bins are too wide for the density say so, judged by exact densities."""

import numpy as np
import pytest
from sim_systems import linear
from test_sim_transient import gaussian, sampled

from fpk.arrays import Array
from fpk.system import System

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
def test_a_spike_of_the_energy_is_resolved_or_refused(t: float) -> None:
    # At early times p(H) ~ H^(−1/2) down to H ~ D t³, where it ends at √3/(D t²).
    system, kT = linear(1), 2.0 * 0.05 * t
    x = kT * np.concatenate([[0.0, 1e-9, 1e-5], np.linspace(1e-3, 0.1, 30)])
    answer = sampled(system, "H", "rest", [t], x)
    exact, lost = energy_density(system, t, x), np.isinf(answer.errors[0])
    assert np.all(np.abs(answer.values[0] - exact)[~lost] < Z * answer.errors[0][~lost])
    assert lost[0] == (t < 0.25) and not lost[-5:].any()
    refused = any("within a bin" in words for words in answer.certificate.failures)
    assert refused == lost.any() and answer.certificate.certified == (not refused)


@pytest.mark.parametrize("of", ["q1", "H"])
def test_what_is_smooth_has_the_error_that_it_had(of: str, monkeypatch: pytest.MonkeyPatch) -> None:
    x = np.linspace(0.02, 1.0, 25)
    own = sampled(linear(1), of, "noise=0.5", [0.01, 3.0], x)
    nothing = np.zeros(x.shape), np.zeros(x.shape, dtype=bool)
    monkeypatch.setattr("sim.motion.densities.misfit", lambda density, *at: nothing)
    np.testing.assert_array_equal(
        sampled(linear(1), of, "noise=0.5", [0.01, 3.0], x).errors, own.errors
    )


def test_a_pair_of_energies_is_refused_where_one_has_a_spike() -> None:
    early, late = (sampled(linear(2), "H1,H2", "rest", [t], [0.0], [0.0]) for t in (1e-3, 30.0))
    assert np.isinf(early.errors).all() and not early.certificate.certified
    assert np.isfinite(late.errors).all() and late.certificate.certified


def test_the_energy_of_two_masses_vanishes_at_rest_within_the_error() -> None:
    # p(H) ~ H at H = 0, in far less than a bin: 5 standard errors above 0 by the bins alone.
    answer = sampled(linear(2), "H", "rest", [1e-3, 30.0], [0.0], paths=8192)
    assert np.all(np.abs(answer.values) < Z * answer.errors)
