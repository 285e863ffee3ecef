"""Feller classification of the ends of an energy process."""

from dataclasses import dataclass

import numpy as np

from fpk.process import DiffusionProcess

NEAR, FAR = 1e-6, 1e4
"""Energies, in units of the process's scale, at which the limits at both ends are read off."""


@dataclass(frozen=True)
class BoundaryClass:
    """Kind of one end in Feller's sense, in the words of stochastic averaging, and why."""

    end: str
    kind: str
    reason: str


def classify(process: DiffusionProcess) -> tuple[BoundaryClass, BoundaryClass]:
    """Return the classes of H = 0 and H = ∞; none of them takes a boundary condition.

    At H = 0 with b ~ β H the scale density behaves as H^(−κ) and the speed density as H^(κ−1),
    κ = 2 s(0)/β. At infinity the scale diverges where the drift points inwards, and the process
    comes back from there in finite time when ∫dH/|s| converges.
    """
    return _lower(process), _upper(process)


def _lower(process: DiffusionProcess) -> BoundaryClass:
    energy = process.energy_scale * np.array([NEAR, 2.0 * NEAR])
    c = process.coefficients(energy)
    order = float(np.log2(c.diffusion[1] / c.diffusion[0]))
    kappa = float(2.0 * c.drift[0] * energy[0] / c.diffusion[0])
    if abs(order - 1.0) > 1e-2:
        return BoundaryClass("H = 0", "not classified", f"σ² ~ H^{order:.3g}, not ~ H")
    # The extrapolated κ is that of H = NEAR, whose distance from the limit is of order NEAR.
    if kappa > 1.0 - 1e-3:
        kind, words = "entrance", "the process leaves it and never comes back"
    elif kappa > 0.0:
        kind, words = "regular", "the process reaches it"
    else:
        kind, words = "exit", "the process ends there"
    return BoundaryClass("H = 0", kind, f"σ² ~ H and 2 s H/σ² → {kappa:.4g}: {words}")


def _upper(process: DiffusionProcess) -> BoundaryClass:
    energy = process.energy_scale * np.array([FAR, 2.0 * FAR])
    c = process.coefficients(energy)
    if c.drift[1] >= 0.0:
        return BoundaryClass("H = ∞", "not confining", "the drift points outwards")
    order = float(np.log2(c.drift[1] / c.drift[0])) if c.drift[0] < 0 else 0.0
    reason = f"the drift points inwards, about as −H^{order:.2g}"
    if order > 1.0 + 1e-2:
        return BoundaryClass("H = ∞", "entrance", f"{reason}, so it is left in finite time")
    return BoundaryClass("H = ∞", "natural", f"{reason}: neither reached nor left in finite time")
