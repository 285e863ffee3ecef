"""Confluent hypergeometric functions of the square-root process, each with its round-off."""

from math import pi, sqrt

import numpy as np
from scipy.special import gammaln, ive, xlogy

from fpk.arrays import EPS, ROUND_OFF, SMALLEST, Array, Complexes
from fpk.quadrature import panel_rule

MOST_TERMS = 20_000
"""Terms of a series of 1F1, or of a continued fraction, beyond which it is left to the finite
elements."""
BESSEL = 50.0
"""Error of scipy's ``ive`` in roundings, and of the power series beside it."""
FEW, MOST_POWERS = 60.0, 40
"""x y below which the Bessel function is summed as a power series, and its powers: 60^41/41!² is
1e-26, beside a sum of 1 or more."""
LARGE = 1e4
"""Argument of a Bessel function, over the square of its order, beyond which it is asymptotic."""
LEAST = 4.0
"""Least |a|: about the relaxation rates, small negative a, 1F1 has zeros near the real x."""
RATIO_PANELS, RATIO_POINTS = (1.5, 2.0), 14
"""Largest ratio and difference of the ends of a panel of x, and its Gauss points."""


def noncentral(n: int, x: Array, y: float) -> tuple[Array, Array]:
    """Return ln of e^(−x−y) (x/y)^((n−1)/2) I_(n−1)(2 √(xy)), n >= 1, and its error.

    As a density of x it is that of half a noncentral χ² of 2n degrees, noncentrality 2y.
    """
    few = x * y < FEW
    # Σ (x y)^k/(k! (n)_k), of positive terms.
    product, series = np.where(few, x * y, 0.0), np.ones(x.shape)
    for k in range(MOST_POWERS if y > 0.0 else 0, 0, -1):
        series = 1.0 + product / (k * (n + k - 1.0)) * series
    # e^(−z) I_(n−1)(z): scipy's has no value at very large z, where Abramowitz and Stegun (9.7.1)
    # has a next term below 1/LARGE^4.
    z, mu = 2.0 * np.sqrt(x) * np.sqrt(y), 4.0 * (n - 1) ** 2
    large = z > LARGE * n**2
    near, w = ive(n - 1, np.where(large, 1.0, z)), np.where(large, 8.0 * z, 1.0)
    tail = 1.0 - (mu - 1.0) / w * (1.0 - (mu - 9.0) / (2.0 * w) * (1.0 - (mu - 25.0) / (3.0 * w)))
    far = np.log(np.where(large, tail, 1.0)) - 0.5 * np.log(np.where(large, 2.0 * pi * z, 1.0))
    with np.errstate(divide="ignore", invalid="ignore"):
        by_series = xlogy(n - 1, x) - x - y + np.log(series) - gammaln(n)
        root, other = np.sqrt(x), np.sqrt(y)
        ratio = 0.0 if n == 1 else (n - 1) * np.log(root / other)
        by_bessel = np.where(large, far, np.log(near)) + ratio - (root - other) ** 2
    value = np.where(few, by_series, by_bessel)
    # Of an exponent, relative errors of its parts are errors of ln p.
    parts = np.where(few, x + y, np.abs(root - other) * (root + other))
    steep = np.where(x > 0.0, (n - 1) * np.abs(np.log(np.maximum(x, SMALLEST))), 0.0)
    return value, EPS * (BESSEL + 4.0 * parts + 2.0 * (gammaln(n + 1.0) + steep))


def kummer(a: Complexes, n: int, x: float) -> tuple[Complexes, Array]:
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


def log_kummer_ratio(a: Complexes, n: int, low: float, high: float) -> tuple[Complexes, Array]:
    """Return ln 1F1(a; n; low)/1F1(a; n; high), 0 < low < high, and its error, at ``a`` (points,).

    It is −∫ 1F1'/1F1 dx, in which nothing cancels however large a is, away from the negative axis.
    The slope is Gauss's continued fraction, DLMF (13.5.1). The error is infinite for |a| below
    ``LEAST``, and where that would need more than ``MOST_TERMS`` terms.
    """
    nodes = [low]
    while nodes[-1] < high:  # zeros of 1F1 are of angles beyond a radian, or an imaginary part of π
        nodes.append(min(high, RATIO_PANELS[0] * nodes[-1], nodes[-1] + RATIO_PANELS[1]))
    x, w = (part.reshape(-1, 1) for part in panel_rule(np.array(nodes), RATIO_POINTS))
    terms = 3.0 * np.sqrt(np.abs(a) * high) + high + 60.0
    near = (terms <= MOST_TERMS) & (np.abs(a) >= LEAST)
    inside, fraction = a[near], np.ones((x.size, int(near.sum())), dtype=complex)
    for k in range(int(np.max(terms[near], initial=0.0)), 0, -1):
        top = inside + k // 2 if k % 2 == 0 else inside - (n + k // 2)
        fraction = 1.0 + top * x / ((n + k - 1) * (n + k)) / fraction
    slopes = w * inside / n / fraction
    value, error = np.zeros_like(a), np.full(a.size, np.inf)
    value[near] = -slopes.sum(axis=0)
    error[near] = 2.0 * ROUND_OFF * EPS * (1.0 + np.abs(slopes).sum(axis=0))
    return value, error


def series_terms(x: float) -> int:
    """Terms of a power series like that of e^x, up to round-off."""
    return int(x + 12.0 * sqrt(x)) + 60
