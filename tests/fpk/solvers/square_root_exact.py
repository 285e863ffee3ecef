"""Exact answers in time of the square-root process by mpmath, x = c H/d, time in units of 1/c."""

import mpmath as mp

mp.mp.dps = 40


def moments(n, x):
    """c E T and c² Var T of the passage 0 → x, from Σ (a)_k x^k/(k! (n)_k) in powers of a."""
    x, term, first, second, harmonic = mp.mpf(x), mp.mpf(1), mp.mpf(0), mp.mpf(0), mp.mpf(0)
    for k in range(1, int(x + 40 * mp.sqrt(x)) + 120):
        term *= x / (n + k - 1)
        first += term / k
        second += harmonic * term / k
        harmonic += mp.mpf(1) / k
    return first, first**2 - 2 * second


def rate(n, x, guess):
    """The failure rate: the least zero in a of 1F1(−a; n; x)."""
    return mp.findroot(lambda a: mp.hyp1f1(-a, n, x, maxterms=10**6), guess, verify=False)


def failure(n, start, limit, t):
    """P(T <= t) by Talbot's inverse transform of 1F1(s; n; x_0)/1F1(s; n; x_f)/s."""

    def transform(s):
        above, below = (mp.hyp1f1(s, n, x, maxterms=10**6) for x in (start, limit))
        return above / below / s

    return mp.invertlaplace(transform, t, method="talbot", degree=40)


def density(n, x, start, t):
    """p(x, t | start), noncentral χ² of 2n degrees."""
    theta = 1 - mp.exp(-mp.mpf(t))
    x, y = mp.mpf(x) / theta, mp.mpf(start) * mp.exp(-mp.mpf(t)) / theta
    if y == 0:
        return x ** (n - 1) * mp.exp(-x) / mp.gamma(n) / theta
    bessel = mp.besseli(n - 1, 2 * mp.sqrt(x * y))
    return mp.exp(-x - y) * (x / y) ** (mp.mpf(n - 1) / 2) * bessel / theta
