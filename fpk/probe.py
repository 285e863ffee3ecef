"""Probe of a process of one energy: the scales and the extent of its density, before any mesh."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fpk.errors import NotCertified
from fpk.process import Process, log_density_slope

Array = NDArray[np.float64]

GRID = np.concatenate([np.logspace(-3.0, 0.0, 10), np.logspace(0.0, 4.0, 41)[1:]])
"""Energies of a probe, in units of the process's scale."""
SAGITTA = 1.0
"""Largest (d²ln(p H)/d(ln H)²)·(Δ ln H)² between two points of a probe: eight times what ln p H
may rise above its chord. Asked for where p is within exp(−``DEEP``) of its maximum."""
DEEP = 100.0
"""Nats below the largest p H down to which a probe resolves it: 1e-43 of the mass."""
PROBE_ROUNDS = 20
"""Halvings of the distance between points of a probe, at the most."""


@dataclass(frozen=True, eq=False)
class Probe:
    """Where a process is sampled first to learn its scales; the answer does not rest on it.

    ``slope`` is d ln p/dH, ``roughness`` |d ln(p/T)/dH| and ``log_mass`` ln of p H up to a constant
    at ``energy``, all (points,).
    """

    energy: Array
    slope: Array
    roughness: Array
    log_mass: Array

    def extent(self, tail: float) -> float:
        """Return an energy beyond which about the share ``tail`` of the probability lies.

        The solver bounds the tail again from its own solution. Raises ``NotCertified`` where the
        density does not fall to that share.
        """
        energy, rate = self.energy, 1.0 + self.energy * self.slope
        top = int(np.argmax(self.log_mass))
        wanted = float(self.log_mass[top]) + math.log(tail)
        below = np.flatnonzero(self.log_mass[top:] < wanted)
        if not below.size:
            raise NotCertified(
                "the density does not fall off: damping does not balance the noise at high energy"
            )
        # As in ``_probe`` the rate is linear in ln H between two points.
        i = top + int(below[0])
        length = math.log(energy[i] / energy[i - 1])
        bend = (rate[i] - rate[i - 1]) / length
        fall = self.log_mass[i - 1] - wanted
        root = math.sqrt(max(rate[i - 1] ** 2 - 2.0 * bend * fall, 0.0))
        return float(energy[i - 1] * math.exp(min(2.0 * fall / (root - rate[i - 1]), length)))

    def tail_bound(self, end: float, density_at_end: float) -> float:
        """Return a bound of the mass above ``end``: p(end) over the least rate p falls at there.

        The rate is that of the probe above ``end``, and taken not to drop below it further out.
        """
        beyond = self.slope[self.energy >= end]
        at_end = float(np.interp(end, self.energy, self.slope))
        rate = -float(beyond.max(initial=at_end))
        return density_at_end / rate if 0.0 < rate < math.inf else math.inf

    def e_fold(self, end: float) -> float:
        """Return the mean energy over which p/T changes by the factor e, below ``end``."""
        inside = self.energy < end
        energy = np.concatenate([[0.0], self.energy[inside], [end]])
        nats = float(np.trapezoid(np.interp(energy, self.energy, self.roughness), energy))
        return end / nats


def probed(process: Process) -> Probe:
    """Return the probe of a process, from far below to far above its energy scale."""
    energy = process.energy_scale * GRID
    probe = _probe(energy, *_slopes(process, energy))
    return _closer(process, probe) if process.state_damping else probe


def _slopes(process: Process, energy: Array) -> tuple[Array, Array]:
    c = process.coefficients(energy)
    return log_density_slope(c), np.abs(2.0 * c.dissipation / c.diffusion)


def _probe(energy: Array, slope: Array, roughness: Array) -> Probe:
    # In the variable ln H, where the slope varies slowly: d ln(p H)/d ln H = 1 + H d ln p/dH.
    rate = 1.0 + energy * slope
    steps = 0.5 * (rate[1:] + rate[:-1]) * np.diff(np.log(energy))
    return Probe(energy, slope, roughness, np.append(0.0, np.cumsum(steps)))


def _closer(process: Process, probe: Probe) -> Probe:
    """Add points until no maximum of p can hide between two of them: it may be narrow."""
    for _ in range(PROBE_ROUNDS):
        log_mass = probe.log_mass
        bulk = np.maximum(log_mass[1:], log_mass[:-1]) > log_mass.max() - DEEP
        rate = 1.0 + probe.energy * probe.slope
        bent = np.abs(np.diff(rate)) * np.diff(np.log(probe.energy)) > SAGITTA
        i = np.flatnonzero(bulk & bent)
        if not i.size:
            break
        energy = np.sqrt(probe.energy[i] * probe.energy[i + 1])
        slope, roughness = _slopes(process, energy)
        probe = _probe(
            np.insert(probe.energy, i + 1, energy),
            np.insert(probe.slope, i + 1, slope),
            np.insert(probe.roughness, i + 1, roughness),
        )
    return probe
