"""Averaged Monte Carlo: exact for uncoupled modes, within its band of exact densities otherwise."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from processes import process_of
from scipy.stats import chi2, ncx2

from cases.compare.averaged import AveragedSimulation
from cases.compare.compare import chance_l1, compare_densities
from cases.compare.routes import method_for
from cases.scene.scene import load_scene
from fpk.answer.certificate import Certificate
from fpk.answer.density import Density, l1_distance
from fpk.answer.names import Coordinate
from fpk.numeric.errors import InvalidInput, NotApplicable
from fpk.solvers.line.stationary import solve_stationary
from fpk.solvers.plane.stationary import solve_plane
from fpk.system.process import Coefficients, Process
from sim.questions.averaged.paths import simulate_energies
from sim.questions.averaged.square_root import line_form, square_root_form, square_root_step

SAMPLING: Any = {"interval": 1.0, "steps": 5, "time": 10.0, "burn_in": 10.0, "paths": 4096}
"""Modes that decay at the rate 0.4 or faster: e⁻⁴ of the start's deviation is left at first, and a
quarter of that in the mean over ten units of time, half a percent in L1; the bands are wider."""
H1, H2, TOTAL = Coordinate("H", 0), Coordinate("H", 1), Coordinate("H")


def coupled(strength: float, energies: int = 2) -> Process:
    """Each mode is damped by the energy of all, b diagonal: ln p = −0.8 ΣH − strength (ΣH)²/1."""

    def drift(H):
        total = H.sum(axis=1, keepdims=True)
        return 0.5 - H * (0.4 + strength * total)

    def diffusion(H):
        return H[:, :, None] * np.eye(energies)

    return process_of(drift, diffusion, lambda H: np.ones_like(H), (0.7,) * energies)


def energy_dependent(quartic: float) -> Process:
    """One energy whose b is not linear: T = H, τ = H/2/(1 + H), p = H exp(−H − quartic H²)."""

    def coefficients(H):
        diffusion = H / (1.0 + H)
        slope = 1.0 / (1.0 + H) ** 2
        dissipation = -0.5 * diffusion * (1.0 + 2.0 * quartic * H)
        drift = dissipation + 0.5 * (slope + diffusion / H)
        nothing = np.zeros_like(H)
        return Coefficients(drift, diffusion, slope, dissipation, np.log(H), nothing)

    return Process(coefficients, (2.0 / (1.0 + quartic),), (), 2)


def as_density(observable, panels, pdf, error=1e-9) -> Density:
    certificate = Certificate(
        l1_error=0.0, mass_defect=0.0, minimum=0.0, residual=0.0, tail_mass=0.0
    )
    return Density(observable, panels, pdf, lambda *x: 0.0 * pdf(*x), error, certificate)


def gibbs_sum(strength: float, energies: int) -> Density:
    """p(H) of H = ΣH_i of ``coupled``: H^(n−1) exp(−0.8 H − strength H²), normalised."""
    nodes = np.linspace(0.0, 12.0, 40)

    def shape(H):
        return np.maximum(H, 0.0) ** (energies - 1) * np.exp(-0.8 * H - strength * H**2)

    fine = np.linspace(0.0, 12.0, 200_001)
    norm = np.trapezoid(shape(fine), fine)
    return as_density((TOTAL,), (nodes,), lambda H: shape(np.asarray(H)) / norm)


def test_one_step_of_an_uncoupled_mode_is_the_noncentral_chi_square_at_any_dt() -> None:
    # The transition law of the CIR process, as scipy knows it; χ² over 20 bins of equal
    # probability, false-alarm rate 1e-4 for each mode.
    form = square_root_form(coupled(0.0))
    assert form.damping is None and square_root_form(coupled(0.1)).damping
    start, dt, count = 0.9, 3.0, 40_000
    H = square_root_step(form, np.full((count, 2), start), dt, np.random.default_rng(11))
    gamma, beta, d = 0.4, 1.0, 0.5
    k = 0.25 * beta * -np.expm1(-gamma * dt) / gamma
    share = ncx2(4.0 * d / beta, start * np.exp(-gamma * dt) / k, scale=k).cdf(H)
    for mode in (0, 1):
        counts = np.histogram(share[:, mode], bins=20, range=(0.0, 1.0))[0]
        statistic = np.sum((counts - count / 20) ** 2) / (count / 20)
        assert statistic < chi2(19).isf(1e-4)


def test_agrees_with_elements_on_coupled_damping_and_rejects_a_wrong_coefficient() -> None:
    # The band is that of chance alone at 1e-4; the step bias at dt = 0.2 must stay inside it, and
    # a coupling that is a quarter too strong must not.
    (pair,) = simulate_energies(square_root_form(coupled(0.8)), [(H1, H2)], **SAMPLING)
    pair = pair.joined(4)
    band = chance_l1(pair)[1]

    def by_elements(process: Process) -> Density:
        found = solve_plane(process, tol=1e-6)
        return as_density((H1, H2), found.nodes, found.density, found.l1_error)

    assert l1_distance(pair, by_elements(coupled(0.8))) < band
    assert l1_distance(pair, by_elements(coupled(1.0))) > band
    assert pair.certificate.certified
    assert pair.certificate.mass_defect < 1e-12


def test_three_coupled_energies_against_their_gibbs_like_density() -> None:
    form = square_root_form(coupled(0.4, energies=3))
    total, first = simulate_energies(form, [(TOTAL,), (H1,)], **SAMPLING)
    joined = total.joined(8)
    band = chance_l1(joined)[1]
    assert l1_distance(joined, gibbs_sum(0.4, 3)) < band
    assert l1_distance(joined, gibbs_sum(0.5, 3)) > band
    assert first.name == "H1"


def test_one_energy_with_a_diffusion_that_is_not_linear_against_elements() -> None:
    form = line_form(energy_dependent(0.2))
    sampling = SAMPLING | {"burn_in": 30.0, "interval": 2.0, "steps": 10}
    (sampled,) = simulate_energies(form, [(TOTAL,)], **sampling)
    joined = sampled.joined(8)
    band = chance_l1(joined)[1]

    def by_elements(quartic: float) -> Density:
        found = solve_stationary(energy_dependent(quartic), tol=1e-8)
        return as_density((TOTAL,), (found.nodes,), found.density, found.l1_error)

    assert l1_distance(joined, by_elements(0.2)) < band
    assert l1_distance(joined, by_elements(0.25)) > band


def test_step_bias_of_the_mean_is_of_second_order() -> None:
    # E H after a fixed time from one start; halving dt twice, differences fall by four. Strong
    # damping makes them large: 12, 3 and less than 1 standard errors or more apart.
    form = square_root_form(coupled(2.0, energies=1))

    def mean(dt: float) -> tuple[float, float]:
        stream = np.random.default_rng(7)
        X = np.full((1_500_000, 1), 1.0)
        for _ in range(round(1.6 / dt)):
            X = square_root_step(form, X, dt, stream)
        return float(X.mean()), float(X.std() / np.sqrt(X.size))

    (a, e1), (b, e2), (c, e3) = mean(1.6), mean(0.8), mean(0.2)
    far, near = a - c, b - c
    assert abs(far) > 12.0 * np.hypot(e1, e3)
    # Second order: (1.6² − 0.2²)/(0.8² − 0.2²) = 4.2; first order would give 2.3.
    assert abs(near) < abs(far) / 3.0 + 4.0 * np.hypot(e2, e3)


@pytest.mark.parametrize(
    ("scene", "theory", "solver", "observables"),
    [
        ("fig8b", "integrable", "closed-form", [(H1,), (TOTAL,), (H1, H2)]),
        pytest.param("vanderpol", "integrable", "fem", [(H1, H2)], marks=pytest.mark.slow),
        pytest.param("vanderpol", "nonintegrable", "fem", [(TOTAL,)], marks=pytest.mark.slow),
        pytest.param("fig6a", "nonintegrable", "fem", [(TOTAL,)], marks=pytest.mark.slow),
    ],
)
def test_as_a_method_it_agrees_with_another_solver_and_is_judged(
    scene, theory, solver, observables
) -> None:
    system = load_scene(scene).system
    results = [
        method_for(theory, name).solve(system, observables) for name in ("simulation", solver)
    ]
    comparisons = compare_densities(results, averaging_is_exact=False)
    assert len(comparisons) == len(observables)
    for found in comparisons:
        assert found.measures == "sampling"
        assert found.holds and found.band is not None and found.band < 0.1


def test_what_is_not_an_energy_is_refused() -> None:
    system = load_scene("fig8b").system
    for theory, observable, words in (
        ("integrable", (Coordinate("q", 0),), "energies only"),
        ("integrable", (H1, TOTAL), "both must be modal"),
        ("nonintegrable", (H1,), "total energy only"),
    ):
        assert words in (AveragedSimulation(theory).refusal(system, observable) or "")


def test_the_answer_does_not_depend_on_threads() -> None:
    form = square_root_form(coupled(0.8))
    short = SAMPLING | {"paths": 256, "time": 3.0, "burn_in": 1.0}
    (one,) = simulate_energies(form, [(H1,)], **short)
    (two,) = simulate_energies(form, [(H1,)], **short, threads=2)
    assert np.array_equal(one.batch_values, two.batch_values)


def test_energies_stay_positive_at_a_coarse_step() -> None:
    stream = np.random.default_rng(3)
    form = square_root_form(coupled(0.8))
    H = np.full((2000, 2), 1e-12)
    for _ in range(20):
        H = square_root_step(form, H, 2.0, stream)
        assert np.all(H >= 0) and np.isfinite(H).all()


def test_refusals() -> None:
    def diffusion(H):
        return H[:, :, None] * np.eye(2) + 0.1 * H.prod(1)[:, None, None]

    independent = coupled(0.1).coefficients
    correlated = replace(
        coupled(0.1), coefficients=lambda H: independent(H)._replace(diffusion=diffusion(H))
    )
    with pytest.raises(NotApplicable, match="correlated"):
        square_root_form(correlated)
    pulled = replace(
        coupled(0.1),
        coefficients=lambda H: independent(H)._replace(drift=independent(H).drift + H[:, ::-1]),
    )
    with pytest.raises(NotApplicable, match="H1 at 0 depends on the other"):
        square_root_form(pulled)
    form = square_root_form(coupled(0.1))
    with pytest.raises(InvalidInput, match="paths"):
        simulate_energies(form, [(H1,)], **SAMPLING | {"paths": 100})
    with pytest.raises(InvalidInput, match="step"):
        AveragedSimulation("integrable", step=0.0)


@pytest.mark.slow
def test_quantities_are_free_of_the_bias_of_the_step() -> None:
    """With steps four times as long the standard deviation was off by 4 to 6 standard errors."""
    system = load_scene("vanderpol").system
    (exact,) = method_for("nonintegrable", "fem").solve(system, [(TOTAL,)]).densities
    z = []
    for seed in range(1, 5):
        (sampled,) = (
            AveragedSimulation("nonintegrable", seed=seed).solve(system, [(TOTAL,)]).densities
        )
        std = sampled.std()
        z.append((std.value - exact.std().value) / std.error)
    assert abs(np.mean(z)) < 2.0  # four standard deviations of the mean of four
