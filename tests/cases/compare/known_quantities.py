"""Quantities of scenes whose density is known by condition (8), by quadrature of their own.

Where condition (8) holds p(q, v) ∝ exp(−Φ(H)), Φ = ∫ h dH, of a Gibbs state H/T. All but the
displacements of some masses, those at stops among them, is quadratic in H: an expectation is an
integral over these, in which the rest is Ψ_ν(W) = ∫ y^(ν−1) exp(−Φ(W + y)) dy/Γ(ν), 2ν its number
of coordinates.
"""

from dataclasses import dataclass
from functools import cached_property, reduce
from math import factorial

import numpy as np
from known_gaussian import normal_truth, of_cumulants
from numpy.polynomial import polynomial
from scipy import stats
from scipy.optimize import brentq
from scipy.special import gamma, gammainc

PANELS, DEPTH, POINTS = 24, 30, 20
"""Panels of a displacement, halvings of the one beside a stop, and Gauss points of each."""
REACH = 13.5
"""Thermal displacements that an axis reaches: beyond lies e^−91 of the whole."""
ROUND_OFF = 4e-15
"""Of the references, relative to the size of what they are of."""


def rule(nodes):
    """Gauss points and weights of panels between ``nodes``."""
    x, w = np.polynomial.legendre.leggauss(POINTS)
    half = 0.5 * np.diff(nodes)[:, None]
    return (nodes[:-1, None] + half * (1.0 + x)).ravel(), (half * w).ravel()


def layers(at, length):
    """Nodes that crowd about a point on both sides."""
    steps = length * 2.0 ** -np.arange(1.0, DEPTH)
    return at + np.concatenate([-steps, [0.0], steps])


def of_moments(weights, x):
    """The same of values with weights."""
    mean = weights @ x
    second, third, fourth = (weights @ (x - mean) ** k for k in (2, 3, 4))
    return of_cumulants(mean, second, third, fourth - 3.0 * second**2)


@dataclass(eq=False)
class Exact:
    """exp(−Φ(H)), h = Σ rate_e H^e; ``row`` (from 0) is the mass whose displacement is asked for.

    Rates with powers of H: of two coordinates and more, with no more than one mass at stops.
    """

    system: object
    rate: np.ndarray
    row: int

    def __post_init__(self):
        touching = [i for i in self.system.contact_masses if i != self.row]
        self.masses = (self.row, *touching)
        # Springs in series to the wall: the nearer of two masses decides.
        series, rows = np.cumsum(1.0 / self.system.stiffness), np.array(self.masses)
        self.compliance = series[np.minimum.outer(rows, rows)]
        self.order = self.system.n - 0.5 * len(self.masses)
        self.gibbs = self.rate.size == 1
        exponent = polynomial.polyint(self.rate)
        # exp(−Φ) is e^−100 of its largest at the last energy.
        energies = np.geomspace(1e-3, 1e6, 20001) / abs(self.rate[0])
        phi = polynomial.polyval(energies, exponent)
        self.shift = min(0.0, phi.min())
        self.end = float(energies[np.nonzero(phi - self.shift < 100.0)[0][-1]])
        self.phi = lambda H: polynomial.polyval(H, exponent) - self.shift

    def potential(self, mesh):
        """W of displacements (masses, ...)."""
        W = 0.5 * np.einsum("i...,ij,j...->...", mesh, np.linalg.inv(self.compliance), mesh)
        for stop in self.system.stops:
            q = mesh[self.masses.index(stop.mass - 1)]
            overlap = np.maximum(stop.sign * q - stop.clearance, 0.0)
            W = W + stop.stiffness * overlap ** (stop.power + 1.0) / (stop.power + 1.0)
        return W

    def psi(self, W, order, most=np.inf, of=np.ones_like):
        """∫ f(W + y) y^(ν−1) exp(−Φ(W + y)) dy/Γ(ν) up to H = ``most``."""
        if self.gibbs and of is np.ones_like:
            T, room = 1.0 / self.rate[0], np.maximum(most - W, 0.0)
            share = 1.0 if most == np.inf else gammainc(order, room / T)
            return T**order * np.exp(-W / T) * share
        z, w = rule(np.linspace(0.0, 1.0, 33))
        root = np.sqrt(np.maximum(min(most, self.end) - W, 0.0))[..., None]
        H = W[..., None] + (root * z) ** 2
        kernel = 2.0 * root ** (2.0 * order) * z ** (2.0 * order - 1.0) / gamma(order)
        return (kernel * of(H) * np.exp(-self.phi(H))) @ w

    def grid(self, cuts=(), ends=(-np.inf, np.inf)):
        """Displacements (masses, points), weights, W; ``cuts`` and ``ends`` of the first."""
        axes = []
        for k, mass in enumerate(self.masses):
            own = np.sqrt(self.compliance[k, k])
            reach = (
                own * np.sqrt(2.0 * self.end)
                if not self.gibbs
                else (REACH * own / np.sqrt(self.rate[0]))
            )
            places = [s.sign * s.clearance for s in self.system.stops if s.mass - 1 == mass]
            places += [*cuts, *ends] if k == 0 else []
            panels = PANELS if self.gibbs else 4 * PANELS
            nodes = [np.linspace(-reach, reach, panels + 1)]
            nodes += [layers(a, reach) for a in places if np.isfinite(a)]
            low, high = (max(-reach, ends[0]), min(reach, ends[1])) if k == 0 else (-reach, reach)
            nodes = np.unique(np.concatenate(nodes))
            axes.append(rule(np.unique(np.clip(nodes, low, high))))
        mesh = np.array([x.ravel() for x in np.meshgrid(*(x for x, _ in axes), indexing="ij")])
        weights = reduce(np.multiply.outer, [w for _, w in axes]).ravel()
        return mesh, weights, self.potential(mesh)

    @cached_property
    def whole(self):
        """The grid without cuts, with the shares of its points."""
        mesh, weights, W = self.grid()
        shares = weights * self.psi(W, self.order)
        return mesh, W, shares, float(shares.sum())

    def cdf_q(self, x):
        """P(q <= x) and p(x)."""
        mesh, weights, W = self.grid(cuts=(x,))
        shares = weights * self.psi(W, self.order)
        low, high = (float(shares[s].sum()) for s in (mesh[0] <= x, mesh[0] > x))
        beside = self.grid_at(x)
        return low / (low + high), high / (low + high), beside / self.whole[3]

    def grid_at(self, x, order=None):
        """∫ Ψ over the other masses at q = x."""
        if len(self.masses) == 1:
            return float(self.psi(self.potential(np.array([[x]])), order or self.order)[0])
        raise NotImplementedError

    def cdf_H(self, x):
        """P(H <= x) and p(x), the latter by a difference."""
        values = []
        for most in (x, x * (1.0 - 1e-4), x * (1.0 + 1e-4)):
            _, weights, W = self.grid(ends=self.turning(most))
            values.append(weights @ self.psi(W, self.order, most))
        step = 1e-4 * x
        low = values[0] / self.whole[3]
        return low, 1.0 - low, (values[2] - values[1]) / (2.0 * step) / self.whole[3]

    def turning(self, energy):
        """Displacements between which W < energy."""
        far = 2.0 * np.sqrt(2.0 * energy * self.compliance[0, 0])
        return tuple(
            sign * brentq(
                lambda s, sign=sign: float(self.potential(np.array([sign * s]))) - energy,
                0.0, far, xtol=1e-300, rtol=1e-15,
            )
            for sign in (-1.0, 1.0)
        )  # fmt: skip

    def truth(self, name):
        """By quantity, the exact number and its size; ``cdf`` of the coordinate."""
        mesh, W, shares, total = self.whole
        m = self.system.mass[self.row]
        if name == "H":
            cdf = self.cdf_H if len(self.masses) == 1 else None
            if not self.gibbs:
                weights = self.grid()[1]

                def mean(f):
                    return float(weights @ self.psi(W, self.order, of=f)) / total

                first = mean(lambda H: H)
                second, third, fourth = (mean(lambda H, k=k: (H - first) ** k) for k in (2, 3, 4))
                return of_cumulants(first, second, third, fourth - 3.0 * second**2), cdf
            share, T = shares / total, 1.0 / self.rate[0]
            mu = share @ W
            c2, c3, c4 = (share @ (W - mu) ** k for k in (2, 3, 4))
            own = (mu, c2, c3, c4 - 3.0 * c2**2)
            kappa = [o + self.order * factorial(k) * T ** (k + 1) for k, o in enumerate(own)]
            return of_cumulants(*kappa), cdf
        if name[0] == "p":
            assert self.gibbs
            normal = stats.norm(scale=np.sqrt(m / self.rate[0]))
            return normal_truth(normal)
        share, q = shares / total, mesh[0]
        known = of_moments(share, q)
        for stop in self.system.stops:
            if stop.mass - 1 != self.row:
                continue
            where = f"{stop.side} stop"
            overlap = np.maximum(stop.sign * q - stop.clearance, 0.0)
            touching, depth = share @ (overlap > 0.0), share @ overlap
            force = share @ (stop.stiffness * overlap**stop.power)
            known[f"contact probability, {where}"] = touching, touching
            known[f"mean overlap, {where}"] = depth, depth
            known[f"mean force, {where}"] = force, force
            if touching > 0.0:
                known[f"overlap in contact, {where}"] = depth / touching, depth / touching
                known[f"force in contact, {where}"] = force / touching, force / touching
            if len(self.masses) == 1:
                at = stop.sign * stop.clearance
                rate = self.grid_at(at, self.order + 0.5) / total / np.sqrt(2.0 * np.pi * m)
                known[f"upcrossing rate, {where}"] = rate, rate
        return known, self.cdf_q
