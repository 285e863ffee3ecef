"""Stationary densities of the full state that depend on the energy only, ρ(q, p) = u(H(q, p))."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from averaging.shell.ratios import log_linear_states, shell_ratios
from fpk.certificate import Measured
from fpk.system import System

Array = NDArray[np.float64]
Part = Literal["value", "error", "table"]
"""Which number is asked of an integral of u(H): its value, the error that the error of u leaves in
it, or the error of the table in which it is interpolated."""


Weyl = Callable[..., Array]
"""Ψ_ν(E) = ∫_0^∞ u(E + x) x^(ν−1)/Γ(ν) dx of (ν, energies, part): a Weyl integral.

It is what is left of u when 2ν quadratic coordinates are integrated out, a factor (2π)^ν/√det
aside; Ψ_0 is u, and ``part`` is "value" when left out."""


@dataclass(frozen=True, eq=False)
class EnergyDensity:
    """Phase-space density u(H) of a system and its integrals, with errors, Eqs. (22), (30).

    ``u`` and ``u_error`` take energies, ``weyl`` is what is left of them when integrated out.
    ``nodes`` are energies from 0 to the last one of a mesh, between which u is smooth;
    ``temperature`` is an energy over which u falls by about 1/e. ``measured`` is what was measured
    on p(H); as integrating out cannot increase an L1 distance, its ``l1_error`` holds for all
    marginals but for the part "table" of ``weyl`` and their own quadratures. ``closed`` says that u
    is a closed form: p(H) = T u then has the error of T, too, which is none of the error of u.
    ``gibbs`` says that it is C exp(−H/temperature).
    """

    system: System
    nodes: Array
    temperature: float
    u: Callable[[Array], Array]
    u_error: Callable[[Array], Array]
    weyl: Weyl
    measured: Measured
    closed: bool = False
    gibbs: bool = False

    @property
    def l1_error(self) -> float:
        """Estimate of ∫|p_h − p| of the density of the energy."""
        return self.measured.l1_error

    def log_states(self, energy: Array) -> Array:
        """ln T(H) at energies of any shape, T the density of states of ``shell_ratios``."""
        flat = np.maximum(energy, np.finfo(float).tiny).ravel()
        value = log_linear_states(self.system, flat)
        value += np.log(shell_ratios(self.system, flat).states)
        return np.asarray(value.reshape(np.shape(energy)))

    def energy_pdf(self, energy: Array) -> Array:
        """p(H) = T(H) u(H); 0 below H = 0."""
        p = np.exp(self.log_states(energy)) * self.u(energy)
        return np.where(np.asarray(energy) >= 0.0, p, 0.0)

    def states_error(self, energy: Array) -> Array:
        """Error of p(H) by that of T at energies of any shape."""
        flat = np.maximum(energy, np.finfo(float).tiny).ravel()
        error = shell_ratios(self.system, flat).error.reshape(np.shape(energy))
        return np.asarray(error * self.energy_pdf(energy))
