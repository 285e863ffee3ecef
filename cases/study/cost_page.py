"""A work-precision study as tables and panels of a picture."""

from dataclasses import asdict
from typing import Any

import numpy as np

from cases.scene.written import bound, duration
from cases.show.pictures.panel import Curve, Panel
from cases.show.study_page import Page, Table
from cases.show.words import theory_of_route
from cases.study.cost import CostStudy
from cases.study.law import FULL
from cases.study.levels import Level
from cases.study.prices import Cheapest, by_equation, crossovers, price_list

MEANING = (
    "Processor times on one thread after a warm-up, the median of 3 to 21 runs where one takes"
    " less than a second; simulations are run once. What a process remembers (integrals of two or"
    " more contact masses, of damping that depends on the state) is in the first call only. Every"
    " error is that of the route's own equation: numerical for the averaged equations and for the"
    " full system where it is solved, sampling and step where it is simulated."
)
PROMISE = (
    "Numbers of elements above are right for this scene. A tolerance is met on every scene, or the"
    " answer is not certified: --tol of fpk run and fpk density is this setting."
)
LAW = (
    "L1 = noise/√(paths x time) + bias dt^order, the bias an upper bound where it is not resolved;"
    " (dt, N) is the cheapest path under it, one thread."
)
COLUMNS = {
    "settings": "settings", "error": "L1 error", "stated": "stated", "unknowns": "unknowns",
    "seconds": "seconds", "spread": "quartiles ±", "first": "first call more",
    "coefficients": "coefficients", "memory": "memory",
}  # fmt: skip
"""Fields of a level that the table of measurements shows, with the names of their columns."""
DRAWN, LONGEST = 1e-4, 3600.0
"""Error and seconds to which the law of sampling is drawn: an hour."""


def cost_page(study: CostStudy) -> Page:
    """Return what ``fpk cost`` shows and writes."""
    measured = [
        {"equation": route.equation, "route": route.route}
        | {column: getattr(point, key) for key, column in COLUMNS.items()}
        for route in study.routes
        for point in route.points
        if not point.modelled
    ]
    simulated = [r for r in study.routes if r.equation == FULL]
    models = []
    for m in study.models:  # beside each the fastest simulation to its error, if one reaches it
        seconds = [r.seconds_for(np.array(max(m.distance, m.error))) for r in simulated]
        models.append(
            {**asdict(m), "simulation to this": float(np.fmin.reduce(seconds, initial=np.nan))}
        )
    full = f"Averaging error: L1 to the full system ({study.full_reference}); no solver lowers it."
    axes = tuple(dict.fromkeys(f"{r.equation}: {r.axis}" for r in study.routes))
    lost = [{k: v for k, v in asdict(n).items() if k != "baseline"} for n in study.not_timed]
    prices = [_price(c) for c in price_list(study.routes)]
    promised = [_price(c) for c in price_list(study.routes, promised=True) if c.point]
    laws = [
        {"seconds a step" if key == "step" else key: value for key, value in asdict(law).items()}
        for law in study.laws
    ]
    time = study.scene.units.time
    noise = study.scene.units.of((0, 0, 0.5))
    of_laws = {"noise": noise, "largest": time, "relaxation": time}
    law = f"{LAW} The bias is in {time}^(-order)." if time else LAW
    crossings, overtaking = crossovers(study.routes), _overtaking(study)
    tables = [
        Table("prices", "To get so many digits (L1)", prices),
        Table("promises", "Settings that hold for other scenes", promised, (PROMISE,)),
        Table("crossings", "Where another route becomes the cheapest", crossings, overtaking),
        Table("models", "What the theories are worth for the full system", models, (full,)),
        Table("not_timed", "Routes that are not timed", lost),
        Table("laws", f"{FULL}: law of sampling", laws, (law,), of_laws),
        Table("measurements", "Measurements", measured, (*axes, MEANING)),
    ]
    title = f"What accuracy costs: {study.scene.title}"
    return Page("cost", study.scene, title, tables, _panels(study))


def _overtaking(study: CostStudy) -> tuple[str, ...]:
    """Where solutions of the full system overtake its sampling, in words."""
    own = [r for r in study.routes if r.equation == FULL]
    sampled = [r for r in own if any(p.modelled for p in r.points)]
    words = []
    for route in [r for r in own if r not in sampled] if sampled else []:
        reached = [p.error for p in route.points]
        errors = np.geomspace(max(reached), min(reached), 1001)
        seconds = route.seconds_for(errors)
        sampling = np.fmin.reduce([r.seconds_for(errors) for r in sampled])
        slower = np.flatnonzero(seconds > sampling)
        first = slower[-1] + 1 if slower.size else 0
        where = (
            f"below {errors[first]:.1e}" if first < errors.size else "at no error that it reached"
        )
        times = duration(seconds[-1]), duration(sampling[-1])
        words.append(
            f"{FULL}: {route.route} overtakes sampling {where}. At its least error here,"
            f" {bound(errors[-1])}, it takes {times[0]}, sampling {times[1]}."
        )
    return tuple(words)


def _price(c: Cheapest) -> dict[str, Any]:
    p, route = c.point, c.route or "reached by none here"
    by = p and ("law of sampling" if p.modelled else "measurement")
    price = {key: getattr(p, key, None) for key in ("settings", "seconds", "memory")}
    return {"equation": c.equation, "digits": c.digits, "route": route, **price, "priced by": by}


def _note(point: Level) -> str:
    """The setting of a point, and how well its error and time are known."""
    if point.modelled:
        return f"{point.settings}, by the law of sampling"
    spread = f", time ± {duration(point.spread)}" if point.spread > 0.0 else ""
    return f"{point.settings}, states {point.stated:.1e}{spread}"


def _panels(study: CostStudy) -> list[Panel]:
    """Return a panel for each equation: error against time of every route.

    Open markers and dotted lines are prices by the law of sampling; dashed levels are the averaging
    error, which no solver lowers.
    """
    panels = []
    models = [(m.distance, f"error of {theory_of_route(m.theory)}") for m in study.models]
    for equation, routes in by_equation(study.routes).items():
        curves = []
        for route in routes:
            drawn = [
                p
                for p in sorted(route.points, key=lambda p: -p.error)
                if p.error >= (0.99 * DRAWN if p.modelled else 1e-300)
                and not (p.modelled and p.seconds > LONGEST)
            ]
            if drawn:
                style = ":" if drawn[-1].modelled else "-"
                times, errors = [p.seconds for p in drawn], [p.error for p in drawn]
                curves.append(
                    Curve(route.route, times, errors, style=style, notes=list(map(_note, drawn)))
                )
        x, floor = "processor time in seconds, one thread", study.floors.get(equation, 0.0)
        lowest = 0.4 * min([DRAWN, *(min(curve.y) for curve in curves)])
        marks, limits = (models, (lowest, 1.0)) if equation == FULL else ((), (2e-16, 2.0))
        y = "L₁ error" if equation in study.floors else "relative error"
        panel = Panel(equation, x, y, curves, max(floor, 2e-15), marks, limits=limits)
        panels.append(panel)
    return panels
