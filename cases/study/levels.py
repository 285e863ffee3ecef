"""Levels of refinement of one averaged equation, each measured against a reference, and timed.

A study is a loop: ``refined_levels`` solves, measures the error, and goes on with ``refined()``.
Convergence and cost differ only in what they do with the levels. Times are processor times: on one
thread those are the wall times of an idle machine, whatever else runs beside.
"""

import tracemalloc
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from math import exp, inf, nan, sqrt
from statistics import quantiles
from time import process_time
from timeit import repeat
from typing import Any, Literal, TypeVar

import numpy as np

from averaging.zero_flux import ENERGY_RULES, ZeroFluxDensity, density_of_energies
from fpk.answer.density import Density
from fpk.answer.names import Observable
from fpk.numeric.arrays import Array
from fpk.numeric.quadrature import gauss_grid, integral
from fpk.solvers.line.stationary import StationarySolution
from fpk.solvers.plane.solution import PlaneSolution
from fpk.system.process import Coefficients

T = TypeVar("T")

REPEATS = 3, 21
"""Least and largest number of timed runs."""
ENOUGH = 0.1
"""Seconds that the timed runs take together, if their least number does not take longer."""
LONG = 1.0
"""Seconds of a first run above which it is the only one: its spread and memory stay unknown."""
NORMS = ("L1", "L2", "max")
FUNCTIONALS = ("mean energy", "integral of p²")
"""Moments of a density: E H (of two energies, E H1 + E H2), and ∫p²."""
Solution = StationarySolution | ZeroFluxDensity | PlaneSolution
"""Density of one or two energies, with its error estimate, by finite elements or quadrature."""


def density_of(observable: Observable, solution: Solution) -> Density:
    """Return the density of the energies of ``solution``, with the error that its solver states."""
    panels = solution.panels if isinstance(solution, PlaneSolution) else (solution.nodes,)
    return density_of_energies(
        observable, solution, panels, lambda *energies: np.zeros(1), tol=inf, added=False
    )


def errors(p: Density, reference: Density | None = None) -> dict[str, float]:
    """Return the L1, L2 and largest distance to ``reference``, or to zero, and that of moments.

    L1 is ∫|p_h − p| over all energies at which either is known.
    """
    panels = p.panels if reference is None else map(np.union1d, p.panels, reference.panels)
    mesh, grids = gauss_grid(list(panels))
    a, b = p(*mesh), np.zeros(1) if reference is None else reference(*mesh)
    values = np.abs(a - b), (a - b) ** 2, (a - b) * sum(mesh), (a - b) * (a + b)
    L1, square, *moments = (integral(v, grids) for v in values)
    norms = dict(zip(NORMS, (L1, square**0.5, float(np.max(values[0]))), strict=True))
    return norms | dict(zip(FUNCTIONALS, map(abs, moments), strict=True))


@dataclass
class TimedCoefficients:
    """The coefficients of a process, with the seconds of processor time spent in them so far."""

    coefficients: Callable[[Array], Coefficients]
    seconds: float = 0.0

    def __call__(self, energies: Array) -> Coefficients:
        """Return the coefficients at ``energies``."""
        values, seconds = timed_first(lambda: self.coefficients(energies))
        self.seconds += seconds
        return values


@dataclass(frozen=True)
class Level:
    """One level of refinement or one setting of a route, as it was measured.

    ``error`` is the L1 error, of a simulation the expected one; ``errors`` those by norm and
    moment; ``stated`` the answer's own estimate. ``distance`` is the L1 distance to the reference,
    ``estimate`` the largest that both errors allow; ``size`` as in ``observed_orders``.
    ``promised`` is the tolerance asked for, if any; ``modelled``: computed by the law of sampling.

    ``seconds`` of processor time is the median of ``repeats`` runs, ``spread`` half the distance of
    their quartiles, ``first`` what the first call took beyond, ``coefficients`` the part spent in
    the process's coefficients, ``memory`` the peak in bytes that Python and NumPy allocate in one
    call. Not a number where it was not measured.
    """

    settings: str
    error: float
    stated: float
    seconds: float
    distance: float = nan
    estimate: float = nan
    unknowns: float = nan
    size: float = nan
    errors: dict[str, float] = field(default_factory=dict)
    functionals: dict[str, float] = field(default_factory=dict)
    promised: float = inf
    modelled: bool = False
    repeats: int = 1
    spread: float = nan
    first: float = nan
    coefficients: float = nan
    memory: float = nan

    @property
    def honest(self) -> bool:
        """Whether the distance to the reference is allowed."""
        return self.distance <= self.estimate


@dataclass(frozen=True, eq=False)
class Discretisation:
    """One level of a family of discretisations of one equation.

    ``name`` is the family's: in "h" elements of ``degree`` are halved, in "p" the degree grows, in
    "tol" the tolerance falls. ``settings``, ``size`` and ``promised`` are those of ``Level``.
    """

    family: Literal["h", "p", "tol"]
    name: str
    settings: str
    solve: Callable[[], Solution]
    refined: Callable[[], "Discretisation"]
    size: float = nan
    promised: float = inf
    degree: int | None = None


def refined_levels(
    first: Discretisation, reference: Density, count: int
) -> Iterator[tuple[Discretisation, Level]]:
    """Yield ``count`` discretisations from coarse to fine, each with what was measured.

    Sizes are h; or, so that the order is a rate of exponential convergence, exp(−p) and
    exp(−√unknowns): nats of error a degree, or a unit of √unknowns. Of quadrature the unknowns are
    its points. Raises what the solvers raise.
    """
    setting = first
    for k in range(count):
        setting = setting.refined() if k else first
        solution, seconds = timed_first(setting.solve)
        p = density_of(reference.observable, solution)
        norms, moments, elements = errors(p, reference), errors(p), p.panels[0].size - 1
        unknowns = (
            ENERGY_RULES[0] * elements
            if isinstance(solution, ZeroFluxDensity)
            else solution.unknowns
        )
        plain = isinstance(solution, PlaneSolution) and solution.weight.plain
        words = f"{setting.settings}, w = 1" if plain else setting.settings
        level = Level(
            settings=words,
            error=norms["L1"],
            stated=p.l1_error,
            seconds=seconds,
            distance=norms["L1"],
            estimate=p.l1_error + reference.l1_error,
            unknowns=unknowns,
            size=exp(-sqrt(unknowns)) if first.family == "tol" else setting.size,
            errors=norms,
            functionals={key: moments[key] for key in FUNCTIONALS},
            promised=setting.promised,
        )
        yield setting, level


def timed_first(work: Callable[[], T]) -> tuple[T, float]:
    """Return the value of one call and its seconds of processor time."""
    start = process_time()
    value = work()
    return value, process_time() - start


def timing(
    work: Callable[[], Any], first: float, coefficients: TimedCoefficients | None = None
) -> dict[str, Any]:
    """Return the times of ``work`` as in ``Level``; its first call took ``first`` seconds.

    ``coefficients`` are those that it evaluates, where the part spent in them is of interest.
    """
    if first > LONG:
        return {"seconds": first}
    before = coefficients.seconds if coefficients else nan
    _, warm = timed_first(work)
    count = int(np.clip(ENOUGH / max(warm, 1e-9), *REPEATS))
    times = [warm, *repeat(work, repeat=count - 1, number=1, timer=process_time)]
    inside = (coefficients.seconds - before) / len(times) if coefficients else nan
    lower, middle, upper = quantiles(times, n=4, method="inclusive")
    tracemalloc.start()
    try:
        work()
        memory = float(tracemalloc.get_traced_memory()[1])
    finally:
        tracemalloc.stop()
    measured = {"seconds": middle, "spread": 0.5 * (upper - lower), "repeats": len(times)}
    extra = max(0.0, first - middle)
    return {**measured, "first": extra, "coefficients": inside, "memory": memory}
