"""The compiled paths of splitting: records, score, limits, and single trajectories of the system.

A trajectory is a block of one lane. The score is a share of the limit by which paths are ranked.
"""

from math import exp, sqrt
from typing import Any, NamedTuple

import numpy as np

from fpk.numeric.arrays import Array, Integers
from fpk.numeric.compiling import ROOT, cached_njit, checksum, inlined
from fpk.system.compiled_laws import compiled_laws, law_files, of_law
from sim.questions.passing import (
    NATS,
    SOURCES,
    Diffusion,
    cubic_of,
    distance_to,
    first_passage,
    form_of,
)
from sim.step.arrays import StepArrays, WatchArrays
from sim.step.kernel import KERNEL, KernelKey, once
from sim.step.lanes import kick, row
from sim.step.parts import forces
from sim.step.parts.linear import map_state
from sim.step.parts.observed import observe
from sim.step.random import GOLDEN, Halves, Singles, box_muller, mixed_seed, mixed_word

FILES = tuple(dict.fromkeys((*KERNEL, *SOURCES, "sim/questions/splitting/kernel.py")))
"""Files that the paths are compiled from."""
LEVELS = 2048
"""Levels of the score from 0 to failure: few enough that the records of a path stay short, each a
factor of 1.01 to 1.05 of the probabilities from 1e-10 to 1e-40."""


class Paths(NamedTuple):
    """The states at which the score of each replica rose to a new level, the last its largest."""

    state: Array  # (replicas, records, coordinates)
    level: Integers  # (replicas, records), ascending
    step: Integers  # (replicas, records), number of steps made by then
    best: Integers  # (replicas,), largest level; LEVELS is failure
    moved: Integers  # (replicas,), steps simulated so far


class Score(NamedTuple):
    """Levels over x, the share of the limit, and over the remaining time, both on square grids.

    ``table`` (coordinates, rows + 1, columns + 1): x = column/columns, of remaining time the share
    (row/rows)². Failure is x >= 1 of any coordinate, whatever the table says.
    """

    table: Array
    steps: int


class LimitArrays(NamedTuple):
    """The limit of a first passage: of c modal energies or, with c = 1, of one displacement q_i.

    E_f is the energy of failure. The score of a displacement depends on E_i/E_f, E_i the energy
    that its motion has; ``reach`` gives it from the modal energies H_m (``problem.limit_arrays``).
    """

    values: Array  # (c,)
    diffusion: Diffusion  # of the energies, none of a displacement
    reach: Array  # (n,), √(H_m/E_f) times these add up to √(E_i/E_f) without contact
    energy: float  # E_f
    mass: int  # of the displacement, from 0


class CompiledReplicas:
    """Paths of one repetition from ``states`` (N, d), with room for so many ``steps``.

    A compiled ``function`` renews them by numbers, the ``model``. Every renewed path has a stream
    of its own, of those that begin with the seed ``seed``.
    """

    def __init__(
        self, function: Any, model: tuple[Any, ...], states: Array, steps: int, seed: int
    ) -> None:
        """Make the paths from their starts."""
        (replicas, coordinates), records = states.shape, min(steps, LEVELS) + 1
        # Only what is written takes memory.
        state = np.empty((replicas, records, coordinates))
        state[:, 0] = states
        level, step = (np.empty((replicas, records), dtype=np.int64) for _ in range(2))
        level[:, 0] = step[:, 0] = 0
        self.best, moved = np.zeros((2, replicas), dtype=np.int64)
        self.paths = Paths(state, level, step, self.best, moved)
        self.function, self.model, self.offset = function, model, mixed_seed(seed)
        self.streams, every = 0, np.arange(replicas)
        self.renew(every, every, -1)

    def renew(self, dead: Integers, parents: Integers, level: int) -> None:
        """Replace ``dead`` by ``parents`` up to where they exceed ``level``, then by new paths."""
        self.function(dead, parents, level, self.streams, self.offset, *self.model, self.paths)
        self.streams += dead.size


@inlined
def begin(paths: Paths, i: int, parent: int, level: int, x: Array) -> int:
    """Make the first record of ``parent`` above ``level`` the only one of ``i``, and its state x.

    Returns the number of steps made by then.
    """
    m = 0
    while paths.level[parent, m] <= level:
        m += 1
    x[:] = paths.state[parent, m]
    paths.state[i, 0] = x
    paths.level[i, 0] = paths.level[parent, m]
    paths.step[i, 0] = paths.step[parent, m]
    return int(paths.step[i, 0])


@inlined
def record(paths: Paths, i: int, records: int, x: Array, level: int, step: int) -> None:
    """Write a state as the record number ``records`` of replica i."""
    paths.state[i, records] = x
    paths.level[i, records], paths.step[i, records] = level, step


@inlined
def level_of(score: Score, coordinate: int, x: float, step: int) -> int:
    """Return the level of the share x of the limit after ``step`` steps, by bilinear tables."""
    if not x < 1.0:
        return LEVELS if x >= 1.0 else 0
    rows, columns = score.table.shape[1] - 1, score.table.shape[2] - 1
    u, v = x * columns, np.sqrt(1.0 - step / score.steps) * rows
    j, k = min(int(u), columns - 1), min(int(v), rows - 1)
    a, b = u - j, v - k
    t = score.table[coordinate]
    low = t[k, j] + a * (t[k, j + 1] - t[k, j])
    high = t[k + 1, j] + a * (t[k + 1, j + 1] - t[k + 1, j])
    return min(int(low + b * (high - low)), LEVELS - 1)


@inlined
def place(trajectory: int, counter: int, offset: np.uint64) -> np.uint64:
    """Return the place of a word in the sequence of ``sim.step.random``."""
    return ((np.uint64(trajectory) << np.uint64(40)) + np.uint64(counter)) * GOLDEN + offset


@inlined
def draw_normals(z: Singles, word: Halves, at: np.uint64, pairs: int) -> None:
    """Write ``pairs`` pairs of normals from the words that begin at the place ``at``."""
    words = word.view(np.uint64)
    for pair in range(pairs):
        words[0] = mixed_word(at + np.uint64(pair) * GOLDEN)
        box_muller(z[2 * pair :], word, 1)


@inlined
def uniform(at: np.uint64) -> float:
    """Return the uniform number in (0, 1) at a place."""
    return (np.float64(mixed_word(at) >> np.uint64(11)) + 0.5) * 2.0**-53


@inlined
def reached_share(
    s: Array, step: StepArrays, watch: WatchArrays, limit: LimitArrays, law: Any
) -> float:
    """Return √(E_i/E_f) of the displacement of one mass at the observed state."""
    root, contact = 0.0, 0.0
    for m in range(limit.reach.size):
        root += limit.reach[m] * sqrt(s[watch.traced[m]])
    for stop in range(step.stop_slot.size):
        if step.slot_mass[step.stop_slot[stop]] == limit.mass:
            sign, clearance, B, e, kind = forces.numbers_of(step, stop)
            _, o = forces.overlap_of(s[watch.at.q + limit.mass], sign, clearance)
            contact += B * of_law(law, kind, o, e)
    return sqrt(root * root + contact / limit.energy)


@inlined
def see(
    seen: Array, s: Array, step: StepArrays, watch: WatchArrays, limit: LimitArrays, of_q: bool
) -> None:
    """Write the distance to each limit, and q, v of a displacement, or σ² and its growth."""
    if of_q:
        mass = limit.mass
        q, v = s[watch.at.q + mass], 2.0 * step.half_inverse_mass[mass] * s[watch.at.p + mass]
        seen[0, 0], seen[0, 1], seen[0, 2] = limit.values[0] - abs(q), q, v
    else:
        noise = limit.diffusion
        for m in range(limit.values.size):
            variance, growth = seen[m, 1:2], seen[m, 2:3]
            form_of(variance, s, watch.at.p, noise.variance[m], 1)
            form_of(growth, s, watch.at.p, noise.growth[m], 1)
            numbers = variance[0], growth[0], noise.at_rest[m]
            seen[m, 0] = distance_to(limit.values[m], s[watch.traced[m]], *numbers)


@inlined
def passed(before: Array, seen: Array, limit: float, h: float, word: np.uint64, of_q: bool) -> bool:
    """Return whether a limit is passed between two looks (3,), one step h apart, or at the second.

    By an energy it is with the probability of a Brownian bridge, of the uniform number at ``word``.
    """
    if of_q:
        return first_passage(cubic_of(before[1], before[2], seen[1], seen[2], h), limit) <= 1.0
    exponent = 2.0 * before[0] * seen[0] / h
    if before[0] <= 0.0 or seen[0] <= 0.0:
        return True
    return exponent < NATS and uniform(word) < exp(-exponent)


@once
def compiled_paths(key: KernelKey, kind: str) -> Any:
    """Return the function that renews paths; ``kind`` is that of the limit."""
    pairs, damping, energy_damping = key.pairs, key.damping, key.energy_damping
    energy, modes, contact, displacement = key.energy, key.modes, bool(key.laws), kind == "q"
    sources = checksum([*(ROOT / name for name in FILES), *law_files(key.laws, ROOT)])
    laws: Any = [
        compiled_laws(key.laws, x) if contact else None for x in ("force", "slope", "energy")
    ]
    force, slope, law = laws

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
                forces.contact_forces(s, at.contact, step, force, slope, 1)
                if energy_damping:
                    forces.spring_energy(s, V, step, 1)
                    forces.add_contact(s, 0, at.work + 1, step, law, False, 1)
                if damping and done > begun:
                    for k in range(terms.target.size):
                        forces.term_flow(s, at.work, step, k, energy_damping, 1)
                if records == 0:
                    for slot in range(step.slot_mass.size):
                        r, g = n + step.slot_mass[slot], row(s, at.contact + 2 * slot, 2, 1)
                        kick(row(s, r, 1, 1), g, -0.5 * h, step.slot_shift[slot], 1)
                before[:] = seen
                observe(
                    s, V, H, step, watch, contact, damping, energy_damping, True, energy, modes,
                    False, force, law, 1,
                )  # fmt: skip
                see(seen, s, step, watch, limit, displacement)
                if records == 0 or done > begun:
                    reached = -1
                    for m in range(c):
                        gone, u = seen[m, 0] <= 0.0, words + np.uint64(pairs + m) * GOLDEN
                        if done > begun:
                            gone = passed(before[m], seen[m], limit.values[m], h, u, displacement)
                        if displacement:
                            share = reached_share(s, step, watch, limit, law)
                        else:
                            share = sqrt(max(s[watch.traced[m]], 0.0) / limit.values[m])
                        # What has not passed the limit has not failed, to round-off either.
                        inside = min(level_of(score, m, share, done), LEVELS - 1)
                        reached = max(reached, LEVELS if gone else inside)
                    if reached > top:
                        top = reached
                        record(paths, i, records, x, top, done)
                        records += 1
                if done >= score.steps or top >= LEVELS:
                    break

                # Kick, the other half of the damping in reverse, and the linear map.
                forces.kick_by_contact(s, at.contact, step, n, 1)
                if damping:
                    for k in range(terms.target.size - 1, -1, -1):
                        forces.term_flow(s, at.work, step, k, energy_damping, 1)
                words = place(first + number, (done - begun) * (pairs + c), offset)
                draw_normals(z, word, words, pairs)
                map_state(s, z, step.matrix, pairs, 1, 1, 2)
                done += 1
            paths.best[i] = top
            paths.moved[i] += done - begun
        return sources

    return renew
