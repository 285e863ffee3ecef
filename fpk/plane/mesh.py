"""Tensor meshes of two energies: where they end and how long their elements are."""

from math import lgamma

import numpy as np
from numpy.typing import NDArray

from fpk.errors import NotCertified
from fpk.vector_process import VectorProcess

Array = NDArray[np.float64]

SURVEY = np.concatenate([np.logspace(-3.0, 0.0, 10), np.logspace(0.0, 3.0, 60)[1:]])
"""Energies of the survey along an axis, in units of the process's scale."""
ACROSS = 8
"""Gauss-Laguerre points over the other energy."""


def fall_rate(process: VectorProcess, axis: int, energy: Array) -> tuple[Array, Array]:
    """Return −d ln p/dH of the marginal along an axis, closed by an exponential other energy.

    The second array is the largest size of the rate at the points of the closure. A guess that
    meshes start from: the answer does not rest on it.
    """
    t, weight = np.polynomial.laguerre.laggauss(ACROSS)
    grid = np.meshgrid(energy, t * process.energy_scales[1 - axis], indexing="ij")
    points = np.stack([part.ravel() for part in (grid if axis == 0 else grid[::-1])], axis=1)
    a = process.drift(points) - 0.5 * process.diffusion_divergence(points)
    flow = -2.0 * a[:, axis].reshape(energy.size, ACROSS)
    spread = process.diffusion(points)[:, axis, axis].reshape(energy.size, ACROSS)
    local = np.abs(flow / spread)[:, weight > 0.03 * weight.max()].max(axis=1)
    return (flow @ weight) / (spread @ weight), local


def axis_nodes(process: VectorProcess, axis: int, *, tail: float, tol: float, degree: int) -> Array:
    """Return nodes from 0 to an energy beyond which about the share ``tail`` lies.

    Element by element as long as polynomials of ``degree`` meet the exponential fall of p there to
    ``tol`` of the whole: over x powers of e the best error is 2 (x/4)^(p+1)/(p+1)!.

    Raises ``NotCertified`` where the density does not fall off along the axis.
    """
    energy = process.energy_scales[axis] * SURVEY
    rate, local = fall_rate(process, axis, energy)
    steps = 0.5 * (rate[1:] + rate[:-1]) * np.diff(energy)
    fall = np.concatenate([[rate[0] * energy[0]], rate[0] * energy[0] + np.cumsum(steps)])
    depth = fall - np.minimum.accumulate(fall)
    deep = np.flatnonzero(depth > -np.log(tail))
    if not deep.size:
        raise NotCertified(f"the density does not fall off along H{axis + 1}")
    around = slice(deep[0] - 1, deep[0] + 1)
    end = float(np.interp(-np.log(tail), depth[around], energy[around]))
    fine = np.linspace(0.0, end, 257)
    change = np.interp(fine, energy, local)
    nats = np.concatenate([[0.0], np.cumsum(0.5 * (change[1:] + change[:-1]) * fine[1])])
    bottom = np.interp(fine, energy, depth)
    cuts, at = [0.0], 0.0
    while at < nats[-1]:
        below = float(np.interp(at, nats, bottom))
        at += 4.0 * float(np.exp((np.log(0.5 * tol) + lgamma(degree + 2) + below) / (degree + 1)))
        cuts.append(at)
    scaled = np.array(cuts) * (nats[-1] / cuts[-1])
    return np.asarray(np.interp(scaled, nats, fine))


def bisected(nodes: Array, marked: NDArray[np.bool_]) -> Array:
    """Return the nodes with the marked intervals halved."""
    middle = 0.5 * (nodes[1:] + nodes[:-1])
    return np.sort(np.concatenate([nodes, middle[marked]]))
