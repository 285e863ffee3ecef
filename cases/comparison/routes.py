"""The methods that the command line asks for, made from the registry of routes."""

from collections.abc import Mapping
from dataclasses import fields, replace
from importlib import import_module
from typing import Any

from cases.scene.errors import BadInput
from fpk.errors import NotApplicable
from fpk.method import Method, Plan
from fpk.observable import Observable
from fpk.route import ROUTES, Route, solvers_of
from fpk.system import System

ROUTE_MODULES = {
    "exact": ("averaging.exact",),
    "linear": ("averaging.gaussian",),
    "nonintegrable": ("averaging.nonintegrable", "cases.comparison.averaged"),
    "integrable": ("averaging.integrable", "cases.comparison.averaged"),
    "montecarlo": ("sim.montecarlo",),
}
"""The modules of the program's own methods; each registers its routes when it is imported."""


def register_routes(method: str | None = None) -> None:
    """Import the modules of one of the program's methods, those of all where it is none of them."""
    for name in [method] if method in ROUTE_MODULES else ROUTE_MODULES:
        for module in ROUTE_MODULES[name]:
            import_module(module)


def listed_routes() -> tuple[Route, ...]:
    """Return all routes: deterministic before sampled, the full system before averaged ones."""
    register_routes()
    own = list(ROUTE_MODULES)
    return tuple(
        sorted(
            ROUTES.values(),
            key=lambda r: (
                r.sampled,
                r.solves != "full",
                own.index(r.method) if r.method in own else len(own),
            ),
        )
    )


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
        known = {*_settings_of(method), "partial", "tol"}
        unused = {k for k, v in settings.items() if v not in (None, False)} - known
        for setting in sorted(unused):
            raise BadInput(
                f"--{setting.replace('_', '-')}: not an option of {name} by {method.solver};"
                " leave it out"
            )
        return plan
    raise NotApplicable(refusals[0])


def _routes_of(name: str, solver: str | None) -> list[Route]:
    register_routes(name)
    choices = solvers_of(name)
    if not choices:
        raise BadInput(f"--method {name}: use one of {', '.join(listed_methods())}")
    if solver is not None and solver not in choices:
        remedy = f"use one of {', '.join(choices)}" if len(choices) > 1 else "leave it out"
        raise BadInput(f"--solver {solver}: not a solver of {name}; {remedy}")
    return [ROUTES[name, s] for s in choices if solver in (None, s)]


def _settings_of(method: Method) -> set[str]:
    return {f.name for f in fields(method)}  # type: ignore[arg-type]  # methods are dataclasses


def _made(route: Route, settings: Mapping[str, Any]) -> Method:
    method = route.make()
    known = _settings_of(method)
    given = {k: v for k, v in settings.items() if v is not None and k in known}
    return replace(method, **given)  # type: ignore[type-var]
