"""The square-root process dH = (n d − c H) dt + √(2 d H) dB in time, in closed form.

It is the averaged energy of n masses without contact, or of one mode; Cox, Ingersoll and Ross.
"""

from dataclasses import dataclass
from math import exp, expm1, inf, pi, sqrt

import numpy as np
from scipy.special import gammaln, ive, xlogy

from fpk.arrays import Array
from fpk.certificate import Measured, certify
from fpk.contour import contours
from fpk.density import SMALLEST
from fpk.dynamics import Complex, Rates
from fpk.errors import InvalidInput, NotApplicable
from fpk.evolution import BEYOND_RANGE, Number, Passage, StartCurve, Transient
from fpk.quadrature import panel_rule

EPS = float(np.finfo(float).eps)
STARTS = 101
"""Starts at which moments are given as a curve, from rest to the limit."""
MOST_TERMS = 20_000
"""Terms of a series of 1F1, beyond which it is left to the finite elements."""
BESSEL = 50.0
"""Error of scipy's ``ive`` in roundings, and of the power series beside it."""
FEW, MOST_POWERS = 60.0, 120
"""x y below which the Bessel function is summed as a power series, and its terms."""
LARGE = 1e4
"""Argument of a Bessel function, over the square of its order, beyond which it is asymptotic."""
FARTHEST = 690.0
"""Largest c H/d of a limit: the mean time is e^690 of its unit."""
WIDTHS = 40.0
"""Standard deviations above the mean within which a density is integrated: e^(−√2·40) is beyond."""


@dataclass(frozen=True)
class SquareRoot:
    """The process of the shape ``n``, the damping ``c`` (1/time) and the noise ``d``: θ = d/c."""

    n: int
    c: float
    d: float

    def rates(self, count: int, *, tol: float) -> Rates:
        """Return k c, the eigenvalues of −L; the eigenfunctions are Laguerre polynomials."""
        values = self.c * np.arange(1.0, count + 1.0)
        certificate = certify(Measured(4.0 * EPS, 0.0, 0.0, 0.0, 0.0), tol=tol)
        return Rates(values.astype(complex), 4.0 * EPS * values, certificate)

    def transient(
        self, start: float, noise: float | None, times: Array, at: Array, *, tol: float
    ) -> Transient:
        """Return the densities at ``times`` after the energy ``start``, or a stationary state.

        The latter, under the multiple ``noise`` of the noise, stays a gamma density. From an energy
        H_0 it is noncentral χ² of 2n degrees: Cox, Ingersoll and Ross, Econometrica 53 (1985) 385.
        """
        values, errors = np.empty((2, times.size, at.size))
        judged = []
        for k, t in enumerate(times.tolist()):
            values[k], errors[k] = self._density(start, noise, t, at)
            judged.append(self._judged(start, noise, t))
        error, mass, least = (max(column) for column in zip(*judged, strict=True))
        measured = Measured(error, mass, -least, 0.0, 0.0)
        return Transient(times, values, errors, "numerical", certify(measured, tol=tol))

    def _scales(self, start: float, noise: float | None, t: float) -> tuple[float, float]:
        """θ_t and the mean that is left of the start."""
        left, theta = exp(-self.c * t), self.d / self.c
        if noise is not None:
            return theta * (-expm1(-self.c * t) + noise * left), 0.0
        return -theta * expm1(-self.c * t), start * left

    def _density(
        self, start: float, noise: float | None, t: float, H: Array
    ) -> tuple[Array, Array]:
        theta, left = self._scales(start, noise, t)
        x, y = np.maximum(H, 0.0) / theta, left / theta
        log_p, log_error = noncentral(self.n, x, y)
        p = np.where(H >= 0.0, np.exp(log_p) / theta, 0.0)
        return p, np.where(H >= 0.0, p * log_error + SMALLEST, 0.0)

    def _judged(self, start: float, noise: float | None, t: float) -> tuple[float, float, float]:
        """L1 error, departure of the mass from one and minus the least value, by quadrature."""
        theta, left = self._scales(start, noise, t)
        mean, width = self.n * theta + left, sqrt(theta * (self.n * theta + 2.0 * left))
        nodes = np.linspace(max(mean - WIDTHS * width, 0.0), mean + WIDTHS * width, 161)
        H, w = (part.ravel() for part in panel_rule(nodes, 20))
        p, error = self._density(start, noise, t, H)
        return float(w @ error), abs(float(w @ p) - 1.0), -float(p.min() / p.max())

    def passage(self, limit: float, start: float, times: Array, *, tol: float) -> Passage:
        """Return the first passage of ``limit``: E e^(−sT) = 1F1(s/c; n; x_0)/1F1(s/c; n; x_f).

        x = c H/d. Moments are its derivatives at s = 0, power series of positive terms; the failure
        rate is c times the least a with 1F1(−a; n; x_f) = 0. Raises ``InvalidInput`` where the mean
        time is beyond double precision, ``NotApplicable`` where at a short time the series cancels.
        """
        if not start < limit:
            raise InvalidInput("start", f"H={start:g}", f"must be below the limit {limit:g}")
        scale = self.c / self.d
        x0, xf = start * scale, limit * scale
        if not xf <= FARTHEST:
            raise InvalidInput("limit", limit, BEYOND_RANGE)
        starts = np.linspace(0.0, limit, STARTS)
        mean, mean_error, variance, variance_error = self._moments(
            np.append(starts * scale, x0), xf
        )
        rate, rate_error = self._rate(xf)
        failure, failure_error = self._failure(x0, xf, times, tol)
        relative = max(mean_error[-1] / mean[-1], rate_error / rate, failure_error.max(initial=0.0))
        if variance[-1] < inf:
            relative = max(relative, variance_error[-1] / variance[-1])
        least = float(np.min(1.0 - failure, initial=1.0))
        error = float(failure_error.max(initial=0.0))
        measured = Measured(float(relative), 0.0, least, 0.0, 0.0, absolute_error=error)
        return Passage(
            Number(float(mean[-1]), float(mean_error[-1])),
            Number(float(variance[-1]), float(variance_error[-1])),
            Number(rate, rate_error),
            times,
            1.0 - failure,
            failure_error + EPS,
            "numerical",
            certify(measured, tol=tol),
            StartCurve(starts, mean[:-1], mean_error[:-1], variance[:-1], variance_error[:-1]),
            {},
            failure,
            failure_error,
        )

    def _moments(self, x: Array, xf: float) -> tuple[Array, Array, Array, Array]:
        """Mean and variance from the starts x, and errors: A_1 and A_1² − 2 A_2, less those of x.

        A_1 = Σ x^k/(k (n)_k) and A_2 = Σ x^k (1 + … + 1/(k−1))/(k (n)_k) are the coefficients of
        a and a² in 1F1(a; n; x).
        """
        k = np.arange(1.0, _terms(xf) + 1.0)
        # x_f^k/(k (n)_k), and 1 − (x/x_f)^k, without a difference of large numbers.
        terms = np.cumprod(xf / (self.n + k - 1.0)) / k
        with np.errstate(divide="ignore"):
            less = -np.expm1(k * np.log(x / xf)[:, None])
        harmonic = np.cumsum(1.0 / k) - 1.0 / k
        A1 = terms.sum()
        first, second = less @ terms, less @ (terms * harmonic)
        unit, relative = A1, 4.0 * EPS * (k.size + 2.0)
        # Per unit²: A_1(x_f)² − A_1(x)² = first (2 A_1 − first).
        a, b, c = first / unit, 2.0 - first / unit, 2.0 * second / unit / unit
        with np.errstate(over="ignore"):
            variance = (a * b - c) * unit * unit / self.c**2
            variance_error = relative * (a * b + c) * unit * unit / self.c**2
        mean = first / self.c
        return mean, relative * mean, variance, variance_error

    def _rate(self, xf: float) -> tuple[float, float]:
        """Return the failure rate by Newton's method, which rises to the root of a convex curve."""
        k = np.arange(1.0, _terms(xf) + 1.0)
        a, relative = 0.0, 4.0 * EPS * (k.size + 2.0)
        for _ in range(100):
            # Terms of 1F1(−a; n; x) − 1 and of its derivative in a, of which the first has a left
            # out: it may be as small as 1e-290.
            rest = np.cumprod(np.append(1.0, k[:-1] - a) * xf / ((self.n + k - 1.0) * k))
            with np.errstate(divide="ignore"):
                slopes = np.cumsum(np.append(0.0, 1.0 / (k[:-1] - a)))
            f, slope = 1.0 - a * rest.sum(), -rest.sum() + a * (rest * slopes).sum()
            step = f / slope
            a -= step
            if abs(step) <= EPS * a:
                break
        error = relative * (1.0 + a * np.abs(rest).sum()) / abs(slope) + 2.0 * EPS * a
        return self.c * a, self.c * error

    def _failure(self, x0: float, xf: float, times: Array, tol: float) -> tuple[Array, Array]:
        """P(T <= t) by inverse transform, and its error."""
        p, error = np.zeros((2, times.size))
        later = np.flatnonzero(times > 0.0)
        for contour in contours(times[later]):
            above, above_error = kummer(contour.z / self.c, self.n, x0)
            below, below_error = kummer(contour.z / self.c, self.n, xf)
            with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
                transform = above / below / contour.z
                relative = above_error / np.abs(above) + below_error / np.abs(below) + 4.0 * EPS
            at, sizes = later[contour.index], np.abs(contour.factors) * np.abs(transform)
            with np.errstate(invalid="ignore"):
                p[at] = (contour.factors @ transform).imag
                error[at] = sizes @ relative + 8.0 * EPS * sizes.sum(axis=1)
        if not np.all(error <= tol):
            first = times[~(error <= tol)][0]
            raise NotApplicable(
                f"at the time {first:g} the series of 1F1 cancels to more than {tol:g}; use fem"
            )
        return p, error


def noncentral(n: int, x: Array, y: float) -> tuple[Array, Array]:
    """Return ln of e^(−x−y) (x/y)^((n−1)/2) I_(n−1)(2 √(xy)), n >= 1, and its error.

    As a density of x it is that of half a noncentral χ² of 2n degrees, noncentrality 2y.
    """
    few = x * y < FEW
    k = np.arange(MOST_POWERS)
    with np.errstate(divide="ignore", invalid="ignore"):
        power = np.exp(
            xlogy(k, np.where(few, x * y, 0.0)[..., None]) - gammaln(k + 1.0) - gammaln(n + k)
        )
        by_series = xlogy(n - 1, x) - x - y + np.log(power.sum(axis=-1))
        root, other = np.sqrt(x), np.sqrt(y)
        ratio = 0.0 if n == 1 else (n - 1) * np.log(root / other)
        by_bessel = _log_ive(n - 1, 2.0 * root * other) + ratio - (root - other) ** 2
    value = np.where(few, by_series, by_bessel)
    # Of an exponent, relative errors of its parts are errors of ln p.
    parts = np.where(few, x + y, np.abs(root - other) * (root + other))
    steep = np.where(x > 0.0, (n - 1) * np.abs(np.log(np.maximum(x, SMALLEST))), 0.0)
    return value, EPS * (BESSEL + gammaln(n + 1.0) + 4.0 * parts + steep)


def _log_ive(order: int, z: Array) -> Array:
    """Return ln of e^(−z) I_order(z); scipy's has no value at very large z."""
    large = z > LARGE * (order + 1.0) ** 2
    near = ive(order, np.where(large, 1.0, z))
    mu, w = 4.0 * order**2, np.where(large, 8.0 * z, 1.0)
    # Abramowitz and Stegun (9.7.1); the next term is below 1/LARGE^4.
    series = 1.0 - (mu - 1.0) / w * (1.0 - (mu - 9.0) / (2.0 * w) * (1.0 - (mu - 25.0) / (3.0 * w)))
    far = np.log(np.where(large, series, 1.0)) - 0.5 * np.log(np.where(large, 2.0 * pi * z, 1.0))
    return np.where(large, far, np.log(near))


def kummer(a: Complex, n: int, x: float) -> tuple[Complex, Array]:
    """Return 1F1(a; n; x) at complex ``a`` (points,), x >= 0, by its series, and its error.

    The error is infinite where ``MOST_TERMS`` are too few or overflow.
    """
    term, total = np.ones_like(a), np.ones_like(a)
    size = np.ones(a.size)
    with np.errstate(over="ignore", invalid="ignore"):
        for k in range(1, MOST_TERMS):
            term = term * ((a + (k - 1)) * (x / ((n + k - 1) * k)))
            total, last = total + term, np.abs(term)
            size += last
            if k > x and np.all(~(last > EPS * np.abs(total))):
                break
        else:
            size[:] = np.inf
    return total, np.where(np.isfinite(size), 4.0 * EPS * sqrt(k) * size, np.inf)


def _terms(x: float) -> int:
    """Terms of a power series like that of e^x, up to round-off."""
    return int(x + 12.0 * sqrt(x)) + 60
