"""Base classes of the methods that solve equations, and the exact stationary solution (7), (22)."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, ClassVar, Self

import numpy as np

from averaging.back_transformation import back_transformed, marginal_of
from averaging.energy_process import compatibility, energy_process, state_closed_form
from averaging.shell.laplace import by_lines
from averaging.weyl import StateDensity
from fpk.answer.certificate import tolerance
from fpk.answer.dynamics import Curve, certify_curve
from fpk.answer.method import ROUTES, Method, Plan, Progress, Result, Route, Solves, register_route
from fpk.answer.names import Coordinate, Observable, observable_name
from fpk.answer.question import QUESTIONS, Asked, answer
from fpk.numeric.errors import InvalidInput
from fpk.system.system import System

SMALLEST, LARGEST = 1e-12, 0.1
"""Smallest and largest L1 tolerance that is accepted: double precision meets no smaller one, and a
density with a larger error says little."""

DEFAULT, DEFAULT_BY_LINES = 1e-10, 1e-5
"""L1 tolerance if none is given: in general, and if the density of states is computed from the
partition function (``by_lines``), whose largest error found was 1e-6 (three masses, stops 1e6 times
as stiff as the springs)."""

UNIFORM_TOL = 1e-4
"""L1 tolerance by scikit-fem if none is given: all shipped scenes meet it within seconds."""


@dataclass(frozen=True)
class Theory(Method):
    """Method that solves an equation by one of several solvers, to an L1 tolerance.

    ``solver`` is the name of the solver, ``tol`` the largest L1 error of a density; None stands for
    the tolerance of ``tol_for``. A subclass defines ``method``, its name on the command line, its
    ``colour`` in pictures and its ``solvers``, the default first, as (name, words for legends,
    equation); also the default of ``solver`` if that is not "closed-form", and ``solves``
    "averaged" if its equation is not Eq. (6) itself. ``register`` adds a route for each solver.
    Raises ``InvalidInput`` for an unknown solver, or a tolerance below ``SMALLEST`` or above
    ``LARGEST``.
    """

    solver: str = "closed-form"
    tol: float | None = None
    method: ClassVar[str]
    solvers: ClassVar[tuple[tuple[str, str, str], ...]]
    solves: ClassVar[Solves] = "full"
    colour: ClassVar[str]

    def __post_init__(self) -> None:
        """Raise ``InvalidInput`` for an unknown solver or a tolerance outside the limits."""
        if self.solver not in (names := sorted(name for name, *_ in self.solvers)):
            raise InvalidInput("solver", self.solver, f"use one of {names}")
        if self.tol is not None and not SMALLEST <= self.tol <= LARGEST:
            raise InvalidInput("tol", self.tol, f"must lie between {SMALLEST:g} and {LARGEST:g}")

    @property
    def route(self) -> Route:
        """The registered route of this method by this solver."""
        return ROUTES[self.method, self.solver]

    def refined(self) -> Self:
        """Return a copy with a tenth of ``tol``, at least ``SMALLEST``.

        For None this is a tenth of ``UNIFORM_TOL`` by scikit-fem, else of ``DEFAULT``.
        """
        default = UNIFORM_TOL if self.route.named else DEFAULT
        return replace(self, tol=max(0.1 * tolerance(self.tol, default), SMALLEST))

    def tol_for(self, system: System) -> float:
        """Return the L1 tolerance: ``tol``, or if it is None a default for ``system``.

        This is ``UNIFORM_TOL`` by scikit-fem, else ``DEFAULT_BY_LINES`` if ``by_lines(system)``,
        else ``DEFAULT``.
        """
        default = DEFAULT_BY_LINES if by_lines(system) else DEFAULT
        return tolerance(self.tol, UNIFORM_TOL if self.route.named else default)

    @classmethod
    def register(cls, **options: Any) -> None:
        """Add a ``Route`` for each solver to ``ROUTES``; ``options`` are further fields of each."""
        for solver, words, equation in cls.solvers:
            make, named = partial(cls, solver=solver), solver == "scikit-fem"
            names = cls.method, solver, words, equation, cls.solves
            register_route(Route(*names, False, cls.colour, make, named=named, **options))


@dataclass(frozen=True)
class EnergyTheory(Theory):
    """Theory of a density u(H(q, p)) of the full state; other densities are marginals of it."""

    def exponential(self, system: System) -> bool:
        """Return whether u is C exp(−αH), raise ``NotApplicable`` if the theory fails; abstract."""
        raise NotImplementedError

    def state(self, system: System) -> tuple[StateDensity, dict[str, str | float | int]]:
        """Return the density u for ``system``, and the settings of the result; abstract."""
        raise NotImplementedError

    def prepare(self, system: System) -> Plan:
        """Return the plan for ``system``; raise ``NotApplicable`` if the theory does not hold."""

        def solve(observables: Sequence[Observable], progress: Progress) -> Result:
            (source, settings), tol = self.state(system), self.tol_for(system)
            densities = tuple(back_transformed(source, o, tol=tol) for o in observables)
            return Result(self, densities, settings=settings)

        refusal = partial(energy_only_refusal, system, exponential=self.exponential(system))
        return Plan(refusal, solve)

    @answer
    def crossings(self, asked: Asked) -> Curve:
        """Return the upcrossings per unit time of the levels ``asked.at`` by q, Rice's formula.

        ∫_0^∞ v f(q, p) dp, f the joint density of q and p and v = p/m, is an integral over p²/2m,
        and so a Weyl integral of u whose order is greater by ½ than the order for p(q).
        """
        system, tol = asked.system, asked.tol or self.tol_for(asked.system)
        (source, _), mass = self.state(system), float(system.mass[asked.row])
        q = back_transformed(source, asked.observable, tol=tol)
        p = back_transformed(source, (Coordinate("p", asked.row),), tol=tol)
        flux, error, _ = marginal_of(source, asked.observable, flux_of=mass)
        scale = QUESTIONS["crossings"].scale(q.std().value, p.std().value / mass)
        return certify_curve(flux(asked.at), error(asked.at), scale=scale, of=q, tol=tol)


def energy_only_refusal(
    system: System, observable: Observable, *, exponential: bool = False
) -> str | None:
    """Return in words why the density of ``observable`` does not follow from u(H), None if it does.

    Modal energies do not, nor does a pair with H. At most two contact masses whose displacement is
    not observed are integrated out by quadrature at once. If u is ``exponential``, only masses
    between the first and the last observed displacement count, since the others are integrated out
    one after another along the chain.
    """
    kinds = {c.kind for c in observable}
    if "H" in kinds and (len(observable) > 1 or observable[0].index is not None):
        return (
            f"{observable_name(observable)}: this theory knows the total energy only; "
            "ask for H, q, p or pairs of q and p"
        )
    seen = [c.row for c in observable if c.kind == "q"]
    hidden = [i for i in system.contact_masses if i not in seen]
    if exponential:
        hidden = [i for i in hidden if seen and min(seen) < i < max(seen)]
    if "H" not in kinds and len(hidden) > 2:
        return (
            f"{observable_name(observable)}: {len(hidden)} contact masses would have to be "
            "integrated out numerically at once, at most 2 are"
        )
    return None


@dataclass(frozen=True)
class Exact(EnergyTheory):
    """Exact stationary density C exp(−∫h dH) of the full system, Eqs. (7), (22), (23).

    It exists if (8) holds. With constant damping h is a constant, and 1/C is the configuration
    integral over the contact masses; otherwise 1/C is an integral over the energy shells. ::

        fpk.solve(fpk.load("fig3a").system, ["q2,p2"], methods=[Exact()])

    Upcrossings per unit time of two levels by the second mass::

        system, levels = fpk.load("fig3a").system, np.array([0.0, 0.5])
        Exact().crossings(system, parse_observable("q2", 2), levels).values
    """

    method = "exact"
    solvers = (("closed-form", "exact", "(7)"),)
    colour = "#056c66"

    def exponential(self, system: System) -> bool:
        """Return whether h is a constant; raise ``NotApplicable`` if (8) does not hold."""
        h = compatibility(system)
        system.fact(energy_process)
        return h.size == 1

    def state(self, system: System) -> tuple[StateDensity, dict[str, str | float | int]]:
        """Return u and the settings "equation", "h" (its constant part), "h, H^1", "h, H^2", …

        With constant damping the residual is max |c − h D|/max |h D|, c symmetric; see (8).
        """
        h = compatibility(system)
        settings: dict[str, str | float | int] = {"equation": "(7), (22)", "h": float(h[0])}
        settings |= {f"h, H^{power}": x for power, x in enumerate(h[1:].tolist(), start=1)}
        constant, D = 0.5 * (system.damping + system.damping.T), h[0] * system.noise_matrix
        residual = float(np.max(np.abs(constant - D)) / np.max(np.abs(D)))
        return state_closed_form(system, h, residual=None if h.size > 1 else residual), settings


Exact.register()
