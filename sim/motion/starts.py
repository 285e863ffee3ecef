"""States in which motions begin: one state, on an energy shell, by modes, or under other noise."""

from dataclasses import dataclass, replace
from math import ceil
from typing import Any

import numpy as np

from fpk.arrays import Array, Flags
from fpk.errors import NotApplicable
from fpk.linear import natural_modes
from fpk.machine import left_out
from fpk.start import Start
from fpk.system import System
from sim.arrays import LANES, in_rows
from sim.ensemble import ensemble_from
from sim.flow import factored
from sim.motion.steps import needs_steps
from sim.random import OTHER_SEED, stream_of
from sim.relaxation import relaxation_time
from sim.start_states import start_displacements
from sim.step_size import chosen_step, temperature

ACCEPTED = 1e-4
"""Share of the proposals on an energy shell below which no states are drawn from it."""

PROPOSED, JUDGED = 4096, 2**18
"""Proposals at once at the least, and after how many the share of the accepted ones counts."""

RADIUS_STEPS = 60
"""Bisections of a radius: to the last digit."""

BURN_IN_STEPS = 256
"""Steps of a burn-in after which the wall time is looked at: 8192 trajectories take 10 ms and more.
"""

Generator = np.random.Generator


@dataclass(frozen=True, eq=False)
class Origin:
    """Draws the states of ``system`` at time 0; ``seed`` and the number of a round make them.

    ``watch``, a ``Watch``, ends a burn-in by ``InvalidInput``.
    """

    system: System
    start: Start
    seed: int
    burn_in: float = 10.0
    workers: Any = None
    watch: Any = None

    def __post_init__(self) -> None:
        """Refuse noise that has no stationary state."""
        if self.start.kind == "noise" and self.start.values["noise"] > 0.0:
            relaxation = relaxation_time(self._louder())
            if not np.isfinite(relaxation):
                raise NotApplicable("some motion is not damped: no stationary state to start from")

    def drawn(self, paths: int, number: int) -> tuple[Array, Array]:
        """Return q and p (paths, n) of round ``number``."""
        start, n = self.start, self.system.n
        stream = stream_of(self.seed, number)
        if start.kind == "energy" and not start.rest:
            return on_shell(self.system, start.values["H"], paths, stream)
        if start.kind == "modal":
            energies = np.array([start.values[f"H{m + 1}"] for m in range(n)])
            return by_modes(self.system, energies, paths, stream)
        if start.kind == "noise" and start.values["noise"] > 0.0:
            return self._stationary(paths, number, stream)
        q, p = start.state(n)
        return np.tile(q, (paths, 1)), np.tile(p, (paths, 1))

    def _louder(self) -> System:
        factor = self.start.values["noise"]
        return replace(self.system, noise_intensity=factor * self.system.noise_intensity)

    def _stationary(self, paths: int, number: int, stream: Generator) -> tuple[Array, Array]:
        """Burn in under the other noise, from displacements and momenta of its temperature."""
        system = self._louder()
        n, kT, dt = system.n, temperature(system), 0.5 * chosen_step(system)
        whole = -(-paths // LANES) * LANES
        q = start_displacements(system, kT, stream.standard_normal((n, whole))).T
        L = factored(np.diag(kT * system.mass))
        p = (L @ stream.standard_normal((L.shape[1], whole))).T
        time = self.burn_in * relaxation_time(system)
        # Without contact and terms a step of any length is exact.
        steps = ceil(time / dt) if needs_steps(system) else 1
        pieces = ceil(steps / BURN_IN_STEPS)
        stride = ceil(steps / pieces)
        seed = (self.seed + number * OTHER_SEED + 2**63) % 2**64  # no seed of a round
        with left_out():
            dt = dt if needs_steps(system) else time
            ensemble = ensemble_from(system, q, p, dt, seed, workers=self.workers)
        for k in range(pieces):
            ensemble.advance(stride, stride=stride)
            if self.watch and k + 1 < pieces:
                self.watch.require("the burn-in", (k + 1) / pieces)
        states = in_rows(ensemble.last)[:paths]
        return states[:, :n], states[:, n : 2 * n]


def by_modes(system: System, energies: Array, paths: int, stream: Generator) -> tuple[Array, Array]:
    """Return states of modal ``energies`` (n,) with uniform phases."""
    shapes, omega = natural_modes(system)
    phase = 2.0 * np.pi * stream.random((paths, system.n))
    size = np.sqrt(2.0 * energies)
    return (size / omega * np.cos(phase)) @ shapes.T, (size * np.sin(phase)) @ (
        system.mass[:, None] * shapes
    ).T


def on_shell(system: System, energy: float, paths: int, stream: Generator) -> tuple[Array, Array]:
    """Return states uniform on the shell H = ``energy``: of the density δ(H − energy), any gap.

    In directions u of the phase space scaled so that H is r²/2 but for the contact: it has the
    weight r^(2n−1)/(∂H/∂r) at the radius where H is reached. Without contact that is R^(2n−2), its
    largest value, R = √(2 energy), and proposals are accepted by their weight.

    Raises ``NotApplicable`` where fewer than ``ACCEPTED`` of them are.
    """
    n, many = system.n, max(paths, PROPOSED)
    back = np.linalg.inv(np.linalg.cholesky(system.stiffness_matrix)).T
    root, most = np.sqrt(system.mass), np.sqrt(2.0 * energy)
    states: list[Array] = []
    proposed = wanted = 0
    while wanted < paths:
        u = stream.standard_normal((many, 2 * n))
        u /= np.linalg.norm(u, axis=1, keepdims=True)
        direction = np.hstack([u[:, :n] @ back.T, u[:, n:] * root])
        radius = _radius(system, direction, energy)
        q, p = radius[:, None] * direction[:, :n], radius[:, None] * direction[:, n:]
        by_contact = np.zeros(many)  # Σ g_i dq_i/dr, the part of ∂H/∂r that the contacts make
        for stop in system.stops:
            overlap = np.maximum(stop.sign * q[:, stop.index] - stop.clearance, 0.0)
            by_contact += stop.sign * stop.force(overlap) * direction[:, stop.index]
        weight = (radius / most) ** (2 * n - 2) * radius / (radius + by_contact)
        accepted: Flags = stream.random(many) < weight
        states.append(np.hstack([q, p])[accepted])
        proposed, wanted = proposed + many, wanted + int(np.count_nonzero(accepted))
        if proposed >= JUDGED and wanted < ACCEPTED * proposed:
            raise NotApplicable(
                f"the shell H = {energy:g} is so far within the contacts that no states are drawn"
                " from it; begin in a state"
            )
    chosen = np.concatenate(states)[:paths]
    return chosen[:, :n], chosen[:, n:]


def _radius(system: System, direction: Array, energy: float) -> Array:
    """Where H reaches ``energy`` along every ``direction`` (paths, 2n)."""
    n = system.n
    low, high = np.zeros(len(direction)), np.full(len(direction), np.sqrt(2.0 * energy))
    if not system.stops:
        return high
    for _ in range(RADIUS_STEPS):
        middle = 0.5 * (low + high)
        state = middle[:, None] * direction
        above = system.hamiltonian(state[:, :n], state[:, n:]) > energy
        low, high = np.where(above, low, middle), np.where(above, middle, high)
    return np.asarray(0.5 * (low + high))
