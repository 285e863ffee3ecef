"""The functions of ``import fpk`` that need all rooms: load, solve, compare."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from cases.comparison.compare import Comparison, compared
from cases.comparison.routes import all_methods, method_for
from cases.comparison.run import answered, incompatibility
from cases.scene.scene import Scene, load_scene
from fpk.density import AnyDensity
from fpk.errors import InvalidInput, NotApplicable
from fpk.method import Method, Result
from fpk.observable import observable_name, parse_observable
from fpk.system import System


@dataclass(frozen=True, repr=False)
class Answers(Mapping[Any, AnyDensity]):
    """Densities by observable and method: ``answers["q2", "exact"]``, as names or labels.

    ``answers["q2"]`` will do where one method alone gives q2; ``answers.of("q2")`` returns all by
    method. ``results`` has what each method returned, ``refusals`` by the label of a method why it
    gives not all that was asked for.
    """

    system: System
    results: tuple[Result, ...]
    refusals: Mapping[str, str] = field(default_factory=dict)

    def of(self, observable: str) -> dict[str, AnyDensity]:
        """Return the densities of ``observable`` by the label of the method, empty where none."""
        name = observable_name(parse_observable(observable, self.system.n))
        return {
            result.method.route.label: density
            for result in self.results
            for density in result.densities
            if density.name == name
        }

    def __getitem__(self, key: str | tuple[str, str]) -> AnyDensity:
        """Return one density; raise ``KeyError`` with what there is where it is not one."""
        observable, method = (key, None) if isinstance(key, str) else key
        densities = self.of(observable)
        if method is None and len(densities) == 1:
            return next(iter(densities.values()))
        if method in densities:
            return densities[method]
        if not densities:
            there = ", ".join(dict.fromkeys(name for name, _ in self))
            raise KeyError(f"no density of {observable}; there are densities of {there}")
        labels = ", ".join(densities)
        raise KeyError(f"say by which method, as in answers[{observable!r}, ...]: {labels}")

    def __iter__(self) -> Iterator[tuple[str, str]]:
        """Iterate over the pairs (observable, method)."""
        for result in self.results:
            for density in result.densities:
                yield density.name, result.method.route.label

    def __len__(self) -> int:
        """Return the number of densities."""
        return sum(len(result.densities) for result in self.results)

    def __repr__(self) -> str:
        """Return the pairs in one line."""
        return f"Answers({', '.join(f'{o} by {m}' for o, m in self)})"


def load(scene: str) -> Scene:
    """Return the shipped scene of that name or the one at that path; its ``system`` is Eq. (1).

    Raises ``BadInput``, one line that names file, key, value and what would be right.
    """
    return load_scene(str(scene))


def solve(
    system: System,
    observables: Sequence[str],
    *,
    methods: Sequence[str | Method] | None = None,
    tol: float | None = None,
) -> Answers:
    """Return the densities of ``observables`` by ``methods``.

    ``observables`` as on the command line: q1, p1, H, H1, or a pair such as "q2,p2". ``methods``
    are names ("exact"), names with a solver ("nonintegrable/fem") or ``Method`` records; left out,
    every route is taken that applies to the system and does not sample: a simulation is run
    where it is named ("montecarlo"). ``tol`` is the L1 tolerance of the methods named by strings.

    Raises ``InvalidInput`` for an unknown name and ``NotApplicable`` where a method that was named
    does not apply or does not give an observable.
    """
    if isinstance(observables, str):
        raise InvalidInput("observables", observables, 'must be a list of names, as ["q2", "H"]')
    wanted = [parse_observable(name, system.n) for name in observables]
    results, refusals = [], {}
    for method in _methods(methods, tol):
        if methods is None:
            result, refused = answered(method, system, wanted)
            results += result
            refusals.update((r.route.label, r.reason) for r in refused)
            continue
        try:
            results.append(method.solve(system, wanted))
        except NotApplicable as reason:
            raise NotApplicable(f"{method.route.label}: {reason}") from None
    return Answers(system, tuple(results), refusals)


def compare(answers: Answers) -> tuple[Comparison, ...]:
    """Return what separates any two answers to one question, and which of three errors it is.

    Numerical and sampling differences are judged (``holds``); those that averaging makes are
    reported, ``band`` is None.
    """
    exact = incompatibility(answers.system) is None
    return compared(answers.results, averaging_is_exact=exact)


def _methods(methods: Sequence[str | Method] | None, tol: float | None) -> list[Method]:
    if isinstance(methods, str):
        raise InvalidInput("methods", methods, 'must be a list, as ["exact", "nonintegrable/fem"]')
    if methods is None:
        return [m for m in all_methods(tol=tol) if not m.route.sampled]
    return [method_for(*m.split("/", 1), tol=tol) if isinstance(m, str) else m for m in methods]
