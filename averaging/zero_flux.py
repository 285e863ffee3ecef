"""Densities of energies with their certificates; of one energy by zero flux, (11)."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from fpk.arrays import EPS, Array
from fpk.certificate import Measured
from fpk.density import Density, certified_density
from fpk.line.stationary import StationarySolution
from fpk.observable import Observable
from fpk.plane.solution import PlaneSolution
from fpk.process import Coefficients, Process, log_density_slope_error
from fpk.quadrature import panel_rule

POINTS = (16, 20)
"""Gauss points per panel of ∫2s/σ² dH, and of the finer rule whose distance is its error."""
ROUND_OFF = 16.0 * EPS
"""Round-off of a logarithm of p or of σ², relative to 1 + |ln|, of some dozens of operations."""


@dataclass(frozen=True, eq=False)
class ZeroFluxDensity:
    """p = T u of a process of one energy from ln u, as (11) gives it; 0 beyond the nodes.

    ``nodes`` are energies to the last one, between which p is smooth. ``log_u`` and
    ``relative_error``, that of u, take energies > 0 of any shape. ``measured`` is what was measured
    on p.
    """

    process: Process
    nodes: Array
    log_u: Callable[[Array], Array]
    relative_error: Callable[[Array], Array]
    measured: Measured

    @property
    def panels(self) -> Array:
        """The nodes: between them u is smooth, and T but for layers above contact energies."""
        return self.nodes

    @property
    def l1_error(self) -> float:
        """Estimate of ∫|p_h − p|."""
        return self.measured.l1_error

    def log_density(self, energy: Array) -> Array:
        """ln p at energies of any shape, −∞ outside the nodes."""
        energy = np.asarray(energy, dtype=float)
        safe, positive = self.process.on_mesh(energy, float(self.nodes[-1]))
        log_states = self.process.coefficients(safe.ravel()).log_density_of_states
        log_p = self.log_u(safe) + log_states.reshape(safe.shape)
        return np.where(positive, log_p, -np.inf)

    def density(self, energy: Array) -> Array:
        """p at energies of any shape."""
        return np.asarray(np.exp(self.log_density(energy)))

    def pointwise_error(self, energy: Array) -> Array:
        """Estimate of the error of p at energies of any shape, but for that of T."""
        safe, _ = self.process.on_mesh(energy, float(self.nodes[-1]))
        return self.relative_error(safe) * self.density(energy)

    def phase_space_density(self, energy: Array) -> Array:
        """u = p/T at energies of any shape, T as the process gives it."""
        safe, _ = self.process.on_mesh(energy, float(self.nodes[-1]))
        return np.where(np.asarray(energy) <= self.nodes[-1], np.exp(self.log_u(safe)), 0.0)

    def phase_space_error(self, energy: Array) -> Array:
        """Estimate of the error of u at energies of any shape."""
        safe, _ = self.process.on_mesh(energy, float(self.nodes[-1]))
        return self.relative_error(safe) * self.phase_space_density(energy)


def flux_residual(process: Process, nodes: Array, log_density: Callable[[Array], Array]) -> float:
    """Return how far ln p is from zero flux, d ln(σ² p) = 2s/σ² dH, on the panels of ``nodes``.

    The largest |Δ ln(σ² p) − ∫2s/σ² dH| of a panel beyond what the stated errors of s and σ² and
    those of the integral explain, relative to ∫2(|s_damping| + |s_noise|)/σ² dH. ``nodes`` are
    energies >= 0 between which the coefficients are smooth; n/H, the singular part of 2s/σ² at
    H = 0, is integrated in closed form.
    """
    inner = nodes[nodes > 0.0]
    n = process.degrees_of_freedom
    integrals = []
    for points in POINTS:
        x, w = panel_rule(inner, points)
        c = Coefficients(*(a.reshape(x.shape) for a in process.coefficients(x.ravel())))
        integrals.append(np.sum(w * (2.0 * c.drift / c.diffusion - n / x), axis=1))
    parts = 2.0 * (np.abs(c.dissipation) + np.abs(c.drift - c.dissipation)) / c.diffusion
    at_nodes = process.coefficients(inner)
    log_flux = np.log(at_nodes.diffusion) + log_density(inner)
    defect = np.abs(np.diff(log_flux - n * np.log(inner)) - integrals[1])
    allowed = np.abs(integrals[1] - integrals[0]) + np.sum(w * log_density_slope_error(c), axis=1)
    ends = 2.0 * at_nodes.relative_error + ROUND_OFF * (1.0 + np.abs(log_flux))
    allowed += ends[1:] + ends[:-1]
    return float(np.max(np.maximum(defect - allowed, 0.0) / np.sum(w * parts, axis=1)))


def density_of_energies(
    observable: Observable,
    solution: StationarySolution | ZeroFluxDensity | PlaneSolution,
    panels: tuple[Array, ...],
    relative_error: Callable[..., Array],
    *,
    tol: float,
    added: bool,
) -> Density:
    """Return the density of one or two energies that ``solution`` gives, with its certificate.

    ``relative_error`` returns at energies the relative error of p by that of the density of states
    or of the modes, which the solver does not know of; ``added`` says that it counts in L1, too.
    """

    def of_model(p: Array, *energies: Array) -> Array:
        return np.asarray(relative_error(*energies) * np.abs(p))

    def pointwise(*energies: Array) -> Array:
        p = solution.density(*energies)
        # Beyond the last energy, where p is 0, the error is what was dropped: less than at the end.
        within = [np.minimum(H, x[-1]) for H, x in zip(energies, panels, strict=True)]
        dropped = np.abs(solution.density(*within) - p)
        error = np.abs(solution.pointwise_error(*energies)) + of_model(p, *energies) + dropped
        return np.where(np.min(np.broadcast_arrays(*energies), axis=0) >= 0.0, error, 0.0)

    return certified_density(
        observable,
        panels,
        solution.density,
        pointwise,
        measured=solution.measured,
        tol=tol,
        added_error=of_model if added else None,
    )
