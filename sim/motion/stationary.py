"""Steps shared by sampled spectra, autocovariances and crossings, from starts to the curve."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from math import inf
from typing import Any

import numpy as np

from fpk.arrays import Array
from fpk.certificate import Measured, certify
from fpk.clock import working_time
from fpk.cores import usable_cores
from fpk.dynamics import Curve
from fpk.errors import InvalidInput
from fpk.start import Start
from fpk.system import System
from sim.checkpoint import interruptible
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
        return bool(self.stopped()) or working_time() - self.begin > self.seconds

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
        watch = Watch(seconds, stopped, working_time())
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
