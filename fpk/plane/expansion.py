"""Densities p = w u with u a polynomial of both energies, by Galerkin's method.

``∫ J · ∇v = 0`` for all polynomials v up to one degree along each axis, with
``J = (s − ½ ∇·b) p − ½ b ∇p = w (α u − ½ b ∇u)``, ``α = s − ½ ∇·b + ½ b ∇Φ``: the weak form of
the finite elements, with other trial functions. Where no probability flows (α = 0) it is definite
and weighted by w: an error of u matters as much as probability is there. As v = 1 is among the test
functions no probability is lost.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from fpk.errors import NotCertified
from fpk.plane.basis import Basis, orthonormal
from fpk.plane.pointwise import evaluated, seen_points, weighted_on_grid
from fpk.plane.weight import Weight
from fpk.process import Process
from fpk.quadrature import panel_rule

Array = NDArray[np.float64]

EPS = float(np.finfo(float).eps)
MOST_PANELS = 24
"""Panels along one axis: 24 panels of 34 points make 7e5 places."""


@dataclass(frozen=True, eq=False)
class Places:
    """Gauss points on the panels of a weight: energies along each axis and their weights.

    ``exponent``, ``w`` and ``area`` (points along H1, along H2); ``seen`` tells where w exceeds
    exp(−nats): beyond, nothing is integrated.
    """

    nodes: tuple[Array, Array]
    energies: tuple[Array, Array]
    exponent: Array
    slopes: tuple[Array, Array]
    area: Array
    seen: NDArray[np.bool_]

    @cached_property
    def w(self) -> Array:
        """w at the points."""
        return np.asarray(np.exp(-self.exponent))


def panels_of(weight: Weight, nats: float) -> tuple[Array, Array]:
    """Return the nodes of panels as far as w > exp(−``nats``).

    Raises ``NotCertified`` where w takes more than ``MOST_PANELS``.
    """
    nodes = weight.panels(nats)
    if max(x.size for x in nodes) > MOST_PANELS + 1:
        raise NotCertified(f"the weight takes more than {MOST_PANELS} panels along one energy")
    return nodes


def _in_quarters(nodes: tuple[Array, Array]) -> tuple[Array, Array]:
    """Nodes that cut each panel in four: p falls by e^(−8) at the most from one to the next.

    Whoever integrates p over them needs no more than twelve Gauss points: e^(−8t) to 3e-16.
    """
    first, second = (
        np.interp(np.arange(4 * (x.size - 1) + 1), 4.0 * np.arange(x.size), x) for x in nodes
    )
    return first, second


def places_of(weight: Weight, nodes: tuple[Array, Array], nats: float, points: int) -> Places:
    """Return ``points`` Gauss points on each panel."""
    (x, first), (y, second) = (
        (H.ravel(), share.ravel()) for H, share in (panel_rule(n, points) for n in nodes)
    )
    phi, *slopes = weight.on_grid(x, y)
    return Places(
        nodes, (x, y), phi, (slopes[0], slopes[1]), np.multiply.outer(first, second), phi < nats
    )


@dataclass(frozen=True, eq=False)
class Expansion:
    """p = w u between ``nodes``, 0 outside; ``coefficients`` (degree + 1, degree + 1)."""

    nodes: tuple[Array, Array]
    weight: Weight
    bases: tuple[Basis, Basis]
    coefficients: Array

    @property
    def degree(self) -> int:
        """Degree of u along each axis."""
        return len(self.coefficients) - 1

    @property
    def unknowns(self) -> int:
        """Number of coefficients."""
        return self.coefficients.size

    def rounding(self, H1: Array, H2: Array) -> Array:
        """Relative round-off of p at energies that broadcast together: of Φ, and of the sum u."""
        return EPS * (self.degree**2 + self.weight.terms(H1, H2))

    def __call__(self, H1: Array, H2: Array) -> Array:
        """p at energies that broadcast together."""
        x, y = np.asarray(H1, float), np.asarray(H2, float)
        inside = (x >= 0.0) & (x <= self.nodes[0][-1]) & (y >= 0.0) & (y <= self.nodes[1][-1])
        x, y = np.clip(x, 0.0, self.nodes[0][-1]), np.clip(y, 0.0, self.nodes[1][-1])
        p = self.u(x, y) * np.exp(-self.weight.exponent(x, y))
        return np.asarray(np.where(inside, p, 0.0))

    def on_grid(self, H1: Array, H2: Array) -> Array:
        """u on the grid (H1.size, H2.size)."""
        first, second = (b.values(H) for b, H in zip(self.bases, (H1, H2), strict=True))
        return np.asarray(first.T @ self.coefficients @ second)

    def u(self, H1: Array, H2: Array) -> Array:
        """u at energies that broadcast together."""
        if H1.ndim == 2 and H1.shape[1] == 1 and H2.ndim == 1:
            return self.on_grid(H1[:, 0], H2)
        first, second = (b.values(H) for b, H in zip(self.bases, (H1, H2), strict=True))
        across = np.tensordot(self.coefficients, second, axes=1)
        total = first[0] * across[0]
        for row, factor in zip(first[1:], across[1:], strict=True):
            total = total + row * factor
        return np.asarray(total)


@dataclass(frozen=True, eq=False)
class Solved:
    """An expansion, the places it was solved on, and its algebraic residual.

    ``residual`` is the largest of the equations relative to the terms that cancel in it.
    """

    density: Expansion
    places: Places
    residual: float


def solve_expansion(
    process: Process,
    weight: Weight,
    nodes: tuple[Array, Array],
    degree: int,
    *,
    nats: float,
    points: int,
) -> Solved:
    """Return p = w u of mass 1 with u of ``degree`` along each axis.

    Integrals go over panels between ``nodes``, of ``points`` Gauss points, as far as
    w > exp(−``nats``). Raises ``NotCertified`` where there is no unique solution.
    """
    at = places_of(weight, nodes, nats, points)
    H1, H2 = at.energies
    w, H = seen_points(H1, H2, at.seen, at.exponent, at.area)
    bases = orthonormal(H1, w.sum(axis=1), degree), orthonormal(H2, w.sum(axis=0), degree)
    (P, dP), (Q, dQ) = (b.with_slopes(H) for b, H in zip(bases, at.energies, strict=True))
    matrix = _matrix(
        weighted_on_grid(w, at.seen, *at.slopes, *evaluated(process, H)), (P, dP), (Q, dQ)
    )
    masses = (P @ w @ Q.T).ravel()
    # The first test function is 1, its equation 0 = 0: the mass takes its place.
    size = float(np.abs(matrix).max())
    system, right = matrix.copy(), np.zeros(len(matrix))
    system[0], right[0] = masses * size / masses[0], size / masses[0]
    try:
        u = np.linalg.solve(system, right)
    except np.linalg.LinAlgError:
        raise NotCertified("the stationary equation has no unique solution") from None
    left, terms = np.abs(matrix @ u), np.abs(matrix) @ np.abs(u)
    k = degree + 1
    return Solved(
        Expansion(_in_quarters(at.nodes), weight, bases, np.asarray(u.reshape(k, k))),
        at,
        float(left.max() / terms.max()) if terms.max() > 0.0 else np.inf,
    )


def _matrix(c: Array, first: tuple[Array, Array], second: tuple[Array, Array]) -> Array:
    """Galerkin matrix, test functions first, by sum factorisation: along H2, then along H1."""
    a1, a2, b11, b12, b22 = c
    (P, dP), (Q, dQ) = first, second

    def products(test: Array, trial: Array) -> Array:
        return np.asarray((test[:, None] * trial).reshape(-1, test.shape[1]))

    vv, sv, vs, ss = (products(*pair).T for pair in ((Q, Q), (dQ, Q), (Q, dQ), (dQ, dQ)))
    total = products(dP, dP) @ (b11 @ vv) + products(P, P) @ (a2 @ sv + b22 @ ss)
    inner = a1 @ vv
    if np.any(b12):
        inner = inner + b12 @ vs
        total = total + products(P, dP) @ (b12 @ sv)
    total = total + products(dP, P) @ inner
    k = len(P)
    return np.asarray(total.reshape(k, k, k, k).transpose(0, 2, 1, 3).reshape(k * k, k * k))
