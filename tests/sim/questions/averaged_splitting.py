"""Splitting of one averaged energy towards a limit, Eqs. (9), (17), whose exact answer is known.

Exact steps of its square-root form; tests judge the algorithm of ``sim.questions.splitting`` by it.
"""

from dataclasses import dataclass
from math import log, sqrt
from typing import Any

import numpy as np

from fpk.answer.method import silent
from fpk.numeric.arrays import Array, Integers
from fpk.numeric.compiling import ROOT, cached_njit, checksum, njit_inline
from fpk.numeric.errors import InvalidInput, NotApplicable
from fpk.system.process import Process
from sim.questions.averaged.square_root import SquareRootForm, line_form
from sim.questions.splitting.kernel import (
    SCORE_LEVELS,
    CompiledReplicas,
    Paths,
    ScoreFunction,
    least_action,
    level_of,
    restart_from,
    score_tables,
    uniform,
    write_record,
)
from sim.questions.splitting.run import RareFailure, Splitting, sample_failure
from sim.step.kernel import kernel_checksum, once
from sim.step.random import GOLDEN, fill_normals, word_place

CELLS = 4096
"""Cells of the table of the damping over R = √X up to the limit."""

STEPS = 16
"""Least number of steps in the time and in 1/γ: the bridge has no damping between its ends."""

WHOLE = 1e-9
"""Distance from a whole number up to which the degrees of freedom 4 d/β count as one."""


@dataclass(frozen=True, eq=False)
class EnergyProblem:
    """Failure at the energy ``limit`` before ``time`` from ``start``; see ``run.repetition``.

    ``numbers`` are d, β, γ₀; ``table`` is γ − γ₀ over R = √X up to ``top``, that of the limit;
    ``first`` is X of the start.
    """

    numbers: tuple[float, float, float]
    table: Array
    first: float
    top: float
    time: float
    dt: float
    tables: Array

    def replicas(
        self, count: int, steps: int, seed: int, stream: np.random.Generator
    ) -> CompiledReplicas:
        """Return ``count`` paths of ``steps`` steps from their starts."""
        (d, beta, gamma), h = self.numbers, self.time / steps
        # X(h) = k χ'² with (1 − e^{−γh})/γ, also for γ = 0, in k.
        k = 0.25 * beta * (h if gamma == 0.0 else -float(np.expm1(-gamma * h)) / gamma)
        pairs = round(2.0 * d / beta)
        model = (
            (h, k, float(np.exp(-gamma * h)), 0.25 * beta * h, self.top),
            pairs, self.table, self.tables[0], steps,
        )  # fmt: skip
        states = np.full((count, 1), self.first)
        return CompiledReplicas(compiled_energies(), model, states, steps, seed)


def rare_failure_of_process(
    process: Process | SquareRootForm,
    limit: float,
    time: float,
    *,
    start: float = 0.0,
    score: ScoreFunction | None = None,
    settings: Splitting | None = None,
) -> RareFailure:
    """Return P(T <= ``time``) of an averaged equation of one energy, from the energy ``start``.

    As ``sim.questions.splitting.rare_failure``; the ``score`` is of energies. A ``Process`` is
    brought to the form by ``line_form``, whose tables are good to 1e-7.
    """
    own = settings or Splitting()
    form = line_form(process) if isinstance(process, Process) else process
    problem = energy_problem(form, limit, start, time, dt=own.dt, score=score)
    return sample_failure(problem, own, silent)


def energy_problem(
    form: SquareRootForm,
    limit: float,
    start: float,
    time: float,
    *,
    dt: float | None,
    score: ScoreFunction | None,
) -> EnergyProblem:
    """Return the problem of the energy ``form`` from ``start`` to ``limit``.

    Raises ``NotApplicable`` for several energies, or degrees of freedom 4 d/β that are odd.
    """
    if form.noise.size != 1:
        raise NotApplicable("splitting of averaged energies takes one of them")
    if not 0.0 <= start < limit:
        raise InvalidInput("start", start, f"must be an energy from 0 to below the limit {limit:g}")
    d, beta, gamma = (float(x[0]) for x in (form.noise, form.slope, form.linear))
    pairs = 2.0 * d / beta
    if abs(pairs - round(pairs)) > WHOLE * pairs or round(pairs) < 1:
        raise NotApplicable(f"4 d/β = {2.0 * pairs:g} is not an even number of degrees of freedom")

    def energy(R: Array) -> Array:
        return np.asarray(form.energies(np.square(R)[:, None])).ravel()

    def root(H: Array) -> Array:
        """R at the energies H."""
        return np.where(H > 0.0, np.sqrt(form.inverse(H[:, None])).ravel(), 0.0)

    top, first = map(float, root(np.array([limit, start])))
    R = np.linspace(0.0, top, CELLS + 1)
    extra = np.zeros(2) if form.damping is None else np.ravel(form.damping(np.square(R)[:, None]))
    # The action to reach the limit from rest is that of the mean of γ over ∫ R dR.
    grid = np.linspace(0.0, top, extra.size)
    mean = gamma + 2.0 * float(np.trapezoid(extra * grid, grid)) / top**2
    own = score or (
        lambda H, times: least_action(
            root(H) ** 2, times, limit=top**2, noise=0.5 * beta, decay=mean
        )
    )
    tables = score_tables([own], [lambda x: energy(top * x)], time)
    rate = max(abs(gamma), abs(mean))
    return EnergyProblem(
        (d, beta, gamma), extra, first**2, top, time,
        dt or min(time, 1.0 / rate if rate > 0.0 else time) / STEPS, tables,
    )  # fmt: skip


@njit_inline
def bridge_maximum(a: float, b: float, variance: float, at: np.uint64) -> float:
    """Draw the maximum of a Brownian bridge from a to b whose motion has ``variance`` in all.

    P(max > m) = exp(−2 (m − a)(m − b)/variance); the uniform number is that at the place ``at``.
    """
    return 0.5 * (a + b + sqrt((b - a) * (b - a) - 2.0 * variance * log(uniform(at))))


@njit_inline
def damped(X: float, table: Array, top: float, h: float) -> float:
    """Return X after the damping beyond the linear over h, by an exponential midpoint rule."""
    cells = table.size - 1
    y = X
    for share in (0.5, 1.0):
        u = np.sqrt(y) / top * cells
        j = min(int(u), cells - 1)
        gamma = table[j] + min(u - j, 1.0) * (table[j + 1] - table[j])
        y = X * np.exp(-share * h * gamma)
    return y


@once
def compiled_energies() -> Any:
    """Return the function that renews paths of an energy, one for all threads."""
    sources = kernel_checksum() ^ checksum([ROOT / "tests/sim/questions/averaged_splitting.py"])

    @cached_njit()
    def renew(
        dead: Integers, parents: Integers, level: int, first: int, offset: np.uint64,
        numbers: tuple[float, float, float, float, float], pairs: int, table: Array,
        levels: Array, steps: int, paths: Paths,
    ) -> int:  # fmt: skip
        """Replace the paths ``dead`` by ``parents`` up to where they exceed ``level``, then anew.

        ``numbers`` are h, k, e^{−γh}, the variance of R in h, and R at the limit. Returns the
        checksum of its sources.
        """
        h, k, decay, variance, top_R = numbers
        x, z, words = np.zeros(1), np.zeros(2 * pairs, np.float32), np.zeros(1, np.uint64)
        for number in range(dead.size):
            i = dead[number]
            done = restart_from(paths, i, parents[number], level, x)
            begun, top, records = done, paths.level[i, 0], 1
            X = x[0]
            if level < 0:
                top = level_of(levels, np.sqrt(X) / top_R, 0.0)
                write_record(paths, i, 0, x, top, 0)
            while done < steps and top < SCORE_LEVELS:
                R0 = np.sqrt(X)
                X = damped(X, table, top_R, 0.5 * h)
                at = word_place(first + number, (done - begun) * (pairs + 1), offset)
                fill_normals(z, words, at, pairs, 1)
                mean = np.float64(z[0]) + np.sqrt(X * decay / k)
                total = mean * mean
                for r in range(1, 2 * pairs):
                    total += np.float64(z[r]) * np.float64(z[r])
                X = damped(k * total, table, top_R, 0.5 * h)
                u = at + np.uint64(pairs) * GOLDEN
                most = bridge_maximum(R0, np.sqrt(X), variance, u)
                done += 1
                reached = level_of(levels, most / top_R, done / steps)
                if reached > top:
                    top, x[0] = reached, X
                    write_record(paths, i, records, x, top, done)
                    records += 1
            paths.best[i] = top
            paths.moved[i] += done - begun
        return sources

    return renew
