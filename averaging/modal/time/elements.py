"""Two modal energies in time by finite elements, coupled by damping or not, Eqs. (17), (33).

Densities of displacements and momenta follow from their joint density, Eqs. (35), (36).
"""

from collections.abc import Iterable
from dataclasses import replace
from functools import partial

import numpy as np

from averaging.modal.analysis import ModalAnalysis
from averaging.modal.observables import state_density
from averaging.time import EnergyStart, modal_limits, modes_of_observable
from fpk.answer.certificate import Measured
from fpk.answer.density import Density, certify_density
from fpk.answer.dynamics import (
    LARGEST_ERROR,
    Passage,
    Rates,
    Transient,
    require_times,
    transient_of,
)
from fpk.answer.names import Coordinate
from fpk.answer.question import Asked
from fpk.numeric.arrays import ROUNDINGS, Array
from fpk.numeric.errors import NotApplicable
from fpk.solvers.plane.solution import PlaneSolution
from fpk.solvers.plane.stationary import solve_plane
from fpk.solvers.plane.time.operator import PlaneStart
from fpk.solvers.plane.time.passage import PlaneLimit, plane_first_passage, relaxation_rates
from fpk.solvers.plane.time.transient import BOTH_AXES, marginal_at, transient_densities
from fpk.system.modulation import require_constant_noise


def transient(modes: ModalAnalysis, asked: Asked) -> Transient:
    """Return the densities of one or two modal energies, of the sum of two, or of (q, p).

    Raises ``InvalidInput`` for the time 0, ``NotApplicable`` under modulated noise and unless
    exactly two modal energies are to be solved for (``_pair_problem``).
    """
    require_constant_noise(asked.system.modulation)
    start, times, at, tol = asked.start, asked.times, asked.at, asked.tol
    require_times(times, positive=True)
    if {c.kind for c in asked.observable} <= {"q", "p"}:
        return _pair_state_transient(modes, asked)
    rows = modes_of_observable(asked.observable)
    pair, stationary, begins = _pair_problem(modes, rows or range(modes.n), start, tol)
    if rows == pair[::-1]:
        at = at[::-1]
    seen = tuple(sorted(map(pair.index, rows)))
    by_modes = partial(_by_modes, modes, pair, sorted(rows), start)
    answer, _ = transient_densities(
        stationary, begins, seen, times, at, tol=tol, coefficients_error=by_modes
    )
    return answer


def passage(modes: ModalAnalysis, asked: Asked) -> Passage:
    """Return the first passage of limits on one or two modal energies, or on the sum of two.

    Raises ``NotApplicable`` unless exactly two modal energies are to be solved for.
    """
    limit, times, tol = asked.limit, require_times(asked.times), asked.tol
    limits = modal_limits(limit, asked.start)
    pair, stationary, start = _pair_problem(modes, limits or range(modes.n), asked.start, tol)
    first, second = map(limits.get, pair)
    plane, error = PlaneLimit(first, second, None if limits else limit.value), modes.relative_error
    return plane_first_passage(stationary, start, plane, times, tol=tol, coefficients_error=error)


def relaxation(modes: ModalAnalysis, count: int, *, tol: float) -> Rates:
    """Return the ``count`` slowest rates above 0 of two modal energies, relative tolerance ``tol``.

    Raises ``NotApplicable`` unless there are two modes.
    """
    if modes.n != 2:
        raise NotApplicable("relaxation rates by fem are those of two modal energies")
    _, stationary, _ = _pair_problem(modes, range(2), EnergyStart(np.zeros(2)), tol)
    return relaxation_rates(stationary, count, tol=tol, relative=modes.relative_error)


def _pair_problem(
    modes: ModalAnalysis, rows: Iterable[int], start: EnergyStart, tol: float
) -> tuple[list[int], PlaneSolution, PlaneStart]:
    """Return the two modes to solve for, their stationary density and their start.

    They are the modes ``rows`` (0-based), the modes that damping couples to these, and if this
    makes one only, the lowest other mode that is not coupled. The two are ascending.
    ``tol`` is the tolerance of the answer. Raises ``NotApplicable`` if they are not two.
    """
    behind = {m for group in modes.averaged.groups if set(group) & set(rows) for m in group}
    alone = [g[0] for g in modes.averaged.groups if len(g) == 1 and g[0] not in behind]
    pair = sorted([*behind, *alone[: max(0, 2 - len(behind))]])
    if len(pair) != 2:
        raise NotApplicable(f"in time fem solves for two modal energies, not for {len(pair)}")
    of_pair = partial(solve_plane, tol=max(1e-2 * tol, 1e-11))
    stationary = of_pair(modes.process(pair))
    if start.noise is None:
        return pair, stationary, PlaneStart(start.energies[pair])
    louder = replace(modes, modal_noise=start.noise * modes.modal_noise)
    return pair, stationary, PlaneStart(None, of_pair(louder.process(pair)), start.noise)


def _by_modes(
    modes: ModalAnalysis, pair: list[int], rows: list[int], start: EnergyStart, t: float, *H: Array
) -> Array:
    """Return the relative error of p at the time ``t`` from the relative error of the modes.

    ``H`` are energies of the modes ``rows`` of ``pair``, or their sum if ``rows`` is empty; they
    count relative to the mean energies at ``t`` of a start at rest.
    """
    spread = modes.temperature * -np.expm1(-2.0 * modes.half_bandwidth * t)
    each = spread[rows] if rows else [spread[pair].min()]
    reach = 1.0 + sum(np.abs(x) / s for x, s in zip(H, each, strict=True))
    from_start = np.sum(start.energies[pair] / spread[pair])
    return np.asarray(2.0 * modes.relative_error * (reach + from_start))


def _pair_state_transient(modes: ModalAnalysis, asked: Asked) -> Transient:
    """Return the densities of one or two of (q, p) of two modes with independent uniform phases.

    The energies are solved for to half of the tolerance; their error is the difference of two mesh
    levels. At a time that is too short for the operator the errors are infinite and the density is
    not certified.
    """
    times, at, tol = asked.times, asked.at, asked.tol
    pair, stationary, start = _pair_problem(modes, range(modes.n), asked.start, tol)
    answer, ((other_op, other), (op, g)) = transient_densities(
        stationary, start, BOTH_AXES, times, (np.zeros(0), np.zeros(0)), tol=0.5 * tol
    )
    tail = answer.certificate.tail_mass or 0.0
    measured = Measured(start.l1_error + 2.0 * tail, None, None, g.residual, tail)

    def energies(k: int, t: float) -> Density:
        """Return the joint density of both energies at ``t``, the time of index ``k``."""
        mass_defect = abs(float(g.values[k] @ op.matrices[2]) - 1.0)
        rounding = float(np.max(ROUNDINGS * g.rounding)) + 2.0 * mass_defect

        def pdf(*H: Array) -> Array:
            return np.asarray(marginal_at(op, BOTH_AXES, g.values[k : k + 1], H)[0])

        def pointwise(*H: Array) -> Array:
            p = pdf(*H)
            moved = np.abs(p - marginal_at(other_op, BOTH_AXES, other.values[k : k + 1], H)[0])
            moved += np.abs(marginal_at(op, BOTH_AXES, g.change[k : k + 1], H)[0])
            relative = _by_modes(modes, pair, pair, asked.start, t, *H) + rounding
            return np.asarray(moved + relative * np.abs(p))

        return certify_density(
            (Coordinate("H", 0), Coordinate("H", 1)),
            op.nodes,
            pdf,
            pointwise,
            measured=measured,
            tol=tol,
            added_error=lambda p, *H: pointwise(*H),
        )

    densities, points = list[Density](), []
    for k, t in enumerate(times.tolist()):
        group = energies(k, t)
        densities.append(state_density(modes, [group], asked.observable, tol=tol))
        p, error = densities[k].at(*at)
        points.append((p, error if group.l1_error <= LARGEST_ERROR else np.full(p.shape, np.inf)))
    return transient_of(times, densities, points, tol=tol, settings=answer.settings)
