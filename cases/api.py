"""The functions of ``import fpk`` that need all rooms: load, solve, compare, plot."""

from collections.abc import Sequence

from cases.compare.answers import Answers
from cases.compare.compare import Comparison
from cases.compare.routes import all_methods, method_for
from cases.compare.stationary import answers_of, joint_at_stops
from cases.scene.scene import load_scene
from cases.show.presented import PresentedAnswers, plot
from fpk.answer.method import Method
from fpk.answer.names import parse_observable
from fpk.numeric.errors import InvalidInput, NotApplicable
from fpk.system.system import System

__all__ = ["compare", "load", "plot", "solve"]

load = load_scene


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


def compare(answers: Answers) -> tuple[Comparison, ...]:
    """Return the differences of all pairs of densities of one observable, and which error each is.

    Numerical and sampling differences are judged (``holds``); averaging errors are reported, their
    ``band`` is None. ::

        for c in fpk.compare(fpk.solve(fpk.load("fig3a").system, ["q2"])):
            print(c.a.label, c.b.label, c.measures, c.L1, c.band)
    """
    return answers.comparisons
