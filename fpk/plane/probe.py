"""Probe of a process of two energies: the scales and the extent of its density, before any mesh."""

from dataclasses import dataclass

import numpy as np

from fpk.arrays import SMALLEST, Array
from fpk.errors import NotCertified
from fpk.process import Process

PROBE = np.concatenate([[0.0], np.logspace(-2.0, 3.0, 52)])
"""Energies of a probe along each axis, in units of the process's scales; ten per decade resolve
ln p of damping of any power of H."""
AXIS = 1e-4
"""Where the slopes at H_i = 0 are evaluated, in units of the scale: b is singular on the axis, and
the slopes vary over energies of the order of the scale."""
EXTENT = 40.0
"""Least fall of ln p within a probe: e^−40 = 4e-18 is below round-off of the mass."""


@dataclass(frozen=True, eq=False)
class Probe:
    """Approximate ln p and its slopes (2, …) on the grid of ``PROBE`` in units of the scales.

    Meshes and weights start from it; the answer does not rest on it.
    """

    log_density: Array
    slopes: Array

    def extent(self, tail: float) -> Array:
        """Return the energies (2,), in units of the scales, with the share ``tail`` beyond each."""
        width = np.gradient(PROBE)
        mass = np.exp(self.log_density - self.log_density.max()) * np.multiply.outer(width, width)
        ends = np.empty(2)
        for axis in (0, 1):
            beyond = np.cumsum(mass.sum(axis=1 - axis)[::-1])[::-1]
            share = np.log(np.maximum(beyond / beyond[0], SMALLEST))
            ends[axis] = np.interp(-np.log(tail), -share, PROBE)
        return ends


def probed(process: Process) -> Probe:
    """Return the density that zero flux everywhere would give, ∇ ln p = b⁻¹ (2s − ∇·b).

    ln p is the mean of the integrals along two paths, first one energy, then the other: exact
    under detailed balance, whatever the coupling. Where that does not fall off, the probability
    circulates strongly; taken instead is the product of exponentials whose means are the process's
    scales.

    Raises ``NotCertified`` where b is singular off the axes.
    """
    inside = np.maximum(PROBE, AXIS)
    points = np.stack(np.broadcast_arrays(inside[:, None], inside), axis=-1).reshape(-1, 2)
    c = process.coefficients(points * process.energy_scales)
    slopes = divided_by_diffusion(2.0 * c.drift - c.divergence, c.diffusion)
    first, second = (slopes * process.energy_scales).T.reshape(2, PROBE.size, PROBE.size)
    along = _integral(first), _integral(second.T).T
    paths = along[0][:, :1] + along[1] + along[1][:1] + along[0]
    log_density, slopes = 0.5 * paths, np.stack([first, second])
    # p H1 H2, the density of the logarithms of the energies.
    log = np.log(np.maximum(PROBE, PROBE[1]))
    log_mass = log_density + log[:, None] + log
    if max(log_mass[-1].max(), log_mass[:, -1].max()) < log_mass.max() - EXTENT:
        return Probe(log_density, slopes)
    return Probe(-PROBE[:, None] - PROBE, np.full_like(slopes, -1.0))


def divided_by_diffusion(flow: Array, b: Array) -> Array:
    """Return b⁻¹ ``flow`` (points, 2); raises ``NotCertified`` where b is singular."""
    determinant = b[:, 0, 0] * b[:, 1, 1] - b[:, 0, 1] ** 2
    if not np.all(determinant > 0.0):
        raise NotCertified("some combination of the two energies gets no noise")
    first = b[:, 1, 1] * flow[:, 0] - b[:, 0, 1] * flow[:, 1]
    second = b[:, 0, 0] * flow[:, 1] - b[:, 0, 1] * flow[:, 0]
    return np.stack([first, second], axis=1) / determinant[:, None]


def _integral(slope: Array) -> Array:
    """Trapezoidal ∫ from 0 along the first axis of the probe."""
    steps = 0.5 * (slope[1:] + slope[:-1]) * np.diff(PROBE)[:, None]
    return np.concatenate([np.zeros_like(slope[:1]), np.cumsum(steps, axis=0)])
