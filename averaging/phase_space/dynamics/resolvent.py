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
from fpk.arrays import EPS, Array, Complexes

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
BLOCK = 4
"""Random vectors that such a space begins with: eigenvalues of a multiplicity of up to as many are
found as often as they occur."""
SAME = 1e-6
"""Relative distance of two eigenvalues that are one of a multiplicity."""
OVERLAP = 0.9
"""Share of the radius about a shift within which eigenvalues count as found there, and of the step
to the next shift: the unconverged one that ends the radius is known to some digits only."""
DISCS = 40
"""Most shifts at which eigenvalues are sought: a minute where eliminations are fast."""

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
    def of(cls, frame: Frame, e: Expansion, *, odd: bool, closed: bool = False) -> "Generator":
        """Return A of the degrees and the reference of an expansion with all levels.

        ``closed`` as of ``chain_of``: for eigenvalues.
        """
        functions = basis(frame, e.basis.reference, e.degrees, odd=odd)
        chain = chain_of(frame, e.basis.reference, functions, e.degrees, closed=closed)
        return cls(functions, chain, functions.of_one())

    def shaped(self, u: Array) -> list[Array]:
        """Return the parts of a vector as ``levels`` of an ``Expansion``."""
        return self.chain.shaped(u)

    def packed(self, levels: Sequence[Array]) -> Array:
        """Return ``levels`` of an ``Expansion`` as a vector."""
        return self.chain.packed(levels)

    def resolvent(self, shift: complex, step: Step) -> Callable[[Array], Array]:
        """Return the function b → (s − A)⁻¹ b for s = ``shift``, b a vector or columns of them.

        Of b, which has no mass, what round-off left of it is removed: A is singular at s = 0.
        """
        factors, _ = factored(self.chain, one=self.one, shift=shift, step=step)

        def solve(b: Array) -> Array:
            right = b.copy()
            right[: self.one.size] -= np.multiply.outer(self.one, self.one @ b[: self.one.size])
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
    for V, H, closed in _krylov(solve, first[:, None], VECTORS):
        m = len(V)
        if m % CHECKED in (0, 1) or closed:
            for k in np.flatnonzero(residuals > RESIDUAL):
                y = np.linalg.solve(np.eye(m) + away[k] * H[:m], size * np.eye(m)[0])
                residuals[k] = abs(away[k]) * np.linalg.norm(H[m:] @ y) / np.linalg.norm(y)
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
    for V, H, closed in _krylov(A.resolvent(rate, step), b[:, None], RITZ_VECTORS):
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
    """Yield orthonormal V (m, size) and H (rows, m) of Arnoldi's method, up to m = ``most``.

    V spans the b columns of ``first`` (size, b), the first vector that of the first column, then
    those of B ``first``, …, with B = ``solve``, b more in each step. H[:m] is B in V, and the rows
    behind are what leads out of V. The last item is whether nothing does, after which there are no
    more.
    """
    b, rows, m = first.shape[1], first.shape[1], 0
    V = np.zeros((most + b, len(first)), dtype=first.dtype)
    H = np.zeros((most + b, most), dtype=first.dtype)
    Q, R = np.linalg.qr(first)
    V[:b] = (Q * np.sign(np.diag(R).real)).T
    while m < min(rows, most):
        for new in solve(V[m : min(rows, most)].T).T:
            for _ in range(2):
                part = V[:rows].conj() @ new
                new = new - part @ V[:rows]
                H[:rows, m] += part
            length = float(np.linalg.norm(new))
            if length > RESIDUAL * float(np.linalg.norm(H[:rows, m])):
                H[rows, m], V[rows] = length, new / length
                rows += 1
            m += 1
        yield V[:m], H[:rows, :m], m == rows


def eigenvalues(A: Generator, at: float, step: Step) -> tuple[Complexes, float]:
    """Return eigenvalues λ of −A, and the |λ − iω| up to which all are among them, ω = ``at``.

    Each as often as it occurs, up to ``BLOCK`` times, by Arnoldi's method with (iω − A)⁻¹ from as
    many random vectors: eigenvalues nearest to iω converge first.
    """
    solve = A.resolvent(1j * at if at else 0.0, step)
    random = np.random.default_rng(0).normal(size=(A.chain.ends[-1], BLOCK))
    *_, (V, H, _) = _krylov(solve, solve(random), RITZ_VECTORS)
    theta, W = np.linalg.eig(H[: len(V)])
    rounding = EPS * np.max(np.abs(theta))
    known = np.abs(theta) > rounding
    theta, residual = theta[known], np.linalg.norm(H[len(V) :] @ W, axis=0)[known] + rounding
    away = 1.0 / np.abs(theta)
    radius = OVERLAP * float(np.min(away[residual * away > CONVERGED], initial=np.inf))
    # θ is 1/(iω + λ); the conjugate of each λ is an eigenvalue of −A, too.
    return np.asarray(1.0 / theta - 1j * at, dtype=complex).conj()[away < radius], radius


def slowest_rates(
    parts: Sequence[Generator], count: int, fastest: float, *, most: int, step: Step
) -> tuple[Complexes, str]:
    """Return eigenvalues λ of −A of all ``parts``, Im λ >= 0, in ascending order of Re λ.

    The ``count`` slowest of all are the first ones, unless the words behind say what is missing.
    Eigenvalues are sought in discs that follow each other along the imaginary axis, at most
    ``most`` of them, up to the largest natural frequency ``fastest`` and until no rate as slow can
    lie above: rates of a linear system are sums of rates of its modes, so that Im λ/Re λ of none is
    more than that of a mode.
    """
    rates, discs, at = np.zeros(0, dtype=complex), list[tuple[float, float]](), 0.0
    while True:
        near = [eigenvalues(A, at, step) for A in parts]
        new, radius = np.concatenate([x for x, _ in near]), min(r for _, r in near)
        inside = (np.abs(new - 1j * at) < radius) & (new.imag >= -SAME * np.abs(new))
        apart = [np.abs(new - 1j * w) >= r for w, r in discs]
        new = new[np.all([inside, *apart], axis=0)]
        rates = np.concatenate([rates, new.real + 1j * np.abs(new.imag)])
        # Sums of rates often have equal real parts, but for round-off.
        scale = SAME * float(np.min(np.abs(rates), initial=np.inf))
        rates = rates[np.lexsort((rates.imag, np.round(rates.real / scale)))]
        discs.append((at, radius))
        slowest = float(np.max(rates.real[:count], initial=0.0))
        # Half the lengths of the line Re λ = slowest within the discs, and its end without a gap.
        halves = [np.sqrt(max(r**2 - slowest**2, 0.0)) for _, r in discs]
        end = 0.0
        for (w, _), half in sorted(zip(discs, halves, strict=True)):
            end = max(end, w + half) if w - half <= end else end
        steepest = float(np.max(rates.imag / rates.real, initial=0.0))
        if rates.size >= count and end >= max(fastest, slowest * steepest):
            same = np.abs(rates[:count, None] - rates) <= SAME * np.abs(rates)
            often = rates[:count][np.sum(same, axis=1) >= BLOCK]
            words = [f"the rate {rate:.3g} occurs {BLOCK} times or more" for rate in often[:1]]
            return rates, "".join(words)
        if min(halves) == 0.0 or len(discs) >= most:
            if not rates.size:
                raise np.linalg.LinAlgError("no relaxation rate is found")
            found = f"{min(rates.size, count)} of {count} rates are found"
            return rates, f"{found}: rates of angular frequencies above {end:.3g} are not sought"
        at = end + OVERLAP * min(halves)
