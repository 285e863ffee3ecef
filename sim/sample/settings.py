"""Settings of the simulation of the full Ito system (6), its step, and what it cannot sample."""

import os
from collections.abc import Sequence
from dataclasses import dataclass, field
from math import inf, isfinite
from pathlib import Path
from typing import Any

import numpy as np

from fpk.answer.names import Observable
from fpk.numeric.errors import InvalidInput, NotApplicable
from fpk.numeric.machine import usable_cores
from fpk.numeric.recognition import REGISTRY
from fpk.system.system import System
from sim.step.arrays import LANES, MAX_TRAJECTORIES
from sim.step.schemes import SCHEMES
from sim.step.step_size import (
    chosen_step,
    expected_error,
    relaxation_time,
    samples_in,
    sampling_interval,
    step_for,
    undamped_mode,
)

LEAST_PATHS = 32 * LANES
"""Paths below which there are fewer than 32 independent batches to take errors from."""
RELAXATIONS = 153.2
"""Relaxation times that are sampled unless a time is given: 6000 time units of fig6a."""
ANYWHERE = {
    "MonteCarlo.threads": "the random numbers belong to a path, whatever thread makes its steps",
    "MonteCarlo.cluster": "and whatever machine",
}
"""Fields on which no number of a simulation of a given length depends."""
NOT_IN_STATE = {
    **ANYWHERE,
    "MonteCarlo.checkpoint": "it says where the state is",
    "MonteCarlo.partial": "it says what Ctrl-C does, after which a state can be gone on from",
    "MonteCarlo.seconds": "a later limit goes on from where an earlier one ended",
    "MonteCarlo.longest": "so does this one",
    "Setup.seconds": "the one of these two that holds; whether there is one is compared",
}
"""Fields on which the saved state of a simulation does not depend, beside its length so far."""


def check_settings(own: Any, positive: Sequence[str], *ranges: tuple[str, int, int]) -> None:
    """Raise ``InvalidInput`` for a wrong seed, thread or field; ``ranges``: (name, least, most)."""
    threads = 4 * (os.cpu_count() or 1)
    for key, low, high in (*ranges, ("seed", 0, 2**64 - 1), ("threads", 1, threads)):
        value = getattr(own, key)
        if value is not None and not low <= value <= high:
            raise InvalidInput(key, value, f"use {low} to {high}")
    for key in positive:
        value = getattr(own, key)
        if value is not None and not (isfinite(value) and value > 0):
            raise InvalidInput(key, value, "must be a finite number > 0")


@dataclass(frozen=True)
class Settings:
    """The fields of ``sim.MonteCarlo``, which describes them; every question takes them."""

    paths: int = 8192
    time: float | None = None
    dt: float | None = None
    scheme: str = field(default="exact_flow", metadata={REGISTRY: SCHEMES})
    seed: int = 1
    threads: int | None = None
    tol: float | None = None
    longest: float = 60.0
    burn_in: float = 10.0
    step_factor: float = 1.0
    relaxations: float = RELAXATIONS
    most_steps: int = 400_000
    seconds: float | None = None
    step_pair: bool = False
    cluster: str | None = None
    checkpoint: Path | None = None
    partial: bool = False
    allow_unstable: bool = False

    def __post_init__(self) -> None:
        """Check every field."""
        if self.scheme not in SCHEMES:
            raise InvalidInput("scheme", self.scheme, f"is none; use one of {sorted(SCHEMES)}")
        times = ("time", "relaxations", "burn_in", "dt", "step_factor", "longest", "seconds")
        paths = ("paths", LEAST_PATHS, MAX_TRAJECTORIES)
        check_settings(self, (*times, "tol", "most_steps"), paths)

    def sampled_time(self, system: System, step: float) -> float:
        """Return the time sampled by steps that cost as much as uniform ones of ``step``."""
        return self.time or min(self.relaxations * relaxation_time(system), self.most_steps * step)


def require_stationary(system: System) -> None:
    """Raise ``NotApplicable`` where ``system`` has no stationary density, with the reason."""
    words = "some motion is not damped: under noise it grows and never becomes stationary"
    if not np.any(system.noise_matrix):
        words = "no noise reaches a mass: the motion dies out and has no stationary density"
    elif relaxation_time(system) < inf and not (system.damping_terms and undamped_mode(system)):
        return
    raise NotApplicable(words)


def default_step(method: Settings, system: System, observables: Sequence[Observable] = ()) -> float:
    """Return the step: short enough for the contact, and for the accuracy the run will reach.

    That follows from ``tol``, from the samples that ``seconds`` of wall time allow by ``threads``
    (of an hour of one thread where a checkpoint may go on with others), or from the sampled time.
    """
    if method.tol is not None:
        return step_for(system, method.tol, observables=observables)
    dt = chosen_step(system)
    if method.seconds is None:
        samples = method.paths * method.sampled_time(system, dt) / sampling_interval(system)
        return step_for(system, expected_error(samples), observables=observables)
    own = method.seconds * (method.threads or usable_cores())
    seconds = own if method.checkpoint is None else 3600.0
    for _ in range(8):  # each leaves a fourth of the change at most: h ~ samples^(−1/4) or less
        error = expected_error(samples_in(system, dt, seconds))
        dt = step_for(system, error, observables=observables)
    return dt


def expected_seconds(method: Settings, system: System) -> float:
    """Return about the seconds of wall time, to a factor of three, without compiling."""
    require_stationary(system)
    dt = default_step(method, system)
    time = method.sampled_time(system, dt) + method.burn_in * relaxation_time(system)
    samples = method.paths * time / max(dt, sampling_interval(system))
    return samples / samples_in(system, dt, 1.0) / (method.threads or usable_cores())
