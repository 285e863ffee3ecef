"""The compiled stepper: many steps of many blocks of lanes, with only the effects asked for."""

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fpk.compiled_laws import compiled_laws
from fpk.compiling import kept
from sim.arrays import StepArrays, WatchArrays
from sim.lanes import add, aligned_rows, kick, row
from sim.parts.contact import add_contact_energy, add_contact_forces, contact_forces, no_law
from sim.parts.damping import (
    damping_forces,
    kick_by_springs,
    processed_by_terms,
    spring_energy,
    term_flow,
    term_flow_with_energy,
    whole_energy,
)
from sim.parts.linear import map_any, map_one_mass, map_two_masses
from sim.parts.observed import (
    count_all,
    fold_products,
    observed_displacements,
    observed_energy,
    observed_modes,
    observed_momenta,
    observed_springs,
    sum_products,
)
from sim.parts.substeps import AT_ONCE, NARROW, gather, near_lanes, places, scatter, small_steps
from sim.random import GOLDEN, LANES, fill_normals
from sim.sources import kernel_stamp

Array = NDArray[np.float64]
Integers = NDArray[np.int64]
W = LANES


@dataclass(frozen=True)
class KernelKey:
    """What a kernel is compiled for: contact laws, damping terms and kinds of observation."""

    laws: tuple[str, ...] = ()
    kick_first: bool = True
    damping: bool = False
    energy_damping: bool = False
    observed: bool = False
    momenta: bool = False
    energy: bool = False
    modes: bool = False
    moments: bool = False
    masses: int = 2
    pairs: int = 2
    kicked: tuple[int, ...] = ()
    substeps: bool = False


@lru_cache
def compiled_kernel(key: KernelKey) -> Any:
    """Return the kernel of ``key``; laws that it does not need are not compiled.

    The disk cache looks at this file only; closing over a checksum of all that is compiled makes
    it miss when a function that the kernel calls was edited.
    """
    contact, observed, kick_first = bool(key.laws), key.observed, key.kick_first
    damping, energy_damping = key.damping, key.energy_damping
    momenta, energy, modes, moments = key.momenta, key.energy, key.modes, key.moments
    masses, pairs = key.masses, key.pairs
    kick1, kick2, fused = 0 in key.kicked, 1 in key.kicked, bool(key.kicked)
    substeps = key.substeps
    stamp = kernel_stamp()
    force: Any = compiled_laws(key.laws, "force") if contact else None
    slope: Any = compiled_laws(key.laws, "slope") if contact else None
    energies = energy or energy_damping
    potential: Any = compiled_laws(key.laws, "energy") if contact and energies else None

    @kept()
    def advance(
        x: Array,
        sums: Array,
        folded: Array,
        live: Integers,
        first: int,
        counter: np.uint64,
        steps: int,
        phase: int,
        stride: int,
        offset: np.uint64,
        step: StepArrays,
        watch: WatchArrays,
        counts: Integers,
    ) -> None:
        """Advance blocks ``x`` (blocks, 2n·W), the first being block ``first`` of the ensemble.

        Observes at the start of a step where ``(phase + step number) % stride == 0``, never with
        ``stride`` 0; adds to ``sums`` (first blocks, moments·W), lane by lane, to ``folded`` (other
        blocks, moments·FOLDED) and ``counts`` (all bins, one more a histogram for outside).
        """
        n = step.matrix.shape[0] // 2
        at, slots = watch.at, step.slot_mass.size
        s = aligned_rows(at.total if stamp >= 0 else 0)
        z, words = aligned_rows(pairs).view(np.float32), aligned_rows(1).view(np.uint64)
        index, second = np.zeros(W, np.int64), np.zeros(W, np.int64)
        if substeps:
            group = at.total * NARROW
            groups, chosen = aligned_rows(at.total), np.zeros(W, np.int64)
            drawn = aligned_rows(pairs * AT_ONCE).view(np.float32)
            places_of = aligned_rows(pairs * AT_ONCE).view(np.uint64)
            halves = aligned_rows(pairs * AT_ONCE).view(np.uint32)
        for b in range(x.shape[0]):
            trajectory = np.uint64((first + b) * W)
            s[: 2 * n * W] = x[b]
            for t in range(steps):
                watched = observed and stride > 0 and (phase + t) % stride == 0
                if contact and (watched or not (fused or substeps)):
                    contact_forces(s, at.contact, step, force, slope)
                if energy_damping:
                    spring_energy(s, row(s, at.work + 1), step.terms)
                    if contact:
                        add_contact_energy(s, 0, at.work + 1, step, potential)
                if damping and kick_first:
                    for k in range(step.terms.target.size):
                        if energy_damping:
                            term_flow_with_energy(s, at.work, step.terms, k, 0.5 * step.dt)
                        else:
                            term_flow(s, at.work, step.terms, k, 0.5 * step.dt)
                if watched:
                    observed_displacements(s, step, watch)
                    if momenta:
                        observed_momenta(s, step, watch)
                    if damping and watch.term_shift != 0.0:
                        H = row(s, at.work + 2)
                        if energy_damping:
                            whole_energy(s, H, row(s, at.work + 1), step.terms)
                        processed_by_terms(s, H, at, watch.term_shift, step)
                    if energy:
                        observed_energy(s, watch)
                    if moments:
                        observed_springs(s, watch)
                    if contact and moments:
                        add_contact_forces(s, at.q, at.force, step, force)
                    if contact and energy:
                        add_contact_energy(s, at.q, at.energy, step, potential)
                    if modes:
                        observed_modes(s, watch.mode_q, watch.mode_p, watch)
                    if moments:
                        if damping:
                            H = row(s, at.energy)
                            damping_forces(s, at.q, H, at.damping, at.work, step.terms)
                        if b < sums.shape[0]:
                            sum_products(s, sums[b], watch)
                        else:
                            fold_products(s, folded[b - sums.shape[0]], live[b], watch)
                    count_all(s, index, second, live[b], watch, counts)
                if contact and kick_first and not (fused or substeps):
                    for slot in range(slots):
                        p, g = row(s, n + step.slot_mass[slot]), row(s, at.contact + 2 * slot, 2)
                        kick(p, g, step.dt, step.slot_shift[slot])
                if damping and kick_first:
                    kick_by_springs(s, step.terms)
                    for k in range(step.terms.target.size - 1, -1, -1):
                        if energy_damping:
                            term_flow_with_energy(s, at.work, step.terms, k, 0.5 * step.dt)
                        else:
                            term_flow(s, at.work, step.terms, k, 0.5 * step.dt)
                if damping and not kick_first:
                    H = row(s, at.work + 2)
                    if energy_damping:
                        whole_energy(s, H, row(s, at.work + 1), step.terms)
                    damping_forces(s, 0, H, at.damping, at.work, step.terms)
                if substeps:
                    matrix = step.substeps.matrix
                    near = near_lanes(s, row(s, at.q, 2), index, chosen, step.substeps)
                    gather(groups, s, chosen, near, 2 * n, group)
                    places(places_of, chosen, near, pairs)
                else:
                    matrix = step.matrix
                for pair in range(pairs):
                    word = counter + np.uint64(t * step.words + pair)
                    pair_rows = z[2 * pair * W : 2 * (pair + 1) * W]
                    fill_normals(pair_rows, words, trajectory, word, offset)
                if masses == 1 and pairs == 1:
                    if fused and not substeps:
                        map_one_mass(row(s, 0, 2), z, matrix, step, kick1, force, slope)
                    else:
                        map_one_mass(row(s, 0, 2), z, matrix, step, False, no_law, no_law)
                elif masses == 2 and pairs == 2:
                    if fused and not substeps:
                        map_two_masses(row(s, 0, 4), z, matrix, step, kick1, kick2, force, slope)
                    else:
                        map_two_masses(row(s, 0, 4), z, matrix, step, False, False, no_law, no_law)
                else:
                    map_any(s, z, pairs, matrix)
                if substeps:
                    word = counter + np.uint64(t * step.words + pairs)
                    place = ((trajectory << np.uint64(40)) + word) * GOLDEN + offset
                    small_steps(
                        groups, group, places_of, near, drawn, halves, place, step,
                        at.contact, (kick1, kick2), masses, pairs, force, slope,
                    )  # fmt: skip
                    scatter(s, groups, chosen, near, 2 * n, group)
                if contact and not kick_first:
                    for slot in range(slots):
                        p, g = row(s, n + step.slot_mass[slot]), row(s, at.contact + 2 * slot, 2)
                        kick(p, g, step.dt, step.slot_shift[slot])
                if damping and not kick_first:
                    for i in range(n):
                        add(row(s, n + i), row(s, at.damping + i), -step.dt)
            x[b] = s[: 2 * n * W]

    return advance
