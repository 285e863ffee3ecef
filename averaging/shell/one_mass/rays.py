"""The rays of one contact mass: its stops, V along them, and where they turn."""

from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from fpk.compiled_laws import of_law
from fpk.compiling import FLAGS

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

NEAR = 0.01
"""Difference of overlap, relative to the overlap, below which that of the contact energy is taken
from the force, as it would cancel: beyond a second stop, and for n = 1, whose integrand is 1/√v."""
NEWTON_STEPS = 100


class Rays(NamedTuple):
    """The stops of each ray: those of ray k are ``first[k]:first[k + 1]``, by clearance."""

    first: Integers  # (rays + 1,)
    clearance: Array  # (stops,)
    stiffness: Array  # (stops,)
    exponent: Array  # (stops,)
    law: Integers  # (stops,), of the laws in order of their names
    reach: float  # displacement of the mass over the length r of a ray


inner = njit(fastmath=FLAGS, error_model="numpy", forceinline=True)


@inner
def before(rays: Rays, stop: int, k: int) -> float:
    """Overlap of stop k where ``stop``, of the same ray and not nearer, is just touched."""
    overlap: float = rays.clearance[stop] - rays.clearance[k]
    return max(overlap, 0.0)


@inner
def level_at(rays: Rays, first: int, stop: int, U: Any) -> float:
    """V where ``stop`` is just touched; ``first`` is the first stop of its ray."""
    r = rays.clearance[stop] / rays.reach
    V: float = 0.5 * r * r
    for k in range(first, stop):
        overlap = before(rays, stop, k)
        if overlap > 0.0:
            V += rays.stiffness[k] * of_law(U, rays.law[k], overlap, rays.exponent[k])
    return V


@inner
def mean_force(middle: float, width: float, law: int, e: float, g: Any) -> float:
    """Mean of the force over a width of ``NEAR`` of the overlap: three Gauss points are exact."""
    shift = 0.5 * np.sqrt(0.6) * width
    ends = of_law(g, law, middle - shift, e) + of_law(g, law, middle + shift, e)
    mean: float = (5.0 * ends + 8.0 * of_law(g, law, middle, e)) / 18.0
    return mean


@inner
def turning_point(height: float, rays: Rays, first: int, stop: int, U: Any, g: Any) -> float:
    """The x > 0 where V, from ``stop`` on, has risen by ``height``; NaN where none is found.

    Newton's method in logarithms: the rise is a sum of positive powers of x, its logarithm convex
    in log x, and the iteration comes down on the root from that of the springs alone.
    """
    L, start = rays.reach, rays.clearance[stop] / rays.reach
    x: float = 2.0 * height / (start + np.sqrt(start * start + 2.0 * height))
    for _ in range(NEWTON_STEPS):
        rise, steepness = x * (start + 0.5 * x), start + x
        for k in range(first, stop + 1):
            begun, B, e, law = (
                before(rays, stop, k),
                rays.stiffness[k],
                rays.exponent[k],
                rays.law[k],
            )
            if L * x < NEAR * begun:
                rise += B * L * x * mean_force(begun + 0.5 * L * x, L * x, law, e, g)
            else:
                rise += B * (of_law(U, law, begun + L * x, e) - of_law(U, law, begun, e))
            steepness += L * B * of_law(g, law, begun + L * x, e)
        # Where the rise is x^m, x (height/rise)^(1/m) is the root: near it by a Padé approximant.
        ratio, m = height / rise, x * steepness / rise
        if ratio > 0.5:
            factor = ((m - 1.0) + (m + 1.0) * ratio) / ((m + 1.0) + (m - 1.0) * ratio)
        elif np.isfinite(m) and ratio > 0.0:
            factor = ratio ** (1.0 / m)
        else:  # so far beyond that a high power of x overflows
            factor = 0.125
        x *= factor
        # Quadratic convergence: the next step would be of the order of the square of this.
        if abs(factor - 1.0) < 1e-8:
            return x
    return np.nan


@inner
def turning_points(
    H: float, rays: Rays, share: float, X: Array, top: Array, U: Any, g: Any
) -> float:
    """Fill X, the distance from each stop to the turning point, and how far its panel goes.

    X is 0 where no panel begins at the stop. ``top`` is X − end where the next stop ends the
    panel, 0 where the turning point does, and −end where v^a has died out before: fallen to
    ``share`` of v. Returns the least height H − V of a stop that is touched.
    """
    least = np.inf
    for k in range(rays.first.size - 1):
        a, b = rays.first[k], rays.first[k + 1]
        done = False
        for s in range(a, b):
            X[s] = top[s] = 0.0
            length = np.inf
            if s + 1 < b:
                length = (rays.clearance[s + 1] - rays.clearance[s]) / rays.reach
            height = H - level_at(rays, a, s, U)
            if done or length <= 0.0 or height <= 0.0:
                continue
            least = min(least, height)
            X[s] = turning_point(height, rays, a, s, U, g)
            if length < X[s]:
                top[s] = X[s] - length
                if top[s] < 1e-5 * X[s]:
                    # It cancels: what is left of H over the slope half-way, whose relative error
                    # is of the order of its square.
                    left = H - level_at(rays, a, s + 1, U)
                    top[s] = left / _slope(0.5 * (length + X[s]), rays, a, s, g)
            if share > 0.0:
                gone = turning_point(height * (1.0 - share), rays, a, s, U, g)
                if gone < X[s] - top[s]:
                    top[s] = -gone
                    done = True
    return least


@inner
def _slope(x: float, rays: Rays, first: int, stop: int, g: Any) -> float:
    """V' at the distance x beyond ``stop``."""
    slope: float = rays.clearance[stop] / rays.reach + x
    for k in range(first, stop + 1):
        overlap = before(rays, stop, k) + rays.reach * x
        force = rays.stiffness[k] * of_law(g, rays.law[k], overlap, rays.exponent[k])
        slope += rays.reach * force
    return slope
