"""Diffusion processes of one energy: the coefficients that the FPK solvers get to see."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Coefficients(NamedTuple):
    """Coefficients of ``dH = s dt + √b dB`` at some energies, each array of the energies' shape.

    ``drift`` s and ``diffusion`` b = σ² (the ½ stays in the FPK equation), ``diffusion_slope``
    b'. ``dissipation`` is the part of the drift that damping causes and ``log_density_of_states``
    is ln T up to a constant, so that ``s = dissipation + ½ (b T)'/T``. ``relative_error``
    estimates the error of the quadratures behind all but b', relative to each; that of the drift is
    relative to the sum of the sizes of its two parts, which may cancel. ``slope_error`` is that of
    b', relative to the noise's part of the drift at least.
    """

    drift: Array
    diffusion: Array
    diffusion_slope: Array
    dissipation: Array
    log_density_of_states: Array
    relative_error: Array
    slope_error: Array


@dataclass(frozen=True)
class DiffusionProcess:
    """Diffusion process of one energy on (0, ∞), Ito, Eqs. (9) and (24).

    ``coefficients`` evaluates it at energies > 0; ``nonsmooth`` holds the energies, ascending,
    where the coefficients lose smoothness (where contact begins); ``energy_scale`` is an energy
    of the order of the mean, from which meshes start; ``degrees_of_freedom`` is n in T ~ H^(n−1)
    at H → 0. ``state_damping`` says that 2 dissipation/diffusion varies with H: the errors of the
    coefficients then add up in ln p, and p may have its maximum anywhere.
    """

    coefficients: Callable[[Array], Coefficients]
    energy_scale: float
    nonsmooth: tuple[float, ...]
    degrees_of_freedom: int
    state_damping: bool = False


def log_density_slope_error(c: Coefficients) -> Array:
    """Return a bound of the error of 2s/b from those of s and b, relative to the parts of s."""
    parts = np.abs(c.dissipation) + np.abs(c.drift - c.dissipation)
    return np.asarray(2.0 * c.relative_error * parts / c.diffusion)


def log_density_slope(c: Coefficients) -> Array:
    """Return d ln p/dH = (2 s − b')/b, the slope that zero flux demands, from (11)."""
    slope: Array = (2.0 * c.drift - c.diffusion_slope) / c.diffusion
    return slope
