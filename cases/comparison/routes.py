"""The methods that the command line asks for, made from the registry of routes."""

from dataclasses import fields, replace
from importlib import import_module
from typing import Any

from cases.scene.errors import BadInput
from fpk.errors import NotApplicable
from fpk.method import Method, Plan
from fpk.observable import Observable
from fpk.route import ROUTES, Route, solvers_of
from fpk.system import System

ROUTE_MODULES = (
    "averaging.exact",
    "averaging.gaussian",
    "averaging.nonintegrable",
    "averaging.integrable",
    "cases.comparison.averaged",
    "sim.montecarlo",
)
"""The program's own methods; each module registers its routes when it is imported."""

for _module in ROUTE_MODULES:
    import_module(_module)


def listed_routes() -> tuple[Route, ...]:
    """Return all routes: deterministic before sampled, the full system before averaged ones."""
    return tuple(sorted(ROUTES.values(), key=lambda r: (r.sampled, r.solves != "full")))


def listed_methods() -> tuple[str, ...]:
    """Return the names of all methods in the order of their routes."""
    return tuple(dict.fromkeys(route.method for route in listed_routes()))


def method_for(name: str, solver: str | None = None, **settings: Any) -> Method:
    """Return the method ``name`` by ``solver`` (None: its default) with the settings it has.

    A setting that is None is left to the method. Raises ``BadInput`` for names of no route.
    """
    return _made(_routes_of(name, solver)[0], settings)


def all_methods(*, tol: float | None = None, **settings: Any) -> tuple[Method, ...]:
    """Return every route with the settings that it has; ``tol`` is for deterministic ones only.

    A simulation has its own tolerance: a digit that takes a solver a millisecond takes sampling a
    hundred times as long.
    """
    return tuple(
        _made(route, settings if route.sampled else {**settings, "tol": tol})
        for route in listed_routes()
    )


def chosen(
    system: System, observable: Observable, name: str, solver: str | None, **settings: Any
) -> Plan:
    """Return the plan of method ``name`` by ``solver``, or by its first that gives ``observable``.

    Raises ``BadInput`` for names of no route and for a setting that was given and the method does
    not have, ``NotApplicable`` with the reason of the first where none gives the observable.
    """
    refusals = []
    for route in _routes_of(name, solver):
        method = _made(route, settings)
        try:
            plan = method.prepare(system)
        except NotApplicable as reason:
            refusals.append(str(reason))
            continue
        if reason_why_not := plan.refusal(observable):
            refusals.append(reason_why_not)
            continue
        _refuse_unused(method, settings)
        return plan
    raise NotApplicable(refusals[0])


def _routes_of(name: str, solver: str | None) -> list[Route]:
    choices = solvers_of(name)
    if not choices:
        raise BadInput(f"--method {name}: use one of {', '.join(listed_methods())}")
    if solver is not None and solver not in choices:
        remedy = f"use one of {', '.join(choices)}" if len(choices) > 1 else "leave it out"
        raise BadInput(f"--solver {solver}: not a solver of {name}; {remedy}")
    return [ROUTES[name, s] for s in choices if solver in (None, s)]


def _made(route: Route, settings: dict[str, Any]) -> Method:
    method = route.make()
    known = {f.name for f in fields(method)}  # type: ignore[arg-type]  # methods are dataclasses
    given = {k: v for k, v in settings.items() if v is not None and k in known}
    return replace(method, **given)  # type: ignore[type-var]


def _refuse_unused(method: Method, settings: dict[str, Any]) -> None:
    known = {f.name for f in fields(method)} | {"partial", "tol"}  # type: ignore[arg-type]
    for name in sorted(k for k, v in settings.items() if v not in (None, False)):
        if name not in known:
            option = "--" + name.replace("_", "-")
            raise BadInput(
                f"{option}: not an option of {method.name} by {method.solver}; leave it out"
            )
