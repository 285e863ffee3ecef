"""The exact stationary solution (7), (22), where damping and noise are in proportion (8)."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import cubature

from averaging.back_transformation import back_transformed, displacement_panels
from averaging.energy_density import EnergyDensity, gibbs
from averaging.energy_process import energy_process
from averaging.nonintegrable import energy_only_refusal
from averaging.polynomial_rate import density_of_rate
from averaging.shell.reduced import reduced_potential
from fpk.errors import NotApplicable
from fpk.method import Method, Plan, Progress, Result
from fpk.observable import Observable
from fpk.quadrature import panel_rule
from fpk.route import ROUTES, Route, register
from fpk.system import System

Array = NDArray[np.float64]

PROPORTION_SLACK = 1e-12
"""Relative departure from 2 c = h b that counts as round-off of the input."""


def compatibility(system: System) -> Array:
    """Return h(H) of the compatibility condition (8), ``2 c_ij = h b_ij`` with ``b = 2 f D fᵀ``.

    Coefficients in ascending powers of H, one for constant damping. The antisymmetric part of c
    does no work and does not enter, unless it depends on velocities. Raises ``NotApplicable``
    where no h meets the condition, or h is not positive at high energy.
    """
    D = system.noise_matrix
    if not np.any(D):
        raise NotApplicable("condition (8) needs noise, and there is none")
    matrices = _by_energy(system)
    if not np.any(matrices):
        raise NotApplicable("nothing is damped: (8) holds with h = 0 only, no stationary density")
    h: Array = np.einsum("eij,ij->e", matrices, D) / np.sum(D * D)
    sizes = np.maximum(np.max(np.abs(matrices), axis=(1, 2)), np.finfo(float).tiny)
    left = np.max(np.abs(matrices - h[:, None, None] * D), axis=(1, 2)) / sizes
    worst = float(left.max())
    h = np.asarray(np.trim_zeros(h, "b"), dtype=float)
    if not h.size or h[-1] <= 0 or worst > PROPORTION_SLACK:
        best = ", ".join(f"{part:.4g}" for part in h) or "0"
        raise NotApplicable(
            "the compatibility condition (8), c_ij = h (f D fᵀ)_ij for all i, j, is not met: "
            f"the best h = {best} leaves {worst:.2g} of the damping"
        )
    return h


def _by_energy(system: System) -> Array:
    """Symmetric damping matrices of each power of H, (powers, n, n), all else having to vanish."""
    constant = 0.5 * (system.damping + system.damping.T)
    terms = system.damping_terms
    matrices = np.zeros((1 + max((t.energy for t in terms), default=0), system.n, system.n))
    matrices[0] = constant
    others: dict[object, Array] = {}
    for t in terms:
        if t.q or t.v:
            key = (t.q, t.v, t.energy)
            entry = others.setdefault(key, np.zeros((system.n, system.n)))
            entry[t.row, t.column] += t.coefficient
        else:
            matrices[t.energy, t.row, t.column] += 0.5 * t.coefficient
            matrices[t.energy, t.column, t.row] += 0.5 * t.coefficient
    # c_ij(q) = −c_ji(q) does no work and leaves a density of H alone; with v in it, it does not.
    working = [k for k, m in others.items() if np.any(m + m.T)]
    turning = [t for t in terms if t.v]
    if working or turning:
        raise NotApplicable(
            "the compatibility condition (8) is not met: the damping depends on q or v beside H"
        )
    return matrices


@dataclass(frozen=True)
class Exact(Method):
    """Exact stationary density C exp(−∫h dH) of the full system, Eqs. (7), (22), (23).

    It exists where (8) holds; with constant damping h is a constant, and the normalisation the
    configuration integral over the contact masses; otherwise it is an integral over the shells.
    """

    @property
    def route(self) -> Route:
        """The route that the method follows."""
        return ROUTES["exact", "closed-form"]

    def prepare(self, system: System) -> Plan:
        """Return the plan for ``system``; raise ``NotApplicable`` where (8) does not hold."""
        h = compatibility(system)
        settings: dict[str, str | float | int] = {"equation": "(7), (22)", "h": float(h[0])}
        for power, coefficient in enumerate(h[1:], start=1):
            settings[f"h, H^{power}"] = float(coefficient)

        def solve(observables: Sequence[Observable], progress: Progress) -> Result:
            source = exact_energy_density(system)
            densities = tuple(back_transformed(source, observable) for observable in observables)
            return Result(self, densities, settings=settings)

        return Plan(lambda observable: energy_only_refusal(system, observable), solve)

    def refined(self) -> Self:
        """Return itself: there is nothing to refine."""
        return self


def exact_energy_density(system: System) -> EnergyDensity:
    """Return the normalised u(H) = C exp(−∫h dH), Eqs. (7), (22)."""
    rate = compatibility(system)
    process = energy_process(system)
    if rate.size > 1:
        return density_of_rate(system, process, rate, provenance={"equation": "(7)"})
    h = float(rate[0])
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


register(
    Route("exact", "closed-form", "exact", "(7)", "full", False, "#2878b5", make=Exact),
)
