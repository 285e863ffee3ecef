"""Averaged energy process of a quasi-non-integrable Hamiltonian system, Eqs. (9), (24).

Its stationary density is p = C T exp(−∫h dH) if the damping depends on the energy only, Eqs. (7),
(29), (34).
"""

from collections import defaultdict
from dataclasses import replace
from functools import partial
from math import exp
from typing import Any

import numpy as np
from numpy.polynomial import polynomial
from scipy.special import gammainccinv, gammaincinv

from averaging.conditional import HIDDEN_RULES, gibbs_integral
from averaging.shell.averages import log_linear_states, shell_averages
from averaging.shell.rays import EnergyShell
from averaging.weyl import Part, Solution, StateDensity, density_by_tables
from averaging.zero_flux import ENERGY_RULES, ZeroFluxDensity, flux_residual
from fpk.answer.certificate import Measured
from fpk.numeric.arrays import DEPTH, EPS, ROUND_OFF, SMALLEST, Array
from fpk.numeric.errors import NotApplicable
from fpk.numeric.quadrature import panel_rule
from fpk.solvers.line.mesh import DEEP_LAYERS, Probe, initial_nodes, probe_process, with_layers
from fpk.system.equivalent import equivalent_temperature
from fpk.system.process import Coefficients, Process
from fpk.system.system import System


def damping_and_noise(system: System) -> tuple[float, float]:
    """Return Σ c_ii/m_i of constant damping, 1/time, and Σ (f D fᵀ)_ii/m_i, energy/time."""
    damping, noise = system.damping.diagonal(), system.noise_matrix.diagonal()
    return float(damping @ (1.0 / system.mass)), float(noise @ (1.0 / system.mass))


def damping_by_energy(system: System) -> Array | None:
    """Return the symmetric part of the damping matrix, (powers, n, n) coefficients of H^0, H^1, …

    None if it depends on q or v. An antisymmetric part that depends on q alone does no work and is
    omitted.
    """
    parts: dict[Any, Array] = defaultdict(lambda: np.zeros((system.n, system.n)))
    parts[(), (), 0] += system.damping
    for t in system.damping_terms:
        parts[t.q, t.v, t.energy][t.row, t.column] += t.coefficient
    if any(v or (q and np.any(c + c.T)) for (q, v, _), c in parts.items()):
        return None
    matrices = np.zeros((1 + max(power for _, _, power in parts), system.n, system.n))
    for (q, _, power), c in parts.items():
        if not q:
            matrices[power] = 0.5 * (c + c.T)
    return matrices


def compatibility(system: System) -> Array:
    """Return h(H) of the compatibility condition (8), ``2 c_ij = h b_ij`` with ``b = 2 f D fᵀ``.

    The result holds the coefficients of H^0, H^1, …; with constant damping there is one. The
    antisymmetric part of c does no work and is omitted, unless it depends on velocities. Raises
    ``NotApplicable`` if no h meets the condition, if h is not positive at high energy, and without
    noise or damping.
    """
    D = system.noise_matrix
    if not np.any(D):
        raise NotApplicable("condition (8) needs noise, and there is none")
    matrices = damping_by_energy(system)
    if matrices is None:
        raise NotApplicable(
            "the compatibility condition (8) is not met: the damping depends on q or v beside H"
        )
    if not np.any(matrices):
        raise NotApplicable("nothing is damped: (8) holds with h = 0 only, no stationary density")
    h: Array = np.einsum("eij,ij->e", matrices, D) / np.sum(D * D)
    sizes = np.maximum(np.max(np.abs(matrices), axis=(1, 2)), SMALLEST)
    worst = float(np.max(np.max(np.abs(matrices - h[:, None, None] * D), axis=(1, 2)) / sizes))
    h = np.asarray(np.trim_zeros(h, "b"), dtype=float)
    if not h.size or h[-1] <= 0 or worst > ROUND_OFF:
        best = ", ".join(f"{part:.4g}" for part in h) or "0"
        raise NotApplicable(
            "the compatibility condition (8), c_ij = h (f D fᵀ)_ij for all i, j, is not met: "
            f"even with the best h = {best}, an entry is off by {worst:.2g} of the largest damping"
        )
    return h


def energy_process(system: System) -> Process:
    """Return the averaged energy process dH = s dt + σ dB of ``system``, Eqs. (9), (10), (24)-(28).

    With the microcanonical temperature τ(H) = Φ/T, Φ the phase volume and T = Φ' the density of
    states, the averages of (10) are ⟨v_i v_j⟩ = δ_ij τ/m_i, so that
    ``s = −Σ(c_ii/m_i) τ + Σ D_ii/m_i`` and ``σ² = 2 Σ(D_ii/m_i) τ`` for any number of masses.
    Damping that depends on the state adds −⟨c_ij(q, v) v_i v_j⟩ to s.
    Corrections: (10) prints the noise terms D f f without the factors ∂²H/∂p_i∂p_j and v_i v_j;
    (28) prints the damping term of s with a plus sign; (25)-(29) hold for unit masses only.

    Drift and diffusion at two energies::

        averaged = energy_process(system).coefficients(np.array([0.1, 0.5]))
        averaged.drift, averaged.diffusion

    Raises ``NotApplicable`` if noise or damping vanishes, or if the damping terms do not outweigh
    the noise at high energy: then there is no stationary density.
    """
    (damping, noise), n = damping_and_noise(system), system.n
    if noise <= 0:
        raise NotApplicable("no noise reaches a mass, so the energy has no stationary density")
    if damping <= 0 and not system.damping_terms:
        raise NotApplicable("nothing is damped, so the energy grows for ever")
    # Scale of the mean energy: n times the temperature, with damping terms the equivalent one.
    terms = system.damping_terms
    scale = n * (equivalent_temperature(system) if terms else noise / damping)

    def coefficients(energy: Array) -> Coefficients:
        shell = shell_averages(system, energy)
        tau = energy / n * shell.volume / shell.states
        dissipation, error = -damping * tau, shell.error
        if system.damping_terms:
            # The error of the constant part is the relative error of τ. The total is relative to
            # the parts of s, |dissipation| + noise, as the terms may cancel the constant part.
            constant = np.abs(dissipation) * (error + EPS)
            dissipation = dissipation - shell.power
            error = error + (shell.power_error + constant) / (np.abs(dissipation) + noise)
        return Coefficients(
            drift=noise + dissipation,
            diffusion=2.0 * noise * tau,
            divergence=2.0 * noise * (1.0 - tau * shell.log_slope / energy),
            dissipation=dissipation,
            log_density_of_states=np.log(shell.states) + (n - 1) * (np.log(energy) - np.log(scale)),
            relative_error=error,
        )

    return Process(
        coefficients=coefficients,
        energy_scales=(scale,),
        nonsmooth=system.fact(EnergyShell).contact_energies,
        degrees_of_freedom=n,
        state_damping=bool(system.damping_terms),
    )


def exponential_density(
    process: Process,
    rate: Array,
    *,
    norm: tuple[float, float] | None = None,
    reach: tuple[float, float, float] | None = None,
    residual: float | None = None,
) -> ZeroFluxDensity:
    """Return p(H) = C T exp(−∫_0^H h dH) with h(H) = Σ_e rate_e H^e, T of ``process``.

    ``rate`` (powers,) are the coefficients of h. ``norm`` is ln C and its error; None: computed by
    quadrature. ``reach`` is the first and the last energy and a bound of the probability outside;
    None: 0 and the end found by a probe of the process. ``residual`` is the relative residual of
    the equation that p solves; None: the residual of zero flux, evaluated here.
    """
    if reach is None:
        probe = probe_process(process)
        begin, end = 0.0, probe.extent(exp(-DEPTH))
    else:
        begin, end, tail = reach
        probe = Probe(np.array([0.0, end]), np.full(2, -rate[0]), np.full(2, rate[0]))
    nodes = initial_nodes(probe, end, process.nonsmooth)
    nodes = nodes[np.searchsorted(nodes, begin, side="right") - 1 :]
    exponent: Array = np.asarray(polynomial.polyint(-rate), dtype=float)
    if norm is None:
        # −ln ∫T exp(Σ exponent_e H^e) dH; its error includes the error of T and the round-off.
        panels, norms = with_layers(nodes, process.nonsmooth, count=DEEP_LAYERS), []
        for points in ENERGY_RULES:
            energy, weights = (part.ravel() for part in panel_rule(panels, points))
            c = process.coefficients(energy)
            terms = c.log_density_of_states + polynomial.polyval(energy, exponent)
            top = float(terms.max())
            shares = weights * np.exp(terms - top)
            norms.append(-top - float(np.log(shares.sum())))
        relative = (c.relative_error + _round_off(exponent, energy)) @ shares / shares.sum()
        rounding = 4.0 * EPS * (1.0 + abs(norms[1]))
        norm = norms[1], abs(norms[1] - norms[0]) + float(relative) + rounding
    exponent[0], error = norm
    p = ZeroFluxDensity(
        process,
        nodes,
        lambda energy: np.asarray(polynomial.polyval(energy, exponent)),
        lambda energy: error + _round_off(exponent, energy),
        Measured(error, np.nan, np.nan, np.nan, np.nan),
    )
    if residual is None:
        residual = flux_residual(process, nodes, p.log_density)
    if reach is None:
        tail = probe.tail_bound(end, float(p.density(nodes[-1:])[0]))
    return replace(p, measured=Measured(error + 2.0 * tail, np.nan, np.nan, residual, tail))


def _round_off(exponent: Array, energy: Array) -> Array:
    """Return a bound, 2 ε Σ_e |a_e H^e|, of the round-off of the polynomial Σ_e a_e H^e.

    a (powers,) is ``exponent``, H ``energy`` of any shape, which is the shape of the result.
    """
    return np.asarray(2.0 * EPS * polynomial.polyval(np.abs(energy), np.abs(exponent)))


def state_closed_form(
    system: System, rate: Array, *, residual: float | None = None
) -> StateDensity:
    """Return u = C exp(−∫_0^H h dH) of the full state, h(H) = Σ_e rate_e H^e, Eqs. (7), (22), (29).

    If ``rate`` has one entry, 1/C is the configuration integral; otherwise it is an integral over
    the energy shells. ∫u(H) dq dp is 1. ``residual``: see ``exponential_density``.
    """
    process = system.fact(energy_process)
    if rate.size > 1:
        return density_by_tables(
            system, exponential_density(process, rate, residual=residual), closed=True
        )
    alpha, unit = float(rate[0]), process.energy_scale
    log_norm, error = log_gibbs_norm(system, alpha)
    norm = log_norm + float(log_linear_states(system, unit)), error
    exponent = np.array([norm[0], -alpha])

    def weyl(order: float, energy: Array, part: Part = "value") -> Array:
        """Return Ψ_ν = u/α^ν at ``energy``, its absolute error for "error", 0 for "table"."""
        relative = error + _round_off(exponent, energy)
        factor = {"value": 1.0, "error": relative, "table": 0.0}[part]
        log_u = polynomial.polyval(energy, exponent) - order * np.log(alpha)
        return np.asarray(factor * np.exp(log_u))

    # Contact lowers T: T exp(−αH) is below the gamma density of the chain without contact.
    ratio = float(np.exp(log_gibbs_norm(replace(system, contacts=()), alpha)[0] - log_norm))
    beyond = max(exp(-DEPTH) * ratio, SMALLEST)
    begin, end = (float(inv(system.n, beyond)) / alpha for inv in (gammaincinv, gammainccinv))
    tail = 2.0 * beyond / max(ratio, SMALLEST)
    # Without a given residual: that of the flux, T τ (noise α − damping) u, over one of its parts.
    damping, noise = damping_and_noise(system)
    left = abs(noise * alpha - damping) / damping if residual is None else residual
    measured = Measured(error + 2.0 * tail, np.nan, np.nan, left, tail)
    return StateDensity(
        system,
        partial(
            exponential_density,
            process,
            rate,
            norm=norm,
            reach=(begin, end, tail),
            residual=residual,
        ),
        lambda order: partial(weyl, order),
        1.0 / alpha,
        unit,
        end=end,
        measured=measured,
        closed=True,
        gibbs=True,
    )


def log_gibbs_norm(system: System, alpha: float) -> tuple[float, float]:
    """Return −ln ∫exp(−αH) dq dp over all displacements and momenta, and its absolute error.

    ``alpha`` α is 1/energy. All factors are Gaussian integrals except the integral over the contact
    displacements, by ``gibbs_integral``.
    """
    rules = HIDDEN_RULES[-1 if len(system.contact_masses) > 2 else 1]
    (coarse, _), (fine, interpolation) = (
        gibbs_integral(system, (), np.zeros((0, 1)), temperature=1.0 / alpha, points=points)
        for points in rules
    )
    log_norm = system.n * np.log(alpha / (2.0 * np.pi)) - float(np.log(fine[0]))
    log_norm += 0.5 * float(np.sum(np.log(system.stiffness / system.mass)))
    # Round-off of the exponent log_norm − αH; the mean of αH is at most n.
    round_off = EPS * (system.n + abs(log_norm))
    rule = (np.abs(fine - coarse)[0] + interpolation) / fine[0]
    return log_norm, float(rule) + round_off


def rate_by_energy(system: System) -> Array:
    """Return α(H) = Σ c_ii(H)/m_i / Σ D_ii/m_i, coefficients in ascending powers of H, Eq. (11).

    With u = p/T, zero flux in (24) is u' = −α(H) u. Raises ``NotApplicable`` if a damping term
    depends on displacements or velocities: its average is then no polynomial times τ.
    """
    matrices = damping_by_energy(system)
    if matrices is None:
        raise NotApplicable(
            "damping that depends on q or v leaves (11) without a closed form; "
            "the solvers fem and quadrature evaluate it"
        )
    damping = np.diagonal(matrices, axis1=1, axis2=2) @ (1.0 / system.mass)
    return np.asarray(damping / damping_and_noise(system)[1])


def closed_form_density(system: System) -> Solution:
    """Return p(H) = C T exp(−∫_0^H α dH), the stationary (29) for any masses and for damping c(H).

    ``rate_by_energy`` gives α, and raises ``NotApplicable`` for damping that depends on q or v.
    """
    return state_closed_form(system, rate_by_energy(system)).solution
