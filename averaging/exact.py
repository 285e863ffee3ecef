"""The exact stationary solution (7), (22), where damping and noise are in proportion (8)."""

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
import scipy  # its parts are loaded at their first use: scipy.integrate takes long to import
from numpy.typing import NDArray

from averaging.back_transformation import POINTS, back_transformed
from averaging.conditional import conditionals
from averaging.energy_density import EnergyDensity, gibbs
from averaging.energy_process import energy_process
from averaging.hidden import DEPTH, HiddenIntegral
from averaging.nonintegrable import energy_only_refusal
from averaging.polynomial_rate import density_of_rate
from averaging.shell.energy_shell import energy_shell
from fpk.errors import NotApplicable
from fpk.method import Method, Plan, Progress, Result, check_solver
from fpk.observable import Observable
from fpk.route import ROUTES, Route, register
from fpk.system import System

Array = NDArray[np.float64]

PROPORTION_SLACK = 1e-12
"""Relative departure from 2 c = h b that counts as round-off of the input."""
ROUND_OFF = 2e-15
"""Relative error of a sum of thousands of positive terms."""
CUBATURE_TOLERANCE = 1e-8
"""Relative tolerance of the norm for three or more contact masses: a second or so."""


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
    parts: dict[Any, Array] = defaultdict(lambda: np.zeros((system.n, system.n)))
    parts[(), (), 0] += system.damping
    for t in system.damping_terms:
        parts[t.q, t.v, t.energy][t.row, t.column] += t.coefficient
    # c_ij(q) = −c_ji(q) does no work and leaves a density of H alone; with v in it, it does not.
    if any(v or (q and np.any(c + c.T)) for (q, v, _), c in parts.items()):
        raise NotApplicable(
            "the compatibility condition (8) is not met: the damping depends on q or v beside H"
        )
    matrices = np.zeros((1 + max(power for _, _, power in parts), system.n, system.n))
    for (q, _, power), c in parts.items():
        if not q:
            matrices[power] = 0.5 * (c + c.T)
    return matrices


@dataclass(frozen=True)
class Exact(Method):
    """Exact stationary density C exp(−∫h dH) of the full system, Eqs. (7), (22), (23).

    It exists where (8) holds; with constant damping h is a constant, and the normalisation the
    configuration integral over the contact masses; otherwise it is an integral over the shells.
    ``tol`` is the L1 tolerance that the answers are judged by.
    """

    tol: float = 1e-10

    def __post_init__(self) -> None:
        """Refuse a tolerance that double precision cannot meet."""
        check_solver("closed-form", ("closed-form",), self.tol)

    @property
    def route(self) -> Route:
        """The route that the method follows."""
        return ROUTES["exact", "closed-form"]

    def prepare(self, system: System) -> Plan:
        """Return the plan for ``system``; raise ``NotApplicable`` where (8) does not hold."""
        h = compatibility(system)
        energy_process(system)
        settings: dict[str, str | float | int] = {"equation": "(7), (22)", "h": float(h[0])}
        for power, coefficient in enumerate(h[1:], start=1):
            settings[f"h, H^{power}"] = float(coefficient)

        def solve(observables: Sequence[Observable], progress: Progress) -> Result:
            source = exact_energy_density(system)
            densities = tuple(back_transformed(source, o, tol=self.tol) for o in observables)
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
        return density_of_rate(system, process, rate)
    h = float(rate[0])
    log_integral, error = _log_configuration_integral(system, h)
    # Momenta give Π √(2π m_i/h), the displacements without contact (2π/h)^½ each over √det K_ff.
    log_norm = -0.5 * float(np.sum(np.log(2.0 * np.pi * system.mass / h))) - log_integral
    # u solves the full equation where (8) holds: what is left of it is the residual.
    D = system.noise_matrix
    left = float(np.max(np.abs(_by_energy(system)[0] - h * D)) / np.max(np.abs(h * D)))
    return gibbs(
        system,
        process,
        h,
        log_norm,
        error=error,
        residual=left,
    )


def _log_configuration_integral(system: System, h: float) -> tuple[float, float]:
    """Return ln ∫exp(−h V) dq over all displacements, and its relative error."""
    laws = conditionals(system, system.contact_masses)
    # The masses without contact leave (2π/h)^½ each over √det K_ff, det K_ff = det K / det K_red.
    constant = 0.5 * (system.n - len(laws)) * np.log(2.0 * np.pi / h)
    constant -= 0.5 * float(np.sum(np.log(system.stiffness)))
    if len(laws) > 2:
        integral, error = _whitened_cubature(system, h)
        return constant + np.log(integral), error / integral
    constant += 0.5 * float(np.sum(np.log([law.precision for law in laws])))
    hidden = HiddenIntegral(laws, 1.0 / h, DEPTH / h)
    coarse, fine = (
        float(hidden(lambda V: np.exp(-h * V), np.zeros(1), np.zeros((0, 1)), points=points)[0])
        for points in POINTS[len(laws)]
    )
    return constant + float(np.log(fine)), abs(coarse / fine - 1.0) + ROUND_OFF


def _whitened_cubature(system: System, h: float) -> tuple[float, float]:
    """Return ∫exp(−h V_red) dy and its error, where V_red >= ½|y|²: one scale in all directions."""
    shell = energy_shell(system)
    reach = np.full(shell.count, np.sqrt(2.0 * DEPTH / h))

    def weight(y: Array) -> Array:
        return np.asarray(np.exp(-h * shell.potential(y)))

    # A rule of few points in a wide box can miss where the weight is: it has 15 along each axis.
    result = scipy.integrate.cubature(weight, -reach, reach, rtol=CUBATURE_TOLERANCE, rule="gk15")
    return float(result.estimate), float(result.error)


register(
    Route("exact", "closed-form", "exact", "(7)", "full", False, "#2878b5", make=Exact),
)
