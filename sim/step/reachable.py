"""States in which stationary simulations start, and how far exact motions get from there."""

from dataclasses import replace
from math import exp, inf, sqrt

import numpy as np
from scipy.special import gammainccinv

from fpk.numeric.arrays import ROUND_OFF, Array
from fpk.system.equivalent import damping_balance
from fpk.system.system import System
from sim.step.arrays import LANES
from sim.step.random import START, normals
from sim.step.schemes import factored
from sim.step.step_size import BEYOND_BALANCE, modal_temperatures, temperature


def start_states(system: System, seed: int, blocks: int) -> Array:
    """Return the states (blocks, 2n, LANES) in which trajectories start.

    They are q = 0 and momenta of the temperature (covariance kT M). With damping terms the
    displacements are drawn, too: on a limit cycle the noise alone mixes phases slowly.
    """
    n, kT = system.n, temperature(system)
    L = factored(np.diag((kT if np.isfinite(kT) else 0.0) * system.mass))
    p = L @ normals(seed, blocks * LANES, START, n)[: L.shape[1]]
    q = np.zeros_like(p)
    if system.damping_terms:
        q = start_displacements(system, kT, normals(seed, blocks * LANES, START + n, n))
    return np.array(np.vstack([q, p]).reshape(2 * n, -1, LANES).transpose(1, 0, 2), order="C")


def start_displacements(system: System, kT: float, z: Array) -> Array:
    """Return displacements (n, paths) from standard normals ``z``: Gaussian by the springs at kT.

    Where a contact is reached they are shortened, by bisection, to the potential energy of the
    springs alone.
    """
    # An inverse, not ``system.compliance``: its rounding is part of what a seed stands for.
    q = np.linalg.cholesky(kT * np.linalg.inv(system.stiffness_matrix)) @ z
    level = 0.5 * np.sum(q * (system.stiffness_matrix @ q), axis=0)
    low, high = np.zeros(q.shape[1]), np.ones(q.shape[1])
    for _ in range(40):
        middle = 0.5 * (low + high)
        above = system.potential((middle * q).T) > level
        low, high = np.where(above, low, middle), np.where(above, middle, high)
    return np.asarray(low * q)


CHANCE = exp(-100.0)
"""Probability that a state has more energy. Of 1e13 states one in 1e30 has it by chance; where the
density is not Gibbs', and falls by e^−30 only instead of e^−100, none of them has."""


def loudest(system: System) -> System:
    """Return the system under constant noise, as strong as its modulation makes it at the most."""
    if system.modulation is None:
        return system
    most = system.modulation.largest * system.noise_intensity
    return replace(system, noise_intensity=most, modulation=None)


def hottest(system: System) -> float:
    """Return the least T with N <= T c, as quadratic forms of v; inf where some v is not damped.

    N = f D fᵀ, and c its symmetric part: of no damped linear motion is the mean of m v² larger.
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
    """Return the largest |q| and |p| (2n,) of motions by the ``time`` since their start.

    ``energy`` is the largest H at the start. The linear motion from there and that by the noise add
    up, of which the second has 2n normal coordinates in units of √T: T is that of the ``hottest``
    mode or, as energy comes from the noise alone, twice all that by then. Stops and springs only
    take room away.
    """
    T = system.fact(hottest)
    if system.damping_terms:
        energy = max(energy, BEYOND_BALANCE * system.fact(damping_balance).energy)
    else:
        T = min(T, 2.0 * time * float(np.sum(np.diag(system.noise_matrix) / system.mass)))
    # Twice: a stable kick keeps ½p² + ½(1 − h²ω²/4) ω²q², a quarter of H at the least up to
    # hω = √3 of at most 2.
    root = 2.0 * sqrt(energy) + sqrt(T * float(gammainccinv(system.n, CHANCE)))
    return root * np.sqrt(2.0 * np.concatenate([np.diag(system.compliance), system.mass]))
