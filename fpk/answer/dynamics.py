"""The stationary motion in time: crossings, power spectra, autocovariances, relaxation rates.

A ``Method`` gives crossing rates if it is a ``CrossingsMethod``, power spectra and autocovariances
if it is a ``StationaryMotionMethod``, and relaxation rates if it is one of ``Relaxation``. In all
of them ``tol`` is the largest error wanted: of curves in units of a natural size of the quantity
(σ_v/(2πσ_q) of crossings, σ_q³/σ_v of spectra, σ_q² of autocovariances), of rates relative to each;
None for the default of the method. ``observable`` is a displacement, as
``parse_observable("q1", n)`` gives it, or else ``InvalidInput`` is raised. ``progress`` as of
``Method.solve``.
"""

from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Protocol, runtime_checkable

import numpy as np

from fpk.answer.certificate import Certificate, Measured, certify, tolerance, with_values, worst
from fpk.answer.density import AnyDensity, Density
from fpk.answer.method import Method, Progress, silent
from fpk.answer.observable import Observable, displacement_row
from fpk.answer.quantities import ErrorKind
from fpk.answer.sampled_density import SampledDensity
from fpk.numeric.arrays import SMALLEST, Array, Complexes
from fpk.numeric.errors import InvalidInput
from fpk.numeric.quadrature import gauss_grid
from fpk.system.system import System

POINTS = (12, 16, 20)
"""Gauss points on each panel of momenta; the answer is that of the last rule. One of the others may
agree with it by chance, both hardly."""
SAFETY = 3.0
"""Error of quadrature over the sum of the distances of the answer to the other rules."""


@dataclass(frozen=True)
class Curve:
    """Values at the points asked for, with an error each, and the certificate of all of them.

    An error is an estimate of the numerical one, or one standard error of sampling. ::

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
        judged = with_values(self.certificate, self.values, self.errors)
        object.__setattr__(self, "certificate", judged)


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
    """Return rates with their certificate by ``tol``, relative to each."""
    relative = float(np.max(errors / np.abs(values)))
    certificate = certify(Measured(relative, None, None, residual, None), tol=tol)
    return Rates(np.asarray(values, dtype=complex), errors, certificate, settings or {})


@runtime_checkable
class Relaxation(Protocol):
    """A method that gives the slowest rates at which the system forgets its past."""

    def relaxation(
        self, system: System, count: int, *, tol: float | None = None, progress: Progress = silent
    ) -> Rates:
        """Return the ``count`` eigenvalues of −L with the least real parts but 0 itself."""


@dataclass(frozen=True, eq=False)
class Question:
    """A curve that is asked for, of the stationary motion of the displacement of one mass.

    ``row`` counts the masses from 0; ``at`` are levels, angular frequencies or lags; ``tol`` is the
    largest error wanted, in the units of the module, None for the default.
    """

    system: System
    row: int
    at: Array
    tol: float | None
    progress: Progress


class CrossingsMethod(Method):
    """Base class of methods that give crossing rates, by ``_crossings`` of a checked question.

    Raised are ``InvalidInput`` for what is no displacement, and ``NotApplicable`` where the method
    does not give its density.
    """

    def crossings(
        self,
        system: System,
        observable: Observable,
        at: Array,
        *,
        tol: float | None = None,
        progress: Progress = silent,
    ) -> Curve:
        """Return the upcrossings per unit time of the levels ``at`` by a displacement."""
        return self._crossings(self._asked(system, observable, at, tol, progress))

    @abstractmethod
    def _crossings(self, asked: Question) -> Curve:
        """Return the upcrossings per unit time of the levels that are asked for."""

    def _asked(
        self, system: System, observable: Observable, at: Array, tol: float | None, p: Progress
    ) -> Question:
        row, wanted = displacement_row(observable), tolerance(tol, None)
        self.planned(system, [observable])
        return Question(system, row, at, wanted, p)


class StationaryMotionMethod(CrossingsMethod):
    """Base class of methods that give power spectra and autocovariances, too.

    Spectra are two-sided, in angular frequency: S(ω) = (1/2π) ∫ C(t) e^(−iωt) dt, C the covariance
    of q(0) and q(t), so that ∫ S dω over all real ω is the variance. C(t) = E q(0) q(t) − (E q)²,
    t >= 0, is the variance at t = 0, and 2 ∫_0^∞ C cos ωt dt = 2π S(ω).
    """

    def spectrum(
        self,
        system: System,
        observable: Observable,
        at: Array,
        *,
        tol: float | None = None,
        progress: Progress = silent,
    ) -> Curve:
        """Return the power spectral density of a displacement at angular frequencies ``at``."""
        return self._spectrum(self._asked(system, observable, at, tol, progress))

    def correlation(
        self,
        system: System,
        observable: Observable,
        at: Array,
        *,
        tol: float | None = None,
        progress: Progress = silent,
    ) -> Curve:
        """Return the autocovariance of a displacement at the lags ``at``, finite and >= 0."""
        wrong = at[~((at >= 0.0) & (at < np.inf))]
        if wrong.size:
            raise InvalidInput("at", float(wrong[0]), "a lag is a time, finite and 0 or later")
        return self._correlation(self._asked(system, observable, at, tol, progress))

    @abstractmethod
    def _spectrum(self, asked: Question) -> Curve:
        """Return S at the angular frequencies that are asked for."""

    @abstractmethod
    def _correlation(self, asked: Question) -> Curve:
        """Return C at the lags that are asked for."""


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

    ``tol`` is the error wanted in units of ``scale``, a natural size of the quantity that is not
    zero where its values are. Mass, tails and failures are those of the density, but that it misses
    a tolerance of its own; so is the residual, unless that of the curve's own equation is larger.
    What is ``positive``, the values themselves where it is None, fails if it is negative by more
    than the error.
    """
    relative = float(np.max(errors)) / scale
    measured = Measured(
        l1_error=relative,
        mass_defect=of.certificate.mass_defect,
        minimum=float(np.min(values if positive is None else positive)) / scale,
        residual=worst((residual, of.certificate.residual)),
        tail_mass=of.certificate.tail_mass,
        failures=(*of.certificate.besides, *failures),
        absolute_error=relative,
    )
    certificate = certify(measured, tol=tol)
    return Curve(values, errors + SMALLEST, certificate, settings or {})


def upcrossings(joint: AnyDensity, mass: float, at: Array) -> tuple[Array, Array]:
    """Return the rates ∫_0^∞ (p/m) f(q, p) dp of a joint density of (q, p) at q = ``at``.

    Rice's formula. The error is the integral of that of the density, with what fewer points give
    and what lies beyond the last momentum, f falling there at least as over the last panel:
    infinite where it does not fall, unless it is within its error of 0 there. Of samples it is one
    standard error by their batches.
    """
    nodes = np.union1d(0.0, joint.panels[1][joint.panels[1] > 0.0])
    if isinstance(joint, SampledDensity):
        return joint.flux(lambda p: p / mass, nodes, at)
    rates = []
    for points in POINTS:
        _, [(p, w)] = gauss_grid([nodes], points=points)
        density, error = joint.at(at[:, None], p)
        rates.append((density @ (w * p / mass), error @ (w * p / mass)))
    *coarse, (value, own) = rates
    missed = sum(np.abs(value - other) for other, _ in coarse)
    last = nodes[-2:]
    density, error = joint.at(at[:, None], last)
    (before, end), known = np.abs(density).T, error[:, 1]
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        falls = (last[1] - last[0]) / np.log(before / end)
    length = np.where(before > end, falls, np.where(end <= known, last[1], np.inf))
    beyond = (end + known) * length * (last[1] + length)
    return value, own + SAFETY * missed + beyond / mass
