"""Two modal energies in time, coupled by damping or not, by finite elements, Eqs. (17), (33).

Displacements and momenta follow from their joint density, Eqs. (35), (36).
"""

from collections.abc import Sequence
from typing import Literal

import numpy as np

from averaging.modal.analysis import ModalAnalysis
from averaging.modal.characteristic import state_density
from averaging.modal.observables import unsolved
from averaging.time.start import DensityQuestion, EnergyStart, limited_modes, observed_modes
from fpk.arrays import SMALLEST, Array
from fpk.certificate import Measured, outside
from fpk.density import Density, certified_density
from fpk.dynamics import Rates
from fpk.errors import NotApplicable
from fpk.evolution import UNRESOLVED, Passage, Transient, checked_times
from fpk.limit import Limit
from fpk.observable import Coordinate
from fpk.plane.stationary import solve_plane
from fpk.plane.time.levels import Frame
from fpk.plane.time.passage import PlaneLimit, first_passage
from fpk.plane.time.relaxation import relaxation_rates
from fpk.plane.time.transient import ROUNDING, Level, transient_densities
from fpk.plane.time.view import DensityStart, PointStart, Start, View
from fpk.process import Coefficients, Process

STATIONARY_TOL = (1e-2, 1e-11)
"""Share of the tolerance to which the stationary density is computed, and the least such."""
Axis = Literal["first", "second"]
AXES: tuple[Axis, Axis] = ("first", "second")
SHARE = 0.5
"""Share of the tolerance to which the energies are resolved."""


def transient(modes: ModalAnalysis, asked: DensityQuestion) -> Transient:
    """Return the densities of one or two modal energies, of the sum of two, or of (q, p)."""
    observable, start, times = asked.observable, asked.start, asked.times
    at, tol = asked.at, asked.tol
    checked_times(times, positive=True)
    if {c.kind for c in observable} <= {"q", "p"}:
        posed = _posed(modes, _pair(modes, range(modes.n)), start, tol)
        return state_transient(modes, *posed, asked)
    rows = observed_modes(observable)
    pair = _pair(modes, rows or range(modes.n))
    if rows == pair[::-1]:
        at = at[::-1]
    one = AXES[pair.index(rows[0])] if rows else "sum"
    view = View("pair" if len(rows) == 2 else one)
    theta, decay = modes.temperature[pair], 2.0 * modes.half_bandwidth[pair]
    seen = [pair.index(r) for r in sorted(rows)]

    def by_modes(t: float, *H: Array) -> Array:
        spread = theta * -np.expm1(-decay * t)
        each = spread[seen] if rows else [spread.min()]
        reach = sum(np.abs(x) / s for x, s in zip(H, each, strict=True))
        begins = np.sum(start.energies[pair] / spread)
        return np.asarray(2.0 * modes.relative_error * (1.0 + reach + begins))

    frame, first = _posed(modes, pair, start, tol)
    answer, _ = transient_densities(
        frame, first, view, times, at, tol=tol, coefficients_error=by_modes
    )
    return answer


def passage(
    modes: ModalAnalysis, limit: Limit, start: EnergyStart, times: Array, *, tol: float
) -> Passage:
    """Return the first passage of one or two modal energies, or of the sum of two."""
    checked_times(times)
    limits = limited_modes(limit, start)
    pair = _pair(modes, list(limits) or range(modes.n))
    first, second = (limits.get(m) for m in pair)
    plane = PlaneLimit(first, second, None if limits else limit.value)
    frame, begins = _posed(modes, pair, start, tol)
    return first_passage(
        frame, begins, plane, times, tol=tol, coefficients_error=modes.relative_error
    )


def relaxation(modes: ModalAnalysis, count: int, *, tol: float) -> Rates:
    """Return the ``count`` slowest rates but 0 of two modal energies."""
    if modes.n != 2:
        raise NotApplicable("relaxation rates by fem are those of two modal energies")
    frame = _frame(modes.process(_pair(modes, range(2))), tol)
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


def _posed(
    modes: ModalAnalysis, pair: list[int], start: EnergyStart, tol: float
) -> tuple[Frame, Start]:
    """The operator's frame, and what the density begins with."""
    process = modes.process(pair)
    frame = _frame(process, tol)
    if start.noise is None:
        return frame, PointStart(start.energies[pair])
    factor, quiet = start.noise, modes.noise[pair]

    def louder(energies: Array) -> Coefficients:
        c = process.coefficients(energies)
        more = (factor - 1.0) * quiet
        return c._replace(
            drift=c.drift + more, diffusion=factor * c.diffusion, divergence=factor * c.divergence
        )

    other = Process(louder, tuple(factor * s for s in process.energy_scales))
    return frame, DensityStart(_frame(other, tol).stationary, factor)


def _frame(process: Process, tol: float) -> Frame:
    share, least = STATIONARY_TOL
    return Frame(process, solve_plane(process, tol=max(share * tol, least)))


def state_transient(
    modes: ModalAnalysis, frame: Frame, start: Start, asked: DensityQuestion
) -> Transient:
    """Return the densities of one or two of (q, p) of two modes.

    The phases are independent and uniform, whatever the energies. The certificate is that of the
    worst time; a time too short for the operator is not certified, its errors infinite.
    """
    times, at, tol = asked.times, asked.at, asked.tol
    none = np.zeros(0), np.zeros(0)
    answer, levels = transient_densities(frame, start, View("pair"), times, none, tol=SHARE * tol)
    tail = outside(answer.certificate)
    values, errors = np.empty((2, times.size, at[0].size))
    densities = []
    for k, t in enumerate(times.tolist()):
        group = _energies(modes, levels, k, t, l1_error=start.l1_error, tail=tail, tol=tol)
        densities.append(state_density(modes, [group], asked.observable, tol=tol))
        values[k], errors[k] = densities[k].at(*at)
        errors[k] = errors[k] if group.l1_error <= UNRESOLVED else np.inf
    worst = max(densities, key=lambda d: (not d.certificate.certified, d.l1_error))
    return Transient(
        times, values, errors + SMALLEST, "numerical", worst.certificate, answer.settings
    )


def _energies(
    modes: ModalAnalysis,
    levels: tuple[Level, Level],
    k: int,
    t: float,
    *,
    l1_error: float,
    tail: float,
    tol: float,
) -> Density:
    """The joint density of both energies at the time ``t``, its error the distance of two levels.

    ``l1_error`` is that of the start, ``tail`` bounds the mass beyond the mesh.
    """
    coarse, fine = levels
    theta = modes.temperature * -np.expm1(-2.0 * modes.half_bandwidth * t)

    def of(level: Level, g: Array, H1: Array, H2: Array) -> Array:
        """The density with the coefficients ``g``, (energies, energies): H1 a column, H2 a row."""
        grid = View("pair").on_grid(level.op, g[k : k + 1], (H1.ravel(), H2.ravel()))
        return np.asarray(grid[0])

    def pdf(H1: Array, H2: Array) -> Array:
        return of(fine, fine.g, H1, H2)

    mass = float(fine.evolved.values[k] @ fine.op.matrices.shares)
    rounding = float(np.max(ROUNDING * fine.evolved.rounding)) + 2.0 * abs(mass - 1.0)

    def pointwise(H1: Array, H2: Array) -> Array:
        p = pdf(H1, H2)
        moved = np.abs(p - of(coarse, coarse.g, H1, H2)) + np.abs(of(fine, fine.change, H1, H2))
        of_modes = 2.0 * modes.relative_error * (1.0 + H1 / theta[0] + H2 / theta[1])
        return np.asarray(moved + (of_modes + rounding) * np.abs(p))

    return certified_density(
        (Coordinate("H", 0), Coordinate("H", 1)),
        fine.op.nodes,
        pdf,
        pointwise,
        measured=Measured(l1_error + 2.0 * tail, None, None, fine.evolved.residual, tail),
        tol=tol,
        added_error=lambda p, *H: pointwise(*H),
    )
