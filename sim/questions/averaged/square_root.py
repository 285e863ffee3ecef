"""Averaged energies as square-root processes, Eqs. (9), (17): coefficients and steps."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from math import sqrt

import numpy as np

from fpk.numeric.arrays import EPS, ROUND_OFF, Array
from fpk.numeric.errors import NotApplicable, NotCertified
from fpk.numeric.quadrature import panel_rule
from fpk.system.modulation import Modulation
from fpk.system.process import Process, log_density_slope
from sim.questions.passing import NEGLIGIBLE_NATS, Diffusion

Function = Callable[[Array], Array]

FIRST_CELLS = 8
"""Cells next to X = 0 in which γ is taken from the next cell, as (d − μ)/X cancels near 0."""


@dataclass(frozen=True, eq=False)
class SquareRootForm:
    """``dX_i = (d_i − γ_i(X) X_i) dt + √(β_i X_i) dB_i``, i = 1 … d, noises independent, Eq. (17).

    p(Σ H_i) is proportional to H^(n−1) near H = 0, n ``degrees_of_freedom``; at ``kinks`` it may
    not be smooth.
    """

    noise: Array  # (d,), d
    slope: Array  # (d,), β
    damping: Function | None  # γ − γ₀ at X (paths, d); None: γ is constant, and any step is exact
    linear: Array  # (d,), γ₀
    energies: Function  # H (paths, d) of X
    scales: Array  # (d,), order of magnitude of the mean of X
    quiet: tuple[Array, Function] | None = None  # γ₀ and γ − γ₀ without noise; None: the same
    degrees_of_freedom: int = 1
    kinks: tuple[float, ...] = ()

    @property
    def steps(self) -> str:
        """Whether steps are "exact" or by "Strang splitting", for the settings of an answer."""
        return "exact" if self.damping is None else "Strang splitting"

    def under(self, factor: float) -> "SquareRootForm":
        """Return the form of ``factor`` times the noise intensity in d, β and, by ``quiet``, γ."""
        louder = replace(self, noise=factor * self.noise, slope=factor * self.slope)
        if self.quiet is None or self.damping is None:
            return louder
        (alone, of_damping), whole = self.quiet, self.damping

        def damping(X: Array) -> Array:
            rest = of_damping(X)
            return np.asarray(rest + factor * (whole(X) - rest))

        return replace(louder, linear=alone + factor * (self.linear - alone), damping=damping)

    def inverse(self, energies: Array) -> Array:
        """Return the X >= 0 (paths, d) that have the ``energies`` (paths, d), by bisection."""
        low, high = np.zeros_like(energies), np.broadcast_to(self.scales, energies.shape).copy()
        while np.any(below := self.energies(high) < energies):
            high[below] *= 2.0
        for _ in range(60):  # to the last digit
            middle = 0.5 * (low + high)
            below = self.energies(middle) < energies
            low, high = np.where(below, middle, low), np.where(below, high, middle)
        return np.asarray(high)

    def diffusion(self, weights: Array) -> Diffusion:
        """Return the diffusion of the sums ``weights`` (limits, d) · X, as forms of momenta √X.

        σ² = Σ w² β X; its slope in the direction of the noise is Σ w³ β² X/σ².
        """
        w, unit, slope = weights[:, :, None], np.eye(self.slope.size), self.slope[:, None]
        beta = np.max(w * slope, axis=(1, 2))
        forms = w**2 * slope * unit, w**3 * slope**2 * unit
        return Diffusion(*forms, beta, np.zeros_like(beta))


def square_root_form(process: Process) -> SquareRootForm:
    """Return the form whose X are the energies H_i of ``process``, with σ²_ii = β_i H_i.

    d_i is the drift of H_i = 0. Raises ``NotApplicable`` if β_i or d_i depends on the energies, or
    the noises of two energies are correlated.
    """
    scales = np.array(process.energy_scales)
    probes = np.random.default_rng(0).exponential(scales, (64, scales.size))
    d, b = process.at(np.zeros((1, scales.size))).drift[0], process.at(probes).diffusion
    for i in range(scales.size):
        edge = process.at(np.where(np.arange(scales.size) == i, 0.0, probes)).drift[:, i]
        if np.any(np.abs(edge - d[i]) > ROUND_OFF * np.abs(d[i])):
            raise NotApplicable(f"the drift of H{i + 1} at 0 depends on the other energies")
    slope = np.diag(b[0]) / probes[0]
    other = np.abs(b - (slope * probes)[:, :, None] * np.eye(scales.size))
    if np.any(other > ROUND_OFF * np.abs(b).max(axis=(1, 2), keepdims=True)):
        raise NotApplicable("the noises of the energies are correlated, or not b_ii ~ H_i")

    def rate(H: Array) -> Array:
        safe = np.maximum(H, sqrt(EPS) * scales)  # below, half of the digits are lost
        return np.asarray((d - process.at(safe).drift) / safe)

    rates = rate(probes)
    # At the largest energies: near 0 the difference d − drift cancels.
    constant = rates[probes.argmax(axis=0), np.arange(scales.size)]
    round_off = ROUND_OFF * (np.abs(d / probes) + np.abs(constant))
    is_constant = bool(np.all(np.abs(rates - constant) <= round_off))
    linear = constant if is_constant else rate(np.zeros((1, scales.size)))[0]
    return SquareRootForm(
        noise=d,
        slope=slope,
        damping=None if is_constant else lambda H: rate(H) - linear,
        linear=linear,
        energies=lambda H: H,
        scales=scales,
        degrees_of_freedom=scales.size,
    )


def line_form(process: Process) -> SquareRootForm:
    """Return the form of X = R², R = ∫ dH/√b from 0, which is a square-root process for any b(H).

    s is the drift and b = σ² the diffusion of ``process``. By Ito's formula ``dX = μ dt + 2 √X
    dB``, ``μ = 1 + 2 R (s − b'/4)/√b``, and μ(0) = d = 2n with n degrees of freedom. For a stop
    without clearance γ is steep near 0, and the steps are not of weak order two. Raises
    ``NotApplicable`` if the stationary density does not decay.
    """
    grid = process.energy_scale * np.logspace(-3.0, 3.0, 600)
    slope = log_density_slope(process.coefficients(grid))
    log_p = np.concatenate([[0.0], np.cumsum(0.5 * (slope[1:] + slope[:-1]) * np.diff(grid))])
    deep = np.flatnonzero(np.maximum.accumulate(log_p) - log_p > NEGLIGIBLE_NATS)
    if not deep.size:
        raise NotApplicable("the density of the energy does not fall off: nothing is stationary")
    # Linear interpolation in 4096 cells has a relative error of 1e-7.
    nodes = float(grid[deep[0]]) * np.linspace(0.0, 1.0, 4097) ** 2
    # H = t²: the integrand 2 t/√b(t²) is smooth at 0, where b ~ H.
    t, w = panel_rule(np.sqrt(nodes), 4)
    b = process.coefficients((t**2).ravel()).diffusion.reshape(t.shape)
    R = np.concatenate([[0.0], np.cumsum(np.sum(w * 2.0 * t / np.sqrt(b), axis=1))])
    # H/R² varies slowly; the interpolation error of H itself would be large near 0.
    ratio = nodes[1:] / R[1:] ** 2
    inner, c = R[1 + FIRST_CELLS :], process.coefficients(nodes[1 + FIRST_CELLS :])
    noise, sigma = 2.0 * process.degrees_of_freedom, np.sqrt(c.diffusion)
    mu = 1.0 + 2.0 * inner * (c.drift - 0.25 * c.divergence) / sigma
    gamma, alone = (noise - mu) / inner**2, -2.0 * c.dissipation / sigma / inner
    table, rest = gamma - gamma[0], alone - alone[0]
    # Up to the error of the table itself.
    is_constant = float(np.max(np.abs(table))) <= 1e-6 * abs(float(gamma[-1]))
    return SquareRootForm(
        noise=np.array([noise]),
        slope=np.array([4.0]),
        damping=None if is_constant else lambda X: np.interp(np.sqrt(X), inner, table),
        linear=gamma[:1],
        energies=lambda X: np.asarray(X * np.interp(np.sqrt(X), R[1:], ratio)),
        scales=np.interp(np.array([process.energy_scale]), nodes, R) ** 2,
        quiet=(alone[:1], lambda X: np.interp(np.sqrt(X), inner, rest)),
        degrees_of_freedom=process.degrees_of_freedom,
        kinks=process.nonsmooth,
    )


@np.errstate(over="ignore", invalid="ignore")  # a step that overflows is refused at the end
def square_root_step(
    form: SquareRootForm,
    X: Array,
    dt: float,
    stream: np.random.Generator,
    modulation: Modulation | None = None,
    begin: float = 0.0,
) -> Array:
    """Return X (paths, d) after a step ``dt``, drawn from ``stream``; it is never < 0.

    Strang splitting of weak order two: half a step of the nonlinear damping, ``dX = −(γ(X) − γ₀) X
    dt``, by an exponential midpoint rule, an exact step of the rest, and the other half. The exact
    step is X(t) = k χ'², k = β (1 − e^{−γ₀t})/(4γ₀), χ'² noncentral chi-square with 4 d/β degrees
    of freedom and noncentrality X e^{−γ₀t}/k. With modulated noise e, from the time ``begin`` on,
    (1 − e^{−γ₀t})/γ₀ is replaced by ∫e(s)² e^{−γ₀(t−s)} ds, and γ is taken for the mean of e².
    Raises ``NotCertified`` if X is not finite after a step with noise.
    """
    factor = 1.0 if modulation is None else float(modulation.mean_square(np.array(begin), dt))
    form = form if modulation is None else form.under(factor)

    def half_step(X: Array) -> Array:
        if form.damping is None:
            return X
        middle = X * np.exp(-0.25 * dt * form.damping(X))
        return np.asarray(X * np.exp(-0.5 * dt * form.damping(middle)))

    X = half_step(X)
    # (1 − e^{−γt})/γ, also for γ = 0.
    nonzero = np.where(form.linear, form.linear, 1.0)
    grown = np.where(form.linear == 0.0, dt, -np.expm1(-form.linear * dt) / nonzero)
    decay = np.exp(-form.linear * dt)
    if factor == 0.0:
        return half_step(X * decay)
    if modulation is not None:
        grown = modulation.faded(begin, begin + dt, form.linear) / factor
    k = 0.25 * form.slope * grown
    X = half_step(k * stream.noncentral_chisquare(4.0 * form.noise / form.slope, X * decay / k))
    if not np.isfinite(X).all():
        words = "energies left the range of double precision: steps of"
        raise NotCertified(f"{words} {dt:g} are unstable; use a smaller step")
    return X
