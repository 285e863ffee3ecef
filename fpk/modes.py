"""Natural modes of the chain without its contacts, Eq. (13)."""

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigh

from fpk.system import System

Array = NDArray[np.float64]


def natural_modes(system: System) -> tuple[Array, Array]:
    """Return the shapes T (n, n), one mode a column, and ω (n,) of K T = M T ω², ω ascending.

    Shapes are normalised to Tᵀ M T = 1 and ω is in radians per time, so that with ``q = T Q`` and
    ``P = Tᵀ p`` a mode has the energy ``H_m = ½ (P_m² + ω_m² Q_m²)``, and ``Q = Tᵀ M q``. The
    H_m of a chain without contacts add up to H; what is stored in contacts is in none of them.
    Their signs are arbitrary.
    """
    squares, shapes = eigh(system.stiffness_matrix, np.diag(system.mass))
    return np.asarray(shapes), np.asarray(np.sqrt(squares))
