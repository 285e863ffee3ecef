"""The answers to the systems of a scene by several methods, and what is wrong with them."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from functools import partial as partial_of
from importlib import import_module
from math import ceil, inf, log10
from time import perf_counter
from typing import TYPE_CHECKING, Any

from averaging.exact import compatibility
from cases.comparison.answering import replies_of
from cases.comparison.compare import Comparison, compared, discrepancies
from cases.comparison.in_time import Replies
from cases.comparison.quantities import (
    Quantity,
    compared_quantities,
    quantities_of,
    quantity_discrepancies,
)
from cases.comparison.refusal import INTERRUPTED, REFUSALS, Attempts, Refusal
from cases.scene.questions import Question
from cases.scene.scene import Scene
from fpk.density import AnyDensity, Density
from fpk.errors import NotApplicable
from fpk.method import Method, Plan, Progress, Result, silent, solved
from fpk.observable import Observable, observable_name, parse_observable
from fpk.route import Route
from fpk.system import System

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from pandas import DataFrame
    from xarray import Dataset

LOOSEST = 1e-4
"""Largest tolerance that takes the place of a default one that is missed: it is still well below
what simulations resolve."""


@dataclass(frozen=True, repr=False)
class Answers(Mapping[Any, AnyDensity]):
    """Densities by observable and method: ``answers["q2", "exact"]``, as names or labels.

    ``answers["q2"]`` will do where one method alone gives q2; ``answers.of("q2")`` returns all by
    method. ``results`` has what each method returned, ``refused`` who gives not all that was asked
    for. Of a scene's curve ``label`` and ``value`` are as in ``Curve``; ``notes`` say in words what
    was done that nobody asked for, ``interrupted`` whether Ctrl-C ended the work. ``passages`` and
    ``transients`` are what was said to the scene's questions about motion in time.
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

    @property
    def in_time(self) -> tuple[Replies, ...]:
        """The replies to all questions about motion in time."""
        return self.passages + self.transients

    @property
    def refusals(self) -> dict[str, str]:
        """By the label of a method, why it gives not all that was asked for."""
        return {refusal.route.label: refusal.reason for refusal in self.refused}

    @cached_property
    def comparisons(self) -> tuple[Comparison, ...]:
        """Distances of all pairs of densities of one observable, judged where that is possible."""
        return compared(self.results, averaging_is_exact=incompatibility(self.system) is None)

    @cached_property
    def quantities(self) -> tuple[Quantity, ...]:
        """Moments, quantiles and what stops feel, each by every route that gives its density."""
        return quantities_of(self.system, self.results)

    @cached_property
    def quantity_comparisons(self) -> tuple[Comparison, ...]:
        """Differences of all pairs of routes in one quantity, judged where that is possible."""
        exact = incompatibility(self.system) is None
        return compared_quantities(self.results, self.quantities, averaging_is_exact=exact)

    def densities(self, observable: Observable) -> dict[Route, AnyDensity]:
        """Return the densities of one observable by route: first deterministic ones, then sampled.

        In both, those of the full system precede those of averaged equations.
        """
        all_of = [(r.method.route, d) for r in self.results for d in r.densities]
        pairs = [(route, d) for route, d in all_of if d.observable == observable]
        return dict(sorted(pairs, key=lambda pair: (pair[0].sampled, pair[0].solves != "full")))

    def of(self, observable: str) -> dict[str, AnyDensity]:
        """Return the densities of ``observable`` by the label of the method, empty where none."""
        densities = self.densities(parse_observable(observable, self.system.n))
        return {route.label: density for route, density in densities.items()}

    def __getitem__(self, key: str | tuple[str, str]) -> AnyDensity:
        """Return one density; raise ``KeyError`` with what there is where it is not one."""
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
        """Iterate over the pairs (observable, method)."""
        return ((d.name, r.method.route.label) for r in self.results for d in r.densities)

    def __len__(self) -> int:
        """Return the number of densities."""
        return sum(len(result.densities) for result in self.results)

    def __repr__(self) -> str:
        """Return the pairs in one line."""
        return f"Answers({', '.join(f'{o} by {m}' for o, m in self)})"

    def summary(self) -> "DataFrame":
        """Return the quantities as a data frame: rows by observable and quantity.

        Columns by route, each with ``value`` and ``error``. Needs pandas; raises ``Unavailable``
        without. ::

            fpk.solve(system, ["q2"], methods=["nonintegrable/fem"]).summary()
        """
        frame: DataFrame = presented().summary_frame(self)
        return frame

    def to_xarray(self) -> "Dataset":
        """Return the densities and their errors on common grids, as in the file of a run.

        ``p_q2`` (route_q2, q2) is the density, ``error_q2`` its error, of the kind that
        ``error_kind_q2`` says. Needs xarray; raises ``Unavailable`` without. ::

            fpk.solve(system, ["q2"], methods=["nonintegrable/fem"]).to_xarray()["p_q2"]
        """
        data: Dataset = presented().dataset(self)
        return data

    def plot(self, observable: str, *, log: bool = False) -> "Figure":
        """Return a figure of pyplot with the densities of ``observable`` by every route drawn.

        ``log``: on a logarithmic axis, down to 1e-6 of the largest. Raises ``InvalidInput`` for a
        pair, and for an observable that there is not. ::

            fpk.solve(system, ["q2"], methods=["nonintegrable/fem"]).plot("q2", log=True)
        """
        wanted = parse_observable(observable, self.system.n)
        figure: Figure = presented().plot(self, wanted, log=log)
        return figure

    def _repr_html_(self) -> str:
        """Return the quantities as tables, for a notebook."""
        return str(presented().html_tables(self))

    def neglects(self, route: Route) -> bool:
        """Whether the answer of ``route`` leaves out an effect of the system."""
        return any(r.neglected for r in self.results if r.method.route == route)

    def is_exact(self, route: Route) -> bool:
        """Whether ``route`` gives the exact density: by itself, or as condition (8) holds."""
        exact = incompatibility(self.system) is None and not self.neglects(route)
        return exact or route.solves == "full"

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
        if not self.refused and not self.results:
            problems.append("not run: the program was interrupted")
        elif not self.results and not problems:
            reasons = dict.fromkeys(r.reason for r in self.refused)
            problems.append(f"no route applies: {'; '.join(reasons)}")
        return tuple(f"{self.label}: {p}" if self.label else p for p in problems)


def presented() -> Any:
    """Return the module that shows answers, which is above this one and heavy: loaded late."""
    return import_module("cases.output.presented")


def incompatibility(system: System) -> str | None:
    """Return why the exact theory (7), (8) does not apply, None where it does."""
    try:
        compatibility(system)
    except NotApplicable as reason:
        return str(reason)
    return None


def answers_of(
    system: System,
    observables: Sequence[Observable],
    methods: Sequence[Method],
    *,
    progress: Progress = silent,
    partial: bool = False,
    relax: bool = False,
    share: float | None = None,
) -> Answers:
    """Return the answers of ``methods``, each for the observables that it gives.

    ``share``: the methods were not named, and each is taken as its ``unasked`` says; None: they
    were.

    ``partial``: Ctrl-C ends the work with the answers that there are by then. ``relax``: tolerances
    are defaults that nobody asked for, so that an answer that misses its own is solved for again at
    the next power of ten that it meets, up to ``LOOSEST``, with a note.
    """
    results: list[Result] = []
    notes: list[str] = []
    attempts = Attempts(partial)
    for method in methods:
        refuse = partial_of(attempts.refuse, method.route)
        if attempts.interrupted:
            refuse(map(observable_name, observables), INTERRUPTED)
            continue
        reasons: dict[Observable, str | None]
        try:
            taken = method if share is None else method.unasked(system, share=share)
            plan = taken.prepare(system)
            reasons = {observable: plan.refusal(observable) for observable in observables}
        except NotApplicable as error:
            reasons = dict.fromkeys(observables, str(error))
        for reason in dict.fromkeys(filter(None, reasons.values())):
            refuse((observable_name(o) for o, r in reasons.items() if r == reason), reason)
        given = [observable for observable, reason in reasons.items() if not reason]
        if not given:
            continue
        result = attempts.answer_of(
            method.route,
            map(observable_name, given),
            partial_of(_solved, plan, system, given, notes, relax, progress),
            failures=REFUSALS if taken is method else (),
        )
        if result is None:
            continue
        attempts.interrupted |= result.partial
        if taken is not method and _worst_error(result) > getattr(taken, "tol", inf):
            notes.append(
                f"{method.route.label}: certified to {_worst_error(result):.2g}, as far as it"
                f" may work unasked; fpk density --method {method.name} goes further"
            )
        results.append(result)
    refused = tuple(attempts.refused)
    return Answers(
        system, tuple(results), refused, notes=tuple(notes), interrupted=attempts.interrupted
    )


def _solved(
    plan: Plan,
    system: System,
    observables: Sequence[Observable],
    notes: list[str],
    relax: bool,
    progress: Progress,
) -> Result:
    """The answer of ``plan``, or with a note the certified one of a looser tolerance."""
    result = solved(plan, system, observables, progress=progress)
    if not (relax and (relaxed := _relaxed(result))):
        return result
    again = relaxed.solve(system, observables, progress=progress)
    if not all(d.certificate.certified for d in again.densities):
        return result
    notes.append(
        f"{again.method.route.label}: certified to {_worst_error(again):.2g}, which"
        " misses the default tolerance that nobody asked for"
    )
    return again


def _relaxed(result: Result) -> Method | None:
    """The method at the least power of ten that its answer meets; None without need or use."""
    tol, worst = getattr(result.method, "tol", None), _worst_error(result)
    if tol is None or not tol < worst <= LOOSEST:
        return None
    relaxed: Method = replace(result.method, tol=10.0 ** ceil(log10(worst)))  # type: ignore[type-var]
    return relaxed


def _worst_error(result: Result) -> float:
    """Largest L1 error that a solver states, 0 of samples."""
    return max((d.l1_error for d in result.densities if isinstance(d, Density)), default=0.0)


@dataclass(frozen=True)
class Outcome:
    """The curves of a scene, the scene's own first, and the seconds that their answers took."""

    scene: Scene
    curves: tuple[Answers, ...]
    seconds: float

    @property
    def problems(self) -> tuple[str, ...]:
        """Every check that does not hold, in words; empty when all do."""
        return tuple(text for curve in self.curves for text in curve.problems)


def run_scene(
    scene: Scene,
    methods: Sequence[Method],
    *,
    progress: Progress = silent,
    partial: bool = False,
    relax: bool = False,
    save: Callable[[Outcome], object] = lambda outcome: None,
) -> Outcome:
    """Return the answers of ``methods`` for every curve of ``scene``, as they are taken unasked.

    ``partial`` and ``relax`` as in ``answers_of``; once one was interrupted, the curves that follow
    are not run. ``save`` gets the outcome so far when the answers of a curve have been made, before
    they are compared.
    """
    start, share = perf_counter(), 1.0 / len(scene.curves)
    options: Any = {"progress": progress, "partial": partial, "relax": relax, "share": share}
    curves: list[Answers] = []
    for k, curve in enumerate(scene.curves, start=1):
        interrupted = any(c.interrupted for c in curves)
        wanted = [] if interrupted else methods
        answers = answers_of(curve.system, scene.observables, wanted, **options)
        answers = replace(answers, label=curve.label, value=curve.value)
        if not (interrupted or answers.interrupted):
            answers = _with_time(answers, scene, methods, progress=progress, partial=partial)
        curves.append(answers)
        save(Outcome(scene, tuple(curves), perf_counter() - start))
        progress(k - 1, len(scene.curves), "comparing")
        _ = (
            curves[-1].comparisons,
            curves[-1].quantity_comparisons,
            [replies.comparisons for replies in curves[-1].in_time],
        )
        progress(k, len(scene.curves), "comparing")
    return Outcome(scene, tuple(curves), perf_counter() - start)


def _with_time(
    answers: Answers, scene: Scene, methods: Sequence[Method], *, progress: Progress, partial: bool
) -> Answers:
    """Return the answers with the replies to the scene's questions about motion in time."""
    replies: list[Replies] = []
    questions: tuple[Question, ...] = (*scene.passages, *scene.transients)
    for question in questions:
        if any(r.interrupted for r in replies):
            replies.append(Replies(question, interrupted=True))
            continue
        replies.append(
            replies_of(answers.system, question, methods, progress=progress, partial=partial)
        )
    count = len(scene.passages)
    return replace(
        answers,
        passages=tuple(replies[:count]),
        transients=tuple(replies[count:]),
        interrupted=any(r.interrupted for r in replies),
    )
