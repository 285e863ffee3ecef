"""Monte Carlo of the full Ito system (6) as a method: system in, densities with bands out."""

import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import inf, isfinite
from time import perf_counter

import numpy as np

import sim.schemes  # noqa: F401  (its modules register the integrators)
from fpk.errors import InvalidInput
from fpk.method import Progress, Result, require_applicable, silent
from fpk.observable import Observable, observable_name
from fpk.system import System
from sim.random import LANES, MAX_TRAJECTORIES
from sim.scheme import SCHEMES
from sim.simulation import simulate
from sim.step_size import check_step, chosen_step, relaxation_time

LEAST_PATHS = 32 * LANES
"""Paths below which there are fewer than 32 independent batches to take errors from."""


@dataclass(frozen=True)
class MonteCarlo:
    """Simulation of Eq. (6) with sampling errors from independent batches.

    ``paths`` trajectories are sampled for ``time`` each, after ``burn_in`` relaxation times of
    the linear system. ``dt`` None: ``step_factor`` times the step chosen from the stiffest contact
    that is reached. ``tol``: go on
    until the expected L1 error of the first observable is below it, at most ``longest`` seconds.
    ``moments``: evaluate the moment identities, too. ``threads`` None: all that there are; the
    answer does not depend on it.

    Raises ``InvalidInput`` naming the field that cannot be used.
    """

    paths: int = 8192
    time: float = 6000.0
    dt: float | None = None
    scheme: str = "exact_flow"
    seed: int = 1
    threads: int | None = None
    tol: float | None = None
    longest: float = 60.0
    burn_in: float = 10.0
    moments: bool = True
    step_factor: float = 1.0

    def __post_init__(self) -> None:
        """Check every field."""
        if self.scheme not in SCHEMES:
            raise InvalidInput("scheme", self.scheme, f"is none; use one of {sorted(SCHEMES)}")
        if not LEAST_PATHS <= self.paths <= MAX_TRAJECTORIES:
            raise InvalidInput("paths", self.paths, f"use {LEAST_PATHS} to {MAX_TRAJECTORIES}")
        if not 0 <= self.seed < 2**64:
            raise InvalidInput("seed", self.seed, "use an integer from 0 to 2**64 - 1")
        if self.threads is not None and self.threads < 1:
            raise InvalidInput("threads", self.threads, "use 1 or more")
        for key in ("time", "dt", "tol", "longest", "burn_in", "step_factor"):
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
        if system.damping_terms:
            return "damping that depends on the state is not simulated yet"
        if relaxation_time(system) == inf:
            return "some motion is not damped: under noise it grows and never becomes stationary"
        if any(c.kind == "H" and c.index is not None for c in observable):
            return f"modal energies such as {observable_name(observable)} are not sampled yet"
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
        run = simulate(
            system,
            observables,
            scheme=scheme,
            dt=dt,
            paths=self.paths,
            time=self.time,
            seed=self.seed,
            threads=self.threads or len(os.sched_getaffinity(0)),
            burn_in=self.burn_in,
            moments=self.moments,
            tol=self.tol if observables else None,
            longest=self.longest,
            progress=progress,
        )
        settings = dict(run.settings)
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
            time=4.0 * self.time,
            tol=None if self.tol is None else 0.5 * self.tol,
            longest=4.0 * self.longest,
            step_factor=self.step_factor * 2.0**-0.25,
        )
