"""Two modal energies in time, coupled by damping or not, by finite elements, Eqs. (17), (33).

Displacements and momenta follow from their joint density, Eqs. (35), (36).
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from averaging.modal.analysis import ModalAnalysis
from averaging.modal.characteristic import state_density
from averaging.modal.observables import unsolved
from averaging.time.start import EnergyStart, limited_modes, observed_modes
from fpk.answer.certificate import Measured, outside
from fpk.answer.density import Density, certified_density
from fpk.answer.dynamics import Rates
from fpk.answer.evolution import LARGEST_ERROR, Passage, Transient, checked_times
from fpk.answer.observable import Coordinate
from fpk.answer.question import Asked
from fpk.numeric.arrays import ROUNDINGS, SMALLEST, Array
from fpk.numeric.errors import NotApplicable
from fpk.solvers.plane.solution import PlaneSolution
from fpk.solvers.plane.stationary import solve_plane
from fpk.solvers.plane.time.operator import PlaneOperator, PlaneStart
from fpk.solvers.plane.time.passage import PlaneLimit, first_passage, relaxation_rates
from fpk.solvers.plane.time.transient import Level, Seen, seen_at, transient_densities


def transient(modes: ModalAnalysis, asked: Asked) -> Transient:
    """Return the densities of one or two modal energies, of the sum of two, or of (q, p)."""
    observable, start, times = asked.observable, asked.start, asked.times
    at, tol = asked.at, asked.tol
    checked_times(times, positive=True)
    if {c.kind for c in observable} <= {"q", "p"}:
        return _state_transient(modes, asked)
    rows = observed_modes(observable)
    pair = _pair(modes, rows or range(modes.n))
    if rows == pair[::-1]:
        at = at[::-1]
    seen: Seen = "pair" if len(rows) == 2 else "sum"
    if len(rows) == 1:
        seen = "first" if rows == pair[:1] else "second"
    which = [pair.index(r) for r in sorted(rows)]

    by_modes = partial(_by_modes, modes, pair, which if rows else None, start)
    posed = _posed(modes, pair, start, tol)
    answer, _ = transient_densities(*posed, seen, times, at, tol=tol, coefficients_error=by_modes)
    return answer


def passage(modes: ModalAnalysis, asked: Asked) -> Passage:
    """Return the first passage of one or two modal energies, or of the sum of two."""
    limit, times, tol = asked.limit, checked_times(asked.times), asked.tol
    limits = limited_modes(limit, asked.start)
    pair = _pair(modes, list(limits) or range(modes.n))
    first, second = (limits.get(m) for m in pair)
    plane = PlaneLimit(first, second, None if limits else limit.value)
    posed, error = _posed(modes, pair, asked.start, tol), modes.relative_error
    return first_passage(*posed, plane, times, tol=tol, coefficients_error=error)


def relaxation(modes: ModalAnalysis, count: int, *, tol: float) -> Rates:
    """Return the ``count`` slowest rates but 0 of two modal energies."""
    if modes.n != 2:
        raise NotApplicable("relaxation rates by fem are those of two modal energies")
    density = _stationary(modes, _pair(modes, range(2)), tol)
    return relaxation_rates(density, count, tol=tol, relative=modes.relative_error)


def _pair(modes: ModalAnalysis, rows: Sequence[int]) -> list[int]:
    """The two modes to solve for together, on which no other acts."""
    if reason := unsolved(modes, "fem"):
        raise NotApplicable(reason)
    behind = {m for group in modes.averaged.groups if set(group) & set(rows) for m in group}
    alone = [g[0] for g in modes.averaged.groups if len(g) == 1 and g[0] not in behind]
    pair = sorted([*behind, *alone[: max(0, 2 - len(behind))]])
    if len(pair) != 2:
        raise NotApplicable(f"in time fem solves for two modal energies, not for {len(pair)}")
    return pair


def _by_modes(
    modes: ModalAnalysis,
    pair: list[int],
    which: list[int] | None,
    start: EnergyStart,
    t: float,
    *H: Array,
) -> Array:
    """The relative error of p by that of the modes, at energies ``which`` of a pair or their sum.

    It counts in units of the means (2,) that the noise has fed into the modes from rest by ``t``.
    """
    spread = modes.temperature[pair] * -np.expm1(-2.0 * modes.half_bandwidth[pair] * t)
    each = [spread.min()] if which is None else spread[which]
    reach = sum(np.abs(x) / s for x, s in zip(H, each, strict=True))
    return np.asarray(
        2.0 * modes.relative_error * (1.0 + reach + np.sum(start.energies[pair] / spread))
    )


def _posed(
    modes: ModalAnalysis, pair: list[int], start: EnergyStart, tol: float
) -> tuple[PlaneSolution, PlaneStart]:
    """The stationary density of the equation, and what the density begins with."""
    stationary = _stationary(modes, pair, tol)
    if start.noise is None:
        return stationary, PlaneStart(start.energies[pair])
    louder = replace(modes, modal_noise=start.noise * modes.modal_noise)
    return stationary, PlaneStart(None, _stationary(louder, pair, tol), start.noise)


def _stationary(modes: ModalAnalysis, pair: list[int], tol: float) -> PlaneSolution:
    """The stationary density to a hundredth of the tolerance, or to 1e-11."""
    return solve_plane(modes.process(pair), tol=max(1e-2 * tol, 1e-11))


def _state_transient(modes: ModalAnalysis, asked: Asked) -> Transient:
    """Return the densities of one or two of (q, p) of two modes.

    The phases are independent and uniform, whatever the energies, which are solved for to half of
    the tolerance. The certificate is that of the worst time; a time too short for the operator is
    not certified, its errors infinite.
    """
    times, at, tol, pair = asked.times, asked.at, asked.tol, _pair(modes, range(modes.n))
    stationary, start = _posed(modes, pair, asked.start, tol)
    none = np.zeros(0), np.zeros(0)
    answer, levels = transient_densities(stationary, start, "pair", times, none, tol=0.5 * tol)
    tail = outside(answer.certificate)
    measured = Measured(start.l1_error + 2.0 * tail, None, None, levels[1][1].residual, tail)
    values, errors = np.empty((2, times.size, at[0].size))
    densities = []
    for k, t in enumerate(times.tolist()):
        of_modes = partial(_by_modes, modes, pair, [0, 1], asked.start, t)
        group = _energies(levels, k, of_modes, measured, tol)
        densities.append(state_density(modes, [group], asked.observable, tol=tol))
        values[k], errors[k] = densities[k].at(*at)
        errors[k] = errors[k] if group.l1_error <= LARGEST_ERROR else np.inf
    worst = max(densities, key=lambda d: (not d.certificate.certified, d.l1_error))
    return Transient(
        times, values, errors + SMALLEST, "numerical", worst.certificate, answer.settings
    )


def _energies(
    levels: tuple[Level, Level],
    k: int,
    of_modes: Callable[..., Array],
    measured: Measured,
    tol: float,
) -> Density:
    """The joint density of both energies at the time ``k``, its error the distance of two levels.

    ``of_modes`` is the relative error by the modes at energies.
    """
    (other_op, other), (op, g) = levels

    def of(op: PlaneOperator, g: Array, *H: Array) -> Array:
        """The density of unknowns g at all times on the grid of a column H1 and a row H2."""
        return np.asarray(seen_at(op, "pair", g[k : k + 1], H)[0])

    pdf = partial(of, op, g.values)
    mass = float(g.values[k] @ op.matrices[2])
    rounding = float(np.max(ROUNDINGS * g.rounding)) + 2.0 * abs(mass - 1.0)

    def pointwise(H1: Array, H2: Array) -> Array:
        p = pdf(H1, H2)
        moved = np.abs(p - of(other_op, other.values, H1, H2)) + np.abs(of(op, g.change, H1, H2))
        return np.asarray(moved + (of_modes(H1, H2) + rounding) * np.abs(p))

    return certified_density(
        (Coordinate("H", 0), Coordinate("H", 1)),
        op.nodes,
        pdf,
        pointwise,
        measured=measured,
        tol=tol,
        added_error=lambda p, *H: pointwise(*H),
    )
