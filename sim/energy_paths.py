"""Monte Carlo of averaged equations (17): several energies, each a square-root process at heart."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fpk.density import Certificate, SampledDensity
from fpk.errors import InvalidInput, NotApplicable
from fpk.observable import Coordinate
from fpk.vector_process import VectorProcess

Array = NDArray[np.float64]

BATCHES = 64
"""Independent batches of paths, each with its own stream of random numbers."""
LEAST_PATHS = 4
"""Paths per batch at the least."""
NEAR_ZERO = 1e-7
"""Energy, in units of the process's scale, below which γ and β are those at that energy."""


@dataclass(frozen=True)
class EnergySampling:
    """How averaged equations are simulated.

    Every step of length ``dt`` draws each energy exactly from a square-root process
    ``dH = (d − γ₀ H) dt + √(β H) dB`` and splits off the rest of the damping symmetrically.
    Energies stay positive, uncoupled modes with constant damping are exact at any ``dt``, and the
    weak order is two where d and β are constants (noise that does not depend on the state).
    ``paths`` in all, each sampled every ``interval`` for ``time`` after ``burn_in``.
    """

    dt: float
    time: float
    burn_in: float
    interval: float
    paths: int = 16384
    seed: int = 1
    bins: int = 64

    def __post_init__(self) -> None:
        """Refuse what cannot be simulated."""
        for key in ("dt", "time", "interval"):
            if not getattr(self, key) > 0:
                raise InvalidInput(key, getattr(self, key), "must be > 0")
        if self.paths < BATCHES * LEAST_PATHS or self.paths % BATCHES:
            raise InvalidInput(
                "paths",
                self.paths,
                f"must be a multiple of {BATCHES}, {BATCHES * LEAST_PATHS} or more",
            )


def simulate_energies(
    process: VectorProcess, sampling: EnergySampling, reach: tuple[float, float]
) -> SampledDensity:
    """Return the histogram density of (H1, H2) on [0, reach] with its sampling error.

    Raises ``NotApplicable`` for a process that has not two energies, or whose noises are correlated
    (b_12 ≠ 0): the exact step is that of one energy at a time.
    """
    if process.dimension != 2:
        raise NotApplicable("averaged equations are simulated for two energies")
    edges = tuple(np.linspace(0.0, end, sampling.bins + 1) for end in reach)
    counts = np.zeros((BATCHES, sampling.bins, sampling.bins))
    samples, outside = 0, 0
    scales = np.array(process.energy_scales)
    warm = int(np.ceil(sampling.burn_in / sampling.dt))
    stride = max(1, round(sampling.interval / sampling.dt))
    steps = warm + int(np.ceil(sampling.time / sampling.dt))
    for batch in range(BATCHES):
        stream = np.random.Generator(np.random.Philox(key=[sampling.seed, batch]))
        H = stream.exponential(scales, (sampling.paths // BATCHES, 2))
        for step in range(steps):
            H = square_root_step(process, H, sampling.dt, stream)
            if step >= warm and (step - warm) % stride == 0:
                found, _, _ = np.histogram2d(H[:, 0], H[:, 1], bins=edges)
                counts[batch] += found
                outside += H.shape[0] - int(found.sum())
                samples += H.shape[0]
    area = float(np.prod([edge[1] for edge in edges]))
    batch_values = counts / (samples / BATCHES * area)
    values = batch_values.mean(axis=0)
    share = outside / samples
    finite = bool(np.isfinite(H).all())
    return SampledDensity(
        (Coordinate("H", 0), Coordinate("H", 1)),
        edges,
        values,
        batch_values,
        Certificate(
            mass_defect=abs(float(values.sum()) * area + share - 1.0),
            minimum=float(values.min() / values.max()),
            residual=0.0,
            tail_mass=share,
            failures=() if finite else ("an energy left the finite range",),
        ),
        {"equation": "(17)", "dt": sampling.dt, "paths": sampling.paths, "seed": sampling.seed},
    )


def square_root_step(
    process: VectorProcess, H: Array, dt: float, stream: np.random.Generator
) -> Array:
    """Draw the energies (paths, 2) one step later, by Strang splitting.

    Half a step of the damping beyond the linear, ``dH = −(γ(H) − γ₀) H dt`` by an exponential
    midpoint rule, the exact step of the square-root process that is left, and the other half. That
    process started from H has H(t) = k χ'², k = β (1 − e^{−γ₀t})/(4γ₀), noncentral chi-square with
    4 d/β degrees of freedom and noncentrality H e^{−γ₀t}/k.
    """
    linear = _damping(process, np.zeros((1, 2)))[0]
    H = _nonlinear_damping(process, H, linear, 0.5 * dt)
    d, beta = _edge_drift(process, H), _slope_of_diffusion(process, H)
    decay = np.exp(-linear * dt)
    # (1 − e^{−γt})/γ, also for γ = 0.
    grown = np.where(linear == 0.0, dt, -np.expm1(-linear * dt) / np.where(linear, linear, 1.0))
    k = 0.25 * beta * grown
    H = k * stream.noncentral_chisquare(4.0 * d / beta, H * decay / k)
    return _nonlinear_damping(process, H, linear, 0.5 * dt)


def _nonlinear_damping(process: VectorProcess, H: Array, linear: Array, dt: float) -> Array:
    middle = H * np.exp(-0.5 * dt * (_damping(process, H) - linear))
    return np.asarray(H * np.exp(-dt * (_damping(process, middle) - linear)))


def _damping(process: VectorProcess, H: Array) -> Array:
    """γ of ``s_i = d_i − γ_i H_i`` (paths, 2), d_i the drift where H_i is next to zero."""
    safe = np.maximum(H, NEAR_ZERO * np.array(process.energy_scales))
    return np.asarray((_edge_drift(process, H) - process.drift(safe)) / safe)


def _edge_drift(process: VectorProcess, H: Array) -> Array:
    """Drift of each energy (paths, 2) on its axis H_i = 0, the other energy as it is."""
    d = np.empty_like(H)
    for i in (0, 1):
        edge = H.copy()
        edge[:, i] = 0.0
        d[:, i] = process.drift(edge)[:, i]
    return d


def _slope_of_diffusion(process: VectorProcess, H: Array) -> Array:
    """β of b_ii = β_i H_i (paths, 2)."""
    safe = np.maximum(H, NEAR_ZERO * np.array(process.energy_scales))
    b = process.diffusion(safe)
    if np.any(b[:, 0, 1]):
        raise NotApplicable("the noises of the two energies are correlated (b_12 ≠ 0)")
    return np.stack([b[:, i, i] / safe[:, i] for i in (0, 1)], axis=1)
