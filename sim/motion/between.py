"""Between two steps: cubics of displacements through (q, v) at both ends, bridges of energies."""

import numpy as np

from fpk.arrays import Array
from fpk.compiling import inlined
from sim.arrays import LANES as W
from sim.lanes import add_product, fill, row

BULGE = 4.0 / 27.0
"""A cubic passes the larger of its ends by ``BULGE · h (|v0| + |v1|)`` at most."""

BISECTIONS = 30
"""Halvings of the interval in which a cubic meets a level: 1e-9 of it."""

Cubic = tuple[float, float, float, float]


@inlined
def cubic_of(q0: float, v0: float, q1: float, v1: float, h: float) -> Cubic:
    """Return the coefficients of q(s), s = t/h in [0, 1], ascending."""
    change = q1 - q0
    return q0, h * v0, 3.0 * change - h * (2.0 * v0 + v1), h * (v0 + v1) - 2.0 * change


@inlined
def value_of(c: Cubic, s: float) -> float:
    """Return q(s)."""
    value: float = c[0] + s * (c[1] + s * (c[2] + s * c[3]))
    return value


@inlined
def turning_points(c: Cubic) -> tuple[float, float]:
    """Return where q'(s) = 0 within (0, 1), ascending; 1 for one that is not there."""
    a, b, d = 3.0 * c[3], c[2], c[1]  # a s² + 2 b s + d
    square = b * b - a * d
    if square <= 0.0:
        return 1.0, 1.0
    # Neither root by a difference of nearly equal numbers.
    far = -(b + np.copysign(np.sqrt(square), b))
    s1 = d / far if far != 0.0 else 1.0
    s2 = far / a if a != 0.0 else 1.0
    s1 = s1 if 0.0 < s1 < 1.0 else 1.0
    s2 = s2 if 0.0 < s2 < 1.0 else 1.0
    return min(s1, s2), max(s1, s2)


@inlined
def largest_of(c: Cubic) -> float:
    """Return the largest |q(s)|, s in [0, 1]."""
    s = turning_points(c)
    largest = max(abs(c[0]), abs(value_of(c, 1.0)))
    return max(largest, abs(value_of(c, s[0])), abs(value_of(c, s[1])))


@inlined
def form_of(value: Array, s: Array, first: int, form: Array, width: int = W) -> None:
    """Write pᵀ ``form`` p of each lane, p being the rows of ``s`` from ``first`` on."""
    fill(value, 0.0, width)
    for i in range(form.shape[0]):
        for j in range(form.shape[1]):
            x, y = row(s, first + i, 1, width), row(s, first + j, 1, width)
            add_product(value, x, y, form[i, j], width)


@inlined
def distance_to(limit: float, H: float, variance: float, growth: float, at_rest: float) -> float:
    """Return d = 2 (√(e + L − H) − √e)/√β, e = σ²/β, how far an energy is from its ``limit`` L.

    It has the ``variance`` σ² per time, of which the noise makes β more as it adds 1 to H, β σ²
    being the ``growth`` and β ``at_rest`` where that is 0: in y = ∫dH/σ, σ² being linear in H, the
    diffusion is 1. Not positive at or beyond the limit.
    """
    beta = growth / variance if growth > 0.0 else at_rest
    e = variance / beta
    return float(2.0 * (np.sqrt(max(e + limit - H, 0.0)) - np.sqrt(e)) / np.sqrt(beta))


@inlined
def first_passage(c: Cubic, limit: float) -> float:
    """Return the first s in (0, 1] with |q(s)| >= ``limit``, |q(0)| being below; else 2."""
    turning = turning_points(c)
    low = 0.0
    for end in (turning[0], turning[1], 1.0):
        if abs(value_of(c, end)) >= limit:
            high = end
            for _ in range(BISECTIONS):
                middle = 0.5 * (low + high)
                if abs(value_of(c, middle)) >= limit:
                    high = middle
                else:
                    low = middle
            return high
        low = end
    return 2.0
