"""Damping terms: polynomials of the state in the equations of the levels, and in their means.

A term adds the force −κ Π q_a^m Π v_a^n H^l v_j to mass i; f_i is the sum of all such forces, with
the sign turned. Displacements are y and x + a y + x₀, and z = C ζ, ζ_j = a_j + a_j⁺, so that f_i is
a polynomial in y and U(y) whose coefficients are matrices that act on the degrees k. In the weak
form of ``chain`` it makes −Σ_j C⁻¹_ji a_j⁺ f_i u: of degree r in z beside its v_j, it connects a
level with those from r below to r + 2 above. Galerkin's method takes the product with exact
integrals, so what a term leaves of dissipation is not lost in the truncation.
"""

import numpy as np
from scipy import sparse

from averaging.phase_space.equation.basis import Basis
from averaging.phase_space.equation.degrees import Matrix, Space, combined, space_to
from averaging.phase_space.equation.frame import Frame
from fpk.numeric.arrays import Array

Polynomial = dict[tuple[int, int], Matrix]
"""Matrices on the degrees, by the powers of y and of U(y) that they stand before."""


def reach(frame: Frame) -> int:
    """Highest degree in z of what a damping term multiplies a velocity by, 0 without terms."""
    contact = frame.contact + 1
    return max(
        (t.degree - dict(t.q).get(contact, 0) for t in frame.system.damping_terms), default=0
    )


def levels_per_stage(frame: Frame) -> int:
    """Levels of a stage, s >= r and 2 s >= r + 2, r = ``reach``; level 0 is a stage of its own."""
    return max(reach(frame), (reach(frame) + 3) // 2)


def state(
    functions: Basis, C: Array, space: Space
) -> tuple[list[Polynomial], list[Polynomial], list[Polynomial]]:
    """Return displacements (y, r), velocities v and forces f, exact but at the end of ``space``."""
    frame, reference = functions.frame, functions.reference
    n, place = frame.n, frame.order.index
    one: Matrix = sparse.eye_array(len(space.level), format="csr")
    z = [combined([up + up.T for up in space.up], row) for row in C]
    v: list[Polynomial] = [{(0, 0): x} for x in z[:n]]
    linear = zip(z[n:], reference.slope, reference.offset, strict=True)
    r: list[Polynomial] = [{(1, 0): one}]
    r += [{(0, 0): x + x0 * one, (1, 0): a * one} for x, a, x0 in linear]
    energy: Polynomial = {(0, 1): one}
    for i in range(n):
        energy = added(energy, product(v[i], v[i]), 0.5)
        for j in range(n):
            energy = added(energy, product(r[i], r[j]), 0.5 * float(frame.stiffness[i, j]))
    forces: list[Polynomial] = [{} for _ in range(n)]
    root = np.sqrt(frame.system.mass)
    for term in frame.system.damping_terms:
        factors = [v[place(term.column)]]
        scale = term.coefficient / (root[term.row] * root[term.column])
        for of, powers in ((r, term.q), (v, term.v)):
            for mass, power in powers:
                factors += [of[place(mass - 1)]] * power
                scale /= root[mass - 1] ** power
        force: Polynomial = {(0, 0): scale * one}
        for factor in (*factors, *[energy] * term.energy):
            force = product(force, factor)
        forces[place(term.row)] = added(forces[place(term.row)], force)
    return r, v, forces


def product(a: Polynomial, b: Polynomial) -> Polynomial:
    """Return the product of two polynomials, whose matrices commute."""
    out: Polynomial = {}
    for (m, e), X in a.items():
        out = added(out, {(m + p, e + q): X @ Y for (p, q), Y in b.items()})
    return out


def added(a: Polynomial, b: Polynomial, factor: float = 1.0) -> Polynomial:
    """Return a + ``factor`` b."""
    out = dict(a)
    for powers, Y in b.items():
        out[powers] = out[powers] + factor * Y if powers in out else factor * Y
    return out


def damped(
    functions: Basis, C: Array
) -> tuple[Space, list[tuple[Matrix, list[list[Array | None]]]]]:
    """Return the degrees that A acts on, and the terms A ⊗ F of −Σ_ij C⁻¹_ji a_j⁺ f_i."""
    frame, degrees = functions.frame, functions.degrees
    beyond, d = reach(frame) + 1, 2 * frame.n - 1
    space = space_to(degrees.total + beyond, degrees.others + beyond, d)
    inverse: Array = np.asarray(np.linalg.inv(C), dtype=float)
    operator: Polynomial = {}
    for i, force in enumerate(state(functions, C, space)[2]):
        up = combined(space.up, inverse[:, i])
        operator = added(operator, {powers: up @ X for powers, X in force.items()}, -1.0)
    values, _ = functions.at_points
    sets, terms = [values @ functions.of_level(n) for n in range(2)], []
    for powers, A in operator.items():
        weights = by_y(functions, powers)[:, None]
        F: list[list[Array | None]] = [[to.T @ (weights * of) for of in sets] for to in sets]
        if powers == (0, 0):
            F[0][0] = F[1][1] = None
        terms.append((A, F))
    return space, terms


def by_y(functions: Basis, powers: tuple[int, int]) -> Array:
    """Weights of the points times the powers of y and of U(y)."""
    y = functions.points
    energy = functions.frame.contact_energy(y) ** powers[1]
    return np.asarray(functions.weights * y ** powers[0] * energy)
