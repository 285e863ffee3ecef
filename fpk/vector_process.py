"""Diffusion processes of several energies: what the two-dimensional solver and sampling get."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class VectorProcess:
    """Diffusion process of d energies H_i >= 0, Ito, Eqs. (17), (19).

    The functions take energies (points, d). ``drift`` returns s (points, d), ``diffusion`` the full
    symmetric b = σσᵀ (points, d, d), the ½ staying in the FPK equation, ``diffusion_divergence``
    Σ_j ∂b_ij/∂H_j (points, d). ``energy_scales`` are energies of the order of each mean, from which
    meshes start. Row i of b vanishes at H_i = 0, which takes no boundary condition.
    """

    drift: Callable[[Array], Array]
    diffusion: Callable[[Array], Array]
    diffusion_divergence: Callable[[Array], Array]
    energy_scales: tuple[float, ...]

    @property
    def dimension(self) -> int:
        """Number of energies, d."""
        return len(self.energy_scales)
