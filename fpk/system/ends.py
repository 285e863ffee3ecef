"""Boundaries H = 0 and H = ∞ of a process: Feller's classes, and whether the drift confines it."""

from dataclasses import dataclass

import numpy as np

from fpk.numeric.arrays import Array
from fpk.numeric.errors import NotCertified
from fpk.system.contact import MAX_EXPONENT
from fpk.system.process import Coefficients, Process, log_density_slope_error

NEAR, FAR, BESIDE = 1e-6, 1e4, 1.05
"""Energies, in units of ``Process.energy_scales``, at which the limits H → 0 and H → ∞ are
evaluated. The order of the drift follows from FAR and BESIDE · FAR, so close that shell integrals
with many contact masses mostly serve both."""

FAR_OUT = np.logspace(4.0, 16.0, 13)
"""Energies, in units of their scale, at which the drift must point inwards. A damping term that
exceeds another of lower degree only beyond 1e16 is less than its round-off (2e-16) at the scale."""
MAX_ENERGY = 1e154
"""Largest energy whose square does not overflow."""
OUT_OF_RANGE = "the coefficients leave the range of double precision: choose other units"
"""Message if coefficients overflow at energies that the density has not yet left."""
LOG_RATIOS = np.log(10.0) * np.concatenate(
    [np.arange(-48.0, -3.0, 0.5), np.linspace(-3.0, 3.0, 49), np.arange(3.5, 48.5, 0.5)]
)
"""ln(H1/H2) at which two energies far out are tested, in units of their scales. Noise keeps an
energy near 1e-16 of its scale that another damps at 1e16 of its own: a ratio of 1e32."""


@dataclass(frozen=True)
class BoundaryClass:
    """Feller class ``kind`` of an ``end`` such as "H1 = 0" or "H = ∞", and the ``reason`` in words.

    At 0 the ``kind`` is "exit", "regular", "entrance" or "not classified", at ∞ "natural",
    "entrance" or, if the drift points outwards, "not confining".
    """

    end: str
    kind: str
    reason: str


def classify(process: Process, axis: int = 0) -> tuple[BoundaryClass, BoundaryClass]:
    """Return the Feller classes of H_i = 0 and of H_i = ∞, i = ``axis`` counted from 0.

    No class takes a boundary condition. At H = 0 with b ~ β H the scale density is ~ H^(−κ) and the
    speed density ~ H^(κ−1), κ = 2 s(0)/β. At infinity the scale function diverges if the drift
    points inwards, and the process returns in finite time if ∫dH/|s| converges. With several
    energies, the others are put at 0, 1 or 10 times their scales, together or one by one, and the
    least favourable case decides.
    """
    # The smallest exponent of the drift above 1, of damping by q² between stops of the highest
    # exponent e, is 1 + 2/(1 + e): exponents within half of the difference count as 1.
    linear, rest = 1.0 / (1.0 + MAX_EXPONENT), process.dimension - 1
    name = f"H{axis + 1}" if rest else "H"
    levels = [np.full(rest, level) for level in ((0.0, 1.0, 10.0) if rest else (0.0,))]
    levels += [level * row for level in (1.0, 10.0) if rest > 1 for row in np.eye(rest)]

    def along(share: float) -> tuple[Array, Array, Array, Coefficients]:
        """Return H_i = ``share`` times its scale, s_i, b_ii, (levels,) each, and coefficients."""
        energy = np.insert(np.array(levels), axis, share, axis=1) * np.array(process.energy_scales)
        c = process.at(energy)
        return energy[:, axis], c.drift[:, axis], c.diffusion[:, axis, axis], c

    energy, drift, diffusion, _ = along(NEAR)
    order = np.log2(along(2.0 * NEAR)[2] / diffusion)
    worst = float(order[np.argmax(np.abs(order - 1.0))])
    # κ is evaluated at H = NEAR: it differs from the limit by the order of NEAR.
    kappa = float(np.min(2.0 * drift * energy / diffusion))
    if abs(worst - 1.0) > linear:
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
    # Error of the exponent by the errors of both drifts; 0 if the process gives none.
    slack = 2.0 * float(np.max(np.nan_to_num(near.relative_error))) / np.log(BESIDE)
    kind, words = "natural", ": neither reached nor left in finite time"
    if power > 1.0 + linear + slack:
        kind, words = "entrance", ", so it is left in finite time"
    return lower, BoundaryClass(f"{name} = ∞", kind, reason + words)


def require_falling(energy: Array, c: Coefficients, slope: Array) -> None:
    """Raise ``NotCertified`` if p(H) H of one energy rises at the highest ``energy``.

    ``energy`` (points,) ascend, with coefficients ``c`` and ``slope`` d ln p/dH there. p has a
    finite integral if the rate d ln(p H)/d ln H = 1 + H slope is negative at the end; a rate that
    does not exceed its error, or is NaN, is accepted. A rise before the end would show in the mass
    beyond the mesh.
    """
    if energy[-1] * slope[-1] < -1.0:
        return
    rate = 1.0 + energy * slope
    error = energy * np.nan_to_num(log_density_slope_error(c))
    inwards = np.flatnonzero(~(rate > error))
    first = int(inwards[-1]) + 1 if inwards.size else 0
    if first < energy.size:
        words = f"the density does not fall off: from H = {energy[first]:.3g} on the drift points"
        words += " outwards, so nothing brings the energy back"
        raise NotCertified(OUT_OF_RANGE if energy[first] > MAX_ENERGY else words)


def require_confined(process: Process) -> None:
    """Raise ``NotCertified`` if the two energies of ``process`` grow to infinity together.

    Far out dH_i = s_i dt. The ratio H_1/H_2 quickly approaches an attracting value, at which
    s_1/H_1 − s_2/H_2 changes from positive to negative as the ratio grows. Both energies then grow
    at the relative rate s/H of the larger: if that is positive at the highest of ``FAR_OUT``, no
    stationary density exists.
    """
    scales = np.array(process.energy_scales)
    shares = np.exp(np.stack([np.minimum(LOG_RATIOS, 0.0), -np.maximum(LOG_RATIOS, 0.0)], axis=1))
    H = FAR_OUT[-1] * scales * shares
    v = process.coefficients(H).drift / H
    turning, growth = v[:, 0] - v[:, 1], np.where(LOG_RATIOS < 0.0, v[:, 1], v[:, 0])
    signed = np.flatnonzero(turning)
    attracts = (turning[signed[:-1]] > 0.0) & (turning[signed[1:]] < 0.0)
    k, m = signed[:-1][attracts], signed[1:][attracts]
    # Zero by linear interpolation between two ratios; in the middle of a range of exact zeros.
    share = np.where(m == k + 1, turning[k] / (turning[k] - turning[m]), 0.5)
    leaving = np.flatnonzero(growth[k] + share * (growth[m] - growth[k]) > 0.0)
    if leaving.size:
        at = k[leaving[0]]
        raise NotCertified(
            f"the density does not fall off along H{1 if v[at, 0] > 0.0 else 2}: nothing brings "
            f"the energies back from H1 = {H[at, 0]:.3g}, H2 = {H[at, 1]:.3g}"
        )
