"""Ends of the energies of a process: Feller classes, and whether anything brings it back."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from fpk.errors import NotCertified
from fpk.process import Coefficients, Process, log_density_slope, log_density_slope_error

Array = NDArray[np.float64]

NEAR, FAR = 1e-6, 1e4
"""Energies, in units of the process's scale, at which the limits at both ends are read off."""
OTHERS = (0.0, 1.0, 10.0)
"""Levels of the other energies, in units of their scales: of all alike, and of one alone."""
FAR_OUT = np.logspace(4.0, 16.0, 13)
"""Energies, in units of the scale, at which a process has to come back. A term of the damping that
outweighs one of a lower degree only beyond 1e16 is less than the round-off (2e-16) of it at the
scale: up to there everything shows that is not round-off."""
RATIOS = np.concatenate([[0.0], np.logspace(-12.0, 0.0, 13)])
"""Ratios of two energies at which they are judged far out, either way; none is below its scale."""
RETURNED = 1e3
"""Two energies have come back below this, in units of their scales: there the probe begins."""
ESCAPED = 1e3
"""Growth from the last of ``FAR_OUT`` that counts as never coming back."""
FLOW = 400.0
"""Length of the path of ln H over which two energies have to come back, 37 straight on."""


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


def require_falling(energy: Array, c: Coefficients) -> None:
    """Raise ``NotCertified`` where p H of one energy rises at the last, highest ``energy``.

    ``c`` are the coefficients there. The slope d ln(p H)/d ln H = 1 + H (2s − b')/b has to be
    negative there beyond its error: p has no finite integral else, whatever a mesh that ends
    earlier makes of it. A rise in between shows in the mass beyond the mesh (``fpk.probe``).
    """
    rate = 1.0 + energy * log_density_slope(c)
    error = energy * np.nan_to_num(log_density_slope_error(c))
    inwards = np.flatnonzero(~(rate > error))
    first = int(inwards[-1]) + 1 if inwards.size else 0
    if first < energy.size:
        raise NotCertified(
            f"the density does not fall off: from H = {energy[first]:.3g} on the drift points "
            "outwards, so nothing brings the energy back"
        )


def require_confined(process: Process) -> None:
    """Raise ``NotCertified`` where two energies do not come back from far out.

    There noise moves them by less and less. Where Σ s_i/θ_i, θ_i the scales, is negative on all
    ``RATIOS`` at all of ``FAR_OUT`` they do (Foster and Lyapunov). Where it is not, the path
    d ln H_i = (s_i/H_i − b_ii/(2 H_i²)) dt is followed from the highest energies: if one of
    them leaves for infinity, or comes to rest far out, no density that ends near the scales
    is stationary (the fluid limit, S. P. Meyn and R. L. Tweedie, Adv. Appl. Prob. 25, 1993, 518).
    """
    scales = np.array(process.energy_scales)
    ratios = np.stack([np.ones_like(RATIOS), RATIOS], axis=1)
    rays = np.concatenate([ratios, ratios[:, ::-1]])
    far = np.maximum(FAR_OUT[:, None, None] * rays, 1.0)
    drift = process.coefficients((far * scales).reshape(-1, 2)).drift
    if np.all(np.sum(drift / scales, axis=1) < 0.0):
        return
    for start in far[-1]:
        level = _followed(process, scales, np.log(start))
        if level > np.log(RETURNED):
            H1, H2 = start * scales
            raise NotCertified(
                f"the density does not fall off: nothing brings the energies back from H1 = "
                f"{H1:.3g}, H2 = {H2:.3g}"
            )


def _followed(process: Process, scales: Array, start: Array) -> float:
    """ln of the larger energy, in units of the scales, where the path from ``start`` ends."""

    def velocity(_: float, x: Array) -> Array:
        H = scales * np.exp(np.maximum(x, 0.0))
        c = process.coefficients(H[None])
        b = np.diagonal(c.diffusion[0])
        v = c.drift[0] / H - 0.5 * b / H**2
        # Noise holds an energy at its scale; the length of the path is what time is counted by.
        v = np.where(v < 0.0, v * np.clip(x, 0.0, 1.0), v)
        size = np.max(np.abs(v))
        return np.asarray(v / size if size > 0.0 else v)

    def over(_: float, x: Array) -> float:
        top = float(np.max(x))
        return min(top - np.log(RETURNED), np.max(start) + np.log(ESCAPED) - top)

    over.terminal = True  # type: ignore[attr-defined]
    path = solve_ivp(
        velocity, (0.0, FLOW), start, method="LSODA", events=over, rtol=1e-6, max_step=1.0
    )
    # An event ends the path on either side of it by the accuracy of its root.
    return float(np.max(path.y[:, -1])) - 1e-6
