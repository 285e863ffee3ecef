"""Which trajectories may touch a stop within a long step, and how long a step is worth while.

A long step ``H = small · h`` divides the trajectories by their state x at its start: *near* ones
make ``small`` steps ``h`` with kicks; *far* ones make it at once, which is exact in law unless they
touch. With q the displacement of the mass and d the side, a trajectory is far if

    max(d q(0), d q(H) + a) + b(x) < clearance ,

q(H) its mean motion, b(x) the ``bends`` of that, and a the ``noise_reach``. It then touches with a
probability of 1.4e-11 at most: docs/theory.md, "The step of the simulation".
"""

from dataclasses import replace
from math import isfinite, log, sqrt

import numpy as np
from scipy.linalg import expm
from scipy.special import comb, ndtr

from fpk.arrays import Array, Integers
from fpk.linear import drift_matrix
from fpk.system import System
from sim.arrays import LANES, SubstepArrays
from sim.flow import exact_flow, lower_trapezoidal, padded
from sim.parts.substeps import NARROW
from sim.schemes import Scheme
from sim.step_size import sampling_interval, temperature

LARGEST_NORMAL = sqrt(2.0 * 32.0 * log(2.0)) * (1.0 + 3e-6)
"""Radius of a pair of normals at most: its uniform number is 2**-32 or more; and its rounding."""

TIMES = 64
"""Intervals of a long step at whose ends the curvature of its path is evaluated."""

SMALL_STEPS = (4, 8, 12, 16, 24, 32, 48, 64, 96, 128)
"""Small steps in a long one; few choices, so that round-off does not decide between them."""

LONG_COST, SMALL_COST, WORTH = 2.3, 1.2, 0.8
"""Processor time of a long step, and of a small step in a group, in units of a step of a whole
block (measured by ``benchmarks/montecarlo.py``), and the cost below which long steps are made."""


def noise_reach(system: System, H: float, masses: Integers) -> Array:
    """Return what the noise of one step H can add to the displacements of ``masses``."""
    rows = lower_trapezoidal(exact_flow(system, H).factor)[masses]
    rows = np.pad(rows, ((0, 0), (0, rows.shape[1] % 2)))
    return np.asarray(LARGEST_NORMAL * np.hypot(rows[:, ::2], rows[:, 1::2]).sum(axis=1))


def bends(system: System, H: float, masses: Integers) -> Array:
    """Return rows (masses, 2n) whose product with ``|x|`` is b(x), how far paths leave the chord.

    The largest curvature is that on a grid of times, and half an interval times the largest slope.
    """
    drift, step = drift_matrix(system), H / TIMES
    across = expm(drift * step)
    value = drift[system.n + masses] / system.mass[masses, None]
    largest, slope = np.zeros_like(value), np.zeros_like(value)
    for _ in range(TIMES + 1):
        largest, slope = np.maximum(largest, abs(value)), np.maximum(slope, abs(value @ drift))
        value = value @ across
    return np.asarray(H**2 / 8.0 * (largest + 0.5 * step * slope))


def substep_arrays(system: System, H: float, small: int, mass: Integers) -> SubstepArrays:
    """Return the numbers of a long step for stops on ``mass`` (stops,), masses from 0."""
    flow = exact_flow(system, H)
    return SubstepArrays(
        small=small,
        matrix=flow.matrix,
        row=padded(flow.propagator[mass]),
        bend=padded(bends(system, H, mass)),
        reach=noise_reach(system, H, mass),
    )


def near_share(system: System, H: float) -> float:
    """Return an estimate of the share of trajectories that are near: each mass alone at kT."""
    kT, far, masses = temperature(system), 1.0, system.contact_masses
    for i, reach in zip(masses, noise_reach(system, H, np.array(masses)), strict=True):
        k_eff = 1.0 / system.compliance[i, i]
        q = np.linspace(-6.0, 6.0, 4001) * sqrt(kT / k_eff)
        energy = 0.5 * k_eff * q * q + system.contact_energy(i, q)
        weight = np.exp(-(energy - energy.min()) / kT)
        near, width = np.zeros(q.size), H * sqrt(kT / system.mass[i])
        for stop in (s for s in system.stops if s.index == i):
            gap = stop.clearance - stop.sign * q
            near += np.where(gap <= 0.0, 1.0, ndtr((reach - gap) / width))
        far *= 1.0 - float(np.sum(np.minimum(near, 1.0) * weight) / np.sum(weight))
    return 1.0 - far


def cost(system: System, dt: float, small: int) -> float:
    """Return the processor time of long steps over that of uniform steps ``dt``, an estimate."""
    if small == 1:
        return 1.0
    count, near = np.arange(LANES + 1), near_share(system, small * dt)
    groups = np.ceil(count / NARROW) * NARROW / LANES
    chance = comb(LANES, count) * near**count * (1.0 - near) ** (LANES - count)  # binomial
    return LONG_COST / small + SMALL_COST * float(np.sum(chance * groups))


def with_long_steps(system: System, scheme: Scheme, dt: float) -> tuple[Scheme, float, str]:
    """Return the scheme with long steps of small ones ``dt``, how long they are, and why.

    Where all trajectories are to make the same steps it is the scheme itself, and ``dt``. A long
    step is no longer than the interval of samples. Damping terms act between stops, too, and only
    the exact flow is exact over a long step.
    """
    if not system.stops:
        return scheme, dt, "no contact: all trajectories make the same steps"
    if system.damping_terms:
        return scheme, dt, "damping terms act everywhere: all trajectories make the same steps"
    if scheme.linear_map is not exact_flow:
        return scheme, dt, f"{scheme.name} needs the small step everywhere"
    kT, longest = temperature(system), sampling_interval(system) * (1.0 + 1e-9) / dt
    choices = [m for m in SMALL_STEPS if m <= longest]
    if not choices or not (isfinite(kT) and kT > 0.0):
        return scheme, dt, "the contact does not limit the step"
    costs = [cost(system, dt, m) for m in choices]
    small = choices[int(np.argmin(costs))]
    if min(costs) > WORTH:
        return scheme, dt, "too many trajectories are near a stop"
    words = f"{small} small steps near a stop, one elsewhere"
    return replace(scheme, small=small), small * dt, words
