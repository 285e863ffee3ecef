"""The FPK operator of an expansion off its stationary state: its resolvent and its eigenvalues.

A vector of the expansion changes as du/dt = A u, A the matrix of the chain of levels: the functions
are orthonormal in L²(w N), so that the unit matrix stands before du/dt. (A − s)⁻¹ is the same
elimination as that of the stationary state with s off the diagonal of every level. Where mirror
images are equally likely A does not mix what keeps its sign under them with what changes it, as
displacements do: each has a chain of its own, of half the size.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from averaging.phase_space.equation.basis import Basis, basis
from averaging.phase_space.equation.chain import Chain
from averaging.phase_space.equation.elimination import Expansion, factored
from averaging.phase_space.equation.equations import chain_of
from averaging.phase_space.equation.frame import Frame
from averaging.phase_space.equation.others import lowered, raised
from averaging.phase_space.marginals import Form
from fpk.arrays import Array, Complexes

VECTORS = 120
"""Most vectors of a Krylov space: with more, making them orthogonal takes as long as an elimination
at another shift."""
CHECKED = 10
"""Vectors after which the residuals of all frequencies are looked at."""
RESIDUAL = 1e-13
"""Residual, relative to the solution, at which a frequency is solved."""

RITZ_VECTORS = 160
"""Vectors of the Krylov space in which eigenvalues are sought."""
CONVERGED = 1e-8
"""Relative residual of an eigenvalue that counts as one of A."""
SEEN = 1e-3
"""Least share of a rate in a correlation. Of the eigenvalues of A, some belong to the truncation:
functions of y that the slopes of those a level below do not span. On fig6a, with B = 10, their
shares are 1e-4 at degree 10 and 1e-5 at degree 18, those of all others 1e-3 and more."""

Step = Callable[[float], None]
"""Called with the share of an elimination that is done."""


@dataclass(frozen=True, eq=False)
class Generator:
    """A on the functions of one parity (``odd`` or not; all of them where there is no mirror).

    ``one`` are the coefficients of the function 1 in level 0: its product with A vanishes, as mass
    is conserved, and it is 0 itself where all functions of level 0 are odd.
    """

    functions: Basis
    chain: Chain
    one: Array

    @classmethod
    def of(cls, frame: Frame, e: Expansion, *, odd: bool) -> "Generator":
        """Return A of the degrees and the reference of an expansion with all levels."""
        functions = basis(frame, e.basis.reference, e.degrees, odd=odd)
        chain = chain_of(frame, e.basis.reference, functions, e.degrees)
        return cls(functions, chain, functions.of_one())

    def shaped(self, u: Array) -> list[Array]:
        """Return the parts of a vector as ``levels`` of an ``Expansion``."""
        return [x for n, part in enumerate(self.chain.split(u)) for x in self.chain.shaped(n, part)]

    def packed(self, levels: Sequence[Array]) -> Array:
        """Return ``levels`` of an ``Expansion`` as a vector."""
        return np.concatenate([self.chain.packed(n, levels) for n in range(self.chain.top + 1)])

    def resolvent(self, shift: complex, step: Step) -> Callable[[Array], Array]:
        """Return the function b → (s − A)⁻¹ b for s = ``shift``.

        Of b, which has no mass, what round-off left of it is removed: A is singular at s = 0.
        """
        factors, _ = factored(self.chain, one=self.one, shift=shift, step=step)

        def solve(b: Array) -> Array:
            right = b.copy()
            right[: self.one.size] -= self.one * (self.one @ b[: self.one.size])
            return -factors.solve(right)

        return solve


def times(b: Basis, levels: Sequence[Array], form: Form, to: Generator) -> Array:
    """Return the product of a coordinate with an expansion, as a vector of ``to``.

    ``levels`` as of an ``Expansion``, with the functions ``b``; what the product has beyond the
    functions of ``to`` is orthogonal to them and left out. The coordinate is
    ``offset + slope y + direction·ζ``, and ζ_j He_k = √k_j He_(k−e_j) + √(k_j + 1) He_(k+e_j).
    """
    new, others, e = to.functions, to.chain.others, form.direction
    values, _ = b.at_points
    by_y = values.T @ ((b.weights * (form.offset + form.slope * b.points))[:, None] * values)
    old = [u @ b.of_level(n)[:, : u.shape[1]].T for n, u in enumerate(levels)]
    product = [u @ by_y @ new.of_level(n) for n, u in enumerate(old)]
    for n in range(len(levels) - 1):
        product[n + 1] += raised(others, n, old[n] @ new.of_level(n + 1), e)
        product[n] += lowered(others, n, old[n + 1] @ new.of_level(n), e)
    return to.packed(product)


def transforms(A: Generator, c: Array, b: Array, at: Array, step: Step) -> tuple[Complexes, float]:
    """Return c·(iω − A)⁻¹ b at the ascending frequencies ω >= 0 of ``at``, and the residual.

    One elimination, at a shift s, serves the frequencies about it: with B = (s − A)⁻¹ the solution
    of (1 + (iω − s) B) u = B b is taken from the Krylov space of B and B b, one for all ω, by
    Galerkin's method (Arnoldi). The first shift is 0, in real numbers; the next ones are in the
    middle of what is left, where one vector is enough. The residual is that of this equation,
    relative to its solution. The backward equation, with c on its right side, which has two levels
    only, would cost as much: its answer is needed on all levels of b.
    """
    values, worst = np.zeros(at.size, dtype=complex), 0.0
    groups, shift = [np.arange(at.size)], 0.0
    while groups:
        group = groups.pop()
        away = np.asarray(1j * (at[group] - shift))
        found, residuals = _near(A.resolvent(1j * shift, step), c, b, away)
        if not np.all(np.isfinite(residuals)):
            raise np.linalg.LinAlgError(f"no resolvent at the frequency {shift:.3g}")
        solved = residuals <= RESIDUAL
        values[group[solved]] = found[solved]
        worst = max(worst, float(np.max(residuals[solved], initial=0.0)))
        rest = group[~solved]
        sides = (rest[at[rest] < shift], rest[at[rest] > shift])
        groups += [side for side in sides if side.size]
        if groups:
            shift = float(at[groups[-1][groups[-1].size // 2]])
    return values, worst


def _near(
    solve: Callable[[Array], Array], c: Array, b: Array, away: Complexes
) -> tuple[Complexes, Array]:
    """Return c·u of (1 + a B) u = B b for all a of ``away``, and the residuals of each.

    ``solve`` is B. The space grows until all residuals are small or it has ``VECTORS`` vectors.
    """
    first = solve(b)
    size = float(np.linalg.norm(first))
    found, residuals = np.zeros(away.size, dtype=complex), np.full(away.size, np.inf)
    for V, H, closed in _krylov(solve, first, VECTORS):
        m = len(H) - 1
        if m % CHECKED in (0, 1) or closed:
            for k in np.flatnonzero(residuals > RESIDUAL):
                y = np.linalg.solve(np.eye(m) + away[k] * H[:m], size * np.eye(m)[0])
                residuals[k] = abs(away[k] * H[m, -1] * y[-1]) / float(np.linalg.norm(y))
                found[k] = c @ (y @ V)
            if np.all(residuals <= RESIDUAL):
                break
    return found, residuals


def decays(
    A: Generator, c: Array, b: Array, at: Array, rate: float, step: Step, *, tol: float
) -> tuple[Array, float]:
    """Return C(t) = c·e^(At) b and its derivative over ``rate`` at the lags ``at``, (2, lags).

    Beside them the error of C that is left of its calculation. One elimination in real numbers, at
    s = ``rate``, which is to be that of a motion, serves all lags: e^(At) b is taken from the
    Krylov space of b and (s − A)⁻¹, in which A is s − H⁻¹. The space grows until ``CHECKED`` more
    vectors change nothing by more than ``tol`` C(0), or it has ``RITZ_VECTORS``; the error is the
    larger one of the last two changes. Raises ``LinAlgError`` where it grows without bound.
    """
    values, changes = np.zeros((2, at.size)), [np.inf, np.inf]
    for V, H, closed in _krylov(A.resolvent(rate, step), b, RITZ_VECTORS):
        m = len(V)
        if not (m % CHECKED == 0 or closed):
            continue
        theta, W = np.linalg.eig(H[:m])
        parts = (V @ c) @ W * np.linalg.solve(W, np.eye(m)[0]) * np.linalg.norm(b)
        exponents = rate - 1.0 / theta
        with np.errstate(over="ignore", invalid="ignore"):
            grown = np.exp(np.multiply.outer(at, exponents))
            new = np.stack([(grown @ parts).real, (grown @ (parts * exponents)).real / rate])
        if not np.all(np.isfinite(new)):
            changes.append(np.inf)
            continue
        changes.append(float(np.max(np.abs(new[0] - values[0]))))
        values = new
        if closed or max(changes[-2:]) <= tol * abs(c @ b):
            break
    if not np.isfinite(changes[-1]):
        raise np.linalg.LinAlgError("a correlation grows with its lag")
    return values, 0.0 if closed else max(changes[-2:])


def _krylov(
    solve: Callable[[Array], Array], first: Array, most: int
) -> Iterator[tuple[Array, Array, bool]]:
    """Yield for m = 1, …, ``most`` orthonormal V (m, size) and H (m + 1, m) of Arnoldi's method.

    V spans ``first``, B ``first``, …, with B = ``solve``, and H[:m] is B in it; H[m, m − 1] is what
    leads out of it. The last item is whether nothing does, after which there are no more.
    """
    V = np.zeros((most + 1, first.size), dtype=first.dtype)
    H = np.zeros((most + 1, most), dtype=first.dtype)
    V[0] = first / np.linalg.norm(first)
    for m in range(1, most + 1):
        new = solve(V[m - 1])
        for _ in range(2):
            part = V[:m].conj() @ new
            new = new - part @ V[:m]
            H[:m, m - 1] += part
        H[m, m - 1] = length = float(np.linalg.norm(new))
        closed = length <= RESIDUAL * float(np.linalg.norm(H[:m, m - 1]))
        yield V[:m], H[: m + 1, :m], closed
        if closed:
            return
        V[m] = new / length


def rates_in(solve: Callable[[Array], Array], c: Array, b: Array) -> tuple[Complexes, float]:
    """Return the rates λ that c·e^(At) b falls with, Im λ >= 0, and the |λ| up to which.

    Σ g_j e^(−λ_j t): those with |g_j| of at least ``SEEN`` of the sum. They are the eigenvalues of
    −A in the Krylov space of (−A)⁻¹, ``solve``, and b, whose nearest to 0 converge first; where one
    with as large a g has not converged, what lies beyond it is not known.
    """
    *_, (V, H, closed) = _krylov(solve, b, RITZ_VECTORS)
    m = len(V)
    theta, W = np.linalg.eig(H[:m])
    parts = np.linalg.solve(W, np.eye(m)[0]) * np.linalg.norm(b)
    seen = np.abs((V @ c) @ W * parts) >= SEEN * abs(c @ b)
    residual = np.zeros(m) if closed else np.abs(H[m, -1] * W[-1]) / np.abs(theta)
    rates = 1.0 / theta[seen]
    converged = residual[seen] <= CONVERGED
    beyond = float(np.min(np.abs(rates[~converged]), initial=np.inf))
    return rates[converged & (rates.imag >= 0.0) & (np.abs(rates) < beyond)], beyond
