"""Stochastic averaging of quasi-integrable Hamiltonian systems as a method, sections 5 and 6.3."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Literal, Self, get_args

import numpy as np
from numpy.typing import NDArray

from averaging.gaussian import gaussian_density
from averaging.modal.analysis import ModalAnalysis, modal_analysis
from averaging.modal.blocks import unsolved
from averaging.modal.coupled import state_dependent_densities
from averaging.modal.energies import modal_energies, total_energy
from averaging.modal.internal import internal_refusal, resonance_order
from averaging.modal.numerical import by_elements, by_quadrature
from averaging.modal.resonance import nearest_resonance, resonance_refusal, strongest_pair
from fpk.clearance import CLEARANCE_RULE, stop_clearances
from fpk.density import Density
from fpk.errors import NotApplicable
from fpk.method import Method, Plan, Progress, Result, check_solver
from fpk.observable import Observable, observable_name
from fpk.route import ROUTES, Route, register
from fpk.system import System

Array = NDArray[np.float64]
Solver = Literal["closed-form", "fem", "quadrature"]
Settings = Mapping[str, str | float | int]

LEFT_OUT = "contacts left out"
"""Key under which settings and provenance say which contacts the theory does not know of."""


@dataclass(frozen=True)
class Integrable(Method):
    """Averaged modal energies (17), (33), their stationary density (34) and (35), (36).

    Contacts are left out: ``settings`` and provenance say so, with the rule clearance > 2 rms of
    section 6.3 evaluated. ``solver``: "closed-form" is (34), Π e^(−H_i/θ_i)/θ_i with the modal
    temperatures θ_i = d_i/c*_ii, whose back-transform is Gaussian; "quadrature" evaluates (11) and
    "fem" solves the FPK equation, for the modal energies alone, to the L1 tolerance ``tol``. The
    theory needs light damping and is refused where the modes are in a resonance that matters;
    without contacts it is exact where the damping and noise meet (8).

    Damping that depends on the state is averaged over the phases; it may couple the energies of
    two modes, which "fem" solves for together, and no more. Every solver then gives every
    observable: displacements and momenta by the characteristic function of the energies.
    """

    solver: Solver = "closed-form"
    tol: float = 1e-10

    def __post_init__(self) -> None:
        """Refuse an unknown solver, or a tolerance that double precision cannot meet."""
        check_solver(self.solver, get_args(Solver), self.tol)

    @property
    def route(self) -> Route:
        """The route that the method follows."""
        return ROUTES["integrable", self.solver]

    def prepare(self, system: System) -> Plan:
        """Return the plan for ``system``; raise ``NotApplicable`` where it does not hold."""
        modes = modal_analysis(system)
        reason = (
            resonance_refusal(modes)
            or internal_refusal(system, modes)
            or unsolved(modes, self.solver)
        )
        if reason:
            raise NotApplicable(reason)

        def solve(observables: Sequence[Observable], progress: Progress) -> Result:
            settings = {**self._equation(modes), **_validity(system, modes)}
            if modes.state is not None:
                densities = state_dependent_densities(
                    modes, observables, self.solver, tol=self.tol, provenance=settings
                )
            else:
                densities = tuple(self._density(modes, o, settings) for o in observables)
            neglected = str(settings.get(LEFT_OUT, ""))
            return Result(self, densities, settings=settings, neglected=neglected)

        return Plan(lambda observable: self._unknown(observable, modes), solve)

    def refined(self) -> Self:
        """Return the method with a tolerance ten times smaller, down to 1e-12."""
        return replace(self, tol=max(0.1 * self.tol, 1e-12))

    def _unknown(self, observable: Observable, modes: ModalAnalysis) -> str | None:
        """Why the solver does not give this observable."""
        name, kinds = observable_name(observable), [c.kind for c in observable]
        total = any(c.kind == "H" and c.index is None for c in observable)
        if len(set(kinds) - {"q", "p"}) and (total or set(kinds) != {"H"}) and len(kinds) > 1:
            return f"{name}: of two quantities, both must be modal energies, or q and p"
        linear = modes.state is None
        if linear and self.solver != "closed-form" and (total or kinds[0] != "H"):
            return f"{name}: by {self.solver}, only modal energies H1, H2, … ; use closed-form"
        return None

    def _equation(self, modes: ModalAnalysis) -> dict[str, str | float | int]:
        if modes.state is not None:
            equation = {"closed-form": "(11)", "quadrature": "(11)", "fem": "(19)"}[self.solver]
            return {"equation": f"{equation}, damping of the state averaged", "tol": self.tol}
        if self.solver == "closed-form":
            return {"equation": "(34), (36)"}
        return {"equation": "(11)" if self.solver == "quadrature" else "(19)", "tol": self.tol}

    def _density(self, modes: ModalAnalysis, observable: Observable, settings: Settings) -> Density:
        relative = modes.relative_error
        if observable[0].kind != "H":
            return gaussian_density(
                modal_covariance(modes), observable, relative=relative, provenance=settings
            )
        observed = [c.index for c in observable if c.index is not None]
        if not observed:
            return total_energy(
                modes.temperature, observable, relative=relative, provenance=settings
            )
        if self.solver == "quadrature":
            return by_quadrature(modes, observable, tol=self.tol, provenance=settings)
        if self.solver == "fem":
            return by_elements(modes, observable, tol=self.tol, provenance=settings)
        return modal_energies(
            modes.temperature[observed], observable, relative=relative, provenance=settings
        )


def modal_covariance(modes: ModalAnalysis) -> Array:
    """Return the covariance of (q, p) that belongs to (34), shape (2n, 2n), Eqs. (20), (35).

    ``cov q = T diag(θ_i/K*_i) Tᵀ``; as P = Tᵀ p, ``cov p = T⁻ᵀ diag(θ_i M*_i) T⁻¹``, where
    T⁻¹ = M*⁻¹ Tᵀ M; displacements and momenta are not correlated. Where (35) prints T_11^{-1} it
    means an element of the matrix T⁻¹, not 1/T_11.
    """
    n, T = modes.n, modes.mode_shapes
    inverse = np.linalg.inv(T)
    covariance = np.zeros((2 * n, 2 * n))
    covariance[:n, :n] = (T * (modes.temperature / modes.modal_stiffness)) @ T.T
    covariance[n:, n:] = (inverse.T * (modes.temperature * modes.modal_mass)) @ inverse
    return covariance


def _validity(system: System, modes: ModalAnalysis) -> dict[str, str | float | int]:
    """What the theory neglects on this system, in words: contacts and resonances."""
    closest = nearest_resonance(modes, order=resonance_order(system))
    found: dict[str, str | float | int] = {"nearest resonance": str(closest)}
    if pair := strongest_pair(modes):
        found["neglected correlation of modes"] = pair.correlation
    if system.stops and modes.state is None:
        stops = stop_clearances(system)
        narrowest = min(stops, key=lambda stop: stop.ratio if stop.ratio is not None else 0.0)
        found[LEFT_OUT] = _clearance_rule(
            len(stops), narrowest.ratio or 0.0, narrowest.mass, all(s.beyond_rule for s in stops)
        )
    elif system.stops:
        variance = np.diag(modal_covariance(modes.linearised))
        ratios = [(s.clearance / float(np.sqrt(variance[s.index])), s.mass) for s in system.stops]
        ratio, mass = min(ratios)
        found[LEFT_OUT] = _clearance_rule(len(ratios), ratio, mass, ratio > CLEARANCE_RULE)
    return found


def _clearance_rule(stops: int, ratio: float, mass: int, holds: bool) -> str:
    """What to say of contacts left out; ``ratio`` is the least clearance in rms of the motion."""
    return (
        f"{stops}; the rule clearance > {CLEARANCE_RULE:g} rms "
        f"{'holds' if holds else 'does not hold'}: least is {ratio:.3g} rms at mass {mass}"
    )


for _solver, _words, _equation in (
    ("closed-form", "modal averaging, closed form", "(34)"),
    ("fem", "modal averaging, finite elements", "(19)"),
    ("quadrature", "modal averaging, quadrature", "(11)"),
):
    register(
        Route(
            "integrable",
            _solver,
            _words,
            _equation,
            "averaged",
            False,
            "#2a9d6f",
            make=partial(Integrable, solver=_solver),  # type: ignore[arg-type]
        )
    )
