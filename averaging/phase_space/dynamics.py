"""Crossings, spectra, autocovariances and relaxation rates of the full system, with errors.

The coefficients u of the expansion obey du/dt = A u, A the matrix of the chain of levels in
orthonormal functions. If mirror images are equally likely, functions that change sign under
reflection, as displacements do, and functions that do not have separate chains of half the size.
In all signatures ``row`` is the mass of q, from 0, ``at`` are levels, angular frequencies or lags
(points,), ``tol`` is the relative tolerance; vectors b, c, u hold all unknowns.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import maximum_filter1d
from scipy.optimize import linear_sum_assignment

from averaging.gaussian import GAUSSIAN_REACH
from averaging.phase_space.densities import DISTANCE_POINTS
from averaging.phase_space.equation.basis import EVERY, RESIDUAL, VECTORS, basis, krylov
from averaging.phase_space.equation.chain import Chain, chain_of
from averaging.phase_space.equation.degrees import combination
from averaging.phase_space.equation.elimination import Expansion, Step, eliminate, solution_cost
from averaging.phase_space.equation.frame import Frame
from averaging.phase_space.marginals import linear_form, marginal, moments
from averaging.phase_space.refinement import (
    DENSITY_ROUND_OFF,
    Ladder,
    Options,
    breakdowns,
    credible_ratio,
    error_by_distances,
    solution_ladder,
)
from fpk.answer.names import Coordinate, Observable
from fpk.numeric.arrays import EPS, Array, Complexes
from fpk.numeric.quadrature import gauss_grid
from fpk.solvers.plane.time.transient import KRYLOV_SHARE

BLOCK = 4
"""Random vectors of the first block; an eigenvalue of higher multiplicity is found this often
only."""
SAME_RATE = 1e-6
"""Relative difference below which two eigenvalues count as a multiple eigenvalue."""
OVERLAP = 0.9
"""Share of the distance from a shift to the nearest eigenvalue that has not converged, within which
all are taken as found. The next shift lies beyond the covered line by this share of the shortest
half of that line in a disc."""
DISCS = 40
"""Largest number of shifts at which eigenvalues are sought: a minute if eliminations are fast."""


@dataclass(frozen=True, eq=False)
class Answer:
    """Values (points,) by one solution, and after ``adapt`` their ``errors`` (points,).

    Errors follow from the difference of two answers in ``compared``, (kinds, points) or all rates,
    plus ``added``; tolerances are relative to ``scale``. ``residual`` is of equations beside the
    stationary equation, ``missing`` says which values are uncertain, ``limit`` why there is no
    finer answer, or "".
    """

    values: Array | Complexes
    compared: Array | Complexes
    scale: Array | float
    added: Array | float = 0.0
    residual: float = 0.0
    missing: str = ""
    errors: Array | float = np.inf
    limit: str = ""

    @property
    def relative(self) -> float:
        """The largest error in units of the scale."""
        return float(np.max(self.errors / self.scale))


Measure = Callable[[Expansion, Step], Answer]
Apart = Callable[[Ladder, Answer, Answer], Array]
"""Maps a ladder, the finer and the coarser answer to the differences of their values (points,)."""


def largest(ladder: Ladder, fine: Answer, coarse: Answer) -> Array:
    """Return the largest difference (points,) of all kinds of values in ``compared``."""
    return np.asarray(np.abs(fine.compared - coarse.compared).max(axis=0))


@breakdowns()
def adapt(
    frame: Frame,
    observables: Sequence[Observable],
    measure: Measure,
    options: Options,
    apart: Apart,
    *,
    tol: float,
    what: str,
    numbers: type = complex,
) -> tuple[Ladder, Answer]:
    """Return the first answer whose relative error is at most ``tol``, else the best answer.

    ``measure`` computes the answer of one solution, ``apart`` the difference of two answers, whose
    error is estimated as for densities. The densities of ``observables`` meet the tolerance, too,
    unless a limit ends the refinement. An earlier answer with a smaller error is preferred if the
    later answer agrees within it. ``what`` is for reports of progress, ``numbers`` the type of the
    numbers of the elimination.
    """
    best: tuple[Ladder, Answer] | None = None
    believed: float | None = None
    fine: Answer | None = None
    for ladder in solution_ladder(frame, observables, options):
        cost = solution_cost(ladder.finest.basis, numbers=numbers)
        if best is not None and (limit := ladder.limit or options.refusal(*cost)):
            own, answer = best
            return own, replace(answer, limit="" if answer.relative <= tol else limit)
        coarse = fine or measure(ladder.coarser, options.step(what, len(ladder.coarser.levels) - 1))
        fine = measure(ladder.finest, options.step(what, len(ladder.finest.levels) - 1))
        difference = apart(ladder, fine, coarse)
        relative = float(np.max(difference / fine.scale))
        believed, error = error_by_distances(relative, believed, credible_ratio(frame))
        errors = (error / relative if relative > 0.0 else 0.0) * difference
        later = replace(fine, errors=errors + fine.added + DENSITY_ROUND_OFF * fine.scale)
        earlier = later if best is None else best[1]
        a, b = ((bool(x.missing), x.relative) for x in (earlier, later))
        agree = a <= b and earlier.values.shape == later.values.shape
        agree = agree and bool(np.all(np.abs(earlier.values - later.values) <= earlier.errors))
        if best is None or not agree:
            best = ladder, later
        if max(best[1].relative, *ladder.errors.values()) <= tol:
            break
    assert best is not None
    return best


def deviations(e: Expansion, row: int) -> Array:
    """Return the standard deviations of q and of the velocity of mass ``row`` (0-based)."""
    frame, variances = e.basis.frame, np.diag(moments(e)[1])
    place = frame.order.index(row)
    return np.asarray(np.sqrt(variances[[place, frame.n + place]] / frame.system.mass[row]))


def crossings(e: Expansion, step: Step, *, row: int, at: Array, tol: float) -> Answer:
    """Return the rates of upcrossing of levels; the net flux, which should be 0, adds an error."""
    (size, velocity), (up, net) = deviations(e, row), crossing_rates(e, row, at)
    return Answer(up, up[None], velocity / (2.0 * np.pi * size), added=np.abs(net))


def about_levels(ladder: Ladder, fine: Answer, coarse: Answer, *, row: int, at: Array) -> Array:
    """Return the largest difference of the rates within half a standard deviation of each level."""
    ((ends,), _), count = marginal(ladder.finest, (Coordinate("q", row),)), DISTANCE_POINTS[2]
    grid = np.linspace(ends[0], ends[-1], count)
    up, before = (crossing_rates(e, row, grid)[0] for e in (ladder.finest, ladder.coarser))
    wide = maximum_filter1d(np.abs(up - before), int(0.5 * count / GAUSSIAN_REACH) + 1)
    return np.maximum(np.interp(at, grid, wide), largest(ladder, fine, coarse))


def crossing_rates(e: Expansion, row: int, at: Array) -> tuple[Array, Array]:
    """Return the rates of upcrossing ∫_0^∞ v f(a, p) dp (Rice) and the net flux ∫ v f(a, p) dp."""
    axes, pdf = marginal(e, (Coordinate("q", row), Coordinate("p", row)))
    _, [(p, w)] = gauss_grid([np.union1d(axes[1], 0.0)])
    flux = w * p / e.basis.frame.system.mass[row]
    # Sixteen levels at a time, since arrays have levels times all points of p and y.
    parts = [pdf(part[:, None], p) for part in np.array_split(at, 1 + at.size // 16)]
    density = np.concatenate(parts)
    return density @ np.maximum(flux, 0.0), density @ flux


def spectrum(e: Expansion, step: Step, *, row: int, at: Array, tol: float) -> Answer:
    """Return the power spectral density Re G(iω)/π, G(s) = ∫ q' (s − L)⁻¹ q' p, q' = q − E q.

    On the flank of a peak S may agree in two solutions although the peak has moved; Im G then does
    not. So G is compared, too, without its first terms at high frequency σ_q²/s − σ_v²/s³, which do
    not contribute to S: G − σ_q² (s + κ)/(s² + κ s + κ²), κ = σ_v/σ_q.
    """
    w, place = np.unique(np.abs(at), return_inverse=True)
    A, (size, velocity) = generator(e, odd=e.basis.mirrored), deviations(e, row)
    G, residual = transforms(A, *displacement_vectors(e, row, A), w, step)
    s, rate = 1j * w, velocity / size
    rest = G - size**2 * (s + rate) / (s**2 + s * rate + rate**2)
    compared = np.stack([rest, G.real])[:, place] / np.pi
    return Answer(G.real[place] / np.pi, compared, size**3 / velocity, residual=residual)


def correlation(e: Expansion, step: Step, *, row: int, at: Array, tol: float) -> Answer:
    """Return the autocovariance C(t) = ∫ q' e^(Lt) q' p of q, q' = q − E q.

    C may agree in two solutions by chance, at a lag where oscillations of different frequencies
    meet; C' does not there. So C + i C'/κ is compared, κ = 2 σ_v/σ_q.
    """
    A, (size, velocity) = generator(e, odd=e.basis.mirrored), deviations(e, row)
    c, b = displacement_vectors(e, row, A)
    values, error = decays(A, c, b, at, 2.0 * velocity / size, step, tol=KRYLOV_SHARE * tol)
    compared = (values[0] + 1j * values[1])[None]
    return Answer(values[0], compared, size**2, added=error + abs(float(c @ b) - size**2))


def relaxation(e: Expansion, step: Step, *, count: int, work: float) -> Answer:
    """Return the ``count`` slowest eigenvalues λ of −L, Im λ >= 0, each as often as it occurs."""
    parities = (True, False) if e.basis.mirrored else (False,)
    parts = [generator(e, odd=odd, closed=True) for odd in parities]
    # Largest natural frequency of the linear system with the covariances of the solution.
    n, (q, v) = e.basis.frame.n, np.split(moments(e)[1], 2)
    squares = np.linalg.eigvals(np.linalg.solve(q[:, :n], v[:, n:]))
    most = min(DISCS, int(work / (len(parts) * solution_cost(e.basis, numbers=complex)[1])))
    fastest = float(np.sqrt(squares.real.max()))
    rates, missing = slowest_rates(parts, count, fastest, most=most, step=step)
    return Answer(rates[:count], rates, np.abs(rates[:count]), missing=missing)


def nearest(ladder: Ladder, fine: Answer, coarse: Answer) -> Array:
    """Return the difference of each rate to its partner in ``coarse``, in the nearest pairing."""
    apart, differences = np.abs(fine.values[:, None] - coarse.compared), np.abs(fine.values)
    rows, columns = linear_sum_assignment(apart)
    differences[rows] = apart[rows, columns]
    return differences


def generator(e: Expansion, *, odd: bool, closed: bool = False) -> Chain:
    """Return A on functions that change sign under reflection if ``odd``, else on the others."""
    b = e.basis
    return chain_of(basis(b.frame, b.reference, b.degrees, odd=odd), closed=closed)


def solve_shifted(A: Chain, shift: complex, step: Step) -> Callable[[Array], Array]:
    """Return the function b → (s − A)⁻¹ b, s = ``shift``, for vectors or columns b of mass 0."""
    (solve, _), one = eliminate(A, shift=shift, step=step), A.basis.of_one

    def massless(u: Array) -> Array:
        # A is singular; so the mass that round-off leaves is removed from b and from the solution.
        level, rest = u[: one.size], u[one.size :]
        return np.concatenate([level - np.multiply.outer(one, one @ level), rest])

    return lambda b: -massless(solve(massless(b)))


def displacement_vectors(e: Expansion, row: int, A: Chain) -> tuple[Array, Array]:
    """Return the coefficients in A of q' times the reference density, and of q' p, q' = q − E q.

    The scalar product of u with the first is ∫ q' u. By ζ_j He_k = √k_j He_(k−e_j) +
    √(k_j + 1) He_(k+e_j); terms outside the functions of A are orthogonal to these and omitted.
    """
    b, space, q = e.basis, e.space, Coordinate("q", row)
    (offset, slope, direction), (at, unit) = linear_form(e, q), b.frame.place(q)
    offset -= unit * moments(e)[0][at]
    values, up = b.at_points[0], combination(space.up, direction)
    by_y = values.T @ ((b.weights * (offset + slope * b.points))[:, None] * values)
    density = np.vstack([e.of_panels(n) for n in range(len(e.levels))])
    reference = np.zeros_like(density)
    reference[0] = b.continuous @ b.of_one
    products = [u @ by_y + (up + up.T) @ u for u in (reference, density)]
    first, second = (
        A.pack([u[space.span(n)] @ A.basis.of_level(n) for n in range(len(e.levels))])
        for u in products
    )
    return first, second


def transforms(A: Chain, c: Array, b: Array, at: Array, step: Step) -> tuple[Complexes, float]:
    """Return c·(iω − A)⁻¹ b at ascending frequencies ω >= 0, ``at``, and the residual over |u|.

    One elimination, at a shift s, serves the frequencies about it: with B = (s − A)⁻¹ the equation
    (1 + (iω − s) B) u = B b is solved in the Krylov space of B and B b by Galerkin's method. The
    first s is 0, each further s in the middle of frequencies not yet solved for. Raises
    ``LinAlgError`` if an elimination fails.
    """
    values, worst = np.zeros(at.size, dtype=complex), 0.0
    groups, shift = [np.arange(at.size)], 0.0
    while groups:
        group = groups.pop()
        away = np.asarray(1j * (at[group] - shift))
        solve = solve_shifted(A, 1j * shift if shift else 0.0, step)
        first = solve(b)
        size = float(np.linalg.norm(first))
        found, residuals = np.zeros(away.size, dtype=complex), np.full(away.size, np.inf)
        for V, H, closed in krylov(solve, first[:, None], VECTORS):
            m = len(V)
            if m % EVERY in (0, 1) or closed:
                for k in np.flatnonzero(residuals > RESIDUAL):
                    y = np.linalg.solve(np.eye(m) + away[k] * H[:m], size * np.eye(m)[0])
                    residuals[k] = abs(away[k]) * np.linalg.norm(H[m:] @ y) / np.linalg.norm(y)
                    found[k] = c @ (y @ V)
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
    A: Chain, c: Array, b: Array, at: Array, rate: float, step: Step, *, tol: float
) -> tuple[Array, float]:
    """Return C(t) = c·e^(At) b and C'/``rate`` at the lags t of ``at``, (2, lags), and their error.

    The Krylov space of b and (s − A)⁻¹, s = ``rate``, in which A is s − H⁻¹, grows until the last
    two changes of C, by ``EVERY`` vectors each, are within ``tol`` C(0); the larger change is the
    error. Raises ``LinAlgError`` if C grows with t.
    """
    values, changes = np.zeros((2, at.size)), [np.inf, np.inf]
    for V, H, closed in krylov(solve_shifted(A, rate, step), b[:, None], VECTORS):
        m = len(V)
        if not (m % EVERY == 0 or closed):
            continue
        theta, W = np.linalg.eig(H[:m])
        parts = (V @ c) @ W * np.linalg.solve(W, np.eye(m)[0]) * np.linalg.norm(b)
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


def eigenvalues(A: Chain, at: float, step: Step) -> tuple[Complexes, float]:
    """Return eigenvalues λ of −A near i ``at``, and the radius within which they are complete."""
    solve = solve_shifted(A, 1j * at if at else 0.0, step)
    random = np.random.default_rng(0).normal(size=(A.ends[-1], BLOCK))
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
    parts: Sequence[Chain], count: int, fastest: float, *, most: int, step: Step
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
