"""Answers about motion in time: curves and relaxation rates of stationary motion, Rice's formula,
densities in time and first passage from a start."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from fpk.answer.certificate import (
    DISTANCE_FACTOR,
    Certificate,
    Measured,
    certify,
    fail_nan,
    largest_measured,
)
from fpk.answer.density import AnyDensity, Density
from fpk.answer.quantities import ErrorKind, Number
from fpk.answer.sampled_density import SampledDensity
from fpk.numeric.arrays import EPS, SMALLEST, Array, Complexes
from fpk.numeric.errors import InvalidInput, require
from fpk.numeric.quadrature import GAUSS_RULES, gauss_grid

START_POINTS = 101
"""Number of start energies, from rest to the limit, at which passage moments are given."""
BEYOND_RANGE = "the mean time to it is beyond the range of double precision; take a lower one"
"""Message for a limit that is hardly ever reached."""
NO_NOISE_YET = "no noise has acted yet: there is no density"
"""Message for a time up to which the modulation is 0."""
LARGEST_ERROR = 0.1
"""Largest absolute error of a certified P(T > t); relative or L1 error above which a density counts
as unknown: its stated errors are then infinite."""


@dataclass(frozen=True)
class Curve:
    """Values (points,) of a function of level, frequency or lag, with one certificate for all.

    ``errors`` (points,) are absolute: numerical estimates, or standard errors of sampling. ::

        free = fpk.System([1.0], [1.0], [0.1], [0.05])
        spectrum = Linear().spectrum(free, parse_observable("q1", 1), np.linspace(0.0, 2.0, 21))
        spectrum.values, spectrum.errors, spectrum.certificate.certified
    """

    values: Array
    errors: Array
    certificate: Certificate
    settings: Mapping[str, str | float | int] = field(default_factory=dict)
    error_kind: ErrorKind = "numerical"

    def __post_init__(self) -> None:
        """Add a failure to the certificate if a value or an error is NaN; raise nothing."""
        fail_nan(self)


@dataclass(frozen=True)
class Rates:
    """Smallest eigenvalues λ ≠ 0 of −L, L the generator, ascending by their real parts, (rates,).

    Correlations decay as e^(−λt). A conjugate pair is represented by its λ with Im λ > 0;
    ``errors`` (rates,) are estimates of |λ − λ_exact|. ::

        rates = NonIntegrable().relaxation(system, 3)
        rates.values, rates.errors
    """

    values: Complexes
    errors: Array
    certificate: Certificate
    settings: Mapping[str, str | float | int] = field(default_factory=dict)


def certify_rates(
    values: Array | Complexes,
    errors: Array,
    *,
    tol: float,
    residual: float | None = None,
    settings: Mapping[str, str | float | int] | None = None,
) -> Rates:
    """Return rates ``values`` and their absolute ``errors``, (rates,) each, with a certificate.

    ``tol`` is the largest certified error/|λ|; ``residual`` is relative to the terms of the
    eigenvalue equation, ``settings`` are for readers.
    """
    relative = float(np.max(errors / np.abs(values)))
    certificate = certify(Measured(relative, None, None, residual, None), tol=tol)
    return Rates(np.asarray(values, dtype=complex), errors, certificate, settings or {})


def certify_curve(
    values: Array,
    errors: Array,
    *,
    scale: float,
    of: Density,
    tol: float,
    residual: float | None = None,
    failures: tuple[str, ...] = (),
    settings: Mapping[str, str | float | int] | None = None,
    positive: Array | None = None,
) -> Curve:
    """Return a curve that follows from the stationary density ``of``, with its certificate.

    ``values`` and ``errors`` are (points,); ``tol`` is the largest error in units of ``scale`` > 0.
    The certificate takes over mass, tail and failures of the density, except a missed tolerance,
    adds ``failures``, and has the larger residual. ``positive`` (points,), by default ``values``,
    must not be below 0 by more than the largest error. ``settings`` are for readers.
    """
    relative, given = float(np.max(errors)) / scale, of.certificate
    least = float(np.min(values if positive is None else positive)) / scale
    residual, words = largest_measured((residual, given.residual)), (*given.besides, *failures)
    numbers = relative, given.mass_defect, least, residual, given.tail_mass
    measured = Measured(*numbers, failures=words, absolute_error=relative)
    return Curve(values, errors + SMALLEST, certify(measured, tol=tol), settings or {})


def upcrossings(joint: AnyDensity, mass: float, at: Array) -> tuple[Array, Array]:
    """Return Rice's rates ∫_0^∞ (p/m) f(q, p) dp at q = ``at``, and their errors, (points,) each.

    f is the density ``joint`` of q and p, m the ``mass``. For samples the error is one standard
    error. Otherwise it is the sum of the integrated error of f, the distance to coarser rules and
    the tail beyond the last momentum, where f is continued with the slope of its last panel. It is
    infinite if f neither falls there nor is 0 within its error.
    """
    nodes = np.unique(np.maximum(joint.panels[1], 0.0))
    if isinstance(joint, SampledDensity):
        return joint.flux(lambda p: p / mass, nodes, at)
    rates = []
    for points in GAUSS_RULES[1]:
        _, [(p, w)] = gauss_grid([nodes], points=points)
        density, error = joint.at(at[:, None], p)
        rates.append((density @ (w * p / mass), error @ (w * p / mass)))
    *coarser, (value, own) = rates
    missed = sum(np.abs(value - other) for other, _ in coarser)
    last = nodes[-2:]
    density, error = joint.at(at[:, None], last)
    (before, end), known = np.abs(density).T, error[:, 1]
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        falls = (last[1] - last[0]) / np.log(before / end)
    both = np.broadcast_arrays(falls, last[1])  # the smaller, if f falls and is 0 within its error
    length = np.where([before > end, end <= known], both, np.inf).min(axis=0)
    beyond = (end + known) * length * (last[1] + length)
    return value, own + DISTANCE_FACTOR * missed + beyond / mass


def require_times(times: Array, *, positive: bool = False) -> Array:
    """Return ``times``, empty or not; raise ``InvalidInput`` unless they are finite, strictly
    ascending and >= 0, or > 0 if ``positive``."""
    if not (np.all(np.isfinite(times)) and np.all(times >= 0.0) and np.all(np.diff(times) > 0.0)):
        raise InvalidInput("times", times, "must be finite, 0 or later, and ascend")
    remedy = "must be > 0: there is no density at time 0, or it is that of the start"
    require(not (positive and times.size and times[0] == 0.0), "times", 0.0, remedy)
    return times


@dataclass(frozen=True)
class Transient:
    """Densities of one observable at given points at several ``times`` after a start.

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
        """Add a failure to the certificate if a value or an error is NaN; raise nothing."""
        fail_nan(self)


def transient_of(
    times: Array,
    densities: Sequence[Density],
    at: Sequence[tuple[Array, Array]],
    *,
    tol: float,
    settings: Mapping[str, str | float | int] | None = None,
) -> Transient:
    """Return the transient of one density for each of ``times``, with one certificate.

    ``at`` are values and errors (points,) for each time. Of every measured number the certificate
    has the worst, and the failures of all densities but a missed tolerance, which it judges itself
    by ``tol``.
    """
    own = [p.certificate for p in densities]
    measured = Measured(
        l1_error=max(c.l1_error for c in own),
        mass_defect=largest_measured(c.mass_defect for c in own),
        minimum=min(c.minimum for c in own if c.minimum is not None),
        residual=largest_measured(c.residual for c in own),
        tail_mass=largest_measured(c.tail_mass for c in own),
        failures=tuple(dict.fromkeys(words for c in own for words in c.besides)),
        absolute_error=max(c.absolute_error for c in own),
    )
    values, errors = np.array(at).transpose(1, 0, 2)
    certificate = certify(measured, tol=tol)
    return Transient(times, values, errors + SMALLEST, "numerical", certificate, settings or {})


@dataclass(frozen=True)
class Passage:
    """First passage of a limit at the time T: its moments, the failure rate, the reliability.

    ``rate`` is −d ln P(T > t)/dt for t → ∞, the least eigenvalue with an absorbing limit; None if
    the method does not compute it. ``mean`` and ``variance`` are inf if some motions never fail.
    ``survival`` is P(T > t) at ``times``, with ``survival_error``, (times,) each. ``failure`` is
    P(T <= t), with ``failure_error``, if the method computes it more accurately than
    1 − ``survival``. ``starts``: the moments as functions of the start energy, if computed: arrays
    (starts,) named ``starts``, ``mean``, ``mean_error``, ``variance``, ``variance_error``.
    ``error_kind``: estimate of the numerical error, or one standard error of sampling. ::

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
    starts: Mapping[str, Array] | None = None
    settings: Mapping[str, str | float | int] = field(default_factory=dict)
    failure: Array | None = None
    failure_error: Array | None = None

    def __post_init__(self) -> None:
        """If a ``survival_error`` exceeds ``LARGEST_ERROR`` or is NaN, add a failure to the
        certificate, unless it has failures already."""
        unknown = np.flatnonzero(~(self.survival_error <= LARGEST_ERROR))
        if unknown.size and self.certificate.certified:
            k = unknown[0]
            error = f"{self.survival_error[k]:.2g}, more than {LARGEST_ERROR:g}"
            words = f"the error of P(T > {self.times[k]:g}) is {error}"
            object.__setattr__(self, "certificate", self.certificate.with_failures(words))


def certify_passage(
    numbers: tuple[Number, Number, Number | None],
    times: Array,
    failure: Array,
    failure_error: Array,
    *,
    tol: float,
    mass_defect: float | None = None,
    residual: float | None = None,
    starts: Sequence[Array] | None = None,
    settings: Mapping[str, str | float | int] | None = None,
) -> Passage:
    """Return a first passage computed numerically, with its certificate.

    ``numbers`` are mean and variance of T and the failure rate; ``failure`` is P(T <= t) at
    ``times``, with ``failure_error``, (times,) each. ``tol`` bounds relative errors of the finite
    numbers and absolute errors of the probabilities; ``mass_defect`` and ``residual`` are defined
    in ``Measured``. ``starts`` are five arrays (starts,): the start energies, then mean, its error,
    variance and its error from each. ``settings`` are for readers.
    """
    finite = [(x.value, x.error) for x in numbers if x and x.value != np.inf]
    value, error = np.array(finite).reshape(-1, 2).T
    with np.errstate(divide="ignore", invalid="ignore"):
        sizes = error / np.abs(value)
    absolute = float(np.max(failure_error, initial=0.0))
    largest = float(np.max([*sizes, absolute]))
    least = float(np.min(1.0 - failure, initial=1.0))
    measured = Measured(largest, mass_defect, least, residual, None, absolute_error=absolute)
    survival, certificate = (1.0 - failure, failure_error + EPS), certify(measured, tol=tol)
    names = "starts", "mean", "mean_error", "variance", "variance_error"
    curves = None if starts is None else dict(zip(names, starts, strict=True))
    answer = Passage(*numbers, times, *survival, "numerical", certificate, curves, settings or {})
    return replace(answer, failure=failure, failure_error=failure_error)
