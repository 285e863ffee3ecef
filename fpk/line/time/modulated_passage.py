"""First passage of one energy under modulated noise, by the forward equation that absorbs."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from fpk.arrays import EPS, SMALLEST, Array
from fpk.errors import NotApplicable
from fpk.evolution import Passage, certified_passage
from fpk.line.time.elements import Elements, Pair, degree_for, meshed
from fpk.line.time.evolution import fem_passage
from fpk.line.time.mesh import HIGHEST, time_nodes
from fpk.line.time.modulated import LEVELS, begins, halved, settings_of
from fpk.line.time.passage import THINNEST, FirstPassage, first_passage
from fpk.line.time.propagation import Solution, Source
from fpk.line.time.resolvent import Evolved
from fpk.line.time.stepping import STAGES, matrices, radau, steps_of
from fpk.line.time.transition import (
    LAYER,
    ROUND_OFF,
    SAFETY,
    Question,
    Settings,
    adapted,
    width_of,
)
from fpk.modulation import Modulation
from fpk.number import Number
from fpk.process import Process

NEVER = Number(np.inf, np.inf)
"""Moments of a time that is infinite for some."""
SHARE = 0.1
"""Share of the tolerance for the mesh, and for the steps: variances have more error than p."""
Under = Callable[[float], Process]


@dataclass(frozen=True, eq=False)
class Absorbed:
    """Motion until the limit from ``source``, on any mesh that ends there, to the ``stops``.

    The first of these is 0. ``later`` is first passage under the noise of the end, from the ``end``
    of the modulation on; None where there is none then.
    """

    process: Process
    source: Source
    modulation: Modulation
    unit: float
    stops: Array
    end: float
    later: FirstPassage | None

    def solved(self, e: Elements, level: int) -> tuple[Solution, Array, Array]:
        """Return p at the stops > 0; P(T > t) at all stops, E T and E T²; errors by ``later``.

        The moments are ∫P(T > t) dt and ∫2t P(T > t) dt up to the end, by the weights of the
        stages, and those of the time that is left, E(t_e + τ)², over the density of then; the
        errors are of the two moments.
        """
        m, begun = matrices(e, absorbing=True), self.source.load(e)
        unit = e.log_scale[:, None]
        load, shares, (A, c) = m.assembled(begun), m.assembled(e.load, unit), radau(STAGES)
        ends, g, kept, residuals = [], [], [float(begun[:, :2].sum())], []
        moments, now = np.zeros(2), 0.0
        for s in steps_of(m, load, self.modulation, self.unit, self.stops[1:], level=level):
            S = s.stages @ shares
            if s.end <= self.end:
                moments += s.length * (
                    A[-1] * S @ np.stack([np.ones(STAGES), 2.0 * (now + c * s.length)], 1)
                )
            now = s.end
            residuals.append(s.residual)
            if s.end in self.stops:
                ends.append(s.end)
                g.append(s.stages[-1])
                kept.append(float(S[-1]))
        f = m.coefficients(np.array(g), unit)
        solution = Solution(self.process, e, Evolved(f, np.abs(f), float(np.max(residuals))))
        lost = np.zeros(2)
        if self.later is not None:
            x, w = e.x.ravel(), e.weight.ravel()
            p = solution.density(x)[0][ends.index(self.end)] * w
            (T, T_error), (U, U_error) = self.later.mean(x), self.later.second(x)
            square = 2.0 * self.later.longest**2
            moments += [p @ T, 2.0 * self.end * (p @ T) + square * (p @ U)]
            first = np.abs(p) @ T_error
            lost += [first, 2.0 * self.end * first + square * (np.abs(p) @ U_error)]
        return solution, np.append(kept, moments), lost


class Converged(NamedTuple):
    """P(T <= t) at the stops, E T and E T² of a motion, with an error each."""

    failure: Array
    failure_error: Array
    moments: Array
    moments_error: Array
    residual: float
    settings: Settings


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
    stops = np.unique([0.0, *asked, end])
    later = first_passage(under(last), limit, times=np.zeros(0), tol=0.01 * tol) if last else None
    motion = Absorbed(process, source, modulation, unit, stops, end, later)
    solved = _converged(motion, limit, tol)
    numbers: tuple[Number, Number, Number | None] = (NEVER, NEVER, None)
    if later is not None:
        (mean, square), (mean_error, square_error) = solved.moments, solved.moments_error
        variance_error = float(square_error + 2.0 * mean * mean_error)
        numbers = (
            Number(float(mean) + quiet, float(mean_error)),
            Number(float(square - mean**2), variance_error),
            Number(*later.rate()),
        )
    at = np.searchsorted(stops, asked)
    return certified_passage(
        numbers,
        times,
        solved.failure[at],
        solved.failure_error[at],
        tol=tol,
        residual=solved.residual,
        settings=solved.settings,
    )


def _converged(motion: Absorbed, limit: float, tol: float) -> Converged:
    """The motion on elements that adapt, in steps that are halved until it changes no more."""
    first = float(motion.modulation.energy(motion.stops[1])) / motion.unit
    question, pair = _posed(motion.process, motion.source, limit, first, SHARE * tol)
    solve = lru_cache(maxsize=len(pair))(motion.solved)

    e, finer = adapted(question, pair, lambda e, **_: solve(e, LEVELS[0])[0]).pair
    off = np.abs(solve(e, LEVELS[0])[1] - solve(finer, LEVELS[0])[1])

    def size(moved: Array, numbers: Array) -> float:
        return float(np.max(moved / np.maximum(numbers, 1.0)))

    level, numbers, moved, sizes = halved(lambda k: solve(e, k)[1], size, SHARE * tol)
    solution, _, lost = solve(e, level)
    error, stops = SAFETY * (off + moved), motion.stops.size
    failure, moments = 1.0 - numbers[:stops], numbers[stops:]
    # At short times ln P ~ −(distance)²/(2 b t): so much more the coefficients count.
    relative = 2.0 * e.coefficient_error(motion.source.energy) + ROUND_OFF * EPS * (
        e.count + float(np.ptp(e.log_scale))
    )
    steep = 2.0 - np.log(np.clip(np.abs(failure), SMALLEST, 1.0))
    return Converged(
        failure,
        error[:stops] + relative * steep * np.abs(failure) + ROUND_OFF * EPS,
        moments,
        error[stops:] + lost + 2.0 * relative * moments,
        solution.g.residual,
        settings_of(e, level, sizes, tol),
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
