"""The functions of ``import fpk`` that need all rooms: load, solve, compare, plot."""

from collections.abc import Sequence
from dataclasses import dataclass
from importlib import import_module
from typing import TYPE_CHECKING, Any

from cases.compare.answers import Answers
from cases.compare.compare import Comparison
from cases.compare.routes import all_methods, method_for
from cases.compare.stationary import answers_of, joint_at_stops
from cases.scene.scene import load_scene
from fpk.answer.density import AnyDensity
from fpk.answer.method import Method
from fpk.answer.names import parse_observable
from fpk.numeric.errors import InvalidInput, NotApplicable
from fpk.system.system import System

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from pandas import DataFrame
    from xarray import Dataset

load = load_scene


@dataclass(frozen=True, repr=False)
class PresentedAnswers(Answers):
    """``Answers`` as ``fpk.solve`` returns them: also as a data frame, labelled arrays, a figure.

    ::

        answers = fpk.solve(fpk.load("fig3a").system, ["q2"])
        answers["q2", "exact"], answers.of("q2"), answers.refusals, answers.problems
        answers.summary(), answers.to_xarray(), answers.plot("q2")
    """

    def summary(self) -> "DataFrame":
        """Return the quantities as a data frame: rows by observable and quantity.

        Columns by route, each with ``value``, ``error`` and ``error_kind``: ``numerical``, or
        ``sampling`` for one standard error. Needs pandas; raises ``Unavailable`` without. ::

            fpk.solve(system, ["q2"], methods=["nonintegrable/fem"]).summary()
        """
        frame: DataFrame = _presentation_module().summary_frame(self)
        return frame

    def to_xarray(self) -> "Dataset":
        """Return the densities and their errors on common grids, as in the file of a run.

        ``p_q2`` (route_q2, q2) is the density, ``error_q2`` its error, of the kind that
        ``error_kind_q2`` says. Needs xarray; raises ``Unavailable`` without. ::

            fpk.solve(system, ["q2"], methods=["nonintegrable/fem"]).to_xarray()["p_q2"]
        """
        data: Dataset = _presentation_module().dataset(self)
        return data

    def plot(self, observable: str, *, log: bool = False) -> "Figure":
        """Return a figure of pyplot with the densities of ``observable`` by every route drawn.

        Contours for a pair. ``log``: on a logarithmic axis, down to 1e-6 of the largest, contours
        to 1e-3. Raises ``InvalidInput`` for an observable without a density. ::

            fpk.solve(system, ["q2"], methods=["nonintegrable/fem"]).plot("q2", log=True)
        """
        figure: Figure = _presentation_module().plot(
            self, parse_observable(observable, self.system.n), log=log
        )
        return figure

    def _repr_html_(self) -> str:
        """Return the quantities as tables, for a notebook."""
        return str(_presentation_module().html_tables(self))


def solve(
    system: System,
    observables: Sequence[str],
    *,
    methods: Sequence[str | Method] | None = None,
    tol: float | None = None,
) -> PresentedAnswers:
    """Return the densities of ``observables`` by ``methods``.

    ``observables`` as on the command line: q1, p1, H, H1, or a pair such as "q2,p2". ``methods``
    are names ("exact"), names with a solver ("nonintegrable/fem") or ``Method`` records; left out,
    every route is taken that applies to the system and does not sample, slow routes within bounds
    and if they gain something; a simulation is run if it is named ("montecarlo"). ``tol`` is the L1
    tolerance of all methods except ``Method`` records, which have their own.

    Energy averaging, Eq. (11), by finite elements::

        answers = fpk.solve(system, ["q2", "H"], methods=["nonintegrable/fem"], tol=1e-8)
        answers["q2"].std()

    Raises ``InvalidInput`` for an unknown name and ``NotApplicable`` where a method that was named
    does not apply or does not give an observable.
    """
    if not isinstance(system, System):
        raise InvalidInput("system", system, 'must be a System, as fpk.load("fig6a").system')
    for key, values, kinds, example in (
        ("observable", observables, str, '"q2"'),
        ("method", () if methods is None else methods, (str, Method), '"nonintegrable/fem"'),
    ):
        if isinstance(values, str) or not isinstance(values, Sequence):
            raise InvalidInput(f"{key}s", values, f"must be a list, as [{example}]")
        for value in values:
            if not isinstance(value, kinds):
                record = " or a Method" if key == "method" else ""
                raise InvalidInput(key, value, f"must be a name{record}, as {example}")
    wanted = [parse_observable(name, system.n) for name in observables]
    if methods is None:
        unsampled = [m for m in all_methods(tol=tol) if not m.route.sampled]
        answers = answers_of(system, wanted, unsampled, share=1.0, rates=True)
        refused, notes = answers.refused, answers.notes
        return PresentedAnswers(system, answers.results, refused, notes=notes)
    results, beside = [], joint_at_stops(system, wanted)
    for name in methods:
        method = method_for(*name.split("/", 1), tol=tol) if isinstance(name, str) else name
        try:
            results.append(method.solve(system, wanted, beside=beside))
        except NotApplicable as reason:
            raise NotApplicable(f"{method.route.label}: {reason}") from None
    return PresentedAnswers(system, tuple(results))


def plot(density: AnyDensity, *, log: bool = False) -> "Figure":
    """Return a figure of pyplot with one density and its error.

    A density of two coordinates is drawn as contours; ``log``: on a logarithmic scale. ::

        answers = fpk.solve(fpk.load("fig3a").system, ["q2,p2"], methods=["exact"])
        fpk.plot(answers["q2,p2"], log=True)
    """
    figure: Figure = _presentation_module().plot_density(density, log=log)
    return figure


def compare(answers: Answers) -> tuple[Comparison, ...]:
    """Return the differences of all pairs of densities of one observable, and which error each is.

    Numerical and sampling differences are judged (``holds``); averaging errors are reported, their
    ``band`` is None. ::

        for c in fpk.compare(fpk.solve(fpk.load("fig3a").system, ["q2"])):
            print(c.a.label, c.b.label, c.measures, c.L1, c.band)
    """
    return answers.comparisons


def _presentation_module() -> Any:
    """Import, at the first call only, and return the module that draws and tabulates answers."""
    return import_module("cases.show.presented")
