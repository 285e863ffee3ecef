"""One point of a sweep: all quantities of a system by several methods."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from functools import cache
from math import isfinite, nan
from time import perf_counter
from typing import Any

import numpy as np

from cases.compare.attempts import REFUSALS
from cases.compare.compare import distance_between
from cases.compare.quantity import AVERAGING, PASSAGE, RELAXATION, UPCROSSING, Definition, total
from cases.compare.rare import passage_answer
from cases.compare.stationary import answers_of
from cases.scene.questions import PassageQuestion
from cases.study.simulation import best_answer, deterministic
from cases.study.sweep.points import SweepPoint, Value
from fpk.answer.density import AnyDensity
from fpk.answer.dynamics import Curve, Passage, Rates
from fpk.answer.method import Method, silent
from fpk.answer.names import REST, Observable, observable_name, parse_limit, parse_observable
from fpk.answer.quantities import Number
from fpk.numeric.errors import NotApplicable, NotCertified
from fpk.system.system import System
from sim.montecarlo import MonteCarlo

Asked = tuple[str, tuple[Method, ...]]
"""The name of a method and its solvers in the order in which they are tried."""
Answer = AnyDensity | Passage | Curve | Rates
SIMULATION = MonteCarlo(relaxations=38.0)
"""Simulation of a point: with 38 relaxation times a path the sampling error of the L1 distance of
one displacement is about 0.001."""
REFERENCE_TOL = 2e-4
"""L1 tolerance of a reference that is not sampled: a fifth of the error of the simulation."""
REFERENCE_SHARE = 3.5
"""Work of a reference that is not sampled, about a minute, over the work of an unasked route."""


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
        """Return label, density, failed checks of the full system, or raise ``NotCertified``."""
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
    reference: Callable[[Observable], tuple[str, AnyDensity, tuple[str, ...]]],
) -> Iterator[Value]:
    """Yield each of ``quantities`` by the method ``name``, with a reason if it has no value.

    ``methods`` are its solvers in the order in which they are tried, each for all densities
    together; ``reference`` returns route, density and failed checks of the full system.
    """
    averaged = methods[0].route.solves == "averaged"
    own = [q for q in quantities if averaged or q.kind != AVERAGING]
    crossed = [q for q in own if q.kind == UPCROSSING]
    levels = {
        of: sorted({x for q in crossed if _subject(q)[1] == of for x in q.levels(system)})
        for _, of in map(_subject, crossed)
    }
    most = int(max((q.at or 0.0 for q in own if q.kind == RELAXATION), default=0.0))

    def ask(method: Any, question: str, of: str) -> Answer:
        """Return the first passage of ``of`` from rest, its upcrossings, or the slowest rates."""
        how: Any = {"tol": None, "progress": silent}
        if question == "passage":
            first = PassageQuestion(parse_limit(of, system.n), REST)
            return passage_answer(method, system, first, **how)
        if question == "relaxation":
            rates: Rates = method.relaxation(system, most, **how)
            return rates
        at = parse_observable(of, system.n), np.array(levels[of])
        curve: Curve = method.crossings(system, *at, **how)
        return curve

    answers = _answers(methods, system, list(dict.fromkeys(map(_subject, own))), ask)

    def read(quantity: Definition) -> tuple[Number, str, tuple[str, ...], str]:
        """Return number, error kind, failed checks and reference, or raise one of ``REFUSALS``."""
        if quantity not in own:
            raise NotApplicable("is no averaged theory")
        question, route = _subject(quantity)[0], ""
        answer = answers.get(_subject(quantity))
        if answer is None:
            words = {"passage": "first passage", "crossings": "upcrossing rate"}
            raise NotApplicable(f"gives no {words.get(question, 'relaxation rate')}")
        if isinstance(answer, Exception):
            raise answer
        failures = answer.certificate.failures
        kind = "numerical" if isinstance(answer, Rates) else answer.error_kind
        if isinstance(answer, Curve):
            rows = [levels[_subject(quantity)[1]].index(x) for x in quantity.levels(system)]
            number = total([Number(float(answer.values[k]), float(answer.errors[k])) for k in rows])
        elif isinstance(answer, Rates):
            k = int(quantity.at or 1.0) - 1
            if k >= answer.values.size:
                raise NotApplicable(f"gives {answer.values.size} rates")
            number = Number(float(answer.values[k].real), float(answer.errors[k]))
        elif isinstance(answer, Passage):
            number = getattr(answer, PASSAGE[quantity.kind]) or Number(nan, nan)
            failures = (*failures, *quantity.failures(number, None, system))
        elif quantity.kind == AVERAGING:
            route, full, problems = reference(quantity.observable)
            number = Number(*distance_between(answer, full)[:2])
            kind = max(kind, full.error_kind)  # "sampling" is last
            failures = (*failures, *problems)
        else:
            number = quantity.of(answer, system)
            failures = (*failures, *quantity.failures(number, answer, system))
        if not (isfinite(number.value) and isfinite(number.error)):
            raise NotApplicable("gives no such number with an error that has a bound")
        return number, kind, tuple(dict.fromkeys(failures)), route

    for quantity in quantities:
        try:
            number, kind, failures, route = read(quantity)
        except REFUSALS as error:
            failed = not isinstance(error, NotApplicable)
            yield Value(str(quantity), name, reason=str(error), failed=failed)
            continue
        yield Value(
            str(quantity), name, number.value, number.error, kind, certified=not failures,
            failures=failures, reference=route,
        )  # fmt: skip


def _subject(q: Definition) -> tuple[str, str]:
    """Return passage, crossings, relaxation or density, and the name of the limit or observable."""
    if q.limit is not None:
        return "passage", str(q.limit)
    questions = {UPCROSSING: "crossings", RELAXATION: "relaxation"}
    return questions.get(q.kind, "density"), observable_name(q.observable)


def _answers(
    methods: Sequence[Method],
    system: System,
    subjects: Sequence[tuple[str, str]],
    ask: Callable[[Any, str, str], Answer],
) -> dict[tuple[str, str], Answer | Exception]:
    """Return each answer by the first of ``methods`` that certifies it, else the first answer.

    All densities of a method are solved for together, other answers are by ``ask``. Without any
    answer it is the exception of the first method; a subject that no method has is left out.
    """
    known: dict[tuple[str, str], Answer | Exception] = {}
    for method in methods:
        offers: dict[tuple[str, str], Answer | Exception] = {}
        missing = [s for s in subjects if not _certified(known.get(s))]
        observables = [parse_observable(of, system.n) for q, of in missing if q == "density"]
        if observables:
            answers = answers_of(system, observables, [method])
            for refusal in answers.refused:
                kind = NotCertified if refusal.failed else NotApplicable
                offers |= {("density", o): kind(refusal.reason) for o in refusal.observables}
            offers |= {("density", d.name): d for r in answers.results for d in r.densities}
        for question, of in missing:
            if question != "density" and hasattr(method, question):
                try:
                    offers[question, of] = ask(method, question, of)
                except REFUSALS as error:
                    offers[question, of] = error
        for subject, answer in offers.items():
            first = isinstance(known.get(subject), Exception) and not isinstance(answer, Exception)
            if first or subject not in known or _certified(answer):
                known[subject] = answer
    return known


def _certified(answer: Answer | Exception | None) -> bool:
    return not isinstance(answer, Exception | None) and answer.certificate.certified
