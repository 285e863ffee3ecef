"""A Gaussian state, and the densities of its energy, displacements and momenta.

Its energy is a sum of independent gamma variables.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import erfc

import numpy as np
from scipy.linalg import qr, solve_triangular

from fpk.answer.certificate import Measured
from fpk.answer.density import Density, certified_density
from fpk.answer.names import Observable, observable_name
from fpk.numeric.arrays import DEPTH, EPS, SMALLEST, Array
from fpk.numeric.errors import NotApplicable

REACH = 8.5
"""Half-width of the support in standard deviations."""
WIDTH = 3.0
"""Largest width of a panel in standard deviations of one coordinate given the other."""
PANELS = (17, 120)
"""Least and largest number of panels along an axis; correlations above 0.999 would need more."""
NODES = (30, 40)
"""Nodes on half of the contour, of the coarser sum for the error and of the answer: 32 reach
round-off."""
MIN_CROSSING = 2.0
"""Least product of x and the point where the contour crosses the real axis: nearer to the
singularity the sum needs more nodes, farther from it large terms cancel."""
SADDLE_STEPS = 12
"""Fixed-point steps to the saddle; any point between it and the first guess serves."""


@dataclass(frozen=True, eq=False)
class Gaussian:
    """Gaussian state (q, p) = F ξ, ξ independent standard normal, whose energy is Σ λ_j G_j.

    ``factor`` F (2n, k): F Fᵀ is the covariance, known to ``relative_error`` as a quadratic form.
    ``scales`` λ, ``shape`` and ``scale_errors`` as in ``gamma_sum``; ``residual`` of the equation.
    """

    factor: Array
    relative_error: float
    scales: Array
    shape: float
    scale_errors: Array
    residual: float

    def refusal(self, observable: Observable) -> str | None:
        """Return why there is no density: two of (q, p) are in one proportion at all times."""
        if len(observable) < 2:
            return None
        rows, _, L = self._standardised(observable)
        if np.min(np.abs(np.diag(L))) > 8.0 * EPS * rows.shape[1]:
            return None
        name = observable_name(observable)
        return f"{name}: one is a multiple of the other at all times: there is no joint density"

    def _standardised(self, observable: Observable) -> tuple[Array, Array, Array]:
        """Rows of F, their scales, and L with x/scale = L y and independent standard y."""
        rows = self.factor[state_rows(observable, self.factor.shape[0] // 2)]
        scale = np.linalg.norm(rows, axis=1)
        L = qr((rows / scale[:, None]).T, mode="r")[0][: len(observable)].T
        return rows, scale, np.asarray(L)

    def density(self, observable: Observable, *, tol: float) -> Density:
        """Return the density of H, or of one or two of (q, p); raise as ``refusal`` says."""
        if observable[0].kind == "H":
            return self._energy_density(observable, tol)
        if reason := self.refusal(observable):
            raise NotApplicable(reason)
        count = len(observable)
        rows, scale, L = self._standardised(observable)
        # Round-off of the rows counts by the condition of L.
        relative = self.relative_error + 8.0 * EPS * rows.shape[1] * float(np.linalg.cond(L))
        height = (2.0 * np.pi) ** (-0.5 * count) / abs(float(np.prod(np.diag(L)) * np.prod(scale)))
        width = WIDTH * float(np.min(np.abs(np.diag(L))))
        panels = int(np.clip(np.ceil(2.0 * REACH / width), *PANELS))

        def half_square(x: Sequence[Array]) -> Array:
            z = np.stack(np.broadcast_arrays(*x))
            y = solve_triangular(L, z.reshape(count, -1) / scale[:, None], lower=True)
            return np.asarray(0.5 * np.sum(y * y, axis=0).reshape(z.shape[1:]))

        def pointwise(*x: Array) -> Array:
            # d ln p = ½ yᵀ E y − ½ tr E, where E = L⁻¹ dR L⁻ᵀ is at most ``relative`` in norm.
            exponent = half_square(x)
            return np.asarray(relative * (exponent + 0.5 * count) * height * np.exp(-exponent))

        tail = count * erfc(REACH * 0.5**0.5)
        return certified_density(
            observable,
            tuple(np.linspace(-REACH * s, REACH * s, panels + 1) for s in scale),
            lambda *x: height * np.exp(-half_square(x)),
            pointwise,
            measured=Measured(count * relative + tail, np.nan, np.inf, self.residual, tail),
            tol=tol,
            # The mass is measured at x = scale L y, where no correlation makes a ridge.
            frame=(scale[:, None] * L, (np.linspace(-REACH, REACH, PANELS[0] + 1),) * count),
        )

    def _energy_density(self, observable: Observable, tol: float) -> Density:
        largest, tail = float(np.max(self.scales)), float(np.exp(-DEPTH))
        # Chernoff's bound at s = 7/8 of the least rate: P(X > E) <= e^(−sE) Π (1 − s λ_j)^−shape.
        s = 0.875 / largest
        end = (DEPTH - self.shape * float(np.sum(np.log1p(-s * self.scales)))) / s
        nodes, least = [0.0], max(float(np.min(self.scales)), EPS * end)
        while nodes[-1] < end:
            nodes.append(nodes[-1] + min(max(2.0 * least, nodes[-1] / 3.0), 2.0 * largest))

        def pdf(energy: Array) -> Array:  # a third of the cost of its error
            terms, *_ = _contour(self.scales, self.shape, energy, NODES[1])
            return np.asarray(terms.real.sum(axis=-1))

        def error(energy: Array) -> Array:
            return gamma_sum(self.scales, self.shape, self.scale_errors, energy)[1]

        return certified_density(
            observable,
            (np.array([*nodes[:-1], end]),),
            pdf,
            error,
            measured=Measured(tail, np.nan, np.inf, self.residual, tail),
            tol=tol,
            added_error=lambda p, energy: error(energy),
        )


def state_rows(observable: Observable, n: int) -> list[int]:
    """Return where the coordinates of ``observable`` stand in (q, p) of n masses."""
    return [c.row + (n if c.kind == "p" else 0) for c in observable]


def gamma_sum(scales: Array, shape: float, errors: Array, x: Array) -> tuple[Array, Array]:
    """Return the density of Σ λ_j G_j at ``x`` of any shape, and an estimate of its error.

    G_j are independent gamma variables of the given ``shape`` and scale 1, λ_j >= 0 the ``scales``
    (k,), known to ``errors`` (k,). It is the inverse Laplace transform of Π (1 + λ_j s)^−shape:
    with z = 1 + λ_max s the trapezoidal rule on the parabola z = c (1 + iu)², through the saddle c
    or to its right, converges geometrically for any ratios of the scales, to a relative accuracy
    (Weideman and Trefethen, Math. Comp. 76 (2007) 1341). Partial fractions cancel for near scales.

    The error holds the distance to a coarser contour, the round-off of the terms, and the
    derivatives of the density with respect to the scales, ∂ ln p^/∂λ_j = −shape s/(1 + λ_j s).
    """
    terms, exponent, z = _contour(scales, shape, x, NODES[1])
    density: Array = terms.real.sum(axis=-1)
    error = np.abs(density - _contour(scales, shape, x, NODES[0])[0].real.sum(axis=-1))
    largest = np.max(scales)
    for r, of_scale in zip(scales / largest, errors, strict=True):
        slope = np.sum(terms * (z - 1.0) / (1.0 - r + r * z), axis=-1).real
        error += np.abs(slope) * (shape / largest * of_scale)
    error += EPS * np.sum(np.abs(terms) * (4.0 + np.abs(exponent)), axis=-1)
    return density, error


def _contour(scales: Array, shape: float, x: Array, nodes: int) -> tuple[Array, Array, Array]:
    """Terms of the sum, their exponents and z, (*shape of x, nodes).

    The terms are 0 for x < 0, and at 0 those of the limit from above.
    """
    largest = float(np.max(scales))
    t = np.maximum(x / largest, SMALLEST**0.5)[..., None]
    ratio = scales / largest
    crossing = scales.size * shape / t
    for _ in range(SADDLE_STEPS):
        pull = ratio / (1.0 - ratio + ratio * crossing)
        crossing = np.maximum(shape * crossing * pull.sum(axis=-1, keepdims=True), MIN_CROSSING) / t
    step = np.sqrt(DEPTH / (crossing * t)) / nodes
    u = 1j * step * (np.arange(nodes) + 0.5)
    z = crossing * (1.0 + u) ** 2
    exponent = t * (z - 1.0)
    for r in ratio:
        factor = 1.0 - r + r * z  # whose complex logarithm takes three times as long
        exponent -= shape * (np.log(np.abs(factor)) + 1j * np.angle(factor))
    length = np.where(x[..., None] >= 0.0, 2.0 * crossing * step / (np.pi * largest), 0.0)
    return np.exp(exponent) * (1.0 + u) * length, exponent, z
