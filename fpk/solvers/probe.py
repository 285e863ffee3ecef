"""Probe of a process of one energy: the scales and the extent of its density, before any mesh."""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from fpk.numeric.arrays import Array
from fpk.numeric.errors import NotCertified
from fpk.system.ends import FAR_OUT, OUT_OF_RANGE, require_falling
from fpk.system.process import Coefficients, Process, log_density_slope

GRID = np.concatenate(
    [np.logspace(-3.0, 0.0, 10), np.logspace(0.1, 2.0, 20), np.logspace(2.25, 4.0, 8), FAR_OUT[1:]]
)
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

    ``slope`` is d ln p/dH and ``roughness`` |d ln(p/T)/dH| at ``energy``, all (points,).
    """

    energy: Array
    slope: Array
    roughness: Array

    @cached_property
    def log_mass(self) -> Array:
        """ln(p H) up to a constant; its slope in ln H, 1 + H d ln p/dH, is linear in between."""
        rate, log_energy = 1.0 + self.energy * self.slope, np.log(self.energy)
        steps = 0.5 * (rate[1:] + rate[:-1]) * (log_energy[1:] - log_energy[:-1])
        return np.concatenate([[0.0], steps.cumsum()])

    def extent(self, tail: float) -> float:
        """Return an energy beyond which about the share ``tail`` of the probability lies.

        The solver bounds the tail again from its own solution. Raises ``NotCertified`` where the
        density does not fall to that share.
        """
        if not np.isfinite(self.log_mass).all():
            raise NotCertified(OUT_OF_RANGE)
        energy, rate = self.energy, 1.0 + self.energy * self.slope
        wanted = float(self.log_mass.max()) + math.log(tail)
        i = int(np.flatnonzero(~(self.log_mass < wanted))[-1]) + 1
        if i == energy.size:
            raise NotCertified(
                "the density does not fall off: damping does not balance the noise at high energy"
            )
        # As in ``log_mass`` the rate is linear in ln H between two points.
        length = math.log(energy[i] / energy[i - 1])
        bend = (rate[i] - rate[i - 1]) / length
        fall = self.log_mass[i - 1] - wanted
        root = math.sqrt(max(rate[i - 1] ** 2 - 2.0 * bend * fall, 0.0))
        return float(energy[i - 1] * math.exp(min(2.0 * fall / (root - rate[i - 1]), length)))

    def tail_bound(self, end: float, density_at_end: float) -> float:
        """Return a bound of the mass above ``end`` from p there; infinite where p does not fall.

        Between two energies of the probe p falls at the lesser of the rates at both of them, and
        beyond the last one at the rate there.
        """
        first = int(np.searchsorted(self.energy, end, side="right"))
        rate = -np.append(np.interp(end, self.energy, self.slope), self.slope[first:])
        least = np.minimum(rate[:-1], rate[1:])
        with np.errstate(all="ignore"):
            fall = least * np.diff(self.energy[first:], prepend=end)
            share = np.exp(-np.append(0.0, fall.cumsum()))
            length = float(np.sum(-np.diff(share) / least) + share[-1] / rate[-1])
        # Not where p rises beyond all bounds, or at the end; and not 0 · ∞.
        falls = rate[-1] > 0.0 and math.isfinite(length)
        return density_at_end * length if falls else math.inf

    def e_fold(self, end: float) -> float:
        """Return the mean energy over which p/T changes by the factor e, below ``end``."""
        inside = self.energy < end
        energy = np.concatenate([[0.0], self.energy[inside], [end]])
        nats = float(np.trapezoid(np.interp(energy, self.energy, self.roughness), energy))
        return end / nats


def probed(process: Process) -> Probe:
    """Return the probe of a process, from far below to far above its energy scale.

    Raises ``NotCertified`` where the density does not fall off at the highest energies.
    """
    energy = process.energy_scale * GRID
    # Of energies farther out than that, those whose coefficients overflow are not judged.
    with np.errstate(over="ignore", invalid="ignore"):
        c = process.coefficients(energy)
        slope, roughness = log_density_slope(c), np.abs(2.0 * c.dissipation / c.diffusion)
        finite = np.isfinite(slope * energy)
        if not finite.all():
            finite |= FAR_OUT[0] >= GRID
            c = Coefficients(*(np.broadcast_to(a, GRID.shape)[finite] for a in c))
            energy, slope, roughness = energy[finite], slope[finite], roughness[finite]
        require_falling(energy, c, slope)
    probe = Probe(energy, slope, roughness)

    # More points, until no maximum of p can hide between two of them: it may be narrow.
    for _ in range(PROBE_ROUNDS if process.state_damping else 0):
        log_mass = probe.log_mass
        bulk = np.maximum(log_mass[1:], log_mass[:-1]) > log_mass.max() - DEEP
        rate = 1.0 + probe.energy * probe.slope
        bent = np.abs(np.diff(rate)) * np.diff(np.log(probe.energy)) > SAGITTA
        i = np.flatnonzero(bulk & bent)
        if not i.size:
            break
        energy = np.sqrt(probe.energy[i] * probe.energy[i + 1])
        c = process.coefficients(energy)
        added = energy, log_density_slope(c), np.abs(2.0 * c.dissipation / c.diffusion)
        of = probe.energy, probe.slope, probe.roughness
        probe = Probe(*(np.insert(x, i + 1, new) for x, new in zip(of, added, strict=True)))
    return probe
