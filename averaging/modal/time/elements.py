"""Two modal energies in time, coupled by damping or not, by finite elements, Eqs. (17), (33).

Displacements and momenta follow from their joint density, Eqs. (35), (36).
"""

from collections.abc import Sequence
from dataclasses import replace

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
from fpk.solvers.plane.stationary import solve_plane
from fpk.solvers.plane.time.levels import Frame, PlaneStart
from fpk.solvers.plane.time.passage import PlaneLimit, first_passage, relaxation_rates
from fpk.solvers.plane.time.transient import Level, Seen, seen_on, transient_densities


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

    def by_modes(t: float, *H: Array) -> Array:
        spread = _spread(modes, pair, t)
        each = spread[which] if rows else [spread.min()]
        reach = sum(np.abs(x) / s for x, s in zip(H, each, strict=True))
        begins = np.sum(start.energies[pair] / spread)
        return np.asarray(2.0 * modes.relative_error * (1.0 + reach + begins))

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
    frame = _frame(modes, _pair(modes, range(2)), tol)
    return relaxation_rates(frame, count, tol=tol, relative=modes.relative_error)


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


def _spread(modes: ModalAnalysis, pair: list[int], t: float) -> Array:
    """Mean energies (2,) that the noise has fed into two modes from rest by the time ``t``."""
    decay = 2.0 * modes.half_bandwidth[pair]
    return np.asarray(modes.temperature[pair] * -np.expm1(-decay * t))


def _posed(
    modes: ModalAnalysis, pair: list[int], start: EnergyStart, tol: float
) -> tuple[Frame, PlaneStart]:
    """The operator's frame, and what the density begins with."""
    frame = _frame(modes, pair, tol)
    if start.noise is None:
        return frame, PlaneStart(start.energies[pair])
    louder = replace(modes, modal_noise=start.noise * modes.modal_noise)
    return frame, PlaneStart(None, _frame(louder, pair, tol).stationary, start.noise)


def _frame(modes: ModalAnalysis, pair: list[int], tol: float) -> Frame:
    """The stationary density is computed to a hundredth of the tolerance, or to 1e-11."""
    process = modes.process(pair)
    return Frame(process, solve_plane(process, tol=max(1e-2 * tol, 1e-11)))


def _state_transient(modes: ModalAnalysis, asked: Asked) -> Transient:
    """Return the densities of one or two of (q, p) of two modes.

    The phases are independent and uniform, whatever the energies, which are solved for to half of
    the tolerance. The certificate is that of the worst time; a time too short for the operator is
    not certified, its errors infinite.
    """
    times, at, tol, pair = asked.times, asked.at, asked.tol, _pair(modes, range(modes.n))
    frame, start = _posed(modes, pair, asked.start, tol)
    none = np.zeros(0), np.zeros(0)
    answer, levels = transient_densities(frame, start, "pair", times, none, tol=0.5 * tol)
    tail = outside(answer.certificate)
    measured = Measured(start.l1_error + 2.0 * tail, None, None, levels[1].evolved.residual, tail)
    values, errors = np.empty((2, times.size, at[0].size))
    densities = []
    for k, t in enumerate(times.tolist()):
        spread = _spread(modes, pair, t)
        group = _energies(levels, k, modes.relative_error, spread, measured, tol)
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
    relative: float,
    spread: Array,
    measured: Measured,
    tol: float,
) -> Density:
    """The joint density of both energies at the time ``k``, its error the distance of two levels.

    ``relative`` is the error of the modes, in units of the energies' ``spread``.
    """
    coarse, fine = levels

    def of(level: Level, g: Array, H1: Array, H2: Array) -> Array:
        """The density with the coefficients ``g``, (energies, energies): H1 a column, H2 a row."""
        grid = seen_on(level.op, "pair", g[k : k + 1], (H1.ravel(), H2.ravel()))
        return np.asarray(grid[0])

    def pdf(H1: Array, H2: Array) -> Array:
        return of(fine, fine.g, H1, H2)

    mass = float(fine.evolved.values[k] @ fine.op.matrices[2])
    rounding = float(np.max(ROUNDINGS * fine.evolved.rounding)) + 2.0 * abs(mass - 1.0)

    def pointwise(H1: Array, H2: Array) -> Array:
        p = pdf(H1, H2)
        moved = np.abs(p - of(coarse, coarse.g, H1, H2)) + np.abs(of(fine, fine.change, H1, H2))
        of_modes = 2.0 * relative * (1.0 + H1 / spread[0] + H2 / spread[1])
        return np.asarray(moved + (of_modes + rounding) * np.abs(p))

    return certified_density(
        (Coordinate("H", 0), Coordinate("H", 1)),
        fine.op.nodes,
        pdf,
        pointwise,
        measured=measured,
        tol=tol,
        added_error=lambda p, *H: pointwise(*H),
    )
