"""States in which motions begin: one state, on an energy shell, by modes, or under other noise."""

from dataclasses import replace
from math import ceil
from typing import Any

import numpy as np

from fpk.answer.start import Start
from fpk.numeric.arrays import Array, Flags
from fpk.numeric.errors import NotApplicable
from fpk.numeric.machine import left_out
from fpk.system.linear import natural_modes
from fpk.system.system import System
from sim.questions.limits import CHUNK, needs_steps
from sim.sample.ensemble import ensemble_from
from sim.step.arrays import LANES, in_rows
from sim.step.random import GOLDEN, start_displacements, stream_of
from sim.step.schemes import factored
from sim.step.step_size import chosen_step, relaxation_time, temperature

ACCEPTED = 1e-4
"""Share of the proposals on an energy shell below which no states are drawn from it."""


def drawn_states(
    system: System,
    start: Start,
    seed: int,
    paths: int,
    number: int = 0,
    *,
    burn_in: float = 10.0,
    workers: Any = None,
    watch: Any = None,
) -> tuple[Array, Array]:
    """Return q and p (paths, n) at time 0 of the trajectories of round ``number``.

    A start under other noise is burnt in for ``burn_in`` relaxation times; ``watch``, a ``Watch``,
    ends that by ``InvalidInput``. Raises ``NotApplicable`` for noise without a stationary state.
    """
    n, stream = system.n, stream_of(seed, number)
    if start.kind == "energy" and not start.rest:
        return on_shell(system, start.values["H"], paths, stream)
    if start.kind == "modal":
        shapes, omega = natural_modes(system)
        phase = 2.0 * np.pi * stream.random((paths, n))
        size = np.sqrt(2.0 * np.array([start.values[f"H{m + 1}"] for m in range(n)]))
        q = (size / omega * np.cos(phase)) @ shapes.T
        return q, (size * np.sin(phase)) @ (system.mass[:, None] * shapes).T
    factor = start.values.get("noise", 0.0)
    if not factor:
        q, p = start.state(n)
        return np.tile(q, (paths, 1)), np.tile(p, (paths, 1))
    # From displacements and momenta of the temperature of the other noise.
    system = replace(system, noise_intensity=factor * system.noise_intensity)
    kT, time = temperature(system), burn_in * relaxation_time(system)
    if not np.isfinite(time):
        raise NotApplicable("some motion is not damped: no stationary state to start from")
    whole = -(-paths // LANES) * LANES
    q = start_displacements(system, kT, stream.standard_normal((n, whole))).T
    L = factored(np.diag(kT * system.mass))
    p = (L @ stream.standard_normal((L.shape[1], whole))).T
    # Without contact and terms a step of any length is exact.
    dt = 0.5 * chosen_step(system) if needs_steps(system) else time
    pieces = ceil(ceil(time / dt) / CHUNK)
    stride = ceil(ceil(time / dt) / pieces)
    with left_out():
        other = (seed + number * int(GOLDEN) + 2**63) % 2**64  # no seed of a round
        ensemble = ensemble_from(system, q, p, dt, other, workers=workers)
    for k in range(pieces):
        ensemble.advance(stride, stride=stride)
        if watch and k + 1 < pieces:
            watch.require("the burn-in", (k + 1) / pieces)
    q, p, _ = np.split(in_rows(ensemble.last)[:paths], [n, 2 * n], axis=1)
    return q, p


def on_shell(
    system: System, energy: float, paths: int, stream: np.random.Generator
) -> tuple[Array, Array]:
    """Return states uniform on the shell H = ``energy``: of the density δ(H − energy), any gap.

    In directions u of the phase space scaled so that H is r²/2 but for the contact: it has the
    weight r^(2n−1)/(∂H/∂r) at the radius where H is reached. Without contact that is R^(2n−2), its
    largest value, R = √(2 energy), and proposals are accepted by their weight.

    Raises ``NotApplicable`` where fewer than ``ACCEPTED`` of them are.
    """
    n, many = system.n, max(paths, 4096)
    back = np.linalg.inv(np.linalg.cholesky(system.stiffness_matrix)).T
    root, most = np.sqrt(system.mass), np.sqrt(2.0 * energy)
    states: list[Array] = []
    proposed = wanted = 0
    while wanted < paths:
        u = stream.standard_normal((many, 2 * n))
        u /= np.linalg.norm(u, axis=1, keepdims=True)
        direction = np.hstack([u[:, :n] @ back.T, u[:, n:] * root])
        # Where H reaches the energy along every direction, by bisection to the last digit.
        low, radius = np.zeros(many), np.full(many, most)
        for _ in range(60 if system.stops else 0):
            middle = 0.5 * (low + radius)
            state = middle[:, None] * direction
            above = system.hamiltonian(state[:, :n], state[:, n:]) > energy
            low, radius = np.where(above, low, middle), np.where(above, middle, radius)
        if system.stops:
            radius = 0.5 * (low + radius)
        q, p = radius[:, None] * direction[:, :n], radius[:, None] * direction[:, n:]
        by_contact = np.zeros(many)  # Σ g_i dq_i/dr, the part of ∂H/∂r that the contacts make
        for stop in system.stops:
            overlap = np.maximum(stop.sign * q[:, stop.index] - stop.clearance, 0.0)
            by_contact += stop.sign * stop.force(overlap) * direction[:, stop.index]
        weight = (radius / most) ** (2 * n - 2) * radius / (radius + by_contact)
        accepted: Flags = stream.random(many) < weight
        states.append(np.hstack([q, p])[accepted])
        proposed, wanted = proposed + many, wanted + int(np.count_nonzero(accepted))
        if proposed >= 2**18 and wanted < ACCEPTED * proposed:
            raise NotApplicable(
                f"the shell H = {energy:g} is so far within the contacts that no states are drawn"
                " from it; begin in a state"
            )
    chosen = np.concatenate(states)[:paths]
    return chosen[:, :n], chosen[:, n:]
