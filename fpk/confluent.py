"""Confluent hypergeometric functions of the square-root process, each with its round-off."""

from math import pi, sqrt

import numpy as np
from scipy.special import gammaln, ive, xlogy

from fpk.arrays import Array
from fpk.density import SMALLEST
from fpk.dynamics import Complex

EPS = float(np.finfo(float).eps)
MOST_TERMS = 20_000
"""Terms of a series of 1F1, beyond which it is left to the finite elements."""
BESSEL = 50.0
"""Error of scipy's ``ive`` in roundings, and of the power series beside it."""
FEW, MOST_POWERS = 60.0, 120
"""x y below which the Bessel function is summed as a power series, and its terms."""
LARGE = 1e4
"""Argument of a Bessel function, over the square of its order, beyond which it is asymptotic."""


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


def series_terms(x: float) -> int:
    """Terms of a power series like that of e^x, up to round-off."""
    return int(x + 12.0 * sqrt(x)) + 60
