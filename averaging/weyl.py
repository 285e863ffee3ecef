"""Weyl integrals of a phase-space density known on a mesh of energies."""

from collections.abc import Callable
from dataclasses import dataclass
from math import gamma

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BarycentricInterpolator
from scipy.special import gammaincc

from fpk.quadrature import gauss_legendre, panel_rule

Array = NDArray[np.float64]

POINTS = (14, 18)
"""Gauss points per panel and Chebyshev points per element of a table, and of the finer table: the
distance between the two is the error of both."""


@dataclass(frozen=True, eq=False)
class WeylTable:
    """Table of ln Ψ_ν(E), Ψ_ν(E) = ∫_E^end u(H) (H − E)^(ν−1)/Γ(ν) dH, on the elements of a mesh.

    ``nodes`` (elements + 1,) and ``log_values`` (elements, points) at Chebyshev points of each; Ψ
    falls exponentially, so its logarithm is what is smooth. Zero beyond the last node.
    """

    nodes: Array
    log_values: Array

    def __call__(self, energy: Array) -> Array:
        """Ψ_ν at energies of any shape."""
        x = np.asarray(energy, dtype=float).ravel()
        k = np.clip(np.searchsorted(self.nodes, x, side="right") - 1, 0, self.nodes.size - 2)
        left, right = self.nodes[k], self.nodes[k + 1]
        t = (2.0 * x - left - right) / (right - left)
        weights = _lagrange(np.clip(t, -1.0, 1.0), self.log_values.shape[1])
        value = np.exp(np.einsum("xj,xj->x", weights, self.log_values[k]))
        return np.where(x < self.nodes[-1], value, 0.0).reshape(np.shape(energy))


def weyl_table(
    order: float, nodes: Array, u: Callable[[Array], Array], *, points: int = POINTS[1]
) -> WeylTable:
    """Tabulate Ψ_ν for ν = ``order``, a multiple of ½ >= 0, of a ``u`` smooth between ``nodes``.

    Ψ_0 is u itself. Beyond the last node u is continued exponentially at the rate of the last
    element: Ψ then keeps its relative accuracy up to that node, beyond which it is dropped.
    """
    centre = 0.5 * (nodes[1:] + nodes[:-1])[:, None]
    half = 0.5 * np.diff(nodes)[:, None]
    # Clipped: an energy one unit of round-off outside its element would lose √ε of the integral.
    energy = np.clip(centre + half * _chebyshev(points), nodes[:-1, None], nodes[1:, None]).ravel()
    element = np.repeat(np.arange(nodes.size - 1), points)
    if order == 0:
        total = u(energy)
    else:
        total = gamma(order) * continued(order, energy, nodes, u)
        x, w = panel_rule(nodes, points)
        values = w * u(x)
        for k in range(nodes.size - 1):
            left, right = nodes[k], nodes[k + 1]
            near = np.flatnonzero((element <= k) & (left - energy < right - left))
            far = np.flatnonzero(left - energy >= right - left)
            total[near] += _near(order, energy[near], left, right, u, points)
            total[far] += (x[k] - energy[far, None]) ** (order - 1.0) @ values[k]
        total = total / gamma(order)
    log_values = np.log(np.maximum(total, np.finfo(float).tiny))
    return WeylTable(nodes, log_values.reshape(-1, points))


def continued(order: float, energy: Array, nodes: Array, u: Callable[[Array], Array]) -> Array:
    """Ψ_ν of what lies beyond the last node, for u falling there as over the last element."""
    before, last = u(nodes[-2:])
    if order == 0 or not before > last > 0.0:
        return np.zeros(energy.shape)
    rate = np.log(before / last) / (nodes[-1] - nodes[-2])
    reach = rate * np.maximum(nodes[-1] - energy, 0.0)
    # ln of e^reach Γ(ν, reach)/Γ(ν) underflows to −∞ far from the end, where the tail is nothing.
    with np.errstate(divide="ignore"):
        log_share = reach + np.log(gammaincc(order, reach))
    return np.asarray(last * rate**-order * np.exp(log_share))


def _near(
    order: float,
    energy: Array,
    left: float,
    right: float,
    u: Callable[[Array], Array],
    points: int,
) -> Array:
    """Integral over one element from E or its left end; H = E + s² takes out the root at E."""
    low = np.sqrt(np.maximum(left - energy, 0.0))[:, None]
    high = np.sqrt(np.maximum(right - energy, 0.0))[:, None]
    t, w = gauss_legendre(points)
    s = 0.5 * (low + high) + 0.5 * (high - low) * t
    inner = u(energy[:, None] + s * s) * 2.0 * s ** (2.0 * order - 1.0)
    return np.asarray((0.5 * (high - low) * inner) @ w)


def _chebyshev(points: int) -> Array:
    """Chebyshev points of the second kind, from −1 to 1."""
    return -np.cos(np.pi * np.arange(points) / (points - 1))


def _lagrange(t: Array, points: int) -> Array:
    """Values (t, points) of the Lagrange polynomials of the Chebyshev points at ``t``."""
    return np.asarray(BarycentricInterpolator(_chebyshev(points), np.eye(points))(t))
