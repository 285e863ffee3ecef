"""A sweep as a page: its table, and curves over one axis or heat pictures over two."""

import numpy as np

from cases.scene.scene import Scene
from cases.scene.units import bracketed
from cases.show.pictures.panel import Field, Panel, curves_over, spans_decades
from cases.show.study_page import Page, Table
from cases.show.words import named, stationary_note
from cases.study.sweep.result import Sweep
from fpk.numeric.arrays import Array


def sweep_table(result: Sweep, remarks: tuple[str, ...] = ()) -> Table:
    """Return every value with its error, in the order of the grid."""
    heads = [a.key + bracketed(a.unit) for a in result.axes]
    labels = dict(zip(result.quantities, result.labels(), strict=True))
    rows = [
        {
            **dict(zip(heads, p.values, strict=True)),
            "quantity": labels[a.quantity],
            "method": a.method,
            "value": a.value,
            "error": a.error,
            "kind": a.error_kind,
            "certified": ("no", "yes")[a.certified] if a.value is not None else "",
        }
        for p in result.points
        for a in p.answers
    ]
    return Table("points", "Values", rows, remarks, parameters=len(heads))


def sweep_page(result: Sweep, scene: Scene) -> Page:
    """Return what ``fpk sweep`` shows and writes: every value, as a table and as a picture."""
    reasons = dict.fromkeys(
        f"{a.quantity} by {a.method}: {a.reason}"
        for p in result.points
        for a in p.answers
        if a.reason
    )
    summary = (
        f"{', '.join(result.quantities)} by {'; '.join(map(named, result.methods))}:"
        f" {len(result.points)} points ({result.reused} from disk)"
    )
    errors = "An error is an estimate of the numerical error, or one standard error of sampling."
    notes = filter(None, [stationary_note(scene.system), *map(named, result.averaging_notes)])
    return Page(
        "result",
        scene,
        f"Sweep of {', '.join(a.key for a in result.axes)}: {scene.title}",
        [
            sweep_table(
                result,
                (summary, errors, *notes, *reasons),
            )
        ],
        sweep_panels(result),
        summary=summary,
        gridded=result.variables(),
    )


def sweep_panels(result: Sweep) -> list[Panel] | list[Field]:
    """Return a panel for each quantity, over two axes one for each of its methods."""
    values, errors = result.field("value"), result.field("error")
    if len(result.axes) == 2:
        return [
            field
            for quantity, own, bars in zip(result.labels(), values, errors, strict=True)
            for field in _fields(quantity, result, own, bars)
        ]
    (axis,), names = result.axes, list(map(named, result.methods))
    return [
        Panel(
            quantity.partition(" [")[0],
            axis.label,
            quantity,
            curves_over(axis, names, own, bars),
            logarithmic=axis.logarithmic,
            y_logarithmic=spans_decades(own),
            by_x=True,
        )
        for quantity, own, bars in zip(result.labels(), values, errors, strict=True)
    ]


def _fields(quantity: str, result: Sweep, values: Array, errors: Array) -> list[Field]:
    """A field for each method with a value, (methods, axes), on common colours."""
    if not np.isfinite(values).any():
        return []
    x, y = result.axes
    limits = float(np.nanmin(values)), float(np.nanmax(values))
    return [
        Field(
            f"{quantity} by {named(method)}",
            x,
            y,
            own,
            bars,
            logarithmic=spans_decades(values),
            limits=limits,
        )
        for method, own, bars in zip(result.methods, values, errors, strict=True)
        if np.isfinite(own).any()
    ]
