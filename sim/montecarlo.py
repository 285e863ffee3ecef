"""Monte Carlo of the full Ito system (6) as a method: system in, densities with bands out."""

import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from math import inf, isfinite
from pathlib import Path

import numpy as np

import sim.schemes  # noqa: F401  (its modules register the integrators)
from fpk.cores import usable_cores
from fpk.errors import InvalidInput, NotApplicable
from fpk.method import Method, Plan, Progress, Result
from fpk.observable import Observable
from fpk.route import ROUTES, Route, register
from fpk.system import System
from sim.cluster import ensembles
from sim.random import LANES, MAX_TRAJECTORIES
from sim.relaxation import relaxation_time, undamped_mode
from sim.scheme import SCHEMES
from sim.simulation import PARTIAL, simulate
from sim.step_pair import mean_settings, step_bias
from sim.step_size import check_step, chosen_step
from sim.substeps import cost, with_long_steps

LEAST_PATHS = 32 * LANES
"""Paths below which there are fewer than 32 independent batches to take errors from."""

RELAXATIONS = 153.2
"""Relaxation times that are sampled unless a time is given: 6000 time units of fig6a."""

MOST_STEPS = 400_000
"""Steps at most where no time is given: of weakly damped systems fewer relaxation times fit in.
Where only some trajectories make small steps it counts what they cost (``substeps.cost``)."""

OTHER_SEED = 0x9E3779B97F4A7C15
"""What is added to the seed for the second simulation of a pair: 2**64 over the golden ratio."""

THREADS_PER_CORE = 4
"""Threads at most, in units of the cores that there are."""


@dataclass(frozen=True)
class MonteCarlo(Method):
    """Simulation of Eq. (6) with sampling errors from independent batches.

    ``paths`` trajectories are sampled for ``time`` each, after ``burn_in`` relaxation times.
    ``time`` None: ``relaxations`` relaxation times, whatever the unit of time is, but no more than
    the cost of ``most_steps`` uniform steps (rounded up to whole chunks); ``settings`` then has
    ``limited_by``.
    ``dt`` None: ``step_factor`` times the step chosen from the stiffest contact that is reached
    and the rates of the damping terms. ``tol``: go on until the expected L1 error of the first
    observable is below it, at most ``longest`` seconds. ``seconds``: go on for so many seconds
    of wall time instead; with ``tol`` it takes the place of ``longest``.
    ``step_pair``: run a second simulation at dt/2, its seed another, on the same bins; settings
    then have the differences as "step bias" of each density and mean, apart from sampling errors.
    ``moments``: evaluate the moment identities, too; settings then have the means of the states as
    "E q2²" and, where their controls hold, "E q2² by control variates" (``sim.control``).
    ``threads`` None: all that there are; the answer does not depend on it. ``cluster``: the address
    of a Dask scheduler whose workers do it, with bitwise the same answer. ``checkpoint``: a folder
    where the state is kept at intervals and found again. ``partial``: Ctrl-C ends the sampling with
    what there is, not certified.
    ``allow_unstable``: take a ``dt`` at or above the stability limit; nothing is certified then.

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
        if not LEAST_PATHS <= self.paths <= MAX_TRAJECTORIES:
            raise InvalidInput("paths", self.paths, f"use {LEAST_PATHS} to {MAX_TRAJECTORIES}")
        if not 0 <= self.seed < 2**64:
            raise InvalidInput("seed", self.seed, "use an integer from 0 to 2**64 - 1")
        most = THREADS_PER_CORE * (os.cpu_count() or 1)
        if self.threads is not None and not 1 <= self.threads <= most:
            raise InvalidInput("threads", self.threads, f"use 1 to {most}")
        if self.most_steps < 1:
            raise InvalidInput("most_steps", self.most_steps, "use 1 or more")
        positive = (
            "time",
            "dt",
            "tol",
            "longest",
            "burn_in",
            "step_factor",
            "relaxations",
            "seconds",
        )
        for key in positive:
            value = getattr(self, key)
            if value is not None and not (isfinite(value) and value > 0):
                raise InvalidInput(key, value, "must be a finite number > 0")

    @property
    def route(self) -> Route:
        """The route that the method follows."""
        return ROUTES["montecarlo", "simulation"]

    def prepare(self, system: System) -> Plan:
        """Return the plan for ``system``; raise ``NotApplicable`` with the reason why not."""
        if not np.any(system.noise_matrix):
            raise NotApplicable(
                "no noise reaches a mass: the motion dies out and has no stationary density"
            )
        relaxation = relaxation_time(system)
        if relaxation == inf or (system.damping_terms and undamped_mode(system)):
            raise NotApplicable(
                "some motion is not damped: under noise it grows and never becomes stationary"
            )
        return Plan(lambda observable: None, partial(self._sampled, system))

    def _sampled(
        self, system: System, observables: Sequence[Observable], progress: Progress
    ) -> Result:
        scheme = SCHEMES[self.scheme]
        dt = self.step_factor * chosen_step(system) if self.dt is None else self.dt
        unstable = self._unstable(system, dt)
        relaxation = relaxation_time(system)
        wanted = self.relaxations * relaxation if self.time is None else self.time
        scheme, long, steps = with_long_steps(system, scheme, dt)
        price = cost(system, dt, scheme.small) if scheme.small > 1 else 1.0
        time = min(wanted, self.most_steps * dt / price) if self.time is None else wanted
        simulated = partial(
            simulate,
            system,
            observables,
            scheme=scheme,
            paths=self.paths,
            threads=self.threads or usable_cores(),
            burn_in=self.burn_in,
            moments=self.moments,
            folder=self.checkpoint,
            partial=self.partial,
            known=unstable,
            progress=progress,
        )
        with ensembles(self.cluster) as make:
            run = simulated(
                make=make,
                dt=long,
                time=time,
                seed=self.seed,
                tol=self.tol if observables else None,
                longest=self.longest,
                seconds=self.seconds,
            )
        settings = dict(run.settings)
        settings["small_steps"] = steps
        settings["relaxation_time"] = relaxation
        if time < wanted:
            settings["limited_by"] = "most_steps"
        if run.paths is not None:
            settings |= mean_settings(run.paths)
        settings["step bias"] = "not measured"
        if self.step_pair and not run.lost and PARTIAL not in run.settings:
            with ensembles(self.cluster) as make:
                half = simulated(
                    make=make,
                    dt=0.5 * long,
                    time=float(run.settings["time"]),
                    seed=(self.seed + OTHER_SEED) % 2**64,
                    histograms=run.histograms,
                )
            if PARTIAL in half.settings:
                settings["step bias"] = "not measured: interrupted"
            else:
                settings |= step_bias(run, half)
        return Result(
            method=self,
            densities=run.densities,
            identities=run.moments.identities() if run.moments is not None else (),
            settings=settings,
            partial=PARTIAL in settings,
        )

    def _unstable(self, system: System, dt: float) -> tuple[str, ...]:
        """Why no answer with the step ``dt`` can be certified; raise unless that is allowed."""
        try:
            check_step(system, SCHEMES[self.scheme], dt)
        except InvalidInput as error:
            if not self.allow_unstable:
                raise
            return (f"the step {dt:g} was insisted on: it {error.remedy}",)
        return ()

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
            seconds=None if self.seconds is None else 4.0 * self.seconds,
            step_factor=self.step_factor * 2.0**-0.25,
        )


register(
    Route(
        "montecarlo",
        "simulation",
        "simulation",
        "(6)",
        "full",
        True,
        "#c08a1e",
        make=MonteCarlo,
    )
)
