"""The main job: every curve of a scene by every route that applies, and what they say together."""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from time import perf_counter

from averaging.energy_process import energy_process
from averaging.modal.process import modal_process
from cases.comparison.averaged import AveragedSimulation, worth_running
from cases.comparison.claims import Finding, findings
from cases.comparison.compare import Comparison, compared, route_name
from cases.comparison.regime import Regime, regime_of
from cases.scene.scene import Scene
from cases.scene.vary import Curve
from fpk.density import AnyDensity
from fpk.effects import Effects, effects_of
from fpk.ends import classify
from fpk.errors import InvalidInput, NotApplicable, NotCertified
from fpk.method import Method, Progress, Result, silent
from fpk.observable import Observable, observable_name, parse_observable
from fpk.system import System

MODES_TOLD = 4
"""Modes whose boundaries are told; with constant damping all are alike."""


@dataclass(frozen=True)
class Refusal:
    """A route not taken for some observables; ``failed`` when it was tried and did not succeed."""

    route: str
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
    """What the routes found for one curve."""

    label: str
    system: System
    effects: Effects
    regime: Regime
    boundaries: tuple[Boundary, ...]
    results: tuple[Result, ...]
    refusals: tuple[Refusal, ...]
    comparisons: tuple[Comparison, ...]
    value: float | None = None

    def densities(self, observable: Observable) -> dict[str, AnyDensity]:
        """Return the densities of one observable by route name."""
        return {
            route_name(r.method): d
            for r in self.results
            for d in r.densities
            if d.observable == observable
        }


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
        return tuple(text for curve in self.curves for text in _problems(curve))


def run_scene(scene: Scene, methods: Sequence[Method], *, progress: Progress = silent) -> Outcome:
    """Return what ``methods`` find for every curve of ``scene``.

    Once a simulation was interrupted, the curves that follow are not run.
    """
    start = perf_counter()
    curves: list[CurveOutcome] = []
    for curve in scene.curves:
        stopped = any(r.partial for c in curves for r in c.results)
        wanted = () if stopped else methods
        curves.append(_run_curve(scene, curve, wanted, progress=progress))
    found = findings(scene.expect, curves)
    return Outcome(scene, tuple(curves), perf_counter() - start, found)


def boundaries_of(system: System) -> tuple[Boundary, ...]:
    """Return the ends of the averaged energies (24) and (17), of each theory that applies."""
    found = []
    with suppress(NotApplicable, InvalidInput):
        ends = classify(energy_process(system))
        found += [Boundary("nonintegrable", e.end, e.kind, e.reason) for e in ends]
    with suppress(NotApplicable, InvalidInput):
        process = modal_process(system)
        for axis in range(min(process.dimension, MODES_TOLD)):
            edges = classify(process, axis)
            found += [Boundary("integrable", e.end, e.kind, e.reason) for e in edges]
    return tuple(found)


def incompatibility(system: System, methods: Sequence[Method]) -> str | None:
    """Return why the exact theory (7), (8) does not apply, None where it does."""
    energy = parse_observable("H", system.n)
    return next(
        (m.refusal(system, energy) for m in methods if m.name == "exact"),
        "the exact theory was not asked",
    )


def _run_curve(
    scene: Scene, curve: Curve, methods: Sequence[Method], *, progress: Progress
) -> CurveOutcome:
    results: list[Result] = []
    refusals: list[Refusal] = []
    for method in methods:
        if isinstance(method, AveragedSimulation) and not worth_running(curve.system):
            continue
        reasons = {o: method.refusal(curve.system, o) for o in scene.observables}
        for reason in dict.fromkeys(r for r in reasons.values() if r is not None):
            names = tuple(observable_name(o) for o, r in reasons.items() if r == reason)
            refusals.append(Refusal(route_name(method), names, reason))
        wanted = [o for o, reason in reasons.items() if reason is None]
        if not wanted:
            continue
        try:
            results.append(method.solve(curve.system, wanted, progress=progress))
        except (NotApplicable, NotCertified, InvalidInput) as error:
            names = tuple(observable_name(o) for o in wanted)
            refusals.append(Refusal(route_name(method), names, str(error), failed=True))
    incompatible = incompatibility(curve.system, methods)
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


def _problems(curve: CurveOutcome) -> list[str]:
    where = f"{curve.label}: " if curve.label else ""
    found = [
        f"{where}{c.observable}: {c.a} and {c.b} differ by L1 = {c.L1:.3g},"
        f" allowed is {c.band:.3g} ({c.measures})"
        for c in curve.comparisons
        if not c.holds
    ]
    found += [
        f"{where}{d.name}: {route_name(r.method)} is not certified: {failure}"
        for r in curve.results
        for d in r.densities
        for failure in d.certificate.failures
    ]
    found += [f"{where}{r.route} failed: {r.reason}" for r in curve.refusals if r.failed]
    if not (curve.results or curve.refusals):
        found.append(f"{where}not run: the program was interrupted")
    return found
