"""Rounds of sampled trajectories until an answer is good enough, and the curves that follow."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from math import ceil, inf
from typing import Any

import numpy as np

from fpk.answer.certificate import Measured, certify, tolerance
from fpk.answer.dynamics import Curve
from fpk.answer.question import Asked
from fpk.answer.start import Start
from fpk.numeric.arrays import Array
from fpk.numeric.errors import InvalidInput
from fpk.numeric.machine import left_out, usable_cores, working_time
from fpk.system.system import System
from sim.questions.starts import drawn_states
from sim.sample.checkpoint import interruptible
from sim.sample.ensemble import Ensemble, Reader, ensemble_from
from sim.sample.settings import LEAST_PATHS, Settings
from sim.sample.workers import workers_of
from sim.step.arrays import LANES, in_rows
from sim.step.random import GOLDEN

MOST_STEPS, MOST_SAMPLES = 1 << 22, 64
"""Steps of all trajectories, and samples of each, after which the wall time is looked at: some ten
milliseconds, and a tenth of a second where ``MOST_SUMS`` numbers are summed."""

MOST_SUMS = 1 << 23
"""Numbers that the windows of one round hold, 64 MB; of two blocks at the least, for an error."""


@dataclass(eq=False)
class Watch:
    """Goes on until an error is ``tol``, or for ``seconds`` of wall time, or to Ctrl-C.

    With a ``tol`` the ``seconds`` are a limit; ``stopped()`` says that an answer that may be
    partial is to end.
    """

    seconds: float
    stopped: Callable[[], bool]
    tol: float | None = None
    begin: float = field(default_factory=working_time)

    def ends(self) -> bool:
        """Return whether it is time to stop."""
        return bool(self.stopped()) or working_time() - self.begin > self.seconds

    def until(
        self, answer: Callable[[int], float | None], *, least: int = 1, most: float = inf
    ) -> None:
        """Call ``answer`` with 0, 1, … at least so often until the error it returns is met.

        Where it is time to stop before, or it was called ``most`` times, that is the end; so it is
        where an ``answer`` was cut short and returns None.
        """
        number = 0
        while (error := answer(number)) is not None:
            number += 1
            more = error > self.tol if self.tol is not None else self.seconds < inf
            if (number >= least and not more) or number >= most or self.ends():
                return

    def require(self, what: str, share: float) -> None:
        """Raise ``InvalidInput`` where it is time to stop and only a ``share`` of ``what`` is done.

        Without all of it there is no answer.
        """
        if not self.ends():
            return
        if self.stopped():
            raise KeyboardInterrupt
        taken = working_time() - self.begin
        needed = f"which takes about {taken / share:.2g} s" if share > 0.0 else "which takes longer"
        raise InvalidInput("seconds", self.seconds, f"are over in {what}, {needed}; give it more")

    def interruption(self) -> list[str]:
        """Return that Ctrl-C came, in words, if it did."""
        return ["partial: interrupted by Ctrl-C"] if self.stopped() else []


@contextmanager
def working(
    method: Settings, system: System, tol: float | None, start: Start | None = None
) -> Iterator[tuple[Any, ...]]:
    """Yield workers, the watch, and what draws states of the ``start`` (None: stationary ones).

    It is called with the number of trajectories and that of their round.
    """
    start = start or Start("noise", {"noise": 1.0})
    seconds = method.seconds or (method.longest if tol is not None else inf)
    with (
        workers_of(method.cluster, method.threads or usable_cores()) as workers,
        interruptible(method.partial) as stopped,
    ):
        watch = Watch(seconds, stopped, tol)
        burn_in: Any = {"burn_in": method.burn_in, "workers": workers, "watch": watch}
        yield workers, watch, partial(drawn_states, system, start, method.seed, **burn_in)


def seed_of(seed: int, number: int) -> int:
    """Return the seed of round ``number`` of trajectories."""
    return (seed + number * int(GOLDEN)) % 2**64


Simulation = tuple[float, int, bool, int, Reader]
"""One of the simulations of a round, by the same random numbers: its step, how many lie between
samples, whether it is ``halved``, from which step to the next states are read, and the reader."""


def in_rounds(
    method: Settings,
    asked: Asked,
    simulations: Sequence[Simulation],
    samples: int,
    numbers: tuple[int, ...],
    estimate: Callable[[list[Array], Array, int], float],
    what: str,
    *,
    least: int = 0,
) -> tuple[int, list[str]]:
    """Follow trajectories until ``estimate`` is content; return how many, and what went wrong.

    A round is a window of ``samples`` of trajectories that have not been followed before. With
    ``least`` it is a chunk of a window, of which there are so many; the trajectories stay the same,
    and go on after it in chunks as long. Of each block a simulation is read into ``numbers``, a
    shape. ``estimate`` is given these (blocks, …) of each simulation, the mean squares of (q, p) at
    the end, and the number of samples; it returns the error of all there is, in the unit of the
    tolerance. A window that the time cuts short is not counted, and the first one is refused by
    ``InvalidInput``; a chunk is counted.
    """
    system, onward = asked.system, least > 0
    paths = -(-method.paths // LANES) * LANES
    size = len(simulations) * int(np.prod(numbers))
    own = paths if onward else max(2, min(paths // LANES, MOST_SUMS // size)) * LANES
    least = least or ceil(paths / own)
    piece = max(1, min(MOST_SAMPLES, MOST_STEPS // (own * simulations[0][1])))
    rounds, running = 0, list[Ensemble]()

    def followed(number: int) -> float | None:
        nonlocal rounds, running
        if not (onward and running):
            seed, (q, p) = seed_of(method.seed, number), origin(own, number)
            with left_out():
                running = [
                    ensemble_from(system, q, p, dt, seed, halved=halved, workers=workers)
                    for dt, _, halved, _, _ in simulations
                ]
        sums, done = [np.zeros((own // LANES, *numbers)) for _ in simulations], 0
        first, last = (samples * k // least for k in (number, number + 1))
        wanted = max(1, last - first) if onward else samples
        while done < wanted and not (done and watch.ends()):
            many = min(piece, wanted - done)
            for ensemble, of, array in zip(running, simulations, sums, strict=True):
                _, steps, _, stride, read = of
                ensemble.advance(many * steps, array, stride=stride, read=read)
            done += many
        whole = done == wanted
        if not (whole or onward):
            if not number:
                watch.require(f"the first {own} windows", done / wanted)
            return None
        rounds += whole
        states = in_rows(running[0].last)[:, : 2 * system.n]
        error = estimate(sums, np.mean(states**2, axis=0), done)
        asked.progress(min(rounds, least), least, what)
        return error if whole else None

    with working(method, system, tolerance(asked.tol, method.tol)) as (workers, watch, origin):
        watch.until(followed, least=least)
        failures = watch.interruption()
    paths = own if onward else rounds * own
    if paths < LEAST_PATHS:
        failures.append(f"it ended after {paths} trajectories of {LEAST_PATHS}")
    return paths, failures


def error_of(blocks: Array) -> Array:
    """Return one standard error of the mean of independent ``blocks`` (blocks, ...)."""
    return np.asarray(blocks.std(axis=0, ddof=1) / np.sqrt(len(blocks)))


def sampled_curve(
    values: Array,
    errors: Array,
    scale: float,
    tol: float | None,
    failures: Sequence[str],
    settings: dict[str, str | float | int],
    positive: Array | None = None,
) -> Curve:
    """Return a curve with one standard error each; the rest as of ``certified_curve``."""
    relative = float(np.max(errors)) / scale
    measured = Measured(
        l1_error=relative,
        mass_defect=None,
        minimum=float(np.min(values if positive is None else positive)) / scale,
        residual=None,
        tail_mass=None,
        failures=tuple(failures),
        absolute_error=relative,
    )
    certificate = certify(measured, tol=inf if tol is None else tol, sampled=True)
    return Curve(values, errors, certificate, settings, error_kind="sampling")
