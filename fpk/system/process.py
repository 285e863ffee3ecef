"""Diffusion processes of one or several energies: what the FPK solvers and samplers are given."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from fpk.numeric.arrays import SMALLEST, Array, Flags

ZERO_ENERGY = 1e-250
"""Energy, over the last of a mesh, that stands for H = 0: integrals underflow below 1e-300."""
UNKNOWN: Array = np.array(np.nan)
"""A coefficient that a process does not give: whatever is computed from it is not a number."""


class Coefficients(NamedTuple):
    """Coefficients of ``dH_i = s_i dt + σ_ij dB_j`` at some energies.

    Of one energy every array has the energies' shape; of d energies (points, d) the ``drift`` s and
    the ``divergence`` Σ_j ∂b_ij/∂H_j are (points, d) and the ``diffusion`` b = σσᵀ, the full
    symmetric matrix, is (points, d, d). The ½ stays in the FPK equation.
    ``dissipation`` is the part of the drift that damping causes and ``log_density_of_states``
    is ln T up to a constant, so that ``s = dissipation + ½ (b T)'/T``. ``relative_error``
    estimates the error of the quadratures behind all but b', relative to each; that of the drift is
    relative to the sum of the sizes of its two parts, which may cancel.
    """

    drift: Array
    diffusion: Array
    divergence: Array
    dissipation: Array = UNKNOWN
    log_density_of_states: Array = UNKNOWN
    relative_error: Array = UNKNOWN


@dataclass(frozen=True)
class Process:
    """Diffusion process of d energies H_i in (0, ∞), Ito, Eqs. (9), (17), (19), (24).

    ``coefficients`` evaluates it at energies > 0, an array of any shape for one energy and
    (points, d) for more. ``energy_scales`` (d,) are energies of the order of each mean, from which
    meshes start; ``nonsmooth`` holds the energies, ascending, where the coefficients of one energy
    lose smoothness (where contact begins); ``degrees_of_freedom`` is n in T ~ H^(n−1) at H → 0.
    ``state_damping`` says that 2 dissipation/diffusion varies with H: the errors of the
    coefficients then add up in ln p, and p may have its maximum anywhere. Row i of b vanishes at
    H_i = 0, which takes no boundary condition.
    """

    coefficients: Callable[[Array], Coefficients]
    energy_scales: tuple[float, ...]
    nonsmooth: tuple[float, ...] = ()
    degrees_of_freedom: int = 1
    state_damping: bool = False

    def at(self, energies: Array) -> Coefficients:
        """Return s, b, Σ_j ∂b_ij/∂H_j and their error at (points, d), of one energy, too."""
        if self.dimension > 1:
            return self.coefficients(energies)
        c = self.coefficients(energies[:, 0])
        s, b, divergence = c.drift[:, None], c.diffusion[:, None, None], c.divergence[:, None]
        return Coefficients(s, b, divergence, relative_error=c.relative_error)

    def on_mesh(self, energy: Array, last: float) -> tuple[Array, Flags]:
        """Return ``energy`` clipped between a hair above 0 and ``last``, and where p is not 0.

        p is 0 outside, and at H = 0 of several degrees of freedom.
        """
        least = max(ZERO_ENERGY * last, SMALLEST)
        above = energy >= 0.0 if self.degrees_of_freedom == 1 else energy > 0.0
        return np.clip(energy, least, last), above & (energy <= last)

    @property
    def dimension(self) -> int:
        """Number of energies, d."""
        return len(self.energy_scales)

    @property
    def energy_scale(self) -> float:
        """The scale of one energy."""
        (scale,) = self.energy_scales
        return scale


def log_density_slope_error(c: Coefficients) -> Array:
    """Return a bound of the error of 2s/b from those of s and b, relative to the parts of s."""
    parts = np.abs(c.dissipation) + np.abs(c.drift - c.dissipation)
    return np.asarray(2.0 * c.relative_error * parts / c.diffusion)


def log_density_slope(c: Coefficients) -> Array:
    """Return d ln p/dH = (2 s − b')/b, the slope that zero flux demands, from (11)."""
    return np.asarray((2.0 * c.drift - c.divergence) / c.diffusion)
