"""Pictures of an outcome, as matplotlib figures: densities, solver differences, what is left."""

from collections.abc import Iterator

import matplotlib as mpl
from matplotlib.figure import Figure

from cases.comparison.run import CurveOutcome, Outcome
from cases.output.pictures.joint import pair_figure, pair_solver_figure, surface_figure
from cases.output.pictures.lines import (
    density_figure,
    difference_figure,
    solver_differences,
    theory_differences,
)
from cases.output.pictures.style import STYLE, two_solvers
from fpk.observable import Observable, observable_name

Drawn = tuple[str, str, Figure]
"""File stem, caption and figure."""


def figures(outcome: Outcome) -> Iterator[Drawn]:
    """Yield file stem, caption and figure of everything that an outcome can show."""
    with mpl.rc_context(dict(STYLE)):
        for observable in outcome.scene.observables:
            curves = [c for c in outcome.curves if c.densities(observable)]
            if curves:
                yield from (_joint if len(observable) == 2 else _single)(curves, observable)


def _single(curves: list[CurveOutcome], observable: Observable) -> Iterator[Drawn]:
    name = observable_name(observable)
    curves = sorted(curves, key=lambda c: c.value or 0.0)
    words = f"Density of {name}: theory as lines, simulation as points with two standard errors."
    yield f"density_{name}", words, density_figure(curves, observable)
    of_theories = (
        f"Simulation minus theory for {name}. Inside the grey band the difference is chance; a"
        " curve that leaves it shows the averaging error where the theory is an averaged one."
    )
    for stem, words, differences, band in (
        ("solver", _solver_caption(name), solver_differences, "±the errors that both state"),
        ("left", of_theories, theory_differences, "±2 standard errors"),
    ):
        rows = [(c.label, drawn) for c in curves if (drawn := differences(c, observable))]
        if rows:
            yield f"{stem}_{name}", words, difference_figure(rows, observable, band)


def _joint(curves: list[CurveOutcome], observable: Observable) -> Iterator[Drawn]:
    name, own = observable_name(observable), curves[0]
    stem = name.replace(",", "_")
    words = f"Joint density of {name}, on common levels."
    yield f"density_{stem}", words, pair_figure(own, observable)
    if two_solvers(own, observable):
        yield f"solver_{stem}", _solver_caption(name), pair_solver_figure(own, observable)
    if all(c.kind != "H" for c in observable):  # energies pile up in a corner
        words = f"Joint density of {name} as a surface: theory, and simulation in its own bins."
        yield f"surface_{stem}", words, surface_figure(own, observable)


def _solver_caption(name: str) -> str:
    return (
        f"Numerical error for {name}: two solvers of the same equation against each other, and the"
        " errors that they state."
    )
