"""Answers about motion after a start by every route that gives them, and what separates them.

The three errors are those of ``compare``. An averaged equation is never exact in time, whatever
its stationary density: what is left between it and the full system is its averaging error.
"""

from dataclasses import dataclass
from functools import cached_property
from itertools import combinations
from typing import Any

import numpy as np

from cases.comparison.attempts import Refusal
from cases.comparison.compare import Comparison, discrepancies, what_is_measured
from cases.comparison.time_distances import density_distances, passage_distances
from cases.scene.questions import Question
from fpk.arrays import Array
from fpk.evolution import Passage, Transient
from fpk.route import Route


@dataclass(frozen=True, eq=False)
class Given:
    """The answer of a route to a question and the seconds that it took."""

    route: Route
    answer: Passage | Transient
    seconds: float


@dataclass(frozen=True, eq=False)
class Replies:
    """The answers of all routes to one question, and the routes that give none.

    Of a transient, ``points`` (points,) are those of all its densities, ascending, and ``windows``
    holds for each time the indices of the points at which its density is compared and drawn; no
    windows where no route says where the density is large. ``notes`` say in words which default
    tolerances were missed.
    """

    question: Question
    given: tuple[Given, ...] = ()
    refused: tuple[Refusal, ...] = ()
    points: Array | None = None
    windows: tuple[Any, ...] = ()
    interrupted: bool = False
    notes: tuple[str, ...] = ()

    @cached_property
    def comparisons(self) -> tuple[Comparison, ...]:
        """The distances of all pairs of routes, but for pairs of two different theories."""
        rows: list[Comparison] = []
        solved = {g.route.method for g in self.given if not g.route.sampled}
        for a, b in combinations(self.given, 2):
            kind = what_is_measured(a.route, b.route, averaging_is_exact=False)
            if kind == "averaging" and "full" not in (a.route.solves, b.route.solves):
                continue
            if b.route.solves == "averaged":  # the full system is what others are held against
                a, b = b, a
            if kind == "averaging" and a.route.sampled and a.route.method in solved:
                continue  # a solution of the same equation says it better
            uncertified = tuple(g.route for g in (a, b) if not g.answer.certificate.certified)
            judged = kind != "averaging"
            if isinstance(a.answer, Passage) and isinstance(b.answer, Passage):
                distances = passage_distances(a.answer, b.answer, judged)
            else:
                assert isinstance(a.answer, Transient) and isinstance(b.answer, Transient)
                of = a.answer, b.answer, np.asarray(self.points), self.windows
                distances = density_distances(*of, judged)
            for name, norm, distance, error, band in distances:
                if judged and not np.isfinite(band):
                    continue  # nothing is stated: the answer is not certified
                allowed = band if judged else None
                words = f"{self.question.name}: {name}"
                rows.append(
                    Comparison(
                        words, a.route, b.route, kind, distance, allowed, error, uncertified, norm
                    )
                )
        return tuple(rows)

    @property
    def problems(self) -> tuple[str, ...]:
        """Every check that does not hold, in words."""
        name = self.question.name
        uncertified = [
            f"{name}: {g.route.label} is not certified: {failure}"
            for g in self.given
            for failure in g.answer.certificate.failures
        ]
        failed = [f"{name}: {r.route.label} failed: {r.reason}" for r in self.refused if r.failed]
        reason = "not run: the program was interrupted" if self.interrupted else "no route answers"
        none = [] if self.given or failed else [f"{name}: {reason}"]
        if self.points is not None and not self.windows:
            none.append(f"{name}: not compared: no route says where the densities are")
        return (*discrepancies(self.comparisons), *uncertified, *failed, *none)
