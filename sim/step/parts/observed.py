"""The observed state, and the bins of histograms that it lies in."""

from typing import Any

import numpy as np
from numba import njit

from fpk.numeric.arrays import Array, Integers
from fpk.numeric.compiling import inlined
from sim.step.arrays import StepArrays, W, WatchArrays
from sim.step.lanes import add, add_matrix, add_product, copy, fill, kick, row
from sim.step.parts.forces import add_contact, damping_forces, processed_by_terms, whole_energy


@inlined
def observed_state(
    s: Array, step: StepArrays, watch: WatchArrays, momenta: bool, width: int = W
) -> None:
    """Write q*, and p* in the middle of the kicks if ``momenta``, corrected by the processor."""
    q0, p0, g0 = watch.at.q, watch.at.p, watch.at.contact
    n, slots = step.matrix.shape[0] // 2, step.slot_mass.size
    for i in range(n):
        copy(row(s, q0 + i, 1, width), row(s, i, 1, width), width)
    for slot in range(slots):
        q, g = row(s, q0 + step.slot_mass[slot], 1, width), row(s, g0 + 2 * slot, 1, width)
        add(q, g, -step.slot_shift[slot], width)
    if momenta:
        for i in range(n):
            copy(row(s, p0 + i, 1, width), row(s, n + i, 1, width), width)
        add_matrix(s, p0, 0, watch.half_springs, -1.0, width)
        for slot in range(slots):
            shift = step.slot_shift[slot]
            p, g = row(s, p0 + step.slot_mass[slot], 1, width), row(s, g0 + 2 * slot, 2, width)
            kick(p, g, watch.half_kick, shift, width)
            for k in range(width):
                p[k] *= 1.0 + shift * g[width + k]
        for i in range(n):
            for slot in range(slots):
                force = row(s, g0 + 2 * slot, 1, width)
                add(row(s, p0 + i, 1, width), force, watch.cross[i, slot], width)


@njit(inline="always")
def observe(
    s: Array, V: Array, H: Array, step: StepArrays, watch: WatchArrays, contact: bool,
    damping: bool, energy_damping: bool, momenta: bool, energy: bool, modes: bool, moments: bool,
    force: Any, potential: Any, width: int = W,
) -> None:  # fmt: skip
    """Write the observed state and all that is asked for of it to the rows of ``watch.at``.

    ``V`` is the potential energy of the state where damping depends on H, ``H`` scratch. Inlined
    before types are inferred, so that nothing is compiled for a flag that is a constant False.
    """
    at = watch.at
    observed_state(s, step, watch, momenta, width)
    if damping and watch.term_shift != 0.0:
        if energy_damping:
            whole_energy(s, H, V, step, width)
        processed_by_terms(s, H, at, watch.term_shift, step, width)
    if energy:
        whole, n = row(s, at.energy, 1, width), step.half_inverse_mass.size
        fill(whole, 0.0, width)
        for i in range(n):
            p = row(s, at.p + i, 1, width)
            add_product(whole, p, p, step.half_inverse_mass[i], width)
            for j in range(n):
                u, v = row(s, at.q + i, 1, width), row(s, at.q + j, 1, width)
                add_product(whole, u, v, 0.5 * step.stiffness_matrix[i, j], width)
        if contact:
            add_contact(s, at.q, at.energy, step, potential, False, width)
    if modes:
        u = row(s, at.work, 1, width)
        for m in range(watch.mode_q.shape[0]):
            modal = row(s, at.modal + m, 1, width)
            fill(modal, 0.0, width)
            for first, shape in ((at.q, watch.mode_q), (at.p, watch.mode_p)):
                fill(u, 0.0, width)
                for r in range(shape.shape[1]):
                    add(u, row(s, first + r, 1, width), shape[m, r], width)
                add_product(modal, u, u, 0.5, width)
    if moments:
        n = step.half_inverse_mass.size
        fill(row(s, at.force, n, width), 0.0, n * width)
        add_matrix(s, at.force, at.q, step.stiffness_matrix, 1.0, width)
        if contact:
            add_contact(s, at.q, at.force, step, force, True, width)
        if damping:
            damping_forces(s, at.q, row(s, at.energy, 1, width), at.damping, at.work, step, width)


@inlined
def find_bins(
    x: Array, number: Array, watch: WatchArrays, m: int, axis: int, index: Integers
) -> None:
    """Write the bin of every lane along one axis; the number of bins for outside and for NaN.

    ``number`` is scratch: the bins of a piece count in full above it.
    """
    first, last = watch.piece[m, axis, 0], watch.piece[m, axis, 1]
    fill(number, 0.0)
    for piece in range(first, last):
        p = watch.pieces[piece]
        low, bins, scale = p[0], p[2], p[3]
        if p[4] == 0.0:
            for k in range(W):
                number[k] += np.floor(min(max((x[k] - low) * scale, 0.0), bins))
        else:
            for k in range(W):
                share = np.sqrt(np.sqrt(max((x[k] - low) * scale, 0.0)))
                number[k] += np.floor(min(share * bins, bins))
    low, high, bins = watch.pieces[first, 0], watch.pieces[last - 1, 1], watch.bins[m, axis]
    for k in range(W):
        inside = (x[k] >= low) & (x[k] < high)
        # Rounding may take a value just below an end beyond it.
        index[k] = np.int64(min(number[k], bins - 1.0)) if inside else np.int64(bins)


@inlined
def count_all(
    s: Array, number: Array, index: Integers, second: Integers, live: int, watch: WatchArrays,
    counts: Integers,
) -> None:  # fmt: skip
    """Add one to a bin of every histogram for each of the first ``live`` lanes."""
    for m in range(watch.rows.shape[0]):
        find_bins(row(s, watch.rows[m, 0]), number, watch, m, 0, index)
        if watch.rows[m, 1] >= 0:
            find_bins(row(s, watch.rows[m, 1]), number, watch, m, 1, second)
            bins, columns = watch.bins[m, 0], watch.bins[m, 1]
            for k in range(W):
                inside = (index[k] < bins) & (second[k] < columns)
                index[k] = index[k] * columns + second[k] if inside else bins * columns
        own = counts[watch.start[m] :]
        for k in range(live):
            own[index[k]] += 1
