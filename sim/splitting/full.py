"""The full system (6) towards a limit: steps, score and starts of its paths."""

from dataclasses import dataclass
from functools import partial
from math import isfinite, sqrt
from typing import Any

import numpy as np

from fpk.arrays import Array
from fpk.effects import effects_of
from fpk.errors import InvalidInput, NotApplicable
from fpk.limit import Limit
from fpk.linear import natural_modes
from fpk.start import Start
from fpk.system import System
from sim.motion.starts import Origin
from sim.plan import step_arrays
from sim.random import mixed_seed
from sim.schemes.exact_flow import EXACT_FLOW
from sim.splitting.arrays import Score, Watched, new_paths
from sim.splitting.kernel import PathKey, compiled_paths
from sim.splitting.replicas import CompiledReplicas
from sim.splitting.score import ScoreFunction, cost_score, score_table
from sim.step_size import (
    REACHED,
    STEP_PER_FREQUENCY,
    STEP_PER_RATE,
    STEP_WITH_TERMS,
    highest_frequency,
    sampling_interval,
    temperature,
    term_rate,
)


@dataclass(frozen=True, eq=False)
class SystemProblem:
    """Failure of ``system`` at ``limit`` before ``time``; see ``replicas.Problem``."""

    system: System
    limit: Limit
    start: Start
    time: float
    dt: float
    score: Score

    @property
    def identity(self) -> tuple[Any, ...]:
        """Values that a checkpoint must have been made with."""
        limit, start = (list(x.values.items()) for x in (self.limit, self.start))
        kinds = self.limit.kind, self.start.kind
        return (self.system, kinds, limit, start, self.time, self.dt, self.score.table)

    def replicas(
        self, count: int, steps: int, seed: int, stream: np.random.Generator
    ) -> CompiledReplicas:
        """Return ``count`` paths of ``steps`` steps from their starts, drawn from ``stream``."""
        dt, effects = self.time / steps, effects_of(self.system)
        step = step_arrays(self.system, EXACT_FLOW, dt)
        kind: Any = self.limit.kind
        key = PathKey(
            kind=kind,
            laws=effects.laws,
            damping=effects.state_damping,
            energy_damping=effects.energy_damping,
            masses=self.system.n,
            pairs=step.pairs,
        )
        origin = Origin(self.system, self.start, int(stream.integers(2**63)))
        return CompiledReplicas(
            compiled_paths(key),
            (step, watched(self.system, self.limit), self.score._replace(steps=steps)),
            new_paths(np.hstack(origin.drawn(count, 0)), steps),
            mixed_seed(seed),
        )


def watched(system: System, limit: Limit) -> Watched:
    """Return the numbers of what ``limit`` is on.

    Of |q_i| these are, for the score, of E_i = ½ k A² + U_i(q_i), A = Σ_m |T_im| √(2 H_m)/ω_m the
    largest |q_i| of free motion and k the static stiffness at mass i. E_i is not above H, and not
    below its value E_f = ½ k a² + U_i(a) where |q_i| passes a. |q_i| itself would be a poor score:
    the next peak of a path that has set out for it is no longer open.
    """
    values, n = limit.values, system.n
    noise, mode_q = 2.0 * system.noise_matrix, np.zeros((0, n))
    mode_p, reach, energy, mass = mode_q, np.zeros(n), 1.0, 0
    if limit.kind != "H":
        shapes, omega = natural_modes(system)
        chosen = list(range(n))
        if limit.kind == "modal":
            chosen = [int(name[1:]) - 1 for name in values]
        else:
            mass, energy = displaced(system, limit)
            reach = np.abs(shapes[mass]) / omega / np.sqrt(energy * system.compliance[mass, mass])
        T = np.ascontiguousarray(shapes.T[chosen])
        mode_q, mode_p = omega[chosen, None] * T * system.mass, T
        if limit.kind == "modal":
            noise = np.einsum("mi,ij,mj->m", T, noise, T)[:, None]
    damping = np.ascontiguousarray(system.damping[:, list(system.contact_masses)])
    inverse = 1.0 / np.array(list(values.values()))
    return Watched(inverse, noise, mode_q, mode_p, reach, energy, mass, damping)


def system_problem(
    system: System,
    limit: Limit,
    start: Start,
    time: float,
    *,
    dt: float | None,
    score: ScoreFunction | None,
) -> SystemProblem:
    """Return the problem with its step, of ``chosen_step`` unless given, and its score.

    Raises ``InvalidInput`` for a start at or beyond the limit, ``NotApplicable`` without noise.
    """
    if not np.any(system.noise_matrix):
        raise NotApplicable("no noise reaches a mass: whether the limit is passed is no chance")
    require_inside(system, limit, start)
    scores, tops = scores_of(system, limit)
    if score is not None:
        if len(scores) > 1:
            raise InvalidInput("score", score, "must be left out where there are several limits")
        scores = [score]
    energies = [partial(_at_share, top=top) for top in tops]
    table = score_table(scores, energies, time=time, steps=1)
    return SystemProblem(system, limit, start, time, dt or chosen_step(system, limit), table)


def require_inside(system: System, limit: Limit, start: Start) -> None:
    """Raise ``InvalidInput`` for a start at or beyond the limit, whatever its phases."""
    if start.kind == "noise":
        return  # of which a share may have failed at once
    reached = dict(start.values)
    if start.kind == "modal":
        reached["H"] = sum(reached.values())  # contact adds to it
    if start.kind == "state":
        q, p = start.state(system.n)
        shapes, omega = natural_modes(system)
        modal = 0.5 * ((omega * (shapes.T @ (system.mass * q))) ** 2 + (shapes.T @ p) ** 2)
        reached = {f"H{m + 1}": float(H) for m, H in enumerate(modal)}
        reached |= {f"q{i + 1}": abs(float(x)) for i, x in enumerate(q)}
        reached["H"] = float(system.hamiltonian(q, p))
    for name, value in limit.values.items():
        if reached.get(name, 0.0) >= value:
            raise InvalidInput("start", str(start), f"must lie below the limit {limit}")


def displaced(system: System, limit: Limit) -> tuple[int, float]:
    """Return the mass (from 0) whose displacement has a limit, and the least V there."""
    (name, value) = next(iter(limit.values.items()))
    i = int(name[1:]) - 1
    return i, 0.5 * value**2 / float(system.compliance[i, i]) + float(
        min(system.contact_energy(i, value), system.contact_energy(i, -value))
    )


def scores_of(system: System, limit: Limit) -> tuple[list[ScoreFunction], list[float]]:
    """Return the score of least action of each coordinate, and the energies of the limit."""
    energies = list(limit.values.values())
    if limit.kind == "modal":
        shapes, _ = natural_modes(system)
        modes = [int(name[1:]) - 1 for name in limit.values]
        noise = np.einsum("im,ij,jm->m", shapes, system.noise_matrix, shapes)[modes]
        decay = np.einsum("im,ij,jm->m", shapes, system.damping, shapes)[modes]
    else:
        if limit.kind == "q":
            energies = [displaced(system, limit)[1]]
        kT = temperature(system)
        noise = np.mean(np.diag(system.noise_matrix) / system.mass, keepdims=True)
        decay = noise / kT if isfinite(kT) else np.zeros(1)
    return [
        cost_score(energy, noise=float(D), decay=float(c))
        for energy, D, c in zip(energies, noise, decay, strict=True)
    ], energies


def _at_share(x: Array, top: float) -> Array:
    return np.asarray(top * x**2)


def chosen_step(system: System, limit: Limit) -> float:
    """Return the longer one of two steps: for the contact as it is at the limit.

    Stops are reached with all the energy of the limit, or ``REACHED`` kT if that is more.
    """
    steps, kT = [sampling_interval(system)], temperature(system)
    energy = sum(limit.values.values())
    if limit.kind == "q":
        _, energy = displaced(system, limit)
    if isfinite(kT):
        energy = max(energy, REACHED * kT)
    share = STEP_WITH_TERMS if system.damping_terms else STEP_PER_FREQUENCY
    for stop in system.stops:
        slope = float(stop.slope(stop.overlap_at(energy)))
        m, K = system.mass[stop.index], system.stiffness_matrix[stop.index, stop.index]
        steps.append(share / sqrt((slope + K) / m))
    if system.damping_terms:
        steps += [STEP_PER_RATE / term_rate(system), STEP_PER_FREQUENCY / highest_frequency(system)]
    return min(steps)
