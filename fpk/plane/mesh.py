"""Tensor meshes of plain elements in two energies: where they end, how long the elements are."""

import numpy as np
from numpy.typing import NDArray

from fpk.plane.probe import PROBE, Probe

Array = NDArray[np.float64]

LATTICE = 512
"""Equal parts of an axis on whose ends nodes are placed at first."""
TINY = float(np.finfo(float).tiny)


def axis_nodes(probe: Probe, axis: int, *, tail: float, tol: float, degree: int) -> Array:
    """Return nodes in units of the scale, from 0 to where about the share ``tail`` lies beyond.

    Between them polynomials of ``degree`` meet p to ``tol`` of the whole mass: over a length h the
    least error is 2 (h/4)^k |p^(k)|/k!, k = degree + 1, with |p^(k)| at the middle for an
    exponential, which the mean of its logarithm gives, and 2/π of that on average.
    """
    log_p, slope = probe.log_density, probe.slopes[axis]
    bend = -np.gradient(slope, PROBE, axis=axis)
    if axis == 1:
        log_p, slope, bend = log_p.T, slope.T, bend.T
    width = np.gradient(PROBE)
    log_p = log_p + np.log(width)
    p = np.exp(log_p - log_p.max())
    beyond = np.cumsum((p.sum(axis=1) * width)[::-1])[::-1]
    share = np.log(np.maximum(beyond / beyond[0], TINY))
    end = float(np.interp(-np.log(tail), -share, PROBE))
    rows = slice(0, int(np.searchsorted(PROBE, end)) + 1)
    k = degree + 1
    change = log_p[rows] - log_p.max() + _log_derivative(slope[rows], bend[rows], k)
    top = change.max(axis=1)
    total = top + np.log(np.exp(change - top[:, None]).sum(axis=1)) - np.log(beyond[0])
    lattice = np.linspace(0.0, end, LATTICE + 1)
    along = np.interp(lattice, PROBE[rows], total)
    summed = np.concatenate([[0.0], np.cumsum(0.5 * (along[1:] + along[:-1]))])
    allowed = np.log(0.25 * np.pi * tol) + k * np.log(4.0)
    cuts, at = [0], 0
    while at < LATTICE:
        length = np.arange(1, LATTICE + 1 - at)
        error = (k + 1) * np.log(length * lattice[1]) + (summed[at + 1 :] - summed[at]) / length
        too_long = np.flatnonzero(error > allowed)
        at += max(int(too_long[0]), 1) if too_long.size else LATTICE - at
        cuts.append(at)
    return lattice[cuts]


def _log_derivative(slope: Array, bend: Array, k: int) -> Array:
    """Return ln |p^(k)|/(k! p) of p = exp(slope x − bend x²/2) by Cauchy's estimate on a circle.

    On the best radius: k/|slope| for an exponential, √(k/bend) near the top of a Gaussian.
    """
    g, c = np.maximum(np.abs(slope), 1e-9), np.maximum(bend, 1e-18)
    top = g * g < 4.0 * k * c
    near = 0.25 * g * g / c + 0.5 * k * (1.0 + np.log(c / k))
    radius = 2.0 * k / (g + np.sqrt(np.maximum(g * g - 4.0 * k * c, 0.0)))
    far = g * radius - 0.5 * c * radius**2 - k * np.log(radius)
    return np.asarray(np.where(top, near, far))


def bisected(nodes: Array, marked: NDArray[np.bool_]) -> Array:
    """Return the nodes with the marked intervals halved."""
    middle = 0.5 * (nodes[1:] + nodes[:-1])
    return np.sort(np.concatenate([nodes, middle[marked]]))


def lengthened(nodes: Array) -> Array:
    """Return the nodes with another interval as long as the last one."""
    return np.append(nodes, 2.0 * nodes[-1] - nodes[-2])
