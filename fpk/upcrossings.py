"""Rates at which a displacement crosses levels upwards, from its joint density with a momentum."""

from dataclasses import replace

import numpy as np

from fpk.arrays import Array
from fpk.density import AnyDensity, Density
from fpk.quadrature import gauss_grid, panel_rule
from fpk.sampled_density import BIN_POINTS, SampledDensity

POINTS = (12, 16, 20)
"""Gauss points on each panel of momenta; the answer is that of the last rule. One of the others may
agree with it by chance, both hardly."""
SAFETY = 3.0
"""Error of quadrature over the sum of the distances of the answer to the other rules."""


def upcrossings(joint: AnyDensity, mass: float, at: Array) -> tuple[Array, Array]:
    """Return the rates ∫_0^∞ (p/m) f(q, p) dp of a joint density of (q, p) at q = ``at``.

    Rice's formula. The error is the integral of that of the density, with what fewer points give
    and what lies beyond the last momentum; of samples one standard error from their independent
    batches, see ``flux``.
    """
    if isinstance(joint, SampledDensity):
        (value, error), (plain, _) = (flux(joint, mass, c).at(at) for c in (True, False))
        return value, error + np.abs(value - plain)
    nodes = np.union1d(0.0, joint.panels[1][joint.panels[1] > 0.0])
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


def flux(joint: SampledDensity, mass: float, corrected: bool = True) -> SampledDensity:
    """Return ∫_0^∞ (p/m) f(q, p) dp of samples of (q, p) as a histogram of q.

    Within a bin of p samples count as evenly spread: with the bin width h that errs by
    (h²/12) ∫ ∂f/∂p dp/m, for which it is ``corrected``.
    """
    p, w = panel_rule(joint.edges[1], BIN_POINTS)
    weights = np.sum(w * np.maximum(p, 0.0), axis=1) / mass
    every = np.concatenate([joint.values[None], joint.batch_values])
    rates = every @ weights
    if corrected:
        rates = rates + np.diff(every, axis=-1) @ np.diff(weights) / 12.0
    # A visit counts as its weight, the mean of those there are weighted by themselves.
    seen = joint.values.sum(axis=0) @ np.stack([weights, weights**2], axis=1)
    return replace(
        joint,
        observable=joint.observable[:1],
        edges=joint.edges[:1],
        values=rates[0],
        batch_values=rates[1:],
        one_sample=joint.one_sample * float(seen[1] / seen[0] if seen[0] > 0.0 else weights.max()),
        log_references=joint.log_references[:1],
    )
