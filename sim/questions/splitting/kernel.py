"""Splitting of paths of the full system (6): starts, the score, and the compiled paths.

A trajectory is a block of one lane. The score ranks paths by the share of the limit that they have
reached and by the remaining time.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import exp, sqrt
from typing import Any, NamedTuple

import numpy as np
from numpy.random import Generator

from fpk.answer.names import Coordinate, Limit, Start
from fpk.numeric.arrays import SMALLEST, Array, Integers
from fpk.numeric.compiling import cached_njit, njit_inline
from fpk.system.compiled_laws import of_law
from fpk.system.linear import natural_modes
from fpk.system.system import System
from sim.questions import limits, passing
from sim.questions.rounds import initial_states
from sim.sample.plan import observation_arrays, step_arrays
from sim.step import forces
from sim.step.arrays import StepArrays, WatchArrays
from sim.step.kernel import KernelKey, kernel_checksum, map_state, once
from sim.step.lanes import kick, quadratic_form, row
from sim.step.random import GOLDEN, fill_normals, splitmix64, stream_offset, word_place
from sim.step.schemes import SCHEMES

ScoreFunction = Callable[[Array, Array], Array]
"""ln P(failure within a time | energy) or an approximation: maps energies (m,) below the limit and
times (k,) > 0, both ascending, to (k, m)."""

SCORE_LEVELS = 2048
"""Levels of the score from 0 to failure. For probabilities of 1e-10 to 1e-40 a level is a factor of
1.01 to 1.05, and the list of records of a path stays short."""

LimitArrays = tuple[Array, passing.Diffusion, Array, float, int]
"""A limit on energies, or of one mass: its ``values_at``; the diffusion; ``reach`` (n,), Σ reach_m
√H_m = √(E_i/E_f) without contact, empty for energies; E_f, and the row of the mass."""

ROWS, COLUMNS = 128, 256
"""Cells of the score table: over the root of the remaining time, over the share of the limit."""


def least_action(
    energies: Array, times: Array, *, limit: float, noise: float, decay: float
) -> Array:
    """Return −(least action) (times, energies) of failure of ``dH = (D' − γ H) dt + √(2 D' H) dB``.

    The action is ``(√H_f − √H e^{−γτ/2})² γ/(D' (1 − e^{−γτ}))``, H in ``energies``, τ in
    ``times``, H_f ``limit``, D' ``noise``, γ ``decay`` of any sign: the exponent of the Gaussian
    transition of an oscillator's amplitude.
    """
    tau = times[:, None]
    grown = tau if decay == 0.0 else -np.expm1(-decay * tau) / decay
    short = np.sqrt(limit) - np.sqrt(energies) * np.exp(-0.5 * decay * tau)
    return np.asarray(-np.square(np.maximum(short, 0.0)) / (noise * grown))


def score_tables(
    scores: Sequence[ScoreFunction], energies: Sequence[Callable[[Array], Array]], time: float
) -> Array:
    """Return the level of each coordinate's score, (coordinates, rows + 1, columns + 1).

    x = column/columns is the share of the limit, where the coordinate has the energy
    ``energies[i](x)``; (row/rows)² is the remaining share of ``time``. The level is 0 at energy 0
    with the whole time, and nowhere falls with the energy or with the remaining time. If the score
    there is not finite and < 0, the level is proportional to x at any time.
    """
    left, tables = time * (np.arange(1, ROWS + 1) / ROWS) ** 2, []
    shares = np.maximum(np.arange(COLUMNS), 0.5) / COLUMNS  # ½ in place of 0
    for score, energy in zip(scores, energies, strict=True):
        table = np.zeros((ROWS + 1, COLUMNS + 1))
        table[:, -1] = SCORE_LEVELS
        values = score(energy(shares), left)
        lowest = values[-1, 0]
        if np.isfinite(lowest) and lowest < 0.0:
            share = np.where(np.isnan(values), 0.0, 1.0 - values / lowest)
            ascending = np.maximum.accumulate(np.clip(share, 0.0, 1.0), axis=1)
            table[1:, :-1] = SCORE_LEVELS * np.maximum.accumulate(ascending, axis=0)
        else:  # no finite negative score at energy 0: rank by x alone
            table[:, :-1] = SCORE_LEVELS * np.arange(COLUMNS) / COLUMNS
        tables.append(table)
    return np.array(tables)


class Paths(NamedTuple):
    """Records of each replica: the states at which its score rose to a new largest level."""

    state: Array  # (replicas, records, coordinates)
    level: Integers  # (replicas, records), ascending
    step: Integers  # (replicas, records), steps from the start to the record
    best: Integers  # (replicas,), largest level; SCORE_LEVELS is failure


@njit_inline
def level_of(t: Array, x: float, elapsed: float) -> int:
    """Return the level at the share ``x`` of the limit and the ``elapsed`` share of the time.

    It is interpolated in the score table ``t`` and rounded down, less than SCORE_LEVELS for x < 1;
    SCORE_LEVELS, failure, for x >= 1, and 0 for NaN.
    """
    if not x < 1.0:
        return SCORE_LEVELS if x >= 1.0 else 0
    rows, columns = t.shape[0] - 1, t.shape[1] - 1
    u, v = x * columns, np.sqrt(1.0 - elapsed) * rows
    j, k = min(int(u), columns - 1), min(int(v), rows - 1)
    a, b = u - j, v - k
    low = t[k, j] + a * (t[k, j + 1] - t[k, j])
    high = t[k + 1, j] + a * (t[k + 1, j + 1] - t[k + 1, j])
    return min(int(low + b * (high - low)), SCORE_LEVELS - 1)


@njit_inline
def look(
    seen: Array, s: Array, step: StepArrays, watch: WatchArrays, limit: LimitArrays, law: Any,
    of_q: bool,
) -> None:  # fmt: skip
    """Write four numbers of each limit to ``seen`` (c, 4), for the observed state in ``s``.

    They are: the distance to the limit; q and v of a displacement (``of_q``), or σ² and its growth
    of an energy; and the share x = √(E/E_f). ``law``: contact energies for ``of_law``.
    """
    values, noise, reach, energy, mass = limit
    q, v = s[watch.q + mass], 2.0 * step.half_inverse_mass[mass] * s[watch.p + mass]
    if reach.size > 0:
        root, contact = 0.0, 0.0
        for m in range(reach.size):
            root += reach[m] * sqrt(s[watch.traced[m]])
        for stop in range(step.stop_slot.size):
            if step.slot_mass[step.stop_slot[stop]] == mass:
                sign, clearance, B, e, kind = forces.numbers_of(step, stop)
                contact += B * of_law(law, kind, forces.overlap_of(q, sign, clearance)[1], e)
        seen[:, 3] = sqrt(root * root + contact / energy)
    if of_q:
        seen[0, 0], seen[0, 1], seen[0, 2] = min(values[1] - q, q - values[0]), q, v
    elif reach.size > 0:
        for m in range(values.size):
            seen[m, 0] = (values[m] - s[watch.p + mass]) / noise.of_momentum[m]
    else:
        for m in range(values.size):
            quadratic_form(seen[m, 1:2], s, watch.p, noise.variance[m], 1.0, 1)
            quadratic_form(seen[m, 2:3], s, watch.p, noise.growth[m], 1.0, 1)
            H, value = s[watch.traced[m]], values[m]
            seen[m, 0] = passing.distance_to(value, H, seen[m, 1], seen[m, 2], noise.at_rest[m])
            seen[m, 3] = sqrt(max(H, 0.0) / value)


@once
def path_function_for(key: KernelKey, kind: str) -> Any:
    """Return ``renew``, compiled, which simulates paths; ``kind``: the ``Limit.kind``."""
    laws, _, damping, energy_damping, energy, _, pairs, _ = key
    force, slope, law = key.parts_of_laws()
    displacement = kind == "q"

    @cached_njit(kernel_checksum(laws))
    def renew(
        dead: Integers, parents: Integers, level: int, first: int, offset: np.uint64,
        step: StepArrays, watch: WatchArrays, limit: LimitArrays, tables: Array, steps: int,
        paths: Paths,
    ) -> None:  # fmt: skip
        """Copy ``parents`` to ``dead`` up to where they exceed ``level``; simulate the rest anew.

        ``paths`` are changed in place. ``level`` −1: new paths from the first records of
        ``parents``. ``first``: number of the stream of ``dead[0]``; ``steps`` of a whole path;
        ``tables``: of the score. States are recorded in the middle of the damping, before the kick.
        """
        n, h, s = step.matrix.shape[0] // 2, step.dt, np.zeros(watch.total)
        c, ends = tables.shape[0], (limit[0][0], limit[0][-1])
        x, z, words = s[: 2 * n], np.zeros(2 * pairs, np.float32), np.zeros(1, np.uint64)
        seen, before = np.zeros((c, 4)), np.zeros((c, 4))
        for number in range(dead.size):
            i, parent, m, records, place = dead[number], parents[number], 0, 1, np.uint64(0)
            while paths.level[parent, m] <= level:
                m += 1
            top, begun = paths.level[parent, m], paths.step[parent, m]
            x[:] = paths.state[parent, m]
            paths.state[i, 0] = x
            paths.level[i, 0], paths.step[i, 0], done = top, begun, begun
            if level < 0:  # a new path: its start is recorded below
                top, records = -1, 0
            while True:
                # To the middle of the damping. A start is also in the middle of the kick.
                forces.contact_forces(s, watch.contact, step, force, slope, 1)
                if energy_damping:
                    forces.potential_energy(s, 0, watch.work + 1, step, law, 1)
                if damping and done > begun:
                    forces.term_flows(s, watch.work, step, False, energy_damping, 1)
                if records == 0:
                    for slot in range(step.slot_mass.size):
                        r, g = n + step.slot_mass[slot], row(s, watch.contact + 2 * slot, 2, 1)
                        kick(row(s, r, 1, 1), g, -0.5 * h, step.slot_shift[slot], 1)
                before[:] = seen
                forces.observe(
                    s, step, watch, damping, energy_damping, energy, False, force, law, 1
                )
                look(seen, s, step, watch, limit, law, displacement)
                if records == 0 or done > begun:
                    reached = -1
                    for m in range(c):
                        gone, a, b = seen[m, 0] <= 0.0, before[m], seen[m]
                        if done > begun and displacement:
                            cubic = passing.cubic_of(a[1], a[2], b[1], b[2], h)
                            gone = passing.cubic_passage(cubic, *ends) <= 1.0
                        elif done > begun:  # of a Brownian bridge between both
                            nats, u = 2.0 * a[0] * b[0] / h, place + np.uint64(pairs + m) * GOLDEN
                            if a[0] <= 0.0:
                                gone = True
                            elif nats < passing.NEGLIGIBLE_NATS and not gone:
                                uniform = (
                                    np.float64(splitmix64(u) >> np.uint64(11)) + 0.5
                                ) * 2.0**-53
                                gone = uniform < exp(-nats)
                        # By round-off the table may give failure without passage.
                        inside = min(
                            level_of(tables[m], seen[m, 3], done / steps), SCORE_LEVELS - 1
                        )
                        reached = max(reached, SCORE_LEVELS if gone else inside)
                    if reached > top:
                        top = reached
                        paths.state[i, records] = x
                        paths.level[i, records], paths.step[i, records] = top, done
                        records += 1
                if done >= steps or top >= SCORE_LEVELS:
                    break

                # Kick, the other half of the damping in reverse, and the linear map.
                forces.kick_by_contact(s, watch.contact, step, n, 1)
                if damping:
                    forces.term_flows(s, watch.work, step, True, energy_damping, 1)
                place = word_place(first + number, (done - begun) * (pairs + c), offset)
                fill_normals(z, words, place, pairs, 1)
                map_state(s, z, step.matrix, pairs, 1)
                done += 1
            paths.best[i] = top

    return renew


@dataclass(frozen=True, eq=False)
class SystemProblem:
    """Failure of ``system`` at ``limit`` before ``time``, from ``start``, by steps up to ``dt``."""

    system: System
    limit: Limit
    start: Start
    time: float
    dt: float
    tables: Array  # of the score


class Replicas:
    """``count`` paths of one repetition of a ``problem``, of up to ``steps`` steps, from starts
    drawn from ``stream``; each new path has the next stream of the ``seed``.

    For |q_i| < a the score is of E_i = ½ k A² + U_i(q_i), A = Σ_m |T_im| √(2 H_m)/ω_m the largest
    |q_i| of free motion, k the static stiffness: E_i <= H, and E_i >= E_f = ½ k a² + U_i(a) at a.
    |q_i| would be poor: the next peak is decided long before the path is there. For v_i it is of
    ½ m_i A² + U_i(q_i), A = Σ_m |T_im| √(2 H_m), E_f = ½ m_i a².
    """

    def __init__(
        self, problem: SystemProblem, count: int, steps: int, seed: int, stream: Generator
    ) -> None:
        """Draw the starts and simulate all ``count`` paths."""
        system, limit, n = problem.system, problem.limit, problem.system.n
        reach, energy, mass = np.zeros(0), 1.0, 0
        if not limit.of_energy:
            mass, (shapes, omega) = limit.row, natural_modes(system)
            energy = max(float(np.min(limits.energies_at(system, limit))), sqrt(SMALLEST))
            reach = np.abs(shapes[mass]) / np.sqrt(energy / system.mass[mass])
        if limit.kind == "q":
            reach = np.abs(shapes[mass]) / omega / np.sqrt(energy * system.compliance[mass, mass])
        scheme = SCHEMES["exact_flow"]
        step = step_arrays(system, scheme, problem.time / steps)
        energies = limits.energies_of(limit, n) or [Coordinate("H", m) for m in range(n)]
        key, watch = observation_arrays(system, scheme, step, (), (), energies)
        starts = initial_states(system, problem.start, int(stream.integers(2**63)), count)
        noise = passing.diffusion_of(system, limit)
        numbers = limits.values_at(system, limit), noise, reach, energy, mass
        self.model = step, watch, numbers, problem.tables, steps
        self.function, self.offset = path_function_for(key, limit.kind), stream_offset(seed)
        records = min(steps, SCORE_LEVELS) + 1
        state = np.empty((count, records, 2 * n))  # only written pages take memory
        state[:, 0] = np.hstack(starts)
        level, taken = (np.empty((count, records), dtype=np.int64) for _ in range(2))
        level[:, 0] = taken[:, 0] = 0
        self.best = np.zeros(count, dtype=np.int64)
        self.paths = Paths(state, level, taken, self.best)
        self.streams, every = 0, np.arange(count)
        self.renew(every, every, -1)

    def renew(self, dead: Integers, parents: Integers, level: int) -> None:
        """Replace replicas ``dead`` by copies of ``parents`` until these exceed ``level``, from
        where on they are simulated anew; the arguments are numbers of replicas, and a level."""
        self.function(dead, parents, level, self.streams, self.offset, *self.model, self.paths)
        self.streams += dead.size
