"""The compiled paths of the full system: single trajectories from their records on."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from math import sqrt
from pathlib import Path
from threading import Lock
from typing import Any, Literal

import numpy as np
from numba import njit

from fpk.arrays import Array, Integers
from fpk.compiled_laws import compiled_laws, law_files, of_law
from fpk.compiling import ROOT, cached_njit, checksum, inlined
from sim.arrays import StepArrays
from sim.kernel import KERNEL
from sim.motion.between import cubic_of, distance_to, energy_at, largest_of
from sim.parts.contact import contact_forces, kick_by_contact, numbers_of, overlap_of
from sim.parts.linear import ONE_LOOP, map_state
from sim.random import GOLDEN
from sim.splitting.arrays import LEVELS, Paths, Score, Watched
from sim.splitting.parts import (
    begin,
    bridge_maximum,
    draw_normals,
    level_of,
    place,
    record,
)

NAMES = ("motion/between", "splitting/arrays", "splitting/parts", "splitting/kernel")
OWN = tuple(f"sim/{name}.py" for name in NAMES)

BELOW = 1.0 - 2.0**-53
"""Share of the limit at most of what has not passed it."""

_COMPILING = Lock()


@dataclass(frozen=True)
class PathKey:
    """What paths are compiled for: contact laws, damping terms, and what the limit is on."""

    kind: Literal["H", "modal", "q"]
    laws: tuple[str, ...]
    damping: bool
    energy_damping: bool
    masses: int
    pairs: int


def paths_checksum(laws: Sequence[str], root: Path = ROOT) -> int:
    """Return a checksum of the sources that paths with contact ``laws`` are compiled from."""
    return checksum([*(root / name for name in (*KERNEL, *OWN)), *law_files(laws, root)])


def compiled_paths(key: PathKey) -> Any:
    """Return the function that renews paths, one for all threads."""
    with _COMPILING:
        return _compiled(key)


@inlined
def observed_state(x: Array, g: Array, step: StepArrays, damping: Array, to: Array) -> None:
    """Write (q*, p*) of the state before the kick, as ``sim.parts.observed`` does for a block."""
    n = step.half_inverse_mass.size
    for r in range(2 * n):
        to[r] = x[r]
    for slot in range(step.slot_mass.size):
        i, a = step.slot_mass[slot], step.slot_shift[slot]
        force, slope = g[2 * slot], g[2 * slot + 1]
        to[i] -= a * force
        to[n + i] = (x[n + i] - 0.5 * step.dt * force * (1.0 - a * slope)) * (1.0 + a * slope)
    for i in range(n):
        for slot in range(step.slot_mass.size):
            to[n + i] += damping[i, slot] * step.slot_shift[slot] * g[2 * slot]


@inlined
def energy_of(x: Array, step: StepArrays, law: Any) -> float:
    """Return H of the state x = (q, p)."""
    n, H = step.half_inverse_mass.size, 0.0
    for i in range(n):
        H += step.half_inverse_mass[i] * x[n + i] * x[n + i]
        for j in range(n):
            H += 0.5 * step.stiffness_matrix[i, j] * x[i] * x[j]
    for stop in range(step.stop_slot.size):
        sign, clearance, B, e, kind, _ = numbers_of(step, stop)
        _, o = overlap_of(x[step.slot_mass[step.stop_slot[stop]]], sign, clearance)
        if o > 0.0:
            H += B * of_law(law, kind, o, e)
    return float(H)


@inlined
def term_forces(x: Array, H: float, step: StepArrays, to: Array) -> None:
    """Write Σ_j c̃_ij v_j of the damping terms at the state x."""
    n, terms = step.half_inverse_mass.size, step.terms
    for i in range(n):
        to[i] = 0.0
    for k in range(terms.target.size):
        force = terms.scale[k]
        for f in range(terms.first[k], terms.first[k + 1]):
            force *= x[terms.factor[f]]
        for _ in range(terms.energy[k]):
            force *= H
        to[terms.target[k] - n] += force


@njit(inline="always")
def damped(
    x: Array, work: Array, force: Array, step: StepArrays, with_energy: bool, law: Any
) -> None:
    """Advance the momenta by the damping terms over half a step, by the midpoint rule."""
    n, t = step.half_inverse_mass.size, 0.5 * step.dt
    H = energy_of(x, step, law) if with_energy else 0.0
    term_forces(x, H, step, force)
    for r in range(n):
        work[r] = x[r]
        work[n + r] = x[n + r] - 0.5 * t * force[r]
    H = energy_of(work, step, law) if with_energy else 0.0
    term_forces(work, H, step, force)
    for r in range(n):
        x[n + r] -= t * force[r]


@inlined
def form_of(form: Array, p: Array) -> float:
    """Return pᵀ ``form`` p."""
    total = 0.0
    for i in range(p.size):
        for j in range(p.size):
            total += form[i, j] * p[i] * p[j]
    return float(total)


@njit(inline="always")
def watch(kind: str, x: Array, step: StepArrays, watched: Watched, law: Any, seen: Array) -> None:
    """Write what is ``seen`` (c, 3) at the observed state x: the distance to the limit first.

    Of an energy it is that of ``distance_to``; the others are σ² and β, of a displacement q and v.
    """
    n = step.half_inverse_mass.size
    if kind == "q":
        i = watched.mass
        seen[0, 0] = watched.limit[0] - abs(x[i])
        seen[0, 1], seen[0, 2] = x[i], 2.0 * step.half_inverse_mass[i] * x[n + i]
    else:
        p, diffusion = x[n:], watched.diffusion
        for m in range(watched.limit.size):
            H = energy_of(x, step, law) if kind == "H" else modal_energy(x, watched, m)
            variance = form_of(diffusion.variance[m], p)
            growth = form_of(diffusion.growth[m], p)
            beta = growth / variance if growth > 0.0 else diffusion.at_rest[m]
            seen[m, 0] = distance_to(watched.limit[m], H, variance, beta)
            seen[m, 1], seen[m, 2] = variance, beta


@inlined
def modal_energy(x: Array, watched: Watched, m: int) -> float:
    """Return H_m of row m at the observed state x."""
    n, Q, P = watched.mode_q.shape[1], 0.0, 0.0
    for r in range(n):
        Q += watched.mode_q[m, r] * x[r]
        P += watched.mode_p[m, r] * x[n + r]
    return float(0.5 * (Q * Q + P * P))


@inlined
def reached_share(x: Array, step: StepArrays, watched: Watched, law: Any) -> float:
    """Return √(E_i/E_f) of the displacement of one mass at the observed state x, below 1."""
    root, contact = 0.0, 0.0
    for m in range(watched.reach.size):
        root += watched.reach[m] * sqrt(modal_energy(x, watched, m))
    for stop in range(step.stop_slot.size):
        if step.slot_mass[step.stop_slot[stop]] == watched.mass:
            sign, clearance, B, e, kind, _ = numbers_of(step, stop)
            _, o = overlap_of(x[watched.mass], sign, clearance)
            if o > 0.0:
                contact += B * of_law(law, kind, o, e)
    return min(sqrt(root * root + contact / watched.energy), BELOW)


@njit(inline="always")
def share_of(
    kind: str, x: Array, left: float, step: StepArrays, watched: Watched, law: Any, seen: Array,
    m: int,
) -> float:  # fmt: skip
    """Return x of the score at the observed state x, 1 where no distance to the limit is ``left``.

    ``left`` is the least since the step before; of an energy the share is that of H there.
    """
    if left <= 0.0:
        return 1.0
    if kind == "q":
        return reached_share(x, step, watched, law)
    limit = watched.limit[m]
    H = energy_at(limit, left, seen[m, 1], seen[m, 2])
    return min(sqrt(max(H, 0.0) / limit), BELOW)


@lru_cache
def _compiled(key: PathKey) -> Any:
    kind, pairs, damping, energy_damping = key.kind, key.pairs, key.damping, key.energy_damping
    contact = bool(key.laws)
    loop = key.masses if (key.masses, pairs) in ONE_LOOP else 0
    sources = paths_checksum(key.laws)
    force: Any = compiled_laws(key.laws, "force") if contact else None
    slope: Any = compiled_laws(key.laws, "slope") if contact else None
    law: Any = compiled_laws(key.laws, "energy") if contact else None

    @cached_njit()
    def renew(
        dead: Integers, parents: Integers, level: int, first: int, offset: np.uint64,
        step: StepArrays, watched: Watched, score: Score, paths: Paths,
    ) -> int:  # fmt: skip
        """Replace the paths ``dead`` by ``parents`` up to where they exceed ``level``, then anew.

        ``first`` is the number of the stream of the first one. Returns the checksum of its sources.
        """
        n, h, c = step.half_inverse_mass.size, step.dt, watched.limit.size
        matrix, words = step.matrix, pairs + c
        g0 = matrix.shape[1] + 2 * n
        s = np.zeros(g0 + 2 * step.slot_mass.size)
        x, g = s[: 2 * n], s[g0:]
        observed, work, terms = np.zeros(2 * n), np.zeros(2 * n), np.zeros(n)
        z, word = np.zeros(2 * pairs, np.float32), np.zeros(2, np.uint32)
        seen, before = np.zeros((c, 3)), np.zeros((c, 3))
        for number in range(dead.size):
            i = dead[number]
            done = begin(paths, i, parents[number], level, x)
            begun, top, records = done, paths.level[i, 0], 1
            contact_forces(s, g0, step, force, slope, 1)
            if level < 0:  # states to start from are in the middle of the kick
                for slot in range(step.slot_mass.size):
                    a = step.slot_shift[slot]
                    kick = 0.5 * h * g[2 * slot] * (1.0 - a * g[2 * slot + 1])
                    x[n + step.slot_mass[slot]] += kick
            observed_state(x, g, step, watched.damping, observed)
            watch(kind, observed, step, watched, law, seen)
            if level < 0:
                for m in range(c):
                    share = share_of(kind, observed, seen[m, 0], step, watched, law, seen, m)
                    top = max(top, level_of(score, m, share, 0))
                record(paths, i, 0, x, top, 0)

            while done < score.steps and top < LEVELS:
                before[:] = seen
                kick_by_contact(s, g0, step, n, 1)
                if damping:
                    damped(x, work, terms, step, energy_damping, law)
                at = place(first + number, (done - begun) * words, offset)
                draw_normals(z, word, at, pairs)
                map_state(s, z, matrix, step, loop, (False, False), pairs, force, slope, 1, 1, 2)
                if damping:
                    damped(x, work, terms, step, energy_damping, law)
                contact_forces(s, g0, step, force, slope, 1)
                observed_state(x, g, step, watched.damping, observed)
                watch(kind, observed, step, watched, law, seen)
                done += 1
                reached = 0
                for m in range(c):
                    if kind == "q":
                        q0, v0, q1, v1 = before[0, 1], before[0, 2], seen[0, 1], seen[0, 2]
                        left = watched.limit[0] - largest_of(cubic_of(q0, v0, q1, v1, h))
                    else:
                        u = at + np.uint64(pairs + m) * GOLDEN
                        left = -bridge_maximum(-before[m, 0], -seen[m, 0], h, u)
                    share = share_of(kind, observed, left, step, watched, law, seen, m)
                    reached = max(reached, level_of(score, m, share, done))
                if reached > top:
                    top = reached
                    record(paths, i, records, x, top, done)
                    records += 1
            paths.best[i] = top
            paths.moved[i] += done - begun
        return sources

    return renew
