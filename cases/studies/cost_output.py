"""A work-precision study as tables, panels of a picture, and rows."""

from dataclasses import astuple
from typing import Any

import numpy as np

from cases.studies.cost import CostStudy
from cases.studies.levels import Level
from cases.studies.picture import Curve, Panel, study_figure
from cases.studies.prices import Cheapest, Priced, by_equation
from cases.studies.sampling import FULL
from cases.studies.tables import Page, Table, duration, megabytes, rows_dataset

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
DRAWN, LONGEST = 1e-4, 3600.0
"""Error and seconds to which the law of sampling is drawn: an hour."""


def cost_page(study: CostStudy) -> Page:
    """Return what ``fpk cost`` shows and writes."""
    return Page(
        "cost",
        study.scene,
        f"What accuracy costs: {study.scene.title}",
        cost_tables(study),
        lambda: rows_dataset(point=_rows(study)).assign_attrs(meaning=MEANING),
        lambda: study_figure(cost_panels(study), width=5.2),
        MEANING,
    )


def cost_tables(study: CostStudy) -> list[Table]:
    """Return the price list of every equation, crossovers, averaging errors, all measurements."""
    equations = list(by_equation(study.routes))
    tables = [_prices(study, name) for name, _ in equations]
    tables += [_promises(study)] if study.promises else []
    tables.append(_crossings(study))
    tables += [_models(study)] if study.models else []
    tables += [_not_timed(study)] if study.not_timed else []
    tables += [_laws(study)] if study.laws else []
    return tables + [_measured(name, routes) for name, routes in equations]


def _prices(study: CostStudy, equation: str) -> Table:
    rows = [_price(c) for c in study.prices if c.equation == equation]
    remarks = ("≈: by the law of sampling, not run.",) if equation == FULL else ()
    head = "digits | route | settings | time | memory"
    return Table(f"{equation}: to get so many digits (L1)", head, rows, remarks)


def _price(c: Cheapest) -> tuple[Any, ...]:
    if (p := c.point) is None:
        return c.digits, "reached by none here", None, None, None
    time = ("≈ " if p.modelled else "") + duration(p.seconds)
    return c.digits, c.route, p.settings, time, megabytes(p.timing.memory)


def _promises(study: CostStudy) -> Table:
    """Return the table of settings that also hold for scenes which were not measured."""
    rows = [(c.equation, *_price(c)) for c in study.promises if c.point is not None]
    head = "equation | digits | route | settings | time here | memory"
    return Table("Settings that hold for other scenes", head, rows, (PROMISE,))


def _crossings(study: CostStudy) -> Table:
    rows: list[tuple[Any, ...]] = [astuple(c) for c in study.crossings]
    crossed = {row[0] for row in rows}
    for equation, _ in by_equation(study.routes):
        if equation not in crossed:
            rows.append((equation, "–", "one route is cheapest at every error measured", ""))
    head = "equation | below the error | from | to"
    return Table("Where another route becomes the cheapest", head, rows, _pays(study))


def _pays(study: CostStudy) -> tuple[str, ...]:
    """Where Monte Carlo stops paying, in words: on the same equation, and on the full system."""
    words = []
    for sampled in study.routes:
        if not sampled.sampled or sampled.equation == FULL:
            continue
        others = [r for r in study.routes if r.equation == sampled.equation and r is not sampled]
        best = min(sampled.points, key=lambda p: p.seconds)
        if (fastest := _fastest(others, best.error)) < best.seconds:
            words.append(
                f"Monte Carlo of {sampled.equation} does not pay at any error measured: at"
                f" {best.error:.1e} it takes {best.seconds / fastest:.0f} times as long as the"
                " cheapest solver."
            )
    full = [r for r in study.routes if r.equation == FULL]
    for m in study.models:
        if (fastest := _fastest(full, max(m.distance, m.error))) == np.inf:
            continue
        ratio = fastest / m.seconds
        verb = "beats" if ratio > 1 else "does not beat"
        words.append(
            f"As an answer to the full system the {m.theory} theory is off by"
            f" L1 = {m.distance:.1e} ± {m.error:.0e}; it {verb}"
            f" simulation above that error (by a factor {max(ratio, 1 / ratio):.0f}), and below it"
            " only simulation answers."
        )
    return tuple(words)


def _fastest(routes: list[Priced], error: float) -> float:
    """Return the least time for ``error``, infinite where no route reached it."""
    return float(np.nanmin([np.inf, *(float(r.seconds_for(np.array(error))) for r in routes)]))


def _models(study: CostStudy) -> Table:
    rows = [(*astuple(m)[:-1], duration(m.seconds)) for m in study.models]
    head = "theory | of | averaging error | known to | time"
    words = f"Averaging error: L1 to the full system ({study.full_reference}); no solver lowers it."
    return Table("What the theories are worth for the full system", head, rows, (words,))


def _not_timed(study: CostStudy) -> Table:
    head = "route | equation | settings | L1 distance | stated | why it is not timed"
    return Table("Routes that are not timed", head, [astuple(n)[:-1] for n in study.not_timed])


def _laws(study: CostStudy) -> Table:
    rows = [
        (law.scheme, law.noise, law.bias, law.bias_resolved, law.order, law.largest, 1e9 * law.step)
        for law in study.laws
    ]
    head = "scheme | A | B | B resolved | r (theory) | largest dt | ns a particle step"
    words = (
        "L1 = A/√(paths x time) + B dt^r, B an upper bound where it is not resolved; (dt, N) is the"
        " cheapest path under it, one thread."
    )
    return Table(f"{FULL}: law of sampling", head, rows, (words,))


def _measured(equation: str, routes: list[Priced]) -> Table:
    rows = [
        (
            *(route.route, p.settings, p.error, p.stated, p.unknowns or None),
            *map(duration, (t.seconds, t.spread, t.first, t.coefficients)),
            megabytes(t.memory),
        )
        for route in routes
        for p in route.points
        if not p.modelled
        for t in [p.timing]
    ]
    head = "route | settings | L1 error | stated | unknowns | median | spread | first call more"
    axes = tuple(dict.fromkeys(r.axis for r in routes))
    return Table(f"{equation}: measurements", f"{head} | coefficients | memory", rows, axes)


def cost_panels(study: CostStudy) -> list[Panel]:
    """Return a panel for each equation: error against time of every route.

    Open markers and dotted lines are prices by the law of sampling; dashed levels are the averaging
    error, which no solver lowers.
    """
    panels = []
    marks = [(m.distance, f"averaging error of the {m.theory} theory") for m in study.models]
    for equation, routes in by_equation(study.routes):
        curves = [
            Curve(
                route.route,
                [p.seconds for p in points],
                [p.error for p in points],
                style=":" if points[-1].modelled else "-",
                end=points[-1].settings.rpartition(", ")[2],
            )
            for route in routes
            if (points := _drawn(route))
        ]
        full = equation == FULL
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


def _drawn(route: Priced) -> list[Level]:
    return [
        p
        for p in route.points
        if p.error > (0.99 * DRAWN if p.modelled else 0.0)
        and (p.seconds <= LONGEST or not p.modelled)
    ]


def _rows(study: CostStudy) -> list[dict[str, Any]]:
    times = ("seconds", "spread", "first", "coefficients", "memory")
    return [
        {
            "route": r.route,
            "equation": r.equation,
            "axis": r.axis,
            "settings": p.settings,
            **{key: float(getattr(p, key)) for key in ("error", "stated", "unknowns", "modelled")},
            **{key: getattr(p.timing, key) for key in times},
        }
        for r in study.routes
        for p in r.points
    ]
