"""The compiled stepper: many steps of many blocks of lanes, with only the effects asked for."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache, wraps
from pathlib import Path
from threading import Lock
from typing import Any

import numpy as np

from fpk.numeric.arrays import Array, Integers
from fpk.numeric.compiling import ROOT, cached_njit, checksum
from fpk.system.compiled_laws import compiled_laws, law_files
from sim.step.arrays import NARROW, StepArrays, W, WatchArrays
from sim.step.lanes import add, add_matrix, add_product, aligned_rows, copy, row
from sim.step.parts import forces, linear, observed
from sim.step.random import GOLDEN, fill_normals

KERNEL = (
    *(f"sim/step/{name}.py" for name in ("arrays", "kernel", "lanes", "random")),
    *(f"sim/step/parts/{name}.py" for name in ("forces", "linear", "observed")),
)
"""Files that a kernel is compiled from."""


def kernel_checksum(laws: Sequence[str], root: Path = ROOT) -> int:
    """Return a checksum of the sources that a kernel with contact ``laws`` is compiled from."""
    return checksum([*(root / name for name in KERNEL), *law_files(laws, root)])


@dataclass(frozen=True)
class KernelKey:
    """Effects, scheme and observations that a kernel is compiled for.

    ``laws`` are the contact laws that act, ``damping`` and ``energy_damping`` damping terms and
    those with H; a step draws ``pairs`` of normals. There may be ``substeps``, small steps near
    stops; observed states that are handed out (``traced``); two maps of a step (``halved``); and a
    factor on the noise of each step (``modulated``).
    """

    laws: tuple[str, ...] = ()
    kick_first: bool = True
    damping: bool = False
    energy_damping: bool = False
    observed: bool = False
    momenta: bool = False
    energy: bool = False
    modes: bool = False
    moments: bool = False
    pairs: int = 2
    substeps: bool = False
    traced: bool = False
    halved: bool = False
    modulated: bool = False


def once(make: Callable[..., Any]) -> Callable[..., Any]:
    """Return ``make`` with results that are kept, made by one thread at a time."""
    lock, cached = Lock(), lru_cache(make)

    @wraps(make)
    def made(*key: Any) -> Any:
        with lock:
            return cached(*key)

    return made


@once
def compiled_kernel(key: KernelKey) -> Any:
    """Return the kernel of ``key``; what a flag guards that is False, a constant, is left out."""
    contact, observing, kick_first = bool(key.laws), key.observed, key.kick_first
    damping, energy_damping = key.damping, key.energy_damping
    momenta, energy, modes, moments = key.momenta, key.energy, key.modes, key.moments
    traced, halved, modulated = key.traced, key.halved, key.modulated
    pairs, substeps = key.pairs, key.substeps
    apart = contact and not substeps  # kicks that are a stage of their own
    sources = kernel_checksum(key.laws)
    force: Any = compiled_laws(key.laws, "force") if contact else None
    slope: Any = compiled_laws(key.laws, "slope") if contact else None
    needed = contact and (energy or energy_damping)
    potential: Any = compiled_laws(key.laws, "energy") if needed else None

    @cached_njit()
    def advance(
        x: Array, sums: Array, counts: Integers, live: Integers, batch: Integers,
        first: int, counter: np.uint64, steps: int, phase: int, stride: int, offset: np.uint64,
        step: StepArrays, watch: WatchArrays, trace: Array,
    ) -> int:  # fmt: skip
        """Advance blocks ``x`` (blocks, 2n·W), the first being block ``first`` of the ensemble.

        Observes at the start of a step where ``(phase + step number) % stride == 0``, never with
        ``stride`` 0: adds to ``sums`` (blocks, moments·W) and ``counts`` (batches, bins) of the
        ``batch`` (blocks,) of each, which ascends by ones, and writes to ``trace`` (blocks,
        samples·rows·W) from its second sample on.
        Returns the checksum of its sources, a constant of the kernel: where it has changed, numba's
        disk cache compiles anew.
        """
        n, at, terms = step.matrix.shape[0] // 2, watch.at, step.terms
        matrix = step.long_matrix if substeps else step.matrix
        s = aligned_rows(at.total)
        V, H = row(s, at.work + 1), row(s, at.work + 2)  # of the state, where damping depends on H
        z, words = aligned_rows(pairs).view(np.float32), aligned_rows(1).view(np.uint64)
        index, second, number = np.zeros(W, np.int64), np.zeros(W, np.int64), aligned_rows(1)
        if substeps:
            group = at.total * NARROW
            groups, chosen = aligned_rows(at.total), np.zeros(W, np.int64)
            drawn, halves = (
                aligned_rows(pairs).view(np.float32),
                aligned_rows(pairs).view(np.uint32),
            )
            places_of = aligned_rows(pairs).view(np.uint64)
        for b in range(x.shape[0]):
            trajectory = np.uint64((first + b) * W)
            s[: 2 * n * W] = x[b]
            for t in range(steps):
                watched = observing and stride > 0 and (phase + t) % stride == 0

                # Forces and energies at the state before the kick.
                if contact and (apart or watched or energy_damping):
                    forces.contact_forces(s, at.contact, step, force, slope)
                if energy_damping:
                    forces.spring_energy(s, V, step)
                    if contact:
                        forces.add_contact(s, 0, at.work + 1, step, potential, False)

                # First half of the damping terms, which ends in the middle of the kicks.
                if damping and kick_first:
                    for k in range(terms.target.size):
                        forces.term_flow(s, at.work, step, k, energy_damping)

                # Observation.
                if watched:
                    observed.observe(
                        s, V, H, step, watch, contact, damping, energy_damping, momenta, energy,
                        modes, moments, force, potential,
                    )  # fmt: skip
                    if moments:
                        for m in range(watch.products.shape[0]):
                            u, v = row(s, watch.products[m, 0]), row(s, watch.products[m, 1])
                            add_product(row(sums[b], m), u, v, 1.0)
                    own = counts[batch[b] - batch[0]]
                    observed.count_all(s, number, index, second, live[b], watch, own)
                    if traced:
                        for r in range(watch.traced.size):
                            sample = (1 + t // stride) * watch.traced.size + r
                            copy(row(trace[b], sample), row(s, watch.traced[r]))

                # Kicks, and the second half of the terms in reverse: a symmetric step.
                if apart and kick_first:
                    forces.kick_by_contact(s, at.contact, step, n)
                if damping and kick_first:
                    add_matrix(s, n, 0, terms.springs, -1.0)
                    for k in range(terms.target.size - 1, -1, -1):
                        forces.term_flow(s, at.work, step, k, energy_damping)
                if damping and not kick_first:  # of Euler's kind, from before the map
                    if energy_damping:
                        forces.whole_energy(s, H, V, step)
                    forces.damping_forces(s, 0, H, at.damping, at.work, step)

                # The linear map; trajectories near a stop make small steps instead.
                if substeps:
                    near = linear.near_lanes(s, row(s, at.q, 2), index, chosen, step)
                    linear.gather(groups, s, chosen, near, 2 * n, group)
                    linear.places(places_of, chosen, near, pairs)
                word = counter + np.uint64(t * step.words)
                for half in range(1 + halved):  # of the time between two kicks
                    for pair in range(pairs):
                        to = z[2 * pair * W : 2 * (pair + 1) * W]
                        own = word + np.uint64(half * pairs + pair)
                        fill_normals(to, words, trajectory, own, offset)
                    if modulated:
                        for k in range(z.size):
                            z[k] *= step.strength[t]
                    linear.map_state(s, z, matrix, pairs)
                if substeps:
                    word += np.uint64(pairs)
                    place = ((trajectory << np.uint64(40)) + word) * GOLDEN + offset
                    linear.small_steps(
                        groups, group, places_of, near, drawn, halves, place, step,
                        at.contact, pairs, force, slope,
                    )  # fmt: skip
                    linear.scatter(s, groups, chosen, near, 2 * n, group)

                # Kicks of a scheme that kicks after its map.
                if apart and not kick_first:
                    forces.kick_by_contact(s, at.contact, step, n)
                if damping and not kick_first:
                    for i in range(n):
                        add(row(s, n + i), row(s, at.damping + i), -step.dt)
            x[b] = s[: 2 * n * W]
        return sources

    return advance
