"""The step: from the stiffest contact that the motion reaches, and from the shortest period."""

from math import inf, pi, sqrt

import numpy as np
from scipy.linalg import eigh
from scipy.optimize import brentq

from fpk.errors import InvalidInput
from fpk.system import System
from sim.flow import linear_drift
from sim.scheme import Scheme

REACHED = 5.0
"""Potential energy, in units of kT, up to which a mass is expected to push into its stop."""

STEP_PER_FREQUENCY = 0.45
"""Step times the frequency in contact, springs included. The bias grows with the fourth power: at
0.65 the L1 of p(q2) shows it beside a sampling error of 3e-4 (B = 1, 10); at 0.45 it does not."""

SAMPLES_PER_PERIOD = 8
"""Samples in the shortest natural period; closer ones repeat each other."""


def temperature(system: System) -> float:
    """Return kT = Σ(N_ii/m_i) / Σ(c_ii/m_i), N = f D fᵀ: the mean of m v² by energy balance."""
    noise = float(np.sum(np.diag(system.noise_matrix) / system.mass))
    loss = float(np.sum(np.diag(system.damping) / system.mass))
    return noise / loss if loss > 0 else inf


def contact_frequency(system: System) -> float:
    """Return the largest √(g'/m) that is reached; 0 without contact."""
    return sqrt(max((slope / m for slope, _, m in _reached_stiffness(system)), default=0.0))


def frequency_in_contact(system: System) -> float:
    """Return the largest √((g' + K_ii)/m_i) that is reached; 0 without contact."""
    return sqrt(max(((slope + k) / m for slope, k, m in _reached_stiffness(system)), default=0.0))


def _reached_stiffness(system: System) -> list[tuple[float, float, float]]:
    """For every stop the steepest g' that is reached, and K_ii and the mass of its mass.

    A mass that moves alone, the others following statically, has the potential
    ``½ k_eff q² + U(q)`` with k_eff the Schur complement of K. It reaches ``REACHED`` kT, or
    one kT of contact energy where the stop is too far for that.
    """
    kT, reached = temperature(system), []
    compliance = np.linalg.inv(system.stiffness_matrix)
    for i in system.contact_masses:
        k_eff = 1.0 / compliance[i, i]
        for stop in (s for s in system.stops if s.mass == i):
            sign = 1.0 if stop.side == "right" else -1.0
            level = max(REACHED * kT, 0.5 * k_eff * stop.clearance**2 + kT)

            def excess(
                q: float, i: int = i, k: float = k_eff, d: float = sign, level: float = level
            ) -> float:
                return 0.5 * k * q * q + float(system.contact_energy(i, d * q)) - level

            q = brentq(excess, 0.0, sqrt(2.0 * level / k_eff) * (1.0 + 1e-9))
            slope = sum(
                float(s.slope(q - s.clearance))
                for s in system.stops
                if s.mass == i and s.side == stop.side and q > s.clearance
            )
            reached.append((slope, float(system.stiffness_matrix[i, i]), float(system.mass[i])))
    return reached


def highest_frequency(system: System) -> float:
    """Return the highest natural frequency without contact, in rad per unit time."""
    squares = eigh(system.stiffness_matrix, np.diag(system.mass), eigvals_only=True)
    return sqrt(float(squares[-1]))


def relaxation_time(system: System) -> float:
    """Return the longest decay time of the motion without contact; inf if some never decays."""
    A = linear_drift(system)
    rate = -float(np.max(np.linalg.eigvals(A).real))
    return 1.0 / rate if rate > 1e-13 * float(np.linalg.norm(A)) else inf


def sampling_interval(system: System) -> float:
    """Return the time between samples, an eighth of the shortest natural period."""
    return 2.0 * pi / highest_frequency(system) / SAMPLES_PER_PERIOD


def chosen_step(system: System) -> float:
    """Return the step of ``exact_flow``; without contact any is exact: the sampling interval."""
    frequency, interval = frequency_in_contact(system), sampling_interval(system)
    return min(interval, STEP_PER_FREQUENCY / frequency) if frequency > 0.0 else interval


def check_step(system: System, scheme: Scheme, dt: float) -> None:
    """Refuse a step at or above 2/ω, where a kick amplifies what it should turn back.

    ω is the contact frequency, with the springs where the scheme kicks by them.
    """
    square = contact_frequency(system) ** 2
    if scheme.springs_kicked or not scheme.kick_first:
        square += highest_frequency(system) ** 2
    limit = 2.0 / sqrt(square) if square > 0 else inf
    if not 0.0 < dt < limit:
        raise InvalidInput(
            "dt",
            dt,
            f"must be > 0 and below the stability limit 2/ω = {limit:.4g} of {scheme.name}",
        )
