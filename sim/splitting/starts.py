"""States in which the paths of a repetition start, drawn from what a start says."""

import numpy as np

from fpk.arrays import Array
from fpk.linear import natural_modes
from fpk.start import Start
from fpk.system import System

Stream = np.random.Generator

MOST_DRAWS = 10_000
"""Rounds of rejection: energies far beyond a stiff stop accept one state in a thousand."""


def start_states(system: System, start: Start, paths: int, stream: Stream) -> Array:
    """Return states (paths, 2n) of displacements and momenta in which ``start`` begins.

    An energy H is microcanonical; modal energies have independent phases, uniform. The kind "noise"
    is not drawn here.
    """
    n = system.n
    if start.kind == "energy":
        return microcanonical(system, start.values["H"], paths, stream)
    if start.kind == "modal":
        energies = np.array([start.values[f"H{m + 1}"] for m in range(n)])
        shapes, omega = natural_modes(system)
        phase = 2.0 * np.pi * stream.random((paths, n))
        amplitude = np.sqrt(2.0 * energies)
        q = (amplitude / omega * np.cos(phase)) @ shapes.T
        p = (amplitude * np.sin(phase)) @ (system.mass[:, None] * shapes).T
        return np.hstack([q, p])
    return np.tile(np.concatenate(start.state(n)), (paths, 1))


def microcanonical(system: System, H: float, paths: int, stream: Stream) -> Array:
    """Return states (paths, 2n) uniform on the shell of the energy H, by rejection.

    Displacements have the density (H − V)^(n/2−1). For n >= 2 they are drawn from that of the
    springs alone, which is not less. For n = 1 V = H sin² θ with θ uniform, and the density of q
    to be met is dθ sin θ/V'(q), which is at most 1/√(2 k H).
    """
    n = system.n
    drawn = np.empty((0, 2 * n))
    if H == 0.0:
        return np.zeros((paths, 2 * n))
    # ½ qᵀ K q = |y|² with q = R y.
    R = np.sqrt(2.0) * np.linalg.inv(np.linalg.cholesky(system.stiffness_matrix)).T
    for _ in range(MOST_DRAWS):
        u = stream.standard_normal((paths, 2 * n))
        u *= np.sqrt(H) / np.linalg.norm(u, axis=1, keepdims=True)
        direction = stream.standard_normal((paths, n))
        direction /= np.linalg.norm(direction, axis=1, keepdims=True)
        if n == 1:
            q, accept = _one_mass(system, u[:, :1], H)
        else:
            q = u[:, :n] @ R.T
            kinetic = np.maximum(H - system.potential(q), 0.0)
            accept = (kinetic / (H - np.sum(u[:, :n] ** 2, axis=1))) ** (0.5 * n - 1.0)
            accept = np.where(kinetic > 0.0, accept, 0.0)
        chosen = stream.random(paths) < accept
        q, kinetic = q[chosen], np.maximum(H - system.potential(q[chosen]), 0.0)
        p = np.sqrt(2.0 * kinetic)[:, None] * direction[chosen] * np.sqrt(system.mass)
        drawn = np.vstack([drawn, np.hstack([q, p])])
        if len(drawn) >= paths:
            return drawn[:paths]
    raise RuntimeError(f"no states were found on the shell of the energy {H:g}")


def _one_mass(system: System, u: Array, H: float) -> tuple[Array, Array]:
    """Displacements with V(q) = u² on the side of u, and with what probability they are taken."""
    k, V = float(system.stiffness[0]), u[:, 0] ** 2
    low, high = np.zeros(len(u)), np.sqrt(2.0 * V / k)
    side = np.sign(u[:, 0])
    for _ in range(60):
        q = 0.5 * (low + high)
        above = system.potential((side * q)[:, None]) > V
        low, high = np.where(above, low, q), np.where(above, q, high)
    q = side * low
    slope = k * low + sum(
        np.asarray(s.force(np.maximum(s.sign * q - s.clearance, 0.0))) for s in system.stops
    )
    safe = np.where(slope > 0.0, slope, 1.0)
    return q[:, None], np.where(slope > 0.0, np.sqrt(2.0 * k * V) / safe, 1.0)
