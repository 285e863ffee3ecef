"""Shells of constant energy, and integrals over them along rays: (10), (25), (28) for any n.

Masses without contact are integrated out exactly, which leaves V_red = ½ q_cᵀ K_red q_c + Σ U_i of
the c masses that have contact. With q_c = L y and L Lᵀ = K_red⁻¹ the springs become ½|y|².

Along a ray y = r e of whitened coordinates V rises strictly, so the shell is 0 <= r <= R. Panels
end where a stop is first touched. X is the distance from the beginning of a panel to the turning
point if no further stop followed. Beyond the first stop x = X sin²φ removes the root at the turning
point and the half-integer powers of a Hertz contact at the beginning; it is smooth up to the next
stop.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import combinations
from typing import Any, NamedTuple

import numpy as np
import scipy  # its parts are loaded at their first use: scipy.optimize takes long to import

from averaging.conditional import conditionals
from fpk.numeric.arrays import Array, Integers
from fpk.numeric.compiling import cached_njit, checksum, njit_inline
from fpk.numeric.quadrature import gauss_legendre
from fpk.system.compiled_laws import compile_laws, law_files, of_law
from fpk.system.system import System, looks_the_same_mirrored

SAME_ENERGY = 1e-11
"""Relative difference below which two contact energies count as equal: mirror images differ
by round-off, minima by the tolerance of their search."""
SMALL_GAIN = 0.01
"""Change of the overlap over the overlap below which a change of the contact energy is computed
from the force: the difference of two energies would cancel."""
NEWTON_STEPS = 100
"""Limit of the steps to a turning point: the convergence is monotone, and some ten steps
suffice."""


class Stops(NamedTuple):
    """One-sided stops along rays, nearest first: the overlap at r is ``reach`` (r − ``touch``).

    Arrays are (rays, stops), for one ray (stops,). ``touch`` is ∞ if the ray never meets the stop.
    ``law`` is the index of the contact law among the names in alphabetical order.
    """

    reach: Array
    touch: Array
    stiffness: Array
    exponent: Array
    law: Integers


@dataclass(frozen=True, eq=False)
class EnergyShell:
    """Geometry of the energy shells of ``system``, to be had as ``system.fact(EnergyShell)``."""

    system: System

    @cached_property
    def L(self) -> Array:
        """L (c, c), lower triangular, of q_c = L y: y are the extensions, times √stiffness, of the
        springs in series between contact masses. No two terms cancel, whatever the springs are."""
        laws = conditionals(self.system, self.system.contact_masses)
        return np.asarray(np.tri(len(laws)) * [law.precision**-0.5 for law in laws])

    @cached_property
    def laws(self) -> tuple[str, ...]:
        """The names of the contact laws of the stops, in alphabetical order."""
        return tuple(sorted({stop.law for stop in self.system.stops}))

    @cached_property
    def stops(self) -> Stops:
        """The one-sided stops in y: ``reach`` (stops, c), the overlap is ``reach @ y − touch``."""
        masses, stops = self.system.contact_masses, self.system.stops
        rises = [stop.sign * self.L[masses.index(stop.index)] for stop in stops]
        reach = np.reshape(rises, (len(stops), len(masses)))
        rows = [(s.clearance, s.stiffness, s.power, self.laws.index(s.law)) for s in stops]
        touch, stiffness, exponent, law = np.array(rows, dtype=float).reshape(-1, 4).T.copy()
        return Stops(reach, touch, stiffness, exponent, law.astype(int))

    def nearest(self, directions: Array) -> Stops:
        """Return the stops (rays, stops), nearest first, along ``directions`` (rays, c)."""
        reach = directions @ self.stops.reach.T
        touch = np.full(reach.shape, np.inf)
        np.divide(self.stops.touch, reach, out=touch, where=reach > 0.0)
        order = touch.argsort(axis=1, kind="stable")
        own = (np.take_along_axis(x, order, 1) for x in (reach, touch))
        return Stops(*own, *(x[order] for x in self.stops[2:]))

    @cached_property
    def sides(self) -> Stops:
        """The stops of one contact mass: row 0 on the right, row 1 on the left, absent if equal."""
        alike = self.system.fact(looks_the_same_mirrored)
        return self.nearest(np.array([[1.0]] if alike else [[1.0], [-1.0]]))

    def potential(self, y: Array) -> Array:
        """Return V_red at whitened coordinates ``y`` (..., c)."""
        value: Array = 0.5 * np.sum(y * y, axis=-1)
        for stop, row in zip(self.system.stops, self.stops.reach, strict=True):
            value = value + stop.energy(np.maximum(y @ row - stop.clearance, 0.0))
        return value

    @cached_property
    def corners(self) -> Array:
        """Points y (points, c) that just touch stops of two contact masses; none unless c = 2."""
        rows, stops = self.stops.reach, self.system.stops
        corners = [
            np.linalg.solve(rows[list(pair)], self.stops.touch[list(pair)])
            for pair in combinations(range(len(stops)), 2)
            if rows.shape[1] == 2 and stops[pair[0]].mass != stops[pair[1]].mass
        ]
        return np.array(corners).reshape(len(corners), rows.shape[1])

    @cached_property
    def first_touch(self) -> Array:
        """For each stop the point y of least V_red among all that just touch it, (stops, c)."""
        rows = self.stops.reach
        points: Array = (self.stops.touch / (rows * rows).sum(axis=1))[:, None] * rows
        if rows.shape[1] == 1:
            return points
        springs = 0.5 * (points * points).sum(axis=1) * (1.0 + SAME_ENERGY)
        for k in np.flatnonzero(self.potential(points) > springs):
            plane, foot = np.linalg.svd(rows[k][None])[2][1:].T, points[k].copy()

            def energy(t: Array, plane: Array = plane, foot: Array = foot) -> float:
                return float(self.potential(foot + plane @ t))

            lowest = scipy.optimize.minimize(energy, np.zeros(plane.shape[1]), tol=1e-12).x
            points[k] = foot + plane @ lowest
        return points

    @cached_property
    def contact_energies(self) -> tuple[float, ...]:
        """The energies, ascending, at which T(H) loses smoothness.

        They are V_red at ``first_touch``, ½ k_eff δ² if no other stop is met before, and for two
        contact masses also at ``corners``; each further contact mass raises T's smoothness there by
        half a derivative.
        """
        energies = sorted([*self.potential(self.first_touch), *self.potential(self.corners)])
        both = zip([-1.0, *energies], energies, strict=False)
        return tuple(float(H) for before, H in both if H - before > SAME_ENERGY * H)


@lru_cache
def gauss_rules(counts: tuple[int, ...]) -> tuple[Array, Integers]:
    """Return Gauss rules on [0, 1] of ``counts`` points, one after another, and their boundaries.

    The first array (4, points) holds points, weights, and sin φ and cos φ, φ = π/2 times the point;
    rule k is columns boundaries[k] to boundaries[k + 1].
    """
    t, w = np.hstack([gauss_legendre(count) for count in counts])
    phi = 0.25 * np.pi * (1.0 + t)
    rule = np.array([0.5 * (1.0 + t), 0.5 * w, np.sin(phi), np.cos(phi)])
    return rule, np.cumsum([0, *counts])


@lru_cache
def ray_integrals(names: tuple[str, ...], singular: bool) -> Callable[..., int]:
    """Return the compiled integrals ``add_rays`` for the contact laws ``names``.

    ``singular`` says that a = n − c/2 − 1 <= 0; the laws' slopes are needed then.
    """
    sources = checksum(law_files(names))
    U: Any = compile_laws(names, "energy")
    g: Any = compile_laws(names, "force")
    bend: Any = compile_laws(names, "slope" if singular else "force")

    @cached_njit()
    def add_rays(
        energy: Array,
        c: int,
        stops: Stops,
        n: int,
        orders: Integers,
        rule: Array,
        ends: Integers,
        out: Array,
    ) -> int:
        """Add the integrals along rays by each rule to ``out`` (rules, rays, 3 + orders), in place.

        ``energy`` H is (rays,), ``n`` the number of masses, ``c`` of masses with contact; ``rule``
        and ``ends`` are as ``gauss_rules`` returns them; rays take the rows of ``stops`` in turn.
        With a = n − c/2 − 1, v = 1 − V/H and lengths in units of √H the integrands are
        v^a r^(c−1) (1, v, w), for T, phase volume and H T', then v^(a+j) r^(c−1+k) for the rows
        (k, j) of ``orders``. For a > 0, w = a/v is the derivative in H; for a <= 0 that integral
        diverges, and w = a + 1 + V ((c−1)/(r V_r) − V_rr/V_r²) results from differentiating with V
        as the variable. Returns the checksum of the laws' sources.
        """
        a = n - 0.5 * c - 1.0
        whole, half = int(np.ceil(a)), a % 1.0 > 0.0
        r, dx, v = np.empty((3, rule.shape[1]))
        for i in range(energy.size):
            H, scale = energy[i], 1.0 / np.sqrt(energy[i])
            reach, touch, stiffness, exponent, law = stops
            m = i % len(reach)  # with one contact mass rays go to either side in turn
            ray = Stops(reach[m], touch[m], stiffness[m], exponent[m], law[m])
            for k in range(ray.touch.size + 1):  # stops engaged
                start = ray.touch[k - 1] if k > 0 else 0.0
                length = ray.touch[k] - start if k < ray.touch.size else np.inf
                height = H - 0.5 * start * start
                for s in range(k):
                    height -= _of_stop(U, ray, s, ray.reach[s] * (start - ray.touch[s]))
                if not height > 0.0:
                    break
                if length <= 0.0:
                    continue
                X = _turning_point(height, start, k, ray, U, g)
                span, top = min(length, X), np.sqrt(X)
                # Before the first stop only the root at X is to be removed, by the variable √(X −
                # x), which needs no sine at each point.
                width = span / (top + np.sqrt(X - span))
                end = 0.5 * np.pi if span == X else np.arctan2(np.sqrt(span), np.sqrt(X - span))
                for j in range(r.size):
                    if k == 0:
                        root = top - width * rule[0, j]
                        x, left = width * rule[0, j] * (top + root), root * root
                        dx[j] = 2.0 * root * width * rule[1, j]
                    else:
                        sine, cosine = rule[2, j], rule[3, j]
                        if span < X:
                            sine, cosine = np.sin(end * rule[0, j]), np.cos(end * rule[0, j])
                        x, left = X * sine * sine, X * cosine * cosine
                        dx[j] = 2.0 * X * end * sine * cosine * rule[1, j]
                    # v H is the fall of the energy of springs and stops from X to x.
                    fall = left * (start + 0.5 * (X + x))
                    for s in range(k):
                        begun = ray.reach[s] * (start - ray.touch[s])
                        last = _of_stop(U, ray, s, begun + ray.reach[s] * X)
                        low, rise = begun + ray.reach[s] * x, ray.reach[s] * left
                        fall += _gain(low, rise, last, ray, s, U, g)
                    r[j], v[j] = start + x, fall / H
                for m in range(out.shape[0]):
                    for j in range(ends[m], ends[m + 1]):
                        states = dx[j] * v[j] ** whole * scale
                        if half:
                            states /= np.sqrt(v[j])
                        if c == 2:
                            states *= r[j] * scale
                        change = a / v[j]
                        if singular:
                            change = a + 1.0 + _bent(r[j], k, c, ray, U, g, bend)
                        out[m, i, 0] += states
                        out[m, i, 1] += states * v[j]
                        out[m, i, 2] += states * change
                        for o in range(orders.shape[0]):
                            power = (r[j] * scale) ** orders[o, 0] * v[j] ** orders[o, 1]
                            out[m, i, 3 + o] += states * power
        return sources

    return add_rays


@njit_inline
def _of_stop(part: Any, ray: Stops, s: int, overlap: float) -> float:
    """Return energy, force or slope (``part`` of the laws) of stop ``s`` at ``overlap``."""
    value: float = ray.stiffness[s] * of_law(part, ray.law[s], overlap, ray.exponent[s])
    return value


@njit_inline
def _gain(low: float, width: float, top: float, ray: Stops, s: int, U: Any, g: Any) -> float:
    """Return U(low + width) − U(low) of stop ``s`` without cancellation; ``top`` is U(low + width).

    If ``width`` is small against the overlap ``low``, it is width times the mean force by three
    Gauss points, whose error is below round-off then.
    """
    if width > SMALL_GAIN * low:
        difference: float = top - _of_stop(U, ray, s, low)
        return difference
    middle, shift = low + 0.5 * width, 0.5 * np.sqrt(0.6) * width
    ends = _of_stop(g, ray, s, middle - shift) + _of_stop(g, ray, s, middle + shift)
    mean: float = (5.0 * ends + 8.0 * _of_stop(g, ray, s, middle)) / 18.0
    return width * mean


@njit_inline
def _turning_point(height: float, start: float, k: int, ray: Stops, U: Any, g: Any) -> float:
    """Return x > 0 with V(``start`` + x) − V(``start``) = ``height``; NaN without convergence.

    V is ½ r² plus the energy U (force ``g``) of the first ``k`` stops of ``ray``. Newton's method
    in logarithms converges monotonically, as the ln of the rise of V is convex in ln x.
    """
    x: float = 2.0 * height / (start + np.sqrt(start * start + 2.0 * height))
    if k == 0:
        return x
    for _ in range(NEWTON_STEPS):
        rise, steepness = x * (start + 0.5 * x), start + x
        for s in range(k):
            begun, gained = ray.reach[s] * (start - ray.touch[s]), ray.reach[s] * x
            rise += _gain(begun, gained, _of_stop(U, ray, s, begun + gained), ray, s, U, g)
            steepness += ray.reach[s] * _of_stop(g, ray, s, begun + gained)
        # If the rise were x^m, the root were x (height/rise)^(1/m); near 1 a Padé approximant of
        # it.
        ratio, m = height / rise, x * steepness / rise
        if ratio > 0.5:
            factor = ((m - 1.0) + (m + 1.0) * ratio) / ((m + 1.0) + (m - 1.0) * ratio)
        elif np.isfinite(m) and ratio > 0.0:
            factor = ratio ** (1.0 / m)
        else:  # a high power of x has overflowed
            factor = 0.125
        x *= factor
        # Quadratic convergence: the next step would be about the square of this step.
        if abs(factor - 1.0) < 1e-8:
            return x
    return np.nan


@njit_inline
def _bent(r: float, k: int, c: int, ray: Stops, U: Any, g: Any, bend: Any) -> float:
    """Return V ((c−1)/(r V_r) − V_rr/V_r²) at ``r``; V, ``k``: see ``_turning_point``.

    ``bend`` is the slope of the laws. V is summed here: H (1 − v) would cancel near rest.
    """
    V, steepness, curvature = 0.5 * r * r, r, 1.0
    for s in range(k):
        reach, overlap = ray.reach[s], ray.reach[s] * (r - ray.touch[s])
        V += _of_stop(U, ray, s, overlap)
        steepness += reach * _of_stop(g, ray, s, overlap)
        curvature += reach * reach * _of_stop(bend, ray, s, overlap)
    value: float = V * ((c - 1) / (r * steepness) - curvature / (steepness * steepness))
    return value
