"""Piecewise polynomials on an interval and on a rectangle.

The idea is chebfun's: a function known to round-off is an object that can be evaluated and
integrated (T. A. Driscoll, N. Hale and L. N. Trefethen, Chebfun Guide, 2014). The series are of
Legendre polynomials, as the same Gauss points serve for interpolation and integration.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import ArrayLike

from fpk.numeric.arrays import Array, Flags, Integers
from fpk.numeric.quadrature import gauss_legendre

PANEL_DEGREE = 15
"""Default degree of interpolants: with 16 Gauss points a panel resolves e^(−x) to 1e-15 over three
e-folds, to 1e-12 over five."""


def panels_at(nodes: Array, x: Array) -> tuple[Integers, Array, Flags]:
    """Return 0-based panels, local coordinates from −1 to 1, and which points lie in the nodes.

    ``x`` are the points, (points,), the ``nodes`` ascend, and their ends count as inside. A node
    belongs to the panel on its right; a point outside gets panel and coordinate of the nearest end.
    """
    k = np.searchsorted(nodes[1:-1], x, side="right")
    left, right = nodes[k], nodes[k + 1]
    t = np.clip((2.0 * x - left - right) / (right - left), -1.0, 1.0)
    return k, t, (x >= nodes[0]) & (x <= nodes[-1])


@cache
def clenshaw_kernel() -> Callable[..., Array]:
    """Return the compiled function of c, k, t that sums Legendre series by Clenshaw's recurrence.

    c (panels, degree + 1, values) are coefficients, k (points,) the panels and t (points,) the
    local coordinates; the result is Σ_j c_kj P_j(t), (points, values). Ten times as fast as NumPy;
    numba is imported at the first call, as that takes 0.4 s.
    """
    from fpk.numeric.compiling import cached_njit  # noqa: PLC0415

    @cached_njit()
    def summed(c: Array, k: Integers, t: Array) -> Array:
        value, j = np.empty((t.size, c.shape[2])), np.arange(c.shape[1] + 0.0)
        rise, fall = (2.0 * j + 1.0) / (j + 1.0), (j + 1.0) / (j + 2.0)
        for i in range(t.size):
            for m in range(c.shape[2]):
                total = after = 0.0
                for n in range(j.size - 1, -1, -1):
                    total, after = c[k[i], n, m] + rise[n] * t[i] * total - fall[n] * after, total
                value[i, m] = total
        return value

    return summed


@dataclass(frozen=True, eq=False)
class Piecewise:
    """``f(x) = exp(log_scale_k) Σ_j coefficients_kj P_j(t)``, t from −1 to 1 over panel k.

    ``nodes`` (panels + 1,) ascend; ``coefficients`` (panels, degree + 1, ...) have the shape of a
    value behind the first two axes; ``log_scale`` (panels,) lets a density span more than the range
    of double precision. Outside the nodes f is ``outside``. ``error`` (panels,) is the estimated
    largest error of the series on each panel, without the scale; only ``fit`` sets it.
    """

    nodes: Array
    coefficients: Array
    log_scale: Array | None = None
    outside: float = 0.0
    error: Array | None = None

    def __call__(self, x: ArrayLike, *, log_factor: ArrayLike = 0.0) -> Array:
        """Return f(x) exp(``log_factor``), of the shape of ``x`` followed by the shape of a value.
        ``log_factor`` is 0 or has the shape of ``x``; ``outside`` is without it. NaN at NaN."""
        at, shape = np.asarray(x, dtype=float), self.coefficients.shape
        k, t, inside = panels_at(self.nodes, at.ravel())
        series = np.ascontiguousarray(self.coefficients).reshape(*shape[:2], -1)
        value: Array = clenshaw_kernel()(series, k, t)
        # One exponential, as scale and factor may overflow although their product does not.
        exponent = 0.0 if self.log_scale is None else self.log_scale[k]
        if np.any(exponent := exponent + np.asarray(log_factor, dtype=float).ravel()):
            value *= np.exp(exponent)[:, None]
        beyond = at.ravel()[~inside, None]
        value[~inside] = np.where(np.isnan(beyond), np.nan, self.outside)
        return value.reshape((*at.shape, *shape[2:]))

    def antiderivative(self) -> "Piecewise":
        """Return ∫f from the first node to x as a function of x. On both sides outside the nodes it
        is the ``outside`` of f. Raises ``AssertionError`` if f has a ``log_scale``."""
        assert self.log_scale is None, "panels with scales have no common antiderivative"
        within = np.asarray(legendre.legint(self.coefficients, axis=1, lbnd=-1), float)
        within *= 0.5 * np.diff(self.nodes).reshape(-1, *(1,) * (within.ndim - 1))
        within[1:, 0] += np.cumsum(within.sum(axis=1), axis=0)[:-1]
        return replace(self, coefficients=within, error=None)


def fit(
    f: Callable[[Array], Array],
    nodes: Array,
    tol: float,
    *,
    degree: int = PANEL_DEGREE,
    cut: Callable[[Array, Array], Array] | None = None,
    estimate: Callable[[Array, Array], Array] | None = None,
    rounds: int = 60,
) -> Piecewise:
    """Return the interpolant of ``f`` by polynomials of ``degree`` on panels between ``nodes``.

    ``f`` maps points (points,) to values (points, ...) and is called once for the given panels and
    once in each round for all new panels. A panel whose absolute error exceeds ``tol`` is split at
    ``cut(left, right)``, by default at its middle, in at most ``rounds`` rounds (2^−60 of a length
    is below round-off); ``Piecewise.error`` states the error reached, which may exceed ``tol``. The
    error (panels,) is ``estimate(lengths, coefficients)``, by default ``degree`` times the sum of
    the sizes of the last two coefficients, of the largest component of a value.
    """
    middle = cut or (lambda left, right: 0.5 * (left + right))

    def last_two(lengths: Array, coefficients: Array) -> Array:
        # Σ|c_j| beyond the degree n for c_j ~ j^(−3/2) (a kink) and faster: Σ j^(−r) from n on is
        # n c_n/(r − 1); two coefficients, as one may vanish by symmetry.
        tail = (coefficients.shape[1] - 1) * np.abs(coefficients[:, -2:]).sum(axis=1)
        return np.asarray(tail.reshape(lengths.size, -1).max(axis=1))

    judge = estimate or last_two
    left, right = nodes[:-1], nodes[1:]
    coefficients = legendre_coefficients(f, left, right, degree)
    error = judge(right - left, coefficients)
    for _ in range(rounds):
        at = middle(left, right)
        split = (error > tol) & (at > left) & (at < right)
        if not split.any():
            break
        new = np.concatenate([left[split], at[split]]), np.concatenate([at[split], right[split]])
        added = legendre_coefficients(f, *new, degree)
        left, right = (np.append(a[~split], b) for a, b in zip((left, right), new, strict=True))
        coefficients = np.concatenate([coefficients[~split], added])
        error = np.append(error[~split], judge(new[1] - new[0], added))
    order = np.argsort(left)
    return Piecewise(np.append(left[order], nodes[-1]), coefficients[order], error=error[order])


def legendre_coefficients(
    f: Callable[[Array], Array], left: Array, right: Array, degree: int
) -> Array:
    """Return Legendre coefficients (panels, degree + 1, ...) of the interpolants of ``f`` at the
    Gauss points of the panels from ``left`` to ``right``, (panels,); exact up to ``degree``."""
    t, _ = gauss_legendre(degree + 1)
    x = 0.5 * (left + right)[:, None] + 0.5 * (right - left)[:, None] * t
    values = np.asarray(f(x.ravel()))
    values = values.reshape(*x.shape, *values.shape[1:])
    return np.asarray(np.moveaxis(np.tensordot(projection(degree), values, (1, 1)), 1, 0))


def projection(degree: int) -> Array:
    """Return the square matrix that maps values at the ``degree`` + 1 Gauss points on [−1, 1] to
    the Legendre coefficients of their interpolant."""
    t, w = gauss_legendre(degree + 1)
    weighted = legendre.legvander(t, degree).T * w
    return np.asarray((np.arange(degree + 1.0) + 0.5)[:, None] * weighted)


@dataclass(frozen=True, eq=False)
class PiecewiseTensor:
    """``f(x, y) = Σ_ij coefficients_klij P_i(s) P_j(t)`` on the rectangle of panels k and l.

    s and t go from −1 to 1 over them. ``nodes`` ascend along each axis, x first; ``coefficients``
    are (panels, panels, degree + 1, degree + 1). Outside the nodes f is 0.
    """

    nodes: tuple[Array, Array]
    coefficients: Array

    def __call__(self, x: ArrayLike, y: ArrayLike) -> Array:
        """Return f at ``x``, ``y``, in the shape to which they broadcast; NaN at NaN.

        The axes (m, 1) and (n,) of a grid take less work.
        """
        a, b = np.asarray(x, float), np.asarray(y, float)
        if a.ndim == 2 and a.shape[1] == 1 and b.ndim <= 2 and b.shape[-1:] == (b.size,):
            return self.on_grid(a.ravel(), b.ravel())
        a, b = np.broadcast_arrays(a, b)
        (k, P), (m, Q) = (self._at(axis, z.ravel()) for axis, z in enumerate((a, b)))
        # With the points sorted by panel, each panel takes one small matrix product.
        panel = k * (self.nodes[1].size - 1) + m
        order = np.argsort(panel, kind="stable")
        used, first = np.unique(panel[order], return_index=True)
        blocks = self.coefficients.reshape(-1, *self.coefficients.shape[2:])
        value = np.empty(panel.size)
        for block, at in zip(used, np.split(order, first[1:]), strict=True):
            value[at] = np.sum((P[at] @ blocks[block]) * Q[at], axis=1)
        return value.reshape(a.shape)

    def on_grid(self, x: Array, y: Array) -> Array:
        """Return f (x.size, y.size) on the grid of ``x`` and ``y``, one axis each."""
        rows = []
        for axis, z in enumerate((x, y)):
            k, P = self._at(axis, z)
            full = np.zeros((z.size, self.nodes[axis].size - 1, P.shape[1]))
            full[np.arange(z.size), k] = P
            rows.append(full.reshape(z.size, -1))
        matrix = self.coefficients.transpose(0, 2, 1, 3).reshape(rows[0].shape[1], -1)
        return np.asarray(rows[0] @ matrix @ rows[1].T)

    def _at(self, axis: int, x: Array) -> tuple[Integers, Array]:
        """Panels of the points ``x`` along ``axis``, and P_j there (points, degree + 1); P_j is 0
        at a point outside the nodes."""
        k, t, inside = panels_at(self.nodes[axis], x)
        P = np.asarray(legendre.legvander(t, self.coefficients.shape[2 + axis] - 1), float)
        return k, P * inside[:, None]
