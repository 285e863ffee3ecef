"""The routes from a system to densities that the command line offers: one entry each."""

from collections.abc import Callable
from dataclasses import asdict, dataclass, field, fields, replace
from pathlib import Path
from typing import Any

from averaging.exact import Exact
from averaging.gaussian import Linear
from averaging.integrable import Integrable
from averaging.nonintegrable import NonIntegrable
from cases.comparison.averaged import AveragedSimulation
from cases.scene.errors import BadInput
from fpk.method import Method
from sim.montecarlo import MonteCarlo

SIMULATION = "simulation"


@dataclass(frozen=True)
class Route:
    """One METHOD of the command line: how it is made from a SOLVER, or why it cannot be yet.

    ``solvers`` are the choices, the default first; the solver "simulation" takes seed and threads.
    """

    make: Callable[[Any], Any] | None
    solvers: tuple[str, ...] = ()
    refusal: str = ""


def _averaged(theory: Any, solver: str) -> Any:
    """The theory by ``solver``; its equations are simulated by a method of their own."""
    plain = theory() if solver == SIMULATION else theory(solver=solver)
    return AveragedSimulation(plain.name) if solver == SIMULATION else plain


ROUTES: dict[str, Route] = {
    "exact": Route(lambda solver: Exact()),
    "linear": Route(lambda solver: Linear()),
    "nonintegrable": Route(
        lambda solver: _averaged(NonIntegrable, solver),
        ("fem", "closed-form", "quadrature", SIMULATION),
    ),
    "integrable": Route(
        lambda solver: _averaged(Integrable, solver),
        ("closed-form", "fem", "quadrature", SIMULATION),
    ),
    "montecarlo": Route(lambda solver: MonteCarlo(), (SIMULATION,)),
}


@dataclass(frozen=True)
class Sampling:
    """What may be said of the simulation; None leaves it to the method.

    ``paths`` trajectories are sampled for ``time`` each, or for so many ``relaxations`` (times in
    which the system forgets): whatever the unit of time. ``seconds`` of wall time end it instead,
    and ``step_pair`` measures the bias of the step. ``cluster`` is the address of a Dask
    scheduler, ``checkpoint`` a folder, ``partial`` whether Ctrl-C leaves what there is by then;
    ``dt`` the step, ``allow_unstable`` whether it may be beyond the stability limit.
    """

    seed: int | None = None
    threads: int | None = None
    paths: int | None = None
    time: float | None = None
    relaxations: float | None = None
    seconds: float | None = None
    step_pair: bool | None = None
    cluster: str | None = None
    checkpoint: Path | None = None
    partial: bool = False
    dt: float | None = None
    allow_unstable: bool = False

    def given_to(self, method: Any) -> dict[str, Any]:
        """Return the settings that were given and that ``method`` has."""
        known = {f.name for f in fields(method)}
        return {k: v for k, v in asdict(self).items() if v is not None and k in known}


@dataclass(frozen=True)
class Request:
    """One METHOD with its SOLVER and settings, as asked for on the command line."""

    method: str
    solver: str | None = None
    tol: float | None = None
    sampling: Sampling = field(default_factory=Sampling)


def method_for(request: Request) -> Method:
    """Return the method asked for; raise ``BadInput`` with the reason where there is none."""
    route = ROUTES.get(request.method)
    if route is None:
        raise BadInput(f"--method {request.method}: use one of {', '.join(ROUTES)}")
    solver = request.solver
    if solver is not None and solver not in route.solvers:
        choices = f"use one of {', '.join(route.solvers)}" if route.solvers else "leave it out"
        raise BadInput(f"--solver {solver}: not a solver of {request.method}; {choices}")
    if route.make is None:
        raise BadInput(f"--method {request.method}: {route.refusal}")
    solver = solver or (route.solvers[0] if route.solvers else "")
    method = route.make(solver)
    settings: dict[str, Any] = request.sampling.given_to(method) if solver == SIMULATION else {}
    if request.tol is not None and hasattr(method, "tol"):
        settings["tol"] = request.tol
    result: Method = replace(method, **settings) if settings else method
    return result


def refuse_unused(method: Method, sampling: Sampling) -> None:
    """Raise ``BadInput`` for an option of the simulation that was given and ``method`` lacks."""
    given = {f.name for f in fields(sampling) if getattr(sampling, f.name) not in (None, False)}
    known = {f.name for f in fields(method)}  # type: ignore[arg-type]  # methods are dataclasses
    for name in sorted(given - known - {"partial"}):
        option = "--" + name.replace("_", "-")
        raise BadInput(f"{option}: not an option of {method.name} by {method.solver}; leave it out")


def all_methods(
    *, tol: float | None = None, sampling: Sampling | None = None
) -> tuple[Method, ...]:
    """Return every route that there is, with every solver; ``tol`` is for the solvers alone.

    The simulation keeps its own tolerance: what takes a solver a millisecond more takes sampling
    a hundred times as long for every digit.
    """
    return tuple(
        method_for(
            Request(name, solver, None if solver == SIMULATION else tol, sampling or Sampling())
        )
        for name, route in ROUTES.items()
        if route.make is not None
        for solver in (route.solvers or (None,))
    )
