"""Natural modes of the chain without its contacts, Eq. (13)."""

import numpy as np

from fpk.arrays import Array
from fpk.system import System


def natural_modes(system: System) -> tuple[Array, Array]:
    """Return the shapes T (n, n), one mode a column, and ω (n,) of K T = M T ω², ω ascending.

    Shapes are normalised to Tᵀ M T = 1 and ω is in radians per time, so that with ``q = T Q`` and
    ``P = Tᵀ p`` a mode has the energy ``H_m = ½ (P_m² + ω_m² Q_m²)``, and ``Q = Tᵀ M q``. The
    H_m of a chain without contacts add up to H; what is stored in contacts is in none of them.
    Their signs are arbitrary.

    With K = Gᵀ G, row i of G being √k_i (q_i − q_{i−1}), ω are the singular values of G M^(−1/2):
    none is lost where an eigenvalue of K would be, in the round-off of the largest one.
    """
    roots, springs = np.sqrt(system.mass), np.sqrt(system.stiffness)
    G = np.diag(springs) - np.diag(springs[1:], -1)
    _, omega, transposed = np.linalg.svd(G / roots)
    shapes = (transposed[::-1] / roots).T
    return np.ascontiguousarray(shapes), np.ascontiguousarray(omega[::-1])
