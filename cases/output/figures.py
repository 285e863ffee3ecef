"""Pictures of an outcome, as matplotlib figures: densities, solver differences, what is left."""

from collections.abc import Iterator

import matplotlib as mpl
from matplotlib.figure import Figure

from cases.comparison.run import Outcome
from cases.output.pictures.joint import pair_figure, pair_solver_figure
from cases.output.pictures.lines import both_answers, density_figure, left_figure, solver_figure
from cases.output.pictures.style import STYLE
from cases.output.pictures.surface import surface_figure
from fpk.observable import observable_name


def figures(outcome: Outcome) -> Iterator[tuple[str, str, Figure]]:
    """Yield file stem, caption and figure of everything that an outcome can show."""
    with mpl.rc_context(dict(STYLE)):
        for observable in outcome.scene.observables:
            curves = [c for c in outcome.curves if c.densities(observable)]
            own_first, curves = curves, sorted(curves, key=lambda c: c.value or 0.0)
            if not curves:
                continue
            name = observable_name(observable)
            stem = name.replace(",", "_")
            if len(observable) == 2:
                yield f"density_{stem}", _pair_caption(name), pair_figure(own_first[0], observable)
                if both_answers(own_first[0], observable, "fem"):
                    drawn = pair_solver_figure(own_first[0], observable)
                    yield f"solver_{stem}", _solver_caption(name), drawn
                if all(c.kind != "H" for c in observable):  # energies pile up in a corner
                    drawn = surface_figure(own_first[0], observable)
                    yield f"surface_{stem}", _surface_caption(name), drawn
                continue
            yield f"density_{stem}", _density_caption(name), density_figure(curves, observable)
            if any(both_answers(c, observable, "fem") for c in curves):
                yield f"solver_{stem}", _solver_caption(name), solver_figure(curves, observable)
            if any(both_answers(c, observable, "montecarlo") for c in curves):
                yield f"left_{stem}", _left_caption(name), left_figure(curves, observable)


def _density_caption(name: str) -> str:
    return f"Density of {name}: theory as lines, simulation as points with two standard errors."


def _solver_caption(name: str) -> str:
    return (
        f"Numerical error for {name}: the finite element answer against another answer to the same"
        " equation, the closed form where there is one, and what the solver stated as its error."
    )


def _left_caption(name: str) -> str:
    return (
        f"What is left for {name} between simulation and theory. Inside the grey band it is chance;"
        " a curve that leaves it shows the averaging error where the theory is an averaged one."
    )


def _pair_caption(name: str) -> str:
    return f"Joint density of {name}, on common levels."


def _surface_caption(name: str) -> str:
    return f"Joint density of {name} as a surface: theory, and simulation in its own bins."
