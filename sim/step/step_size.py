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
"""Potential energy, in units of kT, up to which a mass is expected to push into its stop."""

BEYOND_BALANCE = 1.5
"""Energy up to which a step is to be stable, in units of the last at which damping and noise
balance: kT says nothing of the upper of two humps of its density."""

STEP_PER_FREQUENCY = 0.45
"""Step times the frequency in contact, springs included. The bias grows with the fourth power: at
0.65 the L1 of p(q2) shows it beside a sampling error of 3e-4 (B = 1, 10); at 0.45 it does not."""

STEP_WITH_TERMS = 0.22
"""Step times the frequency in contact where damping terms act, too: their bias then grows with the
square of the step, and is 1e-3 of the kinetic balance of a mass that both act on."""

STEP_PER_RATE = 0.1
"""Step times the steepest rate of the damping terms that is reached, see ``chosen_step``."""

BIAS = 0.02
"""Factor of the bias at a stop, see ``step_for``: measured at 1 and 1.8 times the step of
``STEP_PER_FREQUENCY``, 0.017 to 0.018 of bilinear stops and 0.012 to 0.017 of Hertz ones."""

JOINT_BIAS = 0.1
"""Factor of the bias of a joint density at a stop, see ``step_for``: measured 0.06 of Hertz stops
and 0.10 of bilinear ones at X = 0.1. The trapezoidal rule across the kink of the force gives these
(sup |B₂|/2) max(u² e^(−u²/4)) = 0.12, B₂ Bernoulli's polynomial, v = u √(kT/m)."""

CHANCE = exp(-100.0)
"""Probability that a state has more energy. Of 1e13 states one in 1e30 has it by chance; where the
density is not Gibbs', and falls by e^−30 only instead of e^−100, none of them has."""

STEP_SECONDS, SAMPLE_SECONDS = 5e-9, 4e-8
"""Wall time, in s, to a factor 2, of a step of up to three masses and of a sample, by a thread."""


def temperature(system: System) -> float:
    """Return kT = Σ(N_ii/m_i) / Σ(c_ii/m_i), N = f D fᵀ, or ``equivalent_temperature``."""
    if system.damping_terms:
        return equivalent_temperature(system)
    noise = float(np.sum(np.diag(system.noise_matrix) / system.mass))
    loss = float(np.sum(np.diag(system.damping) / system.mass))
    return noise / loss if loss > 0 else inf


def contact_frequency(
    system: System, *, springs: bool = False, energy: float = 0.0, kT: float | None = None
) -> float:
    """Return the largest √(g'/m) that is reached, with ``springs`` √((g' + K_ii)/m_i); 0 if none.

    A mass that moves alone, the others following statically, has the potential
    ``½ k_eff q² + U(q)``. It reaches ``REACHED`` kT, or one kT of contact energy where the stop is
    too far for that, or ``energy`` where that is more. ``kT`` None: the ``temperature``.
    """
    square, kT = 0.0, temperature(system) if kT is None else kT
    kT = kT if isfinite(kT) else 0.0  # of undamped motion ``energy`` alone counts

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
    """Return the time between samples, 1/8 of the shortest natural period: closer ones repeat."""
    return 2.0 * pi / highest_frequency(system) / 8.0


def chosen_step(system: System, *, energy: float = 0.0, kT: float | None = None) -> float:
    """Return the step of ``exact_flow``; of a linear system any is exact: the sampling interval.

    Damping terms need it short beside the natural periods and beside their largest rate of a mass,
    Σ (1 + power of v_i) |c̃_ij| v_j/(m_i v_i) where each coordinate alone, and H, has the energy of
    ``REACHED`` and of ``BEYOND_BALANCE``.
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
    """Return the step, up to ``chosen_step``, whose bias at the stops is a third of ``error`` of p.

    Within v h of a stop, v the thermal velocity, the force is not smooth over a step: of a force
    ``B x^e`` the bias of p(q) there is ``BIAS X^e`` of itself, ``X = h² e B (v h)^(e−1)/m`` the
    square of the phase that the contact adds in a step. In a density of q and p, or of one of them
    and an energy, the biases of v and −v do not cancel: it is ``JOINT_BIAS X``, and bounded where
    ``observables`` contain one. Farther stops are visited less often, and known to a larger error,
    up to one third of p itself.
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


def expected_error(samples: float) -> float:
    """Return about what relative error p has near its maximum, from the samples to be taken."""
    return 7.0 / sqrt(samples)  # 5.8 to 7.7 in runs of 1e9 samples


def samples_in(system: System, dt: float, seconds: float) -> float:
    """Return about how many samples one thread takes in ``seconds`` of wall time."""
    size = max(1.0, system.n / 3) ** 2  # the map of a step is a full matrix
    steps = max(1.0, sampling_interval(system) / dt)
    return seconds / (STEP_SECONDS * size * steps + SAMPLE_SECONDS)


def stability_limit(
    system: System, scheme: Scheme, *, energy: float = 0.0, kT: float | None = None
) -> float:
    """Return 2/ω, where steps become unstable; ω of the contact, with the springs if they kick.

    Of Euler's rule it is the least −2 Re λ/|λ|², λ the eigenvalues of the drift out of contact;
    damping terms count as constant damping that balances the noise.
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
    """Return the longest decay time of the motion without contact; inf if some never decays.

    With damping terms modes are taken for Gaussian at temperatures θ_m that balance,
    ``dθ_m/dt = S_m − P_m(θ)``: S_m the power of the noise, P_m that of all damping; an eigenvalue
    of ∂P/∂θ there is the decay rate of an energy. One temperature for all modes gives a second
    estimate, 2n/P'(θ), and the longer one counts. Passages between coexisting states take longer.
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
            # Of x'' + rate x' + ω² x = 0; creeping has (rate/2 + √…)/ω².
            creep = np.sqrt(np.maximum((0.5 * rates) ** 2 - slowest**2, 0.0))
            creeping = (0.5 * rates + creep) / slowest**2
            times += np.where(0.5 * rates > slowest, creeping, 2.0 / rates).tolist()
    return max(filter(isfinite, times), default=inf)


def modal_temperatures(system: System) -> Array:
    """Return the temperatures θ (n,) of ``relaxation_time`` at which modes balance; none: empty."""
    shapes, _ = natural_modes(system)
    noise = np.einsum("im,ij,jm->m", shapes, system.noise_matrix, shapes)
    start = np.full(system.n, equivalent_temperature(system))
    root: Any = scipy.optimize.root  # the stubs want a function of a fixed shape
    balance: Any = root(lambda theta: noise - modal_powers(system, theta), start)
    return np.asarray(balance.x if balance.success and np.all(balance.x > 0) else [])


def modal_powers(system: System, temperatures: Array) -> Array:
    """Return E P_m (Tᵀ c M⁻¹ p)_m of modes, independent Gaussians of ``temperatures`` (n,).

    H^e of a term stands for E H^e of the Gibbs state of the same mean energy.
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


def undamped_mode(system: System) -> bool:
    """Return whether neither the constant damping nor any term acts on some mode."""
    shapes, omega = natural_modes(system)
    reached = np.abs(np.diag(shapes.T @ system.damping @ shapes)) > ROUND_OFF * omega[-1]
    size = np.abs(shapes) * np.sqrt(system.mass)[:, None]  # at most 1
    for term in system.damping_terms:
        reached |= size[term.row] * size[term.column] > ROUND_OFF
    return not bool(np.all(reached))


def loudest(system: System) -> System:
    """Return the system under constant noise, as strong as its modulation makes it at the most."""
    if system.modulation is None:
        return system
    most = system.modulation.largest * system.noise_intensity
    return replace(system, noise_intensity=most, modulation=None)


def hottest(system: System) -> float:
    """Return the least T with N <= T c, as quadratic forms of v; inf where some v is not damped.

    With damping terms it is the largest temperature of a mode, or that of all.
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
    return float(np.max(ratios, initial=0.0))  # of none where nothing is damped and no noise acts


def largest_reached(system: System, energy: float, time: float) -> Array:
    """Return the largest |q| and |p| (2n,) by the ``time`` since a start of up to ``energy``.

    The linear motion from there and that by the noise add up, of which the second has 2n normal
    coordinates in units of √T: T is that of the ``hottest`` mode or, as energy comes from the noise
    alone, twice all that by then. Stops and springs only take room away.
    """
    T = system.fact(hottest)
    if system.damping_terms:
        energy = max(energy, BEYOND_BALANCE * system.fact(damping_balance).energy)
    else:
        T = min(T, 2.0 * time * float(np.sum(np.diag(system.noise_matrix) / system.mass)))
    # Twice: a stable kick keeps ½p² + ½(1 − h²ω²/4) ω²q², a quarter of H at the least up to
    # hω = √3 of at most 2.
    root = 2.0 * sqrt(energy) + sqrt(T * float(scipy.special.gammainccinv(system.n, CHANCE)))
    return root * np.sqrt(2.0 * np.concatenate([np.diag(system.compliance), system.mass]))
