"""The stationary FPK equation of one energy on one finite element at a time.

Zero flux makes the one-dimensional stationary problem local. The Galerkin equations
``∫ J(u) v' dH = 0`` for all continuous piecewise polynomials v of degree p say that the flux J is
orthogonal, element by element, to all polynomials of degree p − 1, which are the derivatives v'. So
static condensation is exact: every element has a one-dimensional null space of its own, and the
global solution consists of these null vectors, scaled to match at the vertices. As nothing else has
to match, Legendre polynomials serve as basis.

u = p/T is the phase-space density, and J = T (F u − ½ b u') with F the part of the drift due to
damping; the noise part of the drift, ½ (bT)'/T, has cancelled, so that no derivative of b is
needed, and u is smooth where T is not. The exact solution has J = 0 at every point, so that the
Galerkin equations may use any quadrature points. Integrals of p need special points: above an
energy where contact begins T has half-integer powers, and the element that begins there has points
of its own.
"""

from collections.abc import Callable
from functools import lru_cache

import numpy as np
from numpy.polynomial.legendre import legder, legvander

from fpk.numeric.arrays import SMALLEST, Array
from fpk.numeric.quadrature import gauss_legendre
from fpk.system.process import Process

ENRICHMENT = 2
"""Degree of the enriched solution, whose distance estimates the error, above that of the answer."""
ELEMENT_POINTS = 4
"""Gauss points of an element above its degree; twice as many if T ~ H^(n−1) is steep, n > 2. Fewer
there give answer and enriched solution a common error (n from 7 to 40: up to four times their
distance). More elsewhere hide the error by a root of H in T from their distance: for a stop that
touches at rest the error was 8 times the stated error."""
CONTACT_POINTS = 10
"""Gauss points above the degree, for an element that begins at a contact energy."""
NullVectors = Callable[[Process, Array, int, int], tuple[Array, float]]
"""Solver of (process, nodes, degree, Gauss points) for Legendre series of u and a residual."""


@lru_cache
def element_rule(degree: int, degrees_of_freedom: int = 1) -> tuple[Array, ...]:
    """Return the points of elements of ``degree`` for T ~ H^(n−1), n = ``degrees_of_freedom``."""
    points = degree + (2 if degrees_of_freedom > 2 else 1) * ELEMENT_POINTS
    count, highest = degree + CONTACT_POINTS, degree + ENRICHMENT
    x, w = gauss_legendre(points)
    rules = gauss_legendre(count), gauss_legendre(2 * count - 2)
    t, contact_w = (0.5 * np.concatenate(both) for both in zip(*rules, strict=True))
    t += 0.5
    # Interpolation at all points but the middle one.
    interpolation, used = np.zeros(points), np.arange(points) != points // 2
    every = legvander(x[used], points - 2)
    interpolation[used] = np.linalg.solve(every.T, np.eye(points - 1)[0])
    value = np.asarray(legvander(x, highest), dtype=float)
    slope = 2.0 * value[:, :-1] @ legder(np.eye(highest + 1))
    tests = value[:, :-1, None]
    tested = np.concatenate([(tests * f[:, None]).reshape(points, -1) for f in (value, slope)])
    of_contact = np.asarray(legvander(2.0 * t**3 - 1.0, highest).T, dtype=float)
    own = 0.5 * (1.0 + x), 0.5 * w, interpolation, value.T, tested
    return *own, t**3, 3.0 * t**2 * contact_w, of_contact


def residuals_of(A: Array, u: Array) -> tuple[Array, Array, Array]:
    """Relative residual of ``A`` ``u`` = 0; residual and size of terms of its first equation. ``A``
    is (elements, equations, terms) and ``u`` (elements, terms)."""
    # All terms are zero if an element is so short that the damping in it underflows.
    terms = A[:, : u.shape[1] - 1, : u.shape[1]] * u[:, None]
    residual, size = np.abs(terms.sum(axis=2)), np.abs(terms).sum(axis=2)
    return residual.max(axis=1) / np.maximum(size.max(axis=1), SMALLEST), residual[:, 0], size[:, 0]


def element_null_vectors(A: Array, degree: int) -> Array:
    """Return u (elements, ``degree`` + 1), u_0 = 1, with ``A`` u = 0 in the first ``degree`` rows;
    u_0 is the mean of u, which does not change sign. If elimination meets a zero pivot, as T spans
    hundreds of decades in one element, the u of least norm is returned."""
    B, right = A[:, :degree, 1 : degree + 1], -A[:, :degree, :1]
    try:
        rest = np.linalg.solve(B, right)
    except np.linalg.LinAlgError:
        rest = np.linalg.pinv(B) @ right
    return np.hstack([np.ones((len(A), 1)), rest[:, :, 0]])
