"""Integrals of ∫v^a (1, v, a/v) dr beyond the stops, by Gauss rules."""

from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from averaging.shell.one_mass.rays import NEAR, Rays, before, inner, mean_force
from fpk.compiled_laws import of_law
from fpk.quadrature import gauss_legendre

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

RULES = (14, 18, 24, 48, 96, 192)
"""Gauss points a panel; an energy moves on to the next rule while two disagree. The first two are
evaluated at once: 32 points fill four vectors, as fewer would."""


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

    x: Array  # distance from the stop
    left: Array  # distance to the turning point
    v: Array  # 1 − V/H
    dx: Array
    states: Array  # v^a dx
    change: Array  # its derivative by ln H
    square: Array


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


@inner
def add_panels(
    H: float, rays: Rays, X: Array, top: Array, n: int, rules: Rules, rule: int, stop: int,
    split: int, work: Work, coarse: Array, fine: Array, U: Any, g: Any, bend: Any, single: bool,
) -> None:  # fmt: skip
    """Add the integrals beyond the first stops by rules ``rule`` to ``stop``.

    The first ``split`` of their points go to ``coarse``, the rest to ``fine``. ``X`` and ``top`` as
    in ``turning_points``; a NaN among them makes the sums NaN.
    """
    i, size = rules.first[rule], rules.first[stop] - rules.first[rule]
    for k in range(rays.first.size - 1):
        a = rays.first[k]
        for s in range(a, rays.first[k + 1]):
            if X[s] != 0.0:
                _points(rays.clearance[s] / rays.reach, X[s], top[s], rules, i, size, work)
                _heights(H, X[s], rays, a, s, size, work, U, g, single)
                if single:
                    _one_degree(rays, a, s, size, work, U, g, bend)
                else:
                    _many_degrees(n, size, work)
                _add(0, split, 1.0 / np.sqrt(H), n, work, coarse)
                _add(split, size, 1.0 / np.sqrt(H), n, work, fine)


@inner
def _add(first: int, last: int, scale: float, n: int, work: Work, out: Array) -> None:
    """Add the sums over the points ``first`` to ``last`` of the three integrands."""
    change, states, volume = 0.0, 0.0, 0.0
    for j in range(first, last):
        change += work.change[j]
        states += work.states[j]
        volume += work.states[j] * work.v[j]
    out[0] += scale * states
    out[1] += scale * volume
    out[2] += scale * change


@inner
def _points(
    start: float, X: float, top: float, rules: Rules, i: int, size: int, work: Work
) -> None:
    """Write x, (X − x)(start + ½ (X + x)) and dx of the points from ``i``."""
    x, left, v, dx = work.x, work.left, work.v, work.dx
    if top == 0.0:
        for j in range(size):
            x[j] = X * rules.sine2[i + j]
            left[j] = X * rules.cosine2[i + j]
            v[j] = left[j] * (start + 0.5 * (X + x[j]))
            dx[j] = X * rules.slope[i + j]
        return
    if top < 0.0:
        for j in range(size):
            x[j] = -top * rules.share[i + j] * rules.share[i + j]
            left[j] = X - x[j]
            dx[j] = -2.0 * top * rules.share[i + j] * rules.weight[i + j]
    else:
        end = np.arctan2(np.sqrt(X - top), np.sqrt(top))
        for j in range(size):
            sine, cosine = np.sin(end * rules.share[i + j]), np.cos(end * rules.share[i + j])
            x[j] = X * sine * sine
            left[j] = X * cosine * cosine
            dx[j] = 2.0 * X * end * sine * cosine * rules.weight[i + j]
    for j in range(size):
        v[j] = left[j] * (start + 0.5 * (X + x[j]))


@inner
def _heights(
    H: float, X: float, rays: Rays, first: int, stop: int, size: int, work: Work, U: Any, g: Any,
    single: bool,
) -> None:  # fmt: skip
    """Add to v the fall of the stops from X to x and divide it by H: it is 1 − V/H then."""
    L, x, v = rays.reach, work.x, work.v
    for k in range(first, stop + 1):
        begun, B = before(rays, stop, k), rays.stiffness[k]
        e, law = rays.exponent[k], rays.law[k]
        last = of_law(U, law, begun + L * X, e)
        if single or begun > 0.0:
            for j in range(size):
                now = begun + L * x[j]
                left = L * work.left[j]
                if left > NEAR * now:
                    v[j] += B * (last - of_law(U, law, now, e))
                else:
                    v[j] += B * left * mean_force(now + 0.5 * left, left, law, e, g)
        else:
            for j in range(size):
                v[j] += B * (last - of_law(U, law, begun + L * x[j], e))
    for j in range(size):
        v[j] *= 1.0 / H


@inner
def _many_degrees(n: int, size: int, work: Work) -> None:
    """Write v^a dx and a v^(a−1) dx for n > 1."""
    v, states, change, square = work.v, work.states, work.change, work.square
    for j in range(size):
        change[j] = (n - 1.5) * work.dx[j] / np.sqrt(v[j])
        square[j] = v[j]
    left = n - 2
    while left > 0:
        for j in range(size):
            if left & 1:
                change[j] *= square[j]
            square[j] *= square[j]
        left >>= 1
    for j in range(size):
        states[j] = change[j] * v[j] / (n - 1.5)


@inner
def _one_degree(
    rays: Rays, first: int, stop: int, size: int, work: Work, U: Any, g: Any, bend: Any
) -> None:
    """Write v^(−½) dx and (½ − V V''/V'²) v^(−½) dx for n = 1, from V as the variable."""
    L, start = rays.reach, rays.clearance[stop] / rays.reach
    for j in range(size):
        r = start + work.x[j]
        # Not H (1 − v), which cancels near rest.
        V, steepness, curvature = 0.5 * r * r, r, 1.0
        for k in range(first, stop + 1):
            overlap = before(rays, stop, k) + L * work.x[j]
            B, e, law = rays.stiffness[k], rays.exponent[k], rays.law[k]
            V += B * of_law(U, law, overlap, e)
            steepness += L * B * of_law(g, law, overlap, e)
            curvature += L * L * B * of_law(bend, law, overlap, e)
        work.states[j] = work.dx[j] / np.sqrt(work.v[j])
        work.change[j] = work.states[j] * (0.5 - V * curvature / (steepness * steepness))
