"""Feller classification of the edges H_i = 0 and H_i = ∞ of a process of several energies."""

import numpy as np
from numpy.typing import NDArray

from fpk.line.boundary import FAR, NEAR, BoundaryClass
from fpk.vector_process import VectorProcess

Array = NDArray[np.float64]

OTHERS = (0.0, 1.0, 10.0)
"""Where the other energies are looked at, in units of their scales: all alike, and one alone."""


def classify_edges(process: VectorProcess, axis: int) -> tuple[BoundaryClass, BoundaryClass]:
    """Return the classes of H_i = 0 and H_i = ∞ for the energy ``axis``, the others as they are.

    While H_i is small the others stand still, so that κ = 2 s_i H_i/b_ii at the edge decides as for
    one energy; it is looked at with the others at all of ``OTHERS`` and the least favourable one
    is named.
    """
    name = f"H{axis + 1}"
    rest = process.dimension - 1
    alone = [level * row for level in OTHERS if level for row in np.eye(rest)]
    others = np.array([*(np.full(rest, level) for level in OTHERS), *alone])
    scales = np.array(process.energy_scales)

    def at(share: float) -> Array:
        return np.asarray(np.insert(others, axis, share, axis=1) * scales)

    near = at(NEAR)
    kappa = 2.0 * process.drift(near)[:, axis] * near[:, axis]
    least = float(np.min(kappa / process.diffusion(near)[:, axis, axis]))
    if least > 1.0 - 1e-3:
        kind, words = "entrance", "the process leaves it and never comes back"
    elif least > 0.0:
        kind, words = "regular", "the process reaches it"
    else:
        kind, words = "exit", "the process ends there"
    lower = BoundaryClass(f"{name} = 0", kind, f"2 s H/σ² → {least:.4g} at the least: {words}")
    drift = [process.drift(at(share))[:, axis] for share in (FAR, 2.0 * FAR)]
    if np.any(drift[1] >= 0.0):
        upper = BoundaryClass(f"{name} = ∞", "not confining", "the drift points outwards")
        return lower, upper
    order = float(np.min(np.log2(drift[1] / np.minimum(drift[0], -np.finfo(float).tiny))))
    reason = f"the drift points inwards, about as −{name}^{order:.2g}"
    if order > 1.0 + 1e-2:
        kind, words = "entrance", f"{reason}, so it is left in finite time"
    else:
        kind, words = "natural", f"{reason}: neither reached nor left in finite time"
    return lower, BoundaryClass(f"{name} = ∞", kind, words)
