"""Values that a shell completes: scenes, methods, solvers, observables, contact laws."""

from collections.abc import Iterable

import click
from click.shell_completion import CompletionItem

from fpk.numeric.errors import InvalidInput


def scenes(context: click.Context, option: click.Parameter, begun: str) -> list[CompletionItem]:
    """Return the shipped scenes that begin with ``begun``, and an entry that completes files."""
    from cases.scene.scene import shipped_scenes

    return [*_beginning(shipped_scenes(), begun), CompletionItem(begun, type="file")]


def methods(context: click.Context, option: click.Parameter, begun: str) -> list[CompletionItem]:
    """Return the methods that begin with ``begun``; "method/solver" if it has a ``/`` and the
    option may be given several times."""
    from cases.compare.routes import all_routes

    routes = all_routes()
    if option.multiple and "/" in begun:
        return _beginning((f"{route.method}/{route.solver}" for route in routes), begun)
    return _beginning((route.method for route in routes), begun)


def solvers(context: click.Context, option: click.Parameter, begun: str) -> list[CompletionItem]:
    """Return the solvers, of the method typed before if any, that begin with ``begun``."""
    from cases.compare.routes import all_routes

    method = context.params.get("method")
    return _beginning((r.solver for r in all_routes() if method in (None, r.method)), begun)


def observables(
    context: click.Context, option: click.Parameter, begun: str
) -> list[CompletionItem]:
    """Return the coordinates of the scene typed before that begin with ``begun``; without a valid
    scene none. Pairs are not completed."""
    from cases.scene.errors import BadInput
    from cases.scene.scene import load_scene

    # Words are left in ``args`` where the last option still lacks its value.
    typed = [context.params.get("scene"), *context.args]
    try:
        n = load_scene(next(filter(None, typed))).system.n
    except (StopIteration, BadInput, InvalidInput):
        return []
    names = [f"{kind}{k}" for kind in ("q", "p", "H") for k in range(1, n + 1)]
    return _beginning([*names, "H"], begun)


def laws(context: click.Context, option: click.Parameter, begun: str) -> list[CompletionItem]:
    """Return the contact laws that begin with ``begun``."""
    from fpk.system.contact_law import LAWS

    return _beginning(sorted(LAWS), begun)


def _beginning(names: Iterable[str], begun: str) -> list[CompletionItem]:
    return [CompletionItem(name) for name in dict.fromkeys(names) if name.startswith(begun)]
