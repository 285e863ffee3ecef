"""Stationary densities of the full state that depend on the energy only, ρ(q, p) = u(H(q, p))."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from averaging.energy_process import damping_and_noise
from averaging.shell.ratios import log_linear_states, shell_ratios
from averaging.zero_flux import flux_residual
from fpk.certificate import Measured
from fpk.line.mesh import DEEP_LAYERS, initial_nodes, with_layers
from fpk.probe import probed
from fpk.process import Process
from fpk.quadrature import panel_rule
from fpk.system import System

Array = NDArray[np.float64]
Part = Literal["value", "error", "table"]
"""Which number is asked of an integral of u(H): its value, the error that the error of u leaves in
it, or the error of the table in which it is interpolated."""

TAIL = 1e-17
"""Share of the probability beyond the last energy of a closed form."""
POINTS = (16, 20)
"""Gauss points per panel of the normalisation, and of the finer rule that estimates its error."""


class Weyl(Protocol):
    """Ψ_ν(E) = ∫_0^∞ u(E + x) x^(ν−1)/Γ(ν) dx, a Weyl integral; Ψ_0 is u itself.

    It is what is left of u when 2ν quadratic coordinates are integrated out, a factor
    (2π)^ν/√det aside.
    """

    def __call__(self, order: float, energy: Array, part: Part = "value") -> Array:
        """One part of Ψ for ν = ``order``, a multiple of ½, at energies of any shape."""
        ...


@dataclass(frozen=True, eq=False)
class EnergyDensity:
    """Phase-space density u(H) of a system and its integrals, with errors, Eqs. (22), (30).

    ``u`` and ``u_error`` take energies, ``weyl`` is what is left of them when integrated out.
    ``nodes`` are energies from 0 to the last one of a mesh, between which u is smooth;
    ``temperature`` is an energy over which u falls by about 1/e. ``measured`` is what was measured
    on p(H); as integrating out cannot increase an L1 distance, its ``l1_error`` holds for all
    marginals but for the part "table" of ``weyl`` and their own quadratures. ``closed`` says that u
    is a closed form: p(H) = T u then has the error of T, too, which is none of the error of u.
    """

    system: System
    nodes: Array
    temperature: float
    u: Callable[[Array], Array]
    u_error: Callable[[Array], Array]
    weyl: Weyl
    measured: Measured
    closed: bool = False

    @property
    def l1_error(self) -> float:
        """Estimate of ∫|p_h − p| of the density of the energy."""
        return self.measured.l1_error

    def log_states(self, energy: Array) -> Array:
        """ln T(H) at energies of any shape, T the density of states of ``shell_ratios``."""
        flat = np.maximum(energy, np.finfo(float).tiny).ravel()
        return np.asarray(_log_states(self.system, flat).reshape(np.shape(energy)))

    def energy_pdf(self, energy: Array) -> Array:
        """p(H) = T(H) u(H); 0 below H = 0."""
        p = np.exp(self.log_states(energy)) * self.u(energy)
        return np.where(np.asarray(energy) >= 0.0, p, 0.0)

    def states_error(self, energy: Array) -> Array:
        """Error of p(H) by that of T at energies of any shape."""
        flat = np.maximum(energy, np.finfo(float).tiny).ravel()
        error = shell_ratios(self.system, flat).error.reshape(np.shape(energy))
        return np.asarray(error * self.energy_pdf(energy))


def gibbs(
    system: System,
    process: Process,
    inverse_temperature: float,
    log_norm: float,
    *,
    error: float,
    residual: float | None = None,
) -> EnergyDensity:
    """Return u = exp(log_norm − αH), the form of (22) and (29), α the inverse temperature.

    ``error`` is the relative error of the normalisation. ``residual`` is that of the equation which
    u solves; that of (24) is measured where none is given.
    """
    alpha = inverse_temperature
    log_density = log_density_of(system, lambda energy: log_norm - alpha * energy)
    nodes, measured = closed_form_measured(process, log_density, error=error, residual=residual)

    def weyl(order: float, energy: Array, part: Part = "value") -> Array:
        factor = {"value": 1.0, "error": error, "table": 0.0}[part]
        return np.asarray(factor * np.exp(log_norm - order * np.log(alpha) - alpha * energy))

    u, u_error = partial(weyl, 0.0), partial(weyl, 0.0, part="error")
    return EnergyDensity(system, nodes, 1.0 / alpha, u, u_error, weyl, measured, True)


def closed_form_measured(
    process: Process,
    log_density: Callable[[Array], Array],
    *,
    error: float,
    residual: float | None = None,
) -> tuple[Array, Measured]:
    """Return nodes for a closed form of ln p(H), and what is measured on it before its densities.

    ``error`` is the relative error of the norm. Mass and minimum are those of each density.
    """
    probe = probed(process)
    nodes = initial_nodes(probe, probe.extent(TAIL), process.nonsmooth)
    tail = probe.tail_bound(float(nodes[-1]), float(np.exp(log_density(nodes[-1:])[0])))
    if residual is None:
        residual = flux_residual(process, nodes, log_density)
    return nodes, Measured(error + 2.0 * tail, np.nan, np.nan, residual, tail)


def log_density_of(system: System, log_u: Callable[[Array], Array]) -> Callable[[Array], Array]:
    """Return ln p(H) = ln T + ln u as a function of energies > 0, (energies,)."""
    return lambda energy: _log_states(system, energy) + log_u(energy)


def _log_states(system: System, energy: Array) -> Array:
    """ln T(H) at energies > 0 (energies,)."""
    return log_linear_states(system, energy) + np.log(shell_ratios(system, energy).states)


def log_energy_norm(
    system: System, process: Process, decay: Callable[[Array], Array]
) -> tuple[float, float]:
    """Return −ln ∫T(H) exp(−decay) dH and its relative error, with T in full units.

    ``decay`` is αH for the C of (29).
    """
    probe = probed(process)
    nodes = initial_nodes(probe, probe.extent(TAIL), process.nonsmooth)
    if len(system.contact_masses) == 1:  # of more, an energy costs milliseconds and more
        nodes = with_layers(nodes, process.nonsmooth, count=DEEP_LAYERS)
    nodes = _graded_to_zero(nodes)

    def integral(points: int) -> tuple[float, float]:
        x, w = panel_rule(nodes, points)
        energy = x.ravel()
        ratios = shell_ratios(system, energy)
        exponent = log_linear_states(system, energy) - decay(energy)
        top = float(exponent.max())
        terms = w.ravel() * ratios.states * np.exp(exponent - top)
        return top + float(np.log(terms.sum())), float(terms @ ratios.error / terms.sum())

    coarse, _ = integral(POINTS[0])
    fine, quadrature = integral(POINTS[1])
    return -fine, abs(fine - coarse) + quadrature + 4.0 * np.finfo(float).eps * abs(fine)


def averaged_closed_form(system: System, process: Process) -> EnergyDensity:
    """Return p(H) = C T(H) exp(−αH), α = Σ(c_ii/m_i)/Σ(D_ii/m_i): (29) for any n and masses.

    The printed (29) holds for two unit masses.
    """
    damping, noise = damping_and_noise(system)
    alpha = damping / noise
    log_norm, error = log_energy_norm(system, process, lambda energy: alpha * energy)
    return gibbs(system, process, alpha, log_norm, error=error)


def _graded_to_zero(nodes: Array) -> Array:
    """Add layers above H = 0, where T ~ H^(n−1) times a series in H^(1/4) without clearance."""
    return np.unique(np.concatenate([nodes, nodes[1] * 0.15 ** np.arange(1.0, 13.0)]))
