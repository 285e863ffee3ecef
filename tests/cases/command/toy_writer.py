"""A format of one's own for ``fpk export``: columns of every density of one coordinate."""

from pathlib import Path

import numpy as np

from cases.compare.stationary import Outcome
from cases.show.fields import WRITERS, density_variables
from cases.show.files import write_text


def write_columns(outcome: Outcome, path: Path) -> list[Path]:
    """Write a block of lines ``x density error`` for each observable, curve and route."""
    blocks = []
    for observable in (o for o in outcome.scene.observables if len(o) == 1):
        variables = density_variables(outcome.curves, observable, outcome.scene.units)
        x = str(observable[0])
        values, errors = variables[f"p_{x}"][1], variables[f"error_{x}"][1]
        for k, r in np.ndindex(values.shape[:2]):
            names = outcome.curves[k].label, x, variables[f"route_{x}"][1][r]
            rows = np.column_stack([variables[x][1], values[k, r], errors[k, r]])
            lines = [" ".join(f"{number:.12e}" for number in row) for row in rows]
            blocks.append("\n".join([f"# {', '.join(filter(None, names))}", *lines]))
    write_text(path, "\n\n\n".join(blocks) + "\n")
    return [path]


WRITERS[".dat"] = write_columns
