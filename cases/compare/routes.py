"""The methods of the command line, made from the registry of routes."""

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
"""The modules of each method of the program; importing one registers its routes."""


def register_routes(method: str | None = None) -> None:
    """Import the modules of ``method``, or of all methods if it is none of the program's own."""
    for name in [method] if method in ROUTE_MODULES else ROUTE_MODULES:
        for module in ROUTE_MODULES[name]:
            import_module(module)


def all_routes() -> tuple[Route, ...]:
    """Return all routes: first quick, then slow, then sampling ones.

    In each group routes of the full system precede averaged ones.
    """
    register_routes()
    names = list(dict.fromkeys([*ROUTE_MODULES, *(method for method, _ in ROUTES)]))
    order = sorted(ROUTES.values(), key=lambda r: names.index(r.method))
    return tuple(sorted(order, key=lambda r: (r.sampled, not r.quick, r.solves != "full")))


def method_for(name: str, solver: str | None = None, **settings: Any) -> Method:
    """Return the method ``name`` by ``solver`` (None: its default).

    ``settings`` that are fields of the method and not None are set. Raises ``InvalidInput`` for
    names of no route.
    """
    return methods_of(name, solver, **settings)[0]


def methods_of(name: str, solver: str | None = None, **settings: Any) -> tuple[Method, ...]:
    """Return the method ``name`` by ``solver``, or by each of its solvers, its default first.

    Without ``solver``, routes that must be named are left out. Raises as ``method_for``.
    """
    register_routes(name)
    choices = [ROUTES[name, each] for each in solvers_of(name)]
    if not choices:
        names = dict.fromkeys(route.method for route in all_routes())
        raise InvalidInput("method", name, f"use one of {', '.join(names)}")
    wanted = [r for r in choices if solver == r.solver or (solver is None and not r.named)]
    if not wanted:
        labels = ", ".join(route.label for route in choices)
        remedy = f"use one of {labels}" if len(choices) > 1 else "leave it out"
        raise InvalidInput("solver", solver, f"is not a solver of {name}; {remedy}")
    return tuple(_make_method(route, settings) for route in wanted)


def all_methods(
    *, tol: float | None = None, named: Sequence[str] = (), **settings: Any
) -> tuple[Method, ...]:
    """Return every route with its ``settings``, solvers with the tolerance ``tol``.

    A route that must be named is returned only if its solver or label is in ``named``. Simulations
    do not get ``tol``: a digit more costs them a hundred times the time.
    """
    return tuple(
        _make_method(route, settings if route.sampled else {**settings, "tol": tol})
        for route in all_routes()
        if not route.named or route.solver in named or route.label in named
    )


def chosen_methods(
    methods: Sequence[Method], names: Sequence[str], *, simulation: bool
) -> tuple[Method, ...]:
    """Return the ``methods`` with one of the ``names``, method or method/solver; no name: all.

    ``simulation`` False leaves out methods that sample. Raises ``InvalidInput`` for an unknown
    name, and if none of the named methods remains.
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


def with_settings(method: Method, settings: Mapping[str, Any]) -> Method:
    """Return a copy of the method with the ``settings`` that are its fields; others are ignored."""
    known = settings_of(method)
    given = {key: value for key, value in settings.items() if key in known}
    return replace(method, **given)  # type: ignore[type-var]


def _make_method(route: Route, settings: Mapping[str, Any]) -> Method:
    return with_settings(route.make(), {k: v for k, v in settings.items() if v is not None})
