"""One simulation as it is asked for: everything that its numbers depend on."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from math import ceil, inf
from typing import Literal

from fpk.answer.observable import Observable
from fpk.numeric.errors import InvalidInput
from fpk.numeric.machine import usable_cores
from fpk.system.system import System
from sim.sample.checkpoint import Checkpoint, checkpoint_of
from sim.sample.histogram import Histogram
from sim.sample.plan import cost, with_long_steps
from sim.sample.settings import NOT_IN_STATE, Settings, require_stationary
from sim.step.schemes import SCHEMES, Scheme
from sim.step.step_size import (
    SAMPLE_SECONDS,
    STEP_SECONDS,
    chosen_step,
    expected_error,
    relaxation_time,
    samples_in,
    sampling_interval,
    stability_limit,
    step_for,
)


@dataclass(frozen=True, eq=False)
class Setup:
    """Everything that the numbers of one simulation of Eq. (6) depend on; times of the system.

    ``dt`` is the long step where ``scheme`` makes small ones. Each trajectory is sampled for
    ``time`` or, where that is finite, until ``seconds`` of wall time have passed or the expected
    L1 error of the first observable is below ``tol``. ``histograms`` None: bins that cover what a
    pilot reaches. ``division`` says which trajectories make small steps, ``limited_by`` what
    cut ``time`` short, and ``failures`` are reasons not to certify an answer.
    """

    method: Settings
    system: System
    observables: Sequence[Observable]
    scheme: Scheme
    dt: float
    time: float
    tol: float = inf
    seconds: float = inf
    histograms: tuple[Histogram, ...] | None = None
    division: str = ""
    limited_by: Literal["", "most_steps"] = ""
    failures: tuple[str, ...] = ()

    @property
    def open(self) -> bool:
        """Whether the length is not known before."""
        return self.seconds < inf

    @cached_property
    def stride(self) -> int:
        """Steps from one sample to the next: closer ones are nearly equal, and cost time each."""
        return max(1, round(sampling_interval(self.system) / self.dt))

    @cached_property
    def burn_in_steps(self) -> int:
        """Steps before the sampling begins."""
        return ceil(self.method.burn_in * relaxation_time(self.system) / self.dt)

    def checkpoint(self) -> Checkpoint:
        """Return the checkpoint in the folder of the method; another limit of time may go on."""
        return checkpoint_of(self.method.checkpoint, (self, self.open), less=NOT_IN_STATE)


def default_step(method: Settings, system: System, observables: Sequence[Observable] = ()) -> float:
    """Return the step: short enough for the contact, and for the accuracy the run will reach.

    That follows from ``tol``, from the samples that ``seconds`` of wall time allow by ``threads``,
    or from the sampled time. Not from wall time where there is a checkpoint: a run may go on from
    it with another limit and on another machine; it is then as for an hour of one thread.
    """
    if method.tol is not None:
        return step_for(system, method.tol, observables=observables)
    dt, interval = chosen_step(system), sampling_interval(system)
    if method.seconds is None:
        time = method.time or min(
            method.relaxations * relaxation_time(system), method.most_steps * dt
        )
        error = expected_error(method.paths * time / interval)
        return step_for(system, error, observables=observables)
    own = method.seconds * (method.threads or usable_cores())
    seconds = own if method.checkpoint is None else 3600.0
    for _ in range(8):  # each leaves a fourth of the change at most: h ~ samples^(−1/4) or less
        error = expected_error(samples_in(system, dt, seconds))
        dt = step_for(system, error, observables=observables)
    return dt


def expected_seconds(method: Settings, system: System) -> float:
    """Return about how long a simulation takes, in seconds of wall time, to a factor of three.

    Without compiling, and without what long steps save far from stiff stops. Raises as
    ``require_stationary`` does.
    """
    require_stationary(system)
    dt, relaxation = default_step(method, system), relaxation_time(system)
    time = method.time or min(method.relaxations * relaxation, method.most_steps * dt)
    whole = time + method.burn_in * relaxation
    size = max(1.0, system.n / 3) ** 2  # the map of a step is a full matrix
    samples = whole / max(dt, sampling_interval(system))
    work = STEP_SECONDS * size * whole / dt + SAMPLE_SECONDS * samples
    return method.paths * work / (method.threads or usable_cores())


def setup_of(method: Settings, system: System, observables: Sequence[Observable]) -> Setup:
    """Return the setup that ``method`` asks for; raise ``InvalidInput`` for an unstable step."""
    scheme, failures = SCHEMES[method.scheme], list[str]()
    dt = method.dt or method.step_factor * default_step(method, system, observables)
    # What Euler's rule gains in contact may be lost again out of it.
    limit = stability_limit(system, scheme, touching=scheme.kick_first)
    if not 0.0 < dt < limit:
        remedy = f"must be > 0 and below the stability limit {limit:.4g} of {scheme.name}"
        if not method.allow_unstable:
            raise InvalidInput("dt", dt, remedy)
        failures.append(f"the step {dt:g} was insisted on: it {remedy}")
    relaxation = relaxation_time(system)
    # Of its 2**40 words of random numbers a trajectory takes n a step, 5/4 n with long steps.
    shortest = 2.0**-39 * system.n * (method.burn_in * relaxation + (method.time or 0.0))
    if dt < shortest:
        remedy = f"takes more random numbers than a trajectory has; use at least {shortest:.2g}"
        raise InvalidInput("dt", dt, remedy)
    scheme, long, division = with_long_steps(system, scheme, dt)
    tol = method.tol if method.tol is not None and observables else inf
    own = 3.0 if method.step_pair else 1.0  # half the step takes twice as long
    seconds = method.seconds / own if method.seconds else method.longest if tol < inf else inf
    time = wanted = method.time or method.relaxations * relaxation
    if method.time is None:
        time = min(wanted, method.most_steps * dt / cost(system, dt, scheme.small))
    return Setup(
        method, system, tuple(observables), scheme, dt=long, time=time, tol=tol, seconds=seconds,
        division=division, limited_by="most_steps" if time < wanted else "",
        failures=tuple(failures),
    )  # fmt: skip
