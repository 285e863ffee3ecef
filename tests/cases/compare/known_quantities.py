"""Quantities of Gibbs states by quadrature of their own.

In a Gibbs state all but the displacement of the one mass at stops is quadratic in H. With W(q) the
least potential at q, p(q) ∝ exp(−W/T), and H − W is a Gamma variable of the order n − ½.
"""

from math import factorial

import numpy as np
from scipy import stats
from scipy.optimize import brentq
from scipy.special import gammainc

PANELS, DEPTH, POINTS = 24, 30, 20
"""Panels of a displacement, halvings of the one beside a stop, and Gauss points of each."""
REACH = 13.5
"""Thermal displacements that an axis reaches: beyond lies e^−91 of the whole."""
ROUND_OFF = 4e-15
"""Of the references, relative to the size of what they are of."""


def of_cumulants(mean, second, third, fourth):
    """By quantity, its exact number and the size that its round-off is relative to."""
    std = np.sqrt(second)
    skewness, kurtosis = third / std**3, 3.0 + fourth / second**2
    return {
        "mean": (mean, std),
        "rms": (np.hypot(mean, std), std),
        "std": (std, std),
        "skewness": (skewness, 1.0),
        "kurtosis": (kurtosis, 1.0 + kurtosis),
    }


def central(weights, x):
    """Mean and cumulants of values with weights."""
    mean = weights @ x
    second, third, fourth = (weights @ (x - mean) ** k for k in (2, 3, 4))
    return np.array([mean, second, third, fourth - 3.0 * second**2])


def normal_truth(variance):
    normal = stats.norm(scale=np.sqrt(variance))
    cumulants = of_cumulants(0.0, variance, 0.0, 0.0)
    return cumulants, lambda x: (normal.cdf(x), normal.sf(x), normal.pdf(x))


class Gibbs:
    """exp(−H/T), stops at one mass at the most, ``row`` from 0: that mass or, without, any."""

    def __init__(self, system, temperature, row):
        self.system, self.T = system, temperature
        self.compliance = float(np.sum(1.0 / system.stiffness[: row + 1]))
        self.order = system.n - 0.5
        self.x, w = self.rule()
        self.W = self.potential(self.x)
        shares = w * np.exp(-self.W / self.T)
        self.total = shares.sum()
        self.share = shares / self.total

    def potential(self, q):
        W = 0.5 * q * q / self.compliance
        for stop in self.system.stops:
            overlap = np.maximum(stop.sign * q - stop.clearance, 0.0)
            W = W + stop.stiffness * overlap ** (stop.power + 1.0) / (stop.power + 1.0)
        return W

    def rule(self, *cuts, ends=(-np.inf, np.inf)):
        """Gauss points and weights on panels that crowd about stops, ``cuts`` and ``ends``."""
        reach = REACH * np.sqrt(self.compliance * self.T)
        steps = reach * 2.0 ** -np.arange(1.0, DEPTH)
        places = [s.sign * s.clearance for s in self.system.stops] + [*cuts, *ends]
        nodes = [np.linspace(-reach, reach, PANELS + 1)]
        nodes += [a + np.concatenate([-steps, [0.0], steps]) for a in places if np.isfinite(a)]
        low, high = max(-reach, ends[0]), min(reach, ends[1])
        nodes = np.unique(np.clip(np.concatenate(nodes), low, high))
        x, w = np.polynomial.legendre.leggauss(POINTS)
        half = 0.5 * np.diff(nodes)[:, None]
        return (nodes[:-1, None] + half * (1.0 + x)).ravel(), (half * w).ravel()

    def cdf_q(self, q):
        """P(q <= x), P(q > x) and p(x)."""
        x, w = self.rule(q)
        shares = w * np.exp(-self.potential(x) / self.T)
        low, high = (float(shares[side].sum()) for side in (x <= q, x > q))
        return (
            low / (low + high),
            high / (low + high),
            np.exp(-self.potential(q) / self.T) / self.total,
        )

    def cdf_H(self, energy):
        """P(H <= x), P(H > x) and p(x), the latter by a difference."""
        far, values = 2.0 * np.sqrt(2.0 * energy * self.compliance), []
        for H in energy * np.array([1.0, 1.0 - 1e-4, 1.0 + 1e-4]):
            turning = [
                s
                * brentq(
                    lambda x, s=s, H=H: self.potential(s * x) - H, 0.0, far, xtol=1e-300, rtol=1e-15
                )
                for s in (-1.0, 1.0)
            ]
            x, w = self.rule(ends=turning)
            W = self.potential(x)
            inside = gammainc(self.order, np.maximum(H - W, 0.0) / self.T)
            values.append(w @ (np.exp(-W / self.T) * inside) / self.total)
        return values[0], 1.0 - values[0], (values[2] - values[1]) / (2e-4 * energy)

    def truth(self, name):
        """By quantity, the exact number and its size; the distribution function."""
        if name[0] == "p":
            return normal_truth(self.system.mass[int(name[1:]) - 1] * self.T)
        if name == "H":
            gamma = [self.order * factorial(k) * self.T ** (k + 1) for k in range(4)]
            return of_cumulants(*(central(self.share, self.W) + gamma)), self.cdf_H
        known = of_cumulants(*central(self.share, self.x))
        mass = self.system.mass[int(name[1:]) - 1]
        for stop in self.system.stops:
            overlap = np.maximum(stop.sign * self.x - stop.clearance, 0.0)
            touching, depth = self.share @ (overlap > 0.0), self.share @ overlap
            force = self.share @ (stop.stiffness * overlap**stop.power)
            beside = np.exp(-self.potential(stop.sign * stop.clearance) / self.T) / self.total
            numbers = {
                "contact probability": touching,
                "mean overlap": depth,
                "mean force": force,
                "overlap in contact": depth / touching if touching else np.nan,
                "force in contact": force / touching if touching else np.nan,
                "upcrossing rate": beside * np.sqrt(self.T / (2.0 * np.pi * mass)),
            }
            known |= {f"{key}, {stop.side} stop": (x, x) for key, x in numbers.items()}
        return known, self.cdf_q
