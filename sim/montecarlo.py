"""Monte Carlo of the full Ito system (6) as a method: system in, densities with bands out."""

import os
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from importlib import import_module
from math import inf, isfinite
from pathlib import Path
from typing import Any

import numpy as np

from fpk.dynamics import Curve, Question, StationaryMotionMethod
from fpk.errors import InvalidInput, NotApplicable
from fpk.evolution import (
    AfterStart,
    Passage,
    PassageAsked,
    Passages,
    Transient,
    TransientAsked,
    Transients,
)
from fpk.method import ROUTES, Plan, Progress, Result, Route, register
from fpk.observable import Observable
from fpk.recognition import REGISTRY
from fpk.system import System
from sim.arrays import LANES, MAX_TRAJECTORIES
from sim.relaxation import relaxation_time, undamped_mode
from sim.schemes import SCHEMES

LEAST_PATHS = 32 * LANES
"""Paths below which there are fewer than 32 independent batches to take errors from."""

RELAXATIONS = 153.2
"""Relaxation times that are sampled unless a time is given: 6000 time units of fig6a."""

MOST_STEPS = 400_000
"""Steps at most where no time is given: of weakly damped systems fewer relaxation times fit in.
Where only some trajectories make small steps it counts what they cost (``substeps.cost``)."""

THREADS_PER_CORE = 4
"""Threads at most, in units of the cores that there are."""


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
    """Raise ``InvalidInput`` for a field of a simulation's settings that cannot be used.

    Of its seed and threads, and where they are given: ``ranges`` are (name, least, most).
    """
    most = THREADS_PER_CORE * (os.cpu_count() or 1)
    for key, low, high in (*ranges, ("seed", 0, 2**64 - 1), ("threads", 1, most)):
        value = getattr(own, key)
        if value is not None and not low <= value <= high:
            raise InvalidInput(key, value, f"use {low} to {high}")
    for key in positive:
        value = getattr(own, key)
        if value is not None and not (isfinite(value) and value > 0):
            raise InvalidInput(key, value, "must be a finite number > 0")


@dataclass(frozen=True)
class MonteCarlo(StationaryMotionMethod, Transients, Passages):
    """Simulation of Eq. (6) with sampling errors from independent batches.

    Times are in the unit of time of the system, but for ``seconds`` and ``longest`` (wall time).

    ``paths`` trajectories are sampled for ``time`` each, after ``burn_in`` relaxation times.
    ``time`` None: ``relaxations`` relaxation times, but no more than the cost of ``most_steps``
    uniform steps. ``dt`` None: ``step_factor`` times the step chosen for the system.
    ``tol``: go on until the expected L1 error of the first observable, as it is returned at points,
    is below it, at most ``longest`` seconds. ``seconds``: go on for so long instead. Both hold for
    all that follows the compiling: an answer whose burn-in or first chunk they cut short is not
    certified and says so.
    ``step_pair``: run a second simulation at dt/2, in two thirds of ``seconds``, and report the
    difference of each density and moment.
    ``threads`` None: all that there are. ``cluster``: the address of a Dask scheduler; the answer
    depends on neither. ``checkpoint``: a folder where the state is saved at intervals and read
    again. ``partial``: Ctrl-C ends the sampling with what there is, not certified.
    ``allow_unstable``: take a ``dt`` at or above the stability limit; nothing is certified then. ::

        fpk.solve(system, ["q2"], methods=[MonteCarlo(paths=4096, relaxations=40.0, seed=7)])

    Motion in time; the second mass has the row 1::

        short, times = MonteCarlo(paths=4096, relaxations=5.0), np.array([5.0, 10.0])
        at = np.linspace(0.0, 1.0, 5)
        short.passage(system, parse_limit("H=0.3", 2), REST, times).mean
        short.transient(system, parse_observable("H", 2), REST, times, (at,)).values
        q2 = parse_observable("q2", 2)
        short.crossings(system, q2, at).values, short.correlation(system, q2, at).values
        short.spectrum(system, q2, at).values

    Raises ``InvalidInput`` naming the field that cannot be used.
    """

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
        times = ("time", "relaxations", "burn_in", "dt", "step_factor", "longest", "seconds")
        check_settings(
            self, (*times, "tol", "most_steps"), ("paths", LEAST_PATHS, MAX_TRAJECTORIES)
        )

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

        def solve(
            observables: Sequence[Observable], beside: Sequence[Observable], progress: Progress
        ) -> Result:
            # Compiled code and what it needs are imported by those who simulate only.
            run = import_module("sim.simulation").run
            result: Result = run(self, system, observables, progress, beside=beside)
            return result

        return Plan(lambda _: None, lambda observables, p: solve(observables, (), p), solve)

    def _passage(self, asked: PassageAsked) -> Passage:
        """Return first passage: Brownian bridges or cubics between steps; see ``sim.motion``."""
        answer: Passage = self._sampled("passage", asked)
        return answer

    def _transient(self, asked: TransientAsked) -> Transient:
        """Return densities at ``times`` from histograms of an ensemble; see ``sim.motion``."""
        answer: Transient = self._sampled("transient", asked)
        return answer

    def _crossings(self, asked: Question) -> Curve:
        """Return upcrossing rates, counted between steps too; see ``sim.motion``."""
        answer: Curve = self._sampled("crossings", asked)
        return answer

    def _spectrum(self, asked: Question) -> Curve:
        """Return power spectral densities by Welch's method; see ``sim.motion``."""
        answer: Curve = self._sampled("spectrum", asked)
        return answer

    def _correlation(self, asked: Question) -> Curve:
        """Return autocovariances from products at a distance in time; see ``sim.motion``."""
        answer: Curve = self._sampled("correlation", asked)
        return answer

    def _sampled(self, what: str, asked: Question | AfterStart) -> Any:
        return getattr(import_module(f"sim.motion.{what}"), what)(self, asked)

    def refined(self) -> "MonteCarlo":
        """Return the method with four times the sample: half the sampling error.

        A chosen step shrinks by 2**(−1/4), so that the bias of the default scheme halves, too.
        """
        return replace(
            self,
            time=self.time and 4.0 * self.time,
            relaxations=4.0 * self.relaxations,
            most_steps=5 * self.most_steps,  # 4 times the time, in steps 2**(−1/4) as long
            tol=self.tol and 0.5 * self.tol,
            longest=4.0 * self.longest,
            seconds=self.seconds and 4.0 * self.seconds,
            step_factor=self.step_factor * 2.0**-0.25,
        )


register(
    Route(
        method="montecarlo",
        solver="simulation",
        words="simulation",
        equation="(6)",
        solves="full",
        sampled=True,
        colour="#b50c01",
        make=MonteCarlo,
    )
)
