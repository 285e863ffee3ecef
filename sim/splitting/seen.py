"""The distance of simulated paths to a limit, at steps and between them, and their score.

The score is a share of the limit by which splitting ranks paths. All functions are compiled.
"""

from math import exp, sqrt
from typing import Any

import numpy as np
from numba import njit

from fpk.arrays import Array
from fpk.compiled_laws import of_law
from fpk.compiling import inlined
from sim.arrays import StepArrays, WatchArrays
from sim.motion.between import cubic_of, distance_to, largest_of
from sim.parts.contact import numbers_of, overlap_of
from sim.splitting.arrays import LimitArrays
from sim.splitting.parts import uniform

RAREST = 38.0
"""−ln of less than the least uniform number, 2^−54."""
BELOW = 1.0 - 2.0**-53
"""Share of the limit at most of what has not passed it."""


@inlined
def form_of(form: Array, p: Array) -> float:
    """Return pᵀ ``form`` p."""
    total = 0.0
    for i in range(p.size):
        for j in range(p.size):
            total += form[i, j] * p[i] * p[j]
    return float(total)


@njit(inline="always")
def see(
    kind: str, s: Array, step: StepArrays, watch: WatchArrays, limit: LimitArrays, seen: Array
) -> None:
    """Write what is ``seen`` (c, 3) at the observed state: the distance to the limit first.

    Of an energy it is that of ``distance_to``; of a displacement q and v come after it.
    """
    n, at = step.half_inverse_mass.size, watch.at
    if kind == "q":
        i = limit.mass
        q, v = s[at.q + i], 2.0 * step.half_inverse_mass[i] * s[at.p + i]
        seen[0, 0], seen[0, 1], seen[0, 2] = limit.values[0] - abs(q), q, v
    else:
        p, diffusion = s[at.p : at.p + n], limit.diffusion
        for m in range(limit.values.size):
            seen[m, 0] = distance_to(
                limit.values[m], s[watch.traced[m]], form_of(diffusion.variance[m], p),
                form_of(diffusion.growth[m], p), diffusion.at_rest[m],
            )  # fmt: skip


@inlined
def reached_share(
    s: Array, step: StepArrays, watch: WatchArrays, limit: LimitArrays, law: Any
) -> float:
    """Return √(E_i/E_f) of the displacement of one mass at the observed state, below 1."""
    root, contact = 0.0, 0.0
    for m in range(limit.reach.size):
        root += limit.reach[m] * sqrt(s[watch.traced[m]])
    for stop in range(step.stop_slot.size):
        if step.slot_mass[step.stop_slot[stop]] == limit.mass:
            sign, clearance, B, e, kind = numbers_of(step, stop)
            _, o = overlap_of(s[watch.at.q + limit.mass], sign, clearance)
            contact += B * of_law(law, kind, o, e)
    return min(sqrt(root * root + contact / limit.energy), BELOW)


@njit(inline="always")
def share_of(
    kind: str, s: Array, left: float, step: StepArrays, watch: WatchArrays, limit: LimitArrays,
    law: Any, m: int,
) -> float:  # fmt: skip
    """Return x of the score at the observed state, 1 where no distance to the limit is ``left``."""
    if left <= 0.0:
        return 1.0
    if kind == "q":
        return reached_share(s, step, watch, limit, law)
    return min(sqrt(max(s[watch.traced[m]], 0.0) / limit.values[m]), BELOW)


@njit(inline="always")
def left_after(
    kind: str, before: Array, seen: Array, limit: LimitArrays, m: int, h: float, at: np.uint64
) -> float:
    """Return the distance to limit m after the step h, not positive if it was passed within.

    A displacement is a cubic; an energy at the distances a and b passes with the probability
    e^(−2 a b/h), as a Brownian bridge, by the uniform number that is drawn ``at`` a place.
    """
    if kind == "q":
        cubic = cubic_of(before[0, 1], before[0, 2], seen[0, 1], seen[0, 2], h)
        return float(limit.values[0] - largest_of(cubic))
    a, b = before[m, 0], seen[m, 0]
    if a <= 0.0 or b <= 0.0:
        return 0.0
    exponent = 2.0 * a * b / h
    return 0.0 if exponent < RAREST and uniform(at) < exp(-exponent) else float(b)
