"""The square-root process dH = (n d − c H) dt + √(2 d H) dB in time, in closed form.

It is the averaged energy of n masses without contact, or of one mode; J. C. Cox, J. E. Ingersoll
and S. A. Ross, Econometrica 53 (1985) 385.
"""

from dataclasses import dataclass
from math import exp, expm1, pi, sqrt

import numpy as np
from scipy.special import gammaln, ive, xlogy

from fpk.answer.dynamics import (
    BEYOND_RANGE,
    NO_NOISE_YET,
    START_POINTS,
    Passage,
    Rates,
    certify_passage,
    certify_rates,
)
from fpk.answer.quantities import Number
from fpk.numeric.arrays import DEPTH, EPS, LARGEST_LOG, ROUNDINGS, SMALLEST, Array, Complexes
from fpk.numeric.errors import NotApplicable, require
from fpk.numeric.quadrature import panel_rule
from fpk.solvers.line.elements import ENRICHMENT
from fpk.solvers.line.time.resolvent import contours
from fpk.system.modulation import Modulation, require_constant_noise

CANCELLED = 1e3
"""Relative error, over EPS, above which E e^(−sT) is computed by ``log_kummer_ratio``, too."""
STEEPEST, NEGLIGIBLE = 1e5, 1e-20
"""Largest s x_f/c of Chernoff's bound e^(st) E e^(−sT), x_f = c H_f/d for the limit H_f, as
1F1 ~ e^(2 √(s x_f/c)); bound below which P(T <= t) is returned as 0."""
CLOSE_STARTS = (0.02, 40.0)
"""Smallest x_0/x_f and largest x_f − x_0, x = c H/d at the start and at the limit, at which
``log_kummer_ratio`` is used if the series of 1F1 cancels: failures may be early."""

MOST_TERMS = 20_000
"""Largest number of terms of a series of 1F1 or of a continued fraction."""
BESSEL = 50.0
"""Relative error of the Bessel function in ``noncentral``, by ``ive`` or a series, over EPS."""
SERIES_RANGE = 60.0
"""Largest x y at which 40 powers of x y give I_(n−1)(2 √(xy)): 60^41/41!² is 1e-26."""
LEAST_SIZE = 4.0
"""Smallest |a| of ``log_kummer_ratio``: for smaller negative a, near the relaxation rates, 1F1 has
zeros close to the real axis of x."""
RATIO_PANELS, RATIO_POINTS = (1.5, 2.0), 14
"""Largest ratio and difference of both ends of a panel of x in ``log_kummer_ratio``; Gauss points
of a panel."""


@dataclass(frozen=True)
class SquareRoot:
    """Process dH = (n d − c H) dt + √(2 d H) dB: shape ``n``, damping ``c``, noise ``d`` = c θ.

    θ is the temperature; c is in 1/time, d in energy/time. ``relative_error`` is the error of c and
    of d, which all stated errors include. ``modulation`` e(t) multiplies d by e²; densities keep
    their form, with θ_t = ∫d e(s)² e^(−c(t−s)) ds from 0 to t.
    """

    n: int
    c: float
    d: float
    relative_error: float = 0.0
    modulation: Modulation | None = None

    def rates(self, count: int, *, tol: float) -> Rates:
        """Return the eigenvalues k c of −L, k = 1 to ``count``, certified to the relative ``tol``.
        The eigenfunctions are Laguerre polynomials."""
        values = self.c * np.arange(1.0, count + 1.0)
        return certify_rates(values, (4.0 * EPS + self.relative_error) * values, tol=tol)

    def density(self, start: float, noise: float | None, t: float, H: Array) -> tuple[Array, Array]:
        """Return the density at time ``t`` and energies ``H`` of any shape, and its absolute error,
        of the same shape; both are 0 for H < 0. For ``start`` and ``noise`` see ``scales``."""
        theta, left = self.scales(start, noise, t)
        x, y = np.maximum(H, 0.0) / theta, left / theta
        log_p, log_error = noncentral(self.n, x, y)
        # |∂ ln p/∂ ln θ| and |∂ ln p/∂ ln y| are below these terms.
        log_error = log_error + 2.0 * self.relative_error * (self.n + x + start / theta)
        p = np.where(H >= 0.0, np.exp(log_p) / theta, 0.0)
        return p, np.where(H >= 0.0, p * log_error + SMALLEST, 0.0)

    def judged(self, start: float, noise: float | None, t: float) -> tuple[float, float]:
        """Return the integrated error that ``density`` states at ``t``, and |∫p − 1|.

        Both are by quadrature. For ``start`` and ``noise`` see ``scales``.
        """
        theta, left = self.scales(start, noise, t)
        mean, width = self.n * theta + left, sqrt(theta * (self.n * theta + 2.0 * left))
        # Beyond the mean p falls by e in each standard deviation at least.
        nodes = np.linspace(max(mean - DEPTH * width, 0.0), mean + DEPTH * width, 161)
        H, w = (part.ravel() for part in panel_rule(nodes, 20))
        p, error = self.density(start, noise, t, H)
        return float(w @ error), abs(float(w @ p) - 1.0)

    def scales(self, start: float, noise: float | None, t: float) -> tuple[float, float]:
        """Return θ_t and the remaining initial energy ``start`` e^(−c ``t``) (``noise`` None).

        From a stationary state under ``noise`` times d the latter is 0 and θ_t contains the initial
        temperature. Raises ``InvalidInput`` if, from an energy, no noise has acted before ``t``.
        """
        left, theta = exp(-self.c * t), self.d / self.c
        grown = -theta * expm1(-self.c * t)
        if self.modulation is not None:
            grown = self.d * float(self.modulation.faded(0.0, t, np.array(self.c)))
        if noise is not None:
            return grown + theta * noise * left, 0.0
        require(grown != 0.0, "times", t, NO_NOISE_YET)
        return grown, start * left

    def passage(self, limit: float, start: float, times: Array, *, tol: float) -> Passage:
        """Return the first passage of ``limit`` from a ``start`` below it, P(T <= t) at ``times``.

        E e^(−sT) = 1F1(s/c; n; x_0)/1F1(s/c; n; x_f), x = c H/d; moments are its derivatives at 0.
        ``limit`` and ``start`` are energies; for ``tol`` see ``certify_passage``. Raises as
        ``rate`` and ``failure`` do, and ``NotApplicable`` for modulated noise.
        """
        require_constant_noise(self.modulation)
        rate, xf = self.rate(limit), limit * self.c / self.d
        starts = np.linspace(0.0, limit, START_POINTS)
        x = np.append(starts, start) * self.c / self.d
        k = np.arange(1.0, int(xf + 12.0 * sqrt(xf)) + 61.0)  # terms up to round-off, as for e^x
        # 1F1 = 1 + A_1 a + A_2 a² + …, A_1 = Σ x^k/(k (n)_k) and
        # A_2 = Σ x^k (1 + … + 1/(k−1))/(k (n)_k): A(x_f) − A(x) is summed without cancellation.
        terms = np.cumprod(xf / (self.n + k - 1.0)) / k
        with np.errstate(divide="ignore"):
            less = -np.expm1(k * np.log(x / xf)[:, None])
        harmonic = np.cumsum(1.0 / k) - 1.0 / k
        unit, lost = terms.sum(), self._lost(xf)
        first, second = less @ terms, less @ (terms * harmonic)
        relative = 4.0 * EPS * (k.size + 2.0)
        # Per unit²: A_1(x_f)² − A_1(x)² = first (2 A_1 − first).
        a, b, c = first / unit, 2.0 - first / unit, 2.0 * second / unit / unit
        with np.errstate(over="ignore"):
            variance = (a * b - c) * unit * unit / self.c**2
            variance_error = (relative + 2.0 * lost) * (a * b + c) * unit * unit / self.c**2
        mean = first / self.c
        curves = np.stack([mean, (relative + lost) * mean, variance, variance_error])
        own = curves[:, -1].tolist()
        return certify_passage(
            (Number(*own[:2]), Number(*own[2:]), rate),
            times,
            *self.failure(limit, start, times, tol=tol),
            tol=tol,
            starts=[starts, *curves[:, :-1]],
        )

    def rate(self, limit: float) -> Number:
        """Return the failure rate, c times the smallest a > 0 with 1F1(−a; n; c ``limit``/d) = 0.
        Raises ``InvalidInput`` if the mean time is beyond double precision."""
        xf = limit * self.c / self.d
        require(xf <= LARGEST_LOG, "limit", limit, BEYOND_RANGE)  # the mean time is about e^xf/c
        k = np.arange(1.0, int(xf + 12.0 * sqrt(xf)) + 61.0)  # as in ``passage``
        a, relative = 0.0, 4.0 * EPS * (k.size + 2.0)
        for _ in range(100):  # Newton's method rises to the root of a convex curve
            # Terms of (1F1(−a; n; x) − 1)/(−a), and of its derivative in a; a may be 1e-290.
            factors = k[:-1] - a
            factors[factors == 0.0] = EPS  # one rounding beside an integer a, to avoid 0/0
            rest = np.cumprod(np.append(1.0, factors) * xf / ((self.n + k - 1.0) * k))
            slopes = np.cumsum(np.append(0.0, 1.0 / factors))
            f, slope = 1.0 - a * rest.sum(), -rest.sum() + a * (rest * slopes).sum()
            step = f / slope
            a -= step
            if abs(step) <= EPS * a:
                break
        error = relative * (1.0 + a * np.abs(rest).sum()) / abs(slope) + 2.0 * EPS * a
        return Number(self.c * a, self.c * error + self._lost(xf) * (self.c * a))

    def failure(
        self, limit: float, start: float, times: Array, *, tol: float
    ) -> tuple[Array, Array]:
        """Return P(T <= t) at ``times`` by the inverse Laplace transform, and its absolute error.

        ``limit`` and ``start`` below it are energies; the noise is constant, whatever the
        ``modulation``. At short times, at which the transform cancels, 0 is
        returned with Chernoff's bound e^(st) E e^(−sT) as its error; at t <= 0 both are 0. Raises
        ``NotApplicable`` if an error exceeds ``tol``.
        """
        x0, xf = start * self.c / self.d, limit * self.c / self.d
        p, error = np.zeros((2, times.size))
        if not np.any(times > 0.0):
            return p, error
        a = np.geomspace(1.0, STEEPEST / xf, 60)
        ratio, relative = self._transform(a.astype(complex), x0, xf)
        with np.errstate(over="ignore", invalid="ignore"):
            powers = np.exp(np.multiply.outer(self.c * times, a))
            bound = np.nanmin(powers * (ratio.real * (1.0 + relative)), axis=1)
        later = np.flatnonzero((times > 0.0) & (bound > NEGLIGIBLE))
        # The distance to a contour of ENRICHMENT more points is the error of the rule.
        rules = (contours(times[later], more=more) for more in (0, ENRICHMENT))
        for both in zip(*rules, strict=True):
            at, values = later[both[0][0]], []
            for _, z, factors in both:
                ratio, relative = self._transform(z / self.c, x0, xf)
                with np.errstate(invalid="ignore", over="ignore"):
                    values.append((factors @ (ratio / z)).imag)
                    sizes = np.abs(factors) * np.abs(ratio / z)
                    error[at] = sizes @ relative + ROUNDINGS * EPS * sizes.sum(axis=1)
            p[at] = values[1]
            error[at] += np.abs(values[1] - values[0])
        bounded = (times > 0.0) & ((bound <= NEGLIGIBLE) | ~(error <= bound))
        p[bounded], error[bounded] = 0.0, bound[bounded]
        error[times > 0.0] += self._lost(xf)
        if not np.all(error <= tol):
            first = times[~(error <= tol)][0]
            raise NotApplicable(
                f"at the time {first:g} the series of 1F1 cancels to more than {tol:g}; use fem"
            )
        return p, error

    def _transform(self, a: Complexes, x0: float, xf: float) -> tuple[Complexes, Array]:
        """Return 1F1(a; n; ``x0``)/1F1(a; n; ``xf``) at ``a`` (points,), and relative errors."""
        (above, above_error), (below, below_error) = (kummer(a, self.n, x) for x in (x0, xf))
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            relative = above_error / np.abs(above) + below_error / np.abs(below) + 4.0 * EPS
            ratio = above / below
        cancels = np.flatnonzero(~(relative <= CANCELLED * EPS))
        if cancels.size and x0 > CLOSE_STARTS[0] * xf and xf - x0 < CLOSE_STARTS[1]:
            log_ratio, error = log_kummer_ratio(a[cancels], self.n, x0, xf)
            better = ~(relative[cancels] <= error)
            ratio[cancels[better]] = np.exp(log_ratio[better])
            relative[cancels[better]] = error[better]
        return ratio, relative

    def _lost(self, xf: float) -> float:
        """Relative error of mean times ~ e^``xf`` and rates ~ e^−``xf`` by the errors of c and d;
        ``xf`` is c H_f/d for the limit H_f."""
        return (3.0 + 2.0 * xf) * self.relative_error


def noncentral(n: int, x: Array, y: float) -> tuple[Array, Array]:
    """Return ln p and the absolute error of ln p: p = e^(−x−y) (x/y)^((n−1)/2) I_(n−1)(2 √(xy)).

    p is the density of half a noncentral χ² of 2n degrees, ``n`` >= 1, and noncentrality 2 ``y`` at
    ``x`` >= 0, of any shape.
    """
    few, root, other = x * y < SERIES_RANGE, np.sqrt(x), sqrt(y)
    # Σ (x y)^k/(k! (n)_k), of positive terms.
    powers, series = x[few] * y, np.ones(np.count_nonzero(few))
    for k in range(40, 0, -1):
        series = 1.0 + series * powers / (k * (n + k - 1.0))
    z, mu = 2.0 * root * other, 4.0 * (n - 1) ** 2
    with np.errstate(divide="ignore", invalid="ignore"):
        # ln of e^(−z) I_(n−1)(z), by Abramowitz and Stegun (9.7.1) at the very large z at which
        # SciPy returns NaN; the next term is below round-off.
        value, w = np.log(ive(n - 1, z)), 8.0 * z
        tail = 1.0 - (mu - 9.0) / (2.0 * w) * (1.0 - (mu - 25.0) / (3.0 * w))
        far = np.log1p(-(mu - 1.0) / w * tail) - 0.5 * np.log(2.0 * pi * z)
        value = np.where(np.isnan(value), far, value)
        value += (n - 1) * np.log(root / other) if n > 1 else 0.0
    value -= (root - other) ** 2
    value[few] = xlogy(n - 1, x[few]) - x[few] - y + np.log(series) - gammaln(n)
    # Errors of the exponent of p are errors of ln p.
    parts = np.where(few, x + y, np.abs(root - other) * (root + other))
    steep = np.where(x > 0.0, (n - 1) * np.abs(np.log(np.maximum(x, SMALLEST))), 0.0)
    return value, EPS * (BESSEL + 4.0 * parts + 2.0 * (gammaln(n + 1.0) + steep))


def kummer(a: Complexes, n: int, x: float) -> tuple[Complexes, Array]:
    """Return 1F1(``a``; ``n``; ``x`` >= 0) at ``a`` (points,), and its absolute error, which is inf
    if the series needs more than ``MOST_TERMS`` terms or overflows."""
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


def log_kummer_ratio(a: Complexes, n: int, low: float, high: float) -> tuple[Complexes, Array]:
    """Return ln(1F1(a; ``n``; ``low``)/1F1(a; n; ``high``)) at ``a`` (points,), and its error.

    0 < low < high. It is −∫ 1F1'/1F1 dx by Gauss's continued fraction, DLMF (13.5.1), in which
    nothing cancels for a away from the negative axis. For |a| < ``LEAST_SIZE``, and if more than
    ``MOST_TERMS`` terms are needed, 0 is returned with the absolute error inf.
    """
    nodes = [low]
    while nodes[-1] < high:  # zeros of 1F1 have angles above a radian, or imaginary parts of π
        nodes.append(min(high, RATIO_PANELS[0] * nodes[-1], nodes[-1] + RATIO_PANELS[1]))
    x, w = (part.reshape(-1, 1) for part in panel_rule(np.array(nodes), RATIO_POINTS))
    terms = 3.0 * np.sqrt(np.abs(a) * high) + high + 60.0
    near = (terms <= MOST_TERMS) & (np.abs(a) >= LEAST_SIZE)
    inside, fraction = a[near], np.ones((x.size, int(near.sum())), dtype=complex)
    for k in range(int(np.max(terms[near], initial=0.0)), 0, -1):
        top = inside + k // 2 if k % 2 == 0 else inside - (n + k // 2)
        fraction = 1.0 + top * x / ((n + k - 1) * (n + k)) / fraction
    slopes = w * inside / n / fraction
    value, error = np.zeros_like(a), np.full(a.size, np.inf)
    value[near] = -slopes.sum(axis=0)
    error[near] = 2.0 * ROUNDINGS * EPS * (1.0 + np.abs(slopes).sum(axis=0))
    return value, error
