"""Starts and limits of one mass: states with weights, and what the method refuses."""

from dataclasses import dataclass

import numpy as np

from averaging.phase_space.passage.mesh import Mesh, displacement_mesh, energy_mesh
from averaging.phase_space.passage.oscillator import Oscillator
from fpk.arrays import Array
from fpk.errors import InvalidInput, NotApplicable
from fpk.limit import Limit
from fpk.quadrature import gauss_legendre
from fpk.start import Start
from fpk.system import System

MODAL = "the energy of a mode is that of one mass without stops; ask for H"
AT_LIMIT = 1.0 - 1e-12
"""Share of an energy limit at which a start counts as beyond it, as in the simulation."""


@dataclass(frozen=True, eq=False)
class Region:
    """The states within a limit: H < ``limit`` if ``of_energy``, |q| < ``limit`` if not."""

    oscillator: Oscillator
    limit: float
    of_energy: bool

    @property
    def height(self) -> float:
        """Potential energy at the limit: the least on either side."""
        if self.of_energy:
            return self.limit
        return float(self.oscillator.potential(np.array([-self.limit, self.limit])).min())

    def mesh(self, fastest: float, level: int) -> Mesh:
        """Return the mesh of ``level`` for starts up to the speed ``fastest``."""
        if self.of_energy:
            return energy_mesh(self.oscillator, self.limit, level)
        return displacement_mesh(self.oscillator, self.limit, fastest, level)

    def within(self, q: Array, v: Array) -> Array:
        """Return which states are within the limit."""
        if self.of_energy:
            return np.asarray(self.oscillator.energy(q, v) < AT_LIMIT * self.limit)
        return np.asarray(np.abs(q) < self.limit)


def region_of(system: System, oscillator: Oscillator, limit: Limit) -> Region:
    """Return the states within ``limit``; ``NotApplicable`` for a mode of a mass with stops."""
    if limit.kind == "modal" and system.contacts:
        raise NotApplicable(f"limit {limit}: {MODAL}")
    return Region(oscillator, limit.value, of_energy=limit.kind != "q")


@dataclass(frozen=True, eq=False)
class Source:
    """One state, or all of an energy, each as long as undisturbed motion stays in it."""

    region: Region
    q: float = 0.0
    v: float = 0.0
    energy: float | None = None

    @property
    def height(self) -> float:
        """The energy of its states."""
        if self.energy is None:
            return float(self.region.oscillator.energy(np.array(self.q), np.array(self.v)))
        return self.energy

    @property
    def fastest(self) -> float:
        """The speed at q = 0 of undisturbed motion from its states."""
        return float(np.sqrt(2.0 * self.height / self.region.oscillator.mass))

    def states(self, points: int) -> tuple[Array, Array, Array]:
        """Return q, v and weights of those within the limit.

        Of an energy by ``points`` of Gauss on each piece between turning points, stops and limit:
        dt = dq/|v|, smooth in θ, q = centre + radius sin θ. Weights add up to less than 1 where
        part of the motion is beyond the limit.
        """
        if self.energy is None:
            return np.array([self.q]), np.array([self.v]), np.ones(1)
        o, region = self.region.oscillator, self.region
        left, right = o.turning_points(self.energy)
        centre, radius = 0.5 * (left + right), 0.5 * (right - left)
        cuts = [q for q, _ in o.stops] + [0.0]
        if not region.of_energy:
            cuts += [-region.limit, region.limit]
        angles = np.arcsin([(q - centre) / radius for q in cuts if left < q < right])
        # Weights near a turning point need more digits than E − V has: pieces do not begin there.
        edges = np.unique(np.concatenate([[-0.5 * np.pi, 0.5 * np.pi], angles]))
        t, w = gauss_legendre(points)
        half = 0.5 * np.diff(edges)[:, None]
        theta = (0.5 * (edges[1:] + edges[:-1])[:, None] + half * t).ravel()
        q = centre + radius * np.sin(theta)
        v = np.sqrt(np.maximum(2.0 / o.mass * (self.energy - o.potential(q)), 0.0))
        weights = (half * w).ravel() * radius * np.cos(theta) / v
        weights = 0.5 * weights / weights.sum()
        q, v, weights = np.tile(q, 2), np.concatenate([v, -v]), np.tile(weights, 2)
        inside = np.ones(q.size, dtype=bool) if region.of_energy else region.within(q, v)
        return q[inside], v[inside], weights[inside]


def source_of(system: System, region: Region, start: Start) -> Source:
    """Return the states of ``start``.

    Raises ``InvalidInput`` where it is at or beyond the limit, ``NotApplicable`` for kinds of start
    that the method does not know.
    """
    o, beyond = region.oscillator, "is at or beyond the limit"
    if start.kind == "noise" and start.values["noise"] > 0.0:
        raise NotApplicable("a stationary start is not solved for in phase space; use montecarlo")
    if start.kind == "modal" and system.contacts:
        raise NotApplicable(f"start {start}: {MODAL}")
    if start.kind in ("energy", "modal") and not start.rest:
        (energy,) = start.values.values()
        if region.of_energy and not energy < AT_LIMIT * region.limit:
            raise InvalidInput("start", str(start), beyond)
        return Source(region, energy=energy)
    q, p = (float(x[0]) for x in start.state(1)) if start.kind == "state" else (0.0, 0.0)
    source = Source(region, q, p / o.mass)
    if not region.within(np.array(q), np.array(source.v)):
        raise InvalidInput("start", str(start), beyond)
    return source
