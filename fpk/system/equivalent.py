"""The state in which damping that depends on the state balances the noise, with stops or without.

A scale for meshes, ranges and steps: no answer rests on it.
"""

from collections import defaultdict
from itertools import product
from math import comb, exp, lgamma, prod, sqrt
from typing import Any, NamedTuple

import numpy as np
import scipy  # its parts are loaded at their first use: scipy.optimize takes long to import

from fpk.numeric.arrays import ROUND_OFF, Array
from fpk.numeric.errors import NotApplicable
from fpk.numeric.quadrature import gauss_legendre
from fpk.system.damping import DampingTerm, gaussian_moment
from fpk.system.system import System

SEARCHED = 2.0 ** np.arange(-2.0, 54.0)
"""Temperatures searched, in units of one at which the sizes of all damping powers balance the
noise: up to 1e16 of it, as energies in ``fpk.system.ends.FAR_OUT``."""
DEEP = 40.0
"""Energy of a contact mass, in kT, beyond which its Gibbs density is left out: 4e-18 of it."""
POINTS = {1: 64, 2: 64, 3: 32, 4: 16}
"""Gauss points for each of one to four contact masses, 65536 in all at the most: three digits."""
KEPT = 2**11
"""Points of five and more contact masses: moments to 2 % of up to thirty masses."""
QUADRATURE = 1e-9
"""A power below this share of the terms that cancel in it counts as zero: what quadrature leaves
where terms of one contact mass cancel exactly is 1e-12."""
GROWS = "the damping does not balance the noise, so the energy grows for ever"
"""Message where no state balances."""


class Balance(NamedTuple):
    """The last state at which damping and noise balance; with stops to some per cent.

    ``temperature`` is that of a Gibbs state, in which the power of the damping has the ``slope``
    dP/dθ there; ``energy`` that of a shell. 0 where there is none.
    """

    temperature: float
    slope: float
    energy: float


def equivalent_temperature(system: System) -> float:
    """Return the θ at which E Σ c_ij v_i v_j = Σ (f D fᵀ)_ii/m_i in the Gibbs state exp(−H/θ).

    Of several roots it is the largest, where the damping takes over for good. With constant damping
    it is Σ D_ii/m_i / Σ c_ii/m_i.

    Raises ``NotApplicable`` where no noise reaches a mass, or the damping never balances it.
    """
    if not np.any(np.diag(system.noise_matrix) > 0.0):
        raise NotApplicable("no noise reaches a mass, so the energy has no stationary density")
    temperature = system.fact(damping_balance).temperature
    if temperature <= 0.0:
        raise NotApplicable(GROWS)
    return temperature


def damping_balance(system: System) -> Balance:
    """Return the last balance of Σ c_ij v_i v_j and the noise as the energy grows.

    Without stops, or with constant damping, it is a polynomial in θ, and a term of the power θ^k in
    the Gibbs state has H^k Γ(n)/Γ(n + k) on the shell of energy H. With two humps of the energy the
    upper one lies there, far above θ.

    With stops E is over the Gibbs state exp(−H/θ) of the chain with its stops. Where
    Z E X ~ θ^a, Z the partition function, E H^e X is θ^e E X Γ(a + e)/Γ(a); where Z ~ θ^ν and
    E X ~ θ^k, X is E X ν^k Γ(ν)/Γ(ν + k) on the shell of energy ν θ. Both are exact far out, where
    all are powers. Raises ``NotApplicable`` where the damping does not outweigh the noise there.
    """
    noise = float(np.sum(np.diag(system.noise_matrix) / system.mass))
    constant = float(np.sum(np.diag(system.damping) / system.mass))
    if not (system.damping_terms and system.contact_masses):
        return _polynomial_balance(system, constant, noise)
    theta = _temperature_of_sizes(system, abs(constant), noise) * SEARCHED
    log_theta, states = np.log(theta), [_contact_states(system, float(t)) for t in theta]
    order = system.n + np.gradient(np.log([weights.sum() for _, weights in states]), log_theta)
    gibbs, shell = constant * theta, constant * theta
    size = np.abs(gibbs)
    alike: dict[Any, list[DampingTerm]] = defaultdict(list)
    for term in system.damping_terms:
        alike[term.q, term.velocities(system.n), term.energy].append(term)

    def gamma_ratio(a: Array, k: Array | float) -> Array:
        """Γ(a + k)/Γ(a)."""
        return np.asarray(np.exp(scipy.special.gammaln(a + k) - scipy.special.gammaln(a)))

    for (_, _, degree), terms in alike.items():
        means = [
            sum(np.array(_mean_power(system, term, t, *s, system.compliance)) for term in terms)
            for t, s in zip(theta.tolist(), states, strict=True)
        ]
        mean, absolute = np.array(means, dtype=float).T
        acts = np.abs(mean) > QUADRATURE * absolute
        logs = np.log(np.where(acts, np.abs(mean), 1.0))
        power = np.where(acts, np.maximum(np.gradient(logs, log_theta), 0.0), 0.0)
        factor = theta**degree * gamma_ratio(order + power, float(degree))
        power = power + degree
        gibbs, size = gibbs + factor * mean, size + factor * np.where(acts, absolute, 0.0)
        shell = shell + factor * mean * order**power / gamma_ratio(order, power)
    if not gibbs[-1] > max(noise, QUADRATURE * size[-1]):
        raise NotApplicable(GROWS)

    def last_root(x: Array, share: Array) -> float:
        """The last x at which ``share``, a power law between two of them, rises through one."""
        below = np.flatnonzero(share <= 1.0)
        if not below.size or below[-1] == x.size - 1:
            return float(x[0] if not below.size else x[-1])
        k = below[-1]
        low, high = np.log(share[k : k + 2]) if share[k] > 0.0 else share[k : k + 2] - 1.0
        return float(x[k] - (x[k + 1] - x[k]) * low / (high - low))

    at = last_root(log_theta, gibbs / noise)
    slope = float(np.interp(at, log_theta, np.gradient(gibbs, theta)))
    return Balance(exp(at), slope, exp(last_root(np.log(order * theta), shell / noise)))


def _polynomial_balance(system: System, constant: float, noise: float) -> Balance:
    """``damping_balance`` without stops: of the coefficients of ascending powers of θ."""
    n, none = system.n, (np.zeros((0, 1)), np.ones(1))
    power = np.zeros(2 + max((term.degree // 2 for term in system.damping_terms), default=0))
    power[1] = constant
    size = np.abs(power)
    # Not ``system.compliance``: it differs in the last bit, and so would the states from which a
    # simulation with damping terms starts, which stay bitwise the same from version to version.
    compliance: Array = np.asarray(np.linalg.inv(system.stiffness_matrix), dtype=float)
    for term in system.damping_terms:
        # H is independent of the direction of (q, v): E H^(e + d/2) over E H^(d/2).
        half = n + 0.5 * term.factors
        energies = exp(lgamma(half + term.energy) - lgamma(half))
        part = _mean_power(system, term, 1.0, *none, compliance)[0] * energies
        power[1 + term.degree // 2] += part
        size[1 + term.degree // 2] += abs(part)
    power[np.abs(power) <= ROUND_OFF * size] = 0.0
    power = np.trim_zeros(power, "b") if np.any(power) else power[:2]

    def largest_root(coefficients: Any) -> float:
        """The largest real root of Σ_k coefficients_k x^k = noise, 0 where there is none."""
        roots = np.roots([*coefficients[:0:-1], -noise])
        return float(max((z.real for z in roots if abs(z.imag) < 1e-9 * abs(z)), default=0.0))

    temperature = max(largest_root(power), 0.0) if power[-1] >= 0.0 else 0.0
    shell = [c * exp(lgamma(n) - lgamma(n + k)) for k, c in enumerate(power)]
    slope = float(np.polynomial.Polynomial(power).deriv()(temperature))
    return Balance(temperature, slope, largest_root(shell))


def _temperature_of_sizes(system: System, constant: float, noise: float) -> float:
    """The θ at which constant θ + Σ √E X² is the noise, X the powers of the chain without stops."""
    sizes = []
    for term in system.damping_terms:
        q, v = term.powers("q", system.n), term.velocities(system.n)
        square = gaussian_moment(system.compliance, tuple(2 * a for a in q))
        square *= gaussian_moment(np.diag(1.0 / system.mass), tuple(2 * a for a in v))
        sizes.append((abs(term.coefficient) * sqrt(square), 1.0 + 0.5 * term.degree))

    def excess(log_theta: float) -> float:
        return sum(s * exp(k * log_theta) for s, k in [(constant, 1.0), *sizes]) - noise

    end = 1.0
    while excess(end) < 0.0 or excess(-end) > 0.0:
        end *= 2.0
    return exp(scipy.optimize.brentq(excess, -end, end))


def _contact_states(system: System, theta: float) -> tuple[Array, Array]:
    """Displacements (masses, points) of the contact masses, and weights (points,), at θ.

    A mass departs from the one before it by the flexibility in between, as far as its stops let it
    go. Of many masses ``KEPT`` points are drawn again after each: the weights of all masses
    together would leave one point in thousands.
    """
    masses, reach = system.contact_masses, sqrt(2.0 * DEEP)
    x, w = gauss_legendre(POINTS.get(len(masses), 16))
    flexibility = np.cumsum(1.0 / system.stiffness)[list(masses)]
    q, weights = np.zeros((0, 1)), np.ones(1)
    for mass, width in zip(masses, np.sqrt(theta * np.diff(flexibility, prepend=0.0)), strict=True):
        mean = q[-1] if q.size else np.zeros(1)
        low, high = mean - reach * width, mean + reach * width
        for stop in system.stops:
            if stop.index == mass:
                end = stop.clearance + stop.overlap_at(DEEP * theta)
                low = np.maximum(low, -end) if stop.sign < 0 else low
                high = np.minimum(high, end) if stop.sign > 0 else high
        half = np.maximum(0.5 * (high - low), 0.0)
        own = (0.5 * (low + high))[:, None] + half[:, None] * x
        normal = (own - mean[:, None]) / width
        energy = system.contact_energy(mass, own) / theta
        density = np.exp(-0.5 * normal**2 - energy) / (sqrt(2.0 * np.pi) * width)
        weights = (weights[:, None] * half[:, None] * w * density).ravel()
        q = np.vstack([np.repeat(q, x.size, axis=1), own.reshape(1, -1)])
        if len(masses) not in POINTS:
            # Fractions of the golden ratio: evenly spread beside the order of the mass before.
            k, total = np.arange(KEPT), np.cumsum(weights)
            kept = np.searchsorted(
                total, (k + k * 0.5 * (sqrt(5.0) - 1.0) % 1.0) / KEPT * total[-1]
            )
            q = q[:, kept[np.argsort(q[-1, kept])]]
            weights = np.full(KEPT, total[-1] / KEPT)
    return q, weights


def _mean_power(
    system: System, term: DampingTerm, theta: float, contact: Array, weights: Array, C: Array
) -> tuple[float, float]:
    """E coefficient Π q Π v v_i v_j at θ without the power of H, and that of its absolute value.

    ``contact`` and ``weights`` as of ``_contact_states``; C (n, n) is the compliance. A mass is at
    its mean given the contact masses, and an independent Gaussian part off.
    """
    masses = list(system.contact_masses) if len(contact) else []
    nodes = [0.0, *np.diag(C)[masses]]  # the mean is linear between them, constant beyond
    each = [np.interp(np.diag(C), nodes, [0.0, *e]) for e in np.eye(len(masses))]
    follow = np.reshape(each, (len(masses), system.n)).T
    spread = theta * (C - follow @ C[masses])
    spread[masses] = spread[:, masses] = 0.0
    mean, powers = follow @ contact, term.powers("q", system.n)
    total, absolute = np.zeros((2, weights.size))
    # Without contact masses all displacements are Gaussian.
    least = (0 if len(contact) else power for power in powers)
    for own in product(*(range(a, b + 1) for a, b in zip(least, powers, strict=True))):
        moment = gaussian_moment(spread, own)
        if moment:
            ways = prod(comb(power, k) for power, k in zip(powers, own, strict=True))
            rest = [power - k for power, k in zip(powers, own, strict=True)]
            part = ways * moment * prod(mean[i] ** r for i, r in enumerate(rest) if r)
            total, absolute = total + part, absolute + np.abs(part)
    v = term.velocities(system.n)
    factor = term.coefficient * gaussian_moment(np.diag(theta / system.mass), v) / weights.sum()
    return factor * float(weights @ total), abs(factor) * float(weights @ absolute)
