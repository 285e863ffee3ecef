"""A map as a page: its table, and the distance of each theory with the nearer one as a picture."""

from collections import Counter
from typing import Any

import numpy as np

from cases.output.pictures.style import COLOURS, symbol_of
from cases.output.variables import Variables
from cases.output.words import named, stationary_note
from cases.scene.units import bracketed
from cases.studies.page import Page, Table
from cases.studies.picture import Field, Panel, curves_over, spans_decades
from cases.studies.regime_map.map import NEITHER, THEORIES, UNDECIDED, RegimeMap
from fpk.clearance import CLEARANCE_RULE
from fpk.observable import observable_name

PALE = "#d9d9d4"
"""Colour of points at which the difference is within the errors."""
SMALLEST = 1e-4
"""L1 distance at which the colours end: chance moves it by more."""


def map_page(result: RegimeMap) -> Page:
    """Return what ``fpk regime`` shows and writes: every point, and how often each is nearer."""
    heads = [a.key + bracketed(a.unit) for a in result.sweep.axes]
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
    names = [name for name in (*THEORIES, UNDECIDED, NEITHER) if counts[name]]
    summary = (
        f"p({observable_name(result.observable)}), {len(result.points)} points"
        f" ({result.sweep.reused} from disk), nearer to the full system: "
        + ", ".join(f"{named(name)} {counts[name]}" for name in names)
    )
    words = (
        "L1 is the distance of a theory to the full system, rms_ratio the least clearance over the"
        " rms displacement without contact."
    )
    fields = map_variables(result)
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


def map_variables(result: RegimeMap) -> Variables:
    """Return ``L1`` and ``error`` (theory, parameters); by parameters what else is known."""
    swept, name = result.sweep, observable_name(result.observable)
    keys = tuple(axis.dimension for axis in swept.axes)

    def field(key: str, kind: type) -> Any:
        shape = [axis.values.size for axis in swept.axes]
        return np.array([getattr(p, key) for p in result.points], dtype=kind).reshape(shape)

    distance = f"L1 distance of p({name}) to the full system"
    moved = "how far chance and the solvers may have moved L1"
    ratio = "smallest clearance over rms displacement without contact"
    return {
        "theory": (("theory",), np.array(THEORIES), {}),
        **swept.coordinates(),
        "L1": (("theory", *keys), swept.field("value")[0], {"long_name": distance}),
        "error": (("theory", *keys), swept.field("error")[0], {"long_name": moved}),
        "rms_ratio": (keys, field("rms_ratio", float), {"long_name": ratio}),
        **{key: (keys, field(key, str), {}) for key in ("winner", "reference")},
    }


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
