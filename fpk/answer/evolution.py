"""Answers about a motion that begins at a given time: transient densities and first passage."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from fpk.answer.certificate import Certificate, Measured, certify, forbid_nan
from fpk.answer.quantities import ErrorKind, Number
from fpk.numeric.arrays import EPS, Array
from fpk.numeric.errors import InvalidInput

STARTS = 101
"""Starts at which moments are given as a curve, from rest to the limit."""
BEYOND_RANGE = "the mean time to it is beyond the range of double precision; take a lower one"
"""Why a limit is refused that is hardly ever reached."""
NO_NOISE_YET = "no noise has acted yet: there is no density"
"""Why a time is refused before which a modulation is 0."""
LARGEST_ERROR = 0.1
"""Error of a probability above which it is not certified, some tenths tell no two scenes apart; and
L1 error above which nothing is known of a density: its errors are then infinite."""


def checked_times(times: Array, *, positive: bool = False) -> Array:
    """Return ``times`` if finite, 0 (``positive``: not 0) or later, and ascending, else raise."""
    if not (np.all(np.isfinite(times)) and np.all(times >= 0.0) and np.all(np.diff(times) > 0.0)):
        raise InvalidInput("times", times, "must be finite, 0 or later, and ascend")
    if positive and times.size and times[0] == 0.0:
        remedy = "must be > 0: there is no density at time 0, or it is that of the start"
        raise InvalidInput("times", 0.0, remedy)
    return times


@dataclass(frozen=True)
class Transient:
    """Densities at several times at the points asked for.

    ``values`` and ``errors`` are (times, points); ``error_kind`` says whether an error is an
    estimate of the numerical error or one standard error of sampling. ::

        times, energies = np.array([1.0, 10.0]), np.linspace(0.1, 1.0, 10)
        H = parse_observable("H", 2)
        p = NonIntegrable().transient(system, H, REST, times, (energies,))
        p.values, p.errors, p.certificate.certified
    """

    times: Array
    values: Array
    errors: Array
    error_kind: ErrorKind
    certificate: Certificate
    settings: Mapping[str, str | float | int] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Let no NaN be certified."""
        forbid_nan(self)


@dataclass(frozen=True)
class StartCurve:
    """Moments of the first-passage time over the energies of ``starts``, (starts,) each."""

    starts: Array
    mean: Array
    mean_error: Array
    variance: Array
    variance_error: Array


@dataclass(frozen=True)
class Passage:
    """First passage of a limit: moments of its time T, the failure rate, the reliability.

    ``rate`` is −d ln P(T > t)/dt for t → ∞, the least eigenvalue with an absorbing limit, None
    where the method does not give it. Where some never fail ``mean`` and ``variance`` are inf.
    ``survival`` is P(T > t) at ``times``, with ``survival_error``, (times,) each; where the method
    knows it better than 1 − ``survival``, ``failure`` is P(T <= t), with ``failure_error``.
    ``starts`` has moments for all starts at once where the method gives them. ``error_kind`` as of
    ``Transient``. ::

        limit, times = parse_limit("H=1", 2), np.array([10.0, 100.0])
        first = NonIntegrable().passage(system, limit, REST, times)
        first.mean.value, first.rate.value, first.survival, first.survival_error
    """

    mean: Number
    variance: Number
    rate: Number | None
    times: Array
    survival: Array
    survival_error: Array
    error_kind: ErrorKind
    certificate: Certificate
    starts: StartCurve | None = None
    settings: Mapping[str, str | float | int] = field(default_factory=dict)
    failure: Array | None = None
    failure_error: Array | None = None

    def __post_init__(self) -> None:
        """Certify no probability whose error is above ``LARGEST_ERROR``."""
        unknown = np.flatnonzero(~(self.survival_error <= LARGEST_ERROR))
        if unknown.size and self.certificate.certified:
            k = unknown[0]
            words = f"P(T > {self.times[k]:g}) is known to {self.survival_error[k]:.2g} only"
            object.__setattr__(self, "certificate", self.certificate.with_failures(words))


def certified_passage(
    numbers: tuple[Number, Number, Number | None],
    times: Array,
    failure: Array,
    failure_error: Array,
    *,
    tol: float,
    mass_defect: float | None = None,
    residual: float | None = None,
    starts: StartCurve | None = None,
    settings: Mapping[str, str | float | int] | None = None,
) -> Passage:
    """Return a numerical answer of mean, variance and failure rate, and P(T <= t) at ``times``.

    ``tol`` judges relative errors of the finite numbers, absolute errors of the probabilities.
    """
    finite = [(x.value, x.error) for x in numbers if x and x.value != np.inf]
    value, error = np.array(finite).reshape(-1, 2).T
    with np.errstate(divide="ignore", invalid="ignore"):
        sizes = error / np.abs(value)
    worst = float(np.max(failure_error, initial=0.0))
    largest = float(np.max([*sizes, worst]))
    least = float(np.min(1.0 - failure, initial=1.0))
    measured = Measured(largest, mass_defect, least, residual, None, absolute_error=worst)
    survival, certificate = (1.0 - failure, failure_error + EPS), certify(measured, tol=tol)
    answer = Passage(*numbers, times, *survival, "numerical", certificate, starts, settings or {})
    return replace(answer, failure=failure, failure_error=failure_error)
