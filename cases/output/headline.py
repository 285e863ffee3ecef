"""The answer of a run in one sentence, and its tables as a reader wants them."""

import re
from math import ceil, floor, log10
from typing import Any

from cases.comparison.claims import ACCEPTABLE_L1
from cases.output.records import Record
from fpk.route import ROUTES, Route

AVERAGED = re.compile(r"(?<![\w-])(non)?integrable\b")
"""Theories that have another name on the command line than for readers."""


def headline_of(curves: list[Record]) -> str:
    """Return how far each averaged theory is from the full system, in one sentence.

    Of each curve and theory it is the largest L1 distance of a density, each by the reference with
    which its error is least. Empty where nothing of it is known.
    """
    parts = []
    for curve in curves:
        worst = averaging_errors(curve)
        words = [_words(name, *row) for name, row in worst.items()]
        if words:
            parts.append((f"at {curve['label']}: " if curve["label"] else "") + ", ".join(words))
    if parts:
        return _sentence("; ".join(parts))
    if curves[0]["regime"]["incompatible"] is None:
        return "The compatibility condition (8) holds: the exact density is known."
    return ""


def averaging_errors(curve: Record) -> dict[str, tuple[float, float]]:
    """Return by theory the largest L1 distance to the full system, and its error; best first."""
    best: dict[tuple[str, str], tuple[float, float]] = {}
    routes = _routes()
    for c in sorted(curve["comparisons"], key=lambda c: c["error"]):
        pair = [routes[c[key]] for key in "ab" if c[key] in routes]
        averaged = [r for r in pair if r.solves == "averaged"]
        if c["measures"] != "averaging" or len(pair) != 2 or len(averaged) != 1:
            continue
        name = averaged[0].name.removesuffix(", simulated")
        best.setdefault((name, c["observable"]), (c["L1"], c["error"]))
    worst: dict[str, tuple[float, float]] = {}
    for (name, _), row in best.items():
        worst[name] = max(worst.get(name, row), row)
    return dict(sorted(worst.items(), key=lambda row: row[1]))


def _words(name: str, distance: float, error: float) -> str:
    if distance + error <= ACCEPTABLE_L1:
        return f"{name} is within {_percent(distance + error, up=True)} of the full system"
    return f"{name} is {_percent(distance)} off" + (
        f" (± {_percent(error, up=True)})" if error > 0.05 * distance else ""
    )


def _percent(share: float, *, up: bool = False) -> str:
    """Two digits of a percentage, rounded up where it is a bound."""
    value = 100.0 * share
    if value <= 0.0:
        return "0 %"
    unit = 10.0 ** (floor(log10(value)) - 1)
    digits = ceil(value / unit * (1.0 - 1e-12)) if up else round(value / unit)
    return f"{digits * unit:.2g} %" if value < 99.5 else f"{digits * unit:.0f} %"


def _sentence(text: str) -> str:
    return text[0].upper() + text[1:] + "."


def _routes() -> dict[str, Route]:
    return {route.label: route for route in ROUTES.values()}


def named(text: str) -> str:
    """Return a route's words for its label; in other text theories by their names for readers."""
    if route := _routes().get(text):
        return route.words
    names = {route.method: route.name for route in ROUTES.values() if not route.sampled}
    return AVERAGED.sub(lambda word: names.get(word[0], word[0]), text)


def theory_of_route(label: str) -> str:
    """Return the name of a route's theory, the label itself of one that is not known."""
    route = _routes().get(label)
    return route.name if route else label


def quantity_table(curve: Record) -> Record:
    """Return ``routes`` and ``rows`` of the quantities of a curve, a column for each theory.

    Of the solvers of a theory the first is shown: they agree to their errors.
    """
    first: dict[str, str] = {}
    rows: dict[tuple[str, str], dict[str, Any]] = {}
    for q in curve.get("quantities") or []:
        name = theory_of_route(q["route"])
        if first.setdefault(name, q["route"]) == q["route"]:
            rows.setdefault((q["observable"], q["quantity"]), {})[name] = q
    return {
        "routes": list(first),
        "rows": [{"of": of, "quantity": q, "cells": cells} for (of, q), cells in rows.items()],
    }


def with_error(value: float | None, error: float | None) -> str:
    """Return a value to the digits that its error leaves, at most six, and the error rounded up.

    A value well within its error is 0, by which the error grows.
    """
    if value is None:
        return "–"
    if not error:
        return f"{value:.6g}"
    if abs(value) < 0.1 * error:
        value, error = 0.0, error + abs(value)
    last = floor(log10(error)) - 1
    digits = 1 if value == 0 else floor(log10(abs(value))) - last + 1
    bound = ceil(error / 10.0**last * (1.0 - 1e-12)) * 10.0**last
    return f"{value:.{min(max(digits, 1), 6)}g} ± {bound:.1e}".replace("e-0", "e-").replace(
        "-", "−"
    )
