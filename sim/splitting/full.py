"""The full system (6) towards a limit: steps, score and starts of its paths."""

from dataclasses import dataclass
from math import isfinite

import numpy as np

from fpk.arrays import Array
from fpk.errors import InvalidInput, NotApplicable
from fpk.limit import Limit
from fpk.linear import natural_modes
from fpk.observable import Coordinate
from fpk.start import Start
from fpk.system import System
from sim.motion.limits import beyond, energies_at, energies_of, reach_of
from sim.motion.passing import diffusion_of
from sim.motion.starts import Origin
from sim.motion.steps import STEP_TO_LIMIT, STEPS_SINCE_START, TOO_LONG
from sim.plan import step_arrays, watched
from sim.random import mixed_seed
from sim.schemes.exact_flow import EXACT_FLOW
from sim.splitting.algorithm import CompiledReplicas
from sim.splitting.arrays import LimitArrays, Score, new_paths
from sim.splitting.kernel import compiled_paths
from sim.splitting.score import SHARES, ScoreFunction, cost_score, score_table
from sim.step_size import chosen_step, temperature

PROBES = 64
"""States of a start of which one at least must lie below the limit."""


@dataclass(frozen=True, eq=False)
class SystemProblem:
    """Failure of ``system`` at ``limit`` before ``time``; see ``algorithm.Problem``."""

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
        n, dt = self.system.n, self.time / steps
        step = step_arrays(self.system, EXACT_FLOW, dt)
        energies = energies_of(self.limit, n) or [Coordinate("H", m) for m in range(n)]
        key, watch = watched(self.system, EXACT_FLOW, step, (), (), energies)
        origin = Origin(self.system, self.start, int(stream.integers(2**63)))
        return CompiledReplicas(
            compiled_paths(key, self.limit.kind),
            (step, watch, limit_arrays(self.system, self.limit), self.score._replace(steps=steps)),
            new_paths(np.hstack(origin.drawn(count, 0)), steps),
            mixed_seed(seed),
        )


def limit_arrays(system: System, limit: Limit) -> LimitArrays:
    """Return the numbers of what ``limit`` is on.

    Of |q_i| these are, for the score, of E_i = ½ k A² + U_i(q_i), A = Σ_m |T_im| √(2 H_m)/ω_m the
    largest |q_i| of free motion and k the static stiffness at mass i. E_i is not above H, and not
    below its value E_f = ½ k a² + U_i(a) where |q_i| passes a. |q_i| itself would be a poor score:
    the next peak of a path that has set out for it is no longer open.
    """
    n, at = system.n, energies_at(system, limit)
    if limit.kind != "q":
        return LimitArrays(at, diffusion_of(system, limit), np.zeros(n), 1.0, 0)
    mass, energy = limit.observable(n)[0].row, float(np.min(at))
    shapes, omega = natural_modes(system)
    reach = np.abs(shapes[mass]) / omega / np.sqrt(energy * system.compliance[mass, mass])
    return LimitArrays(np.array([limit.value]), None, reach, energy, mass)


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
    states = () if start.kind == "noise" else Origin(system, start, 0).drawn(PROBES, 0)
    if states and np.all(beyond(system, limit, *states)):
        raise InvalidInput("start", str(start), f"must lie below the limit {limit}")
    scores, tops = scores_of(system, limit)
    if score is not None:
        if len(scores) > 1:
            raise InvalidInput("score", score, "must be left out where there are several limits")
        scores = [score]
    table = score_table(scores, [top * SHARES**2 for top in tops], time=time, steps=1)
    reach = reach_of(system, limit, start, time)
    longest = min(
        chosen_step(system, energy=reach.energy, kT=reach.kT),
        STEP_TO_LIMIT * (min(reach.limit, reach.start) if start.kind == "state" else reach.limit),
        time / STEPS_SINCE_START,
    )
    if dt is not None and dt > TOO_LONG * longest:
        raise InvalidInput("dt", dt, f"is too long to see a passage; use {longest:.2g}")
    return SystemProblem(system, limit, start, time, dt or longest, table)


def scores_of(system: System, limit: Limit) -> tuple[list[ScoreFunction], Array]:
    """Return the score of least action of each coordinate, and the energies of the limit."""
    at = energies_at(system, limit)
    if limit.kind == "modal":
        T = natural_modes(system)[0][:, [c.row for c in energies_of(limit, system.n)]]
        noise = np.einsum("im,ij,jm->m", T, system.noise_matrix, T)
        decay = np.einsum("im,ij,jm->m", T, system.damping, T)
    else:
        at, kT = np.min(at, keepdims=True), temperature(system)
        noise = np.mean(np.diag(system.noise_matrix) / system.mass, keepdims=True)
        decay = noise / kT if isfinite(kT) else np.zeros(1)
    return [
        cost_score(energy, noise=float(D), decay=float(c))
        for energy, D, c in zip(at, noise, decay, strict=True)
    ], at
