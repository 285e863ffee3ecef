"""Feller classification of the ends of the energies of a process."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fpk.process import Process

Array = NDArray[np.float64]

NEAR, FAR = 1e-6, 1e4
"""Energies, in units of the process's scale, at which the limits at both ends are read off."""
OTHERS = (0.0, 1.0, 10.0)
"""Levels of the other energies, in units of their scales: of all alike, and of one alone."""


@dataclass(frozen=True)
class BoundaryClass:
    """Kind of one end in Feller's sense, in the words of stochastic averaging, and why."""

    end: str
    kind: str
    reason: str


def classify(process: Process, axis: int = 0) -> tuple[BoundaryClass, BoundaryClass]:
    """Return the classes of H_i = 0 and H_i = ∞ of energy ``axis``; none takes a condition.

    At H = 0 with b ~ β H the scale density behaves as H^(−κ) and the speed density as H^(κ−1),
    κ = 2 s(0)/β. At infinity the scale diverges where the drift points inwards, and the process
    comes back from there in finite time when ∫dH/|s| converges. Of several energies the others
    stand still while H_i is small: the least favourable of their ``OTHERS`` decides.
    """
    name = "H" if process.dimension == 1 else f"H{axis + 1}"
    return _lower(process, axis, name), _upper(process, axis, name)


def _along(process: Process, axis: int, share: float) -> tuple[Array, Array, Array]:
    """H_i, s_i and b_ii at H_i = ``share`` of its scale, the other energies at all ``OTHERS``."""
    rest = process.dimension - 1
    levels = [np.full(rest, level) for level in OTHERS[: None if rest else 1]]
    levels += [level * row for level in OTHERS if level and rest > 1 for row in np.eye(rest)]
    energy = np.insert(np.array(levels), axis, share, axis=1) * np.array(process.energy_scales)
    c = process.at(energy)
    return energy[:, axis], c.drift[:, axis], c.diffusion[:, axis, axis]


def _lower(process: Process, axis: int, name: str) -> BoundaryClass:
    energy, drift, diffusion = _along(process, axis, NEAR)
    order = np.log2(_along(process, axis, 2.0 * NEAR)[2] / diffusion)
    worst = float(order[np.argmax(np.abs(order - 1.0))])
    if abs(worst - 1.0) > 1e-2:
        return BoundaryClass(f"{name} = 0", "not classified", f"σ² ~ H^{worst:.3g}, not ~ H")
    # The extrapolated κ is that of H = NEAR, whose distance from the limit is of order NEAR.
    kappa = float(np.min(2.0 * drift * energy / diffusion))
    if kappa > 1.0 - 1e-3:
        kind, words = "entrance", "the process leaves it and never comes back"
    elif kappa > 0.0:
        kind, words = "regular", "the process reaches it"
    else:
        kind, words = "exit", "the process ends there"
    least = "" if process.dimension == 1 else " at the least"
    return BoundaryClass(f"{name} = 0", kind, f"σ² ~ H and 2 s H/σ² → {kappa:.4g}{least}: {words}")


def _upper(process: Process, axis: int, name: str) -> BoundaryClass:
    drift, farther = (_along(process, axis, share)[1] for share in (FAR, 2.0 * FAR))
    if np.any(farther >= 0.0):
        return BoundaryClass(f"{name} = ∞", "not confining", "the drift points outwards")
    inwards = drift < 0.0
    order = float(np.min(np.log2(farther[inwards] / drift[inwards]))) if inwards.all() else 0.0
    reason = f"the drift points inwards, about as −{name}^{order:.2g}"
    if order > 1.0 + 1e-2:
        return BoundaryClass(f"{name} = ∞", "entrance", f"{reason}, so it is left in finite time")
    return BoundaryClass(
        f"{name} = ∞", "natural", f"{reason}: neither reached nor left in finite time"
    )
