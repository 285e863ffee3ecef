"""Rates at which a displacement crosses levels upwards, from its joint density with a momentum."""

import numpy as np

from fpk.arrays import Array
from fpk.density import AnyDensity, Density
from fpk.quadrature import gauss_grid
from fpk.sampled_density import SampledDensity

POINTS = (12, 16, 20)
"""Gauss points on each panel of momenta; the answer is that of the last rule. One of the others may
agree with it by chance, both hardly."""
SAFETY = 3.0
"""Error of quadrature over the sum of the distances of the answer to the other rules."""


def upcrossings(joint: AnyDensity, mass: float, at: Array) -> tuple[Array, Array]:
    """Return the rates ∫_0^∞ (p/m) f(q, p) dp of a joint density of (q, p) at q = ``at``.

    Rice's formula. The error is the integral of that of the density, with what fewer points give
    and what lies beyond the last momentum; of samples one standard error by their batches.
    """
    nodes = np.union1d(0.0, joint.panels[1][joint.panels[1] > 0.0])
    if isinstance(joint, SampledDensity):
        return joint.flux(lambda p: p / mass, nodes, at)
    rates = []
    for points in POINTS:
        _, [(p, w)] = gauss_grid([nodes], points=points)
        density, error = joint.at(at[:, None], p)
        rates.append((density @ (w * p / mass), error @ (w * p / mass)))
    *coarse, (value, own) = rates
    missed = sum(np.abs(value - other) for other, _ in coarse)
    return value, own + SAFETY * missed + _beyond(joint, nodes[-2:], at) / mass


def _beyond(joint: Density, last: Array, at: Array) -> Array:
    """∫ p f(q, p) dp beyond the last node, f falling there at least as between the ``last`` two.

    Infinite where it does not fall, unless it is within its error of 0 there.
    """
    density, error = joint.at(at[:, None], last)
    (before, end), size = np.abs(density).T, np.abs(density[:, 1]) + error[:, 1]
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        falls = (last[1] - last[0]) / np.log(before / end)
    length = np.where(before > end, falls, np.where(end <= error[:, 1], last[1], np.inf))
    return np.asarray(size * length * (last[1] + length))
