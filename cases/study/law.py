"""Cost of the full system (6), solved and sampled by every scheme, and of sampling (24)."""

from dataclasses import dataclass, replace
from functools import partial
from math import hypot, sqrt

from cases.compare.averaged import AveragedSimulation
from cases.compare.compare import distance_between
from cases.compare.routes import listed_routes
from cases.study.equations import Equation
from cases.study.levels import Level, timed_first, timing
from cases.study.prices import NotTimed, Priced, judged
from cases.study.simulation import SMALL_STEP, SMALLEST, Reference, largest_stable, observed, run
from fpk.answer.density import Density
from fpk.answer.method import Method, Progress, silent
from fpk.answer.names import observable_name
from fpk.numeric.errors import NotApplicable, NotCertified
from fpk.system.system import System
from sim.montecarlo import MonteCarlo
from sim.sample.diagnostics import Report
from sim.sample.settings import LEAST_PATHS
from sim.step.schemes import SCHEMES

FULL = "full system (6)"
TOLERANCES = (1e-2, 1e-3, 1e-4, 1e-5)
"""L1 errors that are asked for, until one is out of reach of the work that ``fpk run`` allows."""
RELAXATIONS = 4.0
"""Sampled relaxation times of a run at a small step; four times as many at any other."""
PATIENCE = 2.0
"""Seconds of a trial of a small step beyond which no smaller one is tried."""
HALVINGS = 2
"""Halvings of the step while a scheme disagrees with its order of theory, at most."""
FEWEST = 256
"""Paths of the simulation of (24)."""
ERRORS = tuple(10.0**-k for k in (1.0, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0, 10.0))
"""Errors for which the cheapest (dt, N) is given."""
MAX_PATHS = 2.0**20
"""Paths of a modelled run at most; beyond, each is sampled for longer."""
BYTES_A_PATH = 48.0
"""Memory of a path in bytes: a few numbers of eight bytes."""


@dataclass(frozen=True)
class Law:
    """Error of one scheme, L1 = A/√(paths x time) + B dtʳ, and seconds = c (paths x time)/dt.

    ``noise`` is A, ``bias`` B (an upper bound if not ``bias_resolved``), ``order`` r of theory,
    ``step`` c in seconds, ``largest`` the largest stable step, ``relaxation`` the relaxation time.
    """

    scheme: str
    noise: float
    bias: float
    bias_resolved: bool
    order: int
    step: float
    largest: float
    relaxation: float

    def error(self, sampled: float, dt: float) -> float:
        """L1 error expected of ``sampled`` = paths x time at the step ``dt``."""
        return self.noise / sqrt(sampled) + self.bias * dt**self.order

    def cheapest(self, error: float) -> tuple[float, float]:
        """Return (dt, paths x time) that reach ``error`` in the least time.

        Minimising c W/dt under A/√W + B dtʳ = ε leaves the bias the share 1/(2r + 1) of ε.
        """
        r = self.order
        dt = self.largest
        if self.bias > 0.0:
            dt = min(dt, (error / ((2.0 * r + 1.0) * self.bias)) ** (1.0 / r))
        return dt, (self.noise / (error - self.bias * dt**r)) ** 2

    def seconds(self, sampled: float, dt: float) -> float:
        """Return the time of a run on one thread, burn-in of the fewest paths included."""
        return self.step * (sampled + LEAST_PATHS * MonteCarlo.burn_in * self.relaxation) / dt

    def point(self, error: float, unit: str = "") -> Level:
        """Return the cheapest settings for ``error`` with their price by the law, not run.

        ``unit`` is that of the scene's time in words, empty where it has no name.
        """
        dt, sampled = self.cheapest(error)
        paths = max(float(LEAST_PATHS), min(sampled / self.relaxation, MAX_PATHS))
        settings = _settings(f"{paths:.2g}", f"{max(sampled / paths, dt):.2g}", f"{dt:.2g}", unit)
        seconds, memory = self.seconds(sampled, dt), paths * BYTES_A_PATH
        return Level(settings, error, error, seconds, modelled=True, repeats=0, memory=memory)


def _settings(paths: str, time: str, dt: str, unit: str) -> str:
    """Settings of a simulation in words, its times with their unit."""
    own = f" {unit}" if unit else ""
    return f"{paths} paths, time {time}{own}, dt {dt}{own}"


def full_routes(
    system: System,
    reference: Reference,
    *,
    seed: int,
    unit: str = "",
    progress: Progress = silent,
) -> tuple[list[Priced | NotTimed], list[Law]]:
    """Measure the schemes: one run of each, and by the law the cheapest (dt, N) for ``ERRORS``.

    A scheme has its law from the largest step at which it holds; a baseline may have none.
    ``unit`` is that of time in words.
    """
    results: list[Priced | NotTimed] = []
    laws: list[Law] = []
    for scheme in sorted(SCHEMES, key=lambda s: -SCHEMES[s].weak_order):
        method = MonteCarlo(scheme=scheme, seed=seed, threads=1)
        baseline = scheme != MonteCarlo.scheme
        factor = largest_stable(system, method, patience=PATIENCE)
        words = f"no usable step: none down to {SMALLEST:g} of the chosen one is stable and cheap"
        route: Priced | NotTimed = NotTimed(scheme, FULL, reason=words, baseline=baseline)
        factors = [] if factor is None else [factor * 0.5**k for k in range(HALVINGS + 1)]
        for own in factors:  # next to its limit of stability a scheme has no order yet
            law, level = _law(system, method, own, reference.density, unit)
            if level.honest:
                of = f"expected L1 of p({reference.density.name}) of the full system"
                points = level, *(law.point(error, unit) for error in ERRORS)
                axis = f"sampling and step error: {of}"
                route = Priced(f"{scheme}, (dt, N)", FULL, axis, points)
                laws.append(law)
                break
            words = f"differs from the {reference.words} by more than chance and its order explain"
            measured = level.settings, level.distance, level.estimate
            route = NotTimed(scheme, FULL, *measured, reason=words, baseline=baseline)
        results.append(route)
        progress(len(results), len(SCHEMES), f"cost of {FULL}")
    return results, laws


def _law(
    system: System, method: MonteCarlo, factor: float, reference: Density, unit: str
) -> tuple[Law, Level]:
    """Bias from the largest stable step, noise and speed at 0.7 of it or at the chosen one.

    The second run must be where the law says: what is wrong at any step alike is no bias of a step.
    """
    order, observables = SCHEMES[method.scheme].weak_order, [reference.observable]
    few = replace(method, relaxations=4.0 * RELAXATIONS)
    if factor < SMALL_STEP:
        few = replace(method, paths=LEAST_PATHS, relaxations=RELAXATIONS)
    first, result = run(system, replace(few, step_factor=factor), observables)
    distance, expected, _ = distance_between(result.densities[0], reference)
    noise = hypot(expected - reference.l1_error, reference.l1_error)
    resolved = distance > 2.0 * noise
    bias = sqrt(distance**2 - noise**2) if resolved else 2.0 * noise
    usual, result = run(system, replace(few, step_factor=min(0.7 * factor, 1.0)), observables)
    distance, expected, allowed = distance_between(result.densities[0], reference)
    assert isinstance(result.report, Report)
    at, share = result.report, (usual.dt / first.dt) ** order
    law = Law(
        scheme=method.scheme,
        noise=(expected - reference.l1_error) * sqrt(usual.sampled),
        bias=bias / first.dt**order,
        bias_resolved=resolved,
        order=order,
        step=usual.seconds * at.dt / (at.paths * (at.time + at.burn_in)),
        largest=first.dt,
        relaxation=at.relaxation_time,
    )
    error = law.error(usual.sampled, usual.dt)
    level = Level(
        _settings(f"{at.paths}", f"{at.time:.3g}", f"{at.dt:.3g}", unit),
        error,
        error,
        usual.seconds,
        distance,
        # The bias itself is known to the noise of the run that it was read from. Twice the error of
        # the reference: its mean is what chance makes of it, not the worst case.
        allowed + (bias + noise) * share + reference.l1_error,
    )
    return law, level


def averaged_route(system: System, equation: Equation, *, seed: int) -> Priced | NotTimed:
    """Return the simulation of (24), run once."""
    p = equation.reference
    method = AveragedSimulation("nonintegrable", seed=seed, threads=1, paths=FEWEST)
    result, seconds = timed_first(lambda: method.solve(system, [p.observable]))
    distance, expected, allowed = distance_between(result.densities[0], p)
    settings = f"{method.paths} paths, step {method.step:g}"
    mean = expected - p.l1_error
    level = Level(settings, mean, mean, seconds, distance, allowed)
    axis = "sampling error: expected L1 of p(H), within chance of the reference"
    words = f"differs from the {equation.reference_words} by more than chance explains"
    return judged(method.route.label, equation.name, axis, [level], words)


def solved_routes(
    system: System, *, progress: Progress = silent
) -> tuple[list[Priced | NotTimed], Reference | None]:
    """Return the slow routes that solve (6), and the density with the least error of all of them.

    The errors are those that the answers state. An answer that differs from the best one by more
    than both state is not timed, nor is a route that ``fpk run`` leaves out.
    """
    results: list[Priced | NotTimed] = []
    best: Reference | None = None
    for route in listed_routes():
        if route.solves != "full" or route.sampled or route.quick:
            continue
        try:
            answers = _answers(route.make().unasked(system), system, progress)
        except (NotApplicable, NotCertified) as reason:
            results.append(NotTimed(route.label, FULL, reason=str(reason)))
            continue
        finest = min((p for _, p in answers), key=lambda p: p.l1_error)
        if best is None or finest.l1_error < best.density.l1_error:
            best = Reference(route.label, finest, finest)
        points = []
        for level, p in answers:
            distance, allowed, _ = distance_between(p, finest)
            points.append(replace(level, distance=distance, estimate=allowed))
        axis = f"numerical, as stated: L1 of p({observable_name(observed(system))})"
        words = "differs from its own finest answer by more than both state"
        results.append(judged(route.label, FULL, axis, points, words))
    return results, best


def _answers(method: Method, system: System, progress: Progress) -> list[tuple[Level, Density]]:
    """The answer to each tolerance and its price; the last one met, or as near as work allows."""
    answers: list[tuple[Level, Density]] = []
    for tol in TOLERANCES:
        asked: Method = replace(method, tol=tol)  # type: ignore[type-var]
        work = partial(asked.solve, system, [observed(system)], progress=progress)
        result, first = timed_first(work)
        (p,) = result.densities
        assert isinstance(p, Density)
        met = p.l1_error <= tol
        level = Level(
            settings=f"tol = {tol:.0e}" if met else f"tol = {tol:.0e}, not met",
            error=p.l1_error,
            stated=p.l1_error,
            promised=tol if met else p.l1_error,
            **timing(work, first),
        )
        answers.append((level, p))
        if not met:
            break
    return answers
