"""Settings of the simulation of the full Ito system (6), its step and its cost."""

import os
from collections.abc import Sequence
from dataclasses import dataclass, field
from math import inf
from pathlib import Path
from typing import Any

import numpy as np

from fpk.answer.names import Observable
from fpk.numeric.errors import NotApplicable, require
from fpk.numeric.machine import usable_cores
from fpk.numeric.recognition import REGISTRY
from fpk.system.system import System
from sim.step.arrays import LANES, MAX_TRAJECTORIES
from sim.step.schemes import SCHEMES
from sim.step.step_size import (
    chosen_step,
    has_undamped_mode,
    relative_sampling_error,
    relaxation_time,
    samples_in,
    sampling_interval,
    step_for,
)

LEAST_PATHS = 32 * LANES
"""Least number of trajectories: 32 batches of ``LANES``, whose spread gives standard errors."""
ANYWHERE = {
    "MonteCarlo.threads": "random numbers belong to a path, whichever thread makes its steps",
    "MonteCarlo.cluster": "random numbers belong to a path, whichever machine makes its steps",
}
"""Fields on which no number of a simulation of a given length depends: "Class.field" to reason."""
NOT_IN_STATE = {
    **ANYWHERE,
    "MonteCarlo.checkpoint": "the folder of the state",
    "MonteCarlo.partial": "a state is saved whatever Ctrl-C does to the answer",
    "MonteCarlo.seconds": "a longer run continues from the state of a shorter run",
    "MonteCarlo.longest": "a longer run continues from the state of a shorter run",
    "Setup.seconds": "the smaller of these two; whether there is a limit is compared",
    "Splitting.threads": "random numbers belong to a repetition",
    "Splitting.cluster": "random numbers belong to a repetition",
    "Splitting.checkpoint": "the folder of the repetitions",
    "Splitting.partial": "repetitions are saved whatever Ctrl-C does to the answer",
    "Splitting.repetitions": "how many are made; each has its number",
    "Splitting.tol": "decides how many repetitions are made",
    "Splitting.seconds": "decides how many repetitions are made",
}
"""Fields on which the saved state of a simulation does not depend: "Class.field" to reason."""


def check_settings(own: Any, positive: Sequence[str], *ranges: tuple[str, int, int]) -> None:
    """Raise ``InvalidInput`` naming the first field of the settings ``own`` that cannot be used.

    The fields named in ``positive`` must be finite and > 0; ``ranges`` are (name, least, most),
    both values included. ``seed`` must be in 0 … 2**64 − 1, ``threads`` from 1 to four times the
    number of processors. None is allowed in every field.
    """
    threads = 4 * (os.cpu_count() or 1)
    for key, low, high in (*ranges, ("seed", 0, 2**64 - 1), ("threads", 1, threads)):
        value = getattr(own, key)
        require(value is None or low <= value <= high, key, value, f"use {low} to {high}")
    for key in positive:
        value = getattr(own, key)
        require(value is None or 0 < value < inf, key, value, "must be a finite number > 0")


@dataclass(frozen=True)
class Settings:
    """Settings of a simulation of Eq. (6); ``sim.MonteCarlo`` explains each field."""

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
    relaxations: float = 153.2  # 6000 units of time of fig6a
    most_steps: int = 400_000
    seconds: float | None = None
    step_pair: bool = False
    cluster: str | None = None
    checkpoint: Path | None = None
    partial: bool = False
    allow_unstable: bool = False

    def __post_init__(self) -> None:
        """Raise ``InvalidInput`` naming the first field that cannot be used."""
        remedy = f"is none; use one of {sorted(SCHEMES)}"
        require(self.scheme in SCHEMES, "scheme", self.scheme, remedy)
        times = ("time", "relaxations", "burn_in", "dt", "step_factor", "longest", "seconds")
        paths = ("paths", LEAST_PATHS, MAX_TRAJECTORIES)
        check_settings(self, (*times, "tol", "most_steps"), paths)

    def sampled_time(self, system: System, step: float) -> float:
        """Return ``time``, or ``relaxations`` relaxation times up to ``most_steps`` · ``step``."""
        return self.time or min(self.relaxations * relaxation_time(system), self.most_steps * step)


def require_stationary(system: System) -> None:
    """Raise ``NotApplicable``, with the reason, if ``system`` has no stationary density."""
    words = "some motion is not damped: under noise it grows and never becomes stationary"
    if not np.any(system.noise_matrix):
        words = "no noise reaches a mass: the motion dies out and has no stationary density"
    elif relaxation_time(system) < inf and not (system.damping_terms and has_undamped_mode(system)):
        return
    raise NotApplicable(words)


def default_step(method: Settings, system: System, observables: Sequence[Observable] = ()) -> float:
    """Return the step whose bias is a third of the sampling error that the run will reach.

    This error is ``tol`` or, if None, follows from the samples in ``seconds`` of wall time on
    ``threads`` (with a checkpoint, which may be continued elsewhere, in an hour on one thread) or,
    if None, in the sampled time. ``observables``: see ``step_for``. ``dt`` and ``step_factor`` are
    ignored.
    """
    if method.tol is not None:
        return step_for(system, method.tol, observables=observables)
    dt = chosen_step(system)
    if method.seconds is None:
        samples = method.paths * method.sampled_time(system, dt) / sampling_interval(system)
        return step_for(system, relative_sampling_error(samples), observables=observables)
    own = method.seconds * (method.threads or usable_cores())
    seconds = own if method.checkpoint is None else 3600.0
    for _ in range(8):  # h ~ samples^(−1/4) or less: each divides the change by four or more
        error = relative_sampling_error(samples_in(system, dt, seconds))
        dt = step_for(system, error, observables=observables)
    return dt


def estimate_seconds(method: Settings, system: System) -> float:
    """Return the wall time of burn-in and sampling in s, to a factor of three.

    Compilation is not included, and the limits ``seconds`` and ``longest`` do not shorten it.
    Raises ``NotApplicable`` if ``system`` has no stationary density.
    """
    require_stationary(system)
    dt = default_step(method, system)
    time = method.sampled_time(system, dt) + method.burn_in * relaxation_time(system)
    samples = method.paths * time / max(dt, sampling_interval(system))
    return samples / samples_in(system, dt, 1.0) / (method.threads or usable_cores())
