"""First passage of one energy under modulated noise, by the forward equation that absorbs."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from fpk.arrays import Array
from fpk.errors import NotApplicable
from fpk.evolution import Passage, certified_passage
from fpk.line.time.evolution import fem_passage
from fpk.line.time.mesh import HIGHEST, time_nodes
from fpk.line.time.modes import EPS, Modes
from fpk.line.time.modulated import LEAST_TOL, LEVELS, begins, times_factor
from fpk.line.time.pair import Pair, degree_for, meshed
from fpk.line.time.passage import THINNEST, FirstPassage, first_passage
from fpk.line.time.propagation import Solution, Source, points
from fpk.line.time.stepping import STAGES, matrices, radau, shares_of, start_of, steps_of
from fpk.line.time.transition import (
    LAYER,
    ROUND_OFF,
    SAFETY,
    Question,
    Solutions,
    adapted,
    width_of,
)
from fpk.modulation import Modulation
from fpk.number import SMALLEST, Number
from fpk.process import Process

NEVER = Number(np.inf, np.inf)
"""Moments of a time that is infinite for some."""
SHARE = 0.1
"""Share of the tolerance for the mesh, and for the steps: variances have more error than p."""
Under = Callable[[float], Process]


@dataclass(frozen=True, eq=False)
class Absorbed:
    """Motion until the limit from ``source``, on any mesh that ends there, to the ``stops``.

    ``later`` is first passage under the noise of the end, from the ``end`` of the modulation on.
    """

    process: Process
    source: Source
    modulation: Modulation
    unit: float
    stops: Array
    end: float
    later: FirstPassage | None

    def solved(self, e: Modes, level: int) -> tuple[Solution, Array, Array]:
        """Return p at the stops, P(T > t) there, and E T and E T² with their errors by ``later``.

        These are ∫P(T > t) dt and ∫2t P(T > t) dt up to the end, by the weights of the stages, and
        the moments of the time that is left, E(t_e + τ)², over the density of then.
        """
        m = matrices(self.process, e, absorbing=True)
        shares, (A, c) = shares_of(m, e), radau(STAGES)
        load = start_of(m, e, self.source)
        ends, g, kept, residual = [], [], [], 0.0
        moments, now = np.zeros(2), 0.0
        for s in steps_of(m, load, self.modulation, self.unit, self.stops, level=level):
            S = s.stages @ shares
            if s.end <= self.end:
                moments += s.length * (
                    A[-1] * S @ np.stack([np.ones(STAGES), 2.0 * (now + c * s.length)], 1)
                )
            now, residual = s.end, max(residual, s.residual)
            if s.end in self.stops:
                ends.append(s.end)
                g.append(s.stages[-1])
                kept.append(float(S[-1]))
        solution = Solution(self.process, e, partial(times_factor, e, m, np.array(g)), residual)
        lost = np.zeros(2)
        if self.later is not None:
            x, w = (a.ravel() for a in points(self.process, e))
            p = solution.density(x)[0][ends.index(self.end)] * w
            (T, T_error), (U, U_error) = self.later.mean(x), self.later.second(x)
            square = 2.0 * self.later.longest**2
            moments += [p @ T, 2.0 * self.end * (p @ T) + square * (p @ U)]
            first = np.abs(p) @ T_error
            lost += [first, 2.0 * self.end * first + square * (np.abs(p) @ U_error)]
        return solution, np.append(kept, moments), lost


def modulated_passage(
    under: Under, modulation: Modulation, limit: float, source: Source, times: Array, *, tol: float
) -> Passage:
    """Return the first passage of ``limit``; ``under(F)`` is the process under F times the noise.

    P(T > t) is the mass that the forward equation with p = 0 at the limit keeps; mean, variance
    and failure rate are those of the noise that the modulation ends with. Where it ends with 0 who
    lives then never fails: moments are infinite, and there is no failure rate. Errors as of
    ``modulated_transition``, in probabilities and in the moments. Raises ``NotApplicable`` where
    damping feeds energy in at the limit while there is no noise, and as ``first_passage`` does.
    """
    tol = max(tol, LEAST_TOL)
    unit, last, quiet = modulation.largest, modulation.last, begins(modulation, source)
    if unit == 0.0:
        raise NotApplicable("there is no noise at any time: nothing passes a limit")
    if modulation.times.size == 1:
        return fem_passage(under(last), limit, source, times, tol=tol)
    process = under(unit)
    at_limit = process.coefficients(np.array([limit]))
    if float(modulation.factor.min()) == 0.0 and at_limit.dissipation[0] > 0.0:
        raise NotApplicable(
            "damping feeds energy in at the limit: while there is no noise, no mesh sees it"
        )
    modulation = modulation.after(quiet)
    end = float(modulation.times[-1])
    asked = np.maximum(times - quiet, 0.0)
    asked = asked if last else np.minimum(asked, end)
    stops = np.unique(np.append(asked, end))
    stops = stops[stops > 0.0]
    later = first_passage(under(last), limit, times=np.zeros(0), tol=0.01 * tol) if last else None
    motion = Absorbed(process, source, modulation, unit, stops, end, later)
    first = float(modulation.energy(stops[0])) / unit
    question, pair = _posed(process, source, limit, first, SHARE * tol)

    def carried_pair(pair: Pair) -> Solutions:
        return motion.solved(pair[0], LEVELS[0])[0], motion.solved(pair[1], LEVELS[0])[0]

    _, pair = adapted(question, pair, carried_pair)
    (_, own, _), (_, enriched, _) = (motion.solved(e, LEVELS[0]) for e in pair)
    finer = own
    for level in range(LEVELS[0] + 1, LEVELS[1] + 1):
        coarse = finer
        solution, finer, lost = motion.solved(pair[0], level)
        moved = np.abs(finer - coarse)
        if SAFETY * np.max(moved / np.maximum(finer, 1.0)) <= SHARE * tol:
            break
    e = pair[0]
    error = SAFETY * (np.abs(own - enriched) + moved)
    failure = 1.0 - finer[: stops.size]
    # At short times ln P ~ −(distance)²/(2 b t): so much more the coefficients count.
    relative = 2.0 * e.coefficient_error(source.energy) + ROUND_OFF * EPS * (
        e.count + float(np.ptp(e.log_scale))
    )
    steep = 2.0 - np.log(np.clip(np.abs(failure), SMALLEST, 1.0))
    lost_failure = error[: stops.size] + relative * steep * np.abs(failure) + ROUND_OFF * EPS
    mean, square = finer[stops.size :]
    mean_error, square_error = error[stops.size :] + lost + 2.0 * relative * finer[stops.size :]
    numbers: tuple[Number, Number, Number | None] = (NEVER, NEVER, None)
    if later is not None:
        # From the start of the noise on.
        variance = square - mean**2
        numbers = (
            Number(float(mean) + quiet, float(mean_error)),
            Number(float(variance), float(square_error + 2.0 * mean * mean_error)),
            Number(*later.rate()),
        )
    begun = 1.0 - float(source.load(e)[0].sum()) if source.process is not None else 0.0
    at = np.searchsorted(stops, asked)
    before = asked == 0.0
    return certified_passage(
        numbers,
        times,
        np.where(before, begun, failure[np.minimum(at, stops.size - 1)]),
        np.where(before, tol * (begun > 0.0), lost_failure[np.minimum(at, stops.size - 1)]),
        tol=tol,
        residual=solution.residual,
        settings={
            "equation": f"modulated noise, Radau IIA of order {2 * STAGES - 1}",
            "elements": e.count,
            "halvings of the steps": level,
            "tol": tol,
        },
    )


def _posed(
    process: Process, source: Source, limit: float, time: float, tol: float
) -> tuple[Question, Pair]:
    """The density of those that have not failed, ``time`` the first one, and its meshes."""
    b = float(process.coefficients(np.array([limit])).diffusion[0])
    fine = [(limit, max(LAYER * np.sqrt(b * time), THINNEST * limit))]
    width = process.energy_scale
    if source.process is None:
        width = width_of(process, source.energy, time)
        fine.append((source.energy, LAYER * width))
    degree = degree_for(tol)
    nodes = time_nodes(process, limit, degree, fine=tuple(fine), more=source.nodes(limit, HIGHEST))
    return Question(process, source, width, tol), meshed(process, nodes, degree)
