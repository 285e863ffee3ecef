"""Stochastic averaging of quasi-non-integrable Hamiltonian systems as a method, section 4."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Literal, Self, get_args

import numpy as np
from numpy.typing import NDArray

from averaging.back_transformation import back_transformed
from averaging.energy_density import EnergyDensity
from averaging.energy_process import energy_process
from averaging.polynomial_rate import averaged_density, averaged_rate
from averaging.quadrature import QuadratureSolution, solve_by_quadrature
from averaging.shell.ratios import log_linear_states
from averaging.tabulated import tabulated
from fpk.line.elements import Form
from fpk.line.stationary import StationarySolution, solve_stationary
from fpk.method import Method, Plan, Progress, Result, check_solver
from fpk.observable import Observable, observable_name
from fpk.process import Process
from fpk.route import ROUTES, Route, register
from fpk.system import System

Array = NDArray[np.float64]
Solver = Literal["fem", "quadrature", "closed-form"]


@dataclass(frozen=True)
class NonIntegrable(Method):
    """Averaged energy process (24)-(28), its stationary density and what follows from it, (30).

    ``solver``: "fem" solves the FPK equation of the process by finite elements, in the given
    ``form``; "quadrature" evaluates (11); "closed-form" is (29) in its general form, for damping
    that is constant or depends on the energy only. ``tol`` is the L1 tolerance. The theory is exact
    where the damping and noise meet (8), an approximation otherwise, and the better the more the
    contacts matter.
    """

    solver: Solver = "fem"
    form: Form = "flux"
    tol: float = 1e-10

    def __post_init__(self) -> None:
        """Refuse an unknown solver, or a tolerance that double precision cannot meet."""
        check_solver(self.solver, get_args(Solver), self.tol)

    @property
    def route(self) -> Route:
        """The route that the method follows."""
        return ROUTES["nonintegrable", self.solver]

    def prepare(self, system: System) -> Plan:
        """Return the plan for ``system``; raise ``NotApplicable`` where it does not hold."""
        energy_process(system)
        if self.solver == "closed-form":
            averaged_rate(system)

        def solve(observables: Sequence[Observable], progress: Progress) -> Result:
            source, settings = self._energy_density(system, energy_process(system))
            densities = tuple(back_transformed(source, o, tol=self.tol) for o in observables)
            return Result(self, densities, settings=settings)

        return Plan(lambda observable: energy_only_refusal(system, observable), solve)

    def refined(self) -> Self:
        """Return the method with a tolerance ten times smaller, down to 1e-12."""
        return replace(self, tol=max(0.1 * self.tol, 1e-12))

    def _energy_density(
        self, system: System, process: Process
    ) -> tuple[EnergyDensity, dict[str, str | float | int]]:
        if self.solver == "closed-form":
            return averaged_density(system, process), {"equation": "(29)"}
        if self.solver == "quadrature":
            by_quadrature = solve_by_quadrature(process, tol=self.tol)
            return _from_quadrature(system, by_quadrature), {
                "equation": "(11)",
                "panels": by_quadrature.nodes.size - 1,
                "last energy": float(by_quadrature.nodes[-1]),
                "tol": self.tol,
            }
        by_elements = solve_stationary(process, tol=self.tol, form=self.form)
        return _from_elements(system, by_elements), {
            "equation": "FPK of (24)",
            "form": self.form,
            "degree": by_elements.degree,
            "elements": by_elements.nodes.size - 1,
            "unknowns": by_elements.unknowns,
            "last energy": float(by_elements.nodes[-1]),
            "tol": self.tol,
        }


def energy_only_refusal(system: System, observable: Observable) -> str | None:
    """Return why ``observable`` does not follow from a density u(H), or None where it does."""
    kinds = {c.kind for c in observable}
    if "H" in kinds and (len(observable) > 1 or observable[0].index is not None):
        return (
            f"{observable_name(observable)}: this theory knows the total energy only; "
            "ask for H, q, p or pairs of q and p"
        )
    seen = {c.index for c in observable if c.kind == "q"}
    hidden = [i for i in system.contact_masses if i not in seen]
    if "H" not in kinds and len(hidden) > 2:
        return (
            f"{observable_name(observable)}: {len(hidden)} contact masses would have to be "
            "integrated out numerically, at most 2 are"
        )
    return None


def _from_elements(system: System, solution: StationarySolution) -> EnergyDensity:
    offset = _log_unit(system, solution.process)
    scale = np.exp(-offset)

    def u(energy: Array) -> Array:
        return np.asarray(scale * solution.phase_space_density(energy))

    def u_error(energy: Array) -> Array:
        return np.asarray(scale * solution.phase_space_error(energy))

    return tabulated(
        system,
        solution.process,
        solution.panels,
        u,
        u_error,
        measured=solution.measured,
    )


def _from_quadrature(system: System, solution: QuadratureSolution) -> EnergyDensity:
    process = solution.process
    offset = _log_unit(system, process)

    def u(energy: Array) -> Array:
        flat = np.maximum(np.asarray(energy, dtype=float), np.finfo(float).tiny).ravel()
        log_t = process.coefficients(flat).log_density_of_states.reshape(np.shape(energy))
        return np.asarray(np.exp(solution.log_density(energy) - log_t - offset))

    return tabulated(
        system,
        process,
        solution.nodes,
        u,
        lambda energy: solution.log_error(energy) * u(energy),
        measured=solution.measured,
    )


def _log_unit(system: System, process: Process) -> float:
    """ln of the density of states in full units over that of the process, a constant.

    The process measures T in units of the chain without contacts at its energy scale.
    """
    scale = np.array([process.energy_scale])
    return float(log_linear_states(system, scale)[0])


for _solver, _words, _equation in (
    ("fem", "energy averaging, finite elements", "(24)"),
    ("closed-form", "energy averaging, closed form", "(29)"),
    ("quadrature", "energy averaging, quadrature", "(11)"),
):
    register(
        Route(
            "nonintegrable",
            _solver,
            _words,
            _equation,
            "averaged",
            False,
            "#d1603d",
            make=partial(NonIntegrable, solver=_solver),  # type: ignore[arg-type]
        )
    )
