"""Diffusion processes of one or several energies: the input of FPK solvers and samplers."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from fpk.numeric.arrays import SMALLEST, Array, Flags

ZERO_ENERGY = 1e-250
"""Energy at which coefficients for H = 0 are evaluated, in units of the last energy of a mesh:
shell integrals underflow below 1e-300."""
UNKNOWN: Array = np.array(np.nan)
"""Default of a coefficient that a process does not give: NaN, as is all that follows from it."""


class Coefficients(NamedTuple):
    """Coefficients of the Ito equation ``dH_i = s_i dt + σ_ij dB_j`` at given energies.

    For one energy every array has the shape of the energies. For d energies (points, d) the
    ``drift`` s and the ``divergence`` Σ_j ∂b_ij/∂H_j are (points, d), and the ``diffusion``
    b = σσᵀ, the full symmetric matrix, is (points, d, d). The ½ stays in the FPK equation.
    ``dissipation`` is the part of the drift due to damping and ``log_density_of_states`` is ln T up
    to a constant: ``s = dissipation + ½ (b T)'/T``. ``relative_error`` estimates the quadrature
    errors of all but b'. It is relative to each coefficient, but for the drift to the sum of the
    sizes of its two parts, which may cancel. With several energies it is NaN, as is ln T.
    """

    drift: Array
    diffusion: Array
    divergence: Array
    dissipation: Array = UNKNOWN
    log_density_of_states: Array = UNKNOWN
    relative_error: Array = UNKNOWN


@dataclass(frozen=True)
class Process:
    """Ito diffusion process of d energies H_i in (0, ∞), Eqs. (9), (17), (19), (24).

    ``coefficients`` takes energies > 0, an array of any shape for one energy and (points, d) for
    more. ``energy_scales`` (d,) are of the order of the mean energies; meshes start from them.
    ``nonsmooth`` are the ascending energies at which the coefficients of one energy lose smoothness
    because contact begins; ``degrees_of_freedom`` is n in T ~ H^(n−1) for H → 0.
    ``state_damping``: 2 dissipation/diffusion varies with H, so that the errors of the coefficients
    add up in ln p, and p may have its maximum anywhere. Row i of b vanishes at H_i = 0, which takes
    no boundary condition.
    """

    coefficients: Callable[[Array], Coefficients]
    energy_scales: tuple[float, ...]
    nonsmooth: tuple[float, ...] = ()
    degrees_of_freedom: int = 1
    state_damping: bool = False

    def at(self, energies: Array) -> Coefficients:
        """Return drift (points, d), diffusion (points, d, d), divergence (points, d) and the
        relative error at ``energies`` (points, d), also if d = 1: the other fields are NaN then."""
        if self.dimension > 1:
            return self.coefficients(energies)
        c = self.coefficients(energies[:, 0])
        s, b, divergence = c.drift[:, None], c.diffusion[:, None, None], c.divergence[:, None]
        return Coefficients(s, b, divergence, relative_error=c.relative_error)

    def on_mesh(self, energy: Array, last: float) -> tuple[Array, Flags]:
        """Return ``energy``, of any shape, clipped to (0, ``last``], and flags that p is not 0. The
        density p is 0 outside [0, ``last``], and at H = 0 for several degrees of freedom."""
        least = max(ZERO_ENERGY * last, SMALLEST)
        above = energy >= 0.0 if self.degrees_of_freedom == 1 else energy > 0.0
        return np.clip(energy, least, last), above & (energy <= last)

    @property
    def dimension(self) -> int:
        """Number of energies, d."""
        return len(self.energy_scales)

    @property
    def energy_scale(self) -> float:
        """Scale of the only energy; ``ValueError`` if there are several."""
        (scale,) = self.energy_scales
        return scale


def log_density_slope_error(c: Coefficients) -> Array:
    """Return the error of 2s/b, in its shape, that ``c.relative_error`` causes, for one energy."""
    parts = np.abs(c.dissipation) + np.abs(c.drift - c.dissipation)
    return np.asarray(2.0 * c.relative_error * parts / c.diffusion)


def log_density_slope(c: Coefficients) -> Array:
    """Return d ln p/dH = (2 s − b')/b of the density of zero flux of one energy, from (11)."""
    return np.asarray((2.0 * c.drift - c.divergence) / c.diffusion)
