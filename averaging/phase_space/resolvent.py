"""The time-dependent FPK equation: resolvent and eigenvalues of its operator.

The coefficients u of a density obey du/dt = A u; of an expansion A is the matrix of the chain of
levels in orthonormal functions. If mirror images are equally likely, functions that change sign
under reflection, as displacements do, and functions that do not have separate matrices of half the
size. Vectors b, c, u hold all unknowns.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial, singledispatch
from typing import Any

import numpy as np

from averaging.phase_space.equation.basis import basis
from averaging.phase_space.equation.chain import Chain, chain_of
from averaging.phase_space.equation.degrees import combination
from averaging.phase_space.equation.elimination import Expansion, Solve, Step, eliminate
from averaging.phase_space.marginals import linear_form, moments
from fpk.answer.names import Coordinate
from fpk.numeric.arrays import EPS, Array, Complexes
from fpk.numeric.krylov import EVERY, RESIDUAL, VECTORS, krylov

BLOCK = 4
"""Number of random vectors that a space begins with; an eigenvalue of higher multiplicity occurs
this often only among the computed eigenvalues."""
SAME_RATE = 1e-6
"""Relative difference below which two eigenvalues count as a multiple eigenvalue."""
OVERLAP = 0.9
"""Radius about a shift within which all eigenvalues count as found over the distance to the nearest
eigenvalue that has not converged. The next shift lies beyond the part of a line Re λ that discs
cover by this share of the shortest half chord."""
DISCS = 40
"""Largest number of shifts at which eigenvalues are sought: a minute if eliminations are fast."""


@dataclass(frozen=True, eq=False)
class Generator:
    """The equations du/dt = A u of the coefficients u (``size``,) of densities.

    ``solver`` maps a shift s and ``Step`` to the function b → (s − A)⁻¹ b, for a vector or columns
    b, which removes the mass of b and of the result: they should be 0. ``displacement`` maps a mass
    (0-based) to c and b: c·u is ∫ q' u, b are the coefficients of q' p, q' = q − E q. ``metric``
    multiplies by M; the norm (u·M u)^½ of densities should not grow in time. None: M = 1.
    """

    size: int
    solver: Callable[[complex, Step], Solve]
    displacement: Callable[[int], tuple[Array, Array]]
    metric: Callable[[Array], Array] | None = None


def without_mass(solve: Solve, mass: Array, density: Array) -> Solve:
    """Return ``solve`` between two removals of the mass: of ``mass``·u times ``density``.

    Without a shift A is singular, or nearly, which leaves a mass.
    """

    def massless(u: Array) -> Array:
        return np.asarray(u - np.multiply.outer(density, mass @ u))

    return lambda b: massless(solve(massless(b)))


@singledispatch
def generators(e: Any) -> Iterator[Generator]:
    """Yield the generators about the solution ``e``, an ``Expansion`` or another registered one.

    If mirror images are equally likely, the first is of densities that change sign under
    reflection, the second of the others; else there is one.
    """
    b = e.basis
    for odd in (True, False) if b.mirrored else (False,):
        functions = basis(b.frame, b.reference, b.degrees, odd=odd)
        chain = chain_of(functions, joined=True, closed=True)
        solver = partial(chain_solver, chain, packed(e, chain, e.in_panels))
        yield Generator(chain.mass.size, solver, partial(displacement_vectors, e, chain))


def chain_solver(A: Chain, density: Array, shift: complex, step: Step) -> Solve:
    """Return ``Generator.solver`` of a chain with a stationary ``density``.

    For ``step`` see ``eliminate``.
    """
    solve, _ = eliminate(A, shift=shift, step=step)
    return without_mass(lambda b: -solve(b), A.mass, density)


def packed(e: Expansion, A: Chain, u: Array) -> Array:
    """Return the coefficients in A of u (degrees, polynomials of all panels), a density as ``e``.

    Terms outside the functions of A are orthogonal to these and omitted.
    """
    return A.pack([u[e.space.span(n)] @ A.basis.of_level(n) for n in range(len(e.levels))])


def displacement_vectors(e: Expansion, A: Chain, row: int) -> tuple[Array, Array]:
    """Return the vector c with c·u = ∫ q' u for coefficients u in A, and the coefficients of q' p.

    q' is q − E q, q of mass ``row`` (0-based).
    """
    b, space, q = e.basis, e.space, Coordinate("q", row)
    (offset, slope, direction), (at, unit) = linear_form(e, q), b.frame.place(q)
    offset -= unit * moments(e)[0][at]
    values, up = b.at_points[0], combination(space.up, direction)
    by_y = values.T @ ((b.weights * (offset + slope * b.points))[:, None] * values)
    s, first, _ = space.first_moments
    integrals = np.multiply.outer(s, (b.measure * (offset + slope * b.points)) @ values)
    integrals += np.multiply.outer(direction @ first, b.measure @ values)
    product = e.in_panels @ by_y + (up + up.T) @ e.in_panels
    return packed(e, A, integrals), packed(e, A, product)


def transforms(A: Generator, c: Array, b: Array, at: Array, step: Step) -> tuple[Complexes, float]:
    """Return c·(iω − A)⁻¹ b at ascending ω >= 0, ``at``, and the largest residual over |u|.

    One elimination, at a shift s, serves the frequencies about it: with B = (s − A)⁻¹ the equation
    (1 + (iω − s) B) u = B b is solved in the Krylov space of B and B b by Galerkin's method. Raises
    ``LinAlgError`` if an elimination fails.
    """
    values, worst = np.zeros(at.size, dtype=complex), 0.0
    groups, shift = [np.arange(at.size)], 0.0
    while groups:
        group = groups.pop()
        away = np.asarray(1j * (at[group] - shift))
        solve = A.solver(1j * shift if shift else 0.0, step)
        first = solve(b)
        found, residuals = np.zeros(away.size, dtype=complex), np.full(away.size, np.inf)
        for V, H, closed in krylov(solve, first[:, None], VECTORS):
            m = len(V)
            if m % EVERY in (0, 1) or closed:
                seen, size = V @ c, np.linalg.norm(first) / np.linalg.norm(V[0])
                for k in np.flatnonzero(residuals > RESIDUAL):
                    y = np.linalg.solve(np.eye(m) + away[k] * H[:m], size * np.eye(m)[0])
                    residuals[k] = abs(away[k]) * np.linalg.norm(H[m:] @ y) / np.linalg.norm(y)
                    found[k] = seen @ y
                if np.all(residuals <= RESIDUAL):
                    break
        if not np.all(np.isfinite(residuals)):
            raise np.linalg.LinAlgError(f"no resolvent at the frequency {shift:.3g}")
        solved = residuals <= RESIDUAL
        values[group[solved]] = found[solved]
        worst = max(worst, float(np.max(residuals[solved], initial=0.0)))
        rest = group[~solved]
        groups += [side for side in (rest[at[rest] < shift], rest[at[rest] > shift]) if side.size]
        if groups:
            shift = float(at[groups[-1][groups[-1].size // 2]])
    return values, worst


def decays(
    A: Generator, c: Array, b: Array, at: Array, rate: float, step: Step, *, tol: float
) -> tuple[Array, float]:
    """Return C(t) = c·e^(At) b and C'/``rate`` at the lags ``at``, (2, lags), and the error of C.

    The Krylov space of b and (s − A)⁻¹, s = ``rate``, in which A is s − H⁻¹, grows until the last
    two changes of C, by ``EVERY`` vectors each, are within ``tol`` C(0), or it has ``VECTORS``
    vectors; the larger change is the error, 0 if the space is invariant. Raises ``LinAlgError`` if
    C grows with t.
    """
    values, changes = np.zeros((2, at.size)), [np.inf, np.inf]
    for V, H, closed in krylov(A.solver(rate, step), b[:, None], VECTORS, metric=A.metric):
        m = len(V)
        if not (m % EVERY == 0 or closed):
            continue
        theta, W = np.linalg.eig(H[:m])
        size = np.linalg.norm(b) / np.linalg.norm(V[0])
        parts = size * (V @ c) @ W * np.linalg.solve(W, np.eye(m)[0])
        exponents = rate - 1.0 / theta
        with np.errstate(over="ignore", invalid="ignore"):
            grown = np.exp(np.multiply.outer(at, exponents))
            new = np.stack([(grown @ parts).real, (grown @ (parts * exponents)).real / rate])
        finite = bool(np.all(np.isfinite(new)))
        changes.append(float(np.max(np.abs(new[0] - values[0]))) if finite else np.inf)
        values = new if finite else values
        if finite and (closed or max(changes[-2:]) <= tol * abs(c @ b)):
            break
    if not np.isfinite(changes[-1]):
        raise np.linalg.LinAlgError("a correlation grows with its lag")
    return values, 0.0 if closed else max(changes[-2:])


def eigenvalues(A: Generator, at: float, step: Step) -> tuple[Complexes, float]:
    """Return the eigenvalues λ of −A within a radius of i ``at``, and the radius.

    Within it are all eigenvalues; it is ∞ if no computed eigenvalue is inaccurate.
    """
    solve = A.solver(1j * at if at else 0.0, step)
    random = np.random.default_rng(0).normal(size=(A.size, BLOCK))
    *_, (V, H, _) = krylov(solve, solve(random), VECTORS)
    theta, W = np.linalg.eig(H[: len(V)])
    rounding = EPS * np.max(np.abs(theta))
    known = np.abs(theta) > rounding
    theta, residual = theta[known], np.linalg.norm(H[len(V) :] @ W, axis=0)[known] + rounding
    away = 1.0 / np.abs(theta)
    radius = OVERLAP * float(np.min(away[residual * away > EPS**0.5], initial=np.inf))
    # θ is 1/(iω + λ); the conjugate of each λ is an eigenvalue of −A, too.
    return np.asarray(1.0 / theta - 1j * at, dtype=complex).conj()[away < radius], radius


def slowest_rates(
    parts: Sequence[Generator], count: int, fastest: float, *, most: int, step: Step
) -> tuple[Complexes, str]:
    """Return eigenvalues λ of −A of all ``parts`` with Im λ >= 0, Re λ ascending, and a text.

    The first ``count`` are the slowest; the text says which may be missing, or "". At most ``most``
    discs follow each other up the imaginary axis, at least to the largest natural frequency
    ``fastest``, and until no rate as slow can lie above, if no Im λ/Re λ exceeds the largest found.
    Raises ``LinAlgError`` if no eigenvalue is found.
    """
    rates, discs, at = np.zeros(0, dtype=complex), list[tuple[float, float]](), 0.0
    while True:
        near = [eigenvalues(A, at, step) for A in parts]
        new, radius = np.concatenate([x for x, _ in near]), min(r for _, r in near)
        inside = (np.abs(new - 1j * at) < radius) & (new.imag >= -SAME_RATE * np.abs(new))
        apart = [np.abs(new - 1j * w) >= r for w, r in discs]
        new = new[np.all([inside, *apart], axis=0)]
        rates = np.concatenate([rates, new.real + 1j * np.abs(new.imag)])
        # Round the real parts, as those of sums of rates are often equal except for round-off.
        scale = SAME_RATE * float(np.min(np.abs(rates), initial=np.inf))
        rates = rates[np.lexsort((rates.imag, np.round(rates.real / scale)))]
        discs.append((at, radius))
        slowest = float(np.max(rates.real[:count], initial=0.0))
        # Half the length of the line Re λ = slowest in each disc, and how far discs cover the line.
        halves = [np.sqrt(max(r**2 - slowest**2, 0.0)) for _, r in discs]
        end = 0.0
        for (w, _), half in sorted(zip(discs, halves, strict=True)):
            end = max(end, w + half) if w - half <= end else end
        steepest = float(np.max(rates.imag / rates.real, initial=0.0))
        if rates.size >= count and end >= max(fastest, slowest * steepest):
            same = np.abs(rates[:count, None] - rates) <= SAME_RATE * np.abs(rates)
            often = rates[:count][np.sum(same, axis=1) >= BLOCK]
            missing = f"the rate {often[0]:.3g} occurs {BLOCK} times or more" if often.size else ""
            return rates, missing
        if min(halves) == 0.0 or len(discs) >= most:
            if not rates.size:
                raise np.linalg.LinAlgError("no relaxation rate is found")
            found = f"{min(rates.size, count)} of {count} rates are found"
            return rates, f"{found}: rates of angular frequencies above {end:.3g} are not sought"
        at = end + OVERLAP * min(halves)
