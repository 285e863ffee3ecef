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

from collections.abc import Iterable, Sequence
from itertools import chain

import numpy as np

from averaging.phase_space.equation.basis import Basis
from averaging.phase_space.equation.chain import Chain, size_of
from averaging.phase_space.equation.damping import damped, stages_to
from averaging.phase_space.equation.degrees import Degrees
from averaging.phase_space.equation.frame import Frame, Reference, linear_part
from averaging.phase_space.equation.others import Others, others_to
from averaging.phase_space.equation.terms import Group, Sum, Term, Terms
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
    adjoint, force_by_y = _between_sets(functions, C, inverse @ force)
    top, others = degrees.total, others_to(degrees.others, frame.n * 2 - 1)
    stages = stages_to(frame, top)
    groups = _placed(functions, degrees, others, stages)
    own, above, forced, paired = [], [], [], []
    for n in range(top + 1):
        own.append(_own(others, drift, groups[n], n))
        up = adjoint[n % 2]
        above.append(
            [
                Term(to, of, float(np.sqrt(n - m + 1.0)), up[: to.functions, : of.functions])
                for m, (to, of) in enumerate(zip(groups[n], groups[n + 1], strict=False))
            ]
            if n < top
            else []
        )
        forced.append(_forced(others, force_by_y[n % 2], groups, n) if n else [])
        paired.append(_paired(others, pair, groups, n) if n > 1 else [])
    for n in range(1, top + 1):
        for m, group in enumerate(groups[n]):
            # What the level above n lacks of the functions that the one below n has.
            present = groups[n + 1][m].functions if n < top and m < len(groups[n + 1]) else 0
            wanted = _functions(functions, degrees, n - 1, m)
            E = adjoint[n % 2][: group.functions, present:wanted]
            if E.size and (closed or not present):
                U, s, _ = np.linalg.svd(E, full_matrices=False)
                own[n].append(Term(group, group, -float(np.sqrt(n - m + 1.0)), (U * s) @ U.T))
    blocks: Sequence[Sequence[Terms]] = (own, above, forced, paired)
    if frame.system.damping_terms:
        terms = damped(frame, functions, degrees, C, groups)
        blocks = _by_stages(stages, groups, (own, above, forced, paired), terms)
    return Chain(
        C,
        others,
        stages,
        groups,
        tuple(blocks[0]),
        tuple(blocks[1]),
        tuple(blocks[2]),
        tuple(blocks[3]),
    )


def sizes(functions: Basis, degrees: Degrees) -> Array:
    """Return how many unknowns each stage of the equations in a basis has."""
    stages = stages_to(functions.frame, degrees.total)
    others = others_to(degrees.others, 2 * functions.frame.n - 1)
    groups = _placed(functions, degrees, others, stages)
    return np.array([float(size_of(stage, groups)) for stage in stages])


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


def _by_stages(
    stages: tuple[range, ...],
    groups: tuple[tuple[Group, ...], ...],
    constant: Sequence[Sequence[Sequence[Term]]],
    damping: Iterable[tuple[int, int, Term]],
) -> Sequence[list[Terms]]:
    """Return ``own``, ``above``, ``forced`` and ``paired`` of stages.

    ``constant`` has them of levels, and ``damping`` the terms to a level of a level.
    """
    stage_of = {level: n for n, levels in enumerate(stages) for level in levels}
    blocks: dict[tuple[int, int], list[Term]] = {}
    between = (
        (level, level + away, term)
        for away, of_levels in zip((0, 1, -1, -2), constant, strict=True)
        for level, terms in enumerate(of_levels)
        for term in terms
    )
    for to, of, term in chain(between, damping):
        blocks.setdefault((stage_of[to], stage_of[of]), []).append(term)
    whole = [Group(0, 1, size_of(stage, groups)) for stage in stages]
    return [
        [
            [Sum(whole[n], whole[n + away], blocks[n, n + away])] if (n, n + away) in blocks else []
            for n in range(len(stages))
        ]
        for away in (0, 1, -1, -2)
    ]


def _functions(functions: Basis, degrees: Degrees, n: int, m: int) -> int:
    """Number of functions of y of level n and degree m in the others."""
    return functions.counts[n % 2][degrees.beyond(n, m)]


def _placed(
    functions: Basis, degrees: Degrees, others: tuple[Others, ...], stages: tuple[range, ...]
) -> tuple[tuple[Group, ...], ...]:
    """Return the groups of all levels, each placed in its stage behind those of higher levels."""
    levels: list[tuple[Group, ...]] = []
    for stage in stages:
        start, placed = 0, []
        for n in stage[::-1]:
            groups = []
            for m, o in enumerate(others[: degrees.others_at(n) + 1]):
                count = _functions(functions, degrees, n, m)
                groups.append(Group(start, o.count, count))
                start = groups[-1].span.stop
            placed.append(tuple(groups))
        levels += placed[::-1]
    return tuple(levels)


def _between_sets(
    functions: Basis, C: Array, force: Array
) -> tuple[tuple[Array, Array], tuple[list[Array], list[Array]]]:
    """Return l₁ ∂* and the matrices of a_i⁺, to continuous functions and to broken ones.

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
    adjoint = (C[0, 0] * to_continuous, C[0, 0] * to_broken)
    forces = (
        [continuous.T @ ((w * f)[:, None] * broken) for f in force],
        [broken.T @ ((w * f)[:, None] * continuous) for f in force],
    )
    for parts, through in zip(forces, adjoint, strict=True):
        parts[0] += through
    return adjoint, forces


def _own(others: tuple[Others, ...], drift: Array, groups: tuple[Group, ...], n: int) -> list[Term]:
    """Return the blocks within level n: F'_ij a_i⁺ a_j."""
    terms = []
    for m, (group, o) in enumerate(zip(groups, others, strict=False)):
        same = drift[0, 0] * (n - m) * np.eye(group.count)
        if m:
            lower = others[m - 1].raising
            for i, up in enumerate(lower):
                for j, down in enumerate(lower):
                    same += drift[i + 1, j + 1] * up @ down.T
        terms.append(Term(group, group, same))
        if m + 1 < len(groups):
            root = np.sqrt(float(n - m))
            up = sum(c * A for c, A in zip(drift[1:, 0], o.raising, strict=True))
            down = sum(c * A.T for c, A in zip(drift[0, 1:], o.raising, strict=True))
            terms.append(Term(groups[m + 1], group, np.asarray(root * up)))
            terms.append(Term(group, groups[m + 1], np.asarray(root * down)))
    return terms


def _forced(
    others: tuple[Others, ...],
    force: list[Array],
    groups: tuple[tuple[Group, ...], ...],
    n: int,
) -> list[Term]:
    """Return the blocks from unknowns of level n − 1 to equations of level n: h'_i a_i⁺ and ∂*."""
    terms = []
    for m, of in enumerate(groups[n - 1]):
        if m >= len(groups[n]):
            continue
        to = groups[n][m]
        first = force[0][: to.functions, : of.functions]
        terms.append(Term(to, of, float(np.sqrt(n - m)), first))
        if m + 1 < len(groups[n]):
            to = groups[n][m + 1]
            for A, H in zip(others[m].raising, force[1:], strict=True):
                if np.any(H):
                    terms.append(Term(to, of, A, H[: to.functions, : of.functions]))
    return terms


def _paired(
    others: tuple[Others, ...], pair: Array, groups: tuple[tuple[Group, ...], ...], n: int
) -> list[Term]:
    """Return the blocks from unknowns of level n − 2 to equations of level n: a_i⁺ a_j⁺."""
    terms = []
    for m, of in enumerate(groups[n - 2]):
        alone = n - 1.0 - m
        if m >= len(groups[n]):
            continue
        terms.append(Term(groups[n][m], of, float(pair[0, 0] * np.sqrt(alone * (alone + 1.0)))))
        if m + 1 < len(groups[n]):
            up = sum(c * A for c, A in zip(pair[0, 1:], others[m].raising, strict=True))
            terms.append(Term(groups[n][m + 1], of, np.asarray(2.0 * np.sqrt(alone) * up)))
        if m + 2 < len(groups[n]):
            twice = np.zeros((others[m + 2].count, others[m].count))
            for i, first in enumerate(others[m].raising):
                for j, second in enumerate(others[m + 1].raising):
                    twice += pair[i + 1, j + 1] * second @ first
            terms.append(Term(groups[n][m + 2], of, twice))
    return terms
