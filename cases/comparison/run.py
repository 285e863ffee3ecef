"""The main job: every curve of a scene by every route that applies, and what they say together."""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from time import perf_counter

from averaging.energy_process import energy_process
from averaging.exact import compatibility
from averaging.modal.analysis import modal_analysis
from cases.comparison.claims import Finding, findings
from cases.comparison.compare import Comparison, compared, discrepancies
from cases.comparison.regime import Regime, regime_of
from cases.scene.scene import Scene
from cases.scene.vary import Curve
from fpk.density import AnyDensity
from fpk.effects import Effects, effects_of
from fpk.ends import classify
from fpk.errors import InvalidInput, NotApplicable, NotCertified
from fpk.method import Method, Progress, Result, silent, solved
from fpk.observable import Observable, observable_name
from fpk.route import Route
from fpk.system import System

MODES_SHOWN = 4
"""Modes whose boundaries are shown; with constant damping they are alike in all."""


@dataclass(frozen=True)
class Refusal:
    """A route not taken for some observables; ``failed`` when it was tried and did not succeed."""

    route: Route
    observables: tuple[str, ...]
    reason: str
    failed: bool = False


@dataclass(frozen=True)
class Boundary:
    """One end of the averaged energy process and what it is, in Feller's words."""

    process: str
    end: str
    kind: str
    reason: str


@dataclass(frozen=True)
class CurveOutcome:
    """The answers of all routes for one curve, and their comparison."""

    label: str
    system: System
    effects: Effects
    regime: Regime
    boundaries: tuple[Boundary, ...]
    results: tuple[Result, ...]
    refusals: tuple[Refusal, ...]
    comparisons: tuple[Comparison, ...]
    value: float | None = None

    @property
    def judged(self) -> int:
        """How many comparisons are judged."""
        return sum(c.band is not None for c in self.comparisons)

    def densities(self, observable: Observable) -> dict[Route, AnyDensity]:
        """Return the densities of one observable by route."""
        return {
            r.method.route: d
            for r in self.results
            for d in r.densities
            if d.observable == observable
        }

    def neglects(self, route: Route) -> bool:
        """Whether the answer of ``route`` leaves out an effect of the system."""
        return any(r.neglected for r in self.results if r.method.route == route)

    def is_exact(self, route: Route) -> bool:
        """Whether ``route`` gives the exact density: by itself, or as condition (8) holds."""
        exact = self.regime.incompatible is None and not self.neglects(route)
        return exact or route.solves == "full"

    @property
    def problems(self) -> tuple[str, ...]:
        """Every check that does not hold, in words; empty when all do."""
        problems = list(discrepancies(self.comparisons))
        problems += [
            f"{d.name}: {r.method.route.label} is not certified: {failure}"
            for r in self.results
            for d in r.densities
            for failure in d.certificate.failures
        ]
        problems += [f"{r.route.label} failed: {r.reason}" for r in self.refusals if r.failed]
        if not self.refusals and not self.results:
            problems.append("not run: the program was interrupted")
        elif not self.results and not problems:
            reasons = dict.fromkeys(r.reason for r in self.refusals)
            problems.append(f"no route applies: {'; '.join(reasons)}")
        return tuple(f"{self.label}: {p}" if self.label else p for p in problems)


@dataclass(frozen=True)
class Outcome:
    """The curves of a scene, the scene's own first, and the time it all took.

    ``findings`` says what became of the claims in ``[expect]``; they do not count as problems.
    """

    scene: Scene
    curves: tuple[CurveOutcome, ...]
    seconds: float
    findings: tuple[Finding, ...] = ()

    @property
    def problems(self) -> tuple[str, ...]:
        """Every check that does not hold, in words; empty when all do."""
        return tuple(text for curve in self.curves for text in curve.problems)


def run_scene(scene: Scene, methods: Sequence[Method], *, progress: Progress = silent) -> Outcome:
    """Return the answers of ``methods`` for every curve of ``scene``.

    Once a simulation was interrupted, the curves that follow are not run.
    """
    start = perf_counter()
    curves: list[CurveOutcome] = []
    for curve in scene.curves:
        interrupted = any(r.partial for c in curves for r in c.results)
        wanted = () if interrupted else methods
        curves.append(_run_curve(scene, curve, wanted, progress=progress))
    claims = findings(scene.expect, curves)
    return Outcome(scene, tuple(curves), perf_counter() - start, claims)


def boundaries_of(system: System) -> tuple[Boundary, ...]:
    """Return the ends of the averaged energies (24) and (17), of each theory that applies."""
    boundaries = []
    with suppress(NotApplicable):
        ends = classify(energy_process(system))
        boundaries += [Boundary("nonintegrable", e.end, e.kind, e.reason) for e in ends]
    with suppress(NotApplicable):
        process = system.fact(modal_analysis).process()
        for axis in range(min(process.dimension, MODES_SHOWN)):
            edges = classify(process, axis)
            boundaries += [Boundary("integrable", e.end, e.kind, e.reason) for e in edges]
    return tuple(boundaries)


def incompatibility(system: System) -> str | None:
    """Return why the exact theory (7), (8) does not apply, None where it does."""
    try:
        compatibility(system)
    except NotApplicable as reason:
        return str(reason)
    return None


def _run_curve(
    scene: Scene, curve: Curve, methods: Sequence[Method], *, progress: Progress
) -> CurveOutcome:
    results: list[Result] = []
    refusals: list[Refusal] = []
    for method in methods:
        if method.route.unasked(curve.system):
            result, refused = _answer(method, curve.system, scene.observables, progress)
            results += result
            refusals += refused
    incompatible = incompatibility(curve.system)
    return CurveOutcome(
        label=curve.label,
        system=curve.system,
        effects=effects_of(curve.system),
        regime=regime_of(curve.system, incompatible),
        boundaries=boundaries_of(curve.system),
        results=tuple(results),
        refusals=tuple(refusals),
        comparisons=compared(results, averaging_is_exact=incompatible is None),
        value=curve.value,
    )


def _answer(
    method: Method, system: System, observables: Sequence[Observable], progress: Progress
) -> tuple[list[Result], list[Refusal]]:
    """The result of one method for the observables that it gives, and the others refused."""
    names = tuple(observable_name(o) for o in observables)
    route = method.route
    try:
        plan = method.prepare(system)
    except NotApplicable as error:
        return [], [Refusal(route, names, str(error))]
    reasons = [plan.refusal(o) for o in observables]
    refusals = [
        Refusal(route, tuple(n for n, r in zip(names, reasons, strict=True) if r == reason), reason)
        for reason in dict.fromkeys(reasons)
        if reason is not None
    ]
    wanted = [o for o, reason in zip(observables, reasons, strict=True) if reason is None]
    if not wanted:
        return [], refusals
    try:
        return [solved(plan, system, wanted, progress=progress)], refusals
    except (NotApplicable, NotCertified, InvalidInput) as error:
        failed = tuple(observable_name(o) for o in wanted)
        return [], [*refusals, Refusal(route, failed, str(error), failed=True)]
