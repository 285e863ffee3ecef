"""The FPK equation in Hermite functions: the matrix of its equations between levels.

The equations, F', G', h' and C are as in docs/theory.md ("The full equation"): the density is
p = (w(y) N(z; 0, S))^σ Σ_k u_k(y) He_k(C⁻¹ z)/√k!, S = C Cᵀ, a_i He_k = √k_i He_(k−e_i), a_i⁺ the
adjoint of a_i, and l₁ = C₁₁: the first row of C has one entry. With z = C ζ, multiplication by ζ_i
is a_i + a_i⁺, and −∂/∂ζ_i is σ a_i⁺ − (1 − σ) a_i. Equations are multiplied by (w N)^(1−σ) times
the same polynomials and integrated. Levels of even degree have continuous functions of y, those of
odd degree broken ones (``Basis``); for a broken f and a continuous u, (f, ∂* u) is
−(f, u' + (ln w)' u).

A damping term adds the force −κ Π q_a^m Π v_a^n H^l v_j to mass i; −f_i is the sum of all such
forces, a polynomial in y and U(y) whose coefficients are matrices that act on the degrees k. If r
is its degree in z without the factor v_j, it couples a level to the levels from r + 2 below to
r + 2 above; r is 0 without damping terms. Levels are grouped in stages. Integrals are exact.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse

from averaging.phase_space.equation.basis import Basis
from averaging.phase_space.equation.degrees import Matrix, Space, combination, space_to
from averaging.phase_space.equation.frame import POWER, Frame, linear_part
from fpk.numeric.arrays import Array, Integers

ABSORPTION = 10.0
"""Damping of the highest level N, over the largest natural frequency; level n > N/2 has (2n/N − 1)⁶
of it. What the highest levels would reflect is absorbed: with noise on one mass only true errors
fall to 0.4, and of a system on which solutions diverged, distances to a quarter. From 6 to 20 the
errors change little."""

Polynomial = dict[tuple[int, int], Matrix]
"""Maps powers of y and of U(y) to their coefficients, matrices that act on the degrees k."""


@dataclass(frozen=True, eq=False)
class Chain:
    """The equations: a sparse ``matrix`` of the unknowns.

    ``factor`` is C, ``mass`` (unknowns,) has the integrals of the functions, 0 for densities that
    change sign under reflection. ``places`` (degrees, most functions) are the indices of the
    unknowns of each degree of ``space`` in the vector of all unknowns, −1 beyond the functions of a
    degree. Stage n ends at index ``ends[n]``, its highest level first. For the highest level of
    each degree in the other masses the matrix contains −l₁ (∂* ∂)^½, which models the omitted
    levels above.
    """

    basis: Basis
    factor: Array
    space: Space
    places: Integers
    ends: Integers
    matrix: Matrix
    mass: Array

    @property
    def top(self) -> int:
        """The highest stage."""
        return len(self.ends) - 1

    def span(self, n: int) -> slice:
        """Return the slice of stage ``n`` in the vector of all unknowns."""
        return slice(int(self.ends[n - 1]) if n else 0, int(self.ends[n]))

    def cuts(self, n: int) -> Integers:
        """Return the ascending indices in stage ``n`` at which level or ``Space.others`` change."""
        group = self.space.level * (self.space.others.max() + 1) + self.space.others
        starts, span = np.sort(self.places[np.diff(group, prepend=-1) > 0, 0]), self.span(n)
        return np.asarray(starts[(starts > span.start) & (starts < span.stop)] - span.start)

    def within(self, n: int, *, shift: complex = 0.0, kind: type = np.float64) -> Array:
        """Return the dense diagonal block of stage ``n`` minus ``shift``, of type ``kind``."""
        A = self.matrix[self.span(n), self.span(n)].toarray()
        A = A.astype(np.result_type(kind, shift), copy=False)
        if shift:
            A[np.diag_indices_from(A)] -= shift
        return np.asarray(A)

    def blocks(self, matrix: sparse.csr_array, away: int) -> list[sparse.csr_array]:
        """Return the blocks (n, n + ``away``) of ``matrix`` in ascending order of the stages n."""
        stages = range(max(-away, 0), self.top + 1 - max(away, 0))
        return [matrix[self.span(n), self.span(n + away)] for n in stages]

    def pack(self, levels: Sequence[Array]) -> Array:
        """Return the vector of all unknowns from ``levels``, each (degrees, functions)."""
        out = np.zeros(self.ends[-1] + 1, levels[0].dtype)
        for n, u in enumerate(levels):
            out[self.places[self.space.span(n), : u.shape[1]]] = u
        return out[:-1]

    def unpack(self, u: Array) -> list[Array]:
        """Return the levels of the vector ``u``, each (degrees, functions).

        The degree with most functions sets their number; 0 where a degree has fewer.
        """
        every, used = np.append(u, np.zeros(1, u.dtype))[self.places], self.places >= 0
        spans = map(self.space.span, range(self.space.level[-1] + 1))
        return [every[at, : np.sum(used[at].any(axis=0))] for at in spans]


def places(functions: Basis, space: Space, *, joined: bool) -> tuple[Integers, Integers, Integers]:
    """Return the number of functions of each degree of ``space``, its first unknown, and the ends.

    ``Chain`` defines the ends. Stages have r + 2 levels if ``joined``, so that a stage is coupled
    to its two neighbours only, else half of that. Degrees of ``space`` beyond the degrees of the
    basis have no functions. At the highest levels the largest degree in the other masses falls by
    two for each level, which saves a fifth of the work.
    """
    degrees = functions.degrees
    table = np.zeros((space.level[-1] + 1, space.others.max() + 1), dtype=np.int64)
    for n in range(degrees.total + 1):
        for m in range(min(n, 2 * degrees.others, 2 * (degrees.total - n)) + 1):
            table[n, m] = functions.counts[n % 2][degrees.beyond(n, m)]
    count = np.where(space.counted <= degrees.others, table[space.level, space.others], 0)
    # Level 0 is a stage of its own.
    coupled = damping_degree(functions.frame) + 2
    stage = -(-space.level // (coupled if joined else (coupled + 1) // 2))
    order = np.lexsort((-space.level, stage))
    start = np.empty_like(count)
    start[order] = np.cumsum(count[order]) - count[order]
    sizes = np.bincount(stage[space.level <= degrees.total], count[space.level <= degrees.total])
    return count, start, np.cumsum(sizes).astype(np.int64)


Entries = tuple[Integers, Integers, Array]
"""Rows, columns and values of entries of a matrix."""
Between = Sequence[Sequence[Array | None]]
"""Matrices on functions of y, by the parity of the level they lead to and of the level they act on.
None is the identity on the functions that both levels have."""


def chain_of(functions: Basis, *, joined: bool = False, closed: bool = False) -> Chain:
    """Return the equations in the functions of a basis, about its reference.

    For ``joined`` see ``places``. If ``closed``, −l₁ (∂* ∂)^½ is added for all functions that the
    level above lacks, not only for levels with none above. Without it A has slow eigenvalues that
    are no eigenvalues of L.
    """
    frame, reference, degrees = functions.frame, functions.reference, functions.degrees
    F, G, h = linear_part(frame, reference)
    C = np.asarray(np.linalg.cholesky(reference.covariance), dtype=float)
    # Pair the other variables as the planes in which the antisymmetric part of F' rotates; for
    # equal frequencies 0 the planes are arbitrary, hence the orthogonalisation.
    turned = np.linalg.solve(C, F @ C)[1:, 1:]
    turning = np.linalg.eigh(0.5j * (turned - turned.T))[1][:, len(turned) // 2 :].T
    planes = np.stack([turning.real, turning.imag], axis=1).reshape(turned.shape)
    C[:, 1:] = C[:, 1:] @ np.linalg.qr(planes.T)[0]
    inverse = np.linalg.inv(C)
    drift, noise = inverse @ F @ C, inverse @ G @ inverse.T
    y, w = functions.points, functions.weights
    force = frame.contact_force(y)
    # l₁ ∂*, between continuous functions and broken ones.
    value, slope = functions.at_points
    continuous, broken = value @ functions.continuous, value @ functions.broken
    to_continuous = (slope @ functions.continuous).T @ (w[:, None] * broken)
    linear, square, contact = reference.weight
    log_slope = -(linear + square * y + contact * force)
    descent = slope @ functions.continuous + log_slope[:, None] * continuous
    adjoint = C[0, 0] * to_continuous, -C[0, 0] * broken.T @ (w[:, None] * descent)
    # h', the factor of −∂/∂ζ_i.
    given = h[0][:, None] + h[1][:, None] * y
    given[0] -= force
    weighted = [continuous.T @ (f[:, None] * broken) for f in w * (inverse @ given)]
    # The first component of h' and the slope of w cancel.
    forces = [(H, H.T) for H in weighted[1:]]
    transport = weighted[0] + adjoint[0], weighted[0].T + adjoint[1]
    space = space_to(degrees.total, degrees.others, len(drift))
    up, down = space.up, [A.T.tocsr() for A in space.up]
    # Lower levels keep their exact equations, and so moments their identities.
    absorbed = np.maximum(2.0 * space.level / degrees.total - 1.0, 0.0) ** 6
    fastest, even = float(np.sqrt(np.linalg.eigvalsh(frame.stiffness)[-1])), 1.0 - POWER
    # −∂ F' ζ and ∂ G' ∂, with all a to the right of all a⁺, and the absorption.
    lost = even * (np.trace(drift) + POWER * np.trace(noise)) + ABSORPTION * fastest * absorbed
    constant = sparse.diags_array(-lost, format="csr")
    for i, (f, g) in enumerate(zip(drift, noise, strict=True)):
        mixed = POWER * f - even * drift[:, i] - 2.0 * even * POWER * g
        constant += up[i] @ (combination(up, POWER * f + POWER**2 * g) + combination(down, mixed))
        constant += down[i] @ combination(down, even**2 * g - even * f)
    slopes = (POWER * A - even * B for A, B in zip(up[1:], down[1:], strict=True))
    couplings = [(down[0], adjoint), (up[0], transport), *zip(slopes, forces, strict=True)]
    parts: list[tuple[Matrix, Between]] = [
        (constant, ((None, None), (None, None))),
        *((A, ((None, H[0]), (H[1], None))) for A, H in couplings if np.any(H[0])),
    ]
    count, start, ends = places(functions, space, joined=joined)
    size = int(ends[-1])
    terms = [_product_entries(*part, space, count, start) for part in parts]
    if frame.system.damping_terms:
        wider, more = damping_terms(functions, C)
        at = places(functions, wider, joined=joined)[:2]
        terms += [_product_entries(*term, wider, *at) for term in more]
    matrix = Matrix((size, size))
    for term in terms:  # one by one, which takes least memory
        matrix = matrix + _matrix(term, size)
    closing = []
    table = np.zeros((degrees.total + 2, space.others.max() + 1), dtype=np.int64)
    table[space.level[count > 0], space.others[count > 0]] = count[count > 0]
    for n, m in np.argwhere(table[1:]) + np.array([1, 0]):
        # Functions that level n − 1 has and level n + 1 lacks.
        below = functions.counts[(n - 1) % 2][degrees.beyond(n - 1, m)]
        E = adjoint[n % 2][: table[n, m], table[n + 1, m] : below]
        if E.size and (closed or not table[n + 1, m]):
            U, s, _ = np.linalg.svd(E, full_matrices=False)
            at = start[(space.level == n) & (space.others == m) & (count > 0)]
            root = np.full(at.size, -np.sqrt(n - m + 1.0))
            closing.append(_entries(at, at, root, (U * s) @ U.T))
    matrix, j = matrix + _matrix(closing, size), np.arange(count.max())
    unknowns = np.where(j < count[:, None], start[:, None] + j, -1)
    integrals = [functions.measure @ (value @ functions.of_level(n)) for n in range(2)]
    chain = Chain(functions, C, space, unknowns, ends, matrix, np.zeros(0))
    s = space.integral()
    levels = [np.outer(s[space.span(n)], integrals[n % 2]) for n in range(space.level[-1] + 1)]
    return replace(chain, mass=chain.pack(levels))


def _product_entries(
    A: Matrix, functions: Between, space: Space, count: Integers, start: Integers
) -> Iterator[Entries]:
    """Yield the entries of A ⊗ ``functions``, in groups of degrees with equal numbers of functions.

    ``count`` and ``start`` (degrees,) are the number of functions and the first unknown of each
    degree of ``space``.
    """
    X, parity = A.tocoo(), space.level % 2
    inside = (count[X.row] > 0) & (count[X.col] > 0) & (X.data != 0.0)
    to, of, factor = X.row[inside], X.col[inside], X.data[inside]
    kind = ((count[to] * (count.max() + 1) + count[of]) * 2 + parity[to]) * 2 + parity[of]
    order = np.argsort(kind, kind="stable")
    for at in np.split(order, np.flatnonzero(np.diff(kind[order])) + 1) if order.size else ():
        first, second = to[at[0]], of[at[0]]
        F = functions[parity[first]][parity[second]]
        rows, columns = count[first], count[second]
        F = np.ones(min(rows, columns)) if F is None else F[:rows, :columns]
        yield _entries(start[to[at]], start[of[at]], factor[at], F)


def _matrix(entries: Iterable[Entries], size: int) -> Matrix:
    """Return the matrix (size, size) of all ``entries``; entries of one place are added."""
    nothing = (*np.zeros((2, 0), dtype=np.int32), np.zeros(0))
    row, column, values = map(np.concatenate, zip(nothing, *entries, strict=True))
    return Matrix((values, (row, column)), shape=(size, size))


def _entries(to: Integers, of: Integers, factor: Array, F: Array) -> Entries:
    """Return the entries of one block for each pair, its ``factor`` times F (diagonal if 1-D).

    The block of a pair begins at row ``to`` and column ``of``, (pairs,) each.
    """
    index = np.indices(F.shape, dtype=np.int32)
    row, column = (
        np.add.outer(x.astype(np.int32), i).ravel() for x, i in ((to, index[0]), (of, index[-1]))
    )
    return row, column, np.multiply.outer(factor, F).ravel()


def damping_degree(frame: Frame) -> int:
    """Return r, the highest degree of a damping term without its factor v_j; 0 without terms.

    Powers of the contact displacement do not count, H counts 2.
    """
    terms, contact = frame.system.damping_terms, frame.contact + 1
    return max((t.degree - dict(t.q).get(contact, 0) for t in terms), default=0)


def state_polynomials(
    functions: Basis, C: Array, space: Space
) -> tuple[list[Polynomial], list[Polynomial], list[Polynomial]]:
    """Return displacements (y, r), velocities v and forces f as polynomials in ζ, z = ``C`` ζ.

    dv contains −f dt, f the force of the damping terms over √m. The matrices are exact on degrees
    of ``space`` that multiplication does not lead out of it.
    """
    frame, reference = functions.frame, functions.reference
    n, place = frame.n, frame.order.index
    one: Matrix = sparse.eye_array(len(space.level), format="csr")
    z = [combination([up + up.T for up in space.up], row) for row in C]
    v: list[Polynomial] = [{(0, 0): x} for x in z[:n]]
    linear = zip(z[n:], reference.slope, reference.offset, strict=True)
    r: list[Polynomial] = [{(1, 0): one}]
    r += [{(0, 0): x + x0 * one, (1, 0): a * one} for x, a, x0 in linear]
    energy: Polynomial = {(0, 1): one}
    for i in range(n):
        energy = polynomial_sum(energy, polynomial_product(v[i], v[i]), 0.5)
        for j in range(n):
            square = polynomial_product(r[i], r[j])
            energy = polynomial_sum(energy, square, 0.5 * float(frame.stiffness[i, j]))
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
            force = polynomial_product(force, factor)
        forces[place(term.row)] = polynomial_sum(forces[place(term.row)], force)
    return r, v, forces


def polynomial_product(a: Polynomial, b: Polynomial) -> Polynomial:
    """Return the product of two polynomials, whose matrices commute."""
    out: Polynomial = {}
    for (m, e), X in a.items():
        out = polynomial_sum(out, {(m + p, e + q): X @ Y for (p, q), Y in b.items()})
    return out


def polynomial_sum(a: Polynomial, b: Polynomial, factor: float = 1.0) -> Polynomial:
    """Return a + ``factor`` b."""
    out = dict(a)
    for powers, Y in b.items():
        out[powers] = out[powers] + factor * Y if powers in out else factor * Y
    return out


def damping_terms(
    functions: Basis, C: Array
) -> tuple[Space, list[tuple[Matrix, list[list[Array | None]]]]]:
    """Return a space, and (A, F) of the terms A ⊗ F of Σ_ij ``C``⁻¹_ji ∂/∂ζ_j f_i.

    f are the forces of ``state_polynomials``. A acts on the degrees of the space, F (``Between``)
    on the functions of y.
    """
    degrees, beyond = functions.degrees, damping_degree(functions.frame) + 1
    space = space_to(degrees.total + beyond, degrees.others + beyond, len(C))
    inverse: Array = np.asarray(np.linalg.inv(C), dtype=float)
    operator: Polynomial = {}
    for i, force in enumerate(state_polynomials(functions, C, space)[2]):
        up = combination(space.up, inverse[:, i])
        slope = POWER * up - (1.0 - POWER) * up.T
        operator = polynomial_sum(operator, {p: slope @ X for p, X in force.items()}, -1.0)
    values, _ = functions.at_points
    sets, terms = [values @ functions.of_level(n) for n in range(2)], []
    for powers, A in operator.items():
        weights = (functions.weights * by_y(functions, powers))[:, None]
        F: list[list[Array | None]] = [[to.T @ (weights * of) for of in sets] for to in sets]
        if powers == (0, 0):
            F[0][0] = F[1][1] = None
        terms.append((A, F))
    return space, terms


def by_y(functions: Basis, powers: tuple[int, int]) -> Array:
    """Return y^m U(y)^l at the points of the basis, (points,), ``powers`` (m, l)."""
    y = functions.points
    return np.asarray(y ** powers[0] * functions.frame.contact_energy(y) ** powers[1])
