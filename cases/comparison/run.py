"""The main job: every curve of a scene by every route that applies, and what they say together."""

from collections.abc import Sequence
from dataclasses import dataclass
from time import perf_counter

from averaging.exact import compatibility
from cases.comparison.claims import Finding, findings
from cases.comparison.compare import Comparison, compared, discrepancies
from cases.scene.scene import Scene
from cases.scene.vary import Curve
from fpk.clearance import StopClearance, stop_clearances
from fpk.density import AnyDensity
from fpk.errors import InvalidInput, NotApplicable, NotCertified
from fpk.method import Method, Progress, Result, silent, solved
from fpk.observable import Observable, observable_name
from fpk.route import Route
from fpk.system import System


@dataclass(frozen=True)
class Refusal:
    """A route not taken for some observables; ``failed`` when it was tried and did not succeed."""

    route: Route
    observables: tuple[str, ...]
    reason: str
    failed: bool = False


@dataclass(frozen=True)
class CurveOutcome:
    """The answers of all routes for one curve, and their comparison; ``value`` as in ``Curve``."""

    label: str
    system: System
    results: tuple[Result, ...]
    refusals: tuple[Refusal, ...]
    comparisons: tuple[Comparison, ...]
    value: float | None = None

    @property
    def stops(self) -> tuple[StopClearance, ...]:
        """Every stop with its clearance over the rms displacement."""
        return self.system.fact(stop_clearances)

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
        exact = incompatibility(self.system) is None and not self.neglects(route)
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
        curves.append(_run_curve(curve, scene.observables, methods=wanted, progress=progress))
    claims = findings(scene.expect, curves)
    return Outcome(scene, tuple(curves), perf_counter() - start, claims)


def incompatibility(system: System) -> str | None:
    """Return why the exact theory (7), (8) does not apply, None where it does."""
    try:
        compatibility(system)
    except NotApplicable as reason:
        return str(reason)
    return None


def answered(
    method: Method,
    system: System,
    observables: Sequence[Observable],
    *,
    progress: Progress = silent,
) -> tuple[list[Result], list[Refusal]]:
    """Return the result of ``method`` for the observables that it gives, and the others refused.

    No result where it gives none of them or fails.
    """
    given: list[Observable] = []
    refused: dict[str, list[Observable]] = {}
    try:
        plan = method.prepare(system)
    except NotApplicable as error:
        return [], [_refusal(method, observables, error)]
    for observable in observables:
        reason = plan.refusal(observable)
        (given if reason is None else refused.setdefault(reason, [])).append(observable)
    refusals = [_refusal(method, names, reason) for reason, names in refused.items()]
    if not given:
        return [], refusals
    try:
        return [solved(plan, system, given, progress=progress)], refusals
    except (NotApplicable, NotCertified, InvalidInput) as error:
        return [], [*refusals, _refusal(method, given, error, failed=True)]


def _refusal(
    method: Method, observables: Sequence[Observable], reason: object, *, failed: bool = False
) -> Refusal:
    return Refusal(method.route, tuple(map(observable_name, observables)), str(reason), failed)


def _run_curve(
    curve: Curve,
    observables: Sequence[Observable],
    *,
    methods: Sequence[Method],
    progress: Progress,
) -> CurveOutcome:
    results: list[Result] = []
    refusals: list[Refusal] = []
    for method in methods:
        if method.route.unasked(curve.system):
            result, refused = answered(method, curve.system, observables, progress=progress)
            results += result
            refusals += refused
    exact = incompatibility(curve.system) is None
    comparisons = compared(results, averaging_is_exact=exact)
    return CurveOutcome(
        curve.label, curve.system, tuple(results), tuple(refusals), comparisons, curve.value
    )
