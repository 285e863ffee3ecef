"""The record of ``fpk show``: system, effects, frequencies, theories, boundaries."""

from typing import Any

from cases.comparison.routes import listed_routes
from cases.output.records import facts_record, plain
from cases.scene.scene import Scene
from fpk.errors import NotApplicable
from fpk.method import Method
from fpk.observable import observable_name
from fpk.route import ROUTES, solvers_of


def show_record(scene: Scene) -> dict[str, Any]:
    """Return the record of ``fpk show``."""
    facts = facts_record(scene.system)
    record = {
        "scene": scene.name,
        "title": scene.title,
        "source": scene.source,
        "system": facts["system"],
        "observables": [observable_name(o) for o in scene.observables],
        "curves": [curve.label for curve in scene.curves],
        "effects": facts["effects"],
        "natural_frequencies": facts["regime"]["natural_frequencies"],
        "regime": facts["regime"],
        "theories": theories(scene),
        "boundaries": facts["regime"].pop("boundaries"),
    }
    result: dict[str, Any] = plain(record)
    return result


def theories(scene: Scene) -> list[dict[str, Any]]:
    """Return for every METHOD whether it applies to the scene's own system, and why not."""
    records = []
    for name in dict.fromkeys(route.method for route in listed_routes()):
        routes = [ROUTES[name, solver] for solver in solvers_of(name)]
        by_solver = [_refusals(route.make(), scene) for route in routes]
        # An observable is refused where every solver refuses it: the default's reason is shown.
        refused = [column for column in zip(*by_solver, strict=True) if None not in column]
        records.append(
            {
                "method": name,
                "meaning": f"{routes[0].words}, Eq. {routes[0].equation}",
                "solvers": solvers_of(name),
                "applies": len(refused) < len(scene.observables),
                "reason": "; ".join(dict.fromkeys(str(column[0]) for column in refused)) or None,
            }
        )
    return records


def _refusals(method: Method, scene: Scene) -> list[str | None]:
    """Why the method does not give each observable of the scene, None where it does."""
    try:
        plan = method.prepare(scene.system)
    except NotApplicable as reason:
        return [str(reason)] * len(scene.observables)
    pairs = [(observable_name(o), plan.refusal(o)) for o in scene.observables]
    return [reason and reason.removeprefix(f"{name}: ") for name, reason in pairs]
