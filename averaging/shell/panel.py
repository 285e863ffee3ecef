"""One smooth piece of rays over the energy shell: its turning point and its integrals."""

from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from averaging.shell.reduced import ReducedPotential
from fpk.quadrature import gauss_legendre

Array = NDArray[np.float64]

NEWTON_STEPS = 60
"""Far more than the logarithmic Newton iteration takes (about five): it converges monotonically."""


@lru_cache
def _joined_rules(rules: tuple[int, ...]) -> tuple[Array, Array]:
    """Gauss points of all rules side by side, and their weights as a matrix (points, rules)."""
    parts = [gauss_legendre(points) for points in rules]
    weights = np.zeros((sum(rules), len(rules)))
    at = 0
    for k, (t, w) in enumerate(parts):
        weights[at : at + t.size, k] = w
        at += t.size
    return np.concatenate([t for t, _ in parts]), weights


class Panel:
    """Smooth piece of the rays beyond ``start`` (rays,), with the stops engaged there."""

    def __init__(self, potential: ReducedPotential, start: Array, reach: Array) -> None:
        """Keep the stops that any of the rays has reached by ``start``; ``reach`` (rays, stops)."""
        self.start = start[:, None]
        self.dimension = potential.count
        self.engaged = []
        for s, stop in enumerate(potential.stops):
            if np.any(reach[:, s]):
                before = np.maximum(reach[:, s] * start - stop.clearance, 0.0)[:, None]
                self.engaged.append((stop, reach[:, s, None], before))

    def rise(self, x: Array) -> tuple[Array, Array]:
        """V(start + x) − V(start) and its slope, for x of shape (rays, ·)."""
        value = x * (self.start + 0.5 * x)
        slope = self.start + x
        for stop, reach, before in self.engaged:
            now = before + reach * x
            value = value + (stop.energy(now) - stop.energy(before))
            slope = slope + reach * stop.force(now)
        return value, slope

    def curvature(self, x: Array) -> Array:
        """Second derivative of V along the rays at start + x."""
        value = np.ones_like(x)
        for stop, reach, before in self.engaged:
            value = value + reach**2 * stop.slope(before + reach * x)
        return value

    def fall(self, x: Array, X: Array, distance: Array) -> Array:
        """V(start + X) − V(start + x) given X − x as ``distance``, without cancelling springs."""
        value = distance * (self.start + 0.5 * (X + x))
        for stop, reach, before in self.engaged:
            value = value + (stop.energy(before + reach * X) - stop.energy(before + reach * x))
        return value

    def turning_point(self, height: Array) -> Array:
        """The x > 0 where the rise equals ``height`` (rays,), by Newton's method in logarithms.

        The rise is a sum of positive powers of x, so its logarithm is convex in log x and the
        iteration, started where the springs alone reach ``height``, comes down on the root
        monotonically: that start and zero bracket it.
        """
        start = self.start[:, 0]
        x = 2.0 * height / (start + np.sqrt(start * start + 2.0 * height))
        for _ in range(NEWTON_STEPS):
            value, slope = (part[:, 0] for part in self.rise(x[:, None]))
            step = np.log(value / height) * value / (x * slope)
            x = x * np.exp(-step)
            # Quadratic convergence: the next step would be of the order of the square of this.
            if np.max(np.abs(step)) < 1e-8:
                break
        return x

    def end_angle(self, left: Array, X: Array, length: Array) -> Array:
        """Angle φ of x = X sin²φ at the panel's end, where ``left`` = H − V is left, or π/2.

        Just short of the turning point X − length cancels; there it is ``left`` over the slope
        half-way, whose relative error is of the order of its square.
        """
        inner = left > 0.0
        if not inner.any():
            return np.full(X.shape, 0.5 * np.pi)
        short = np.where(inner, X - np.where(inner, length, 0.0), 0.0)
        near = inner & (short < 1e-5 * X)
        if near.any():
            slope = self.rise(0.5 * (X + np.where(inner, length, X))[:, None])[1][:, 0]
            short = np.where(near, left / slope, short)
        return np.arctan2(np.sqrt(X - short), np.sqrt(short))

    def integrals(
        self,
        energy: Array,
        level: Array,
        end_level: Array,
        length: Array,
        *,
        exponent: float,
        rules: Sequence[int],
    ) -> Array:
        """The three integrals over this panel, from ``start`` to its end or the turning point."""
        H = energy[:, None]
        x, r, v, slope_of_x, factor, weights = self.points(energy, level, end_level, length, rules)
        c = self.dimension
        measure = slope_of_x * half_integer_power(v, exponent)
        if c > 1:
            measure = measure * (r / np.sqrt(H)) ** (c - 1)
        if exponent > 0:
            w = exponent / v
        else:
            rise, slope = self.rise(x)
            V = level[:, None] + rise
            w = V * ((c - 1) / (r * slope) - self.curvature(x) / (slope * slope))
            w += exponent + 1.0
        parts = [(part @ weights) * factor for part in (measure, measure * v, measure * w)]
        return np.stack(parts, axis=-1).transpose(1, 0, 2)

    def moments(
        self,
        energy: Array,
        level: Array,
        end_level: Array,
        length: Array,
        *,
        exponent: float,
        orders: Sequence[tuple[int, int]],
        rules: Sequence[int],
    ) -> Array:
        """The integrals of ``shell_ray_moments`` over this panel."""
        _, r, v, slope_of_x, factor, weights = self.points(energy, level, end_level, length, rules)
        r = r / np.sqrt(energy)[:, None]
        base = slope_of_x * half_integer_power(v, exponent)
        radial = {k: r ** (k + self.dimension - 1) for k, _ in orders}
        kinetic = {j: base * v**j for _, j in orders}
        parts = [((radial[k] * kinetic[j]) @ weights) * factor for k, j in orders]
        return np.stack(parts, axis=-1).transpose(1, 0, 2)

    def points(
        self, energy: Array, level: Array, end_level: Array, length: Array, rules: Sequence[int]
    ) -> tuple[Array, Array, Array, Array, Array, Array]:
        """Gauss points of the panel: x, r, v (rays, points), then what makes integrals of them.

        An integral is ``(slope_of_x * f) @ weights * factor``, in units of √H, per rule.
        """
        X = self.turning_point(energy - level)
        phi_end = self.end_angle(energy - end_level, X, length)[:, None]
        t, weights = _joined_rules(tuple(rules))
        phi = 0.5 * phi_end * (1.0 + t)
        sine, cosine = np.sin(phi), np.cos(phi)
        x = X[:, None] * (sine * sine)
        H = energy[:, None]
        v = self.fall(x, X[:, None], X[:, None] * (cosine * cosine)) / H
        factor = phi_end * X[:, None] / np.sqrt(H)
        return x, self.start + x, v, sine * cosine, factor, weights


def half_integer_power(x: Array, exponent: float) -> Array:
    """Return x**exponent for an exponent that is a multiple of ½, by roots and products."""
    whole, odd = divmod(round(2 * exponent), 2)
    result: Array = np.sqrt(x) if odd else np.ones_like(x)
    if whole < 0:
        return result / x ** (-whole)
    return result * x**whole if whole else result
