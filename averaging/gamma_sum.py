"""The density of a sum of independent gamma variables: of an energy that is a quadratic form."""

from collections.abc import Iterator

import numpy as np

from fpk.arrays import EPS, Array

NODES, COARSE_NODES = 40, 30
"""Nodes on half of the contour, and of the coarser sum for the error: 32 reach round-off."""
MIN_CROSSING = 2.0
"""Least product of x and the point where the contour crosses the real axis: nearer to the
singularity the sum needs more nodes, farther from it large terms cancel."""
CONTOUR_NATS = 39.0
"""ln of the fall of the integrand along the contour at which that ends: 1e-17 lies beyond."""
SADDLE_STEPS = 12
"""Fixed-point steps to the saddle; any point between it and the first guess serves."""
MIN_ENERGY = 1e-200
"""Least x, in units of the largest scale, for which the contour is taken: the limit at 0."""


def gamma_sum(scales: Array, shape: float, errors: Array, x: Array) -> tuple[Array, Array]:
    """Return the density of Σ λ_j G_j at ``x`` of any shape, and an estimate of its error.

    G_j are independent gamma variables of the given ``shape`` and scale 1, λ_j >= 0 the ``scales``
    (k,), known to ``errors`` (k,). It is the inverse Laplace transform of Π (1 + λ_j s)^−shape,
    whose singularities lie on the negative real axis: with z = 1 + λ_max s the trapezoidal rule on
    the parabola z = c (1 + iu)², through the saddle c or to its right, converges geometrically for
    any ratios of the scales (Weideman and Trefethen, Math. Comp. 76 (2007) 1341), and keeps its
    relative accuracy at small and at large x. Partial fractions cancel for nearly equal scales.

    The error holds the distance to a coarser contour, the round-off of the terms, and the
    derivatives of the density with respect to the scales, ∂ ln p^/∂λ_j = −shape s/(1 + λ_j s).
    """
    coarse, *_ = _contour(scales, shape, np.ravel(x), COARSE_NODES)
    terms, exponent, z = _contour(scales, shape, np.ravel(x), NODES)
    factors = _factors(scales / np.max(scales), z)
    slopes = np.stack([np.sum(terms * (z - 1.0) / f, axis=1).real for f in factors], axis=1)
    density = terms.real.sum(axis=1)
    error = np.abs(density - coarse.real.sum(axis=1))
    error += np.abs(slopes * (shape / np.max(scales))) @ errors
    error += EPS * np.sum(np.abs(terms) * (4.0 + np.abs(exponent)), axis=1)
    return density.reshape(np.shape(x)), error.reshape(np.shape(x))


def gamma_density(scales: Array, shape: float, x: Array) -> Array:
    """Return the density that ``gamma_sum`` returns, at a third of the cost of its error."""
    terms, *_ = _contour(scales, shape, np.ravel(x), NODES)
    density: Array = terms.real.sum(axis=1).reshape(np.shape(x))
    return density


def _contour(scales: Array, shape: float, x: Array, nodes: int) -> tuple[Array, Array, Array]:
    """Terms of the sum, their exponents and z, (points, nodes).

    The terms are 0 for x < 0, and at 0 those of the limit from above.
    """
    largest = float(np.max(scales))
    t = np.maximum(x / largest, MIN_ENERGY)
    ratio = scales / largest
    crossing = scales.size * shape / t
    for _ in range(SADDLE_STEPS):
        pull = ratio / (1.0 - ratio + ratio * crossing[:, None])
        crossing = np.maximum(shape * crossing * pull.sum(axis=1), MIN_CROSSING) / t
    step = np.sqrt(CONTOUR_NATS / (crossing * t)) / nodes
    u = 1j * step[:, None] * (np.arange(nodes) + 0.5)
    z = crossing[:, None] * (1.0 + u) ** 2
    exponent = t[:, None] * (z - 1.0)
    for factor in _factors(ratio, z):  # whose complex logarithm takes three times as long
        exponent -= shape * (np.log(np.abs(factor)) + 1j * np.angle(factor))
    length = np.where(x >= 0.0, 2.0 * crossing * step / (np.pi * largest), 0.0)
    return np.exp(exponent) * (1.0 + u) * length[:, None], exponent, z


def _factors(ratio: Array, z: Array) -> Iterator[Array]:
    """The factors 1 + λ_j s at z, one scale at a time."""
    return (1.0 - r + r * z for r in ratio)
