"""The compiled paths of the full system: single trajectories, blocks of one lane, from records."""

from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from threading import Lock
from typing import Any

import numpy as np

from fpk.arrays import Integers
from fpk.compiling import ROOT, cached_njit, checksum, compiled_laws, law_files
from sim.arrays import StepArrays, WatchArrays
from sim.kernel import KERNEL, KernelKey
from sim.lanes import kick, row
from sim.parts.contact import add_contact, contact_forces, kick_by_contact
from sim.parts.damping import spring_energy, term_flow
from sim.parts.linear import map_state
from sim.parts.observed import observe
from sim.random import GOLDEN
from sim.splitting.arrays import LEVELS, LimitArrays, Paths, Score
from sim.splitting.parts import (
    begin,
    draw_normals,
    left_after,
    level_of,
    place,
    record,
    see,
    share_of,
)

PARTS = ("arrays", "kernel", "parts")
NAMES = ("motion/between", *(f"splitting/{part}" for part in PARTS))
OWN = tuple(f"sim/{name}.py" for name in NAMES)
"""Files that paths are compiled from beside those of a kernel."""

_COMPILING = Lock()


def paths_checksum(laws: Sequence[str], root: Path = ROOT) -> int:
    """Return a checksum of the sources that paths with contact ``laws`` are compiled from."""
    return checksum([*(root / name for name in (*KERNEL, *OWN)), *law_files(laws, root)])


def compiled_paths(key: KernelKey, kind: str) -> Any:
    """Return the function that renews paths, one for all threads; ``kind`` is that of the limit."""
    with _COMPILING:
        return _compiled(key, kind)


@lru_cache
def _compiled(key: KernelKey, kind: str) -> Any:
    pairs, damping, energy_damping = key.pairs, key.damping, key.energy_damping
    energy, modes, contact = key.energy, key.modes, bool(key.laws)
    sources = paths_checksum(key.laws)
    force: Any = compiled_laws(key.laws, "force") if contact else None
    slope: Any = compiled_laws(key.laws, "slope") if contact else None
    law: Any = compiled_laws(key.laws, "energy") if contact else None

    @cached_njit()
    def renew(
        dead: Integers, parents: Integers, level: int, first: int, offset: np.uint64,
        step: StepArrays, watch: WatchArrays, limit: LimitArrays, score: Score, paths: Paths,
    ) -> int:  # fmt: skip
        """Replace the paths ``dead`` by ``parents`` up to where they exceed ``level``, then anew.

        ``first`` is the number of the stream of the first one. Recorded states lie in the middle of
        the damping and before the kick. Returns the checksum of its sources.
        """
        n, h, at, terms = step.matrix.shape[0] // 2, step.dt, watch.at, step.terms
        s, c = np.zeros(at.total), limit.values.size
        x, V, H = s[: 2 * n], row(s, at.work + 1, 1, 1), row(s, at.work + 2, 1, 1)
        z, word = np.zeros(2 * pairs, np.float32), np.zeros(2, np.uint32)
        seen, before = np.zeros((c, 3)), np.zeros((c, 3))
        for number in range(dead.size):
            i = dead[number]
            done = begin(paths, i, parents[number], level, x)
            begun, top, records, words = done, paths.level[i, 0], 1, np.uint64(0)
            if level < 0:  # the start is to be recorded anew
                top, records = -1, 0
            while True:
                # Up to the middle of the damping, where a start is in the middle of the kick, too.
                contact_forces(s, at.contact, step, force, slope, 1)
                if energy_damping:
                    spring_energy(s, V, step, 1)
                    add_contact(s, 0, at.work + 1, step, law, False, 1)
                if damping and done > begun:
                    for k in range(terms.target.size):
                        term_flow(s, at.work, step, k, energy_damping, 1)
                if records == 0:
                    for slot in range(step.slot_mass.size):
                        r, g = n + step.slot_mass[slot], row(s, at.contact + 2 * slot, 2, 1)
                        kick(row(s, r, 1, 1), g, -0.5 * h, step.slot_shift[slot], 1)

                # What is seen, and the score.
                before[:] = seen
                observe(
                    s, V, H, step, watch, contact, damping, energy_damping, True, energy, modes,
                    False, force, law, 1,
                )  # fmt: skip
                see(kind, s, step, watch, limit, seen)
                reached = -1
                if records == 0 or done > begun:
                    for m in range(c):
                        left = seen[m, 0]
                        if done > begun:
                            u = words + np.uint64(pairs + m) * GOLDEN
                            left = left_after(kind, before, seen, limit, m, h, u)
                        share = share_of(kind, s, left, step, watch, limit, law, m)
                        reached = max(reached, level_of(score, m, share, done))
                if reached > top:
                    top = reached
                    record(paths, i, records, x, top, done)
                    records += 1
                if done >= score.steps or top >= LEVELS:
                    break

                # Kick, the other half of the damping in reverse, and the linear map.
                kick_by_contact(s, at.contact, step, n, 1)
                if damping:
                    for k in range(terms.target.size - 1, -1, -1):
                        term_flow(s, at.work, step, k, energy_damping, 1)
                words = place(first + number, (done - begun) * (pairs + c), offset)
                draw_normals(z, word, words, pairs)
                map_state(s, z, step.matrix, pairs, 1, 1, 2)
                done += 1
            paths.best[i] = top
            paths.moved[i] += done - begun
        return sources

    return renew
