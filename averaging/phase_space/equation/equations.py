"""The FPK equation in Hermite functions, level by level.

The density is p = w(y) N(z; 0, S) Σ_k u_k(y) He_k(C⁻¹ z)/√k!, S = C Cᵀ, z = (v, x) as in ``frame``.
With a_i He_k = √k_i He_(k−e_i) and a_i⁺ its adjoint, Galerkin's method in L²(w N) turns Eq. (6)
into

    Σ_ij F'_ij a_i⁺ a_j u + Σ_ij (½ (F' + F'ᵀ) + G')_ij a_i⁺ a_j⁺ u
        + Σ_i h'_i(y) a_i⁺ u + Σ_i l_i (a_i + a_i⁺) ∂* u = 0,

F' = C⁻¹ F C, G' = C⁻¹ G C⁻ᵀ, h' = C⁻¹ h, z₁ = l·C⁻¹ z, ∂* the adjoint of ∂/∂y in L²(w). The first
row of C has one entry, so that z₁ has one term. A level is all k of one sum: it meets itself, the
two below and the one above. Where S is not that of the linear part alone the second term is not
zero. The Hermite polynomials of the others come in other combinations (``others``).

Levels of even degree have continuous functions of y, those of odd degree broken ones (``Basis``).
∂* connects the two only; for a broken f and a continuous u, (f, ∂* u) is −(f, u' + (ln w)' u).

Damping terms (``damping``) may connect a level with others beyond its neighbours, too. Levels are
then eliminated in stages of several: so many that each stage meets the two below and the one above.
"""

from itertools import chain

import numpy as np

from averaging.phase_space.equation.basis import Basis
from averaging.phase_space.equation.chain import Chain, ends_of
from averaging.phase_space.equation.damping import damped, stages_to
from averaging.phase_space.equation.degrees import Degrees
from averaging.phase_space.equation.frame import Frame, Reference, linear_part
from averaging.phase_space.equation.others import Matrix, Others, Space, combined, others_to
from averaging.phase_space.equation.terms import SAME, Between, Group, block, blocks_of
from fpk.arrays import Array


def chain_of(
    frame: Frame, reference: Reference, functions: Basis, degrees: Degrees, *, closed: bool = False
) -> Chain:
    """Return the equations about a reference in the functions of a basis.

    ``closed``: levels meet themselves by l₁ (∂* ∂)^½ (``Chain``) of all functions that the level
    above lacks, not only where there is none above. Else functions of the highest degrees in y are
    hardly damped, and A has slow eigenvalues that are none of L; stationary densities hardly do.
    """
    F, G, h = linear_part(frame, reference)
    C = _factor(F, reference)
    inverse = np.linalg.inv(C)
    drift, noise = inverse @ F @ C, inverse @ G @ inverse.T
    pair = 0.5 * (drift + drift.T) + noise
    y = functions.points
    force = h[0][:, None] + h[1][:, None] * y
    force[0] -= frame.contact_force(y)
    adjoint, *forces = _between_sets(functions, C, inverse @ force)
    top, others = degrees.total, others_to(degrees.others, frame.n * 2 - 1)
    stages = stages_to(frame, top)
    groups = _placed(functions, degrees, others, stages)
    space = Space.to(top, degrees.others, len(drift))
    up, down = space.up, [A.T.tocsr() for A in space.up]
    constant = [
        A @ (combined(down, f) + combined(up, g)) for A, f, g in zip(up, drift, pair, strict=True)
    ]
    blocks = [
        blocks_of(combined(constant, np.ones(len(up))), SAME, space, groups),
        blocks_of(down[0], adjoint, space, groups),
        *(
            blocks_of(A, F, space, groups)
            for A, F in zip(up, forces, strict=True)
            if np.any(F[0][1])
        ),
    ]
    if frame.system.damping_terms:
        blocks.append(damped(frame, functions, degrees, C, groups))
    closing = []
    for n in range(1, top + 1):
        for m, group in enumerate(groups[n]):
            # What the level above n lacks of the functions that the one below n has.
            present = groups[n + 1][m].functions if n < top and m < len(groups[n + 1]) else 0
            wanted = _functions(functions, degrees, n - 1, m)
            E = np.asarray(adjoint[n % 2][1 - n % 2])[: group.functions, present:wanted]
            if E.size and (closed or not present):
                U, s, _ = np.linalg.svd(E, full_matrices=False)
                k = np.arange(group.count)
                root = k, k, np.full(k.size, -np.sqrt(n - m + 1.0))
                closing.append(block(group, group, root, (U * s) @ U.T))
    parts = zip(*chain(*blocks, closing), strict=True)
    row, column, values = (np.concatenate(part) for part in parts)
    size = int(ends_of(stages, groups)[-1])
    matrix = Matrix((values, (row, column)), shape=(size, size))
    return Chain(C, others, stages, groups, matrix)


def sizes(functions: Basis, degrees: Degrees) -> Array:
    """Return how many unknowns each stage of the equations in a basis has."""
    stages = stages_to(functions.frame, degrees.total)
    others = others_to(degrees.others, 2 * functions.frame.n - 1)
    groups = _placed(functions, degrees, others, stages)
    return np.diff(ends_of(stages, groups), prepend=0).astype(float)


def _factor(F: Array, reference: Reference) -> Array:
    """Return C of S = C Cᵀ, the other variables of ζ in pairs of one oscillator each.

    These are the planes that the antisymmetric part of F', which turns ζ, has for the others.
    """
    C = np.asarray(np.linalg.cholesky(reference.covariance), dtype=float)
    drift = np.linalg.solve(C, F @ C)[1:, 1:]
    _, vectors = np.linalg.eigh(0.5j * (drift - drift.T))
    turning = vectors[:, len(drift) // 2 :].T
    planes = np.stack([turning.real, turning.imag], axis=1).reshape(drift.shape)
    # Orthogonal but for frequencies of 0, whose planes are any.
    C[:, 1:] = C[:, 1:] @ np.linalg.qr(planes.T)[0]
    return C


def _functions(functions: Basis, degrees: Degrees, n: int, m: int) -> int:
    """Number of functions of y of level n and degree m in the others."""
    return functions.counts[n % 2][degrees.beyond(n, m)]


def _placed(
    functions: Basis, degrees: Degrees, others: tuple[Others, ...], stages: tuple[range, ...]
) -> tuple[tuple[Group, ...], ...]:
    """Return the groups of all levels, each placed in its stage behind those of higher levels."""
    levels: list[tuple[Group, ...]] = []
    start = 0
    for stage in stages:
        placed = []
        for n in stage[::-1]:
            groups = []
            for m, o in enumerate(others[: degrees.others_at(n) + 1]):
                count = _functions(functions, degrees, n, m)
                groups.append(Group(start, o.count, count))
                start = groups[-1].span.stop
            placed.append(tuple(groups))
        levels += placed[::-1]
    return tuple(levels)


def _between_sets(functions: Basis, C: Array, force: Array) -> list[Between]:
    """Return l₁ ∂* and what stands with a_i⁺, between continuous functions and broken ones.

    ``force`` h' (d, points).
    """
    w = functions.weights
    value, slope = functions.at_points
    continuous, broken = value @ functions.continuous, value @ functions.broken
    to_continuous = (slope @ functions.continuous).T @ (w[:, None] * broken)
    # The derivative of 1 is 0: with round-off in its place mass would not be conserved.
    one = functions.of_one()
    to_continuous -= np.outer(one, one @ to_continuous)
    descent = slope @ functions.continuous + functions.log_slope()[:, None] * continuous
    to_broken = -broken.T @ (w[:, None] * descent)
    adjoint = C[0, 0] * to_continuous, C[0, 0] * to_broken
    weighted = [continuous.T @ (f[:, None] * broken) for f in w * force]
    both = [(F, F.T) for F in weighted]
    both[0] = weighted[0] + adjoint[0], weighted[0].T + adjoint[1]
    return [((None, to), (back, None)) for to, back in (adjoint, *both)]
