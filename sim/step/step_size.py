"""Time scales: the steps of contacts and of periods, the relaxation; and how far motions get."""

from collections.abc import Sequence
from dataclasses import replace
from math import exp, inf, isfinite, lgamma, log, pi, sqrt
from typing import Any

import numpy as np
import scipy  # its parts are loaded at their first use: scipy.optimize takes long to import

from fpk.answer.names import Observable
from fpk.numeric.arrays import ROUND_OFF, Array
from fpk.system.damping import gaussian_moment
from fpk.system.equivalent import damping_balance, equivalent_temperature
from fpk.system.linear import decay_time, drift_matrix, natural_modes
from fpk.system.system import System
from sim.step.schemes import Scheme

REACHED = 5.0
"""Potential energy, in units of kT, for which the step resolves the contact (``chosen_step``)."""

BEYOND_BALANCE = 1.5
"""Energy for which the step must be stable with damping terms, in units of the highest energy at
which damping and noise balance. kT would not do: the density may have a second maximum far
above."""

STEP_PER_FREQUENCY = 0.45
"""Largest product of the step and the angular frequency in contact, springs included. The bias is
of fourth order in the step: beside a sampling error of 3e-4 of the L1 norm of p(q2) (B = 1 and 10)
it is visible at 0.65 and not at 0.45."""

STEP_WITH_TERMS = 0.22
"""Largest product of the step and the angular frequency in contact, springs included, for a system
with damping terms. Their bias near a stop is of second order in the step; at this step it is 1e-3
of the kinetic balance of the mass."""

STEP_PER_RATE = 0.1
"""Largest product of step and rate of the damping terms (``chosen_step``). Between steps the
displacement of a first passage then leaves the cubic by (√3/8) 0.1^1.5 = 0.7 % of its standard
deviation (``sim.questions.limits``, rates of the limit and of the amplitudes)."""

BIAS = 0.02
"""Relative bias of p(q) at a stop in units of X^e (``step_for``). Measured at 1 and 1.8 times the
step of ``STEP_PER_FREQUENCY``: 0.017 to 0.018 for bilinear stops, 0.012 to 0.017 for Hertz
stops."""

JOINT_BIAS = 0.1
"""Relative bias of a joint density at a stop in units of X (``step_for``). Measured at X = 0.1:
0.06 for Hertz stops, 0.10 for bilinear stops. The trapezoidal rule across the kink of the force
gives (sup |B₂|/2) max(u² e^(−u²/4)) = 0.12, B₂ Bernoulli's polynomial, v = u √(kT/m)."""

CHANCE = exp(-100.0)
"""Probability that a state of a stable trajectory exceeds ``largest_reached``. Even if a density
that is not Gibbs' falls by e^−30 only, none of 1e13 states exceeds it by chance."""

STEP_SECONDS, SAMPLE_SECONDS = 5e-9, 4e-8
"""Wall time in s, to a factor 2, that one thread needs for a step of three masses, for a sample."""


def temperature(system: System) -> float:
    """Return kT = Σ(N_ii/m_i) / Σ(c_ii/m_i), N = f D fᵀ; inf without damping.

    With damping terms it is the ``equivalent_temperature``; raises ``NotApplicable`` then without
    noise, and if damping never balances it.
    """
    if system.damping_terms:
        return equivalent_temperature(system)
    noise = float(np.sum(np.diag(system.noise_matrix) / system.mass))
    loss = float(np.sum(np.diag(system.damping) / system.mass))
    return noise / loss if loss > 0 else inf


def contact_frequency(
    system: System, *, springs: bool = False, energy: float = 0.0, kT: float | None = None
) -> float:
    """Return the largest angular frequency in contact √(g'/m) of a mass; 0 if none reaches a stop.

    With ``springs`` it is √((g' + K_ii)/m_i). A mass that moves alone, the others following
    statically, has the potential ``½ k_eff q² + U(q)``. It is taken to reach the largest of
    ``REACHED`` kT, of one kT of contact energy, and of ``energy``. ``kT`` None: ``temperature``; an
    infinite kT counts as 0.
    """
    square, kT = 0.0, temperature(system) if kT is None else kT
    kT = kT if isfinite(kT) else 0.0  # undamped motion: ``energy`` alone counts

    def excess(q: float, i: int, sign: float, k_eff: float, level: float) -> float:
        return 0.5 * k_eff * q * q + float(system.contact_energy(i, sign * q)) - level

    for stop in system.stops:
        i, k_eff = stop.index, 1.0 / system.compliance[stop.index, stop.index]
        level = max(REACHED * kT, 0.5 * k_eff * stop.clearance**2 + kT, energy)
        most = sqrt(2.0 * level / k_eff) * (1.0 + 1e-9)
        q = scipy.optimize.brentq(excess, 0.0, most, args=(i, stop.sign, k_eff, level))
        same = (s for s in system.stops if (s.index, s.side) == (i, stop.side))
        slope = sum(float(s.slope(q - s.clearance)) for s in same if q > s.clearance)
        if slope > 0.0:
            whole = slope + springs * system.stiffness_matrix[i, i]
            square = max(square, float(whole / system.mass[i]))
    return sqrt(square)


def highest_frequency(system: System) -> float:
    """Return the highest natural frequency without contact, in rad per unit time."""
    return float(natural_modes(system)[1][-1])


def sampling_interval(system: System) -> float:
    """Return the time between two samples: 1/8 of the shortest natural period."""
    return 2.0 * pi / highest_frequency(system) / 8.0


def chosen_step(system: System, *, energy: float = 0.0, kT: float | None = None) -> float:
    """Return the longest step of ``exact_flow`` with a small bias, at most the sampling interval.

    Stops limit it by ``contact_frequency`` for ``energy`` and ``kT``. Damping terms need it short
    beside the natural periods and beside their largest rate of a mass, Σ (1 + power of v_i) |c̃_ij|
    v_j/(m_i v_i), each coordinate and H having the energy ``REACHED`` kT or ``BEYOND_BALANCE``.
    """
    frequency = contact_frequency(system, springs=True, energy=energy, kT=kT)
    steps, share = [sampling_interval(system)], STEP_PER_FREQUENCY
    if system.damping_terms:
        level = BEYOND_BALANCE * system.fact(damping_balance).energy
        level = max(REACHED * temperature(system), level)
        q, v = np.sqrt(2.0 * level * np.diag(system.compliance)), np.sqrt(2.0 * level / system.mass)
        rates = np.zeros(system.n)
        for term in system.damping_terms:
            power = 1 + term.powers("v", system.n)[term.row]
            size = abs(float(term.value(q, v, level))) * v[term.column] / v[term.row]
            rates[term.row] += power * size / system.mass[term.row]
        steps += STEP_PER_RATE / float(np.max(rates)), share / highest_frequency(system)
        share = STEP_WITH_TERMS
    return min(*steps, share / frequency) if frequency > 0.0 else min(steps)


def step_for(
    system: System, error: float, *, kT: float | None = None, observables: Sequence[Observable] = ()
) -> float:
    """Return the step, up to ``chosen_step``, whose relative bias at the stops is ``error``/3.

    ``error`` is the relative error that p shall have near its maximum, ``kT`` None:
    ``temperature``. Within v h of a stop, v the thermal velocity, the force is not smooth over a
    step: for a force ``B x^e`` the relative bias of p(q) there is ``BIAS X^e``, ``X = h² e B (v
    h)^(e−1)/m`` the square of the phase that the contact adds in a step. In a density of q and p,
    or of q or p and an energy, the biases of v and −v do not cancel: it is ``JOINT_BIAS X``, which
    counts if ``observables`` contain such a density. At stops that are reached less often a larger
    error is allowed, up to a third of p itself.
    """
    kT = temperature(system) if kT is None else kT
    steps, joint = [chosen_step(system, kT=kT)], set[int | None]()
    for observable in observables:
        rows = {c.row for c in observable if c.kind != "H"}
        if len({c.kind for c in observable}) == 2 and len(rows) == 1:
            joint |= rows
    for stop in system.stops:
        m, k_eff = float(system.mass[stop.index]), 1.0 / system.compliance[stop.index, stop.index]
        rarity = min(0.25 * k_eff * stop.clearance**2 / kT, -log(error))
        known = error * exp(rarity) / 3.0
        square = (known / BIAS) ** (1.0 / stop.power)
        if stop.index in joint:
            square = min(square, known / JOINT_BIAS)
        slope = stop.power * stop.stiffness * sqrt(kT / m) ** (stop.power - 1.0)
        steps.append((square * m / slope) ** (1.0 / (stop.power + 1.0)))
    return min(steps)


def relative_sampling_error(samples: float) -> float:
    """Return the expected relative sampling error of p(q) near its maximum: 7/√``samples``."""
    return 7.0 / sqrt(samples)  # 5.8 to 7.7 in runs of 1e9 samples


def samples_in(system: System, dt: float, seconds: float) -> float:
    """Return the number of samples, to a factor 2, of one thread in ``seconds`` by steps ``dt``."""
    size = max(1.0, system.n / 3) ** 2  # the linear map is a full matrix
    steps = max(1.0, sampling_interval(system) / dt)
    return seconds / (STEP_SECONDS * size * steps + SAMPLE_SECONDS)


def stability_limit(
    system: System, scheme: Scheme, *, energy: float = 0.0, kT: float | None = None
) -> float:
    """Return the largest stable step 2/ω, ω the ``contact_frequency`` for ``energy`` and ``kT``.

    inf if ω is 0. Springs that kick are part of ω. If the kick is last it is min −2 Re λ/|λ|², λ
    the eigenvalues of the drift out of contact, with constant damping that balances the noise in
    place of damping terms.
    """
    if scheme.kick_first:
        square = contact_frequency(system, energy=energy, kT=kT) ** 2
        square += scheme.springs_kicked * highest_frequency(system) ** 2
        return 2.0 / sqrt(square) if square > 0 else inf
    n, drift = system.n, drift_matrix(system)
    if system.damping_terms:
        power = float(np.sum(np.diag(system.noise_matrix) / system.mass))
        drift[n:, n:] = -np.eye(n) * power / (n * temperature(system))
    roots = np.linalg.eigvals(drift)
    return float(np.min(-2.0 * roots.real / np.abs(roots) ** 2))


def relaxation_time(system: System) -> float:
    """Return the longest decay time of the motion without contact; inf if a mode never decays.

    With damping terms modes are taken to be Gaussian with temperatures θ_m, ``dθ_m/dt = S_m −
    P_m(θ)``, S_m the power of the noise and P_m the power lost to damping; the eigenvalues of ∂P/∂θ
    in equilibrium are decay rates of energies. An equal temperature of all modes gives a second
    estimate, 2n/P'(θ); the longer time is returned. Passages between coexisting states take longer.
    Raises ``NotApplicable`` with damping terms if there is no noise or they never balance it.
    """
    if not system.damping_terms:
        return decay_time(system)
    equivalent_temperature(system)  # raises where damping and noise do not balance
    slope = system.fact(damping_balance).slope
    times = [2.0 * system.n / slope if slope > 0 else inf]
    if (balance := modal_temperatures(system)).size:
        slowest = float(natural_modes(system)[1][0])
        # ∂P/∂θ by central differences: a polynomial of low degree, so that 1e-4 costs no digit.
        change = [
            modal_powers(system, balance + h) - modal_powers(system, balance - h)
            for h in np.diag(1e-4 * balance)
        ]
        rates = np.linalg.eigvals(np.transpose(change) / (2e-4 * balance)).real
        if np.all(rates > 0):
            # x'' + rate x' + ω² x = 0 decays in 2/rate; if overdamped, in (rate/2 + √…)/ω².
            creep = np.sqrt(np.maximum((0.5 * rates) ** 2 - slowest**2, 0.0))
            creeping = (0.5 * rates + creep) / slowest**2
            times += np.where(0.5 * rates > slowest, creeping, 2.0 / rates).tolist()
    return max(filter(isfinite, times), default=inf)


def modal_temperatures(system: System) -> Array:
    """Return the equilibrium temperatures θ (n,) of ``relaxation_time``; empty if none is found."""
    shapes, _ = natural_modes(system)
    noise = np.einsum("im,ij,jm->m", shapes, system.noise_matrix, shapes)
    start = np.full(system.n, equivalent_temperature(system))
    root: Any = scipy.optimize.root  # the stubs want a function of a fixed shape
    balance: Any = root(lambda theta: noise - modal_powers(system, theta), start)
    return np.asarray(balance.x if balance.success and np.all(balance.x > 0) else [])


def modal_powers(system: System, temperatures: Array) -> Array:
    """Return the mean power (n,) that each mode loses to damping, E P_m (Tᵀ c M⁻¹ p)_m.

    Modes are independent Gaussians of ``temperatures`` (n,). H^e of a term is replaced by E H^e of
    the Gibbs density of the same mean temperature.
    """
    n, (shapes, omega) = system.n, natural_modes(system)
    displacements = (shapes * (temperatures / omega**2)) @ shapes.T
    velocities = (shapes * temperatures) @ shapes.T
    force = system.damping @ velocities  # E (c v)_i v_r
    power = np.einsum("im,ir,r,rm->m", shapes, force, system.mass, shapes)
    mean = float(np.mean(np.abs(temperatures)))
    for term in system.damping_terms:
        level = mean**term.energy * exp(lgamma(n + term.energy) - lgamma(n))
        q = gaussian_moment(displacements, term.powers("q", n))
        for r in range(n):
            v = list(term.powers("v", n))
            v[term.column] += 1
            v[r] += 1
            moment = term.coefficient * level * q * gaussian_moment(velocities, tuple(v))
            power = power + shapes[term.row] * moment * system.mass[r] * shapes[r]
    return np.asarray(power)


def has_undamped_mode(system: System) -> bool:
    """Return whether there is a mode that neither constant damping nor any damping term acts on."""
    shapes, omega = natural_modes(system)
    has_damping = np.abs(np.diag(shapes.T @ system.damping @ shapes)) > ROUND_OFF * omega[-1]
    size = np.abs(shapes) * np.sqrt(system.mass)[:, None]  # at most 1
    for term in system.damping_terms:
        has_damping |= size[term.row] * size[term.column] > ROUND_OFF
    return not bool(np.all(has_damping))


def loudest(system: System) -> System:
    """Return a system with constant noise of intensity max e(t)² D; ``system`` itself without e."""
    if system.modulation is None:
        return system
    most = system.modulation.largest * system.noise_intensity
    return replace(system, noise_intensity=most, modulation=None)


def hottest(system: System) -> float:
    """Return the least T with vᵀ N v <= T vᵀ c v for all v; inf if noise acts on undamped v.

    With damping terms it is the largest ``modal_temperatures``, or ``temperature`` if larger.
    """
    if system.damping_terms:
        return float(max(temperature(system), *modal_temperatures(system)))
    rates, v = np.linalg.eigh(0.5 * (system.damping + system.damping.T))
    noise = v.T @ system.noise_matrix @ v
    damped = rates > ROUND_OFF * rates[-1]
    if np.any(np.diag(noise)[~damped] > 0.0):
        return inf
    roots = np.sqrt(rates[damped])
    ratios = np.linalg.eigvalsh(noise[damped][:, damped] / np.outer(roots, roots))
    return float(np.max(ratios, initial=0.0))  # 0 without damping and noise


def largest_reached(system: System, energy: float, time: float) -> Array:
    """Return bounds of |q| and |p| (2n,) at the ``time`` after a start with up to ``energy``.

    Free motion and motion by the noise add up. The latter has 2n normal coordinates in units of √T:
    T is ``hottest`` or, if less, twice the energy that the noise has brought by then. Stops only
    make displacements smaller. A state exceeds the bounds with the probability ``CHANCE``. The
    noise counts as constant: of a system with ``modulation`` pass ``loudest``.
    """
    T = system.fact(hottest)
    if system.damping_terms:
        energy = max(energy, BEYOND_BALANCE * system.fact(damping_balance).energy)
    else:
        T = min(T, 2.0 * time * float(np.sum(np.diag(system.noise_matrix) / system.mass)))
    # Twice √energy: a stable kick conserves ½p² + ½(1 − h²ω²/4) ω²q², which is a quarter of H or
    # more up to hω = √3; the largest stable hω is 2.
    root = 2.0 * sqrt(energy) + sqrt(T * float(scipy.special.gammainccinv(system.n, CHANCE)))
    return root * np.sqrt(2.0 * np.concatenate([np.diag(system.compliance), system.mass]))
