"""One point of a sweep: all quantities of a system by several methods."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from functools import cache, partial
from math import isfinite
from time import perf_counter
from typing import Any, TypeVar

import numpy as np

from cases.compare.attempts import REFUSALS
from cases.compare.compare import distance_between
from cases.compare.quantity import (
    AVERAGING,
    PASSAGE,
    RELAXATION,
    UPCROSSING,
    Definition,
    total,
)
from cases.compare.rare import passage_answer
from cases.compare.stationary import answers_of
from cases.scene.questions import PassageQuestion
from cases.study.simulation import best_answer, deterministic
from cases.study.sweep.points import SweepPoint, Value
from fpk.answer.density import AnyDensity
from fpk.answer.dynamics import Curve, Passage, Rates
from fpk.answer.method import Method, silent
from fpk.answer.names import REST, Observable, observable_name, parse_limit
from fpk.answer.quantities import Number
from fpk.numeric.errors import NotApplicable, NotCertified
from fpk.system.system import System
from sim.montecarlo import MonteCarlo

Answer = TypeVar("Answer", Passage, Curve, Rates)
Asked = tuple[str, tuple[Method, ...]]
"""The name of a method and its solvers in the order in which they are tried."""
Reading = tuple[Number | None, str, tuple[str, ...], str]
"""A number, None if the method does not give it, the kind of its error, failed checks, and the
route of the full system that it was compared with (empty for none)."""
Reference = Callable[[Observable], tuple[str, AnyDensity, tuple[str, ...]]]
"""Returns route and density of the full system for comparison, and the failed checks of both."""
SIMULATION = MonteCarlo(relaxations=38.0)
"""Simulation of a point: with 38 relaxation times a path the sampling error of the L1 distance of
one displacement is about 0.001."""
REFERENCE_TOL = 2e-4
"""L1 tolerance of a reference that is not sampled: a fifth of the error of the simulation."""
REFERENCE_SHARE = 3.5
"""Work that such a reference may take, about a minute, over the work of an unasked route."""


def sweep_point(
    system: System,
    values: tuple[float, ...],
    quantities: tuple[Definition, ...],
    asked: Sequence[Asked],
    solver: Method | None,
    simulation: MonteCarlo,
) -> SweepPoint:
    """Return all quantities of ``system`` by the methods ``asked``.

    ``values`` are the coordinates of the grid point. Averaging errors are distances to the full
    system's exact density if there is one; else to the density of ``solver``, if it is given and
    certifies its answer within the work of ``REFERENCE_SHARE``; else to that by ``simulation``.
    """
    start = perf_counter()

    @cache
    def reference(observable: Observable) -> tuple[str, AnyDensity, tuple[str, ...]]:
        problems: list[str] = []
        best = best_answer(deterministic("full"), system, observable, problems)
        if best is None and solver is not None:
            with suppress(NotApplicable):
                bounded = solver.unasked(system, share=REFERENCE_SHARE)
                best = best_answer([bounded], system, observable, [])
            if best is not None and not best[1].certificate.certified:
                best = None
        best = best or best_answer([simulation], system, observable, problems)
        if best is None:
            why = "; ".join(problems) or "no method gives this density of the full system"
            raise NotCertified(f"no reference: {why}")
        return *best, tuple(problems)

    columns = []
    for name, own in asked:
        methods = [simulation if isinstance(m, MonteCarlo) else m for m in own]
        columns.append(_values(name, methods, system, quantities, reference))
    answers = tuple(answer for row in zip(*columns, strict=True) for answer in row)
    return SweepPoint(values, answers, perf_counter() - start)


def _values(
    name: str,
    methods: Sequence[Method],
    system: System,
    quantities: Sequence[Definition],
    reference: Reference,
) -> Iterator[Value]:
    """Yield the quantities by one method, which solves for all their densities together."""
    averaged = methods[0].route.solves == "averaged"
    own = [q for q in quantities if q.of_density or (averaged and q.kind == AVERAGING)]
    densities, refused = _densities(methods, system, list(dict.fromkeys(q.observable for q in own)))
    crossed = [q for q in quantities if q.kind == UPCROSSING]
    levels = {
        o: sorted({x for q in crossed if q.observable == o for x in q.levels(system)})
        for o in dict.fromkeys(q.observable for q in crossed)
    }

    @cache
    def passage(limit: str) -> Passage | Exception:
        """Return the first passage of ``limit`` from rest; by its name, as a limit has no hash."""
        question = PassageQuestion(parse_limit(limit, system.n), REST)
        ask = partial(passage_answer, system=system, question=question)
        return _first(methods, "passage", "first passage", ask)

    @cache
    def crossings(observable: Observable) -> Curve | Exception:
        """Return the upcrossing rates of all ``levels`` of the observable."""

        def ask(method: Any, **how: Any) -> Any:
            return method.crossings(system, observable, np.array(levels[observable]), **how)

        return _first(methods, "crossings", "upcrossing rate", ask)

    @cache
    def relaxation() -> Rates | Exception:
        """Return the slowest rates, as many as the quantities need."""
        most = int(max(q.at or 0.0 for q in quantities if q.kind == RELAXATION))

        def ask(method: Any, **how: Any) -> Any:
            return method.relaxation(system, most, **how)

        return _first(methods, "relaxation", "relaxation rate", ask)

    def read(quantity: Definition) -> Reading:
        """Return the number of ``quantity``; raises ``REFUSALS``, also of an earlier quantity."""
        if quantity.limit is not None:
            first = _or_raise(passage(str(quantity.limit)))
            number = getattr(first, PASSAGE[quantity.kind])
            more = () if number is None else quantity.failures(number, None, system)
            return number, first.error_kind, (*first.certificate.failures, *more), ""
        if quantity.kind == UPCROSSING:
            curve, at = _or_raise(crossings(quantity.observable)), levels[quantity.observable]
            rows = [at.index(level) for level in quantity.levels(system)]
            number = total([Number(float(curve.values[k]), float(curve.errors[k])) for k in rows])
            return number, curve.error_kind, curve.certificate.failures, ""
        if quantity.kind == RELAXATION:
            rates, k = _or_raise(relaxation()), int(quantity.at or 1.0) - 1
            if k >= rates.values.size:
                raise NotApplicable(f"gives {rates.values.size} rates")
            number = Number(float(rates.values[k].real), float(rates.errors[k]))
            return number, "numerical", rates.certificate.failures, ""
        if quantity not in own:
            raise NotApplicable("is no averaged theory")
        if quantity.observable not in densities:
            raise refused[observable_name(quantity.observable)]
        density = densities[quantity.observable]
        failures = density.certificate.failures
        if quantity.kind != AVERAGING:
            number = quantity.of(density, system)
            failures = (*failures, *quantity.failures(number, density, system))
            return number, density.error_kind, failures, ""
        route, full, problems = reference(quantity.observable)
        kinds = density.error_kind, full.error_kind
        L1, error, _ = distance_between(density, full)
        return Number(L1, error), max(kinds), (*failures, *problems), route  # "sampling" is last

    for quantity in quantities:
        try:
            number, kind, failures, route = read(quantity)
            if number is None or not (isfinite(number.value) and isfinite(number.error)):
                raise NotApplicable("gives no such number with an error that has a bound")
        except REFUSALS as error:
            failed = not isinstance(error, NotApplicable)
            yield Value(str(quantity), name, reason=str(error), failed=failed)
            continue
        checks = tuple(dict.fromkeys(failures))
        yield Value(
            str(quantity), name, number.value, number.error, kind, certified=not checks,
            failures=checks, reference=route,
        )  # fmt: skip


def _densities(
    methods: Sequence[Method], system: System, wanted: Sequence[Observable]
) -> tuple[dict[Observable, AnyDensity], dict[str, Exception]]:
    """Return the density of each observable, and by name the refusal of each that has none.

    A density is by the first of ``methods`` that certifies it, else by the first that gives it.
    """
    densities: dict[Observable, AnyDensity] = {}
    refused: dict[str, Exception] = {}
    for method in methods:
        certified = {o for o, d in densities.items() if d.certificate.certified}
        if missing := [o for o in wanted if o not in certified]:
            answers = answers_of(system, missing, [method])
            for density in (d for r in answers.results for d in r.densities):
                if density.certificate.certified or density.observable not in densities:
                    densities[density.observable] = density
            for refusal in answers.refused:
                kind = NotCertified if refusal.failed else NotApplicable
                for name in refusal.observables:
                    refused.setdefault(name, kind(refusal.reason))
    return densities, refused


def _first(
    methods: Sequence[Method], question: str, what: str, ask: Callable[..., Answer]
) -> Answer | Exception:
    """Return the answer of the first of ``methods`` that certifies it, else the first answer.

    ``ask`` takes a method that has the function ``question``; ``what`` names such answers in words.
    Without any answer the exception of the first method is returned, not raised, to be cached.
    """
    refused: list[Exception] = []
    answers: list[Answer] = []
    for method in methods:
        if hasattr(method, question):
            try:
                answer = ask(method, tol=None, progress=silent)
            except REFUSALS as error:
                refused.append(error)
                continue
            if answer.certificate.certified:
                return answer
            answers.append(answer)
    if answers:
        return answers[0]
    return refused[0] if refused else NotApplicable(f"gives no {what}")


def _or_raise(answer: Answer | Exception) -> Answer:
    if isinstance(answer, Exception):
        raise answer
    return answer
