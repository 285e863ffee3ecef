"""Shells of constant energy in the coordinates of the masses that can touch something.

Integrals over a shell are those along rays, summed over all directions and refined.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations
from math import pi
from typing import Any

import numpy as np
import scipy  # its parts are loaded at their first use: scipy.optimize takes long to import

from averaging.conditional import conditionals
from averaging.shell.rays import Stops, gauss_rules, ray_integrals
from fpk.numeric.arrays import Array, Integers
from fpk.numeric.quadrature import gauss_legendre
from fpk.system.system import System, looks_the_same_mirrored

SAME = 1e-11
"""Relative distance below which two energies are one: mirror images differ by roundings, minima
by what their search leaves; a mesh between them would have no room."""
RULES = (14, 18, 24, 48, 96, 192)
"""Gauss points per panel, in the order in which an integral is refined."""
RADIAL_RULE = 2
"""Index of the rule of 24 points, enough along a ray for any contact stiffness, not over angles."""
TARGET = 3e-12
"""Relative disagreement of two rules that ends the refinement and is reported as the error."""
ROUND_OFF = 2e-15
"""Relative error of a sum of some dozens of positive terms."""
ROOT_ROUND_OFF = 4e-13
"""Relative error of a sum of a system of one mass, ε points²: its integrand is 1/√v, v = 1 − V/H,
where v ~ 1/points² at the Gauss point next to the turning point."""

Combine = Callable[[Array, Array], Array]
"""Quantities (..., rays, quantities) from directions (rays, c) and integrals (..., rays, ·)."""


@dataclass(frozen=True, eq=False)
class EnergyShell:
    """Shells of constant energy of one system, over the c masses that have a contact.

    Masses without contact are integrated out exactly, which leaves
    V_red = ½ q_cᵀ K_red q_c + Σ U_i(q_i). With q_c = L y and L Lᵀ = K_red⁻¹ the springs become
    ½|y|². Held by the system as ``system.fact(EnergyShell)``.
    """

    system: System

    @property
    def count(self) -> int:
        """Number of masses with contact, c."""
        return len(self.system.contact_masses)

    @cached_property
    def L(self) -> Array:
        """L (c, c): y are the extensions of the springs in series between the contact masses, times
        the root of their stiffness; nothing cancels at any ratio of the springs."""
        laws = conditionals(self.system, self.system.contact_masses)
        return np.asarray(np.tri(self.count) * [law.precision**-0.5 for law in laws])

    @cached_property
    def stops(self) -> Stops:
        """The one-sided contacts in y."""
        stops, laws = self.system.stops, sorted({stop.law for stop in self.system.stops})
        masses = self.system.contact_masses
        rows = [stop.sign * self.L[masses.index(stop.index)] for stop in stops]
        return Stops(
            reach=np.array(rows).reshape(len(stops), self.count),
            touch=np.array([stop.clearance for stop in stops], dtype=float),
            stiffness=np.array([stop.stiffness for stop in stops], dtype=float),
            exponent=np.array([stop.power for stop in stops], dtype=float),
            law=np.array([laws.index(stop.law) for stop in stops], dtype=np.int64),
        )

    def potential(self, y: Array) -> Array:
        """V_red at whitened coordinates of shape (..., c)."""
        value: Array = 0.5 * np.sum(y * y, axis=-1)
        for stop, row in zip(self.system.stops, self.stops.reach, strict=True):
            value = value + stop.energy(np.maximum(y @ row - stop.clearance, 0.0))
        return value

    @cached_property
    def corners(self) -> Array:
        """Points where two stops are just touched, (points, c), of two contact masses."""
        rows, clearance, stops = self.stops.reach, self.stops.touch, self.system.stops
        corners = [
            np.linalg.solve(rows[list(pair)], clearance[list(pair)])
            for pair in combinations(range(clearance.size), 2)
            if self.count == 2 and stops[pair[0]].mass != stops[pair[1]].mass
        ]
        return np.array(corners).reshape(len(corners), self.count)

    @cached_property
    def first_touch(self) -> Array:
        """Points where V_red is least among those that just touch one stop, (stops, c)."""
        rows = self.stops.reach
        points: Array = (self.stops.touch / (rows * rows).sum(axis=1))[:, None] * rows
        if self.count == 1:
            return points
        springs = 0.5 * (points * points).sum(axis=1) * (1.0 + SAME)
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

        They are the minima of V_red where one stop is just touched, H_c = ½ k_eff δ² with no other
        in the way, and for two contact masses also where two are: each more adds half a derivative.
        """
        energies = sorted([*self.potential(self.first_touch), *self.potential(self.corners)])
        both = zip([-1.0, *energies], energies, strict=False)
        return tuple(float(H) for before, H in both if H - before > SAME * H)

    def integrals(
        self, energy: Array, orders: Integers, combine: Combine, target: float
    ) -> tuple[Array, Array]:
        """Return integrals over the shells (energies, quantities) and their errors, of that shape.

        One or two masses have contact. ``combine`` makes the quantities of the integrals along rays
        of ``ray_integrals``; they are summed over all directions. Errors are relative, of H T' to T
        at the least. The rules are refined until the errors of the first three are below
        ``TARGET``, all others below ``target``.
        """
        n, mirror = self.system.n, self.system.fact(looks_the_same_mirrored)
        laws = tuple(sorted({stop.law for stop in self.system.stops}))
        add_rays = ray_integrals(laws, 2 * n - self.count - 2 <= 0)
        cuts = self._cut_angles(energy) if self.count == 2 else np.empty((energy.size, 0))

        def sums(i: Integers, rules: range) -> Array:
            """The quantities at some energies by some of the ``RULES``, (rules, energies, ·)."""
            which, directions, weights = _rays(cuts[i], RULES[rules[0]], mirror=mirror)
            last = len(RULES) if self.count == 1 else RADIAL_RULE
            radial = gauss_rules(tuple(RULES[min(k, last)] for k in rules))
            out = np.zeros((len(rules), which.size, 3 + len(orders)))
            add_rays(energy[i[which]], directions, self.stops, n, orders, *radial, out)
            parts = weights[:, None] * combine(directions, out)
            return np.add.reduceat(parts, np.searchsorted(which, np.arange(i.size)), axis=1)

        def error_of(coarse: Array, fine: Array) -> Array:
            size = np.abs(fine)
            size[:, 2] = np.maximum(size[:, 2], fine[:, 0])
            return np.abs(coarse - fine) / size + (ROUND_OFF if n > 1 else ROOT_ROUND_OFF)

        # Rays of one contact mass serve both rules; of two each rule has its own.
        first = [range(2)] if self.count == 1 else [range(1), range(1, 2)]
        coarse, fine = np.concatenate([sums(np.arange(energy.size), rules) for rules in first])
        error = error_of(coarse, fine)
        targets = np.array([TARGET] * 3 + [target] * (fine.shape[1] - 3))
        for rule in range(2, len(RULES)):
            i = np.flatnonzero(~np.all(error <= targets, axis=1))  # no number is refined, too
            if not i.size:
                break
            (finer,) = sums(i, range(rule, rule + 1))
            error[i], fine[i] = error_of(fine[i], finer), finer
        return fine, np.where(np.isnan(error), np.inf, error)

    def _cut_angles(self, energy: Array) -> Array:
        """Angles (energies, cuts) where a stop joins or leaves the shell; 0 for no cut."""
        fixed = [0.0, 0.5 * pi, *np.arctan2(self.corners[:, 1], self.corners[:, 0])]
        touch, rows = self.first_touch, self.stops.reach
        angles = np.zeros((2, len(touch), energy.size))
        stop, level = np.nonzero(self.potential(touch)[:, None] < energy)
        if stop.size:
            # On the line where a stop is just touched V is convex: H is met once on either side of
            # the lowest point, no farther than where the springs alone reach it.
            (x0, y0), H = touch[stop].T, energy[level]
            dx, dy = np.array([-rows[stop, 1], rows[stop, 0]]) / np.linalg.norm(rows[stop], axis=1)
            end = np.array([[1.0], [-1.0]]) * (1.000000001 * np.sqrt(2.0 * H) + np.hypot(x0, y0))

            def excess(t: Array, *line: Array) -> Array:
                x0, y0, dx, dy, H = line
                return self.potential(np.stack([x0 + t * dx, y0 + t * dy], axis=-1)) - H

            from scipy.optimize import elementwise  # noqa: PLC0415  (it takes 0.2 s)

            find_root: Any = elementwise.find_root  # typed without further arguments
            t = find_root(excess, (0.0 * end, end), args=(x0, y0, dx, dy, H)).x
            angles[:, stop, level] = np.arctan2(y0 + t * dy, x0 + t * dx)
        crossings = angles.reshape(-1, energy.size).T
        return np.hstack([np.tile(fixed, (energy.size, 1)), crossings])


def _rays(cuts: Array, nodes: int, *, mirror: bool) -> tuple[Integers, Array, Array]:
    """Index of each ray's energy (rays,), the directions (rays, c), the weights (rays,).

    Without ``cuts`` (energies, cuts) one mass has contact; of two there are Gauss panels over the
    angle between these: sin² towards both ends of a panel turns the half-integer powers that Hertz
    contact leaves there into smooth functions. ``mirror`` says that V is even.
    """
    if not cuts.shape[1]:
        sides = np.array([[1.0]] if mirror else [[1.0], [-1.0]])
        which = np.repeat(np.arange(len(cuts)), len(sides))
        return which, np.tile(sides, (len(cuts), 1)), np.full(which.size, 2.0 / len(sides))
    period = pi if mirror else 2.0 * pi
    cuts = np.sort(cuts % period, axis=1)
    cuts = np.concatenate([cuts, cuts[:, :1] + period], axis=1)
    t, w = gauss_legendre(nodes)
    psi = 0.25 * pi * (1.0 + t)
    share, slope = np.sin(psi) ** 2, 0.25 * pi * np.sin(2.0 * psi) * w
    length = np.diff(cuts, axis=1)[:, :, None]
    angle, weight = cuts[:, :-1, None] + length * share, length * slope
    keep = weight != 0.0  # a cut that is no number makes a sum that is none
    directions = np.stack([np.cos(angle[keep]), np.sin(angle[keep])], axis=1)
    return np.nonzero(keep)[0], directions, weight[keep] * (2.0 * pi / period)
