"""The full system (6) towards a limit: steps, score and starts of its paths."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
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
from sim.questions.splitting.kernel import LEVELS, CompiledReplicas, LimitArrays, compiled_paths
from sim.questions.starts import drawn_states
from sim.sample.plan import step_arrays, watched
from sim.step.schemes import SCHEMES
from sim.step.step_size import chosen_step, temperature

ScoreFunction = Callable[[Array, Array], Array]
"""ln P(failure within a time | energy), or any approximation of it: a function of energies (m,)
below the limit, ascending, and times (k,) > 0, ascending, to (k, m)."""

ROWS, COLUMNS = 128, 256
"""Cells of the table over the root of the remaining time and over the share of the limit."""

SHARES = np.maximum(np.arange(COLUMNS), 0.5) / COLUMNS
"""Shares x of the limit at which scores are asked; the first stands for 0."""


def least_action(
    energies: Array, times: Array, *, limit: float, noise: float, decay: float
) -> Array:
    """Return minus the least action by which ``dH = (D' − γ H) dt + √(2 D' H) dB`` fails in time.

    ``(√H_f − √H e^{−γτ/2})² γ/(D' (1 − e^{−γτ}))`` with ``noise`` D' and ``decay`` γ, which may be
    0 or negative: the exponent of the Gaussian transition of an oscillator's amplitude.
    """
    tau = times[:, None]
    grown = tau if decay == 0.0 else -np.expm1(-decay * tau) / decay
    short = np.sqrt(limit) - np.sqrt(energies) * np.exp(-0.5 * decay * tau)
    return np.asarray(-np.square(np.maximum(short, 0.0)) / (noise * grown))


def score_tables(scores: Sequence[ScoreFunction], energies: Sequence[Array], time: float) -> Array:
    """Return levels (coordinates, rows + 1, columns + 1); ``energies`` are those at ``SHARES``.

    x = column/columns is the share of the limit, and (row/rows)² that of the time which is left. A
    score counts from its value at energy 0 with all of ``time`` left; no failure has a larger one
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
    return np.array(tables)


@dataclass(frozen=True, eq=False)
class SystemProblem:
    """Failure of ``system`` at ``limit`` before ``time``; see ``run.repetition``."""

    system: System
    limit: Limit
    start: Start
    time: float
    dt: float
    tables: Array  # of the score

    def replicas(
        self, count: int, steps: int, seed: int, stream: np.random.Generator
    ) -> CompiledReplicas:
        """Return ``count`` paths of ``steps`` steps from their starts, drawn from ``stream``.

        Of |q_i| the score is of E_i = ½ k A² + U_i(q_i), A = Σ_m |T_im| √(2 H_m)/ω_m the largest
        |q_i| of free motion and k the static stiffness at mass i. E_i is not above H, and not below
        its value E_f = ½ k a² + U_i(a) where |q_i| passes a. |q_i| itself would be a poor score:
        the next peak of a path that has set out for it is no longer open.
        """
        system, limit, n = self.system, self.limit, self.system.n
        at, reach, energy, mass = limits.energies_at(system, limit), np.zeros(n), 1.0, 0
        if limit.kind == "q":
            at, energy = np.array([limit.value]), float(np.min(at))
            mass, (shapes, omega) = limit.observable(n)[0].row, natural_modes(system)
            reach = np.abs(shapes[mass]) / omega / np.sqrt(energy * system.compliance[mass, mass])
        scheme = SCHEMES["exact_flow"]
        step = step_arrays(system, scheme, self.time / steps)
        energies = limits.energies_of(limit, n) or [Coordinate("H", m) for m in range(n)]
        key, watch = watched(system, scheme, step, (), (), energies)
        starts = drawn_states(system, self.start, int(stream.integers(2**63)), count)
        numbers = LimitArrays(at, diffusion_of(system, limit), reach, energy, mass)
        model = step, watch, numbers, self.tables, steps
        renew = compiled_paths(key, limit.kind)
        return CompiledReplicas(renew, model, np.hstack(starts), steps, seed)


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
    scores: list[ScoreFunction] = [
        partial(least_action, limit=energy, noise=float(D), decay=float(c))
        for energy, D, c in zip(tops, noise, decay, strict=True)
    ]
    if score is not None:
        if len(scores) > 1:
            raise InvalidInput("score", score, "must be left out where there are several limits")
        scores = [score]
    tables = score_tables(scores, [top * SHARES**2 for top in tops], time)
    reach = limits.reach_of(system, limit, start, time)
    soon = min(reach.limit, reach.start) if start.kind == "state" else reach.limit
    longest = chosen_step(system, energy=reach.energy, kT=reach.kT)
    longest = min(longest, limits.STEP_TO_LIMIT * soon, time / limits.STEPS_SINCE_START)
    if dt is not None and dt > limits.TOO_LONG * longest:
        raise InvalidInput("dt", dt, f"is too long to see a passage; use {longest:.2g}")
    return SystemProblem(system, limit, start, time, dt or longest, tables)
