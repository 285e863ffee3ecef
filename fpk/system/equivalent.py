"""Mean power of damping terms given the contact displacements, and its balance with the noise.

The balance gives energy scales for meshes, ranges and time steps; no answer depends on its error.
"""

from collections import defaultdict
from collections.abc import Sequence
from itertools import product
from math import comb, exp, lgamma, log, prod, sqrt
from typing import Any, NamedTuple

import numpy as np
import scipy  # its parts are loaded at their first use: scipy.optimize takes long to import

from fpk.numeric.arrays import DEPTH, ROUND_OFF, Array, Integers
from fpk.numeric.errors import NotApplicable
from fpk.numeric.quadrature import gauss_legendre
from fpk.system.damping import DampingTerm, gaussian_moment
from fpk.system.linear import displacements_given
from fpk.system.system import System

SEARCHED = 2.0 ** np.arange(-2.0, 54.0)
"""Temperatures at which the balance is sought, in units of ``_temperature_of_sizes``: up to 1e16
of it, as the energies ``fpk.system.ends.FAR_OUT``."""
MAX_GRID_POINTS = 2**16
"""Largest number of points of the tensor grid over the contact masses, 16 to 64 along each of up
to four: moments to three digits."""
RESAMPLED_POINTS = 2**11
"""Points drawn with five or more contact masses: moments to 2 % for up to thirty masses."""
QUADRATURE = 1e-9
"""A mean power below this share of its cancelling terms counts as zero; where terms of one contact
mass cancel exactly, quadrature leaves 1e-12."""
GROWS = "the damping does not balance the noise, so the energy grows for ever"
"""Message if damping and noise balance at no temperature."""


class Balance(NamedTuple):
    """Highest temperature and energy at which damping dissipates the power of the noise.

    In the Gibbs state exp(−H/θ) the mean dissipated power P balances at θ = ``temperature``, with
    the ``slope`` dP/dθ; the microcanonical mean balances at the ``energy`` H. Without a balance
    ``temperature`` is 0 and the rest has no meaning. With stops the errors are a few per cent.
    """

    temperature: float
    slope: float
    energy: float


def equivalent_temperature(system: System) -> float:
    """Return the θ at which E Σ c_ij v_i v_j = Σ (f D fᵀ)_ii/m_i in the Gibbs state exp(−H/θ).

    It is the largest of several roots, beyond which the damping dominates. With constant damping it
    is Σ (f D fᵀ)_ii/m_i / Σ c_ii/m_i.

    Raises ``NotApplicable`` if no noise reaches a mass, or the damping never balances it.
    """
    if not np.any(np.diag(system.noise_matrix) > 0.0):
        raise NotApplicable("no noise reaches a mass, so the energy has no stationary density")
    temperature = system.fact(damping_balance).temperature
    if temperature <= 0.0:
        raise NotApplicable(GROWS)
    return temperature


def power_given(system: System, terms: Sequence[DampingTerm]) -> tuple[Integers, Array]:
    """Return E Σ c_ij v_i v_j of ``terms`` given the c contact displacements, as a polynomial.

    Momenta and the other displacements are Gaussian at the temperature θ. The power is the sum of
    parts H^energy · C · θ^j · Π q_c^powers. A row of the first array (parts, 2 + c) is (degree,
    order, powers) with order = Σ powers + 2 j and degree = order − 2 + 2 energy; a row of the
    second (parts, 2) is C and the sum of the sizes of the terms of C.
    """
    n, masses = system.n, system.contact_masses
    weights, covariance = displacements_given(system, masses)
    sums: dict[tuple[int, ...], Array] = defaultdict(lambda: np.zeros(2))
    for term in terms:
        q = term.powers("q", n)
        C = term.coefficient * gaussian_moment(np.diag(1.0 / system.mass), term.velocities(n))
        for own in product(*(range(power + 1) for power in q)):  # powers of the Gaussian parts
            left = np.repeat(np.arange(n), np.subtract(q, own))
            moment = C * gaussian_moment(covariance, own) * prod(map(comb, q, own))
            for of_mass in product(*(np.flatnonzero(weights[i]).tolist() for i in left)):
                value = moment * float(np.prod(weights[left, list(of_mass)]))
                powers = map(of_mass.count, range(len(masses)))
                sums[term.degree, term.factors, *powers] += value, abs(value)
    keys = np.array(list(sums), dtype=np.int64).reshape(len(sums), 2 + len(masses))
    return keys, np.array(list(sums.values())).reshape(-1, 2)


def damping_balance(system: System) -> Balance:
    """Return the balance of Σ c_ij v_i v_j and the noise at the highest temperature and energy.

    Without stops, or with constant damping, the mean power is a polynomial in θ, and a term θ^k of
    the Gibbs state is H^k Γ(n)/Γ(n + k) on the energy shell H. With stops local power laws are
    used, which are exact far out: with Z E X ~ θ^a, Z the partition function, E H^e X is
    θ^e E X Γ(a + e)/Γ(a); with Z ~ θ^ν and E X ~ θ^k, X is E X ν^k Γ(ν)/Γ(ν + k) on the shell
    of energy ν θ. Raises ``NotApplicable`` if, with stops and damping terms, the damping does not
    exceed the noise far out.
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
    log_gamma = scipy.special.gammaln
    for (_, _, energy), terms in alike.items():
        keys, values = power_given(system, terms)
        half = 0.5 * (keys[:, 1] - keys[:, 2:].sum(axis=1))
        means = np.zeros((theta.size, 2))  # means of the power without H^energy, and of its size
        for row, t, (q, weights) in zip(means, theta.tolist(), states, strict=True):
            for powers, scaled in zip(keys[:, 2:], values * t ** half[:, None], strict=True):
                part = prod(q[k] ** powers[k] for k in np.flatnonzero(powers)) * weights
                row += scaled * [part.sum(), np.abs(part).sum()] / weights.sum()
        mean, absolute = means.T
        acts = np.abs(mean) > QUADRATURE * absolute
        mean = np.where(acts, mean, 0.0)
        logs = np.log(np.where(acts, np.abs(mean), 1.0))
        power = np.where(acts, np.maximum(np.gradient(logs, log_theta), 0.0), 0.0)
        level = order + power
        factor = theta**energy * np.exp(log_gamma(level + energy) - log_gamma(level))
        power = power + energy
        gibbs, size = gibbs + factor * mean, size + factor * np.where(acts, absolute, 0.0)
        on_shell = np.exp(power * np.log(order) + log_gamma(order) - log_gamma(order + power))
        shell = shell + factor * mean * on_shell
    if not gibbs[-1] > max(noise, QUADRATURE * size[-1]):
        raise NotApplicable(GROWS)
    at = _last_root(log_theta, gibbs / noise)
    slope = float(np.interp(at, log_theta, np.gradient(gibbs, theta)))
    return Balance(exp(at), slope, exp(_last_root(np.log(order * theta), shell / noise)))


def _last_root(x: Array, share: Array) -> float:
    """Return the largest ``x`` at which ``share`` rises through 1, ln ``share`` linear between the
    points; the first x if it is > 1 at all points, the last x if it ends <= 1. Both (points,)."""
    below = np.flatnonzero(share <= 1.0)
    if not below.size or below[-1] == x.size - 1:
        return float(x[0] if not below.size else x[-1])
    k = below[-1]
    low, high = np.log(share[k : k + 2]) if share[k] > 0.0 else share[k : k + 2] - 1.0
    return float(x[k] - (x[k + 1] - x[k]) * low / (high - low))


def _polynomial_balance(system: System, constant: float, noise: float) -> Balance:
    """``damping_balance`` without stops or without damping terms: the power is a polynomial in θ.

    ``constant`` is Σ c_ii/m_i of constant damping, ``noise`` is Σ (f D fᵀ)_ii/m_i.
    """
    # ``power``: its coefficients, of ascending powers of θ.
    n, power = system.n, np.zeros(2 + max((t.degree // 2 for t in system.damping_terms), default=0))
    power[1] = constant
    size = np.abs(power)
    # Not ``system.compliance``: it differs in the last bit, and so would the states from which a
    # simulation with damping terms starts, which stay bitwise the same from version to version.
    compliance: Array = np.asarray(np.linalg.inv(system.stiffness_matrix), dtype=float)
    for term in system.damping_terms:
        moment = gaussian_moment(np.diag(1.0 / system.mass), term.velocities(n))
        part = term.coefficient * moment * gaussian_moment(compliance, term.powers("q", n))
        # H is independent of the direction of (q, v): E H^(e + d/2) over E H^(d/2).
        half = n + 0.5 * term.factors
        part *= exp(lgamma(half + term.energy) - lgamma(half))
        power[1 + term.degree // 2] += part
        size[1 + term.degree // 2] += abs(part)
    power[np.abs(power) <= ROUND_OFF * size] = 0.0
    power = np.trim_zeros(power, "b") if np.any(power) else power[:2]

    def largest_root(coefficients: Sequence[float] | Array) -> float:
        """Largest real root of Σ_k ``coefficients``_k x^k = noise, 0 if there is none."""
        roots = np.roots([*coefficients[:0:-1], -noise])
        return float(max((z.real for z in roots if abs(z.imag) < 1e-9 * abs(z)), default=0.0))

    temperature = max(largest_root(power), 0.0) if power[-1] >= 0.0 else 0.0
    shell = [c * exp(lgamma(n) - lgamma(n + k)) for k, c in enumerate(power)]
    slope = float(np.polynomial.Polynomial(power).deriv()(temperature))
    return Balance(temperature, slope, largest_root(shell))


def _temperature_of_sizes(system: System, constant: float, noise: float) -> float:
    """Return the θ at which ``constant`` θ + Σ √E X² = ``noise``, means over the Gibbs state
    without stops. X is the power c_ij v_i v_j of a damping term with θ in the place of H,
    ``constant`` is |Σ c_ii/m_i| of constant damping, ``noise`` is Σ (f D fᵀ)_ii/m_i."""
    sizes, powers = [constant], [1.0]
    for term in system.damping_terms:
        q, v = term.powers("q", system.n), term.velocities(system.n)
        square = gaussian_moment(system.compliance, tuple(2 * a for a in q))
        square *= gaussian_moment(np.diag(1.0 / system.mass), tuple(2 * a for a in v))
        sizes.append(abs(term.coefficient) * sqrt(square))
        powers.append(1.0 + 0.5 * term.degree)
    size, power = np.array(sizes)[np.array(sizes) > 0.0], np.array(powers)[np.array(sizes) > 0.0]
    # At the root no term exceeds the noise, and the largest of m terms is at least 1/m of it.
    high = np.min((log(noise) - np.log(size)) / power)
    low = np.min((log(noise / size.size) - np.log(size)) / power)

    def excess(log_theta: float) -> float:
        return float(size @ np.exp(power * log_theta)) / noise - 1.0

    return exp(scipy.optimize.brentq(excess, low - 1e-9, high + 1e-9))


def _contact_states(system: System, theta: float) -> tuple[Array, Array]:
    """Displacements (masses, points) of the contact masses and weights (points,) of a Gibbs mean.

    ``theta`` is the temperature. The weights sum to the partition function over its value without
    stops. Along the chain each contact mass is Gaussian about the previous, with the variance θ
    times the flexibility in between, and ends where a stop has the energy ``DEPTH`` θ. With five or
    more contact masses ``RESAMPLED_POINTS`` are drawn by their weights after each mass, as
    otherwise few points carry all of the weight.
    """
    masses, reach = system.contact_masses, sqrt(2.0 * DEPTH)
    on_grid = [points for points in (64, 32, 16) if points ** len(masses) <= MAX_GRID_POINTS]
    x, w = gauss_legendre([*on_grid, 16][0])
    flexibility = np.cumsum(1.0 / system.stiffness)[list(masses)]
    q, weights = np.zeros((0, 1)), np.ones(1)
    for mass, width in zip(masses, np.sqrt(theta * np.diff(flexibility, prepend=0.0)), strict=True):
        mean = q[-1] if q.size else np.zeros(1)
        low, high = mean - reach * width, mean + reach * width
        for stop in system.stops:
            if stop.index == mass:
                end = stop.clearance + stop.overlap_at(DEPTH * theta)
                low = np.maximum(low, -end) if stop.sign < 0 else low
                high = np.minimum(high, end) if stop.sign > 0 else high
        half = np.maximum(0.5 * (high - low), 0.0)
        own = (0.5 * (low + high))[:, None] + half[:, None] * x
        normal = (own - mean[:, None]) / width
        energy = system.contact_energy(mass, own) / theta
        density = np.exp(-0.5 * normal**2 - energy) / (sqrt(2.0 * np.pi) * width)
        weights = (weights[:, None] * half[:, None] * w * density).ravel()
        q = np.vstack([np.repeat(q, x.size, axis=1), own.reshape(1, -1)])
        if not on_grid:
            # Shifts by the golden ratio: low discrepancy together with the order of this mass.
            k, total = np.arange(RESAMPLED_POINTS), np.cumsum(weights)
            share = (k + k * 0.5 * (sqrt(5.0) - 1.0) % 1.0) / RESAMPLED_POINTS
            kept = np.searchsorted(total, share * total[-1])
            q = q[:, kept[np.argsort(q[-1, kept])]]
            weights = np.full(RESAMPLED_POINTS, total[-1] / RESAMPLED_POINTS)
    return q, weights
