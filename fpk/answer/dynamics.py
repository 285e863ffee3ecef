"""Answers about the stationary motion in time: curves and relaxation rates, and Rice's formula."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from fpk.answer.certificate import Certificate, Measured, certify, forbid_nan, worst
from fpk.answer.density import RULES, SAFETY, AnyDensity, Density
from fpk.answer.quantities import ErrorKind
from fpk.answer.sampled_density import SampledDensity
from fpk.numeric.arrays import SMALLEST, Array, Complexes
from fpk.numeric.quadrature import gauss_grid


@dataclass(frozen=True)
class Curve:
    """Values at the points asked for, and the certificate of all of them.

    Each has an estimate of its numerical error, or one standard error of sampling. ::

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
        """Let no NaN be certified."""
        forbid_nan(self)


@dataclass(frozen=True)
class Rates:
    """Eigenvalues λ of −L, L the generator, in ascending order of their real parts.

    Correlations fall as e^(−λt). Of a conjugate pair the one with Im λ > 0 stands for both. ::

        rates = NonIntegrable().relaxation(system, 3)
        rates.values, rates.errors
    """

    values: Complexes
    errors: Array
    certificate: Certificate
    settings: Mapping[str, str | float | int] = field(default_factory=dict)


def certified_rates(
    values: Array | Complexes,
    errors: Array,
    *,
    tol: float,
    residual: float | None = None,
    settings: Mapping[str, str | float | int] | None = None,
) -> Rates:
    """Return rates with their certificate; ``tol`` is relative to each."""
    relative = float(np.max(errors / np.abs(values)))
    certificate = certify(Measured(relative, None, None, residual, None), tol=tol)
    return Rates(np.asarray(values, dtype=complex), errors, certificate, settings or {})


def certified_curve(
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
    """Return a curve that rests on the stationary density ``of``, with its certificate.

    ``tol`` is the largest error in units of ``scale``, not 0. The density gives mass, tail and
    failures, its missed tolerance apart; the larger residual counts. ``positive`` (None: the
    values) must not be negative by more than the error.
    """
    relative, given = float(np.max(errors)) / scale, of.certificate
    least = float(np.min(values if positive is None else positive)) / scale
    residual, words = worst((residual, given.residual)), (*given.besides, *failures)
    numbers = relative, given.mass_defect, least, residual, given.tail_mass
    measured = Measured(*numbers, failures=words, absolute_error=relative)
    return Curve(values, errors + SMALLEST, certify(measured, tol=tol), settings or {})


def upcrossings(joint: AnyDensity, mass: float, at: Array) -> tuple[Array, Array]:
    """Return Rice's rates ∫_0^∞ (p/m) f(q, p) dp of a joint density f at q = ``at``, and errors.

    The error holds the integrated error of f, the distance of coarser rules and the tail beyond the
    last momentum, if f falls as over the last panel: infinite where it does not and is not 0 within
    its error. Of samples it is one standard error.
    """
    nodes = np.union1d(0.0, joint.panels[1][joint.panels[1] > 0.0])
    if isinstance(joint, SampledDensity):
        return joint.flux(lambda p: p / mass, nodes, at)
    rates = []
    for points in RULES[1]:
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
    length = np.where(before > end, falls, np.where(end <= known, last[1], np.inf))
    beyond = (end + known) * length * (last[1] + length)
    return value, own + SAFETY * missed + beyond / mass
