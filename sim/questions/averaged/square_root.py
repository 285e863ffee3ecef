"""Averaged energies as square-root processes, Eqs. (9), (17): their form, exact steps, limits."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from math import sqrt

import numpy as np

from fpk.numeric.arrays import EPS, ROUND_OFF, Array
from fpk.numeric.errors import NotApplicable, NotCertified
from fpk.numeric.quadrature import panel_rule
from fpk.system.modulation import Modulation
from fpk.system.process import Process, log_density_slope
from sim.questions.passing import NATS, Diffusion

Function = Callable[[Array], Array]

FIRST = 8
"""Cells next to 0 with the γ of the next one: a difference of equal numbers is divided by X."""


@dataclass(frozen=True, eq=False)
class SquareRootForm:
    """``dX_i = (d_i − γ_i(X) X_i) dt + √(β_i X_i) dB_i``, i = 1 … d, noises independent, Eq. (17).

    ``noise`` d, ``slope`` β and ``linear`` γ₀ are constants (d,). ``damping`` returns γ − γ₀ at X
    (paths, d), None where γ is constant: a step of any length is then exact. ``energies`` gives H
    (paths, d) of X; ``scales`` (d,) are X of the order of the mean. ``quiet`` are γ₀ and γ − γ₀ of
    the damping alone, without noise, where these are others. p(Σ H_i) is in proportion to H^(n−1)
    next to 0, n the ``degrees_of_freedom``, and may not be smooth at ``kinks``.
    """

    noise: Array
    slope: Array
    damping: Function | None
    linear: Array
    energies: Function
    scales: Array
    quiet: tuple[Array, Function] | None = None
    degrees_of_freedom: int = 1
    kinks: tuple[float, ...] = ()

    def under(self, factor: float) -> "SquareRootForm":
        """Return the form under so many times the noise."""
        linear, damping = self.linear, self.damping
        if self.quiet is not None and damping is not None:
            (alone, of_damping), whole = self.quiet, damping
            linear = alone + factor * (linear - alone)

            def damping(X: Array) -> Array:
                rest = of_damping(X)
                return np.asarray(rest + factor * (whole(X) - rest))

        noise, slope = factor * self.noise, factor * self.slope
        return replace(self, noise=noise, slope=slope, linear=linear, damping=damping)


def square_root_form(process: Process) -> SquareRootForm:
    """Return modal energies H_i, with b_ii = β_i H_i and s_i = d_i where H_i = 0, as they are.

    Raises ``NotApplicable`` where β_i or d_i depends on the energies, or b_ij ≠ 0.
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
    # Read at large energies: next to 0 the difference of equal numbers is divided by H_i.
    constant = rates[probes.argmax(axis=0), np.arange(scales.size)]
    round_off = ROUND_OFF * (np.abs(d / probes) + np.abs(constant))
    alike = bool(np.all(np.abs(rates - constant) <= round_off))
    linear = constant if alike else rate(np.zeros((1, scales.size)))[0]
    return SquareRootForm(
        noise=d,
        slope=slope,
        damping=None if alike else lambda H: rate(H) - linear,
        linear=linear,
        energies=lambda H: H,
        scales=scales,
        degrees_of_freedom=scales.size,
    )


def line_form(process: Process) -> SquareRootForm:
    """Return X = R², R = ∫ dH/√b from 0: a square-root process with β = 4 whatever b(H) is.

    By Ito's formula ``dX = μ dt + 2 √X dB``, ``μ = 1 + 2 R (s − b'/4)/√b``, and μ(0) = d = 2n with
    n degrees of freedom: steps are of weak order two, but where contact has no clearance, where γ
    is steep next to 0. Raises ``NotApplicable`` where the density does not fall off.
    """
    grid = process.energy_scale * np.logspace(-3.0, 3.0, 600)
    slope = log_density_slope(process.coefficients(grid))
    log_p = np.concatenate([[0.0], np.cumsum(0.5 * (slope[1:] + slope[:-1]) * np.diff(grid))])
    deep = np.flatnonzero(np.maximum.accumulate(log_p) - log_p > NATS)
    if not deep.size:
        raise NotApplicable("the density of the energy does not fall off: nothing is stationary")
    # Linear interpolation between 4096 cells is good to 1e-7.
    nodes = float(grid[deep[0]]) * np.linspace(0.0, 1.0, 4097) ** 2
    # H = t²: the integrand 2 t/√b(t²) is smooth at 0, where b ~ H.
    t, w = panel_rule(np.sqrt(nodes), 4)
    b = process.coefficients((t**2).ravel()).diffusion.reshape(t.shape)
    R = np.concatenate([[0.0], np.cumsum(np.sum(w * 2.0 * t / np.sqrt(b), axis=1))])
    # H/R² varies slowly; H itself would be off by the square of a cell next to 0.
    ratio = nodes[1:] / R[1:] ** 2
    inner, c = R[1 + FIRST :], process.coefficients(nodes[1 + FIRST :])
    noise, sigma = 2.0 * process.degrees_of_freedom, np.sqrt(c.diffusion)
    mu = 1.0 + 2.0 * inner * (c.drift - 0.25 * c.divergence) / sigma
    gamma, alone = (noise - mu) / inner**2, -2.0 * c.dissipation / sigma / inner
    table, rest = gamma - gamma[0], alone - alone[0]
    # What the table itself is good for counts as nothing.
    alike = float(np.max(np.abs(table))) <= 1e-6 * abs(float(gamma[-1]))
    return SquareRootForm(
        noise=np.array([noise]),
        slope=np.array([4.0]),
        damping=None if alike else lambda X: np.interp(np.sqrt(X), inner, table),
        linear=gamma[:1],
        energies=lambda X: np.asarray(X * np.interp(np.sqrt(X), R[1:], ratio)),
        scales=np.interp(np.array([process.energy_scale]), nodes, R) ** 2,
        quiet=(alone[:1], lambda X: np.interp(np.sqrt(X), inner, rest)),
        degrees_of_freedom=process.degrees_of_freedom,
        kinks=process.nonsmooth,
    )


def limit_diffusion(form: SquareRootForm, weights: Array) -> Diffusion:
    """Return how the noise moves the sums ``weights`` (limits, d) · X, forms of the momenta √X.

    A sum S of square-root processes has dS = … + σ dB, σ² = Σ w² β X; as the noise moves S by 1 it
    moves σ² by Σ w³ β² X/σ², at rest by that of the energy alone that moves most.
    """
    w, one, slope = weights[:, :, None], np.eye(form.slope.size), form.slope[:, None]
    return Diffusion(w**2 * slope * one, w**3 * slope**2 * one, np.max(w * slope, axis=(1, 2)))


def from_energies(form: SquareRootForm, energies: Array) -> Array:
    """Return X (paths, d) of ``energies``: by bisection, ``form.energies`` being monotone."""
    low, high = np.zeros_like(energies), np.broadcast_to(form.scales, energies.shape).copy()
    while np.any(below := form.energies(high) < energies):
        high[below] *= 2.0
    for _ in range(60):  # to the last digit
        middle = 0.5 * (low + high)
        below = form.energies(middle) < energies
        low, high = np.where(below, middle, low), np.where(below, high, middle)
    return np.asarray(high)


def square_root_step(
    form: SquareRootForm,
    X: Array,
    dt: float,
    stream: np.random.Generator,
    modulation: Modulation | None = None,
    begin: float = 0.0,
) -> Array:
    """Draw X (paths, d) one step later, by Strang splitting; it stays positive.

    Half a step of the damping beyond the linear, ``dX = −(γ(X) − γ₀) X dt`` by an exponential
    midpoint rule, the exact step of the square-root process that is left, and the other half. That
    process has X(t) = k χ'², k = β (1 − e^{−γ₀t})/(4γ₀), noncentral chi-square with 4 d/β degrees
    of freedom and noncentrality X e^{−γ₀t}/k. Weak order two. Of modulated noise, the step being
    from ``begin`` on, (1 − e^{−γ₀t})/γ₀ is ∫e(s)² e^{−γ₀(t−s)} ds, exact as well, and γ that of the
    mean of e².

    Raises ``NotCertified`` where a step is so long that energies grow beyond all bounds.
    """
    factor = 1.0 if modulation is None else float(modulation.mean_square(np.array(begin), dt))
    form = form if modulation is None else form.under(factor)

    def damped(X: Array) -> Array:
        if form.damping is None:
            return X
        middle = X * np.exp(-0.25 * dt * form.damping(X))
        return np.asarray(X * np.exp(-0.5 * dt * form.damping(middle)))

    X = damped(X)
    # (1 − e^{−γt})/γ, also for γ = 0.
    nonzero = np.where(form.linear, form.linear, 1.0)
    grown = np.where(form.linear == 0.0, dt, -np.expm1(-form.linear * dt) / nonzero)
    decay = np.exp(-form.linear * dt)
    if factor == 0.0:
        return damped(X * decay)
    if modulation is not None:
        grown = modulation.faded(begin, begin + dt, form.linear) / factor
    k = 0.25 * form.slope * grown
    freedom = 4.0 * form.noise / form.slope
    X = damped(k * stream.noncentral_chisquare(freedom, X * decay / k))
    if not np.isfinite(X).all():
        words = "energies left the range of double precision: steps of"
        raise NotCertified(f"{words} {dt:g} are unstable; use a smaller step")
    return X
