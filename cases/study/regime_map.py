"""The map of regimes: a sweep of averaging errors, the nearer theory at its points, its page."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from cases.compare.quantity import AVERAGING
from cases.scene.numbers import with_numbers
from cases.scene.scene import Scene
from cases.show.pictures.panel import Field, Panel, spans_decades
from cases.show.pictures.style import COLOURS
from cases.show.records import Record
from cases.show.study_page import Page, Table
from cases.show.variables import Variables
from cases.show.words import reader_words, stationary_note
from cases.study.sweep.answering import REFERENCE_TOL
from cases.study.sweep.sweep import Sweep, sweep
from fpk.answer.contacts import CLEARANCE_RULE, stop_clearances
from fpk.answer.names import Observable, observable_name

THEORIES = ("nonintegrable", "integrable")
"""Averaged methods that are mapped, in the order of the pictures."""
UNDECIDED, NEITHER = "undecided", "neither"
"""Winners where the difference is within the errors, and where no theory applies."""


@dataclass(frozen=True)
class RegimeMap:
    """The points of a map in the order of the ``sweep`` of averaging errors that it is made of.

    A point has the distances of the theories to the full system there: ``L1`` and ``error`` by
    theory, without the theories that do not apply; ``reference``, the route that solved the full
    system, empty if no theory applies; ``rms_ratio``, the smallest clearance over the rms
    displacement without contact, None if it is not known; and ``winner``, the nearer theory, or
    ``UNDECIDED``, or ``NEITHER``. ``values``, ``problems``, ``seconds`` are of the ``SweepPoint``.
    """

    scene: Scene
    observable: Observable
    sweep: Sweep
    points: tuple[Record, ...]

    @property
    def problems(self) -> tuple[str, ...]:
        """Every failure at a point, in words that begin with its place: ``B = 10, δ = 0.5``."""
        return self.sweep.problems

    def record(self) -> dict[str, Any]:
        """Return what ``fpk regime`` writes as JSON, not yet converted by ``plain``."""
        swept = self.sweep.record()
        own = {key: swept[key] for key in ("scene", "axes", "reused", "seconds")}
        return {**own, "observable": observable_name(self.observable), "points": self.points}

    def variables(self) -> Variables:
        """Return the variables of the sweep, "rms_ratio", "winner" and "reference" (axes)."""
        axes = self.sweep.axes
        kinds = ("rms_ratio", float), ("winner", str), ("reference", str)
        words = {"long_name": "smallest clearance over rms displacement without contact"}
        return self.sweep.variables() | {
            key: (
                tuple(axis.dimension for axis in axes),
                np.array([p[key] for p in self.points], dtype=kind).reshape(
                    [axis.values.size for axis in axes]
                ),
                words if key == "rms_ratio" else {},
            )
            for key, kind in kinds
        }

    def page(self) -> Page:
        """Return the page of ``fpk regime``: every point, and how often each theory is nearer."""
        swept, theories = self.sweep, self.sweep.methods
        rows = [
            {
                **dict(zip(swept.heads(), p["values"], strict=True)),
                **{f"L1 {reader_words(t)}": p["L1"].get(t) for t in theories},
                **{f"error {reader_words(t)}": p["error"].get(t) for t in theories},
                **{key: p[key] for key in ("winner", "reference", "rms_ratio")},
            }
            for p in self.points
        ]
        counts = Counter(p["winner"] for p in self.points)
        winners = [word for word in (*theories, UNDECIDED, NEITHER) if counts[word]]
        summary = (
            f"p({observable_name(self.observable)}), {len(self.points)} points"
            f" ({swept.reused} from disk), nearer to the full system: "
            + ", ".join(f"{reader_words(word)} {counts[word]}" for word in winners)
        )
        words = (
            "L1 is the distance of a theory to the full system, rms_ratio the least clearance over"
            " the rms displacement without contact."
        )
        remarks = (summary, words, *filter(None, [stationary_note(self.scene.system)]))
        return Page(
            "regime",
            self.scene,
            f"Map of regimes: {self.scene.title}",
            [Table("points", "Distances", rows, remarks, parameters=len(swept.axes))],
            self.panels(),
            summary=summary,
            gridded=self.variables(),
        )

    def panels(self) -> list[Panel] | list[Field]:
        """Return a map over one parameter as curves, over two as fields."""
        fields, theories = self.variables(), list(map(reader_words, self.sweep.methods))
        (L1,), (error,), ratio, winner = (
            fields[k][1] for k in ("value", "error", "rms_ratio", "winner")
        )
        if len(self.sweep.axes) == 1:
            return self.sweep.panels()
        x, y = self.sweep.axes
        # Colours end at the error of a reference: beyond it chance decides.
        low = max(np.nanmin(L1, initial=0.1), REFERENCE_TOL)
        high = max(np.nanmax(L1, initial=REFERENCE_TOL), 2.0 * low)
        border: dict[str, Any] = {
            "split": ratio < CLEARANCE_RULE,
            "border": f"clearance = {CLEARANCE_RULE:g} rms",
        }
        distances = [
            Field(f"L₁, {name}", x, y, L, e, logarithmic=True, limits=(low, high), **border)
            for name, L, e in zip(theories, L1, error, strict=True)
        ]
        winners = [*self.sweep.methods, UNDECIDED]
        index = np.select([winner == name for name in winners], [0.0, 1.0, 2.0], np.nan)
        nearer = (*zip(theories, COLOURS, strict=False), ("within the errors", "#d9d9d4"))
        return [
            *distances,
            Field("nearer to the full system", x, y, index, categories=nearer, **border),
            Field("clearance over rms", x, y, ratio, logarithmic=spans_decades(ratio), **border),
        ]


def build_map(scene: Scene, vary: Sequence[str], **settings: Any) -> RegimeMap:
    """Return the map of the scene's first displacement, else of its first observable.

    A displacement of a pair is taken if no displacement is observed alone. ``vary``, the
    ``settings`` ``simulation``, ``reference``, ``folder`` and ``progress`` and the exceptions are
    documented in ``sweep``.
    """
    displacements = [c for o in sorted(scene.observables, key=len) for c in o if c.kind == "q"]
    observable = tuple(displacements[:1]) or scene.observables[0]
    quantity = f"{AVERAGING}({observable_name(observable)})"
    swept = sweep(scene, vary, [quantity], methods=THEORIES, silent_methods=True, **settings)
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
            {
                "values": point.values,
                "L1": {name: value for name, (value, _) in distances.items()},
                "error": {name: error for name, (_, error) in distances.items()},
                "reference": max(a.reference for a in point.answers),
                "rms_ratio": min(ratios, default=None),
                "winner": winner_of(distances),
                "problems": point.problems,
                "seconds": point.seconds,
            }
        )
    return RegimeMap(scene, observable, swept, tuple(points))


def winner_of(distances: dict[str, tuple[float, float]]) -> str:
    """Return the theory with the smallest distance, if the others exceed it by the sum of errors.

    ``distances`` have (L1, error) by theory. Else ``UNDECIDED``; ``NEITHER`` if empty. A theory
    alone is returned.
    """
    if not distances:
        return NEITHER
    nearer, *others = sorted(distances, key=lambda name: distances[name][0])
    slack = sum(error for _, error in distances.values())
    clear = all(distances[other][0] - distances[nearer][0] > slack for other in others)
    return nearer if clear else UNDECIDED
