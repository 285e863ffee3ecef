"""What sampling routes cost: simulation of (24), and of the full system by every scheme."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from math import isfinite, sqrt
from time import perf_counter

import numpy as np
from scipy.interpolate import PchipInterpolator

from averaging.exact import Exact
from averaging.gaussian import Linear
from cases.averaged import AveragedSimulation
from cases.compare import BINS_1D, chance_l1
from cases.study.equations import Equation
from cases.study.priced import NotTimed, Point, Priced
from cases.study.timing import Timing, peak_memory
from fpk.density import Array, Certificate, Density, SampledDensity
from fpk.errors import InvalidInput
from fpk.method import Method, Progress, silent
from fpk.observable import Observable, observable_name
from fpk.system import System
from sim.montecarlo import LEAST_PATHS, MonteCarlo
from sim.scheme import SCHEMES

FULL = "full system (6)"
RELAXATIONS = (4.0, 16.0, 64.0)
"""Sampled relaxation times of the runs at the chosen step."""
REFERENCE_RELAXATIONS = 300.0
"""Of the simulation that stands for the full system where no closed form does."""
BURN_IN = 10.0
PATHS = 8192
AVERAGED_PATHS = (256, 1024, 4096)
ERRORS = tuple(10.0**-k for k in (1.0, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0, 10.0))
"""Errors for which the cheapest (dt, N) is given; up to 1e-3 it is drawn."""
TRIAL = 0.25
"""Relaxation times of a trial run that finds the largest stable step."""
SLOWEST = 2.0**-8
SMALLER = 2
"""Times that the step is halved where a scheme is not yet where its order says."""


@dataclass(frozen=True, eq=False)
class FullReference:
    """Shares of the bins of p(q_i) of the full system, and the L1 error of what they rest on."""

    words: str
    shares: Callable[[Array], Array]
    error: float


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
        left = error - self.bias * dt**r
        return dt, (self.noise / left) ** 2

    def seconds(self, sampled: float, dt: float) -> float:
        """Return the wall time of a run on one thread, burn-in of the fewest paths included."""
        return self.step * (sampled + LEAST_PATHS * BURN_IN * self.relaxation) / dt


def coarse(sampled: SampledDensity) -> SampledDensity:
    """Join bins to about 128, as the comparison does."""
    bins = sampled.edges[0].size - 1
    return sampled.coarsened(bins // BINS_1D) if bins % BINS_1D == 0 else sampled


def sampled_distance(sampled: SampledDensity, shares: Array) -> float:
    """Return Σ |share − true share| over the bins, all outside of them being one more bin."""
    found = sampled.values * np.diff(sampled.edges[0])
    left = found - shares
    return float(np.sum(np.abs(left)) + abs(np.sum(left)))


def full_reference(
    system: System, observable: Observable, *, seed: int, relaxations: float
) -> FullReference:
    """Return the full system's p(q_i): a closed form, or a long simulation at 0.7 of the step."""
    methods: tuple[Method, ...] = (Exact(), Linear())
    for method in methods:
        if method.refusal(system, observable) is None:
            (density,) = method.solve(system, [observable]).densities
            assert isinstance(density, Density)
            return FullReference(f"closed form, {method.name}", _shares(density), density.l1_error)
    run = MonteCarlo(paths=PATHS, relaxations=relaxations, seed=seed + 7919, step_factor=sqrt(0.5))
    (found,) = run.solve(system, [observable]).densities
    assert isinstance(found, SampledDensity)
    edges = found.edges[0]
    inside = np.concatenate([[0.0], np.cumsum(found.values * np.diff(edges))])
    # Between the edges of 1024 bins the distribution function is smooth to far below the noise.
    cdf = PchipInterpolator(edges, inside)

    def shares(wanted: Array) -> Array:
        return np.diff(cdf(np.clip(wanted, edges[0], edges[-1])))

    return FullReference("long simulation", shares, chance_l1(coarse(found))[0])


def _shares(density: Density) -> Callable[[Array], Array]:
    def shares(edges: Array) -> Array:
        return np.asarray(density.cell_averages(edges) * np.diff(edges))

    return shares


def full_routes(
    system: System,
    observable: Observable,
    reference: FullReference,
    *,
    seed: int,
    progress: Progress = silent,
) -> tuple[list[Priced], list[NotTimed], list[Law]]:
    """Measure the schemes, and return their points: in N at the chosen step, and in (dt, N)."""
    good: list[Priced] = []
    bad: list[NotTimed] = []
    laws: list[Law] = []
    name = observable_name(observable)
    axis = f"sampling and step error: expected L1 of p({name}) of the full system"
    for k, scheme in enumerate(sorted(SCHEMES, key=lambda s: -SCHEMES[s].weak_order)):
        progress(k, len(SCHEMES), f"cost of {FULL}")
        method = MonteCarlo(paths=PATHS, scheme=scheme, seed=seed, threads=1)
        factor = _largest_stable(system, observable, method)
        if factor is None:
            nan = float("nan")
            words = "no stable step down to 1/256 of the chosen one is cheap enough to try"
            bad.append(NotTimed(scheme, FULL, "", nan, nan, words))
            continue
        law = _law(system, observable, method, factor, reference)
        for _ in range(SMALLER):  # next to its limit of stability a scheme has no order yet
            if isinstance(law, Law):
                break
            factor *= 0.5
            law = _law(system, observable, method, factor, reference)
        if isinstance(law, NotTimed):
            bad.append(law)
            continue
        laws.append(law)
        if scheme == "exact_flow":
            found = _in_samples(system, observable, method, law, reference)
            (bad if isinstance(found, NotTimed) else good).append(found)  # type: ignore[arg-type]
        good.append(
            Priced(f"{scheme}, (dt, N)", FULL, axis, tuple(_modelled(law, e) for e in ERRORS))
        )
    good = [replace(p, axis=axis) for p in good]
    progress(len(SCHEMES), len(SCHEMES), f"cost of {FULL}")
    return good, bad, laws


def _run(
    system: System, observable: Observable, method: MonteCarlo
) -> tuple[SampledDensity, dict[str, float], float]:
    start = perf_counter()
    result = method.solve(system, [observable])
    seconds = perf_counter() - start
    (found,) = result.densities
    assert isinstance(found, SampledDensity)
    keys = ("dt", "time", "paths", "ns_per_particle_step", "relaxation_time")
    return coarse(found), {key: float(result.settings[key]) for key in keys}, seconds


def _largest_stable(system: System, observable: Observable, method: MonteCarlo) -> float | None:
    factor = 4.0
    trial = replace(method, paths=LEAST_PATHS, relaxations=TRIAL, burn_in=1.0)
    while factor > SLOWEST:
        try:
            found, _, seconds = _run(system, observable, replace(trial, step_factor=factor))
            if np.all(np.isfinite(found.values)) and not _lost(found):
                return factor
            if seconds > 2.0 and factor < 0.25:
                return None
        except (InvalidInput, ValueError):  # the limit of the scheme, or no range for a histogram
            pass
        factor /= sqrt(2.0) if factor > 0.5 else 2.0
    return None


def _lost(found: SampledDensity) -> bool:
    return any("finite range" in words for words in found.certificate.failures)


def _law(
    system: System,
    observable: Observable,
    method: MonteCarlo,
    factor: float,
    reference: FullReference,
) -> Law | NotTimed:
    """Bias from the largest stable step, noise and speed at 0.7 of it or at the chosen one.

    The second run must be where the law says: what is wrong at any step alike is no bias of a step.
    """
    scheme = SCHEMES[method.scheme]
    few = replace(method, relaxations=RELAXATIONS[1])
    if factor < 0.25:
        few = replace(method, paths=LEAST_PATHS, relaxations=RELAXATIONS[0])
    biased, found, _ = _run(system, observable, replace(few, step_factor=factor))
    distance = sampled_distance(biased, reference.shares(biased.edges[0]))
    noise = float(np.hypot(chance_l1(biased)[0], reference.error))
    resolved = distance > 2.0 * noise
    bias = sqrt(distance**2 - noise**2) if resolved else 2.0 * noise
    usual, at, _ = _run(system, observable, replace(few, step_factor=min(0.7 * factor, 1.0)))
    sampled = at["paths"] * at["time"]
    true = sampled_distance(usual, reference.shares(usual.edges[0]))
    # The bias itself is known to the noise of the run that it was read from.
    left = (bias + noise) * (at["dt"] / found["dt"]) ** scheme.weak_order
    allowed = chance_l1(usual)[1] + left + 2.0 * reference.error
    if not true <= allowed:
        words = f"differs from the {reference.words} by more than chance and its order explain"
        return NotTimed(scheme.name, FULL, f"dt {at['dt']:.3g}", true, allowed, words)
    return Law(
        scheme=method.scheme,
        noise=chance_l1(usual)[0] * sqrt(sampled),
        bias=bias / found["dt"] ** scheme.weak_order,
        bias_resolved=resolved,
        order=scheme.weak_order,
        step=1e-9 * at["ns_per_particle_step"],
        largest=found["dt"],
        relaxation=at["relaxation_time"],
    )


def _in_samples(
    system: System,
    observable: Observable,
    method: MonteCarlo,
    law: Law,
    reference: FullReference,
) -> Priced | NotTimed:
    """Points in N at the chosen step; each must agree with the reference within chance."""
    route, points = "exact_flow, N", []
    for relaxations in RELAXATIONS:
        own = replace(method, relaxations=relaxations)
        found, at, first = _run(system, observable, own)
        true = sampled_distance(found, reference.shares(found.edges[0]))
        mean, quantile = chance_l1(found)
        bias = law.bias * at["dt"] ** law.order
        # Twice the reference's error: its mean says what chance makes of it, not the worst case.
        allowed = quantile + bias + 2.0 * reference.error
        settings = f"{at['paths']:.0f} paths, time {at['time']:.3g}, dt {at['dt']:.3g}"
        if not true <= allowed:
            words = f"differs from the {reference.words} by more than chance and step explain"
            return NotTimed(route, FULL, settings, true, allowed, words)
        start = perf_counter()
        _run(system, observable, own)
        again = perf_counter() - start
        again_so = partial(_run, system, observable, own)
        memory = peak_memory(again_so) if again < 1.0 else float("nan")
        timing = Timing(
            seconds=min(first, again),
            spread=0.5 * abs(first - again),
            repeats=2,
            first=max(0.0, first - again),
            coefficients=0.0,
            memory=memory,
        )
        points.append(Point(settings, mean + bias, mean + bias, timing))
    return Priced(route, FULL, "", tuple(points))


def _modelled(law: Law, error: float) -> Point:
    dt, sampled = law.cheapest(error)
    seconds = law.seconds(sampled, dt)
    paths = max(float(LEAST_PATHS), min(sampled / law.relaxation, 2.0**20))
    settings = f"{paths:.2g} paths, time {max(sampled / paths, dt):.2g}, dt {dt:.2g}"
    memory = paths * 8.0 * 6.0
    timing = Timing(seconds, 0.0, 0, 0.0, 0.0, memory)
    return Point(settings, error, error, timing, modelled=True)


def averaged_route(
    system: System, equation: Equation, *, seed: int, progress: Progress = silent
) -> Priced | NotTimed:
    """Return the simulation of (24) in N: the same equation as the elements solve, by sampling."""
    method = AveragedSimulation("nonintegrable", seed=seed, threads=1)
    reference = equation.reference
    density = Density(
        equation.observable,
        reference.panels,
        reference.density,
        lambda *H: 0.0 * H[0],
        reference.l1_error,
        Certificate(0.0, 0.0, 0.0, 0.0),
    )
    points = []
    for k, paths in enumerate(AVERAGED_PATHS):
        progress(k, len(AVERAGED_PATHS), "simulation of (24)")
        own = replace(method, paths=paths)
        start = perf_counter()
        (found,) = own.solve(system, [equation.observable]).densities
        first = perf_counter() - start
        assert isinstance(found, SampledDensity)
        sampled = coarse(found)
        true = sampled_distance(sampled, _shares(density)(sampled.edges[0]))
        mean, quantile = chance_l1(sampled)
        allowed = quantile + reference.l1_error
        settings = f"{paths} paths, step {own.step:g}"
        if not (isfinite(true) and true <= allowed):
            words = "differs from the closed form by more than chance explains"
            return NotTimed("simulation of (24)", equation.name, settings, true, allowed, words)
        compiled = 0.0
        if k == 0:  # the first run compiles
            start = perf_counter()
            own.solve(system, [equation.observable])
            compiled = max(0.0, first - (perf_counter() - start))
        timing = Timing(first - compiled, np.nan, 1, compiled, np.nan, np.nan)
        points.append(Point(settings, mean, mean, timing))
    axis = "sampling error: expected L1 of p(H), found within chance of the reference"
    return Priced("simulation of (24)", equation.name, axis, tuple(points))
