"""Records: of a run, from which its text, page and JSON are written, and of ``fpk verify``."""

from collections.abc import Iterable

from cases.compare.answers import Answers
from cases.compare.attempts import Refusal
from cases.compare.claims import findings, time_findings
from cases.compare.compare import Comparison
from cases.compare.in_time import Replies
from cases.compare.quantities import Quantity
from cases.compare.stationary import Outcome
from cases.scene.questions import TransientQuestion
from cases.scene.units import NO_UNITS, Units
from cases.scene.written import SCHEMA
from cases.show.facts import facts_record, units_record
from cases.show.records import Record, answer_tail, answer_units, passage_numbers, plain
from cases.show.words import stationary_note
from fpk.answer.dynamics import Passage
from fpk.answer.method import Result, Route
from fpk.answer.names import observable_name
from sim.sample.diagnostics import Report

ROW = ("observable", "measures", "norm", "L1", "band", "error")
"""Fields of ``Comparison`` that ``comparison_rows`` copies."""


def digest_of(outcome: Outcome) -> Record:
    """Return the record of ``fpk run``, with plain values as JSON has them.

    The scene's own system is at the top level, the others in ``curves``. ``judged`` is the number
    of comparisons that have an allowed difference.
    """
    base, *others = outcome.curves
    key, units = outcome.scene.curves[0].key, outcome.scene.units
    compared = [c for curve in outcome.curves for c in curve.comparisons]
    in_time = [replies for curve in outcome.curves for replies in curve.in_time]
    compared += [c for curve in outcome.curves for c in curve.quantity_comparisons]
    compared += [c for replies in in_time for c in replies.comparisons]
    judged = [c for c in compared if c.band is not None]
    claims = *findings(outcome.scene.expect, outcome.curves), *time_findings(outcome.curves)
    return plain(
        {
            "schema": SCHEMA,
            "scene": outcome.scene.name,
            "title": outcome.scene.title,
            "units": units_record(outcome.scene),
            **_curve(base, key, units),
            "curves": [_curve(c, key, units) for c in others],
            "judged": len(judged),
            "problems": outcome.problems,
            "claims": claims,
            "seconds": outcome.seconds,
        }
    )


def curves_of(digest: Record) -> list[Record]:
    """Return the records of all curves in ``digest``, by ascending ``value``, the varied number.

    The record of the scene's own system is ``digest`` itself. Without numbers it comes first, then
    the others in the order of the scene.
    """
    return sorted([digest, *digest["curves"]], key=lambda curve: curve["value"] or 0.0)


def _curve(curve: Answers, key: str, units: Units) -> Record:
    return {
        "label": curve.label,
        "key": key,
        "value": curve.value,
        **facts_record(curve.system),
        "methods": [*map(method_record, curve.results), *map(refusal_record, curve.refused)],
        "notes": curve.notes,
        "stationary_note": stationary_note(curve.system),
        "averaging_notes": curve.averaging_notes,
        "averaging_unknown": [o for own in curve.unknown_averaging_errors.values() for o in own],
        "tails": curve.tails,
        "quantities": [quantity_row(q, units) for q in curve.quantities],
        "comparisons": comparison_rows(curve.comparisons),
        "quantity_comparisons": comparison_rows(curve.quantity_comparisons),
        "averaging": [
            {"observable": name, **row}
            for name in dict.fromkeys(c.observable for c in curve.comparisons)
            for row in averaging_errors(name, curve.comparisons)
        ],
        "passages": [_replies(replies, units) for replies in curve.passages],
        "transients": [_replies(replies, units) for replies in curve.transients],
        # The three errors of a density of a simulation, never mixed: ``sampling`` is the expected
        # L1 error by chance; ``step_bias`` the L1 distance from the density of half the step and
        # what chance makes of that.
        "errors": [
            {
                "route": r.method.route.label,
                "observable": d.name,
                "sampling": d.l1_error,
                "step_bias": {"L1": bias.value, "by_chance": bias.error}
                if bias
                else "not measured",
                "averaging": averaging_errors(d.name, curve.comparisons),
            }
            for r in curve.results
            if isinstance(r.report, Report)
            for d in r.densities
            for bias in [r.report.step_biases.get(d.name)]
        ],
        "identities": [
            {"method": r.method.route.label, **plain(i), "z": i.z}
            for r in curve.results
            for i in r.identities
        ],
    }


def _replies(replies: Replies, units: Units) -> Record:
    """The record of a question about motion in time: answers, comparisons, refusals (``methods``).

    The rows of comparisons have ``of`` for ``observable``. The densities of a transient are not in
    the record: they are in the netCDF file only.
    """
    question = replies.question
    if isinstance(question, TransientQuestion):
        asked = {"observable": observable_name(question.of)}
    else:
        asked = {"limit": str(question.limit)}
    answers = []
    for g in replies.given:
        own = passage_numbers(g.answer) if isinstance(g.answer, Passage) else {}
        tail = answer_tail(g.answer.certificate, g.answer.settings, g.seconds)
        names = _names(g.route)
        names |= {"solver": g.answer.settings.get("solver", g.route.solver), "words": g.words}
        answers.append({**names, **own, "error_kind": g.answer.error_kind, **tail})
    rows = comparison_rows(replies.comparisons)
    for row in rows:
        row["of"] = row.pop("observable").removeprefix(f"{question.name}: ")
    return {
        "question": question.name,
        "start": str(question.start),
        "units": answer_units(units, asked, "density") if units else None,
        "times": question.times,
        "answers": answers,
        "comparisons": rows,
        "methods": [refusal_record(refusal) for refusal in replies.refused],
    }


def _names(route: Route) -> Record:
    """The label (``route``), ``method``, ``solver``, and ``solves``: "full" or "averaged"."""
    names = {"route": route.label, "method": route.method, "solver": route.solver}
    return {**names, "solves": route.solves}


def method_record(result: Result) -> Record:
    """Return the record of a route that answered: names, seconds, settings, errors of densities."""
    report = result.report if isinstance(result.report, Report) else None
    return {
        **_names(result.method.route),
        "applies": True,
        "seconds": result.seconds,
        "settings": dict(result.settings),
        "diagnosis": report and report.diagnosis,
        "densities": [
            {
                "observable": d.name,
                "error_kind": d.error_kind,
                "l1_error": d.l1_error,
                "certificate": d.certificate.record,
            }
            for d in result.densities
        ],
    }


def refusal_record(refusal: Refusal) -> Record:
    """Return the record of a route that gave no answer: its names, ``applies`` False, the reason.

    It has the fields ``observables``, ``reason``, ``failed`` and ``gave_up`` of ``refusal``.
    """
    own = {key: value for key, value in vars(refusal).items() if key != "route"}
    return {**_names(refusal.route), "applies": False, **own}


def comparison_rows(comparisons: Iterable[Comparison]) -> list[Record]:
    """Return a row for each comparison: fields ``ROW``, labels ``a`` and ``b``, and ``holds``.

    ``repeats``: the row is an averaging error, and an earlier row has the same observable and
    theories by other solvers, whose answers are nearly equal.
    """
    first: dict[tuple[str, ...], Comparison] = {}
    rows = []
    for c in comparisons:
        pair = (c.observable, _theory(c.a), _theory(c.b))
        repeats = c.measures == "averaging" and first.setdefault(pair, c) is not c
        row = {key: getattr(c, key) for key in ROW}
        rows.append(row | {"a": c.a.label, "b": c.b.label, "holds": c.holds, "repeats": repeats})
    return rows


def quantity_row(quantity: Quantity, units: Units = NO_UNITS) -> Record:
    """Return the record of a quantity by one route, with its value, error and names.

    ``label`` is for readers, ``name`` the argument of ``fpk sweep --quantity``. The key ``unit`` is
    missing if ``units`` have no names.
    """
    unit = units.number(quantity.quantity, quantity.observable)
    level = quantity.definition.kind == "exceedance" and units.number("", quantity.observable)
    return {
        "observable": quantity.observable,
        "quantity": quantity.quantity,
        "label": f"{quantity.label} {level}" if level else quantity.label,
        "name": quantity.name,
        "route": quantity.route.label,
        "solves": quantity.route.solves,
        "value": quantity.number.value,
        "error": quantity.number.error,
        "error_kind": quantity.error_kind,
        **({"unit": unit} if unit else {}),
    }


def averaging_errors(name: str, comparisons: Iterable[Comparison]) -> list[Record]:
    """Return a row with the ``L1`` distance to the full system for each averaged ``theory``.

    ``name`` is the observable's. ``error`` is the part of L1 that sampling and solvers explain; of
    several answers for the full system the ``reference`` is the label with the least ``error``. The
    ``theory`` is a method, or the label of a simulated averaged equation.
    """
    averaging: dict[str, Record] = {}
    for c in sorted(comparisons, key=lambda c: c.error):
        full = [r for r in (c.a, c.b) if r.solves == "full"]
        if (c.measures, c.observable) == ("averaging", name) and full:
            theory = _theory(c.b if c.a in full else c.a)
            row = {"theory": theory, "L1": c.L1, "error": c.error, "reference": full[0].label}
            averaging.setdefault(theory, row)
    return list(averaging.values())


def _theory(route: Route) -> str:
    """The method of a route, which all its solvers share, or the label of a route that samples."""
    return route.label if route.sampled else route.method


def verify_row(digest: Record) -> Record:
    """Return the counts, problems and claims of a run; an unjudged curve is a problem, too.

    ``certificates`` is the number of certificates that hold; ``holds``: there is no problem.
    """
    curves = curves_of(digest)
    unjudged = [
        f"{curve['label'] or digest['scene']}: no comparison was judged"
        for curve in curves
        for part in [(curve, *curve["passages"], *curve["transients"])]
        if all(c["band"] is None for answers in part for c in answers["comparisons"])
    ]
    problems = [*digest["problems"], *unjudged]
    answers = [d for c in curves for m in c["methods"] if m["applies"] for d in m["densities"]]
    answers += [a for c in curves for q in c["passages"] + c["transients"] for a in q["answers"]]
    return {
        "scene": digest["scene"],
        "curves": len(curves),
        "judged": digest["judged"],
        "certificates": sum(answer["certificate"]["certified"] for answer in answers),
        "problems": problems,
        "claims": digest["claims"],
        "seconds": digest["seconds"],
        "holds": not problems,
    }
