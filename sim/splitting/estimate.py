"""Finished repetitions at two steps, and the probability and error that follow from them."""

from dataclasses import asdict, dataclass, field
from math import exp, hypot, inf, log
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import betaincinv

from fpk.arrays import Array
from sim.splitting.algorithm import Repetition
from sim.splitting.settings import RareFailure, Splitting

DOUBT = 0.05
"""Probability with which the upper bound may be too low."""

DEVIATIONS = 1.645
"""Standard deviations that a normal variable exceeds with that probability."""

RESOLVED = 0.3
"""Relative standard error up to which the spread of a few repetitions tells it."""

LARGEST_SPREAD = 500.0
"""Variance of ln P at most from which an error is made, so that it stays a number."""


@dataclass(eq=False)
class Repetitions:
    """The fields of repetitions at dt and dt/2, (fields, 2, made); NaN where one is not finished.

    ``saved`` and ``restore`` are what a checkpoint needs.
    """

    made: Array = field(default_factory=lambda: np.zeros((len(Repetition._fields), 2, 0)))
    seconds: float = 0.0

    def grow(self, count: int) -> None:
        """Make room for ``count`` repetitions at each step."""
        missing = (0, 0), (0, 0), (0, max(0, count - self.made.shape[2]))
        self.made = np.pad(self.made, missing, constant_values=np.nan)

    def saved(self) -> dict[str, NDArray[Any]]:
        """Return everything, as arrays."""
        return {"made": self.made, "seconds": np.array(self.seconds)}

    def restore(self, saved: dict[str, NDArray[Any]]) -> None:
        """Go on from what ``saved`` returned, from the beginning if that is nothing."""
        if saved:
            self.made, self.seconds = saved["made"], float(saved["seconds"])

    @property
    def whole(self) -> int:
        """How many of the first repetitions are finished at both steps."""
        missing = np.isnan(self.made[0]).any(axis=0)
        return int(np.argmax(missing)) if missing.any() else missing.size


def mean_and_error(log_values: Array) -> tuple[float, float]:
    """Return the mean of exp(``log_values``) (repetitions,) and its standard error.

    Estimates of splitting are nearly log-normal. Of few with a large spread the largest ones are
    missing, and mean and deviation are both too small: the error is that by the variance s² of the
    logarithms, with a share e of zeros ``mean √((e^{s²}/(1 − e) − 1)/count)``, where it is the
    larger one; and inf where it exceeds ``RESOLVED``, as the mean may then be off by decades.
    """
    values = np.exp(log_values)
    mean, error = float(values.mean()), float(values.std(ddof=1))
    positive = log_values[np.isfinite(log_values)]
    if positive.size == 0:
        return 0.0, 0.0
    spread = float(positive.var(ddof=1)) if positive.size > 1 else LARGEST_SPREAD
    square = np.exp(min(spread, LARGEST_SPREAD)) * values.size / positive.size - 1.0
    error = max(error, mean * float(np.sqrt(square))) / float(np.sqrt(values.size))
    return mean, error if error <= RESOLVED * mean else inf


def estimated(done: Repetitions, count: int, *, dt: float, settings: Splitting) -> RareFailure:
    """Return the probability from the first ``count`` repetitions, ``dt`` being the shorter step.

    The bias at dt/2 is at most the difference from dt where it falls as dt or faster. A difference
    below its own standard error counts as that: it may be small by chance.
    """
    (coarse, fine), levels, failures, _ = done.made[:, :, :count]
    unit = float(np.max([coarse, fine]))
    unit = unit if np.isfinite(unit) else 0.0
    (at_long, long_error), (mean, own) = (mean_and_error(x - unit) for x in (coarse, fine))
    own = own or mean / (settings.replicas * count)  # as if one of all paths had not failed
    bias, scale = at_long - mean, exp(unit)
    bias_error = hypot(own, long_error)
    error = hypot(own, max(abs(bias), bias_error))
    bound = (mean + DEVIATIONS * error) * scale
    if not mean > 0.0 or error == inf:
        failed, paths = float(failures[1].sum()), settings.replicas * count
        bound = float(betaincinv(failed + 1.0, paths - failed, 1.0 - DOUBT))  # Clopper, Pearson
    return RareFailure(
        probability=mean * scale,
        error=error * scale if mean > 0.0 else bound,
        upper_bound=bound,
        log_probability=log(mean) + unit if mean > 0.0 else -inf,
        sampling_error=own * scale,
        bias=bias * scale,
        bias_error=bias_error * scale,
        values=np.exp(fine),
        extinct=int(np.sum(~np.isfinite(fine))),
        levels=float(levels[1].mean()),
        dt=dt,
        steps=int(np.nansum(done.made[3])),
        seconds=done.seconds,
        settings={k: v for k, v in asdict(settings).items() if isinstance(v, (int, float, str))},
    )
