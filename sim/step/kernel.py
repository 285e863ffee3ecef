"""The compiled stepper: many steps of many blocks of lanes, with only the effects of the system.

The random linear map is ``x <- matrix @ (x, z)``, z rows of normals, two rows for each random word.
It is applied to two rows and ``MAP_COLUMNS`` columns at a time, through scratch rows.

Lanes that may touch a stop within a long step (``sim.sample.plan``) make its small steps in groups
of ``NARROW`` lanes; all lanes are mapped over the long step, and the results of the small steps
then replace those of the map. The normals of a small step belong to the trajectory and the step,
not to the place of a lane in its group: the lower half of a word is the radius, the upper half the
angle.
"""

from collections.abc import Callable, Sequence
from functools import lru_cache
from pathlib import Path
from threading import Lock
from typing import Any, NamedTuple

import numpy as np
from numba import njit

from fpk.numeric.arrays import Array, Integers
from fpk.numeric.compiling import ROOT, cached_njit, checksum, njit_inline
from fpk.system.compiled_laws import compile_laws, law_files
from sim.step import forces, random
from sim.step.arrays import MAP_COLUMNS, NARROW, StepArrays, W, WatchArrays
from sim.step.lanes import add, add_matrix, add_product, copy, fill, row, zero_rows
from sim.step.random import GOLDEN, Singles, Words

COMPILED = (
    *(f"sim/step/{name}.py" for name in ("arrays", "forces", "kernel", "lanes", "random")),
    *(f"sim/questions/{name}.py" for name in ("passing", "splitting/kernel")),
)
"""Source files of the kernels, of the readers of traces and of the paths of splitting."""


def kernel_checksum(laws: Sequence[str] = (), root: Path = ROOT) -> int:
    """Return a checksum of ``COMPILED`` and of the files of contact ``laws``, under ``root``."""
    return checksum([*(root / name for name in COMPILED), *law_files(laws, root)])


class KernelKey(NamedTuple):
    """Effects, scheme and observations that a kernel is compiled for."""

    laws: tuple[str, ...] = ()  # names of the contact laws
    kick_first: bool = True
    damping: bool = False  # with damping terms
    energy_damping: bool = False  # with damping terms that contain H
    energy: bool = False  # H is observed
    moments: bool = False  # products of forces are summed
    pairs: int = 2  # pairs of normals in a linear map
    substeps: bool = False  # small steps near stops

    def parts_of_laws(self) -> Any:
        """Return [force, slope, energy] of the laws for ``of_law``, each None without laws."""
        parts = "force", "slope", "energy"
        return [compile_laws(self.laws, part) if self.laws else None for part in parts]


def once(make: Callable[..., Any]) -> Callable[..., Any]:
    """Return ``make`` with a cache of its results; only one thread at a time computes them."""
    lock, cached = Lock(), lru_cache(make)

    def made(*key: Any) -> Any:
        with lock:
            return cached(*key)

    return made


@njit_inline
def map_state(s: Array, z: Singles, matrix: Array, pairs: int, width: int = W) -> None:
    """Replace the state in ``s`` by ``matrix`` @ (state, z), z ``pairs`` pairs of rows of normals.

    Rows of ``width`` lanes. The rows of ``s`` after the state are overwritten.
    """
    n, scratch = matrix.shape
    copy(row(s, n, 2 * pairs, width), z, 2 * pairs * width)
    for i in range(0, n, 2):
        y = row(s, scratch + i, 2, width)
        for j in range(0, matrix.shape[1], MAP_COLUMNS):
            a0, a1, a2, a3 = matrix[i, j], matrix[i, j + 1], matrix[i, j + 2], matrix[i, j + 3]
            b0, b1 = matrix[i + 1, j], matrix[i + 1, j + 1]
            b2, b3 = matrix[i + 1, j + 2], matrix[i + 1, j + 3]
            x = row(s, j, MAP_COLUMNS, width)
            if j == 0:
                for k in range(width):
                    x0, x1, x2, x3 = x[k], x[width + k], x[2 * width + k], x[3 * width + k]
                    y[k] = a0 * x0 + a1 * x1 + a2 * x2 + a3 * x3
                    y[width + k] = b0 * x0 + b1 * x1 + b2 * x2 + b3 * x3
            else:
                for k in range(width):
                    x0, x1, x2, x3 = x[k], x[width + k], x[2 * width + k], x[3 * width + k]
                    y[k] += a0 * x0 + a1 * x1 + a2 * x2 + a3 * x3
                    y[width + k] += b0 * x0 + b1 * x1 + b2 * x2 + b3 * x3
    copy(row(s, 0, n, width), row(s, scratch, n, width), n * width)


@njit_inline
def near_lanes(s: Array, work: Array, near: Integers, index: Integers, step: StepArrays) -> int:
    """Write the lanes that may touch a stop within the long step to ``index``; return their number.

    ``s`` contains the states. ``index`` (W,) is filled up with its first lane to a multiple of
    ``NARROW``. ``near`` (W,) and ``work`` (two rows) are scratch.
    """
    after, bend = row(work, 0), row(work, 1)
    for k in range(W):
        near[k] = 0
    for stop in range(step.stop_slot.size):
        fill(work, 0.0, 2 * W)
        for j in range(0, step.after.shape[1], MAP_COLUMNS):
            a, b, x = step.after[stop], step.bend[stop], row(s, j, MAP_COLUMNS)
            a0, a1, a2, a3 = a[j], a[j + 1], a[j + 2], a[j + 3]
            b0, b1, b2, b3 = b[j], b[j + 1], b[j + 2], b[j + 3]
            for k in range(W):
                x0, x1, x2, x3 = x[k], x[W + k], x[2 * W + k], x[3 * W + k]
                after[k] += a0 * x0 + a1 * x1 + a2 * x2 + a3 * x3
                bend[k] += b0 * abs(x0) + b1 * abs(x1) + b2 * abs(x2) + b3 * abs(x3)
        q, reach = row(s, step.slot_mass[step.stop_slot[stop]]), step.reach[stop]
        sign, clearance = step.stops[stop, 0], step.stops[stop, 1]
        for k in range(W):
            x0 = sign * q[k] if sign != 0.0 else abs(q[k])
            x1 = sign * after[k] if sign != 0.0 else abs(after[k])
            near[k] |= np.int64(max(x0, x1 + reach) + bend[k] >= clearance)
    count = 0
    for k in range(W):
        index[count] = k
        count += near[k]
    for k in range(count, -(-count // NARROW) * NARROW):
        index[k] = index[0]
    return count


@njit(inline="always")
def small_steps(
    s: Array, groups: Array, size: int, index: Integers, count: int, begins: Words, z: Singles,
    halves: random.Halves, first: np.uint64, step: StepArrays, at_contact: int, pairs: int,
    force: Any, slope: Any,
) -> None:  # fmt: skip
    """Copy the states in ``s`` of the ``count`` lanes in ``index`` to ``groups``; advance them.

    They are advanced by ``step.small`` small steps; ``s`` does not change. Each group has ``size``
    numbers, laid out as a workspace of ``NARROW`` lanes with g at row ``at_contact``; the first
    lane fills up the last group. ``first`` is the place in the sequence of the first word of lane
    0, ``pairs`` the words of a small step. ``begins`` (W,), ``z`` and ``halves`` are scratch.
    """
    n, many = step.matrix.shape[0] // 2, -(-count // NARROW)
    for k in range(many * NARROW):
        begins[k] = (np.uint64(index[k]) << np.uint64(40)) * GOLDEN
        for r in range(2 * n):
            groups[(k // NARROW) * size + r * NARROW + k % NARROW] = s[r * W + index[k]]
    for t in range(step.small):
        for c in range(many):
            for pair in range(pairs):
                place = first + np.uint64(t * pairs + pair) * GOLDEN
                for k in range(NARROW):
                    word = random.splitmix64(place + begins[c * NARROW + k])
                    halves[k] = np.uint32(word)
                    halves[NARROW + k] = np.uint32(word >> np.uint64(32))
                random.box_muller(z[2 * pair * NARROW : 2 * (pair + 1) * NARROW], halves, NARROW)
            own = groups[c * size : (c + 1) * size]
            forces.contact_forces(own, at_contact, step, force, slope, NARROW)
            forces.kick_by_contact(own, at_contact, step, n, NARROW)
            map_state(own, z, step.matrix, pairs, NARROW)


@once
def kernel_for(key: KernelKey) -> Any:
    """Return the kernel compiled for ``key``, whose flags are constants: False compiles nothing."""
    laws, kick_first, damping, energy_damping, energy, moments, pairs, substeps = key
    force, slope, potential = key.parts_of_laws()

    @cached_njit(kernel_checksum(laws))
    def advance(
        x: Array, sums: Array, counts: Integers, live: Integers, batch: Integers,
        first: int, counter: np.uint64, steps: int, phase: int, stride: int, offset: np.uint64,
        step: StepArrays, watch: WatchArrays, trace: Array,
    ) -> None:  # fmt: skip
        """Advance the states ``x`` (blocks, 2n·W) by ``steps`` steps, in place.

        ``x[0]`` is block ``first`` of the ensemble, ``counter`` the first word of each trajectory,
        ``offset`` the offset of the seed. The state is observed at the start of a step if ``(phase
        + step number) % stride == 0``; with ``stride`` 0 never. An observation adds to ``sums``
        (blocks, moments·W) and, for the first ``live`` (blocks,) lanes, to the row of ``counts``
        (batches, bins) of the block's ``batch`` (blocks,); it is copied to ``trace`` (blocks,
        samples·rows·W) from its second sample on.
        """
        n, matrix = step.matrix.shape[0] // 2, step.long_matrix if substeps else step.matrix
        s, number = zero_rows(watch.total), zero_rows(1)
        z, words = zero_rows(pairs).view(np.float32), zero_rows(1).view(np.uint64)
        index, second = np.zeros(W, np.int64), np.zeros(W, np.int64)
        if substeps:
            size, groups = watch.total * NARROW, zero_rows(watch.total)
            chosen = np.zeros(W, np.int64)
            begins, halves = zero_rows(1).view(np.uint64), words.view(np.uint32)
        for b in range(x.shape[0]):
            s[: 2 * n * W] = x[b]
            for t in range(steps):
                watched = stride > 0 and (phase + t) % stride == 0

                # Forces and energies at the state before the kick.
                if not substeps or watched or energy_damping:
                    forces.contact_forces(s, watch.contact, step, force, slope)
                if energy_damping:
                    forces.potential_energy(s, 0, watch.work + 1, step, potential)

                # First half of the damping terms.
                if damping and kick_first:
                    forces.term_flows(s, watch.work, step, False, energy_damping)

                # Observation.
                if watched:
                    forces.observe(
                        s, step, watch, damping, energy_damping, energy, moments, force, potential
                    )
                    for m in range(watch.products.shape[0]):
                        u, v = row(s, watch.products[m, 0]), row(s, watch.products[m, 1])
                        add_product(row(sums[b], m), u, v, 1.0)
                    own = counts[batch[b] - batch[0]]
                    forces.count_all(s, number, index, second, live[b], watch, own)
                    for r in range(watch.traced.size):
                        sample = (1 + t // stride) * watch.traced.size + r
                        copy(row(trace[b], sample), row(s, watch.traced[r]))

                # Kicks, and the second half of the terms in reverse: a symmetric step.
                if kick_first and not substeps:
                    forces.kick_by_contact(s, watch.contact, step, n)
                if damping and kick_first:
                    add_matrix(s, n, 0, step.terms.springs, -1.0)
                    forces.term_flows(s, watch.work, step, True, energy_damping)
                if damping and not kick_first:  # Euler's rule: forces of the state before the map
                    if energy_damping:
                        forces.whole_energy(s, watch.work, step)
                    forces.damping_forces(s, 0, row(s, watch.work + 2), watch, step)

                # The linear map, or small steps of trajectories near a stop.
                word = counter + np.uint64(t * step.words)
                place = random.word_place((first + b) * W, word, offset)
                if substeps:
                    near = near_lanes(s, row(s, watch.q, 2), index, chosen, step)
                    small_steps(
                        s, groups, size, chosen, near, begins, z, halves,
                        place + np.uint64(pairs) * GOLDEN, step, watch.contact, pairs, force, slope,
                    )  # fmt: skip
                for _ in range(step.maps):
                    random.fill_normals(z, words, place, pairs)
                    place += np.uint64(pairs) * GOLDEN
                    if step.strength.size:
                        for k in range(z.size):
                            z[k] *= step.strength[t]
                    map_state(s, z, matrix, pairs)
                if substeps:
                    for k in range(near):
                        for r in range(2 * n):
                            lane = (k // NARROW) * size + r * NARROW + k % NARROW
                            s[r * W + chosen[k]] = groups[lane]

                # Kicks of a scheme that kicks after its map.
                if not kick_first:
                    forces.kick_by_contact(s, watch.contact, step, n)
                    if damping:
                        for i in range(n):
                            add(row(s, n + i), row(s, watch.damping + i), -step.dt)
            x[b] = s[: 2 * n * W]

    return advance
