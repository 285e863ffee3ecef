"""Averaged energies as square-root processes: the form that exact steps need."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from fpk.errors import NotApplicable
from fpk.process import Process
from sim.arrays import Array

Function = Callable[[Array], Array]

NEAR_ZERO = 1e-7
"""Energy, in units of the process's scale, below which γ and β are those at that energy."""

PROBES = 64
"""Random energies at which coefficients are compared to see whether they are constants."""

ALIKE = 1e-12
"""Relative spread over the probes below which a coefficient counts as a constant."""


@dataclass(frozen=True, eq=False)
class SquareRootForm:
    """``dX_i = (d_i − γ_i X_i) dt + √(β_i X_i) dB_i``, i = 1 … d, noises independent, Eq. (17).

    ``noise`` d, ``slope`` β and ``damping`` γ − γ₀ take X (paths, d) and return the same shape, or
    (1, d) for a constant; ``linear`` γ₀ (d,). ``damping`` is None where nothing is left of it: with
    d and β constant a step is then exact at any length. ``energies`` gives H (paths, d) of X;
    ``scales`` (d,) are X of the order of the mean, ``times`` (d,) how long noise takes to fill
    them, the relaxation time of a single well.
    """

    noise: Function
    slope: Function
    damping: Function | None
    linear: Array
    energies: Function
    scales: Array
    times: Array

    @property
    def exact(self) -> bool:
        """Whether a step of any length is exact: nothing is split off, d and β are constants."""
        probe = np.ones((2, self.scales.size)) * self.scales
        constant = all(f(probe).shape[0] == 1 for f in (self.noise, self.slope))
        return self.damping is None and constant


def square_root_form(process: Process) -> SquareRootForm:
    """Return energies H_i with b_ii = β_i H_i and b_ij = 0 in the form of exact steps.

    d_i is the drift on the axis H_i = 0, the other energies as they are; β_i may depend on the
    other energies and, then frozen over a step, on H_i. Constants are recognised by probing.

    Raises ``NotApplicable`` where noises are correlated (b_ij ≠ 0).
    """
    scales = np.array(process.energy_scales)
    probes = np.random.default_rng(0).exponential(scales, (PROBES, scales.size))

    def noise(H: Array) -> Array:
        d = np.empty_like(H)
        for i in range(scales.size):
            edge = H.copy()
            edge[:, i] = 0.0
            d[:, i] = process.at(edge).drift[:, i]
        return d

    def slope(H: Array) -> Array:
        safe = np.maximum(H, NEAR_ZERO * scales)
        return np.asarray(np.einsum("nii->ni", process.at(safe).diffusion) / safe)

    b = process.at(probes).diffusion
    off = b - np.einsum("nii->ni", b)[:, :, None] * np.eye(scales.size)
    if np.any(np.abs(off) > ALIKE * np.abs(b).max(axis=(1, 2), keepdims=True)):
        raise NotApplicable("the noises of two energies are correlated (b_ij ≠ 0): not simulated")
    d = _constant_or(noise, probes)

    def rate(H: Array) -> Array:
        safe = np.maximum(H, NEAR_ZERO * scales)
        return np.asarray((d(H) - process.at(safe).drift) / safe)

    rates = rate(probes)
    # Read at large energies: next to 0 the difference of equal numbers is divided by H_i.
    constant = rates[probes.argmax(axis=0), np.arange(scales.size)]
    round_off = ALIKE * (np.abs(d(probes) / probes) + np.abs(constant))
    alike = bool(np.all(np.abs(rates - constant) <= round_off))
    linear = constant if alike else rate(np.zeros((1, scales.size)))[0]
    return SquareRootForm(
        noise=d,
        slope=_constant_or(slope, probes),
        damping=None if alike else lambda H: rate(H) - linear,
        linear=linear,
        energies=lambda H: H,
        scales=scales,
        times=scales / noise(scales[None])[0],
    )


def _constant_or(function: Function, probes: Array) -> Function:
    """Return the function, or the constant (1, d) that it is at all ``probes``."""
    values = function(probes)
    if np.all(np.ptp(values, axis=0) <= ALIKE * np.abs(values).max(axis=0)):
        return lambda H: values[:1]
    return function


def square_root_step(
    form: SquareRootForm, X: Array, dt: float, stream: np.random.Generator
) -> Array:
    """Draw X (paths, d) one step later, by Strang splitting; it stays positive.

    Half a step of the damping beyond the linear, ``dX = −(γ(X) − γ₀) X dt`` by an exponential
    midpoint rule, the exact step of the square-root process that is left, and the other half. That
    process started from X has X(t) = k χ'², k = β (1 − e^{−γ₀t})/(4γ₀), noncentral chi-square with
    4 d/β degrees of freedom and noncentrality X e^{−γ₀t}/k. Weak order two where d and β are
    constants, one where they depend on the state: they are frozen over the step.
    """
    X = _damped(form, X, 0.5 * dt)
    # (1 − e^{−γt})/γ, also for γ = 0.
    nonzero = np.where(form.linear, form.linear, 1.0)
    grown = np.where(form.linear == 0.0, dt, -np.expm1(-form.linear * dt) / nonzero)
    beta = form.slope(X)
    k = 0.25 * beta * grown
    X = k * stream.noncentral_chisquare(
        4.0 * form.noise(X) / beta, X * np.exp(-form.linear * dt) / k
    )
    return _damped(form, X, 0.5 * dt)


def _damped(form: SquareRootForm, X: Array, dt: float) -> Array:
    if form.damping is None:
        return X
    middle = X * np.exp(-0.5 * dt * form.damping(X))
    return np.asarray(X * np.exp(-dt * form.damping(middle)))
