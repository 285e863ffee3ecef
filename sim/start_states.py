"""States in which the trajectories of a stationary simulation start: at rest or near it."""

import numpy as np

from fpk.arrays import Array
from fpk.system import System
from sim.arrays import LANES
from sim.flow import factored
from sim.random import START, normals
from sim.step_size import temperature

PIECE = 64
"""Blocks whose starts are drawn together, beginning at its multiples."""


def start_states(system: System, seed: int, piece: int) -> Array:
    """Return the states (PIECE, 2n, LANES) in which the blocks from ``piece`` on start.

    They are q = 0 and momenta of the temperature (covariance kT M). With damping terms the
    displacements are drawn, too: on a limit cycle the noise alone mixes phases slowly.
    """
    n, kT = system.n, temperature(system)
    # A trajectory owns 2**40 words; so many lie before those of the piece's first one.
    words = START + ((piece * LANES) << 40)
    L = factored(np.diag((kT if np.isfinite(kT) else 0.0) * system.mass))
    # Of whole pieces: matrix products may round by the shape they come in.
    p = L @ normals(seed, PIECE * LANES, words, n)[: L.shape[1]]
    q = np.zeros_like(p)
    if system.damping_terms:
        q = start_displacements(system, kT, normals(seed, PIECE * LANES, words + n, n))
    return np.vstack([q, p]).reshape(2 * n, -1, LANES).transpose(1, 0, 2)


def start_displacements(system: System, kT: float, z: Array) -> Array:
    """Return displacements (n, paths) from standard normals ``z``: Gaussian by the springs at kT.

    Where a contact is reached they are shortened, by bisection, to the potential energy of the
    springs alone: no start is deeper in a stop than its energy allows.
    """
    # An inverse, not ``system.compliance``: its rounding is part of what a seed stands for.
    q = np.linalg.cholesky(kT * np.linalg.inv(system.stiffness_matrix)) @ z
    level = 0.5 * np.sum(q * (system.stiffness_matrix @ q), axis=0)
    low, high = np.zeros(q.shape[1]), np.ones(q.shape[1])
    for _ in range(40):
        middle = 0.5 * (low + high)
        above = system.potential((middle * q).T) > level
        low, high = np.where(above, low, middle), np.where(above, middle, high)
    return np.asarray(low * q)
