"""The observed state, products of its rows, and histograms."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from fpk.compiling import FLAGS
from sim.arrays import LANES, StepArrays, WatchArrays
from sim.lanes import (
    add,
    add_matrix,
    add_product,
    bin_of,
    copy,
    count,
    fill,
    grow,
    join_bins,
    kick,
    row,
)

Array = NDArray[np.float64]
Integers = NDArray[np.int64]
W = LANES

FOLDED = 16
"""Sums of a product over a block whose trajectories are not wanted each: a vector or two."""


@njit(fastmath=FLAGS, error_model="numpy", forceinline=True)
def observed_displacements(s: Array, step: StepArrays, watch: WatchArrays) -> None:
    """Write q*, corrected by the processor; without contact it is q."""
    q0, g0 = watch.at.q, watch.at.contact
    for i in range(step.matrix.shape[0] // 2):
        copy(row(s, q0 + i), row(s, i))
    for slot in range(step.slot_mass.size):
        add(row(s, q0 + step.slot_mass[slot]), row(s, g0 + 2 * slot), -step.slot_shift[slot])


@njit(fastmath=FLAGS, error_model="numpy", forceinline=True)
def observed_momenta(s: Array, step: StepArrays, watch: WatchArrays) -> None:
    """Write p*, in the middle of the kicks and corrected by the processor."""
    p0, g0 = watch.at.p, watch.at.contact
    n, slots = step.matrix.shape[0] // 2, step.slot_mass.size
    for i in range(n):
        copy(row(s, p0 + i), row(s, n + i))
    add_matrix(s, p0, 0, watch.half_springs, -1.0)
    for slot in range(slots):
        p, g = row(s, p0 + step.slot_mass[slot]), row(s, g0 + 2 * slot, 2)
        kick(p, g, watch.half_kick, step.slot_shift[slot])
        grow(p, g[W:], step.slot_shift[slot])
    for i in range(n):
        for slot in range(slots):
            add(row(s, p0 + i), row(s, g0 + 2 * slot), watch.cross[i, slot])


@njit(fastmath=FLAGS, error_model="numpy", forceinline=True)
def observed_energy(s: Array, step: StepArrays, watch: WatchArrays) -> None:
    """Write kinetic energy and that of the springs of (q*, p*); contact is added elsewhere."""
    H = row(s, watch.at.energy)
    fill(H, 0.0)
    n = step.half_inverse_mass.size
    for i in range(n):
        p = row(s, watch.at.p + i)
        add_product(H, p, p, step.half_inverse_mass[i])
        for j in range(n):
            K = step.stiffness_matrix[i, j]
            add_product(H, row(s, watch.at.q + i), row(s, watch.at.q + j), 0.5 * K)


@njit(fastmath=FLAGS, error_model="numpy", forceinline=True)
def observed_modes(s: Array, mode_q: Array, mode_p: Array, watch: WatchArrays) -> None:
    """Write the modal energies ½ (P_m² + ω_m² Q_m²) of (q*, p*)."""
    u = row(s, watch.at.work)
    for m in range(mode_q.shape[0]):
        H = row(s, watch.at.modal + m)
        fill(H, 0.0)
        for first, shape in ((watch.at.q, mode_q), (watch.at.p, mode_p)):
            fill(u, 0.0)
            for r in range(shape.shape[1]):
                add(u, row(s, first + r), shape[m, r])
            add_product(H, u, u, 0.5)


@njit(fastmath=FLAGS, error_model="numpy", forceinline=True)
def add_products(
    s: Array, b: int, sums: Array, folded: Array, live: Integers, watch: WatchArrays
) -> None:
    """Add the products of rows of block ``b``: lane by lane in the first blocks.

    In the others lanes ``FOLDED`` apart share one sum.
    """
    for m in range(watch.products.shape[0]):
        u, v = row(s, watch.products[m, 0]), row(s, watch.products[m, 1])
        if b < sums.shape[0]:
            add_product(row(sums[b], m), u, v, 1.0)
        else:
            to = row(folded[b - sums.shape[0]], m, 1, FOLDED)
            if live[b] == W:
                for j in range(0, W, FOLDED):
                    add_product(to, u[j:], v[j:], 1.0, FOLDED)
            else:
                for k in range(live[b]):
                    to[k % FOLDED] += u[k] * v[k]


@njit(fastmath=FLAGS, error_model="numpy", forceinline=True)
def count_all(
    s: Array, index: Integers, second: Integers, live: int, watch: WatchArrays, counts: Integers
) -> None:
    """Count the lanes in every histogram."""
    for m in range(watch.rows.shape[0]):
        low, scale, bins = watch.low[m], watch.scale[m], watch.bins[m]
        bin_of(row(s, watch.rows[m, 0]), low[0], scale[0], bins[0], index)
        if watch.rows[m, 1] >= 0:
            bin_of(row(s, watch.rows[m, 1]), low[1], scale[1], bins[1], second)
            join_bins(index, second, bins[0], bins[1])
        count(counts[watch.start[m] :], index, live)
