"""Averaged energies as square-root processes: the form that exact steps need."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from fpk.errors import NotApplicable
from fpk.process import Process
from sim.arrays import Array

Function = Callable[[Array], Array]

NEAR_ZERO = 1e-7
"""Energy, in units of the process's scale, below which γ is that at this energy."""

PROBES = 64
"""Random energies at which coefficients are compared to see whether they are constants."""

ALIKE = 1e-12
"""Relative spread over the probes below which a coefficient counts as a constant."""


@dataclass(frozen=True, eq=False)
class SquareRootForm:
    """``dX_i = (d_i − γ_i(X) X_i) dt + √(β_i X_i) dB_i``, i = 1 … d, noises independent, Eq. (17).

    ``noise`` d, ``slope`` β and ``linear`` γ₀ are constants (d,). ``damping`` returns γ − γ₀ at X
    (paths, d), None where γ is constant: a step of any length is then exact. ``energies`` gives H
    (paths, d) of X; ``scales`` (d,) are X of the order of the mean, ``times`` (d,) how long noise
    takes to fill them, the relaxation time of a single well.
    """

    noise: Array
    slope: Array
    damping: Function | None
    linear: Array
    energies: Function
    scales: Array
    times: Array


def square_root_form(process: Process) -> SquareRootForm:
    """Return modal energies H_i, with b_ii = β_i H_i and s_i = d_i where H_i = 0, as they are.

    Raises ``NotApplicable`` where β_i or d_i depends on the energies, or b_ij ≠ 0.
    """
    scales = np.array(process.energy_scales)
    probes = np.random.default_rng(0).exponential(scales, (PROBES, scales.size))
    b, d = process.at(probes).diffusion, np.empty_like(probes)
    for i in range(scales.size):
        edge = np.where(np.arange(scales.size) == i, 0.0, probes)
        d[:, i] = process.at(edge).drift[:, i]
    beta = np.einsum("nii->ni", b) / probes
    off = b - np.einsum("nii->ni", b)[:, :, None] * np.eye(scales.size)
    if np.any(np.abs(off) > ALIKE * np.abs(b).max(axis=(1, 2), keepdims=True)):
        raise NotApplicable("the noises of two energies are correlated (b_ij ≠ 0): not simulated")
    if any(np.any(np.ptp(x, axis=0) > ALIKE * np.abs(x).max(axis=0)) for x in (d, beta)):
        raise NotApplicable("the noise depends on the energies otherwise than b_ii ~ H_i")

    def rate(H: Array) -> Array:
        safe = np.maximum(H, NEAR_ZERO * scales)
        return np.asarray((d[0] - process.at(safe).drift) / safe)

    rates = rate(probes)
    # Read at large energies: next to 0 the difference of equal numbers is divided by H_i.
    constant = rates[probes.argmax(axis=0), np.arange(scales.size)]
    round_off = ALIKE * (np.abs(d[0] / probes) + np.abs(constant))
    alike = bool(np.all(np.abs(rates - constant) <= round_off))
    linear = constant if alike else rate(np.zeros((1, scales.size)))[0]
    return SquareRootForm(
        noise=d[0],
        slope=beta[0],
        damping=None if alike else lambda H: rate(H) - linear,
        linear=linear,
        energies=lambda H: H,
        scales=scales,
        times=scales / d[0],
    )


def square_root_step(
    form: SquareRootForm, X: Array, dt: float, stream: np.random.Generator
) -> Array:
    """Draw X (paths, d) one step later, by Strang splitting; it stays positive.

    Half a step of the damping beyond the linear, ``dX = −(γ(X) − γ₀) X dt`` by an exponential
    midpoint rule, the exact step of the square-root process that is left, and the other half. That
    process started from X has X(t) = k χ'², k = β (1 − e^{−γ₀t})/(4γ₀), noncentral chi-square with
    4 d/β degrees of freedom and noncentrality X e^{−γ₀t}/k. Weak order two.
    """
    X = _damped(form, X, 0.5 * dt)
    # (1 − e^{−γt})/γ, also for γ = 0.
    nonzero = np.where(form.linear, form.linear, 1.0)
    grown = np.where(form.linear == 0.0, dt, -np.expm1(-form.linear * dt) / nonzero)
    k = 0.25 * form.slope * grown
    freedom, decay = 4.0 * form.noise / form.slope, np.exp(-form.linear * dt)
    return _damped(form, k * stream.noncentral_chisquare(freedom, X * decay / k), 0.5 * dt)


def _damped(form: SquareRootForm, X: Array, dt: float) -> Array:
    if form.damping is None:
        return X
    middle = X * np.exp(-0.5 * dt * form.damping(X))
    return np.asarray(X * np.exp(-dt * form.damping(middle)))
