"""The answers for one system by several methods, and what is wrong with them."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from cases.compare.attempts import Refusal
from cases.compare.compare import Comparison, compare_densities, discrepancies
from cases.compare.doubt import incompatibility, notes_in_words, tails_off, unknown_averaging_errors
from cases.compare.in_time import Replies
from cases.compare.quantities import (
    Quantity,
    compare_quantities,
    quantities_of,
    quantity_discrepancies,
)
from fpk.answer.density import AnyDensity
from fpk.answer.method import Result, Route
from fpk.answer.names import Level, Observable, observable_name, parse_observable
from fpk.system.system import System
from sim.montecarlo import MonteCarlo


@dataclass(frozen=True, repr=False)
class Answers(Mapping[Any, AnyDensity]):
    """Densities by observable and method: ``answers["q2", "exact"]``, as names or labels.

    ``answers["q2"]`` suffices if one method alone gives q2; ``answers.of("q2")`` returns all by
    method. ``results``: of each method that answered; ``refused``: the methods that do not give all
    observables, with the reason. ``label`` and ``value`` are the fields of a scene's ``Curve``;
    ``notes``: loosened tolerances and the like; ``interrupted``: Ctrl-C ended the work.
    ``passages`` and ``transients``: the replies to the scene's questions about motion in time.
    ``exceedance``: levels a whose P(X > a) is among the quantities. ``asked``: observables whose
    stationary density, if it exists, must be given by some route. ::

        answers = fpk.solve(fpk.load("fig3a").system, ["q2"])
        answers["q2", "exact"], answers.of("q2"), answers.refusals, answers.problems
        answers.quantities, answers.quantity_comparisons, answers.comparisons
    """

    system: System
    results: tuple[Result, ...]
    refused: tuple[Refusal, ...] = ()
    label: str = ""
    value: float | None = None
    notes: tuple[str, ...] = ()
    interrupted: bool = False
    passages: tuple[Replies, ...] = ()
    transients: tuple[Replies, ...] = ()
    exceedance: tuple[Level, ...] = ()
    asked: tuple[Observable, ...] = ()

    @property
    def in_time(self) -> tuple[Replies, ...]:
        """The replies to all questions about motion in time."""
        return self.passages + self.transients

    @property
    def refusals(self) -> dict[str, str]:
        """Why a method does not give all observables, the last of its reasons, by its label."""
        return {refusal.route.label: refusal.reason for refusal in self.refused}

    @property
    def _averaging_is_exact(self) -> bool:
        return incompatibility(self.system) is None

    @cached_property
    def comparisons(self) -> tuple[Comparison, ...]:
        """Distances of all pairs of densities of one observable, judged where that is possible."""
        return compare_densities(self.results, averaging_is_exact=self._averaging_is_exact)

    @cached_property
    def quantities(self) -> tuple[Quantity, ...]:
        """Moments, quantiles, impacts and forces, each by every route that gives its density."""
        return quantities_of(self.system, self.results, self.exceedance)

    @cached_property
    def quantity_comparisons(self) -> tuple[Comparison, ...]:
        """Differences of all pairs of routes in one quantity, judged where that is possible."""
        exact = self._averaging_is_exact
        return compare_quantities(self.results, self.quantities, averaging_is_exact=exact)

    def densities(self, observable: Observable) -> dict[Route, AnyDensity]:
        """Return the densities of one observable by route: first deterministic ones, then sampled.

        In both groups densities of the full system precede averaged ones.
        """
        all_of = [(r.method.route, d) for r in self.results for d in r.densities]
        pairs = [(route, d) for route, d in all_of if d.observable == observable]
        return dict(sorted(pairs, key=lambda pair: (pair[0].sampled, pair[0].solves != "full")))

    def of(self, observable: str) -> dict[str, AnyDensity]:
        """Return the densities of ``observable`` by the label of the method, empty without any."""
        densities = self.densities(parse_observable(observable, self.system.n))
        return {route.label: density for route, density in densities.items()}

    def __getitem__(self, key: str | tuple[str, str]) -> AnyDensity:
        """Return the density of ``key``: an observable, or (observable, label of the method).

        Raises ``KeyError`` naming the densities there are if ``key`` has none, or several.
        """
        observable, method = (key, None) if isinstance(key, str) else key
        densities = self.of(observable)
        if method is None and len(densities) == 1:
            return next(iter(densities.values()))
        if method in densities:
            return densities[method]
        if not densities:
            there = ", ".join(dict.fromkeys(name for name, _ in self))
            raise KeyError(f"no density of {observable}; there are densities of {there}")
        labels = ", ".join(densities)
        raise KeyError(f"say by which method, as in answers[{observable!r}, ...]: {labels}")

    def __iter__(self) -> Iterator[tuple[str, str]]:
        """Iterate over the pairs (name of the observable, label of the method)."""
        return ((d.name, r.method.route.label) for r in self.results for d in r.densities)

    def __len__(self) -> int:
        """Return the number of densities."""
        return sum(len(result.densities) for result in self.results)

    def __repr__(self) -> str:
        """Return the pairs in one line."""
        return f"Answers({', '.join(f'{o} by {m}' for o, m in self)})"

    def neglects(self, route: Route) -> bool:
        """Whether the answer of ``route`` leaves out an effect of the system."""
        return any(r.neglected for r in self.results if r.method.route == route)

    def is_exact(self, route: Route) -> bool:
        """Whether ``route`` has no averaging error: full system, or (8) and no neglected effect."""
        return route.solves == "full" or (self._averaging_is_exact and not self.neglects(route))

    @cached_property
    def unknown_averaging_errors(self) -> dict[str, list[str]]:
        """Notes on averaging errors that are not known, each with the names of its answers.

        The names are of observables and questions that only averaged equations answer. There is no
        note if averaging is exact.
        """
        of = dict.fromkeys(d.observable for d in self.values())
        densities = [(observable_name(o), self.densities(o), False) for o in of]
        in_time = [(r.question.name, [g.route for g in r.given], True) for r in self.in_time]
        return unknown_averaging_errors(self.system, [*densities, *in_time])

    @property
    def averaging_notes(self) -> tuple[str, ...]:
        """The notes of ``unknown_averaging_errors``, each behind the names of its answers."""
        return notes_in_words(self.unknown_averaging_errors)

    @cached_property
    def tails(self) -> tuple[dict[str, Any], ...]:
        """Rows of ``tails_off``: tails that theories miss by a factor; none for modulated noise."""
        if self.system.modulation is not None:
            return ()
        of = dict.fromkeys(d.observable for d in self.values() if len(d.observable) == 1)
        return tuple(row for o in of for row in tails_off(self.densities(o)))

    @property
    def answered(self) -> bool:
        """Whether any route gave a density, or the answer to a question about motion in time."""
        return bool(self.results) or any(replies.given for replies in self.in_time)

    @property
    def absence(self) -> str | None:
        """Why the system has no stationary density; None if it has, or if a route gave one."""
        return None if self.results else MonteCarlo().refusal(self.system, ())

    @property
    def problems(self) -> tuple[str, ...]:
        """Every check that does not hold, in words; empty when all do."""
        problems = list(discrepancies(self.comparisons))
        problems += quantity_discrepancies(self.quantity_comparisons, self.comparisons)
        problems += [
            f"{d.name}: {r.method.route.label} is not certified: {failure}"
            for r in self.results
            for d in r.densities
            for failure in d.certificate.failures
        ]
        problems += [f"{r.route.label} failed: {r.reason}" for r in self.refused if r.failed]
        problems += [problem for replies in self.in_time for problem in replies.problems]
        absence = self.absence
        if not self.refused and not self.results:
            problems.append("not run: the program was interrupted")
        elif not self.answered and not problems:
            reasons = dict.fromkeys([absence] if absence else [r.reason for r in self.refused])
            problems.append(f"no route applies: {'; '.join(reasons)}")
        elif self.answered and not (self.interrupted or absence):
            failed = {name for r in self.refused if r.failed for name in r.observables}
            names = {observable_name(o) for o in self.asked if not self.densities(o)} - failed
            words = "no route gives its stationary density; --details says why"
            problems += [f"{name}: {words}" for name in sorted(names)]
        return tuple(f"{self.label}: {p}" if self.label else p for p in problems)
