"""The exact stationary solution (7), (22), where damping and noise are in proportion (8)."""

from collections.abc import Sequence
from dataclasses import dataclass
from time import perf_counter
from typing import Self

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import cubature

from averaging.back_transformation import back_transformed, displacement_panels
from averaging.energy_density import EnergyDensity, gibbs
from averaging.energy_process import energy_process
from averaging.nonintegrable import energy_only_refusal
from averaging.shell.reduced import reduced_potential
from fpk.errors import NotApplicable
from fpk.method import Progress, Result, require_applicable, silent
from fpk.observable import Observable
from fpk.quadrature import panel_rule
from fpk.system import System

Array = NDArray[np.float64]

PROPORTION_SLACK = 1e-12
"""Relative departure from 2 c = h b that counts as round-off of the input."""


def compatibility(system: System) -> float:
    """Return h of the compatibility condition (8), ``2 c_ij = h b_ij`` with ``b = 2 f D fᵀ``.

    The antisymmetric part of c does no work and does not enter. Raises ``NotApplicable`` where no
    h meets the condition, or h is not positive.
    """
    if system.damping_terms:
        raise NotApplicable("damping that depends on the state is not averaged yet")
    c = 0.5 * (system.damping + system.damping.T)
    D = system.noise_matrix
    if not np.any(D):
        raise NotApplicable("condition (8) needs noise, and there is none")
    h = float(np.sum(c * D) / np.sum(D * D))
    worst = float(np.max(np.abs(c - h * D)) / max(np.max(np.abs(c)), np.finfo(float).tiny))
    if not np.any(c):
        raise NotApplicable("nothing is damped: (8) holds with h = 0 only, no stationary density")
    if h <= 0 or worst > PROPORTION_SLACK:
        raise NotApplicable(
            "the compatibility condition (8), c_ij = h (f D fᵀ)_ij for all i, j, is not met: "
            f"the best h = {h:.4g} leaves {worst:.2g} of the damping"
        )
    return h


@dataclass(frozen=True)
class Exact:
    """Exact stationary density C exp(−h H) of the full system, Eqs. (7), (22), (23).

    It exists where (8) holds; with constant damping h is a constant. The normalisation is the
    configuration integral over the contact masses and knows nothing of averaging.
    """

    @property
    def name(self) -> str:
        """The method's name on the command line."""
        return "exact"

    @property
    def solver(self) -> str:
        """How the method's equation is solved, on the command line."""
        return "closed-form"

    def refusal(self, system: System, observable: Observable) -> str | None:
        """Return why there is no exact density of ``observable``, or None where there is."""
        try:
            compatibility(system)
        except NotApplicable as reason:
            return str(reason)
        return energy_only_refusal(system, observable)

    def solve(
        self,
        system: System,
        observables: Sequence[Observable],
        *,
        progress: Progress = silent,
    ) -> Result:
        """Return the densities of ``observables``; raise ``NotApplicable`` where it refuses."""
        require_applicable(self, system, observables)
        start = perf_counter()
        source = exact_energy_density(system)
        densities = tuple(back_transformed(source, observable) for observable in observables)
        settings: dict[str, str | float | int] = {
            "equation": "(7), (22)",
            "h": compatibility(system),
        }
        return Result(self, densities, perf_counter() - start, settings=settings)

    def refined(self) -> Self:
        """Return itself: there is nothing to refine."""
        return self


def exact_energy_density(system: System) -> EnergyDensity:
    """Return u(H) = C exp(−h H) normalised by the configuration integral, Eqs. (7), (22)."""
    h = compatibility(system)
    process = energy_process(system)
    # The grid over the contact masses asks a density for its range; it does not need its norm.
    draft = gibbs(system, process, h, 0.0, error=0.0, provenance={})
    log_integral, error = _log_configuration_integral(draft, h)
    # Momenta give Π √(2π m_i/h), the displacements without contact (2π/h)^½ each over √det K_ff.
    log_norm = -0.5 * float(np.sum(np.log(2.0 * np.pi * system.mass / h))) - log_integral
    return gibbs(system, process, h, log_norm, error=error, provenance={"equation": "(7), (22)"})


def _log_configuration_integral(source: EnergyDensity, h: float) -> tuple[float, float]:
    """Return ln ∫exp(−h V) dq over all displacements, and its relative error."""
    system = source.system
    potential = reduced_potential(system)
    c = potential.count
    # The masses without contact leave (2π/h)^((n−c)/2)/√det K_ff; det K is the product of springs.
    constant = 0.5 * (system.n - c) * np.log(2.0 * np.pi / h)
    constant -= 0.5 * float(np.sum(np.log(system.stiffness)))
    inverse = np.linalg.inv(potential.L) if c else potential.L
    # Integrated over q itself: det(L) comes from det K_ff alone, √det K_ff = √(det K) det(L).
    log_det = -float(np.sum(np.log(np.diag(potential.L)))) if c else 0.0
    panels = [displacement_panels(source, i) for i in potential.masses]

    def weight(q: Array) -> Array:
        return np.asarray(np.exp(-h * potential(q @ inverse.T)))

    if c == 0:
        return constant, 0.0
    if c > 2:
        found = cubature(
            weight, [p[0] for p in panels], [p[-1] for p in panels], rtol=1e-8, rule="genz-malik"
        )
        return (
            constant + log_det + float(np.log(found.estimate)),
            float(found.error / found.estimate),
        )
    sums = []
    for points in (16, 20):
        grids = [panel_rule(p, points) for p in panels]
        mesh = np.meshgrid(*(x.ravel() for x, _ in grids), indexing="ij")
        total = weight(np.stack(mesh, axis=-1))
        for _, w in reversed(grids):
            total = total @ w.ravel()
        sums.append(float(total))
    return constant + log_det + float(np.log(sums[1])), abs(sums[0] / sums[1] - 1.0) + 1e-15
