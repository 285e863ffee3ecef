"""The density of a sum of independent gamma variables: of an energy that is a quadratic form."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from fpk.certificate import Measured
from fpk.density import Density, certified_density
from fpk.observable import Observable

Array = NDArray[np.float64]
Provenance = Mapping[str, str | float | int]

NODES = (40, 30)
"""Nodes on half of the contour, of the answer and of the coarser sum whose distance estimates its
error: measured, that is 1e-8 with 16 nodes and round-off with 32."""
LEAST_CROSSING = 2.0
"""Least product of x and the point where the contour crosses the real axis: nearer to the
singularity the sum needs more nodes, farther from it e^2 times as large terms cancel."""
NATS = 39.0
"""Fall of the integrand along the contour at which it ends: 1e-17 of it lies beyond."""
REACH = 40.0
"""Nats below its maximum down to which the density is given: 4e-18 of the mass lies beyond."""
SADDLE_STEPS = 12
"""Fixed-point steps to the saddle; any point between it and the first guess serves."""
LEAST = 1e-200
"""Least x, in units of the largest scale, at which the contour is taken: the limit at 0."""
EPS = float(np.finfo(float).eps)


def gamma_sum(scales: Array, shape: float, x: Array) -> Array:
    """Return the density of Σ λ_j G_j at ``x`` of any shape.

    G_j are independent gamma variables of the given ``shape`` and scale 1, λ_j >= 0 the ``scales``
    (k,). It is the inverse Laplace transform of Π (1 + λ_j s)^−shape, whose singularities lie on
    the negative real axis: with z = 1 + λ_max s the trapezoidal rule on the parabola
    z = c (1 + iu)², through the saddle c or to its right, converges geometrically for any ratios of
    the scales (Weideman and Trefethen, Math. Comp. 76 (2007) 1341), and keeps its relative accuracy
    at small and at large x. Partial fractions cancel for nearly equal scales.
    """
    terms, *_ = _contour(scales, shape, np.ravel(x), NODES[0])
    return np.asarray(terms.real.sum(axis=1).reshape(np.shape(x)))


def gamma_sum_error(scales: Array, shape: float, errors: Array, x: Array) -> Array:
    """Return an estimate of the error of ``gamma_sum`` of scales known to ``errors`` (k,).

    It holds the distance to a coarser contour, the round-off of the terms, and the derivatives of
    the density with respect to the scales: ∂ ln p^/∂λ_j = −shape s/(1 + λ_j s).
    """
    largest = float(np.max(scales))
    coarse, *_ = _contour(scales, shape, np.ravel(x), NODES[1])
    terms, exponent, factors, s = _contour(scales, shape, np.ravel(x), NODES[0])
    slopes = np.einsum("xk,xkj->xj", terms * s, 1.0 / factors).real * (shape / largest)
    rounding = EPS * np.sum(np.abs(terms) * (4.0 + np.abs(exponent)), axis=1)
    distance = np.abs(terms.real.sum(axis=1) - coarse.real.sum(axis=1))
    return np.asarray((distance + rounding + np.abs(slopes) @ errors).reshape(np.shape(x)))


def _contour(scales: Array, shape: float, x: Array, nodes: int) -> tuple[Array, ...]:
    """Terms of the sum, their exponents, the factors 1 + λ_j s and λ_max s, (points, nodes, ...).

    The terms are 0 for x < 0, and at 0 those of the limit from above.
    """
    largest = float(np.max(scales))
    t = np.maximum(x / largest, LEAST)
    ratio = scales / largest
    crossing = scales.size * shape / t
    for _ in range(SADDLE_STEPS):
        pull = ratio / (1.0 - ratio + ratio * crossing[:, None])
        crossing = np.maximum(shape * crossing * pull.sum(axis=1), LEAST_CROSSING) / t
    step = np.sqrt(NATS / (crossing * t)) / nodes
    u = 1j * step[:, None] * (np.arange(nodes) + 0.5)
    z = crossing[:, None] * (1.0 + u) ** 2
    factors = 1.0 - ratio + ratio * z[..., None]
    exponent = t[:, None] * (z - 1.0) - shape * np.log(factors).sum(axis=-1)
    length = np.where(x >= 0.0, 2.0 * crossing * step / (np.pi * largest), 0.0)
    return np.exp(exponent) * (1.0 + u) * length[:, None], exponent, factors, z - 1.0


def gamma_sum_density(
    scales: Array,
    shape: float,
    errors: Array,
    observable: Observable,
    *,
    residual: float,
    tol: float,
    provenance: Provenance | None = None,
) -> Density:
    """Return ``gamma_sum`` as the density of an energy; ``residual`` is that of the scales."""
    # Chernoff's bound at s = 7/8 of the least rate: P(X > E) <= e^(−sE) Π (1 − s λ_j)^−shape.
    s = 0.875 / float(np.max(scales))
    end = float(REACH - shape * np.sum(np.log1p(-s * scales))) / s
    nodes, least = [0.0], max(float(np.min(scales)), EPS * end)
    while nodes[-1] < end:
        nodes.append(nodes[-1] + min(max(2.0 * least, nodes[-1] / 3.0), 2.0 * float(scales.max())))

    def error(energy: Array) -> Array:
        return gamma_sum_error(scales, shape, errors, np.asarray(energy, dtype=float))

    tail = float(np.exp(-REACH))
    return certified_density(
        observable,
        (np.array([*nodes[:-1], end]),),
        lambda energy: gamma_sum(scales, shape, np.asarray(energy, dtype=float)),
        error,
        measured=Measured(tail, np.nan, np.inf, residual, tail),
        tol=tol,
        added_error=error,
        provenance=provenance,
    )
