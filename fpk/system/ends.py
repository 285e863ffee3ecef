"""Ends of the energies of a process: Feller classes, and whether anything brings it back."""

from dataclasses import dataclass

import numpy as np

from fpk.numeric.arrays import Array
from fpk.numeric.errors import NotCertified
from fpk.system.process import Coefficients, Process, log_density_slope_error

NEAR, FAR, BESIDE = 1e-6, 1e4, 1.05
"""Energies, in units of the scale, at which the limits at both ends are read off, and the ratio of
a second energy far out to ``FAR``: both give the order of the drift. It is so near to 1 that many
contact masses are mostly integrated along one line for both."""
LINEAR = 1e-2
"""Orders up to 1 + ``LINEAR`` of the drift, and within it of σ² at rest, count as linear: damping
by q² between stops of a power law of exponent e has the order 1 + 2/(1 + e)."""
FAR_OUT = np.logspace(4.0, 16.0, 13)
"""Energies, in units of the scale, at which a process has to come back. A term of the damping that
outweighs one of a lower degree only beyond 1e16 is less than its round-off (2e-16) at the scale."""
MAX_ENERGY = 1e154
"""Largest energy whose square is a number in double precision."""
OUT_OF_RANGE = "the coefficients leave the range of double precision: choose other units"
"""Message where the equation cannot be evaluated as far out as its density has to fall off."""
LOG_RATIOS = np.log(10.0) * np.concatenate(
    [np.arange(-48.0, -3.0, 0.5), np.linspace(-3.0, 3.0, 49), np.arange(3.5, 48.5, 0.5)]
)
"""ln of the ratios of two energies far out: one that the other, 1e16 times its scale, damps is
held by noise at 1e-16 of its own scale."""


@dataclass(frozen=True)
class BoundaryClass:
    """Kind of one end in Feller's sense, in the words of stochastic averaging, and why."""

    end: str
    kind: str
    reason: str


def classify(process: Process, axis: int = 0) -> tuple[BoundaryClass, BoundaryClass]:
    """Return the classes of H_i = 0 and H_i = ∞ of energy ``axis``; none takes a condition.

    At H = 0 with b ~ β H the scale density is ~ H^(−κ) and the speed density ~ H^(κ−1),
    κ = 2 s(0)/β. At infinity the scale diverges where the drift points inwards, and the process
    comes back in finite time when ∫dH/|s| converges. The other energies are at 0, 1 or 10 times
    their scales, all or one alone, and the least favourable decides.
    """
    rest = process.dimension - 1
    name = f"H{axis + 1}" if rest else "H"
    levels = [np.full(rest, level) for level in ((0.0, 1.0, 10.0) if rest else (0.0,))]
    levels += [level * row for level in (1.0, 10.0) if rest > 1 for row in np.eye(rest)]

    def along(share: float) -> tuple[Array, Array, Array, Coefficients]:
        """H_i = ``share`` of its scale, s_i and b_ii there at all levels of the others."""
        energy = np.insert(np.array(levels), axis, share, axis=1) * np.array(process.energy_scales)
        c = process.at(energy)
        return energy[:, axis], c.drift[:, axis], c.diffusion[:, axis, axis], c

    energy, drift, diffusion, _ = along(NEAR)
    order = np.log2(along(2.0 * NEAR)[2] / diffusion)
    worst = float(order[np.argmax(np.abs(order - 1.0))])
    # The extrapolated κ is that of H = NEAR, whose distance from the limit is of order NEAR.
    kappa = float(np.min(2.0 * drift * energy / diffusion))
    if abs(worst - 1.0) > LINEAR:
        lower = BoundaryClass(f"{name} = 0", "not classified", f"σ² ~ H^{worst:.3g}, not ~ H")
    else:
        kind, words = "exit", "the process ends there"
        if kappa > 1.0 - 1e-3:
            kind, words = "entrance", "the process leaves it and never comes back"
        elif kappa > 0.0:
            kind, words = "regular", "the process reaches it"
        least = " at the least" if rest else ""
        reason = f"σ² ~ H and 2 s H/σ² → {kappa:.4g}{least}: {words}"
        lower = BoundaryClass(f"{name} = 0", kind, reason)
    (_, drift, _, near), (_, farther, _, _) = along(FAR), along(BESIDE * FAR)
    if np.any(farther >= 0.0):
        return lower, BoundaryClass(f"{name} = ∞", "not confining", "the drift points outwards")
    inwards = drift < 0.0
    power = float(np.min(np.log(farther / drift))) / np.log(BESIDE) if inwards.all() else 0.0
    reason = "the drift points inwards, about as −" + name
    reason += "" if f"{power:.2g}" == "1" else f"^{power:.2g}"
    # An error of either drift; 0 where the process gives none.
    slack = 2.0 * float(np.max(np.nan_to_num(near.relative_error))) / np.log(BESIDE)
    kind, words = "natural", ": neither reached nor left in finite time"
    if power > 1.0 + LINEAR + slack:
        kind, words = "entrance", ", so it is left in finite time"
    return lower, BoundaryClass(f"{name} = ∞", kind, reason + words)


def require_falling(energy: Array, c: Coefficients, slope: Array) -> None:
    """Raise ``NotCertified`` where p H of one energy rises at the last, highest ``energy``.

    ``slope`` is d ln p/dH. p has a finite integral where the rate d ln(p H)/d ln H = 1 + H slope is
    negative there, beyond its error. A rise in between shows in the mass beyond the mesh.
    """
    if energy[-1] * slope[-1] < -1.0:
        return
    rate = 1.0 + energy * slope
    error = energy * np.nan_to_num(log_density_slope_error(c))
    inwards = np.flatnonzero(~(rate > error))
    first = int(inwards[-1]) + 1 if inwards.size else 0
    if first < energy.size:
        if energy[first] > MAX_ENERGY:
            raise NotCertified(OUT_OF_RANGE)
        raise NotCertified(
            f"the density does not fall off: from H = {energy[first]:.3g} on the drift points "
            "outwards, so nothing brings the energy back"
        )


def require_confined(process: Process) -> None:
    """Raise ``NotCertified`` where two energies leave for infinity together.

    Far out dH_i = s_i dt. The ratio of the two quickly approaches a value at which
    s_1/H_1 − s_2/H_2 falls through zero as it grows, while both change by the larger one's s/H:
    where that is positive at the highest of ``FAR_OUT`` no density that falls off is stationary.
    """
    scales = np.array(process.energy_scales)
    shares = np.exp(np.stack([np.minimum(LOG_RATIOS, 0.0), -np.maximum(LOG_RATIOS, 0.0)], axis=1))
    H = FAR_OUT[-1] * scales * shares
    v = process.coefficients(H).drift / H
    turning, growth = v[:, 0] - v[:, 1], np.where(LOG_RATIOS < 0.0, v[:, 1], v[:, 0])
    signed = np.flatnonzero(turning)
    attracts = (turning[signed[:-1]] > 0.0) & (turning[signed[1:]] < 0.0)
    k, m = signed[:-1][attracts], signed[1:][attracts]
    # Linear between two ratios; where the difference is below round-off over more, the middle.
    share = np.where(m == k + 1, turning[k] / (turning[k] - turning[m]), 0.5)
    leaving = np.flatnonzero(growth[k] + share * (growth[m] - growth[k]) > 0.0)
    if leaving.size:
        at = k[leaving[0]]
        raise NotCertified(
            f"the density does not fall off along H{1 if v[at, 0] > 0.0 else 2}: nothing brings "
            f"the energies back from H1 = {H[at, 0]:.3g}, H2 = {H[at, 1]:.3g}"
        )
