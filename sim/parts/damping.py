"""Damping that depends on the state: each term's flow at fixed q, and the forces of all.

A term changes one momentum only, ``p_i' = −κ p_i^N`` with κ constant unless H is in it: a shift, an
exponential, or ``p/(1 + (N−1) κ p^(N−1) t)^(1/(N−1))``. Where that base is not positive the flow
has blown up: the momentum becomes NaN and the trajectory counts as lost. With H the rate is that in
the middle of the step, from a predictor.
"""

import numpy as np

from fpk.arrays import Array
from fpk.compiling import inlined
from sim.arrays import LANES as W
from sim.arrays import Rows, StepArrays, TermArrays
from sim.lanes import add, add_matrix, add_product, copy, fill, multiply, row


@inlined
def term_rate(rate: Array, s: Array, first: int, terms: TermArrays, k: int, own: int) -> None:
    """Write κ p^own of term k, without its H, at the state from row ``first`` on."""
    fill(rate, terms.scale[k])
    for f in range(terms.first[k], terms.first[k + 1] - terms.power[k] + own):
        multiply(rate, row(s, first + terms.factor[f]))


@inlined
def flow(p: Array, rate: Array, N: int, t: float) -> None:
    """Replace p by the solution of ``p' = −rate p^N`` after ``t``; NaN after a blow-up."""
    if N == 0:
        for k in range(W):
            p[k] -= t * rate[k]
    elif N == 1:
        for k in range(W):
            p[k] *= np.exp(-t * rate[k])
    elif N == 2:
        for k in range(W):
            base = 1.0 + t * rate[k] * p[k]
            p[k] = p[k] / base if base > 0.0 else np.nan
    elif N == 3:
        for k in range(W):
            base = 1.0 + 2.0 * t * rate[k] * p[k] * p[k]
            p[k] = p[k] / np.sqrt(base) if base > 0.0 else np.nan
    else:
        for k in range(W):
            power = 1.0
            for _ in range(N - 1):
                power *= p[k]
            base = 1.0 + (N - 1) * t * rate[k] * power
            p[k] = p[k] * base ** (-1.0 / (N - 1)) if base > 0.0 else np.nan


@inlined
def spring_energy(s: Array, V: Array, step: StepArrays) -> None:
    """Write ½ qᵀ K q of the state; contact is added elsewhere."""
    fill(V, 0.0)
    K = step.stiffness_matrix
    for i in range(K.shape[0]):
        for j in range(K.shape[0]):
            add_product(V, row(s, i), row(s, j), 0.5 * K[i, j])


@inlined
def whole_energy(s: Array, H: Array, V: Array, step: StepArrays) -> None:
    """Write H = V + Σ p²/(2m) of the state."""
    copy(H, V)
    n = step.half_inverse_mass.size
    for i in range(n):
        add_product(H, row(s, n + i), row(s, n + i), step.half_inverse_mass[i])


@inlined
def term_flow(s: Array, work: int, step: StepArrays, k: int) -> None:
    """Advance the state by term k alone over half a step; with H^e, half-way from a predictor.

    Scratch rows from ``work``: rate, potential energy (given), H, half-way p, rate with H.
    """
    rate, V, H = row(s, work), row(s, work + 1), row(s, work + 2)
    middle, with_energy = row(s, work + 3), row(s, work + 4)
    terms, t = step.terms, 0.5 * step.dt
    p = row(s, terms.target[k])
    term_rate(rate, s, 0, terms, k, 0)
    if terms.energy[k] > 0:
        whole_energy(s, H, V, step)
        a = step.half_inverse_mass[terms.target[k] - step.half_inverse_mass.size]
        copy(with_energy, rate)
        copy(middle, p)
        multiply(with_energy, H, terms.energy[k])
        flow(middle, with_energy, terms.power[k], 0.5 * t)
        add_product(H, middle, middle, a)
        add_product(H, p, p, -a)
        multiply(rate, H, terms.energy[k])
    flow(p, rate, terms.power[k], t)


@inlined
def damping_forces(s: Array, first: int, H: Array, to: int, work: int, step: StepArrays) -> None:
    """Write Σ_j c̃_ij v_j of the terms at the state from row ``first``, whose energy is ``H``."""
    n, rate, terms = step.half_inverse_mass.size, row(s, work), step.terms
    fill(row(s, to, n), 0.0, n * W)
    for k in range(terms.target.size):
        term_rate(rate, s, first, terms, k, terms.power[k])
        multiply(rate, H, terms.energy[k])
        add(row(s, to + terms.target[k] - n), rate, 1.0)


@inlined
def change_of_term(
    change: Array, one: Array, s: Array, state: int, rates: int, terms: TermArrays, k: int
) -> None:
    """Write the rate of change of term k's force, without its H, as (q, p) change by ``rates``."""
    first, last = terms.first[k], terms.first[k + 1]
    fill(change, 0.0)
    for moving in range(first, last):
        fill(one, terms.scale[k])
        for f in range(first, last):
            multiply(one, row(s, (rates if f == moving else state) + terms.factor[f]))
        add(change, one, 1.0)


@inlined
def processed_by_terms(s: Array, H: Array, at: Rows, shift: float, step: StepArrays) -> None:
    """Change the observed (q*, p*) by the processor of the terms; ``H`` is that of the state.

    ``q_i* = q_i − (h²/12) D_i/m_i``, ``p_i* = p_i + (h²/12) dD_i/dt`` along the flow of the springs
    and of the contact with the other sign: docs/theory.md, "The step of the simulation".
    """
    terms = step.terms
    n, work = step.half_inverse_mass.size, at.work
    fill(row(s, at.change, 3 * n), 0.0, 3 * n * W)
    # (M⁻¹ p, −K q), the flow of the springs alone.
    for i in range(n):
        add(row(s, at.change + i), row(s, at.p + i), 2.0 * step.half_inverse_mass[i])
    add_matrix(s, at.change + n, at.q, step.stiffness_matrix, -1.0)
    for slot in range(step.slot_mass.size):
        force = row(s, at.change + n + step.slot_mass[slot])
        add(force, row(s, at.contact + 2 * slot), 1.0)
    damping_forces(s, at.q, H, at.damping, work, step)
    change, one = row(s, work), row(s, work + 3)
    for k in range(terms.target.size):
        change_of_term(change, one, s, at.q, at.change, terms, k)
        multiply(change, H, terms.energy[k])
        add(row(s, at.change + n + terms.target[k]), change, 1.0)
    for i in range(n):
        a = 2.0 * shift * step.half_inverse_mass[i]
        add(row(s, at.q + i), row(s, at.damping + i), -a)
        add(row(s, at.p + i), row(s, at.change + 2 * n + i), shift)
