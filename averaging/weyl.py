"""Weyl integrals of a phase-space density known on a mesh of energies."""

from collections.abc import Callable
from dataclasses import dataclass
from math import gamma

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaincc

from fpk.piecewise import Piecewise, interpolated
from fpk.quadrature import gauss_legendre, panel_rule

Array = NDArray[np.float64]

POINTS = (14, 18)
"""Gauss points per element of a table and of its integrals, and of the finer table: the
distance between the two is the error of both."""


@dataclass(frozen=True, eq=False)
class WeylTable:
    """Ψ_ν(E) = ∫_E^end u(H) (H − E)^(ν−1)/Γ(ν) dH by polynomials of ln Ψ on the elements of a mesh.

    Ψ falls exponentially, so its logarithm is what is smooth. Zero from the last node on.
    """

    log_values: Piecewise

    def __call__(self, energy: Array) -> Array:
        """Ψ_ν at energies of any shape."""
        x = np.asarray(energy, dtype=float)
        nodes = self.log_values.nodes
        value = np.exp(self.log_values(np.clip(x, nodes[0], nodes[-1])))
        return np.where(x < nodes[-1], value, 0.0)


def weyl_table(
    order: float, nodes: Array, u: Callable[[Array], Array], *, points: int = POINTS[1]
) -> WeylTable:
    """Tabulate Ψ_ν for ν = ``order``, a multiple of ½ >= 0, of a ``u`` smooth between ``nodes``.

    Ψ_0 is u itself. Beyond the last node u is continued exponentially at the rate of the last
    element: Ψ then keeps its relative accuracy up to that node, beyond which it is dropped.
    """

    def log_weyl(energy: Array) -> Array:
        if order == 0:
            total = u(energy)
        else:
            element = np.repeat(np.arange(nodes.size - 1), points)
            total = continued(order, energy, nodes, u)
            total += _integrals(order, energy, element, nodes, u, points)
        return np.log(np.maximum(total, np.finfo(float).tiny))

    coefficients = interpolated(log_weyl, nodes[:-1], nodes[1:], points - 1)
    return WeylTable(Piecewise(nodes, coefficients))


def _integrals(
    order: float,
    energy: Array,
    element: NDArray[np.intp],
    nodes: Array,
    u: Callable[[Array], Array],
    points: int,
) -> Array:
    """∫_E^last u(H) (H − E)^(ν−1)/Γ(ν) dH at energies, each in its ``element`` of the mesh."""
    total = np.zeros(energy.size)
    x, w = panel_rule(nodes, points)
    values = w * u(x)
    for k in range(nodes.size - 1):
        left, right = nodes[k], nodes[k + 1]
        near = np.flatnonzero((element <= k) & (left - energy < right - left))
        far = np.flatnonzero(left - energy >= right - left)
        total[near] += _near(order, energy[near], left, right, u, points)
        total[far] += (x[k] - energy[far, None]) ** (order - 1.0) @ values[k]
    return total / gamma(order)


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
