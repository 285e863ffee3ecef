"""Contact forces, damping terms and the observed state, lane by lane.

Every function reads and writes rows of ``width`` lanes of the workspace ``s`` (``arrays.Rows``).
Contact laws are compiled functions, None for a system without stops. A damping term changes one
momentum only, ``p_i' = −κ p_i^N``, κ constant unless the term contains H: the solution is a shift,
an exponential, or ``p/(1 + (N−1) κ p^(N−1) t)^(1/(N−1))``. If the base is not positive the solution
has blown up: the momentum becomes NaN and the trajectory counts as lost. With H, κ is taken in the
middle of the step, from a predictor.

The scratch rows from ``at.work`` are the rate of a term, V and H of the state, and two more.
"""

from typing import Any

import numpy as np
from numba import njit

from fpk.numeric.arrays import Array, Integers
from fpk.numeric.compiling import njit_inline
from fpk.system.compiled_laws import of_law
from sim.step.arrays import StepArrays, TermArrays, W, WatchArrays
from sim.step.lanes import (
    add,
    add_matrix,
    add_product,
    copy,
    fill,
    kick,
    multiply,
    quadratic_form,
    row,
)


@njit_inline
def numbers_of(step: StepArrays, stop: int) -> tuple[float, float, float, float, Any]:
    """Return sign (0: both sides), clearance, stiffness, exponent and law number of a ``stop``."""
    s = step.stops[stop]
    return s[0], s[1], s[2], s[3], np.int64(s[4])


@njit_inline
def overlap_of(q: float, sign: float, clearance: float) -> tuple[float, float]:
    """Return d and the overlap max(d ``q`` − ``clearance``, 0); d: ``sign``, or if 0 q's sign."""
    d = sign if sign != 0.0 else np.copysign(1.0, q)
    return d, max(d * q - clearance, 0.0)


@njit_inline
def contact_forces(
    s: Array, g0: int, step: StepArrays, force: Any, slope: Any, width: int = W
) -> None:
    """Write the contact force g and dg/dq of every slot to two rows of ``s`` each, from ``g0``.

    q are the first rows of ``s``, of ``width`` lanes; g = dU/dq, so that p' = −g. ``force``,
    ``slope``: parts of the contact laws for ``of_law``.
    """
    rows = 2 * step.slot_mass.size
    fill(row(s, g0, rows, width), 0.0, rows * width)
    for stop in range(step.stop_slot.size):
        slot = step.stop_slot[stop]
        q = row(s, step.slot_mass[slot], 1, width)
        g = row(s, g0 + 2 * slot, 2, width)
        sign, clearance, B, e, law = numbers_of(step, stop)
        for k in range(width):
            d, o = overlap_of(q[k], sign, clearance)
            g[k] += d * B * of_law(force, law, o, e)
            g[width + k] += B * of_law(slope, law, o, e) if o > 0.0 else 0.0


@njit_inline
def kick_by_contact(s: Array, g0: int, step: StepArrays, n: int, width: int = W) -> None:
    """Subtract h g (1 − w h² g'/m) from the momenta, rows ``n``… of ``s``; g, g' at row ``g0``."""
    for slot in range(step.slot_mass.size):
        p, g = row(s, n + step.slot_mass[slot], 1, width), row(s, g0 + 2 * slot, 2, width)
        kick(p, g, step.dt, step.slot_shift[slot], width)


@njit_inline
def add_contact(
    s: Array, q0: int, to: int, step: StepArrays, law_part: Any, forces: bool, width: int = W
) -> None:
    """Add the contact forces g = dU/dq at q to the rows of ``s`` from ``to``, a row for each mass.

    q: rows from ``q0``, of ``width`` lanes. ``law_part`` is the laws' force; if not ``forces``,
    their energy: the whole U is added to the row ``to``.
    """
    for stop in range(step.stop_slot.size):
        i = step.slot_mass[step.stop_slot[stop]]
        q, f = row(s, q0 + i, 1, width), row(s, to + i if forces else to, 1, width)
        sign, clearance, B, e, law = numbers_of(step, stop)
        for k in range(width):
            d, o = overlap_of(q[k], sign, clearance)
            size = d * B if forces else B
            f[k] += size * of_law(law_part, law, o, e)


@njit_inline
def potential_energy(
    s: Array, q0: int, to: int, step: StepArrays, potential: Any, width: int = W
) -> None:
    """Write V = ½ qᵀ K q + U(q) to the row ``to`` of ``s`` (``width`` lanes); q: rows ``q0``…."""
    quadratic_form(row(s, to, 1, width), s, q0, step.stiffness_matrix, 0.5, width)
    add_contact(s, q0, to, step, potential, False, width)


@njit_inline
def add_kinetic(H: Array, s: Array, p0: int, step: StepArrays, width: int = W) -> None:
    """Add Σ p²/(2m) to the row ``H`` (``width`` lanes); p: the rows of ``s`` from ``p0``."""
    for i in range(step.half_inverse_mass.size):
        p = row(s, p0 + i, 1, width)
        add_product(H, p, p, step.half_inverse_mass[i], width)


@njit_inline
def whole_energy(s: Array, work: int, step: StepArrays, width: int = W) -> None:
    """Write H = V + Σ p²/(2m) of the state (q, p) in the first rows of ``s`` to row ``work`` + 2.

    V is read from the row ``work`` + 1; rows have ``width`` lanes.
    """
    H = row(s, work + 2, 1, width)
    copy(H, row(s, work + 1, 1, width), width)
    add_kinetic(H, s, step.half_inverse_mass.size, step, width)


@njit_inline
def term_rate(
    rate: Array, s: Array, first: int, terms: TermArrays, k: int, exponent: int, width: int = W
) -> None:
    """Write κ p_i^``exponent`` to the row ``rate``; damping term ``k`` is p_i' = −κ H^e p_i^N.

    The state (q, p) is in the rows of ``s`` from number ``first`` on, of ``width`` lanes.
    """
    fill(rate, terms.scale[k], width)
    for f in range(terms.first[k], terms.first[k + 1] - terms.power[k] + exponent):
        multiply(rate, row(s, first + terms.factor[f], 1, width), 1, width)


@njit_inline
def flow(p: Array, rate: Array, N: int, t: float, width: int = W) -> None:
    """Replace ``p`` (``width``,) by p(``t``) of p' = −``rate`` p^``N``; NaN after a blow-up."""
    if N == 0:
        for k in range(width):
            p[k] -= t * rate[k]
    elif N == 1:
        for k in range(width):
            p[k] *= np.exp(-t * rate[k])
    elif N == 2:
        for k in range(width):
            base = 1.0 + t * rate[k] * p[k]
            p[k] = p[k] / base if base > 0.0 else np.nan
    elif N == 3:
        for k in range(width):
            base = 1.0 + 2.0 * t * rate[k] * p[k] * p[k]
            p[k] = p[k] / np.sqrt(base) if base > 0.0 else np.nan
    else:
        for k in range(width):
            power = 1.0
            for _ in range(N - 1):
                power *= p[k]
            base = 1.0 + (N - 1) * t * rate[k] * power
            p[k] = p[k] * base ** (-1.0 / (N - 1)) if base > 0.0 else np.nan


@njit_inline
def term_flows(
    s: Array, work: int, step: StepArrays, backwards: bool, with_energy: bool, width: int = W
) -> None:
    """Advance the state in ``s`` (``width`` lanes) by each damping term alone over half a step.

    ``backwards``: in reverse order. ``with_energy``, a constant: some term contains H^e; V of the
    state is then in row ``work`` + 1, and H is taken half-way, from a predictor.
    """
    terms, rate, h = step.terms, row(s, work, 1, width), step.dt
    for index in range(terms.target.size):
        k = terms.target.size - 1 - index if backwards else index
        p, N = row(s, terms.target[k], 1, width), terms.power[k]
        term_rate(rate, s, 0, terms, k, 0, width)
        if with_energy and terms.energy[k] > 0:
            H, middle = row(s, work + 2, 1, width), row(s, work + 3, 1, width)
            predicted = row(s, work + 4, 1, width)
            whole_energy(s, work, step, width)
            a = step.half_inverse_mass[terms.target[k] - step.half_inverse_mass.size]
            copy(predicted, rate, width)
            copy(middle, p, width)
            multiply(predicted, H, terms.energy[k], width)
            flow(middle, predicted, N, 0.25 * h, width)
            add_product(H, middle, middle, a, width)
            add_product(H, p, p, -a, width)
            multiply(rate, H, terms.energy[k], width)
        flow(p, rate, N, 0.5 * h, width)


@njit_inline
def damping_forces(
    s: Array, first: int, H: Array, watch: WatchArrays, step: StepArrays, width: int = W
) -> None:
    """Write D_i = Σ_j c̃_ij v_j, p_i' = −D_i, to the rows of ``s`` from ``watch.damping``.

    The state is in the rows from ``first``, of ``width`` lanes; the row ``H``, its energy, is only
    read if a term contains H.
    """
    n, rate, terms = step.half_inverse_mass.size, row(s, watch.work, 1, width), step.terms
    fill(row(s, watch.damping, n, width), 0.0, n * width)
    for k in range(terms.target.size):
        term_rate(rate, s, first, terms, k, terms.power[k], width)
        multiply(rate, H, terms.energy[k], width)
        add(row(s, watch.damping + terms.target[k] - n, 1, width), rate, 1.0, width)


@njit_inline
def apply_term_processor(
    s: Array, watch: WatchArrays, shift: float, step: StepArrays, width: int = W
) -> None:
    """Apply the processor of the damping terms to the observed q and p in ``s``, in place.

    ``q_i − shift D_i/m_i`` and ``p_i + shift dD_i/dt``, ``shift`` = h²/12, D_i the force of the
    terms, d/dt along springs and the contact force of the other sign, replace them: docs/theory.md,
    "The step of the simulation". Rows of ``width`` lanes.
    """
    terms, H = step.terms, row(s, watch.work + 2, 1, width)
    n, work = step.half_inverse_mass.size, watch.work
    fill(row(s, watch.change, 3 * n, width), 0.0, 3 * n * width)
    # d(q, p)/dt: M⁻¹ p, −K q + g.
    for i in range(n):
        p = row(s, watch.p + i, 1, width)
        add(row(s, watch.change + i, 1, width), p, 2.0 * step.half_inverse_mass[i], width)
    add_matrix(s, watch.change + n, watch.q, step.stiffness_matrix, -1.0, width)
    for slot in range(step.slot_mass.size):
        force = row(s, watch.change + n + step.slot_mass[slot], 1, width)
        add(force, row(s, watch.contact + 2 * slot, 1, width), 1.0, width)
    damping_forces(s, watch.q, H, watch, step, width)
    change, product = row(s, work, 1, width), row(s, work + 3, 1, width)
    for k in range(terms.target.size):
        # The product rule, without H.
        fill(change, 0.0, width)
        for moving in range(terms.first[k], terms.first[k + 1]):
            fill(product, terms.scale[k], width)
            for f in range(terms.first[k], terms.first[k + 1]):
                first = watch.change if f == moving else watch.q
                multiply(product, row(s, first + terms.factor[f], 1, width), 1, width)
            add(change, product, 1.0, width)
        multiply(change, H, terms.energy[k], width)
        add(row(s, watch.change + n + terms.target[k], 1, width), change, 1.0, width)
    for i in range(n):
        a = 2.0 * shift * step.half_inverse_mass[i]
        add(row(s, watch.q + i, 1, width), row(s, watch.damping + i, 1, width), -a, width)
        add(row(s, watch.p + i, 1, width), row(s, watch.change + 2 * n + i, 1, width), shift, width)


@njit(inline="always")
def observe(
    s: Array, step: StepArrays, watch: WatchArrays, damping: bool, energy_damping: bool,
    energy: bool, moments: bool, force: Any, potential: Any, width: int = W,
) -> None:  # fmt: skip
    """Write the observed state, its energies and its forces to the rows of ``s`` in ``watch``.

    Observed are q, and p in the middle of the kicks, both corrected by the processor; g and g' are
    read from the rows ``watch.contact``. A flag (see ``KernelKey``) that is a constant False
    compiles nothing. Rows of ``width`` lanes.
    """
    n, slots = step.half_inverse_mass.size, step.slot_mass.size
    copy(row(s, watch.q, 2 * n, width), row(s, 0, 2 * n, width), 2 * n * width)
    add_matrix(s, watch.p, 0, watch.half_springs, -1.0, width)
    for slot in range(slots):
        i, shift = step.slot_mass[slot], step.slot_shift[slot]
        g = row(s, watch.contact + 2 * slot, 2, width)
        add(row(s, watch.q + i, 1, width), g, -shift, width)
        p = row(s, watch.p + i, 1, width)
        kick(p, g, watch.half_kick, shift, width)
        for k in range(width):
            p[k] *= 1.0 + shift * g[width + k]
    for i in range(n):
        for slot in range(slots):
            g = row(s, watch.contact + 2 * slot, 1, width)
            add(row(s, watch.p + i, 1, width), g, watch.cross[i, slot], width)
    if damping and watch.term_shift != 0.0:
        if energy_damping:
            whole_energy(s, watch.work, step, width)
        apply_term_processor(s, watch, watch.term_shift, step, width)
    whole = row(s, watch.energy, 1, width)
    if energy:
        potential_energy(s, watch.q, watch.energy, step, potential, width)
        add_kinetic(whole, s, watch.p, step, width)
    u = row(s, watch.work, 1, width)
    for m in range(watch.mode_q.shape[0]):
        modal = row(s, watch.modal + m, 1, width)
        fill(modal, 0.0, width)
        for first, shape in ((watch.q, watch.mode_q), (watch.p, watch.mode_p)):
            fill(u, 0.0, width)
            for r in range(n):
                add(u, row(s, first + r, 1, width), shape[m, r], width)
            add_product(modal, u, u, 0.5, width)
    if moments:
        fill(row(s, watch.force, n, width), 0.0, n * width)
        add_matrix(s, watch.force, watch.q, step.stiffness_matrix, 1.0, width)
        add_contact(s, watch.q, watch.force, step, force, True, width)
        if damping:
            damping_forces(s, watch.q, whole, watch, step, width)


@njit_inline
def find_bins(
    x: Array, number: Array, watch: WatchArrays, m: int, axis: int, index: Integers
) -> None:
    """Write the bin of each lane's ``x`` on ``axis`` of histogram ``m`` to ``index``, from 0.

    Outside the bins and for NaN it is the number of bins. ``number`` is a scratch row.
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


@njit_inline
def count_all(
    s: Array, number: Array, index: Integers, second: Integers, live: int, watch: WatchArrays,
    counts: Integers,
) -> None:  # fmt: skip
    """Add 1 to ``counts`` at the bin of each of the first ``live`` lanes of ``s``, per histogram.

    ``number``, ``index`` and ``second`` are scratch rows.
    """
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
