"""A work-precision study as tables and panels of a picture."""

from dataclasses import asdict
from typing import Any

import numpy as np

from cases.studies.cost import CostStudy
from cases.studies.law import FULL
from cases.studies.page import Page, Table
from cases.studies.picture import Curve, Panel, study_figure
from cases.studies.prices import Cheapest, by_equation, crossovers, price_list

MEANING = (
    "Times are processor times on one thread: the wall time of a core that does nothing else, after"
    " a warm-up, the median of 3 to 21 runs where one takes less than a second; simulations are run"
    " once. Every error is that of the route's own equation: numerical for the averaged equations,"
    " sampling and step for the full system. What averaging costs in accuracy is in a table of its"
    " own. What a process remembers (integrals of two or more contact masses, of damping"
    " that depends on the state) is in the first call, not in the median."
)
PROMISE = (
    "Numbers of elements above are right for this scene. A tolerance is met on every scene, or the"
    " answer is not certified: --tol of fpk run and fpk density is this setting."
)
LAW = (
    "L1 = noise/√(paths x time) + bias dt^order, the bias an upper bound where it is not resolved;"
    " (dt, N) is the cheapest path under it, one thread."
)
DRAWN, LONGEST = 1e-4, 3600.0
"""Error and seconds to which the law of sampling is drawn: an hour."""


def cost_page(study: CostStudy) -> Page:
    """Return what ``fpk cost`` shows and writes."""
    return Page(
        "cost",
        study.scene,
        f"What accuracy costs: {study.scene.title}",
        cost_tables(study),
        lambda: study_figure(cost_panels(study), width=5.2),
        MEANING,
    )


def cost_tables(study: CostStudy) -> list[Table]:
    """Return the price list of every equation, crossovers, averaging errors, all measurements."""
    measured = [
        {
            "equation": route.equation,
            "route": route.route,
            "settings": point.settings,
            "L1 error": point.error,
            "stated": point.stated,
            "unknowns": point.unknowns or None,
            "seconds": t.seconds,
            "quartiles ±": t.spread,
            "first call more": t.first,
            "coefficients": t.coefficients,
            "memory": t.memory,
        }
        for route in study.routes
        for point in route.points
        if not point.modelled
        for t in [point.timing]
    ]
    models = [
        {**asdict(m), "simulation to this": _simulated(study, max(m.distance, m.error))}
        for m in study.models
    ]
    full = f"Averaging error: L1 to the full system ({study.full_reference}); no solver lowers it."
    axes = tuple(dict.fromkeys(f"{r.equation}: {r.axis}" for r in study.routes))
    lost = [{k: v for k, v in asdict(n).items() if k != "baseline"} for n in study.not_timed]
    promised = [_price(c) for c in price_list(study.routes, promised=True) if c.point]
    crossings = [asdict(c) for c in crossovers(study.routes)]
    laws = [asdict(law) for law in study.laws]
    return [
        Table(
            "prices", "To get so many digits (L1)", [_price(c) for c in price_list(study.routes)]
        ),
        Table("promises", "Settings that hold for other scenes", promised, (PROMISE,)),
        Table("crossings", "Where another route becomes the cheapest", crossings),
        Table("models", "What the theories are worth for the full system", models, (full,)),
        Table("not_timed", "Routes that are not timed", lost),
        Table("laws", f"{FULL}: law of sampling", laws, (LAW,)),
        Table("measurements", "Measurements", measured, axes),
    ]


def _price(c: Cheapest) -> dict[str, Any]:
    row = {"equation": c.equation, "digits": c.digits, "route": c.route or "reached by none here"}
    if (p := c.point) is None:
        return row | dict.fromkeys(("settings", "seconds", "memory", "priced by"))
    by = "law of sampling" if p.modelled else "measurement"
    settings = {"settings": p.settings, "seconds": p.seconds, "memory": p.timing.memory}
    return row | settings | {"priced by": by}


def _simulated(study: CostStudy, error: float) -> float:
    """Seconds of the fastest simulation of the full system to ``error``."""
    times = [float(r.seconds_for(np.array(error))) for r in study.routes if r.equation == FULL]
    return min((t for t in times if t == t), default=np.nan)


def cost_panels(study: CostStudy) -> list[Panel]:
    """Return a panel for each equation: error against time of every route.

    Open markers and dotted lines are prices by the law of sampling; dashed levels are the averaging
    error, which no solver lowers.
    """
    panels = []
    marks = [(m.distance, f"averaging error of the {m.theory} theory") for m in study.models]
    for equation, routes in by_equation(study.routes).items():
        curves, full = [], equation == FULL
        for route in routes:
            points = [
                p
                for p in sorted(route.points, key=lambda p: -p.error)
                if p.error > 0.0
                and not (p.modelled and (p.error < 0.99 * DRAWN or p.seconds > LONGEST))
            ]
            if points:
                times, errors = [p.seconds for p in points], [p.error for p in points]
                style = ":" if points[-1].modelled else "-"
                curves.append(Curve(route.route, times, errors, style=style))
        panels.append(
            Panel(
                equation,
                "processor time in seconds, one thread",
                "$L_1$ error",
                curves,
                floor=max(study.floors.get(equation, 0.0), 2e-15),
                marks=marks if full else (),
                limits=(0.5 * DRAWN, 1.0) if full else (2e-16, 2.0),
            )
        )
    return panels
