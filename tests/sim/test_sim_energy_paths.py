"""Averaged Monte Carlo: exact for uncoupled modes, within its band of the FE solution otherwise."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2, ncx2

from cases.compare import chance_l1
from fpk.density import Density, l1_distance
from fpk.errors import InvalidInput, NotApplicable
from fpk.observable import Coordinate
from fpk.plane.stationary import solve_plane
from fpk.vector_process import VectorProcess
from sim.energy_paths import EnergySampling, simulate_energies, square_root_step

SAMPLING = EnergySampling(dt=0.1, time=20.0, burn_in=10.0, interval=1.0, paths=4096, bins=16)


def coupled(strength: float) -> VectorProcess:
    """Van der Pol type damping of two modes: each is damped by the energy of both, b diagonal."""

    def drift(H):
        total = H.sum(axis=1, keepdims=True)
        return 0.5 - H * (0.4 + strength * total)

    def diffusion(H):
        return H[:, :, None] * np.eye(2)

    return VectorProcess(drift, diffusion, lambda H: np.ones_like(H), (0.7, 0.7))


def by_elements(process: VectorProcess) -> Density:
    found = solve_plane(process, tol=1e-6)
    return Density(
        (Coordinate("H", 0), Coordinate("H", 1)),
        found.nodes,
        found.density,
        found.pointwise_error,
        found.l1_error,
        found.certificate,
    )


def test_one_step_of_an_uncoupled_mode_is_the_noncentral_chi_square_at_any_dt() -> None:
    # The transition law of the CIR process, as scipy knows it; χ² over 20 bins of equal
    # probability, false-alarm rate 1e-4 for each mode.
    process = coupled(0.0)
    start, dt, count = 0.9, 3.0, 40_000
    H = square_root_step(process, np.full((count, 2), start), dt, np.random.default_rng(11))
    gamma, beta, d = 0.4, 1.0, 0.5
    k = 0.25 * beta * -np.expm1(-gamma * dt) / gamma
    share = ncx2(4.0 * d / beta, start * np.exp(-gamma * dt) / k, scale=k).cdf(H)
    for mode in (0, 1):
        counts = np.histogram(share[:, mode], bins=20, range=(0.0, 1.0))[0]
        statistic = np.sum((counts - count / 20) ** 2) / (count / 20)
        assert statistic < chi2(19).isf(1e-4)


def test_agrees_with_elements_on_coupled_damping_and_rejects_a_wrong_coefficient() -> None:
    # The band is that of chance alone at 1e-4; the step bias at dt = 0.1 must stay inside it, and
    # a coupling that is a quarter too strong must not.
    sampled = simulate_energies(coupled(0.8), SAMPLING, (4.0, 4.0))
    band = chance_l1(sampled)[1]
    assert l1_distance(sampled, by_elements(coupled(0.8))) < band
    assert l1_distance(sampled, by_elements(coupled(1.0))) > band
    assert sampled.certificate.certified
    assert sampled.certificate.mass_defect < 1e-12


def test_energies_stay_positive_at_a_coarse_step() -> None:
    stream = np.random.default_rng(3)
    H = np.full((2000, 2), 1e-12)
    for _ in range(20):
        H = square_root_step(coupled(0.8), H, 2.0, stream)
        assert np.all(H >= 0) and np.isfinite(H).all()


def test_refusals() -> None:
    correlated = replace(
        coupled(0.1), diffusion=lambda H: H[:, :, None] * np.eye(2) + 0.1 * H.prod(1)[:, None, None]
    )
    with pytest.raises(NotApplicable, match="correlated"):
        simulate_energies(correlated, SAMPLING, (4.0, 4.0))
    with pytest.raises(InvalidInput, match="paths"):
        replace(SAMPLING, paths=100)
    with pytest.raises(InvalidInput, match="dt"):
        replace(SAMPLING, dt=0.0)
