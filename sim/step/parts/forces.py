"""Forces and energies of contact, and damping that depends on the state, lane by lane.

Contact laws come as compiled functions. A damping term changes one momentum only,
``p_i' = −κ p_i^N`` with κ constant unless H is in it: a shift, an exponential, or
``p/(1 + (N−1) κ p^(N−1) t)^(1/(N−1))``. Where that base is not positive the flow has blown up: the
momentum becomes NaN and the trajectory counts as lost. With H the rate is that in the middle of the
step, from a predictor.
"""

from typing import Any

import numpy as np

from fpk.numeric.arrays import Array
from fpk.numeric.compiling import inlined
from fpk.system.compiled_laws import of_law
from sim.step.arrays import Rows, StepArrays, TermArrays, W
from sim.step.lanes import add, add_matrix, add_product, copy, fill, kick, multiply, row

Stop = tuple[float, float, float, float, Any]
"""Sign, clearance, stiffness, exponent and law of a stop."""


@inlined
def numbers_of(step: StepArrays, stop: int) -> Stop:
    """Return the numbers of one stop."""
    s = step.stops[stop]
    return s[0], s[1], s[2], s[3], np.int64(s[4])


@inlined
def overlap_of(q: float, sign: float, clearance: float) -> tuple[float, float]:
    """Return the side on which the displacement ``q`` lies and its overlap with the stop there."""
    d = sign if sign != 0.0 else np.copysign(1.0, q)
    return d, max(d * q - clearance, 0.0)


@inlined
def contact_forces(
    s: Array, g0: int, step: StepArrays, force: Any, slope: Any, width: int = W
) -> None:
    """Write g and g' of every slot at the displacements of the state to the rows from ``g0``."""
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


@inlined
def kick_by_contact(s: Array, g0: int, step: StepArrays, n: int, width: int = W) -> None:
    """Take the modified contact forces in the rows from ``g0`` times dt from the momenta."""
    for slot in range(step.slot_mass.size):
        p, g = row(s, n + step.slot_mass[slot], 1, width), row(s, g0 + 2 * slot, 2, width)
        kick(p, g, step.dt, step.slot_shift[slot], width)


@inlined
def add_contact(
    s: Array, q0: int, to: int, step: StepArrays, law_part: Any, forces: bool, width: int = W
) -> None:
    """Add g at the displacements from row ``q0`` to the rows of its masses from ``to``.

    If not ``forces`` it is U, by the laws' energy as ``law_part``, and all goes to row ``to``.
    """
    for stop in range(step.stop_slot.size):
        i = step.slot_mass[step.stop_slot[stop]]
        q, f = row(s, q0 + i, 1, width), row(s, to + i if forces else to, 1, width)
        sign, clearance, B, e, law = numbers_of(step, stop)
        for k in range(width):
            d, o = overlap_of(q[k], sign, clearance)
            size = d * B if forces else B
            f[k] += size * of_law(law_part, law, o, e)


@inlined
def term_rate(
    rate: Array, s: Array, first: int, terms: TermArrays, k: int, own: int, width: int = W
) -> None:
    """Write κ p^own of term k, without its H, at the state from row ``first`` on."""
    fill(rate, terms.scale[k], width)
    for f in range(terms.first[k], terms.first[k + 1] - terms.power[k] + own):
        multiply(rate, row(s, first + terms.factor[f], 1, width), 1, width)


@inlined
def flow(p: Array, rate: Array, N: int, t: float, width: int = W) -> None:
    """Replace p by the solution of ``p' = −rate p^N`` after ``t``; NaN after a blow-up."""
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


@inlined
def spring_energy(s: Array, V: Array, step: StepArrays, width: int = W) -> None:
    """Write ½ qᵀ K q of the state; contact is added elsewhere."""
    fill(V, 0.0, width)
    K = step.stiffness_matrix
    for i in range(K.shape[0]):
        for j in range(K.shape[0]):
            add_product(V, row(s, i, 1, width), row(s, j, 1, width), 0.5 * K[i, j], width)


@inlined
def whole_energy(s: Array, H: Array, V: Array, step: StepArrays, width: int = W) -> None:
    """Write H = V + Σ p²/(2m) of the state."""
    copy(H, V, width)
    n = step.half_inverse_mass.size
    for i in range(n):
        p = row(s, n + i, 1, width)
        add_product(H, p, p, step.half_inverse_mass[i], width)


@inlined
def term_flow(
    s: Array, work: int, step: StepArrays, k: int, with_energy: bool, width: int = W
) -> None:
    """Advance the state by term k alone over half a step; with H^e, half-way from a predictor.

    ``with_energy``, a constant: whether any term has H^e. Scratch rows from ``work``: its rate, and
    then the potential energy (given), H, p a quarter of a step on, the rate with H.
    """
    rate, p, terms = row(s, work, 1, width), row(s, step.terms.target[k], 1, width), step.terms
    term_rate(rate, s, 0, terms, k, 0, width)
    if with_energy and terms.energy[k] > 0:
        V, H = row(s, work + 1, 1, width), row(s, work + 2, 1, width)
        middle, predicted = row(s, work + 3, 1, width), row(s, work + 4, 1, width)
        whole_energy(s, H, V, step, width)
        a = step.half_inverse_mass[terms.target[k] - step.half_inverse_mass.size]
        copy(predicted, rate, width)
        copy(middle, p, width)
        multiply(predicted, H, terms.energy[k], width)
        flow(middle, predicted, terms.power[k], 0.25 * step.dt, width)
        add_product(H, middle, middle, a, width)
        add_product(H, p, p, -a, width)
        multiply(rate, H, terms.energy[k], width)
    flow(p, rate, terms.power[k], 0.5 * step.dt, width)


@inlined
def damping_forces(
    s: Array, first: int, H: Array, to: int, work: int, step: StepArrays, width: int = W
) -> None:
    """Write Σ_j c̃_ij v_j of the terms at the state from row ``first``, whose energy is ``H``."""
    n, rate, terms = step.half_inverse_mass.size, row(s, work, 1, width), step.terms
    fill(row(s, to, n, width), 0.0, n * width)
    for k in range(terms.target.size):
        term_rate(rate, s, first, terms, k, terms.power[k], width)
        multiply(rate, H, terms.energy[k], width)
        add(row(s, to + terms.target[k] - n, 1, width), rate, 1.0, width)


@inlined
def processed_by_terms(
    s: Array, H: Array, at: Rows, shift: float, step: StepArrays, width: int = W
) -> None:
    """Change the observed (q*, p*) by the processor of the terms; ``H`` is that of the state.

    ``q_i* = q_i − (h²/12) D_i/m_i``, ``p_i* = p_i + (h²/12) dD_i/dt`` along the flow of the springs
    and of the contact with the other sign: docs/theory.md, "The step of the simulation".
    """
    terms = step.terms
    n, work = step.half_inverse_mass.size, at.work
    fill(row(s, at.change, 3 * n, width), 0.0, 3 * n * width)
    # (M⁻¹ p, −K q), the flow of the springs alone.
    for i in range(n):
        p = row(s, at.p + i, 1, width)
        add(row(s, at.change + i, 1, width), p, 2.0 * step.half_inverse_mass[i], width)
    add_matrix(s, at.change + n, at.q, step.stiffness_matrix, -1.0, width)
    for slot in range(step.slot_mass.size):
        force = row(s, at.change + n + step.slot_mass[slot], 1, width)
        add(force, row(s, at.contact + 2 * slot, 1, width), 1.0, width)
    damping_forces(s, at.q, H, at.damping, work, step, width)
    change, one = row(s, work, 1, width), row(s, work + 3, 1, width)
    for k in range(terms.target.size):
        # The rate of change of its force, without H, as each factor in turn changes.
        fill(change, 0.0, width)
        for moving in range(terms.first[k], terms.first[k + 1]):
            fill(one, terms.scale[k], width)
            for f in range(terms.first[k], terms.first[k + 1]):
                first = at.change if f == moving else at.q
                multiply(one, row(s, first + terms.factor[f], 1, width), 1, width)
            add(change, one, 1.0, width)
        multiply(change, H, terms.energy[k], width)
        add(row(s, at.change + n + terms.target[k], 1, width), change, 1.0, width)
    for i in range(n):
        a = 2.0 * shift * step.half_inverse_mass[i]
        add(row(s, at.q + i, 1, width), row(s, at.damping + i, 1, width), -a, width)
        add(row(s, at.p + i, 1, width), row(s, at.change + 2 * n + i, 1, width), shift, width)
