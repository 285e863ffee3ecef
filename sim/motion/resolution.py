"""Whether the bins of a histogram are narrow enough for its density.

In each bin let m be the average of the fit of ``SampledDensity.at`` less the value of the bin.
Where the density is smooth on the scale of the bins m is chance; near a spike, a jump or a kink it
is not. Where m falls as the bins narrow it is the error of the fit. Where it does not, the density
has an edge or a spike within a bin, and the samples do not show how high it is.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import scipy  # its parts are loaded at their first use

from fpk.arrays import Array, Flags
from fpk.quadrature import panel_rule
from fpk.reconstruction import DEGREE, radius_of
from fpk.sampled_density import SampledDensity
from sim.diagnostics import drift_limit
from sim.motion.stationary import error_of

POINTS = 2
"""Gauss points at which the fit is averaged over a bin."""

FALLS = 0.75
"""Ratio of m to that on bins twice as wide above which bins are too wide: it is one half at a kink
and 1 at a jump."""


def misfit(density: SampledDensity, *points: Array) -> tuple[Array, Flags]:
    """Return the largest |m| near ``points`` over the density there, and where bins are too wide.

    An m that chance explains counts as 0, with false alarms as of ``drift_limit``. Of a pair of
    coordinates it is the larger one of the densities of each alone.
    """
    missed, lost = np.zeros(points[0].shape), np.zeros(points[0].shape, dtype=bool)
    for axis, x in enumerate(points):
        alone = _marginal(density, axis)
        one, own = _missed(alone, x)
        two, _ = _missed(alone.joined(2), x)
        size = np.maximum(np.abs(alone.at(x)[0]), alone.one_sample)
        missed = np.maximum(missed, one / size)
        lost |= own > FALLS * two
    return missed, lost


def too_wide(density: SampledDensity, time: float, point: Sequence[float]) -> str:
    """Return words for a ``point`` at which bins are too wide."""
    at = ", ".join(f"{c} = {x:g}" for c, x in zip(density.observable, point, strict=True))
    width = " x ".join(f"{e[1] - e[0]:.2g}" for e in density.edges)
    return (
        f"at t = {time:g} the density near {at} changes within a bin of {width}, and is not known"
        " there; ask for points farther off, or later times"
    )


def _marginal(density: SampledDensity, axis: int) -> SampledDensity:
    """The density of one coordinate of a pair, or the density itself."""
    if len(density.edges) == 1:
        return density
    other = density.edges[1 - axis]
    return replace(
        density,
        observable=(density.observable[axis],),
        edges=(density.edges[axis],),
        values=density.values.sum(axis=1 - axis) * (other[1] - other[0]),
        batch_values=density.batch_values.sum(axis=2 - axis) * (other[1] - other[0]),
        one_sample=density.one_sample * (other[1] - other[0]),
        log_references=density.log_references[axis : axis + 1],
    )


def _missed(density: SampledDensity, x: Array) -> tuple[Array, Array]:
    """Largest significant |m| near each ``x``, and within a bin of it."""
    (edges,), bins, radius = density.edges, density.values.size, radius_of(density.values.size)
    every = np.concatenate([density.values[None], density.batch_values])
    limit, size = drift_limit(len(density.batch_values), bins), np.zeros(bins)

    def significant(m: Array) -> Flags:
        return np.asarray(np.abs(m[0]) > limit * error_of(m[1:]))

    # A plain polynomial tells where to look: it takes a hundredth of the time.
    plain = scipy.signal.savgol_filter(every, 2 * radius + 1, DEGREE, axis=1, mode="interp")
    missed = np.flatnonzero(significant(plain - every))
    if missed.size:
        points, weights = (rule[missed] for rule in panel_rule(edges, POINTS))
        fitted = density.fitted(points.ravel(), every).reshape(len(every), missed.size, POINTS)
        m = (fitted * weights).sum(axis=2) / (edges[1] - edges[0]) - every[:, missed]
        size[missed] = np.where(significant(m), np.abs(m[0]), 0.0)
    own = np.clip(((x - edges[0]) / (edges[1] - edges[0])).astype(np.int64), 0, bins - 1)
    near, within = (
        scipy.ndimage.maximum_filter1d(size, 2 * reach + 1, mode="nearest")[own]
        for reach in (radius // 2, 1)
    )
    return near, within
