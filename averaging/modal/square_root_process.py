"""Closed forms of the square-root process in time: a modal energy, or several of equal decay.

In units of the mean decay time 1/c and of the temperature θ, x = H/θ obeys
``dx = (n − x) dt + √(2x) dB``: stationary density x^(n−1) e^(−x)/Γ(n), relaxation rates 1, 2, …
"""

from typing import NamedTuple

import numpy as np
from scipy.linalg import eigh
from scipy.special import gammainc, gammaln, ive

from fpk.arrays import Array
from fpk.quadrature import gauss_legendre, panel_rule

EPS = float(np.finfo(float).eps)
DEEPEST = 300.0
"""Largest limit x whose E T² ~ e^(2x) is within double precision."""
RULE = (12, 2.0)
"""Gauss points of a panel and its largest length: e^x is integrated to round-off."""
ROUNDING = 64.0 * EPS
"""Relative round-off of integrals of positive terms, and of densities per unit of exponent."""


class Moments(NamedTuple):
    """Mean and variance of a first-passage time, with errors."""

    mean: float
    mean_error: float
    variance: float
    variance_error: float


def transition_density(x: Array, start: float, t: float, n: float = 1.0) -> tuple[Array, Array]:
    """Return p(x, t | ``start``) and its error by round-off, 0 for x < 0.

    (1/τ) (x/y)^((n−1)/2) e^(−(x+y)/τ) I_(n−1)(2√(xy)/τ) with τ = 1 − e^(−t), y = start e^(−t): a
    noncentral χ² of 2n degrees (Cox, Ingersoll and Ross 1985, Eq. (18)).
    """
    tau, y = -np.expm1(-t), start * np.exp(-t)
    inside = np.maximum(x, 0.0)
    z = 2.0 * np.sqrt(inside * y) / tau
    exponent = -((np.sqrt(inside) - np.sqrt(y)) ** 2) / tau
    if y > 0.0 and n == 1.0:
        p = np.exp(exponent) * ive(0.0, z) / tau
    else:
        # (x/y)^ν I_ν(z) e^(−z), ν = n − 1, by its limit e^(−z)/Γ(n) (z/2)^ν where z is small.
        nu = n - 1.0
        small = z < 1e-8
        safe = np.where(small, 1.0, z)
        scaled = ive(nu, safe) * (2.0 / safe) ** nu
        limit = np.exp(-z - gammaln(n))
        p = np.exp(exponent) * np.where(small, limit, scaled) * (inside / tau) ** nu / tau
    terms = (inside + y) / tau + 8.0
    return np.where(x >= 0.0, p, 0.0), np.where(x >= 0.0, ROUNDING * terms * p, 0.0)


def exponential_mean(factor: float, t: float) -> float:
    """Return the mean, in units of θ, of an energy that was exponential of mean ``factor`` θ.

    It stays exponential: 1 + (factor − 1) e^(−t), for n = 1.
    """
    return 1.0 + (factor - 1.0) * float(np.exp(-t))


def passage_moments(limit: float, start: float, n: float = 1.0) -> Moments:
    """Return mean and variance of the first passage of x = ``limit`` from ``start`` below it.

    ``T' = −(1/m) ∫_0^x π`` and, as L Var = −b T'², ``Var' = −(1/m) ∫_0^x π b T'²`` with
    π = x^(n−1) e^(−x), m = x π, b = 2x: only positive terms, so that both have full relative
    accuracy however rare the failure.
    """
    nodes = _panels(limit, start)
    values = [_moments(nodes, start, n, points) for points in (RULE[0], RULE[0] + 4)]
    (mean, variance), (finer, finer_variance) = values
    rounding = ROUNDING * (1.0 + limit)
    return Moments(
        finer,
        abs(finer - mean) + rounding * finer,
        finer_variance,
        abs(finer_variance - variance) + rounding * finer_variance,
    )


def _panels(limit: float, start: float) -> Array:
    count = 1 + int(np.ceil(limit / RULE[1]))
    return np.unique(np.concatenate([np.linspace(0.0, limit, count), [start]]))


def _moments(nodes: Array, start: float, n: float, points: int) -> tuple[float, float]:
    x, w = panel_rule(nodes, points)

    def slope(y: Array) -> Array:
        """−T' = e^y y^(−n) γ(n, y), 1/n at 0."""
        return np.exp(y + gammaln(n) - n * np.log(y)) * gammainc(n, y)

    above = x[:, 0] > start
    mean = float(np.sum((w * slope(x))[above]))
    # ∫_0^x 2 y^n e^(−y) T'² dy at the points: whole panels, and the last one up to x.
    t, _ = gauss_legendre(points)
    half = 0.5 * (1.0 + t)
    lower, width = nodes[:-1, None, None], np.diff(nodes)[:, None, None]
    y = lower + width * half[:, None] * half
    partial = 0.5 * (width * half[:, None]) * gauss_legendre(points)[1]

    def inner(z: Array) -> Array:
        return 2.0 * z**n * np.exp(-z) * slope(z) ** 2

    whole = np.concatenate([[0.0], np.cumsum(np.sum(w * inner(x), axis=1))[:-1]])
    up_to = whole[:, None] + np.sum(partial * inner(y), axis=2)
    return mean, float(np.sum((w * x ** (-n) * np.exp(x) * up_to)[above]))


class Decay(NamedTuple):
    """P(T > t) = Σ ``weights``_k e^(−``rates``_k t), with an error for all t."""

    rates: Array
    weights: Array
    rate_errors: Array
    error: float

    def survival(self, times: Array) -> tuple[Array, Array]:
        """Return P(T > t) and its error at ``times`` >= 0."""
        decays = np.exp(-np.outer(times, self.rates))
        value = np.where(times > 0.0, decays @ self.weights, 1.0)
        late = np.outer(times, self.rate_errors) * decays
        # Left out are modes faster than the last one.
        last = np.abs(self.weights[-2:]).max() * decays[:, -1] * self.rates.size
        error = late @ np.abs(self.weights) + last + self.error
        return value, np.where(times > 0.0, error, 0.0)


def passage_decay(limit: float, start: float, n: float = 1.0) -> Decay:
    """Return the expansion of P(T > t) in the eigenfunctions M(−λ; n; x) that vanish at the limit.

    With φ = e^(x/2) q the form is ∫ x^n (q' + q/2)², and polynomials q, of a degree that resolves
    e^(−x/2), need no weight. The least rate, which may be 1e-100, is the root of the power series
    of M, whose terms but the first are of one sign for λ < 1.
    """
    answers = [_decay(limit, start, n, int(degree + 0.9 * limit)) for degree in (64, 84)]
    (coarse, _), (rates, weights) = answers
    count = min(coarse.size, 40)
    rates, weights = rates[:count], weights[:count]
    errors = np.abs(rates - coarse[:count]) + 1e-13 * (1.0 + rates)
    least, least_error = _least_rate(limit, n, rates[0])
    rates[0], errors[0] = least, least_error
    lost = 2.0 * float(np.max(np.abs(weights - answers[0][1][:count])[: count // 2]))
    return Decay(rates, weights, errors, lost + 1e-13)


def _decay(limit: float, start: float, n: float, degree: int) -> tuple[Array, Array]:
    """Rates and weights by Galerkin's method, in 1 − s and its products with Legendre P_j(2s − 1).

    The eigenvalues of the shifted inverse, 1/(1 + λ), are those that are computed.
    """
    points = degree + int(n) + 24
    t, w = gauss_legendre(points)
    s, v = 0.5 * (1.0 + t), 0.5 * w * limit
    legendre = np.polynomial.legendre
    P = legendre.legvander(t, degree)
    slopes = np.stack(
        [legendre.legval(t, legendre.legder(row)) for row in np.eye(degree + 1)], axis=1
    )
    q = (1.0 - s)[:, None] * P
    dq = (-P + (1.0 - s)[:, None] * 2.0 * slopes) / limit
    x = limit * s
    M = q.T @ ((v * x ** (n - 1.0))[:, None] * q)
    flow = dq + 0.5 * q
    K = flow.T @ ((v * x**n)[:, None] * flow)
    mu, X = eigh(M, K + M)
    mu, X = mu[::-1], X[:, ::-1] / np.sqrt(np.maximum(mu[::-1], 1e-300))
    at = (1.0 - start / limit) * legendre.legvander(np.array([2.0 * start / limit - 1.0]), degree)[
        0
    ]
    load = q.T @ (v * x ** (n - 1.0) * np.exp(-0.5 * x))
    return 1.0 / mu - 1.0, (load @ X) * (np.exp(0.5 * start) * at @ X)


def _least_rate(limit: float, n: float, guess: float) -> tuple[float, float]:
    """The least root of M(−λ; n; x) = 1 − λ Σ_k (1−λ)_(k−1) x^k/((n)_k k!), by Newton's method."""
    if guess > 0.5:
        return _bracketed(limit, n, guess)
    k = np.arange(1.0, 4.0 * limit + 80.0)
    log_terms = k * np.log(limit) - gammaln(n + k) + gammaln(n) - gammaln(k + 1.0)
    rate = 0.0
    for _ in range(60):
        factors = np.concatenate([[0.0], np.cumsum(np.log(k[:-1] - rate))])
        total = float(np.sum(np.exp(log_terms + factors)))
        last, rate = rate, 1.0 / total
        if abs(rate - last) <= EPS * rate:
            break
    error = abs(rate - last) + ROUNDING * (2.0 + limit) * rate
    return rate, error


def _bracketed(limit: float, n: float, guess: float) -> tuple[float, float]:
    """A least rate that is not small, as Galerkin's method gives it."""
    return guess, 1e-13 * (1.0 + guess)
