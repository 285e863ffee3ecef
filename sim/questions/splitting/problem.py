"""The full system (6) towards a limit: steps, score and starts of its paths."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import isfinite

import numpy as np

from fpk.answer.limit import Limit
from fpk.answer.observable import Coordinate
from fpk.answer.start import Start
from fpk.numeric.arrays import Array
from fpk.numeric.errors import InvalidInput, NotApplicable
from fpk.system.linear import natural_modes
from fpk.system.system import System
from sim.questions import limits
from sim.questions.passing import diffusion_of
from sim.questions.rounds import drawn_states
from sim.questions.splitting.kernel import (
    LEVELS,
    CompiledReplicas,
    LimitArrays,
    Score,
    compiled_paths,
)
from sim.sample.plan import step_arrays, watched
from sim.step.schemes import EXACT_FLOW
from sim.step.step_size import chosen_step, temperature

ScoreFunction = Callable[[Array, Array], Array]
"""ln P(failure within a time | energy), or any approximation of it: a function of energies (m,)
below the limit, ascending, and times (k,) > 0, ascending, to (k, m)."""

ROWS, COLUMNS = 128, 256
"""Cells of the table over the root of the remaining time and over the share of the limit."""


SHARES = np.maximum(np.arange(COLUMNS), 0.5) / COLUMNS
"""Shares x of the limit at which scores are asked; the first stands for 0."""


def cost_score(limit: float, *, noise: float, decay: float) -> ScoreFunction:
    """Return minus the least action by which ``dH = (D' − γ H) dt + √(2 D' H) dB`` fails in time.

    ``(√H_f − √H e^{−γτ/2})² γ/(D' (1 − e^{−γτ}))`` with ``noise`` D' and ``decay`` γ, which may be
    0 or negative: the exponent of the Gaussian transition of an oscillator's amplitude.
    """

    def score(energies: Array, times: Array) -> Array:
        tau = times[:, None]
        grown = tau if decay == 0.0 else -np.expm1(-decay * tau) / decay
        short = np.sqrt(limit) - np.sqrt(energies) * np.exp(-0.5 * decay * tau)
        return np.asarray(-np.square(np.maximum(short, 0.0)) / (noise * grown))

    return score


def score_table(
    scores: Sequence[ScoreFunction], energies: Sequence[Array], *, time: float, steps: int
) -> Score:
    """Return the levels of one score a coordinate; ``energies`` are what it takes at ``SHARES``.

    A score counts from its value at energy 0 with all of ``time`` left; no failure has a larger one
    than energies just below it.
    """
    left, tables = time * (np.arange(1, ROWS + 1) / ROWS) ** 2, []
    for score, energy in zip(scores, energies, strict=True):
        table = np.zeros((ROWS + 1, COLUMNS + 1))
        table[:, -1] = LEVELS
        values = score(energy, left)
        lowest = values[-1, 0]
        if np.isfinite(lowest) and lowest < 0.0:
            share = np.where(np.isnan(values), 0.0, 1.0 - values / lowest)
            ascending = np.maximum.accumulate(np.clip(share, 0.0, 1.0), axis=1)
            table[1:, :-1] = LEVELS * np.maximum.accumulate(ascending, axis=0)
        else:  # the score cannot tell: x alone does
            table[:, :-1] = LEVELS * np.arange(COLUMNS) / COLUMNS
        tables.append(table)
    return Score(np.array(tables), steps)


@dataclass(frozen=True, eq=False)
class SystemProblem:
    """Failure of ``system`` at ``limit`` before ``time``; see ``run.repetition``."""

    system: System
    limit: Limit
    start: Start
    time: float
    dt: float
    score: Score

    def replicas(
        self, count: int, steps: int, seed: int, stream: np.random.Generator
    ) -> CompiledReplicas:
        """Return ``count`` paths of ``steps`` steps from their starts, drawn from ``stream``."""
        n, step = self.system.n, step_arrays(self.system, EXACT_FLOW, self.time / steps)
        energies = limits.energies_of(self.limit, n) or [Coordinate("H", m) for m in range(n)]
        key, watch = watched(self.system, EXACT_FLOW, step, (), (), energies)
        starts = drawn_states(self.system, self.start, int(stream.integers(2**63)), count)
        score = self.score._replace(steps=steps)
        model = step, watch, limit_arrays(self.system, self.limit), score
        renew = compiled_paths(key, self.limit.kind)
        return CompiledReplicas(renew, model, np.hstack(starts), steps, seed)


def limit_arrays(system: System, limit: Limit) -> LimitArrays:
    """Return the numbers of the quantity that ``limit`` is on.

    Of |q_i| these are, for the score, of E_i = ½ k A² + U_i(q_i), A = Σ_m |T_im| √(2 H_m)/ω_m the
    largest |q_i| of free motion and k the static stiffness at mass i. E_i is not above H, and not
    below its value E_f = ½ k a² + U_i(a) where |q_i| passes a. |q_i| itself would be a poor score:
    the next peak of a path that has set out for it is no longer open.
    """
    at, diffusion = limits.energies_at(system, limit), diffusion_of(system, limit)
    if limit.kind != "q":
        return LimitArrays(at, diffusion, np.zeros(system.n), 1.0, 0)
    mass, energy = limit.observable(system.n)[0].row, float(np.min(at))
    shapes, omega = natural_modes(system)
    reach = np.abs(shapes[mass]) / omega / np.sqrt(energy * system.compliance[mass, mass])
    return LimitArrays(np.array([limit.value]), diffusion, reach, energy, mass)


def system_problem(
    system: System,
    limit: Limit,
    start: Start,
    time: float,
    *,
    dt: float | None,
    score: ScoreFunction | None,
) -> SystemProblem:
    """Return the problem with its step, chosen as in a plain simulation, and its score.

    Steps are as many as ``STEPS_SINCE_START`` in the time at the least.
    Raises ``InvalidInput`` for a start at or beyond the limit or a ``dt`` that is ``TOO_LONG``,
    ``NotApplicable`` without noise.
    """
    if not np.any(system.noise_matrix):
        raise NotApplicable("no noise reaches a mass: whether the limit is passed is no chance")
    # A share of a random start may have failed at once.
    states = () if start.kind == "noise" else drawn_states(system, start, 0, 64)
    if states and np.all(limits.beyond(system, limit, *states)):
        raise InvalidInput("start", str(start), f"must lie below the limit {limit}")
    # By default the score of least action of each coordinate.
    tops = limits.energies_at(system, limit)
    if limit.kind == "modal":
        noise, decay = (
            limits.modal_rates(system, limit, x) for x in (system.noise_matrix, system.damping)
        )
    else:
        tops, kT = np.min(tops, keepdims=True), temperature(system)
        noise = np.mean(np.diag(system.noise_matrix) / system.mass, keepdims=True)
        decay = noise / kT if isfinite(kT) else np.zeros(1)
    scores = [
        cost_score(energy, noise=float(D), decay=float(c))
        for energy, D, c in zip(tops, noise, decay, strict=True)
    ]
    if score is not None:
        if len(scores) > 1:
            raise InvalidInput("score", score, "must be left out where there are several limits")
        scores = [score]
    table = score_table(scores, [top * SHARES**2 for top in tops], time=time, steps=1)
    reach = limits.reach_of(system, limit, start, time)
    soon = min(reach.limit, reach.start) if start.kind == "state" else reach.limit
    longest = chosen_step(system, energy=reach.energy, kT=reach.kT)
    longest = min(longest, limits.STEP_TO_LIMIT * soon, time / limits.STEPS_SINCE_START)
    if dt is not None and dt > limits.TOO_LONG * longest:
        raise InvalidInput("dt", dt, f"is too long to see a passage; use {longest:.2g}")
    return SystemProblem(system, limit, start, time, dt or longest, table)
