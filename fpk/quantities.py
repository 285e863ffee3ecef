"""Numbers that follow from a density: moments, probabilities, quantiles, correlations.

Both kinds of density have them as methods. Each is a ``Number``: with an estimate of the numerical
error where the density is a function, with one standard error where it was sampled.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from functools import reduce
from importlib import import_module
from math import inf, isfinite, isnan
from numbers import Integral, Real
from typing import Any

import numpy as np
from scipy.optimize import brentq

from fpk.arrays import Array, Complexes
from fpk.errors import InvalidInput, Unavailable
from fpk.number import Number

Function = Callable[..., Array]
FIRST_FOUR = tuple((k,) for k in range(1, 5))
UP_TO_SECOND = (1, 0), (0, 1), (2, 0), (1, 1), (0, 2)
"""Powers of the moments that quantities follow from, of one coordinate and of two."""
STEP = 1e-20
"""Imaginary step by which a function is differentiated without a difference, relative to the size
of a moment: its square is nothing beside 1, in any unit."""


class Quantities(ABC):
    """Moments, probabilities, quantiles: of a coordinate X, or of a pair (X, Y), from its density.

    All but ``expectation``, ``moment`` and ``plot`` raise ``InvalidInput`` for a joint density,
    ``covariance`` and ``correlation`` for any other. ::

        q2 = fpk.solve(fpk.load("fig6a").system, ["q2"])["q2"]
        q2.std().value, q2.std().error
        q2.exceedance(0.5)   # P(q2 > 0.5)
        q2.probability(-0.5, 0.5)
    """

    @abstractmethod
    def axes(self) -> tuple[Array, ...]:
        """Return the ascending nodes of every axis; the first and last are the support."""

    @abstractmethod
    def expectation(self, function: Function, *, kinks: Sequence[float] = ()) -> Number:
        """Return E f(X) of a ``function`` of arrays that is smooth but at its ``kinks``."""

    def probability(self, low: float, high: float) -> Number:
        """Return P(low < X <= high) and its error; either end may be infinite.

        Raises ``InvalidInput`` unless both ends are numbers.
        """
        return self._probability(_number("low", low), _number("high", high))

    @abstractmethod
    def _probability(self, low: float, high: float) -> Number:
        """Return P(low < X <= high) and its error."""

    def share(self, low: float, high: float) -> float:
        """Return P(low < X <= high) without its error."""
        return self._probability(low, high).value

    def moment(self, *powers: int, about: float = 0.0) -> Number:
        """Return E (X − about)^power, of two coordinates E (X − about)^power (Y − about)^other.

        Raises ``InvalidInput`` for a power that is no integer >= 0, or unless each coordinate has
        one.
        """
        if len(powers) != len(self.axes()) or not all(map(_is_power, powers)):
            raise InvalidInput("power", powers, "takes one integer >= 0 for each coordinate")
        return self.expectation(monomial(powers, [about] * len(powers)))

    def mean(self) -> Number:
        """Return E X."""
        self._axis()
        return self.moment(1)

    def rms(self) -> Number:
        """Return √E X²."""
        return self._of_moments(lambda m: np.sqrt(m[1]), 0.0)

    def std(self) -> Number:
        """Return the standard deviation, √E (X − E X)²."""
        return self._of_moments(lambda m: np.sqrt(m[1] - m[0] ** 2), self.mean().value)

    def variance(self) -> Number:
        """Return E (X − E X)²."""
        return self._of_moments(lambda m: m[1] - m[0] ** 2, self.mean().value)

    def skewness(self) -> Number:
        """Return E (X − E X)³ over the cube of the standard deviation, 0 of a symmetric density."""

        def skewness(m: Complexes) -> complex:
            return complex((m[2] - 3.0 * m[0] * m[1] + 2.0 * m[0] ** 3) / (m[1] - m[0] ** 2) ** 1.5)

        return self._of_moments(skewness, self.mean().value)

    def kurtosis(self) -> Number:
        """Return E (X − E X)⁴ over the square of the variance: 3 of a Gaussian."""

        def kurtosis(m: Complexes) -> complex:
            fourth = m[3] - 4.0 * m[0] * m[2] + 6.0 * m[0] ** 2 * m[1] - 3.0 * m[0] ** 4
            return complex(fourth / (m[1] - m[0] ** 2) ** 2)

        return self._of_moments(kurtosis, self.mean().value)

    def covariance(self) -> Number:
        """Return E (X − E X)(Y − E Y) of a joint density."""
        return self._of_moments(lambda m: m[3] - m[0] * m[1], *self._middle())

    def correlation(self) -> Number:
        """Return the covariance over both standard deviations, from −1 to 1 but for its error."""

        def correlation(m: Complexes) -> complex:
            variances = (m[2] - m[0] ** 2) * (m[4] - m[1] ** 2)
            return complex((m[3] - m[0] * m[1]) / np.sqrt(variances))

        return self._of_moments(correlation, *self._middle())

    def cdf(self, x: float) -> Number:
        """Return P(X <= x). Raises ``InvalidInput`` unless x is a number."""
        return self._probability(-inf, _number("x", x))

    def exceedance(self, x: float) -> Number:
        """Return P(X > x): its relative digits are kept where it is small.

        Raises ``InvalidInput`` unless x is a number.
        """
        return self._probability(_number("x", x), inf)

    def quantile(self, p: float) -> Number:
        """Return the x with P(X <= x) = p; its error is that of x at p plus and minus its error.

        Raises ``InvalidInput`` unless 0 < p < 1.
        """
        if not 0.0 < _number("p", p) < 1.0:
            raise InvalidInput("p", p, "must be a probability between 0 and 1")
        low, high = (float(x) for x in self._axis()[[0, -1]])
        # From the side on which there is less, whose relative digits are kept.
        upper = p > 0.5
        wanted = 1.0 - p if upper else p

        def beside(x: float) -> float:
            return self.share(x, inf) if upper else self.share(-inf, x)

        def inverse(wanted: float) -> float:
            at_low, at_high = beside(low) - wanted, beside(high) - wanted
            if at_low * at_high >= 0.0:
                return -inf if upper == (at_low < 0.0) else inf
            return float(brentq(lambda x: beside(x) - wanted, low, high, xtol=1e-14 * (high - low)))

        x = inverse(wanted)
        if not isfinite(x):
            return Number(x, inf)
        error = (self.exceedance(x) if upper else self.cdf(x)).error
        ends = [inverse(wanted + s * error) for s in (-1.0, 1.0)]
        rounding = 1e-14 * (high - low)
        return Number(x, max(abs(end - x) for end in ends) + rounding)

    def plot(self, *, log: bool = False) -> Any:
        """Return a figure of pyplot with the density and its error; of two coordinates as contours.

        ``log``: on a logarithmic scale. ::

            fpk.solve(system, ["q2"], methods=["nonintegrable/fem"])["q2"].plot(log=True)
        """
        return import_module("fpk").plot(self, log=log)

    def to_meshio(self) -> Any:
        """Return the density as a ``meshio.Mesh`` of quadratic cells that follow it.

        ``point_data`` has ``density``, ``log10 density`` and ``error of p``, the stated error. ::

            fpk.solve(system, ["q2,p2"], methods=["nonintegrable/fem"])["q2,p2"].to_meshio()
        """
        from fpk.field import field_of  # noqa: PLC0415  (meshio is needed here only)

        return field_of({"p": self})[0]

    def to_pyvista(self) -> Any:
        """Return the density as an ``UnstructuredGrid`` of pyvista, see ``to_meshio``.

        Raises ``Unavailable`` without pyvista.
        """
        try:
            pyvista = import_module("pyvista")
        except ImportError:
            raise Unavailable("pyvista is not installed; pip install pyvista brings it") from None
        return pyvista.from_meshio(self.to_meshio())

    def _axis(self, points: Sequence[float] = ()) -> Array:
        """The nodes of the one coordinate, and those of ``points`` that lie between them."""
        if len(self.axes()) != 1:
            raise InvalidInput("density", "joint", "of two coordinates: ask for that of one")
        return with_points(self.axes()[0], np.asarray(points))

    def _middle(self) -> tuple[float, float]:
        """E X and E Y of a joint density."""
        if len(self.axes()) != 2:
            raise InvalidInput("density", "single", "of one coordinate: ask for that of a pair")
        return self.moment(1, 0).value, self.moment(0, 1).value

    def _of_moments(self, function: Callable[[Complexes], complex], *about: float) -> Number:
        """A ``function`` of the moments about a point, of ``FIRST_FOUR`` or ``UP_TO_SECOND``.

        A small change of the density changes it by that of the expectation of its gradient times
        the powers, whose error is taken.
        """
        powers = FIRST_FOUR if len(about) == 1 else UP_TO_SECOND
        terms = [monomial(k, about) for k in powers]
        moments = np.array([self.expectation(term).value for term in terms])
        squares = moments[[1]] if len(about) == 1 else moments[[2, 4]]
        sizes = np.prod(np.sqrt(squares) ** np.array(powers), axis=1)
        steps = moments + 1j * np.diag(STEP * sizes)
        gradient = np.imag([function(m) for m in steps]) / (STEP * sizes)

        def change(*x: Array) -> Array:
            total: Array = sum(g * term(*x) for g, term in zip(gradient, terms, strict=True))
            return total

        own = self.expectation(change)
        return Number(float(np.real(function(moments.astype(complex)))), own.error)


def _number(key: str, value: Any) -> float:
    """Return ``value``, one real number; raise ``InvalidInput`` for anything else."""
    if isinstance(value, bool) or not isinstance(value, Real) or isnan(value):
        raise InvalidInput(key, value, "must be one number; of several, ask for each")
    return float(value)


def _is_power(value: Any) -> bool:
    return isinstance(value, Integral) and int(value) >= 0


def with_points(nodes: Array, points: Array) -> Array:
    """Return the nodes and those of ``points`` that lie between the first and the last."""
    return np.union1d(nodes, points[(points > nodes[0]) & (points < nodes[-1])])


def monomial(powers: Sequence[int], about: Sequence[float]) -> Function:
    """Return the product of the powers of the distances of each coordinate from ``about``."""

    def product(*x: Array) -> Array:
        factors = [(y - a) ** k for y, a, k in zip(x, about, powers, strict=True)]
        return reduce(np.multiply, factors)

    return product


def beyond(
    function: Callable[..., Array], panels: Sequence[Array], kinks: Sequence[float] = ()
) -> float:
    """Return the largest |f| at the corners of twice the support: what the tails weigh with.

    A density falls at least exponentially beyond the end of its support, so that next to nothing
    lies at more than twice its distance. A function that begins farther out, at one of its
    ``kinks``, is taken at twice their distance: it would count as 0 otherwise, and is not.
    """
    reach = 2.0 * float(np.max(np.abs(kinks), initial=0.0))
    ends = (2.0 * x[[0, -1]] for x in panels)
    corners = np.meshgrid(*([min(a, -reach), max(b, reach)] for a, b in ends))
    return float(np.max(np.abs(function(*corners))))
