"""Damping terms: polynomials of the state in the equations of the levels, and in their means.

A term adds the force −κ Π q_a^m Π v_a^n H^l v_j to mass i; f_i is the sum of all such forces, with
the sign turned. Displacements are y and x + a y + x₀, and z = C ζ, ζ_j = a_j + a_j⁺, so that f_i is
a polynomial in y and U(y) whose coefficients are matrices that act on the degrees k. In the weak
form of ``equations`` it makes −Σ_j C⁻¹_ji a_j⁺ f_i u: of degree r in z beside its v_j, it connects
a level with those from r below to r + 2 above. Galerkin's method takes the product with exact
integrals, so what a term leaves of dissipation is not lost in the truncation.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import sparse

from averaging.phase_space.equation.basis import Basis
from averaging.phase_space.equation.degrees import Degrees
from averaging.phase_space.equation.frame import Frame, Reference
from averaging.phase_space.equation.others import Matrix, Space, combined
from averaging.phase_space.equation.terms import Entries, Group, blocks_of
from fpk.arrays import Array

Polynomial = dict[tuple[int, int], Matrix]
"""Matrices on the degrees, by the powers of y and of U(y) that they stand before."""


def reach(frame: Frame) -> int:
    """Highest degree in z of what a damping term multiplies a velocity by, 0 without terms."""
    return max(
        (
            term.degree - dict(term.q).get(frame.contact + 1, 0)
            for term in frame.system.damping_terms
        ),
        default=0,
    )


def stages_to(frame: Frame, top: int) -> tuple[range, ...]:
    """Return the levels of each stage of the elimination, up to level ``top``.

    Level 0 is alone. A stage of s levels is to meet the two below it and the one above: s >= r and
    2 s >= r + 2, r = ``reach``. Without damping terms it is one.
    """
    r = reach(frame)
    size = max(r, (r + 3) // 2)
    starts = range(1, top + 1, size)
    return (range(1), *(range(n, min(n + size, top + 1)) for n in starts))


@dataclass(frozen=True, eq=False)
class State:
    """Displacements ``r`` (y the first of them) and velocities ``v`` times √m, and the forces f."""

    r: tuple[Polynomial, ...]
    v: tuple[Polynomial, ...]
    forces: tuple[Polynomial, ...]


def state(frame: Frame, reference: Reference, C: Array, space: Space) -> State:
    """Return the state as matrices on the degrees of ``space``, exact but at its end."""
    n, place = frame.n, frame.order.index
    one: Matrix = sparse.eye_array(len(space.level), format="csr")
    z = [combined([up + up.T for up in space.up], row) for row in C]
    v = tuple({(0, 0): x} for x in z[:n])
    r = (
        {(1, 0): one},
        *(
            {(0, 0): x + x0 * one, (1, 0): a * one}
            for x, a, x0 in zip(z[n:], reference.slope, reference.offset, strict=True)
        ),
    )
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
    return State(r, v, tuple(forces))


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
    frame: Frame,
    functions: Basis,
    degrees: Degrees,
    C: Array,
    groups: Sequence[Sequence[Group]],
) -> Iterator[Entries]:
    """Yield the entries of −Σ_ij C⁻¹_ji a_j⁺ f_i in the matrix of the equations."""
    beyond, d = reach(frame) + 1, 2 * frame.n - 1
    space = Space.to(degrees.total + beyond, degrees.others + beyond, d)
    inverse: Array = np.asarray(np.linalg.inv(C), dtype=float)
    operator: Polynomial = {}
    for i, force in enumerate(state(frame, functions.reference, C, space).forces):
        up = combined(space.up, inverse[:, i])
        operator = added(operator, {powers: up @ X for powers, X in force.items()}, -1.0)
    values, _ = functions.functions(functions.points)
    sets = [values @ functions.of_level(n) for n in range(2)]
    for powers, A in operator.items():
        weights = by_y(frame, functions, powers)[:, None]
        F: list[list[Array | None]] = [[to.T @ (weights * of) for of in sets] for to in sets]
        if powers == (0, 0):
            F[0][0] = F[1][1] = None
        yield from blocks_of(A, F, space, groups)


def by_y(frame: Frame, functions: Basis, powers: tuple[int, int]) -> Array:
    """Weights of the points times the powers of y and of U(y)."""
    y = functions.points
    return np.asarray(functions.weights * y ** powers[0] * frame.contact_energy(y) ** powers[1])
