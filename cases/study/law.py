"""Cost of the full system (6), solved and sampled by every scheme, and of sampling (24)."""

from dataclasses import dataclass, replace
from functools import partial
from math import hypot, sqrt

from cases.compare.averaged import AveragedSimulation
from cases.compare.compare import distance_between
from cases.compare.routes import all_routes
from cases.study.equations import Equation
from cases.study.levels import Level, time_call
from cases.study.prices import PRICED_DIGITS, NotTimed, Priced, answers_by_tolerance, price_route
from cases.study.simulation import (
    MIN_ORDER_SIGNAL,
    PILOT,
    SECONDS,
    SHARE_OF_A_TRIAL,
    SMALL_STEP,
    SMALLEST_FACTOR,
    Reference,
    displacement_of_study,
    largest_stable,
    time_simulation,
)
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
"""L1 errors asked of solvers of (6), until one is out of reach of the work ``fpk run`` allows."""
HALVINGS = 2
"""Halvings of the step while a scheme disagrees with its order of theory, at most."""
FEWEST = 256
"""Paths of the simulation of (24)."""
MAX_PATHS = 2.0**20
"""Paths of a modelled run at most; beyond, each is sampled for longer."""
BYTES_A_PATH = 48.0
"""Memory of a path in bytes: a few numbers of eight bytes."""


@dataclass(frozen=True)
class Law:
    """Error of a scheme, L1 = A/√(paths x time) + B dtʳ, and its seconds = c (paths x time)/dt.

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
        """Return the expected L1 error of ``sampled`` = paths x time at the step ``dt``."""
        return self.noise / sqrt(sampled) + self.bias * dt**self.order

    def cheapest(self, error: float) -> tuple[float, float]:
        """Return (dt, paths x time) that reach ``error`` in the least time.

        Minimising c W/dt under A/√W + B dtʳ = ε leaves the bias the share 1/(2r + 1) of ε, less if
        dt is limited by ``largest``.
        """
        r = self.order
        dt = self.largest
        if self.bias > 0.0:
            dt = min(dt, (error / ((2.0 * r + 1.0) * self.bias)) ** (1.0 / r))
        return dt, (self.noise / (error - self.bias * dt**r)) ** 2

    def seconds(self, sampled: float, dt: float) -> float:
        """Return the seconds of a run on one thread, burn-in of the fewest paths included.

        ``sampled`` = paths x time and the step ``dt`` are in the scene's unit of time.
        """
        return self.step * (sampled + LEAST_PATHS * MonteCarlo.burn_in * self.relaxation) / dt

    def point(self, error: float, unit: str = "") -> Level:
        """Return the cheapest settings for ``error`` with their price by the law, not run.

        ``unit`` is the name of the scene's unit of time, empty if it has none.
        """
        dt, sampled = self.cheapest(error)
        paths = max(float(LEAST_PATHS), min(sampled / self.relaxation, MAX_PATHS))
        settings = _settings(f"{paths:.2g}", f"{max(sampled / paths, dt):.2g}", f"{dt:.2g}", unit)
        seconds, memory = self.seconds(sampled, dt), paths * BYTES_A_PATH
        return Level(settings, error, error, seconds, modelled=True, repeats=0, memory=memory)


def _settings(paths: str, time: str, dt: str, unit: str) -> str:
    """Return the settings of a simulation in words, its times with their unit."""
    own = f" {unit}" if unit else ""
    return f"{paths} paths, time {time}{own}, dt {dt}{own}"


def price_schemes(
    system: System,
    reference: Reference,
    *,
    seed: int,
    unit: str = "",
    progress: Progress = silent,
) -> tuple[list[Priced | NotTimed], list[Law]]:
    """Return the price of the full system by every scheme, and the laws that agree with a run.

    A scheme is run at its largest stable step or halves of it, until its law agrees with the
    distance to ``reference``; the law then prices the cheapest (dt, N) for each error. Without
    agreement it is not timed, which is no failure of a baseline: a scheme other than the default.
    ``unit`` is the scene's unit of time in words, ``seed`` the seed of the simulations.
    """
    results: list[Priced | NotTimed] = []
    laws: list[Law] = []
    for scheme in sorted(SCHEMES, key=lambda s: -SCHEMES[s].weak_order):
        method = MonteCarlo(scheme=scheme, seed=seed, threads=1)
        baseline = scheme != MonteCarlo.scheme
        factor = largest_stable(system, method, patience=SHARE_OF_A_TRIAL * SECONDS)
        words = (
            f"no usable step: none down to {SMALLEST_FACTOR:g} of the chosen one is stable and"
            " cheap"
        )
        route: Priced | NotTimed = NotTimed(scheme, FULL, reason=words, baseline=baseline)
        factors = [] if factor is None else [factor * 0.5**k for k in range(HALVINGS + 1)]
        for own in factors:  # next to its limit of stability a scheme has no order yet
            law, level = _law(system, method, own, reference.density, unit)
            if level.honest:
                of = f"expected L1 of p({reference.density.name}) of the full system"
                digits = sorted({*PRICED_DIGITS, 1.5, 2.5})  # finer where the law is drawn
                points = level, *(law.point(10.0**-d, unit) for d in digits)
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
    """Return the law of a scheme and the level that tests it.

    The bias is from the distance to ``reference`` of a run at the largest step, ``factor`` times
    the chosen step; noise and speed are from a second run at 0.7 of it, at most at the chosen step.
    The level is honest if the distance of the second run agrees with the law: an error that is
    equal at both steps is no bias of the step.
    """
    order, observables = SCHEMES[method.scheme].weak_order, [reference.observable]
    few = replace(method, relaxations=4.0 * PILOT)
    if factor < SMALL_STEP:
        few = replace(method, paths=LEAST_PATHS, relaxations=PILOT)
    first, result = time_simulation(system, replace(few, step_factor=factor), observables)
    distance, expected, _ = distance_between(result.densities[0], reference)
    noise = hypot(expected - reference.l1_error, reference.l1_error)
    resolved = distance > MIN_ORDER_SIGNAL * noise
    bias = sqrt(distance**2 - noise**2) if resolved else MIN_ORDER_SIGNAL * noise
    usual, result = time_simulation(
        system, replace(few, step_factor=min(0.7 * factor, 1.0)), observables
    )
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


def price_averaged_simulation(
    system: System, equation: Equation, *, seed: int
) -> Priced | NotTimed:
    """Return the price of simulating (24), run once and compared with ``equation.reference``."""
    p = equation.reference
    method = AveragedSimulation("nonintegrable", seed=seed, threads=1, paths=FEWEST)
    result, seconds = time_call(lambda: method.solve(system, [p.observable]))
    distance, expected, allowed = distance_between(result.densities[0], p)
    settings = f"{method.paths} paths, step {method.step:g}"
    mean = expected - p.l1_error
    level = Level(settings, mean, mean, seconds, distance, allowed)
    axis = "sampling error: expected L1 of p(H), within chance of the reference"
    words = f"differs from the {equation.reference_words} by more than chance explains"
    return price_route(method.route.label, equation.name, axis, [level], words)


def price_solutions(
    system: System, *, progress: Progress = silent
) -> tuple[list[Priced | NotTimed], Reference | None]:
    """Return the slow routes that solve (6), and the density with the least error of all of them.

    The errors are stated by the answers. A route is not timed if an answer differs from its best
    answer by more than both state, or if ``fpk run`` would not take it.
    """
    results: list[Priced | NotTimed] = []
    best: Reference | None = None
    for route in all_routes():
        if route.solves != "full" or route.sampled or route.quick:
            continue
        try:
            method = route.make().unasked(system)
            answers = answers_by_tolerance(
                partial(_density_within, method, system, progress), lambda p: p.l1_error, TOLERANCES
            )
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
        axis = f"numerical, as stated: L1 of p({observable_name(displacement_of_study(system))})"
        words = "differs from its own finest answer by more than both state"
        results.append(price_route(route.label, FULL, axis, points, words))
    return results, best


def _density_within(method: Method, system: System, progress: Progress, tol: float) -> Density:
    """Return the density of ``displacement_of_study`` to the L1 tolerance ``tol``.

    If the work that ``method`` allows ends before, its certificate states the error reached.
    """
    asked: Method = replace(method, tol=tol)  # type: ignore[type-var]
    (p,) = asked.solve(system, [displacement_of_study(system)], progress=progress).densities
    assert isinstance(p, Density)
    return p
