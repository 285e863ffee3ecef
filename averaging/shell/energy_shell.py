"""Shells of constant energy in the contact displacements, and the power of damping terms there.

Masses without contact are integrated out exactly, which leaves V_red = ½ q_cᵀ K_red q_c + Σ U_i of
the c masses that have contact. With q_c = L y and L Lᵀ = K_red⁻¹ the springs become ½|y|².
"""

from dataclasses import dataclass
from functools import cached_property
from itertools import combinations
from typing import NamedTuple

import numpy as np
import scipy  # its parts are loaded at their first use: scipy.optimize takes long to import
from scipy.special import gammaln

from averaging.conditional import conditionals
from averaging.shell.rays import Stops
from fpk.numeric.arrays import Array, Integers
from fpk.system.damping import gaussian_moment
from fpk.system.equivalent import power_given
from fpk.system.system import System, looks_the_same_mirrored

SAME = 1e-11
"""Relative distance below which two energies are one: mirror images differ by roundings, minima
by what their search leaves; a mesh between them would have no room."""
MOMENTS = 1e-14
"""Relative error, to the sum of absolute values, of some dozens of Gaussian moments and factors."""


@dataclass(frozen=True, eq=False)
class EnergyShell:
    """Shells of constant energy of one system, held by it as ``system.fact(EnergyShell)``."""

    system: System

    @cached_property
    def L(self) -> Array:
        """L (c, c): y are the extensions of the springs in series between the contact masses, times
        the root of their stiffness; nothing cancels at any ratio of the springs."""
        laws = conditionals(self.system, self.system.contact_masses)
        return np.asarray(np.tri(len(laws)) * [law.precision**-0.5 for law in laws])

    @cached_property
    def laws(self) -> tuple[str, ...]:
        """The names of the laws of the stops, in order."""
        return tuple(sorted({stop.law for stop in self.system.stops}))

    @cached_property
    def stops(self) -> Stops:
        """The one-sided stops in y: ``reach`` (stops, c), the overlap is ``reach @ y − touch``."""
        masses, stops = self.system.contact_masses, self.system.stops
        reach = [stop.sign * self.L[masses.index(stop.index)] for stop in stops]
        rows = [(s.clearance, s.stiffness, s.power, self.laws.index(s.law)) for s in stops]
        touch, stiffness, exponent, law = np.reshape(rows, (-1, 4)).T.copy()
        return Stops(
            np.reshape(reach, (len(stops), len(masses))),
            touch,
            stiffness,
            exponent,
            law.astype(int),
        )

    def nearest(self, directions: Array) -> Stops:
        """The stops (rays, stops) in the order in which rays along ``directions`` meet them."""
        reach = directions @ self.stops.reach.T
        touch = np.full(reach.shape, np.inf)
        np.divide(self.stops.touch, reach, out=touch, where=reach > 0.0)
        order, ray = touch.argsort(axis=1, kind="stable"), np.arange(len(touch))[:, None]
        _, _, stiffness, exponent, law = self.stops
        met = reach[ray, order], touch[ray, order]
        return Stops(*met, stiffness[order], exponent[order], law[order])

    @cached_property
    def sides(self) -> Stops:
        """The stops of one contact mass on both its sides, or on one where they are alike."""
        alike = self.system.fact(looks_the_same_mirrored)
        return self.nearest(np.array([[1.0]] if alike else [[1.0], [-1.0]]))

    def potential(self, y: Array) -> Array:
        """V_red at whitened coordinates of shape (..., c)."""
        value: Array = 0.5 * np.sum(y * y, axis=-1)
        for stop, row in zip(self.system.stops, self.stops.reach, strict=True):
            value = value + stop.energy(np.maximum(y @ row - stop.clearance, 0.0))
        return value

    @cached_property
    def corners(self) -> Array:
        """Points where two stops are just touched, (points, c), of two contact masses."""
        rows, stops = self.stops.reach, self.system.stops
        corners = [
            np.linalg.solve(rows[list(pair)], self.stops.touch[list(pair)])
            for pair in combinations(range(len(stops)), 2)
            if rows.shape[1] == 2 and stops[pair[0]].mass != stops[pair[1]].mass
        ]
        return np.array(corners).reshape(len(corners), rows.shape[1])

    @cached_property
    def first_touch(self) -> Array:
        """Points where V_red is least among those that just touch one stop, (stops, c)."""
        rows = self.stops.reach
        points: Array = (self.stops.touch / (rows * rows).sum(axis=1))[:, None] * rows
        if rows.shape[1] == 1:
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


class Parts(NamedTuple):
    """Σ c_ij v_i v_j of the damping terms, averaged given the contact displacements q_c.

    With momenta and the other displacements Gaussian at the temperature 1/β, a part is
    H^energy · coefficient · β^(−j) · Π q_c^powers. The order is Σ powers + 2 j, the same for all
    parts of a term, whose degree is order − 2 + 2 energy. Without contact the power is
    Σ_d g_d H^(1 + d/2), d one of ``degrees``.
    """

    powers: Integers  # (parts, c)
    coefficient: Array  # (parts,)
    size: Array  # (parts,), the sum of the absolute values that the coefficient is a sum of
    orders: Integers  # (groups,), of the terms of one degree and order
    of_group: Array  # (parts, groups), 1 where a part is of a group and 0 elsewhere
    mean: Array  # (groups,), the mean without contact at β = 1
    spread: Array  # (groups,), a bound of the size of the mean
    degrees: Integers  # of the damping terms, ascending
    of_degree: Array  # (groups, degrees), Γ(n)/Γ(n + order/2) where a group is of a degree, else 0
    free: Array  # (degrees,), g_d
    scale: Array  # (degrees,), the same of the spread: the size of g_d
    along: Integers  # (integrals, 2), the pairs (Σ powers, j) of all parts
    column: Integers  # (parts,), which of the pairs a part has
    rest: Array  # (parts,), Γ(N/2)/Γ(N/2 + j), N = 2n − c, see ``parts_of``


def parts_of(system: System) -> Parts:
    """Return the parts of all damping terms.

    Given y the N numbers (√m v, K^½ ξ) are uniform on the sphere ½|x|² = H − V_red: a moment of
    degree 2j is (H − V_red)^j Γ(N/2)/Γ(N/2 + j) times that of Gaussian numbers.
    """
    if not system.damping_terms:
        no, none, square = np.zeros(0, dtype=np.int64), np.zeros(0), np.zeros((0, 0))
        powers, along = np.zeros((0, len(system.contact_masses)), dtype=np.int64), no.reshape(0, 2)
        of_groups = none, none, no, square, none, none, no, square, none, none
        return Parts(powers, *of_groups, along, no, none)
    keys, values = power_given(system, system.damping_terms)
    groups, group = np.unique(keys[:, :2], axis=0, return_inverse=True)
    of_group = np.eye(len(groups))[group.ravel()]
    powers, (coefficient, size) = keys[:, 2:], values.T
    # What is left where terms cancel is their round-off, which ``size`` still states.
    coefficient = np.where(np.abs(coefficient) > MOMENTS * size, coefficient, 0.0)
    L = system.fact(EnergyShell).L
    mean, square = (
        np.array([gaussian_moment(L @ L.T, tuple(row)) for row in (k * powers).tolist()])
        for k in (1, 2)
    )
    mean, spread = (coefficient * mean) @ of_group, (size * square**0.5) @ of_group
    degree, orders = groups.T
    degrees = np.unique(degree)
    rest = np.exp(gammaln(system.n) - gammaln(system.n + 0.5 * orders))
    of_degree = rest[:, None] * (degree[:, None] == degrees)
    free, scale = mean @ of_degree, spread @ of_degree
    free = np.where(np.abs(free) > MOMENTS * scale, free, 0.0)
    total, half_n = powers.sum(axis=1), system.n - 0.5 * powers.shape[1]
    j = (of_group @ orders - total).astype(int) // 2
    along, column = np.unique(np.stack([total, j], axis=1), axis=0, return_inverse=True)
    rest = np.exp(gammaln(half_n) - gammaln(half_n + j))
    found = coefficient, size, orders, of_group, mean, spread, degrees, of_degree, free, scale
    return Parts(powers, *found, along, column.ravel(), rest)
