"""The compiled stepper: many steps of many blocks of lanes, with only the effects asked for."""

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple
from zlib import crc32

import numpy as np
from numba import njit
from numpy.typing import NDArray

from sim.compiled_laws import compiled_laws
from sim.lanes import (
    add,
    add_product,
    apply_map,
    bin_of,
    copy,
    count,
    fill,
    grow,
    join_bins,
    kick,
    row,
)
from sim.random import FLAGS, LANES, fill_normals

Array = NDArray[np.float64]
Integers = NDArray[np.int64]
W = LANES


@dataclass(frozen=True)
class KernelKey:
    """What a kernel is compiled for: contact laws in force and kinds of observation."""

    laws: tuple[str, ...] = ()
    kick_first: bool = True
    observed: bool = False
    momenta: bool = False
    energy: bool = False
    moments: bool = False


class StepArrays(NamedTuple):
    """Numbers of one step; ``matrix`` is (propagator, factor) with columns padded."""

    matrix: Array  # (2n, columns)
    pairs: int
    dt: float
    slot_mass: Integers  # (slots,), the masses that touch something
    slot_shift: Array  # (slots,), w h² / m of the modified kick and of the observed q
    stop_slot: Integers  # (stops,)
    stop_fresh: NDArray[np.bool_]  # (stops,), first of its slot
    stop_sign: Array  # (stops,), +1, −1, or 0 for the same stop on either side
    stop_clearance: Array
    stop_stiffness: Array
    stop_exponent: Array
    stop_law: Integers


class WatchArrays(NamedTuple):
    """What is observed, and where it is counted."""

    half_kick: float  # share of the kick that belongs to the observed momentum, times dt
    half_springs: Array  # (n, n), the same of the springs
    cross: Array  # (n, slots), w h² c_ik / m_k
    stiffness_matrix: Array  # (n, n)
    mass: Array  # (n,)
    rows: Integers  # (histograms, 2), rows of the coordinates, second −1 for one coordinate
    low: Array  # (histograms, 2)
    scale: Array  # (histograms, 2), bins per unit
    bins: Integers  # (histograms, 2)
    start: Integers  # (histograms,), first bin of each in the counts
    products: Integers  # (moments, 2), rows whose products are summed


def observed_rows(n: int, slots: int, columns: int) -> int:
    """Return the first observed row: q* (n), p* (n), total force at q* (n), H (1) follow."""
    return columns + 2 * n + 2 * slots


def source_stamp() -> int:
    """Return a checksum of this room's sources.

    The disk cache looks at the file of the kernel only; closing over the stamp makes it miss
    when a function that the kernel calls was edited.
    """
    files = sorted(Path(__file__).parent.glob("*.py"))
    return crc32(b"".join(file.read_bytes() for file in files))


@lru_cache
def compiled_kernel(key: KernelKey) -> Any:
    """Return the kernel of ``key``; laws that it does not need are not compiled."""
    contact, observed = bool(key.laws), key.observed
    kick_first, momenta, energy, moments = key.kick_first, key.momenta, key.energy, key.moments
    stamp = source_stamp()
    force: Any = compiled_laws(key.laws, "force") if contact else None
    slope: Any = compiled_laws(key.laws, "slope") if contact else None
    potential: Any = compiled_laws(key.laws, "energy") if contact and energy else None

    @njit(fastmath=FLAGS, error_model="numpy", cache=True, nogil=True)
    def advance(
        x: Array,
        sums: Array,
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

        Observes at the start of a step where ``(phase + step number) % stride == 0``; adds to
        ``sums`` (blocks, moments·W) and ``counts`` (all bins, one more a histogram for outside).
        """
        n, columns = step.matrix.shape[0] // 2, step.matrix.shape[1]
        slots = step.slot_mass.size
        g0 = columns + 2 * n
        q0 = g0 + 2 * slots
        p0, f0, h0 = q0 + n, q0 + 2 * n, q0 + 3 * n
        s = np.zeros((h0 + 1) * W) if stamp >= 0 else np.zeros(0)
        index, second = np.zeros(W, np.int64), np.zeros(W, np.int64)
        for b in range(x.shape[0]):
            trajectory = np.uint64((first + b) * W)
            s[: 2 * n * W] = x[b]
            for t in range(steps):
                if contact:
                    for stop in range(step.stop_slot.size):
                        slot, law = step.stop_slot[stop], step.stop_law[stop]
                        q, g = row(s, step.slot_mass[slot]), row(s, g0 + 2 * slot, 2)
                        clearance, sign = step.stop_clearance[stop], step.stop_sign[stop]
                        B, e = step.stop_stiffness[stop], step.stop_exponent[stop]
                        if step.stop_fresh[stop]:
                            fill(g, 0.0)
                            fill(g[W:], 0.0)
                        if sign != 0.0:
                            for k in range(W):
                                o = max(sign * q[k] - clearance, 0.0)
                                g[k] += sign * B * force(law, o, e)
                                g[W + k] += B * slope(law, o, e) if o > 0.0 else 0.0
                        else:
                            for k in range(W):
                                o = max(abs(q[k]) - clearance, 0.0)
                                g[k] += np.copysign(B, q[k]) * force(law, o, e)
                                g[W + k] += B * slope(law, o, e) if o > 0.0 else 0.0
                if observed and (phase + t) % stride == 0:
                    for i in range(n):
                        copy(row(s, q0 + i), row(s, i))
                        if momenta:
                            copy(row(s, p0 + i), row(s, n + i))
                            for j in range(n):
                                add(row(s, p0 + i), row(s, j), -watch.half_springs[i, j])
                    if contact:
                        for slot in range(slots):
                            i, g = step.slot_mass[slot], row(s, g0 + 2 * slot, 2)
                            a = step.slot_shift[slot]
                            add(row(s, q0 + i), g, -a)
                            if momenta:
                                kick(row(s, p0 + i), g, watch.half_kick, a)
                                grow(row(s, p0 + i), g[W:], a)
                        if momenta:
                            for i in range(n):
                                for slot in range(slots):
                                    add(row(s, p0 + i), row(s, g0 + 2 * slot), watch.cross[i, slot])
                    if energy:
                        H = row(s, h0)
                        fill(H, 0.0)
                        for i in range(n):
                            p = row(s, p0 + i)
                            add_product(H, p, p, 0.5 / watch.mass[i])
                            for j in range(n):
                                K = watch.stiffness_matrix[i, j]
                                add_product(H, row(s, q0 + i), row(s, q0 + j), 0.5 * K)
                    if moments:
                        for i in range(n):
                            fill(row(s, f0 + i), 0.0)
                            for j in range(n):
                                K = watch.stiffness_matrix[i, j]
                                add(row(s, f0 + i), row(s, q0 + j), K)
                    if contact and (energy or moments):
                        for stop in range(step.stop_slot.size):
                            i, law = step.slot_mass[step.stop_slot[stop]], step.stop_law[stop]
                            q, f, H = row(s, q0 + i), row(s, f0 + i), row(s, h0)
                            clearance, sign = step.stop_clearance[stop], step.stop_sign[stop]
                            B, e = step.stop_stiffness[stop], step.stop_exponent[stop]
                            for k in range(W):
                                d = sign if sign != 0.0 else np.copysign(1.0, q[k])
                                o = max(d * q[k] - clearance, 0.0)
                                if moments:
                                    f[k] += d * B * force(law, o, e)
                                if energy:
                                    H[k] += B * potential(law, o, e)
                    if moments:
                        for m in range(watch.products.shape[0]):
                            u, v = row(s, watch.products[m, 0]), row(s, watch.products[m, 1])
                            add_product(row(sums[b], m), u, v, 1.0)
                    for m in range(watch.rows.shape[0]):
                        low, scale, bins = watch.low[m], watch.scale[m], watch.bins[m]
                        bin_of(row(s, watch.rows[m, 0]), low[0], scale[0], bins[0], index)
                        if watch.rows[m, 1] >= 0:
                            bin_of(row(s, watch.rows[m, 1]), low[1], scale[1], bins[1], second)
                            join_bins(index, second, bins[0], bins[1])
                        count(counts[watch.start[m] :], index, live[b])
                if contact and kick_first:
                    for slot in range(slots):
                        p, g = row(s, n + step.slot_mass[slot]), row(s, g0 + 2 * slot, 2)
                        kick(p, g, step.dt, step.slot_shift[slot])
                for pair in range(step.pairs):
                    word = counter + np.uint64(t * step.pairs + pair)
                    fill_normals(row(s, 2 * n + 2 * pair, 2), trajectory, word, offset)
                apply_map(s, step.matrix, columns)
                if contact and not kick_first:
                    for slot in range(slots):
                        p, g = row(s, n + step.slot_mass[slot]), row(s, g0 + 2 * slot, 2)
                        kick(p, g, step.dt, step.slot_shift[slot])
            x[b] = s[: 2 * n * W]

    return advance
