"""The map of regimes: a sweep of averaging errors, the nearer theory at its points, its page."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from cases.compare.quantity import AVERAGING
from cases.scene.numbers import with_numbers
from cases.scene.scene import Scene
from cases.scene.units import bracketed
from cases.show.pictures.panel import Field, Panel, curves_over, spans_decades
from cases.show.pictures.style import COLOURS, symbol_of
from cases.show.study_page import Page, Table
from cases.show.variables import Variables
from cases.show.words import named, stationary_note
from cases.study.sweep.answering import SIMULATION
from cases.study.sweep.result import Sweep
from cases.study.sweep.sweep import every_answer
from fpk.answer.contacts import CLEARANCE_RULE, stop_clearances
from fpk.answer.method import Progress, silent
from fpk.answer.names import Observable, observable_name
from sim.montecarlo import MonteCarlo

THEORIES = ("nonintegrable", "integrable")
"""Averaged methods that are mapped, in the order of the pictures."""
UNDECIDED, NEITHER = "undecided", "neither"
"""Winners where the difference is within the errors, and where no theory applies."""
PALE = "#d9d9d4"
"""Colour of points at which the difference is within the errors."""
SMALLEST = 1e-4
"""L1 distance at which the colours end: chance moves it by more."""


@dataclass(frozen=True)
class MapPoint:
    """Measured distances of the theories at one grid point.

    ``L1`` and ``error`` by theory; a theory that does not apply is left out. ``reference`` is the
    route that they are held against, empty where no theory applies; ``rms_ratio`` the smallest
    clearance over the rms displacement without contact; ``winner`` the nearer theory, or
    ``UNDECIDED``, or ``NEITHER``; ``problems`` what failed or was not certified.
    """

    values: tuple[float, ...]
    L1: dict[str, float]
    error: dict[str, float]
    reference: str
    rms_ratio: float | None
    winner: str
    problems: tuple[str, ...]
    seconds: float


@dataclass(frozen=True)
class RegimeMap:
    """The points of a map in the order of the ``sweep`` of averaging errors that it is made of."""

    scene: Scene
    observable: Observable
    sweep: Sweep
    points: tuple[MapPoint, ...]

    @property
    def problems(self) -> tuple[str, ...]:
        """Every failure at a point, in words that begin with its place: ``B = 10, δ = 0.5``."""
        return self.sweep.problems

    def record(self) -> dict[str, Any]:
        """Return the record of ``fpk regime`` as ``plain`` takes it."""
        swept = self.sweep.record()
        return {
            "scene": self.scene.name,
            "observable": observable_name(self.observable),
            "axes": swept["axes"],
            "points": self.points,
            "reused": swept["reused"],
            "seconds": swept["seconds"],
        }


def build_map(
    scene: Scene,
    vary: Sequence[str],
    *,
    simulation: MonteCarlo = SIMULATION,
    reference: str = SIMULATION.route.method,
    folder: Path | None = None,
    progress: Progress = silent,
) -> RegimeMap:
    """Return the map of the scene's first displacement, one in a pair if no other is observed.

    ``vary`` and what it raises are as of ``sweep``. Finished points are stored in ``folder``, and
    the map goes on from them. ``reference`` is the method that the theories are held against where
    the full system's density is not exact: that of ``simulation``, or one that solves (6) to
    ``REFERENCE_TOL``, or to what its work unasked allows; ``simulation`` where it does not apply.
    The ``cluster`` of ``simulation`` takes whole points.
    """
    displacements = [c for o in sorted(scene.observables, key=len) for c in o if c.kind == "q"]
    observable = tuple(displacements[:1]) or scene.observables[0]
    swept = every_answer(
        scene, vary, [f"{AVERAGING}({observable_name(observable)})"], methods=THEORIES,
        simulation=simulation, reference=reference, folder=folder, progress=progress,
    )  # fmt: skip
    keys = [axis.key for axis in swept.axes]
    points = []
    for point in swept.points:
        system = with_numbers(scene.system, dict(zip(keys, point.values, strict=True)))
        ratios = [s.ratio for s in stop_clearances(system) if s.ratio is not None]
        distances = {
            a.method: (a.value, a.error)
            for a in point.answers
            if a.value is not None and a.error is not None
        }
        points.append(
            MapPoint(
                values=point.values,
                L1={name: value for name, (value, _) in distances.items()},
                error={name: error for name, (_, error) in distances.items()},
                reference=max(a.reference for a in point.answers),
                rms_ratio=min(ratios, default=None),
                winner=winner_of(distances),
                problems=point.problems,
                seconds=point.seconds,
            )
        )
    return RegimeMap(scene, observable, swept, tuple(points))


def winner_of(distances: dict[str, tuple[float, float]]) -> str:
    """Return the theory whose distance is smaller beyond the errors of both."""
    if not distances:
        return NEITHER
    nearer, *others = sorted(distances, key=lambda name: distances[name][0])
    slack = sum(error for _, error in distances.values())
    clear = all(distances[other][0] - distances[nearer][0] > slack for other in others)
    return nearer if clear else UNDECIDED


def map_page(result: RegimeMap) -> Page:
    """Return what ``fpk regime`` shows and writes: every point, and how often each is nearer."""
    swept, name = result.sweep, observable_name(result.observable)
    keys = tuple(axis.dimension for axis in swept.axes)

    def field(key: str, kind: type) -> Any:
        shape = [axis.values.size for axis in swept.axes]
        return np.array([getattr(p, key) for p in result.points], dtype=kind).reshape(shape)

    heads = [a.key + bracketed(a.unit) for a in swept.axes]
    rows = [
        {
            **dict(zip(heads, p.values, strict=True)),
            **{f"L1 {named(t)}": p.L1.get(t) for t in THEORIES},
            **{f"error {named(t)}": p.error.get(t) for t in THEORIES},
            "winner": p.winner,
            "reference": p.reference,
            "rms_ratio": p.rms_ratio,
        }
        for p in result.points
    ]
    counts = Counter(p.winner for p in result.points)
    winners = [word for word in (*THEORIES, UNDECIDED, NEITHER) if counts[word]]
    summary = (
        f"p({name}), {len(result.points)} points ({swept.reused} from disk),"
        " nearer to the full system: "
        + ", ".join(f"{named(word)} {counts[word]}" for word in winners)
    )
    words = (
        "L1 is the distance of a theory to the full system, rms_ratio the least clearance over the"
        " rms displacement without contact."
    )
    distance = f"L1 distance of p({name}) to the full system"
    moved = "how far chance and the solvers may have moved L1"
    ratio = "smallest clearance over rms displacement without contact"
    fields: Variables = {
        "theory": (("theory",), np.array(THEORIES), {}),
        **swept.coordinates(),
        "L1": (("theory", *keys), swept.field("value")[0], {"long_name": distance}),
        "error": (("theory", *keys), swept.field("error")[0], {"long_name": moved}),
        "rms_ratio": (keys, field("rms_ratio", float), {"long_name": ratio}),
        **{key: (keys, field(key, str), {}) for key in ("winner", "reference")},
    }
    return Page(
        "regime",
        result.scene,
        f"Map of regimes: {result.scene.title}",
        [
            Table(
                "points",
                "Distances",
                rows,
                (summary, words, *filter(None, [stationary_note(result.scene.system)])),
                parameters=len(heads),
            )
        ],
        regime_panels(result, fields),
        summary=summary,
        gridded=fields,
    )


def regime_panels(result: RegimeMap, fields: Variables) -> list[Panel] | list[Field]:
    """Return a map over one parameter as curves, over two as fields."""
    L1, error, ratio, winner = (fields[key][1] for key in ("L1", "error", "rms_ratio", "winner"))
    words = f"L₁ distance of p({symbol_of(result.observable[0])}) to the full system"
    axes = result.sweep.axes
    if len(axes) == 1:
        (axis,) = axes
        curves = curves_over(axis, [named(t) for t in THEORIES], L1, error)
        title = result.scene.title
        return [Panel(title, axis.label, words, curves, logarithmic=axis.logarithmic, by_x=True)]
    x, y = axes
    low = max(np.nanmin(L1, initial=0.1), SMALLEST)
    border: dict[str, Any] = {
        "split": ratio < CLEARANCE_RULE,
        "border": f"clearance = {CLEARANCE_RULE:g} rms",
    }
    distances: dict[str, Any] = {
        "logarithmic": True,
        "limits": (low, max(np.nanmax(L1, initial=SMALLEST), 2.0 * low)),
        **border,
    }
    index = np.select([winner == name for name in (*THEORIES, UNDECIDED)], [0.0, 1.0, 2.0], np.nan)
    nearer = (*zip(map(named, THEORIES), COLOURS, strict=False), ("within the errors", PALE))
    return [
        *(
            Field(f"L₁, {named(name)}", x, y, *of, **distances)
            for name, *of in zip(THEORIES, L1, error, strict=True)
        ),
        Field("nearer to the full system", x, y, index, categories=nearer, **border),
        Field("clearance over rms", x, y, ratio, logarithmic=spans_decades(ratio), **border),
    ]
