"""Shells of constant energy in the coordinates of the masses that can touch something."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations

import numpy as np
import scipy  # its parts are loaded at their first use: scipy.optimize takes long to import

from averaging.conditional import conditionals
from averaging.shell.rays import Stops, ray_integrals
from fpk.arrays import Array
from fpk.system import System

SAME = 1e-11
"""Relative distance below which two energies are one: mirror images differ by roundings, minima
by what their search leaves; a mesh between them would have no room."""


@dataclass(frozen=True, eq=False)
class EnergyShell:
    """Shells of constant energy of one system, over the c masses that have a contact.

    Masses without contact are integrated out exactly, which leaves
    V_red = ½ q_cᵀ K_red q_c + Σ U_i(q_i) with ``K_red`` the Schur complement of the stiffness
    matrix. With q_c = L y and L Lᵀ = K_red⁻¹ the springs become ½|y|². Held by the system as
    ``system.fact(EnergyShell)``.
    """

    system: System

    @cached_property
    def L(self) -> Array:
        """L (c, c): each contact mass hangs on the one before it by springs in series.

        y are the extensions of these springs, times the root of their stiffness: nothing cancels
        at any ratio of the springs.
        """
        reach = [
            law.precision**-0.5 for law in conditionals(self.system, self.system.contact_masses)
        ]
        return np.asarray(np.tri(self.count) * reach)

    @cached_property
    def stops(self) -> Stops:
        """The one-sided contacts in y."""
        stops, laws = self.system.stops, sorted({stop.law for stop in self.system.stops})
        masses = self.system.contact_masses
        rows = [stop.sign * self.L[masses.index(stop.index)] for stop in stops]
        return Stops(
            rows=np.array(rows).reshape(len(stops), self.count),
            clearance=np.array([stop.clearance for stop in stops], dtype=float),
            stiffness=np.array([stop.stiffness for stop in stops], dtype=float),
            exponent=np.array([stop.power for stop in stops], dtype=float),
            law=np.array([laws.index(stop.law) for stop in stops], dtype=np.int64),
        )

    def potential(self, y: Array) -> Array:
        """V_red at whitened coordinates of shape (..., c)."""
        value: Array = 0.5 * np.sum(y * y, axis=-1)
        for stop, row in zip(self.system.stops, self.stops.rows, strict=True):
            value = value + stop.energy(np.maximum(y @ row - stop.clearance, 0.0))
        return value

    @property
    def count(self) -> int:
        """Number of masses with contact, c."""
        return len(self.system.contact_masses)

    @cached_property
    def add_rays(self) -> Callable[..., int]:
        """The compiled integrals along rays for the contact laws of the system."""
        names = tuple(sorted({stop.law for stop in self.system.stops}))
        return ray_integrals(names, 2 * self.system.n - self.count - 2 <= 0)

    @cached_property
    def corners(self) -> Array:
        """Points where two stops are just touched, (points, 2), of two contact masses."""
        rows, clearance, stops = self.stops.rows, self.stops.clearance, self.system.stops
        pairs = [
            list(pair)
            for pair in combinations(range(clearance.size), 2)
            if self.count == 2 and stops[pair[0]].mass != stops[pair[1]].mass
        ]
        corners = [np.linalg.solve(rows[p], clearance[p]) for p in pairs]
        return np.array(corners).reshape(-1, 2)

    @cached_property
    def contact_energies(self) -> tuple[float, ...]:
        """The energies, ascending, at which T(H) loses smoothness.

        They are the minima of V_red where one stop is just touched, H_c = ½ k_eff δ² with no other
        in the way, and for two contact masses also where two are: each more adds half a derivative.
        """
        energies = self.potential(self.first_touch).tolist()
        if self.count == 2:
            energies += self.potential(self.corners).tolist()
        energies.sort()
        return tuple(H for k, H in enumerate(energies) if not k or H - energies[k - 1] > SAME * H)

    @cached_property
    def first_touch(self) -> Array:
        """Points where V_red is least among those that just touch one stop, (stops, c)."""
        rows = self.stops.rows
        points: Array = (self.stops.clearance / (rows * rows).sum(axis=1))[:, None] * rows
        if self.count > 1:
            springs = 0.5 * (points * points).sum(axis=1) * (1.0 + SAME)
            for k in np.flatnonzero(self.potential(points) > springs):
                points[k] = self._lowest(points[k], rows[k])
        return points

    def _lowest(self, foot: Array, row: Array) -> Array:
        """Where V_red is least on the plane through ``foot`` with the normal ``row``."""
        free = np.linalg.svd(row[None])[2][1:].T

        def energy(t: Array) -> float:
            return float(self.potential(foot + free @ t))

        lowest = scipy.optimize.minimize(energy, np.zeros(free.shape[1]), tol=1e-12).x
        return np.asarray(foot + free @ lowest)
