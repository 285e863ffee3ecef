"""Stationary densities of the full state that depend on the energy only, ρ(q, p) = u(H(q, p))."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from averaging.energy_process import energy_balance
from averaging.shell.ratios import EnergyShell, energy_shell, log_linear_states, shell_ratios
from fpk.certificate import Certificate
from fpk.line.mesh import DEEP_LAYERS, initial_nodes, with_layers
from fpk.probe import probed
from fpk.process import Process
from fpk.quadrature import panel_rule
from fpk.system import System

Array = NDArray[np.float64]
Provenance = Mapping[str, str | float | int]

TAIL = 1e-17
"""Share of the probability beyond the last energy of a closed form."""
POINTS = (16, 20)
"""Gauss points per panel of the normalisation, and of the finer rule that estimates its error."""


@dataclass(frozen=True, eq=False)
class EnergyDensity:
    """Phase-space density u(H) of a system and its integrals, with errors, Eqs. (22), (30).

    ``u`` and ``u_error`` take energies. ``weyl(ν, E)`` is ∫_0^∞ u(E + x) x^(ν−1)/Γ(ν) dx, what is
    left of u when 2ν quadratic coordinates are integrated out (a factor (2π)^ν/√det aside), and
    ``weyl_error`` its error; ``nodes`` are energies from 0 to the last one kept, between which u is
    smooth; ``temperature`` an energy over which u falls by about 1/e. ``l1_error`` holds for p(H)
    and, as integrating out cannot increase an L1 distance, for all marginals.
    """

    system: System
    shell: EnergyShell
    nodes: Array
    temperature: float
    u: Callable[[Array], Array]
    u_error: Callable[[Array], Array]
    weyl: Callable[[float, Array], Array]
    weyl_error: Callable[[float, Array], Array]
    l1_error: float
    certificate: Certificate
    provenance: Provenance = field(default_factory=dict)

    def log_states(self, energy: Array) -> Array:
        """ln T(H) at energies > 0 of any shape, T the density of states of ``shell_ratios``."""
        flat = np.maximum(energy, np.finfo(float).tiny).ravel()
        log_t = log_linear_states(self.system, flat) + np.log(shell_ratios(self.shell, flat).states)
        return np.asarray(log_t.reshape(np.shape(energy)))

    def energy_pdf(self, energy: Array) -> Array:
        """p(H) = T(H) u(H); 0 below H = 0."""
        p = np.exp(self.log_states(energy)) * self.u(energy)
        return np.where(np.asarray(energy) >= 0.0, p, 0.0)


def gibbs(
    system: System,
    process: Process,
    inverse_temperature: float,
    log_norm: float,
    *,
    error: float,
    provenance: Provenance,
) -> EnergyDensity:
    """Return u = exp(log_norm − αH), the form of (22) and (29), α the inverse temperature.

    ``error`` is the relative error of the normalisation.
    """
    alpha = inverse_temperature
    probe = probed(process)
    nodes = initial_nodes(probe, probe.extent(TAIL), process.nonsmooth)

    def u(energy: Array) -> Array:
        return np.asarray(np.exp(log_norm - alpha * energy))

    def weyl(order: float, energy: Array) -> Array:
        return np.asarray(np.exp(log_norm - order * np.log(alpha) - alpha * energy))

    return EnergyDensity(
        system=system,
        shell=energy_shell(system),
        nodes=nodes,
        temperature=1.0 / alpha,
        u=u,
        u_error=lambda energy: error * u(energy),
        weyl=weyl,
        weyl_error=lambda order, energy: error * weyl(order, energy),
        l1_error=error + TAIL,
        certificate=Certificate(mass_defect=error, minimum=0.0, residual=0.0, tail_mass=TAIL),
        provenance=provenance,
    )


def log_energy_norm(
    system: System, process: Process, decay: Callable[[Array], Array]
) -> tuple[float, float]:
    """Return −ln ∫T(H) exp(−decay) dH and its relative error, with T in full units.

    ``decay`` is αH for the C of (29).
    """
    shell = energy_shell(system)
    probe = probed(process)
    nodes = initial_nodes(probe, probe.extent(TAIL), process.nonsmooth)
    if shell.potential.count == 1:  # of more, an energy costs milliseconds and more
        nodes = with_layers(nodes, process.nonsmooth, count=DEEP_LAYERS)
    nodes = _graded_to_zero(nodes)

    def integral(points: int) -> tuple[float, float]:
        x, w = panel_rule(nodes, points)
        energy = x.ravel()
        ratios = shell_ratios(shell, energy)
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
    alpha = energy_balance(system).inverse_temperature
    log_norm, error = log_energy_norm(system, process, lambda energy: alpha * energy)
    return gibbs(system, process, alpha, log_norm, error=error, provenance={"equation": "(29)"})


def _graded_to_zero(nodes: Array) -> Array:
    """Add layers above H = 0, where T ~ H^(n−1) times a series in H^(1/4) without clearance."""
    return np.unique(np.concatenate([nodes, nodes[1] * 0.15 ** np.arange(1.0, 13.0)]))
