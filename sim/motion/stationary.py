"""Steps shared by sampled spectra, autocovariances and crossings, from starts to the curve."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from math import inf
from time import perf_counter
from typing import Any

import numpy as np

from fpk.arrays import Array
from fpk.certificate import Measured, certify
from fpk.cores import usable_cores
from fpk.dynamics import Curve
from fpk.errors import InvalidInput
from fpk.escape import escape
from fpk.start import Start
from fpk.system import System
from sim.checkpoint import interruptible
from sim.ensemble import MAX_COORDINATE
from sim.montecarlo import MonteCarlo
from sim.motion.starts import Origin
from sim.workers import workers_of

STATIONARY = Start("noise", {"noise": 1.0})


@dataclass(eq=False)
class Watch:
    """Stop at Ctrl-C, where an answer may be partial, and when ``seconds`` have passed."""

    seconds: float
    stopped: Any
    begin: float

    def ends(self) -> bool:
        """Return whether it is time to stop."""
        return bool(self.stopped()) or perf_counter() - self.begin > self.seconds

    def require(self, what: str, share: float) -> None:
        """Raise ``InvalidInput`` where it is time to stop and only a ``share`` of ``what`` is done.

        Without all of it there is no answer.
        """
        if not self.ends():
            return
        if self.stopped():
            raise KeyboardInterrupt
        taken = perf_counter() - self.begin
        needed = f"which takes about {taken / share:.2g} s" if share > 0.0 else "which takes longer"
        raise InvalidInput("seconds", self.seconds, f"are over in {what}, {needed}; give it more")

    @contextmanager
    def held(self) -> Iterator[None]:
        """Do not count the time of what is within: of compiling."""
        now = perf_counter()
        yield
        self.begin += perf_counter() - now


@contextmanager
def working(
    method: MonteCarlo, system: System, tol: float | None, start: Start = STATIONARY
) -> Iterator[tuple[Any, ...]]:
    """Yield workers, the watch, and what draws states of the ``start``."""
    seconds = method.seconds or (method.longest if tol is not None else inf)
    with (
        workers_of(method.cluster, method.threads or usable_cores()) as workers,
        interruptible(method.partial) as stopped,
    ):
        watch = Watch(seconds, stopped, perf_counter())
        yield workers, watch, Origin(system, start, method.seed, method.burn_in, workers, watch)


def not_met(method: MonteCarlo, tol: float | None, error: float) -> bool:
    """Return whether the error is too large, or the time that was asked for not over."""
    return error > tol if tol is not None else bool(method.seconds)


def error_of(blocks: Array) -> Array:
    """Return one standard error of the mean of independent ``blocks`` (blocks, ...)."""
    return np.asarray(blocks.std(axis=0, ddof=1) / np.sqrt(len(blocks)))


def interruption(watch: Watch) -> list[str]:
    """Return that Ctrl-C came, in words, if it did."""
    return ["partial: interrupted by Ctrl-C"] if watch.stopped() else []


def losses(states: Array, dt: float) -> list[str]:
    """Return how many ``states`` (paths, 2n) left the finite range, in words, if some did."""
    return lost_words(int(np.count_nonzero(~(np.abs(states) < MAX_COORDINATE).all(axis=1))), dt)


def lost_words(lost: int, dt: float, system: System | None = None) -> list[str]:
    """Return how many trajectories left the finite range, in words, if some did, and what to do.

    Where the motion of ``system`` escapes it is the reason, which no step changes.
    """
    reason = system and system.fact(escape)
    remedy = f": {reason}" if reason else f"; use a smaller dt than {dt:g}"
    return [f"{lost} trajectories left the finite range{remedy}"] if lost else []


def sampled_curve(
    values: Array, errors: Array, scale: float, tol: float | None, failures: list[str],
    settings: dict[str, str | float | int], positive: Array | None = None,
) -> Curve:  # fmt: skip
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
