"""The temperature at which damping, wherever it depends on the state, balances the noise."""

from collections.abc import Sequence
from math import exp, lgamma

import numpy as np

from fpk.arrays import Array
from fpk.balance import balance_with_stops
from fpk.damping import DampingTerm
from fpk.errors import NotApplicable
from fpk.moments import gaussian_moment
from fpk.system import System

ROUND_OFF = 1e-12
"""A power below this share of the terms that cancel in it is their round-off, so zero."""


def equivalent_temperature(system: System) -> float:
    """Return the θ at which E Σ c_ij v_i v_j = Σ (f D fᵀ)_ii/m_i in the Gibbs state exp(−H/θ).

    Of several roots it is the largest, where the damping takes over for good. With stops and
    damping terms it is that of ``balance_with_stops``; without, the balance is a polynomial in θ.
    With constant damping it is Σ D_ii/m_i / Σ c_ii/m_i. A scale for meshes, ranges and steps: no
    answer rests on it.

    Raises ``NotApplicable`` where no noise reaches a mass, or the damping never balances it.
    """
    noise = float(np.sum(np.diag(system.noise_matrix) / system.mass))
    if noise <= 0:
        raise NotApplicable("no noise reaches a mass, so the energy has no stationary density")
    if stops_matter(system):
        return system.fact(balance_with_stops).temperature
    power = dissipated_power(system)
    temperature = largest_root(power, noise)
    if temperature <= 0 or next(c for c in power[::-1] if c) < 0:
        raise NotApplicable("the damping does not balance the noise, so the energy grows for ever")
    return temperature


def stops_matter(system: System) -> bool:
    """Return whether the balance is that of ``balance_with_stops``."""
    return bool(system.damping_terms and system.contact_masses)


def dissipated_power(system: System) -> Array:
    """Return the coefficients of E Σ c_ij v_i v_j without contacts, ascending powers of θ."""
    power = np.zeros(2 + max((term.degree // 2 for term in system.damping_terms), default=0))
    power[1] = np.sum(np.diag(system.damping) / system.mass)
    size = np.abs(power)
    for term in system.damping_terms:
        part = _mean_power(system, term)
        power[1 + term.degree // 2] += part
        size[1 + term.degree // 2] += abs(part)
    power[np.abs(power) <= ROUND_OFF * size] = 0.0
    return np.trim_zeros(power, "b") if np.any(power) else power[:2]


def balance_energy(system: System) -> float:
    """Return about the last energy at which damping and noise balance on a shell.

    Without stops a term of the power θ^k in the Gibbs state has H^k Γ(n)/Γ(n + k) on the shell of
    energy H. With two humps of the energy the upper one lies there, far above θ. 0 where they never
    balance.
    """
    if stops_matter(system):
        return system.fact(balance_with_stops).energy
    n, noise = system.n, float(np.sum(np.diag(system.noise_matrix) / system.mass))
    shell = [c * exp(lgamma(n) - lgamma(n + k)) for k, c in enumerate(dissipated_power(system))]
    return largest_root(shell, noise)


def largest_root(coefficients: Sequence[float] | Array, value: float) -> float:
    """Return the largest real root of Σ_k coefficients_k x^k = value, 0 where there is none.

    The constant coefficient is 0.
    """
    roots = np.roots([*coefficients[:0:-1], -value])
    return float(max((z.real for z in roots if abs(z.imag) < 1e-9 * abs(z)), default=0.0))


def _mean_power(system: System, term: DampingTerm) -> float:
    """E coefficient Π q Π v H^e v_i v_j at θ = 1; 0 where a power is odd.

    Without the energy it is a Gaussian moment of degree d. H is independent of the direction of
    (q, v), so that the energy brings E H^(e + d/2)/E H^(d/2) = Γ(n + d/2 + e)/Γ(n + d/2).
    """
    n = system.n
    half = 0.5 * term.factors
    velocities = gaussian_moment(np.diag(1.0 / system.mass), term.velocities(n))
    # Not ``system.compliance``: it differs in the last bit, and so would the states from which a
    # simulation with damping terms starts, which stay bitwise the same from version to version.
    compliance: Array = np.asarray(np.linalg.inv(system.stiffness_matrix), dtype=float)
    displacements = gaussian_moment(compliance, term.powers("q", n))
    energies = exp(lgamma(n + half + term.energy) - lgamma(n + half))
    return term.coefficient * velocities * displacements * energies
