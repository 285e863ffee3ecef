"""Integrals over the energy shell along rays from rest, compiled: (10), (25), (28) for any n.

Along a ray y = r e of whitened coordinates V rises strictly, so the shell is 0 <= r <= R. Between
stops lie panels. X is the distance from the beginning of one to the turning point that the engaged
stops alone would leave. Up to the first stop y = √(X − x) removes the root there. From each stop on
x = X sin²φ removes the half-integer powers of Hertz contact, too, and stays smooth when the next
stop comes before.
"""

from collections.abc import Callable
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from fpk.arrays import Array, Integers
from fpk.compiling import cached_njit, checksum, compiled_laws, inlined, law_files, of_law
from fpk.quadrature import gauss_legendre

RULES = (14, 18, 24, 48, 96, 192)
"""Gauss points per panel of a ray, in the order in which an integral is refined. The first two are
evaluated at once: 32 points fill four vectors, as fewer would."""
NEAR = 0.01
"""Difference of overlap, relative to the overlap, below which that of the contact energy is taken
from the force, as it would cancel: beyond a second stop, and next to the turning point."""
NEWTON_STEPS = 100


class Stops(NamedTuple):
    """One-sided stops of a system: the overlap at y is ``rows @ y − clearance``."""

    rows: Array  # (stops, c)
    clearance: Array  # (stops,)
    stiffness: Array  # (stops,)
    exponent: Array  # (stops,)
    law: Integers  # (stops,), of the laws in order of their names


class Ray(NamedTuple):
    """The stops that one ray reaches, nearest first, in arrays long enough for all stops."""

    at: Array  # distance r at which each is touched
    reach: Array  # overlap gained per length r
    which: Integers  # its row in ``stops``
    stops: Stops


class Rules(NamedTuple):
    """Gauss points of ``RULES`` one after another, rule k being ``first[k]:first[k + 1]``."""

    first: Integers  # (rules + 1,)
    share: Array  # of [0, 1], and
    weight: Array  # their weights
    sine2: Array  # sin²φ at φ = π/2 · share
    cosine2: Array  # cos²φ
    slope: Array  # 2 sin φ cos φ dφ


class Work(NamedTuple):
    """Numbers at the points of one panel, (points,) each."""

    x: Array  # distance from the beginning of the panel
    left: Array  # distance to the turning point
    v: Array  # 1 − V/H
    dx: Array
    states: Array  # v^a r^(c−1) dx
    change: Array  # its derivative by ln H


@lru_cache
def gauss_rules() -> Rules:
    """Return the points of all rules."""
    t, w = (np.concatenate(part) for part in zip(*map(gauss_legendre, RULES), strict=True))
    phi = 0.25 * np.pi * (1.0 + t)
    return Rules(
        first=np.cumsum([0, *RULES]),
        share=0.5 * (1.0 + t),
        weight=0.5 * w,
        sine2=np.sin(phi) ** 2,
        cosine2=np.cos(phi) ** 2,
        slope=0.25 * np.pi * np.sin(2.0 * phi) * w,
    )


@lru_cache
def ray_integrals(names: tuple[str, ...], singular: bool) -> Callable[..., int]:
    """Return the compiled integrals for the laws ``names``.

    ``singular`` says that a = n − c/2 − 1 is not positive; the laws' slopes are needed then.
    """
    sources = checksum(law_files(names))
    U: Any = compiled_laws(names, "energy")
    g: Any = compiled_laws(names, "force")
    bend: Any = compiled_laws(names, "slope" if singular else "force")

    @cached_njit()
    def add_rays(
        energy: Array, directions: Array, stops: Stops, n: int, orders: Integers, rules: Rules,
        rule: int, out: Array,
    ) -> int:  # fmt: skip
        """Add the integrals along rays to ``out``, (rules, rays, 3 + orders), from ``rule`` on.

        ``energy`` (rays,) and unit vectors ``directions`` (rays, c). With v = 1 − V/H and lengths
        in units of √H the integrals are those of v^a r^(c−1) (1, v, w), which belong to T, the
        phase volume and H T', then of v^(a+j) r^(c−1+k) for the rows (k, j) of ``orders``. For
        a > 0, w = a/v is the derivative under the integral; otherwise that diverges, and
        w = a + 1 + V ((c−1)/(r V_r) − V_rr/V_r²) comes from differentiating with V as the
        variable. Returns the checksum of the sources.
        """
        c, total = stops.rows.shape[1], stops.clearance.size
        ray = Ray(np.empty(total), np.empty(total), np.empty(total, dtype=np.int64), stops)
        first, last = rules.first[rule], rules.first[rule + out.shape[0]]
        w = np.empty((6, last - first))
        work = Work(w[0], w[1], w[2], w[3], w[4], w[5])
        for i in range(energy.size):
            H = energy[i]
            count = _along(np.sqrt(2.0 * H), directions[i], ray)
            for k in range(count + 1):  # stops engaged
                start = ray.at[k - 1] if k > 0 else 0.0
                length = ray.at[k] - start if k < count else np.inf
                height = H - _level(start, k, ray, U)
                if height <= 0.0:
                    break
                if length <= 0.0:
                    continue
                X = _turning_point(height, start, k, ray, U, g)
                _points(X, min(length, X), k, rules, first, work)
                _heights(H, start, X, k, ray, work, U, g)
                if singular:
                    _lowest_degree(H, start, k, ray, work, U, g, bend)
                else:
                    _degrees(H, start, n, c, work)
                for m in range(out.shape[0]):
                    begin, stop = rules.first[rule + m] - first, rules.first[rule + m + 1] - first
                    _add(begin, stop, start, H, orders, work, out[m, i])
        return sources

    return add_rays


@inlined
def _along(span: float, direction: Array, ray: Ray) -> int:
    """Write the stops that the ray touches within ``span`` to ``ray``; return their number."""
    count, stops = 0, ray.stops
    for s in range(stops.clearance.size):
        reach = 0.0
        for j in range(direction.size):
            reach += stops.rows[s, j] * direction[j]
        if reach <= 0.0 or stops.clearance[s] >= reach * span:
            continue
        at, k = stops.clearance[s] / reach, count
        while k > 0 and ray.at[k - 1] > at:
            ray.at[k], ray.reach[k], ray.which[k] = (
                ray.at[k - 1],
                ray.reach[k - 1],
                ray.which[k - 1],
            )
            k -= 1
        ray.at[k], ray.reach[k], ray.which[k] = at, reach, s
        count += 1
    return count


@inlined
def _of_stop(part: Any, ray: Ray, s: int, overlap: float) -> float:
    """Energy, force or slope, by ``part`` of the laws, of stop s of the ray over its stiffness."""
    i = ray.which[s]
    value: float = of_law(part, ray.stops.law[i], overlap, ray.stops.exponent[i])
    return value


@inlined
def _level(start: float, k: int, ray: Ray, U: Any) -> float:
    """V at the distance ``start`` where k stops are engaged."""
    V: float = 0.5 * start * start
    for s in range(k):
        B = ray.stops.stiffness[ray.which[s]]
        V += B * _of_stop(U, ray, s, ray.reach[s] * (start - ray.at[s]))
    return V


@inlined
def _gain(low: float, width: float, top: float, ray: Ray, s: int, U: Any, g: Any) -> float:
    """U(low + width) − U(low) of stop s without cancellation, ``top`` being the first of the two.

    A small width is that times the mean force, for which three Gauss points are exact.
    """
    if width > NEAR * low:
        difference: float = top - _of_stop(U, ray, s, low)
        return difference
    middle, shift = low + 0.5 * width, 0.5 * np.sqrt(0.6) * width
    ends = _of_stop(g, ray, s, middle - shift) + _of_stop(g, ray, s, middle + shift)
    mean: float = (5.0 * ends + 8.0 * _of_stop(g, ray, s, middle)) / 18.0
    return width * mean


@inlined
def _turning_point(height: float, start: float, k: int, ray: Ray, U: Any, g: Any) -> float:
    """The x > 0 where V has risen by ``height`` from ``start`` on; NaN where the iteration fails.

    Newton's method in logarithms: the rise is a sum of positive powers of x, its logarithm convex
    in log x, and the iteration comes down on the root from that of the springs alone.
    """
    x: float = 2.0 * height / (start + np.sqrt(start * start + 2.0 * height))
    if k == 0:
        return x
    for _ in range(NEWTON_STEPS):
        rise, steepness = x * (start + 0.5 * x), start + x
        for s in range(k):
            B = ray.stops.stiffness[ray.which[s]]
            begun, gained = ray.reach[s] * (start - ray.at[s]), ray.reach[s] * x
            rise += B * _gain(begun, gained, _of_stop(U, ray, s, begun + gained), ray, s, U, g)
            steepness += ray.reach[s] * B * _of_stop(g, ray, s, begun + gained)
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


@inlined
def _points(X: float, span: float, k: int, rules: Rules, i: int, work: Work) -> None:
    """Write x, what is left to X, and dx at the points from i on, of a panel of length ``span``."""
    x, left, dx = work.x, work.left, work.dx
    if k == 0:
        top = np.sqrt(X)
        width = span / (top + np.sqrt(X - span))
        for j in range(x.size):
            fall = width * rules.share[i + j]  # of √(X − x) from its value at x = 0
            x[j] = fall * (2.0 * top - fall)
            left[j] = (top - fall) * (top - fall)
            dx[j] = 2.0 * (top - fall) * width * rules.weight[i + j]
    elif span == X:
        for j in range(x.size):
            x[j] = X * rules.sine2[i + j]
            left[j] = X * rules.cosine2[i + j]
            dx[j] = X * rules.slope[i + j]
    else:
        end = np.arctan2(np.sqrt(span), np.sqrt(X - span))
        for j in range(x.size):
            sine, cosine = np.sin(end * rules.share[i + j]), np.cos(end * rules.share[i + j])
            x[j] = X * sine * sine
            left[j] = X * cosine * cosine
            dx[j] = 2.0 * X * end * sine * cosine * rules.weight[i + j]


@inlined
def _heights(
    H: float, start: float, X: float, k: int, ray: Ray, work: Work, U: Any, g: Any
) -> None:
    """Write v = 1 − V/H from the fall of springs and stops between X and x."""
    x, left, v = work.x, work.left, work.v
    for j in range(x.size):
        v[j] = left[j] * (start + 0.5 * (X + x[j]))
    for s in range(k):
        reach, begun = ray.reach[s], ray.reach[s] * (start - ray.at[s])
        last, B = _of_stop(U, ray, s, begun + reach * X), ray.stops.stiffness[ray.which[s]]
        for j in range(x.size):
            v[j] += B * _gain(begun + reach * x[j], reach * left[j], last, ray, s, U, g)
    for j in range(x.size):
        v[j] *= 1.0 / H


@inlined
def _degrees(H: float, start: float, n: int, c: int, work: Work) -> None:
    """Write v^a r^(c−1) dx and a v^(a−1) r^(c−1) dx for a >= ½, a multiple of ½."""
    v, states, change = work.v, work.states, work.change
    a, twice = n - 0.5 * c - 1.0, 2 * n - c - 4
    for j in range(v.size):
        change[j] = a * work.dx[j]
    if twice % 2:
        for j in range(v.size):
            change[j] /= np.sqrt(v[j])
    for _ in range((twice + 1) // 2):
        for j in range(v.size):
            change[j] *= v[j]
    for _ in range(c - 1):
        for j in range(v.size):
            change[j] *= (start + work.x[j]) / np.sqrt(H)
    for j in range(v.size):
        states[j] = change[j] * v[j] / a


@inlined
def _lowest_degree(
    H: float, start: float, k: int, ray: Ray, work: Work, U: Any, g: Any, bend: Any
) -> None:
    """Write v^a r^(c−1) dx and w times that for a = −½ (c = 1) and a = 0 (c = 2)."""
    c = ray.stops.rows.shape[1]
    a = 0.5 * c - 1.0
    for j in range(work.x.size):
        r = start + work.x[j]
        # Not H (1 − v), which cancels near rest.
        V, steepness, curvature = 0.5 * r * r, r, 1.0
        for s in range(k):
            reach, overlap = ray.reach[s], ray.reach[s] * (r - ray.at[s])
            B = ray.stops.stiffness[ray.which[s]]
            V += B * _of_stop(U, ray, s, overlap)
            steepness += reach * B * _of_stop(g, ray, s, overlap)
            curvature += reach * reach * B * _of_stop(bend, ray, s, overlap)
        work.states[j] = work.dx[j]
        if a < 0.0:
            work.states[j] /= np.sqrt(work.v[j])
        if c == 2:
            work.states[j] *= r / np.sqrt(H)
        bent = (c - 1) / (r * steepness) - curvature / (steepness * steepness)
        work.change[j] = work.states[j] * (a + 1.0 + V * bent)


@inlined
def _add(
    first: int, last: int, start: float, H: float, orders: Integers, work: Work, out: Array
) -> None:
    """Add the sums over the points ``first`` to ``last`` of the integrands."""
    states, volume, change = 0.0, 0.0, 0.0
    for j in range(first, last):
        states += work.states[j]
        volume += work.states[j] * work.v[j]
        change += work.change[j]
    scale = 1.0 / np.sqrt(H)
    out[0] += scale * states
    out[1] += scale * volume
    out[2] += scale * change
    for o in range(orders.shape[0]):
        value = 0.0
        for j in range(first, last):
            r = (start + work.x[j]) * scale
            value += work.states[j] * r ** orders[o, 0] * work.v[j] ** orders[o, 1]
        out[3 + o] += scale * value
