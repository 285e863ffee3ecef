"""What sampling costs: the full system by every scheme, and the averaged equation (24)."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from math import inf, sqrt

import numpy as np

from cases.comparison.averaged import AveragedSimulation
from cases.comparison.compare import chance_l1, joined
from cases.studies.full_system import PATHS, Reference, Run, largest_stable, run
from cases.studies.levels import Equation, Level, Work
from cases.studies.prices import NotTimed, Priced, priced
from cases.studies.timing import Timing, timed_first
from fpk.certificate import Measured
from fpk.density import Density, SampledDensity, certified_density, l1_distance
from fpk.method import Progress, Result, silent
from fpk.system import System
from sim.montecarlo import LEAST_PATHS, MonteCarlo
from sim.report import Report, Steps
from sim.scheme import SCHEMES

FULL = "full system (6)"
RELAXATIONS, LEVELS = 4.0, 3
"""Sampled relaxation times of the first run at the chosen step, and runs, each a refinement."""
SMALLEST, PATIENCE = 2.0**-8, 2.0
"""Smallest step tried, in chosen ones, and seconds of a trial beyond which no smaller one is."""
HALVINGS = 2
"""Times that the step is halved where a scheme is not yet where its order says."""
FEWEST = 256
"""Paths of the first simulation of (24)."""
LONG = 5.0
"""Seconds of a simulation beyond which it is not refined."""
ERRORS = tuple(10.0**-k for k in (1.0, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0, 10.0))
"""Errors for which the cheapest (dt, N) is given."""
MAX_PATHS = 2.0**20
"""Paths of a modelled run at most; beyond, each is sampled for longer."""
BYTES_A_PATH = 48.0
"""State of a path: a few numbers of eight bytes; histograms are small beside it."""


@dataclass(frozen=True)
class Law:
    """Error of one scheme, L1 = A/√(paths x time) + B dtʳ, and seconds = c (paths x time)/dt.

    ``noise`` A, ``bias`` B with the ``order`` r of theory, ``bias_resolved`` False where B is an
    upper bound; ``step`` c in seconds; ``largest`` the largest stable step; ``relaxation`` the time
    that burn-in counts in.
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

    def point(self, error: float) -> Level:
        """Return the cheapest settings for ``error`` with their price by the law, not run."""
        dt, sampled = self.cheapest(error)
        paths = max(float(LEAST_PATHS), min(sampled / self.relaxation, MAX_PATHS))
        timing = Timing(self.seconds(sampled, dt), 0.0, 0, 0.0, 0.0, paths * BYTES_A_PATH)
        settings = f"{paths:.2g} paths, time {max(sampled / paths, dt):.2g}, dt {dt:.2g}"
        return Level(settings, error, error, timing, modelled=True)


def full_routes(
    system: System, reference: Reference, *, seed: int, progress: Progress = silent
) -> tuple[list[Priced | NotTimed], list[Law]]:
    """Measure the schemes, and return their points: refined at the chosen step, and in (dt, N).

    A baseline without a step at which its law holds is named and not timed: it is no failure.
    """
    results: list[Priced | NotTimed] = []
    laws: list[Law] = []
    axis = f"sampling and step error: expected L1 of p({reference.density.name}) of the full system"
    for k, scheme in enumerate(sorted(SCHEMES, key=lambda s: -SCHEMES[s].weak_order)):
        progress(k, len(SCHEMES), f"cost of {FULL}")
        method = MonteCarlo(paths=PATHS, scheme=scheme, seed=seed, threads=1)
        baseline = scheme != MonteCarlo.scheme
        law = _law_at_some_step(system, method, reference)
        if isinstance(law, NotTimed):
            results.append(replace(law, baseline=baseline))
            continue
        laws.append(law)
        if not baseline:
            results.append(_simulated(system, method, law, reference, axis))
        points = tuple(law.point(error) for error in ERRORS)
        results.append(Priced(f"{scheme}, (dt, N)", FULL, axis, points, sampled=True))
    progress(len(SCHEMES), len(SCHEMES), f"cost of {FULL}")
    return results, laws


def _law_at_some_step(system: System, method: MonteCarlo, reference: Reference) -> Law | NotTimed:
    """Return the law from the largest step at which it holds: at most ``HALVINGS`` halvings."""
    factor = largest_stable(system, method, smallest=SMALLEST, patience=PATIENCE)
    if factor is None:
        words = f"no usable step: none down to {SMALLEST:g} of the chosen one is stable and cheap"
        return NotTimed(method.scheme, FULL, reason=words)
    for k in range(HALVINGS + 1):  # next to its limit of stability a scheme has no order yet
        law = _law(system, method, factor * 0.5**k, reference)
        if isinstance(law, Law):
            break
    return law


def _law(system: System, method: MonteCarlo, factor: float, reference: Reference) -> Law | NotTimed:
    """Bias from the largest stable step, noise and speed at 0.7 of it or at the chosen one.

    The second run must be where the law says: what is wrong at any step alike is no bias of a step.
    """
    order, density = SCHEMES[method.scheme].weak_order, reference.density
    few = replace(method, relaxations=4.0 * RELAXATIONS)
    if factor < 0.25:
        few = replace(method, paths=LEAST_PATHS, relaxations=RELAXATIONS)

    def measured(factor: float) -> tuple[Run, Steps, float, float, float]:
        own, result = run(system, replace(few, step_factor=factor), [density.observable])
        return own, _steps(result), *_distance(result, density)

    first, _, distance, mean, _ = measured(factor)
    noise = float(np.hypot(mean, density.l1_error))
    resolved = distance > 2.0 * noise
    bias = sqrt(distance**2 - noise**2) if resolved else 2.0 * noise
    usual, at, true, mean, quantile = measured(min(0.7 * factor, 1.0))
    largest = first.dt
    # The bias itself is known to the noise of the run that it was read from.
    left = (bias + noise) * (at.dt / largest) ** order
    allowed = quantile + left + 2.0 * density.l1_error
    if not true <= allowed:
        words = f"differs from the {reference.words} by more than chance and its order explain"
        return NotTimed(method.scheme, FULL, f"dt {at.dt:.3g}", true, allowed, words)
    return Law(
        scheme=method.scheme,
        noise=mean * sqrt(usual.sampled),
        bias=bias / largest**order,
        bias_resolved=resolved,
        order=order,
        step=usual.seconds * at.dt / (at.paths * (at.time + at.burn_in)),
        largest=largest,
        relaxation=at.relaxation_time,
    )


def _simulated(
    system: System, method: MonteCarlo, law: Law, reference: Reference, axis: str
) -> Priced | NotTimed:
    """The simulation at its chosen step and its refinements."""

    def described(result: Result) -> tuple[str, float]:
        at = _steps(result)
        words = f"{at.paths} paths, time {at.time:.3g}, dt {at.dt:.3g}"
        return words, law.bias * at.dt**law.order

    few = replace(method, relaxations=RELAXATIONS)
    return _priced(few, system, reference, Priced(few.route.label, FULL, axis, (), True), described)


def averaged_route(system: System, equation: Equation, *, seed: int) -> Priced | NotTimed:
    """Return the simulation of (24) and its refinements."""
    p = equation.reference
    measured = Measured(p.l1_error, 0.0, 0.0, 0.0, 0.0)
    density = certified_density(
        equation.observable, p.panels, p.density, lambda H: 0.0 * H, measured=measured, tol=inf
    )
    method = AveragedSimulation("nonintegrable", seed=seed, threads=1, paths=FEWEST)

    def described(result: Result) -> tuple[str, float]:
        assert isinstance(result.method, AveragedSimulation)
        return f"{result.method.paths} paths, step {result.method.step:g}", 0.0

    axis = "sampling error: expected L1 of p(H), within chance of the reference"
    empty = Priced(method.route.label, equation.name, axis, (), True)
    return _priced(method, system, Reference(equation.reference_words, density), empty, described)


def _priced(
    method: AveragedSimulation | MonteCarlo,
    system: System,
    reference: Reference,
    empty: Priced,
    described: Callable[[Result], tuple[str, float]],
) -> Priced | NotTimed:
    """The method and its refinements; ``described`` gives settings in words and the step error."""

    def levels() -> Iterator[tuple[Work, Level]]:
        level, density = method, reference.density
        for k in range(LEVELS):
            level = level.refined() if k else level
            work = partial(level.solve, system, [density.observable])
            result, seconds = timed_first(work)
            distance, mean, quantile = _distance(result, density)
            settings, bias = described(result)
            # Twice the reference's error: its mean is what chance makes of it, not the worst case.
            estimate = quantile + bias + 2.0 * density.l1_error
            error, timing = mean + bias, Timing(seconds)
            yield work, Level(settings, error, error, timing, distance, estimate)

    warm_up = partial(method.solve, system, [reference.density.observable])
    return priced(empty, levels(), warm_up=warm_up, reference=reference.words, longest=LONG)


def _steps(result: Result) -> Steps:
    assert isinstance(result.report, Report)
    return result.report.steps


def _distance(result: Result, reference: Density) -> tuple[float, float, float]:
    """L1 distance of the one density to the reference, its mean by chance alone and quantile."""
    (density,) = result.densities
    assert isinstance(density, SampledDensity)
    return l1_distance(joined(density), reference), *chance_l1(joined(density))
