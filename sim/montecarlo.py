"""Monte Carlo of the full Ito system (6) as a method: system in, densities with bands out."""

import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import inf, isfinite
from time import perf_counter

import numpy as np

import sim.schemes  # noqa: F401  (its modules register the integrators)
from fpk.errors import InvalidInput, NotApplicable
from fpk.method import Progress, Result, require_applicable, silent
from fpk.observable import Observable
from fpk.system import System
from sim.random import LANES, MAX_TRAJECTORIES
from sim.relaxation import relaxation_time, undamped_mode
from sim.scheme import SCHEMES
from sim.simulation import simulate
from sim.step_size import check_step, chosen_step

LEAST_PATHS = 32 * LANES
"""Paths below which there are fewer than 32 independent batches to take errors from."""

RELAXATIONS = 153.2
"""Relaxation times that are sampled unless a time is given: 6000 time units of fig6a."""

MOST_STEPS = 400_000
"""Steps at most where no time is given: of weakly damped systems fewer relaxation times fit in."""

THREADS_PER_CORE = 4
"""Threads at most, in units of the cores that there are."""


@dataclass(frozen=True)
class MonteCarlo:
    """Simulation of Eq. (6) with sampling errors from independent batches.

    ``paths`` trajectories are sampled for ``time`` each, after ``burn_in`` relaxation times.
    ``time`` None: ``relaxations`` relaxation times, whatever the unit of time is, but no more than
    ``most_steps`` steps (rounded up to whole chunks); ``settings`` then has ``limited_by``.
    ``dt`` None: ``step_factor`` times the step chosen from the stiffest contact that is reached
    and the rates of the damping terms. ``tol``: go on until the expected L1 error of the first
    observable is below it, at most ``longest`` seconds.
    ``moments``: evaluate the moment identities, too. ``threads`` None: all that there are; the
    answer does not depend on it.

    Raises ``InvalidInput`` naming the field that cannot be used.
    """

    paths: int = 8192
    time: float | None = None
    dt: float | None = None
    scheme: str = "exact_flow"
    seed: int = 1
    threads: int | None = None
    tol: float | None = None
    longest: float = 60.0
    burn_in: float = 10.0
    moments: bool = True
    step_factor: float = 1.0
    relaxations: float = RELAXATIONS
    most_steps: int = MOST_STEPS

    def __post_init__(self) -> None:
        """Check every field."""
        if self.scheme not in SCHEMES:
            raise InvalidInput("scheme", self.scheme, f"is none; use one of {sorted(SCHEMES)}")
        if not LEAST_PATHS <= self.paths <= MAX_TRAJECTORIES:
            raise InvalidInput("paths", self.paths, f"use {LEAST_PATHS} to {MAX_TRAJECTORIES}")
        if not 0 <= self.seed < 2**64:
            raise InvalidInput("seed", self.seed, "use an integer from 0 to 2**64 - 1")
        most = THREADS_PER_CORE * (os.cpu_count() or 1)
        if self.threads is not None and not 1 <= self.threads <= most:
            raise InvalidInput("threads", self.threads, f"use 1 to {most}")
        if self.most_steps < 1:
            raise InvalidInput("most_steps", self.most_steps, "use 1 or more")
        for key in ("time", "dt", "tol", "longest", "burn_in", "step_factor", "relaxations"):
            value = getattr(self, key)
            if value is not None and not (isfinite(value) and value > 0):
                raise InvalidInput(key, value, "must be a finite number > 0")

    @property
    def name(self) -> str:
        """The method's name on the command line."""
        return "montecarlo"

    @property
    def solver(self) -> str:
        """How the method's equation is solved, on the command line."""
        return "simulation"

    def refusal(self, system: System, observable: Observable) -> str | None:
        """Return why there is nothing to sample, or None where there is."""
        if not np.any(system.noise_matrix):
            return "no noise reaches a mass: the motion dies out and has no stationary density"
        try:
            relaxation = relaxation_time(system)
        except NotApplicable as reason:
            return str(reason)
        if relaxation == inf or (system.damping_terms and undamped_mode(system)):
            return "some motion is not damped: under noise it grows and never becomes stationary"
        return None

    def solve(
        self,
        system: System,
        observables: Sequence[Observable],
        *,
        progress: Progress = silent,
    ) -> Result:
        """Return the densities of ``observables``; raise ``NotApplicable`` where it refuses."""
        begin = perf_counter()
        require_applicable(self, system, observables)
        scheme = SCHEMES[self.scheme]
        dt = self.step_factor * chosen_step(system) if self.dt is None else self.dt
        check_step(system, scheme, dt)
        relaxation = relaxation_time(system)
        wanted = self.relaxations * relaxation if self.time is None else self.time
        time = min(wanted, self.most_steps * dt) if self.time is None else wanted
        run = simulate(
            system,
            observables,
            scheme=scheme,
            dt=dt,
            paths=self.paths,
            time=time,
            seed=self.seed,
            threads=self.threads or len(os.sched_getaffinity(0)),
            burn_in=self.burn_in,
            moments=self.moments,
            tol=self.tol if observables else None,
            longest=self.longest,
            progress=progress,
        )
        settings = dict(run.settings)
        settings["relaxation_time"] = relaxation
        if time < wanted:
            settings["limited_by"] = "most_steps"
        if run.moments is not None:
            for i in range(system.n):
                for name, mean in (
                    (f"q{i + 1}", run.moments.displacement_square(i)),
                    (f"v{i + 1}", run.moments.velocity_square(i)),
                ):
                    settings[f"E {name}²"] = mean.value
                    settings[f"standard error of E {name}²"] = mean.error
        return Result(
            method=self,
            densities=run.densities,
            seconds=perf_counter() - begin,
            identities=run.moments.identities() if run.moments is not None else (),
            settings=settings,
        )

    def refined(self) -> "MonteCarlo":
        """Return the method with four times the sample: half the sampling error.

        A chosen step shrinks by 2**(−1/4), so that the bias of the default scheme halves, too.
        """
        return replace(
            self,
            time=None if self.time is None else 4.0 * self.time,
            relaxations=4.0 * self.relaxations,
            most_steps=5 * self.most_steps,  # 4 times the time, in steps 2**(−1/4) as long
            tol=None if self.tol is None else 0.5 * self.tol,
            longest=4.0 * self.longest,
            step_factor=self.step_factor * 2.0**-0.25,
        )
