"""Numbers that follow from the density of one coordinate: moments, probabilities, quantiles.

Both kinds of density have them as methods. Each is a ``Number``: with an estimate of the numerical
error where the density is a function, with one standard error where it was sampled.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from functools import reduce
from math import inf, isfinite

import numpy as np
from scipy.optimize import brentq

from fpk.arrays import Array, Complexes
from fpk.errors import InvalidInput
from fpk.number import Number

Function = Callable[..., Array]
STEP = 1e-100
"""Imaginary step by which a function is differentiated without a difference."""


class Quantities(ABC):
    """What follows from the density of one coordinate X.

    All but ``expectation`` and ``moment`` raise ``InvalidInput`` for a joint density. ::

        q2 = fpk.solve(fpk.load("fig6a").system, ["q2"])["q2"]
        q2.std().value, q2.std().error
        q2.exceedance(0.5)   # P(q2 > 0.5)
    """

    @abstractmethod
    def axes(self) -> tuple[Array, ...]:
        """Return the ascending nodes of every axis; the first and last are the support."""

    @abstractmethod
    def expectation(self, function: Function, *, kinks: Sequence[float] = ()) -> Number:
        """Return E f(X) of a ``function`` of arrays that is smooth but at its ``kinks``."""

    @abstractmethod
    def probability(self, low: float, high: float) -> Number:
        """Return P(low < X <= high); either end may be infinite."""

    def share(self, low: float, high: float) -> float:
        """Return P(low < X <= high) without its error."""
        return self.probability(low, high).value

    def moment(self, *powers: int, about: float = 0.0) -> Number:
        """Return E (X − about)^power, of two coordinates E (X − about)^power (Y − about)^other.

        Raises ``InvalidInput`` for a power below 0, or unless each coordinate has one.
        """
        if len(powers) != len(self.axes()) or min(powers) < 0:
            raise InvalidInput("power", powers, "takes one number >= 0 for each coordinate")

        def product(*x: Array) -> Array:
            return reduce(np.multiply, [(y - about) ** k for y, k in zip(x, powers, strict=True)])

        return self.expectation(product)

    def mean(self) -> Number:
        """Return E X."""
        self._axis()
        return self.moment(1)

    def rms(self) -> Number:
        """Return √E X²."""
        return self._of_moments(lambda m: np.sqrt(m[2]), 0.0)

    def std(self) -> Number:
        """Return the standard deviation, √E (X − E X)²."""
        return self._of_moments(lambda m: np.sqrt(m[2] - m[1] ** 2), self.mean().value)

    def variance(self) -> Number:
        """Return E (X − E X)²."""
        return self._of_moments(lambda m: m[2] - m[1] ** 2, self.mean().value)

    def skewness(self) -> Number:
        """Return E (X − E X)³ over the cube of the standard deviation, 0 of a symmetric density."""

        def skewness(m: Complexes) -> complex:
            return complex((m[3] - 3.0 * m[1] * m[2] + 2.0 * m[1] ** 3) / (m[2] - m[1] ** 2) ** 1.5)

        return self._of_moments(skewness, self.mean().value)

    def kurtosis(self) -> Number:
        """Return E (X − E X)⁴ over the square of the variance: 3 of a Gaussian."""

        def kurtosis(m: Complexes) -> complex:
            fourth = m[4] - 4.0 * m[1] * m[3] + 6.0 * m[1] ** 2 * m[2] - 3.0 * m[1] ** 4
            return complex(fourth / (m[2] - m[1] ** 2) ** 2)

        return self._of_moments(kurtosis, self.mean().value)

    def cdf(self, x: float) -> Number:
        """Return P(X <= x)."""
        return self.probability(-inf, x)

    def exceedance(self, x: float) -> Number:
        """Return P(X > x): its relative digits are kept where it is small."""
        return self.probability(x, inf)

    def quantile(self, p: float) -> Number:
        """Return the x with P(X <= x) = p; its error is that of x at p plus and minus its error.

        Raises ``InvalidInput`` unless 0 < p < 1.
        """
        if not 0.0 < p < 1.0:
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

    def _axis(self, points: Sequence[float] = ()) -> Array:
        """The nodes of the one coordinate, and those of ``points`` that lie between them."""
        if len(self.axes()) != 1:
            raise InvalidInput("density", "joint", "of two coordinates: ask for that of one")
        nodes, more = self.axes()[0], np.asarray(points)
        return np.union1d(nodes, more[(more > nodes[0]) & (more < nodes[-1])])

    def _of_moments(self, function: Callable[[Complexes], complex], about: float) -> Number:
        """A ``function`` of the moments about a point, by power up to 4.

        A small change of the density changes it by that of the expectation of its gradient times
        the powers, whose error is taken.
        """
        moments = np.array([self.moment(k, about=about).value for k in range(5)])
        steps = moments + 1j * STEP * np.eye(5)
        gradient = np.imag([function(m) for m in steps]) / STEP
        change = np.polynomial.Polynomial(gradient)
        own = self.expectation(lambda x: change(x - about))
        return Number(float(np.real(function(moments.astype(complex)))), own.error)


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
