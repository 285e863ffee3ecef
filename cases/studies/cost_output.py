"""A work-precision study as tables and files."""

from pathlib import Path

import numpy as np
import xarray as xr

from cases.output.fields import program_version
from cases.output.files import write_by, write_text
from cases.output.svg import svg_text
from cases.studies.cost import CostStudy
from cases.studies.cost_picture import cost_figure
from cases.studies.names import BY_TOL, EXPLAINED
from cases.studies.priced import Point
from cases.studies.sampling_law import FULL
from cases.studies.tables import Table, markdown_text, shown

UNITS = ((3.156e7, "a"), (86400.0, "d"), (3600.0, "h"), (60.0, "min"), (1.0, "s"), (1e-3, "ms"))
MEANING = (
    "Times are processor times on one thread: the wall time of a core that does nothing else, after"
    " a warm-up, the median of 3 to 21 runs where one takes less than a second. Every error is that"
    " of the route's own equation: numerical for the averaged equations, sampling and step for the"
    " full system. What averaging itself costs in accuracy is in a table of its own, and in none of"
    " the others. What a process remembers (integrals of two or more contact masses, of damping"
    " that depends on the state) is in the first call, not in the median."
)


def told_seconds(seconds: float) -> str:
    """Return a time with a unit that suits it."""
    if seconds != seconds:
        return "–"
    for size, unit in UNITS:
        if seconds >= size:
            value = seconds / size
            return f"{value:.3g} {unit}" if value < 1e4 else f"{value:.1e} {unit}"
    return f"{seconds * 1e3:.2g} ms"


def told_bytes(size: float) -> str:
    """Return a memory in MB."""
    return "–" if size != size else f"{size / 1e6:.2g} MB"


def cost_tables(study: CostStudy) -> list[Table]:
    """Return the price list of every equation, crossovers, averaging errors, all measurements."""
    tables = [_prices(study, name) for name in dict.fromkeys(c.equation for c in study.prices)]
    if study.promises:
        tables.append(_promises(study))
    tables.append(_crossings(study))
    if study.models:
        tables.append(_models(study))
    if study.not_timed:
        tables.append(_not_timed(study))
    if study.laws:
        tables.append(_laws(study))
    tables += [_measured(study, name) for name in dict.fromkeys(r.equation for r in study.routes)]
    return tables


def _prices(study: CostStudy, equation: str) -> Table:
    rows = []
    for c in study.prices:
        if c.equation != equation:
            continue
        if c.point is None:
            rows.append((str(c.digits), "reached by none here", "–", "–", "–"))
            continue
        rows.append(
            (
                str(c.digits),
                c.route,
                c.point.settings,
                ("≈ " if c.point.modelled else "") + told_seconds(c.point.seconds),
                told_bytes(c.point.timing.memory),
            )
        )
    remarks = ["≈: by the law of sampling, not run."] if equation == FULL else []
    there = {r.route for r in study.routes if r.equation == equation}
    remarks += [EXPLAINED[d] for d, name in BY_TOL.items() if name in there]
    head = ("digits", "route", "settings", "time", "memory")
    return Table(f"{equation}: to get so many digits (L1)", head, tuple(rows), tuple(remarks))


def _promises(study: CostStudy) -> Table:
    """The same question for a scene that was not measured: tolerances keep what they promise."""
    rows = [
        (
            c.equation,
            str(c.digits),
            c.route,
            f"tol = {c.point.settings}",
            told_seconds(c.point.seconds),
            told_bytes(c.point.timing.memory),
        )
        for c in study.promises
        if c.point is not None
    ]
    head = ("equation", "digits", "route", "settings", "time here", "memory")
    words = (
        "Numbers of elements above are right for this scene. A tolerance is met on every scene, or"
        " the answer is not certified: --tol of fpk run and fpk density is this setting."
    )
    return Table("Settings that hold for other scenes", head, tuple(rows), (words,))


def _crossings(study: CostStudy) -> Table:
    rows = [(c.equation, shown(c.error, 1), c.above, c.below) for c in study.crossings]
    for equation in dict.fromkeys(r.equation for r in study.routes):
        if not any(c.equation == equation for c in study.crossings):
            rows.append((equation, "–", "one route is cheapest at every error measured", ""))
    return Table(
        "Where another route becomes the cheapest",
        ("equation", "below the error", "from", "to"),
        tuple(rows),
        _pays(study),
    )


def _pays(study: CostStudy) -> tuple[str, ...]:
    """Where Monte Carlo stops paying, in words: on the same equation, and on the full system."""
    found = []
    sampled = next((r for r in study.routes if r.route == "simulation of (24)"), None)
    others = [r for r in study.routes if sampled and r.equation == sampled.equation]
    if sampled:
        best = min(sampled.points, key=lambda p: p.seconds)
        times = [r.seconds_for(best.error) for r in others if r is not sampled]
        times = [t for t in times if t == t]
        if times and min(times) < best.seconds:
            found.append(
                f"Monte Carlo of (24) does not pay at any error measured: at {best.error:.1e} it"
                f" takes {best.seconds / min(times):.0f} times as long as the cheapest solver."
            )
    full = [r for r in study.routes if r.equation == FULL]
    for m in study.models:
        simulated = [r.seconds_for(max(m.distance, m.error)) for r in full]
        simulated = [t for t in simulated if t == t]
        if not simulated:
            continue
        ratio = min(simulated) / m.seconds
        words = "beats" if ratio > 1 else "does not beat"
        found.append(
            f"As an answer to the full system the {m.theory} theory is off by"
            f" L1 = {m.distance:.1e} ± {m.error:.0e}; it {words} simulation above that error (by a"
            f" factor {max(ratio, 1 / ratio):.0f}), and below it only simulation answers."
        )
    return tuple(found)


def _models(study: CostStudy) -> Table:
    rows = [
        (
            m.theory,
            f"p({m.observable})",
            shown(m.distance),
            shown(m.error, 0),
            told_seconds(m.seconds),
        )
        for m in study.models
    ]
    head = ("theory, closed form", "of", "averaging error", "known to", "time")
    words = f"Averaging error: L1 to the full system ({study.full_reference}); no solver lowers it."
    return Table("What the theories are worth for the full system", head, tuple(rows), (words,))


def _not_timed(study: CostStudy) -> Table:
    rows = [
        (n.route, n.equation, n.settings or "–", shown(n.distance), shown(n.allowed), n.reason)
        for n in study.not_timed
    ]
    head = ("route", "equation", "settings", "L1 distance", "stated", "why it is not timed")
    return Table("Routes that are not timed", head, tuple(rows))


def _laws(study: CostStudy) -> Table:
    rows = [
        (
            law.scheme,
            f"{law.noise:.3g}",
            ("" if law.bias_resolved else "< ") + f"{law.bias:.3g}",
            str(law.order),
            f"{law.largest:.3g}",
            f"{1e9 * law.step:.3g}",
        )
        for law in study.laws
    ]
    head = ("scheme", "A", "B", "r (theory)", "largest dt", "ns a particle step")
    words = "L1 = A/√(paths x time) + B dt^r; (dt, N) is the cheapest path under it, one thread."
    return Table(f"{FULL}: law of sampling", head, tuple(rows), (words,))


def _measured(study: CostStudy, equation: str) -> Table:
    rows = [
        (route.route if k == 0 else "", *_row(point))
        for route in study.routes
        if route.equation == equation
        for k, point in enumerate(p for p in route.points if not p.modelled)
    ]
    axes = dict.fromkeys(r.axis for r in study.routes if r.equation == equation)
    first = ("route", "settings", "L1 error", "stated", "unknowns", "median", "spread")
    head = (*first, "first call more", "coefficients", "memory")
    return Table(f"{equation}: measurements", head, tuple(rows), tuple(axes))


def _row(p: Point) -> tuple[str, ...]:
    t = p.timing
    return (
        p.settings,
        shown(p.error),
        shown(p.stated),
        str(p.unknowns) if p.unknowns else "–",
        told_seconds(t.seconds),
        told_seconds(t.spread),
        told_seconds(t.first),
        told_seconds(t.coefficients),
        told_bytes(t.memory),
    )


def write_cost(study: CostStudy, folder: Path) -> list[Path]:
    """Write ``cost.md``, ``cost.nc`` and ``cost.svg``; return their paths."""
    paths = [folder / f"cost.{ending}" for ending in ("md", "nc", "svg")]
    page = markdown_text(f"What accuracy costs: {study.scene.title}", cost_tables(study))
    write_text(paths[0], f"{page}\n{MEANING}\n")
    data = cost_dataset(study)
    write_by(paths[1], lambda temporary: data.to_netcdf(temporary, engine="h5netcdf"))
    write_text(paths[2], svg_text(cost_figure(study), salt="cost"))
    return paths


def cost_dataset(study: CostStudy) -> xr.Dataset:
    """Return one row a point: route, equation, settings, error, seconds, memory."""
    points = [(r, p) for r in study.routes for p in r.points]
    text = {
        "route": [r.route for r, _ in points],
        "equation": [r.equation for r, _ in points],
        "axis": [r.axis for r, _ in points],
        "settings": [p.settings for _, p in points],
    }
    data = xr.Dataset({key: ("point", np.array(value, dtype=str)) for key, value in text.items()})
    for key in ("error", "stated", "unknowns", "modelled"):
        data[key] = ("point", np.array([float(getattr(p, key)) for _, p in points]))
    for key in ("seconds", "spread", "first", "coefficients", "memory"):
        data[key] = ("point", np.array([float(getattr(p.timing, key)) for _, p in points]))
    data.attrs = {
        "title": f"What accuracy costs: {study.scene.title}",
        "meaning": MEANING,
        "scene": study.scene.name,
        "scene_file": study.scene.text,
        "program": f"vibro-fpk {program_version()}",
    }
    return data
