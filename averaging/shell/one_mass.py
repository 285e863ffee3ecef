"""Energy shells of a system with one contact mass, compiled: the integrals of (25), (28), any n.

One contact mass leaves integrals over a line, ∫ v^a (1, v, a/v) dr with v = 1 − V_red/H and
a = n − 3/2, along the two rays from rest. Up to the first stop they are powers of cosines in
closed form. Beyond, x = X sin²φ with X the distance to the turning point removes the root there and
the half-integer powers of Hertz contact, as in ``averaging.shell.panel``, of which this is the
compiled twin for one mass. For many masses v^a has died out long before the turning point, and
x = x₀ s² goes as far as that: the same few points serve any number of masses.
"""

from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from averaging.shell.reduced import ReducedPotential
from averaging.shell.sums import ROOT_ROUND_OFF, ROUND_OFF, TARGET
from fpk.compiled_laws import compiled_laws, of_law
from fpk.compiling import FLAGS, LAWS, checksum
from fpk.quadrature import gauss_legendre

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

RULES = (14, 18, 24, 48, 96, 192)
"""Gauss points a panel; an energy moves on to the next rule while two disagree. The first two are
evaluated at once: 32 points fill four vectors, as fewer would."""
MANY = 5
"""Masses from which the first rule would be refused, as v^a is narrow."""
NEAR = 0.01
"""Difference of overlap, relative to the overlap, below which that of the contact energy is taken
from the force, as it would cancel: beyond a second stop, and for n = 1, whose integrand is 1/√v."""
DIED_OUT = 1e-18
"""Share of its value at the stop below which v^a is left out."""
LEAST_LEFT = 0.005
"""Share of v that is left by then for the cut to be worth a second root: from n = 10 on."""
NEWTON_STEPS = 60


class Rays(NamedTuple):
    """The stops of each ray: those of ray k are ``first[k]:first[k + 1]``, by clearance."""

    first: Integers  # (rays + 1,)
    clearance: Array  # (stops,)
    stiffness: Array  # (stops,)
    exponent: Array  # (stops,)
    law: Integers  # (stops,), of the laws in order of their names
    reach: float  # displacement of the mass over the length r of a ray


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


class OneMassShell:
    """The ratios of ``shell_ratios`` for one contact mass, compiled for the laws that act."""

    def __init__(self, potential: ReducedPotential) -> None:
        """Sort the stops along the rays, of which there is one where V is even."""
        stops = potential.stops
        names = tuple(sorted({stop.law for stop in stops}))
        sides = ("right",) if potential.mirror else ("right", "left")
        along = [sorted((s for s in stops if s.side == side), key=_clearance) for side in sides]
        inner = [stop for side in along for stop in side]
        self.rays = Rays(
            np.cumsum([0, *map(len, along)]),
            np.array([s.clearance for s in inner], dtype=float),
            np.array([s.stiffness for s in inner], dtype=float),
            np.array([s.power for s in inner], dtype=float),
            np.array([names.index(s.law) for s in inner], dtype=np.int64),
            float(potential.L[0, 0]),
        )
        self.n = potential.n
        self.ratios = compiled_ratios(names, potential.n == 1)

    def __call__(self, energy: Array) -> Array:
        """Rows states, volume, log_slope and their relative error, (4, energies)."""
        found = np.empty((4, energy.size))
        self.ratios(energy, self.rays, self.n, gauss_rules(), found)
        return found


def _clearance(stop: Any) -> float:
    return float(stop.clearance)


@lru_cache
def compiled_ratios(names: tuple[str, ...], single: bool) -> Any:
    """Return the ratios for the laws ``names``; n = 1 (``single``) needs their slopes, too."""
    stamp = checksum([*LAWS])
    U: Any = compiled_laws(names, "energy")
    g: Any = compiled_laws(names, "force")
    bend: Any = compiled_laws(names, "slope" if single else "force")

    @njit(fastmath=FLAGS, error_model="numpy", cache=True, nogil=True)
    def ratios(energy: Array, rays: Rays, n: int, rules: Rules, found: Array) -> None:
        """Fill the rows of ``found``, (4, energies)."""
        whole = np.array([_cosines(2 * n - 2), _cosines(2 * n), 0.0])
        share = DIED_OUT ** (1.0 / (n - 1.5)) if n > 2 and stamp >= 0 else 0.0
        share = share if share > LEAST_LEFT else 0.0
        size = RULES[-1]
        e = np.empty((7, size))
        work = Work(e[0], e[1], e[2], e[3], e[4], e[5], e[6])
        free, sums, finer = np.empty(3), np.empty(3), np.empty(3)
        X, top = np.empty(rays.clearance.size), np.empty(rays.clearance.size)
        count = rays.first.size - 1
        floor = ROOT_ROUND_OFF if single else ROUND_OFF
        least = np.inf
        for k in range(count):
            if rays.first[k + 1] > rays.first[k]:
                least = min(least, rays.clearance[rays.first[k]] / rays.reach)
        for i in range(energy.size):
            H = energy[i]
            if 0.5 * least * least >= H:
                found[0, i] = found[1, i] = 1.0
                found[2, i], found[3, i] = n - 1.0, 0.0
                continue
            _turning_points(H, rays, share, X, top, U, g)
            free[0] = free[1] = free[2] = 0.0
            for k in range(count):
                first = np.inf
                if rays.first[k + 1] > rays.first[k]:
                    first = rays.clearance[rays.first[k]] / rays.reach
                _free_part(H, first, n, free)
            for part in range(3):
                sums[part] = finer[part] = free[part]
            # Two rules at once, then one after another; of many masses the first is too coarse.
            begin = 0 if n < MANY else 1
            rule, stop, error = begin, begin + 2, np.inf
            split = rules.first[begin + 1] - rules.first[begin]
            while error > TARGET and stop < rules.first.size:
                _panels(
                    H, rays, X, top, n, rules, rule, stop, split, work, sums, finer, U, g, bend,
                    single,
                )  # fmt: skip
                error = _disagreement(sums, finer) + floor
                rule, stop, split = stop, stop + 1, 0
                if error > TARGET and stop < rules.first.size:
                    for part in range(3):
                        sums[part], finer[part] = finer[part], free[part]
            found[0, i] = finer[0] / (count * whole[0])
            found[1, i] = finer[1] / (count * whole[1])
            found[2, i] = finer[2] / finer[0]
            found[3, i] = error

    return ratios


_inner = njit(fastmath=FLAGS, error_model="numpy", forceinline=True)


@_inner
def _disagreement(coarse: Array, fine: Array) -> float:
    """The largest relative difference of three sums."""
    worst = 0.0
    for part in range(3):
        gap = abs(coarse[part] - fine[part])
        if gap > 0.0:
            worst = max(worst, gap / abs(fine[part]))
    return worst


@_inner
def _cosines(m: int) -> float:
    """√2 ∫cos^m θ dθ from 0 to π/2, m even."""
    integral: float = np.sqrt(2.0) * 0.5 * np.pi
    for k in range(2, m + 1, 2):
        integral *= (k - 1) / k
    return integral


@_inner
def _free_part(H: float, end: float, n: int, out: Array) -> None:
    """Add the three integrals up to the first stop, where V = ½ r²; r = √(2H) sin θ."""
    sine = min(end / np.sqrt(2.0 * H), 1.0)
    cosine = np.sqrt((1.0 - sine) * (1.0 + sine))
    # ∫cos^m from that of m − 2, (cos^(m−1) sin + (m − 1) ∫cos^(m−2))/m: sums of positive terms.
    power, below, integral = cosine * sine, 0.0, np.arctan2(sine, cosine)
    for m in range(2, 2 * n, 2):
        below = integral
        integral = (power + (m - 1) * integral) / m
        power *= cosine * cosine
    out[0] += np.sqrt(2.0) * integral
    out[1] += np.sqrt(2.0) * (power + (2 * n - 1) * integral) / (2 * n)
    out[2] += np.sqrt(2.0) * (n - 1.5) * below


@_inner
def _level(r: float, rays: Rays, a: int, b: int, U: Any) -> float:
    """V at the place r of the ray whose stops are a to b."""
    V = 0.5 * r * r
    for s in range(a, b):
        overlap = rays.reach * r - rays.clearance[s]
        if overlap > 0.0:
            V += rays.stiffness[s] * of_law(U, rays.law[s], overlap, rays.exponent[s])
    return V


@_inner
def _mean_force(middle: float, width: float, law: int, e: float, g: Any) -> float:
    """Mean of the force over a width of ``NEAR`` of the overlap: three Gauss points are exact."""
    shift = 0.5 * np.sqrt(0.6) * width
    ends = of_law(g, law, middle - shift, e) + of_law(g, law, middle + shift, e)
    mean: float = (5.0 * ends + 8.0 * of_law(g, law, middle, e)) / 18.0
    return mean


@_inner
def _turning_point(
    start: float, height: float, rays: Rays, a: int, b: int, U: Any, g: Any
) -> float:
    """The x > 0 where V(start + x) − V(start) is ``height``, stops a to b being engaged.

    Newton's method in logarithms: the rise is a sum of positive powers of x, its logarithm convex
    in log x, and the iteration comes down on the root from that of the springs alone.
    """
    L = rays.reach
    x: float = 2.0 * height / (start + np.sqrt(start * start + 2.0 * height))
    for _ in range(NEWTON_STEPS):
        rise, steepness = x * (start + 0.5 * x), start + x
        for s in range(a, b):
            before = max(L * start - rays.clearance[s], 0.0)
            B, e, law = rays.stiffness[s], rays.exponent[s], rays.law[s]
            if L * x < NEAR * before:
                rise += B * L * x * _mean_force(before + 0.5 * L * x, L * x, law, e, g)
            else:
                rise += B * (of_law(U, law, before + L * x, e) - of_law(U, law, before, e))
            steepness += L * B * of_law(g, law, before + L * x, e)
        # Where the rise is x^m, x (height/rise)^(1/m) is the root: near it by a Padé approximant.
        ratio, m = height / rise, x * steepness / rise
        if ratio > 0.5:
            factor = ((m - 1.0) + (m + 1.0) * ratio) / ((m + 1.0) + (m - 1.0) * ratio)
        else:
            factor = ratio ** (1.0 / m)
        x *= factor
        # Quadratic convergence: the next step would be of the order of the square of this.
        if abs(factor - 1.0) < 1e-8:
            break
    return x


@_inner
def _turning_points(
    H: float, rays: Rays, share: float, X: Array, top: Array, U: Any, g: Any
) -> None:
    """Fill X, the distance from each stop to the turning point, and how far its panel goes.

    X is 0 where no panel begins at the stop. ``top`` is X − end where the next stop ends the
    panel, 0 where the turning point does, and where v^a dies out before, −end.
    """
    for k in range(rays.first.size - 1):
        a, b = rays.first[k], rays.first[k + 1]
        done = False
        for s in range(a, b):
            X[s] = top[s] = 0.0
            start = rays.clearance[s] / rays.reach
            end = rays.clearance[s + 1] / rays.reach if s + 1 < b else np.inf
            height = H - _level(start, rays, a, s, U)
            if done or end <= start or height <= 0.0:
                continue
            X[s] = _turning_point(start, height, rays, a, s + 1, U, g)
            if end - start < X[s]:
                top[s] = X[s] - (end - start)
                if top[s] < 1e-5 * X[s]:
                    # It cancels: what is left of H over the slope half-way, whose relative error
                    # is of the order of its square.
                    left = H - _level(end, rays, a, s + 1, U)
                    top[s] = left / _slope(0.5 * (end + start + X[s]), rays, a, s + 1, g)
            if share > 0.0:
                gone = _turning_point(start, height * (1.0 - share), rays, a, s + 1, U, g)
                if gone < X[s] - top[s]:
                    top[s] = -gone
                    done = True


@_inner
def _slope(r: float, rays: Rays, a: int, b: int, g: Any) -> float:
    """V' at the place r of the ray whose stops are a to b."""
    slope: float = r
    for s in range(a, b):
        overlap = max(rays.reach * r - rays.clearance[s], 0.0)
        force = rays.stiffness[s] * of_law(g, rays.law[s], overlap, rays.exponent[s])
        slope += rays.reach * force
    return slope


@_inner
def _panels(
    H: float, rays: Rays, X: Array, top: Array, n: int, rules: Rules, rule: int, stop: int,
    split: int, work: Work, coarse: Array, fine: Array, U: Any, g: Any, bend: Any, single: bool,
) -> None:  # fmt: skip
    """Add the integrals beyond the first stops by rules ``rule`` to ``stop``.

    The first ``split`` of their points go to ``coarse``, the rest to ``fine``.
    """
    i, size = rules.first[rule], rules.first[stop] - rules.first[rule]
    for k in range(rays.first.size - 1):
        a = rays.first[k]
        for s in range(a, rays.first[k + 1]):
            if X[s] > 0.0:
                start = rays.clearance[s] / rays.reach
                _points(start, X[s], top[s], rules, i, size, work)
                _heights(H, start, X[s], rays, a, s + 1, size, work, U, g, single)
                if single:
                    _one_degree(start, rays, a, s + 1, size, work, U, g, bend)
                else:
                    _many_degrees(n, size, work)
                _add(0, split, 1.0 / np.sqrt(H), n, work, coarse)
                _add(split, size, 1.0 / np.sqrt(H), n, work, fine)


@_inner
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


@_inner
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


@_inner
def _heights(
    H: float, start: float, X: float, rays: Rays, a: int, b: int, size: int, work: Work, U: Any,
    g: Any, single: bool,
) -> None:  # fmt: skip
    """Add to v the fall of the stops from X to x and divide it by H: it is 1 − V/H then."""
    L, x, v = rays.reach, work.x, work.v
    for s in range(a, b):
        before = max(L * start - rays.clearance[s], 0.0)
        B, e, law = rays.stiffness[s], rays.exponent[s], rays.law[s]
        last = of_law(U, law, before + L * X, e)
        if single or before > 0.0:
            for j in range(size):
                now = before + L * x[j]
                left = L * work.left[j]
                if left > NEAR * now:
                    v[j] += B * (last - of_law(U, law, now, e))
                else:
                    v[j] += B * left * _mean_force(now + 0.5 * left, left, law, e, g)
        else:
            for j in range(size):
                v[j] += B * (last - of_law(U, law, before + L * x[j], e))
    for j in range(size):
        v[j] *= 1.0 / H


@_inner
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


@_inner
def _one_degree(
    start: float, rays: Rays, a: int, b: int, size: int, work: Work, U: Any, g: Any, bend: Any
) -> None:
    """Write v^(−½) dx and (½ − V V''/V'²) v^(−½) dx for n = 1, from V as the variable."""
    L = rays.reach
    for j in range(size):
        r = start + work.x[j]
        # Not H (1 − v), which cancels near rest.
        V, steepness, curvature = 0.5 * r * r, r, 1.0
        for s in range(a, b):
            overlap = max(L * start - rays.clearance[s], 0.0) + L * work.x[j]
            B, e, law = rays.stiffness[s], rays.exponent[s], rays.law[s]
            V += B * of_law(U, law, overlap, e)
            steepness += L * B * of_law(g, law, overlap, e)
            curvature += L * L * B * of_law(bend, law, overlap, e)
        work.states[j] = work.dx[j] / np.sqrt(work.v[j])
        work.change[j] = work.states[j] * (0.5 - V * curvature / (steepness * steepness))
