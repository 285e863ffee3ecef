"""The methods that the command line asks for, made from the registry of routes."""

from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from importlib import import_module
from typing import Any

from fpk.answer.method import ROUTES, Method, Route, solvers_of
from fpk.numeric.errors import InvalidInput

ROUTE_MODULES = {
    "exact": ("averaging.theory",),
    "linear": ("averaging.gaussian",),
    "phase-space": ("averaging.phase_space.method",),
    "nonintegrable": ("averaging.nonintegrable", "cases.compare.averaged"),
    "integrable": ("averaging.integrable", "cases.compare.averaged"),
    "montecarlo": ("sim.montecarlo",),
}
"""The modules of the program's own methods; each registers its routes when it is imported."""


def register_routes(method: str | None = None) -> None:
    """Import the modules of one of the program's methods, those of all where it is none of them."""
    for name in [method] if method in ROUTE_MODULES else ROUTE_MODULES:
        for module in ROUTE_MODULES[name]:
            import_module(module)


def listed_routes() -> tuple[Route, ...]:
    """Return all routes: quick ones, slow ones, and last those that sample.

    In each the full system precedes averaged equations.
    """
    register_routes()
    names = list(dict.fromkeys([*ROUTE_MODULES, *(method for method, _ in ROUTES)]))
    order = sorted(ROUTES.values(), key=lambda r: names.index(r.method))
    return tuple(sorted(order, key=lambda r: (r.sampled, not r.quick, r.solves != "full")))


def method_for(name: str, solver: str | None = None, **settings: Any) -> Method:
    """Return the method ``name`` by ``solver`` (None: its default) with the settings it has.

    A setting that is None is left to the method. Raises ``InvalidInput`` for names of no route.
    """
    return methods_of(name, solver, **settings)[0]


def methods_of(name: str, solver: str | None = None, **settings: Any) -> tuple[Method, ...]:
    """Return the method ``name`` by ``solver``, or by each of its solvers, its default first.

    Those that are taken only where they are named are left out of the latter.
    """
    register_routes(name)
    choices = [ROUTES[name, each] for each in solvers_of(name)]
    if not choices:
        names = dict.fromkeys(route.method for route in listed_routes())
        raise InvalidInput("method", name, f"use one of {', '.join(names)}")
    wanted = [r for r in choices if solver == r.solver or (solver is None and not r.named)]
    if not wanted:
        labels = ", ".join(route.label for route in choices)
        remedy = f"use one of {labels}" if len(choices) > 1 else "leave it out"
        raise InvalidInput("solver", solver, f"is not a solver of {name}; {remedy}")
    return tuple(_made(route, settings) for route in wanted)


def all_methods(
    *, tol: float | None = None, named: Sequence[str] = (), **settings: Any
) -> tuple[Method, ...]:
    """Return every route with the settings that it has; ``tol`` is for deterministic ones only.

    Routes that are taken only where they are named are those whose solver or label is in ``named``.

    A simulation has its own tolerance: a digit that takes a solver a millisecond takes sampling a
    hundred times as long.
    """
    return tuple(
        _made(route, settings if route.sampled else {**settings, "tol": tol})
        for route in listed_routes()
        if not route.named or route.solver in named or route.label in named
    )


def chosen_methods(
    methods: Sequence[Method], names: Sequence[str], *, simulation: bool
) -> tuple[Method, ...]:
    """Return those of ``methods`` that ``names`` have, as method or method/solver; no name: all.

    Without ``simulation`` none that samples. Raises ``InvalidInput`` for a name of none, and where
    nothing is left.
    """
    wanted = {m.route for name in names for m in methods_of(*name.split("/", 1))}
    chosen = [m for m in methods if not names or m.route in wanted]
    left = tuple(m for m in chosen if simulation or not m.route.sampled)
    if names and not left:
        raise InvalidInput("--no-simulation", " ".join(names), "leaves no method; leave one out")
    return left


def settings_of(method: Method) -> set[str]:
    """Return the names of the fields of a method."""
    return {f.name for f in fields(method)}  # type: ignore[arg-type]  # methods are dataclasses


def _made(route: Route, settings: Mapping[str, Any]) -> Method:
    method = route.make()
    known = settings_of(method)
    given = {k: v for k, v in settings.items() if v is not None and k in known}
    return replace(method, **given)  # type: ignore[type-var]
