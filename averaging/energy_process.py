"""Averaged energy process of a quasi-non-integrable Hamiltonian system, Eqs. (9), (24).

Its closed forms p = C T exp(−∫h dH) where the damping depends on the energy only, (7), (29), (34).
"""

from collections import defaultdict
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from numpy.polynomial import polynomial
from scipy.special import gammainccinv, gammaincinv

from averaging.conditional import RULES, gibbs_integral
from averaging.shell.averages import log_linear_states, shell_averages
from averaging.shell.rays import EnergyShell
from averaging.weyl import Part, Solution, StateDensity, tabulated
from averaging.zero_flux import POINTS, ZeroFluxDensity, flux_residual
from fpk.answer.certificate import Measured
from fpk.numeric.arrays import EPS, ROUND_OFF, SMALLEST, Array
from fpk.numeric.errors import NotApplicable
from fpk.numeric.quadrature import panel_rule
from fpk.solvers.line.mesh import DEEP_LAYERS, Probe, initial_nodes, probe_process, with_layers
from fpk.system.equivalent import equivalent_temperature
from fpk.system.process import Coefficients, Process
from fpk.system.system import System

TAIL = 1e-17
"""Share of the probability beyond the last energy of a closed form."""


def damping_and_noise(system: System) -> tuple[float, float]:
    """Return Σ c_ii/m_i of constant damping, 1/time, and Σ (f D fᵀ)_ii/m_i, energy/time."""
    damping, noise = system.damping.diagonal(), system.noise_matrix.diagonal()
    return float(damping @ (1.0 / system.mass)), float(noise @ (1.0 / system.mass))


def damping_by_energy(system: System) -> Array | None:
    """Return the symmetric part of the damping matrix, coefficients (n, n) of H^0, H^1, …

    None where it depends on q or v, too; c_ij(q) = −c_ji(q) does no work, and is left out.
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

    Coefficients in ascending powers of H, one for constant damping. The antisymmetric part of c
    does no work and does not enter, unless it depends on velocities. Raises ``NotApplicable``
    where no h meets the condition, or h is not positive at high energy.
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
    left = np.max(np.abs(matrices - h[:, None, None] * D), axis=(1, 2)) / sizes
    worst = float(left.max())
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
    Corrections: (10) prints D f f for the noise terms without ∂²H/∂p_i∂p_j and v_i v_j; (28)
    prints the damping term of s with a plus sign; (25)-(29) hold for unit masses only.

    Drift and diffusion at two energies::

        averaged = energy_process(system).coefficients(np.array([0.1, 0.5]))
        averaged.drift, averaged.diffusion

    Raises ``NotApplicable`` where noise or damping vanishes, or damping terms do not outweigh the
    noise at high energy: there is no stationary density then.
    """
    (damping, noise), n = damping_and_noise(system), system.n
    if noise <= 0:
        raise NotApplicable("no noise reaches a mass, so the energy has no stationary density")
    if damping <= 0 and not system.damping_terms:
        raise NotApplicable("nothing is damped, so the energy grows for ever")
    # An energy of the order of the mean: n times the temperature, or where damping takes over.
    terms = system.damping_terms
    scale = n * (equivalent_temperature(system) if terms else noise / damping)

    def coefficients(energy: Array) -> Coefficients:
        shell = shell_averages(system, energy)
        tau = energy / n * shell.volume / shell.states
        dissipation, error = -damping * tau, shell.error
        if system.damping_terms:
            # The constant part is exact relative to τ, whose error is counted already; the error is
            # relative to the parts of s, which is less where the terms cancel the constant part.
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


def closed_form(
    process: Process,
    rate: Array,
    *,
    norm: tuple[float, float] | None = None,
    reach: tuple[float, float, float] | None = None,
    residual: float | None = None,
) -> ZeroFluxDensity:
    """Return C T exp(−∫_0^H h dH) with h(H) = Σ rate_e H^e.

    ``norm`` is ln C and its error, by quadrature where not given; ``reach`` the first and last
    energy and a bound of the probability outside, otherwise 0 and by a probe of the process.
    ``residual`` is that of the equation which p solves; the flux is measured where none is given.
    """
    if reach is None:
        probe = probe_process(process)
        begin, end = 0.0, probe.extent(TAIL)
    else:
        begin, end, tail = reach
        probe = Probe(np.array([0.0, end]), np.full(2, -rate[0]), np.full(2, rate[0]))
    nodes = initial_nodes(probe, end, process.nonsmooth)
    nodes = nodes[np.searchsorted(nodes, begin, side="right") - 1 :]
    exponent: Array = np.asarray(polynomial.polyint(-rate), dtype=float)
    if norm is None:
        # −ln ∫T exp(Σ exponent_e H^e) dH and its error, that of T and round-off included.
        panels, norms = with_layers(nodes, process.nonsmooth, count=DEEP_LAYERS), []
        for points in POINTS:
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
    """Round-off of the exponent, relative to the sum of the absolute values of its terms."""
    return np.asarray(2.0 * EPS * polynomial.polyval(np.abs(energy), np.abs(exponent)))


def state_closed_form(
    system: System, rate: Array, *, residual: float | None = None
) -> StateDensity:
    """Return u = C exp(−∫_0^H h dH) of the full state, h(H) = Σ rate_e H^e, Eqs. (7), (22), (29).

    With a constant h the norm is the configuration integral, otherwise an integral over the shells.
    """
    process = system.fact(energy_process)
    if rate.size > 1:
        return tabulated(system, closed_form(process, rate, residual=residual), closed=True)
    alpha, unit = float(rate[0]), process.energy_scale
    log_norm, error = log_gibbs_norm(system, alpha)
    norm = log_norm + float(log_linear_states(system, unit)), error
    exponent = np.array([norm[0], -alpha])

    def weyl(order: float, energy: Array, part: Part = "value") -> Array:
        """Ψ_ν = u/α^ν."""
        relative = error + _round_off(exponent, energy)
        factor = {"value": 1.0, "error": relative, "table": 0.0}[part]
        log_u = polynomial.polyval(energy, exponent) - order * np.log(alpha)
        return np.asarray(factor * np.exp(log_u))

    # Contact only takes states away: T exp(−αH) is below that of the chain without, a Gamma law.
    ratio = float(np.exp(log_gibbs_norm(replace(system, contacts=()), alpha)[0] - log_norm))
    beyond = max(TAIL * ratio, SMALLEST)
    begin, end = (float(inv(system.n, beyond)) / alpha for inv in (gammaincinv, gammainccinv))
    tail = 2.0 * beyond / max(ratio, SMALLEST)
    # Where none is given it is that of the flux, T τ (noise α − damping) u, whose parts cancel.
    damping, noise = damping_and_noise(system)
    left = abs(noise * alpha - damping) / damping if residual is None else residual
    measured = Measured(error + 2.0 * tail, np.nan, np.nan, left, tail)
    return StateDensity(
        system,
        partial(closed_form, process, rate, norm=norm, reach=(begin, end, tail), residual=residual),
        lambda order: partial(weyl, order),
        1.0 / alpha,
        unit,
        end=end,
        measured=measured,
        closed=True,
        gibbs=True,
    )


def log_gibbs_norm(system: System, alpha: float) -> tuple[float, float]:
    """Return −ln ∫exp(−αH) dq dp over all displacements and momenta, and its error.

    All are Gaussian but for the contact displacements, a pass along the chain.
    """
    rules = RULES[-1 if len(system.contact_masses) > 2 else 1]
    (coarse, _), (fine, interpolation) = (
        gibbs_integral(system, (), np.zeros((0, 1)), temperature=1.0 / alpha, points=points)
        for points in rules
    )
    log_norm = system.n * np.log(alpha / (2.0 * np.pi)) - float(np.log(fine[0]))
    log_norm += 0.5 * float(np.sum(np.log(system.stiffness / system.mass)))
    # The exponent log_norm − αH has a round-off; the mean of αH is n at the most.
    round_off = EPS * (system.n + abs(log_norm))
    rule = (np.abs(fine - coarse)[0] + interpolation) / fine[0]
    return log_norm, float(rule) + round_off


def averaged_rate(system: System) -> Array:
    """Return α(H) = Σ c_ii(H)/m_i / Σ D_ii/m_i, coefficients in ascending powers of H, Eq. (11).

    With u = p/T, zero flux in (24) is u' = −α(H) u. Raises ``NotApplicable`` where a damping term
    depends on displacements or velocities: its average is no polynomial times τ then.
    """
    matrices = damping_by_energy(system)
    if matrices is None:
        raise NotApplicable(
            "damping that depends on q or v leaves (11) without a closed form; "
            "the solvers fem and quadrature evaluate it"
        )
    damping = np.diagonal(matrices, axis1=1, axis2=2) @ (1.0 / system.mass)
    return np.asarray(damping / damping_and_noise(system)[1])


def averaged_density(system: System) -> Solution:
    """Return p(H) = C T exp(−∫α dH): (29), printed for two unit masses, for any and for c(H)."""
    return state_closed_form(system, averaged_rate(system)).solution
