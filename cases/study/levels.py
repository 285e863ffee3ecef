"""A study: what varies from level to level, what is measured, and which order theory predicts.

``Study.levels`` is the loop of every study by refinement: it solves, measures the error, and goes
on with ``refined()``; ``Study.ladder`` adds the observed orders. Convergence and cost differ only
in what they do with the levels. Times are processor times: on one thread they equal the wall times
of an idle machine, whatever else runs beside.
"""

import tracemalloc
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from math import exp, inf, isfinite, nan, sqrt
from statistics import quantiles
from time import process_time
from timeit import repeat
from typing import Any, TypeVar

import numpy as np

from cases.study.orders import Convergence, GridConvergence, convergence, grid_convergence
from fpk.numeric.arrays import Array
from fpk.system.process import Coefficients

T = TypeVar("T")

REPEATS = 3, 21
"""Least and largest number of timed runs."""
ENOUGH = 0.1
"""Seconds that the timed runs take together, if their least number does not take longer."""
LONG_RUN = 1.0
"""Seconds of a first run above which no other follows: its spread and memory stay unknown."""


@dataclass
class TimedCoefficients:
    """The coefficients of a process, with the seconds of processor time spent in them so far."""

    coefficients: Callable[[Array], Coefficients]
    seconds: float = 0.0

    def __call__(self, energies: Array) -> Coefficients:
        """Return the coefficients at ``energies``; adds the time that takes to ``seconds``."""
        values, seconds = time_call(lambda: self.coefficients(energies))
        self.seconds += seconds
        return values


@dataclass(frozen=True)
class Level:
    """One level of refinement, or one setting of a route, with the errors and times measured.

    ``error`` is the L1 error, of a simulation its expectation; ``errors`` has the error in every
    norm and moment by name; ``stated`` is the answer's own estimate. ``distance`` is the L1
    distance to the reference, ``estimate`` the largest distance that both stated errors allow.
    ``size`` is the abscissa of ``observed_orders``; ``functionals`` are values by name.
    ``promised`` is the tolerance given to the solver, if any; ``modelled``: by the law of sampling.

    ``seconds`` of processor time is the median of ``repeats`` runs, ``spread`` half the distance of
    their quartiles, ``first`` the additional time of the first call, ``coefficients`` the part
    spent in the process's coefficients, ``memory`` the peak in bytes that Python and NumPy allocate
    in one call. NaN stands for each that was not measured.
    """

    settings: str
    error: float
    stated: float
    seconds: float
    distance: float = nan
    estimate: float = nan
    unknowns: float = nan
    size: float = nan
    errors: Mapping[str, float] = field(default_factory=dict)
    functionals: Mapping[str, float] = field(default_factory=dict)
    promised: float = inf
    modelled: bool = False
    repeats: int = 1
    spread: float = nan
    first: float = nan
    coefficients: float = nan
    memory: float = nan

    @property
    def honest(self) -> bool:
        """Whether the distance to the reference is within the errors that both state."""
        return self.distance <= self.estimate

    @property
    def sound(self) -> bool:
        """Whether the level is honest and states a finite error."""
        return self.honest and isfinite(self.stated)


@dataclass(frozen=True, eq=False)
class Discretisation:
    """One level of a family of discretisations; ``refined`` returns the next, finer level.

    ``name`` is the family's: in the family "h" elements of ``degree`` are halved, in "p" the degree
    grows, in "tol" the tolerance falls. ``size`` is the h of ``observed_orders``: the ratio of the
    sizes of two levels is known, their unit is free. For exponential convergence it is exp(−x),
    and the order then is the rate in x: exp(−degree) in "p"; in "tol" NaN, which stands for
    exp(−√unknowns). ``settings`` and ``promised`` have the meaning of the fields of ``Level``.
    """

    family: str
    name: str
    settings: str
    solve: Callable[[], Any]
    refined: Callable[[], "Discretisation"]
    size: float = nan
    promised: float = inf
    degree: int | None = None


@dataclass(frozen=True)
class Ladder:
    """Levels from coarse to fine of one family, with their orders by norm and moment.

    ``degree`` is the degree of the elements in h, else None; ``grid`` holds Richardson's value and
    the grid convergence index of every functional of known order.
    """

    name: str
    equation: str
    dimension: int
    family: str
    degree: int | None
    levels: tuple[Level, ...]
    verdicts: dict[str, Convergence]
    grid: dict[str, GridConvergence]


@dataclass(frozen=True, eq=False)
class Study:
    """The quantity that varies, the measured errors, and the order that theory predicts.

    ``first`` is the coarsest of ``count`` levels of the quantity that varies.

    ``measure`` takes an answer of ``Discretisation.solve`` and returns a ``Level`` with its errors:
    ``seconds`` is replaced by the processor time of the solution, ``size`` and ``promised`` by the
    values of the discretisation (in the family "tol" the size is exp(−√unknowns), which ``measure``
    must give), and ``settings`` is appended to its settings. ``theory`` has the predicted order in
    ``size`` of every error by name, or none if the convergence is exponential; ``floor`` the size
    of each error below which the reference resolves nothing. ``equation`` names the subject in
    tables, ``dimension`` is the number of its coordinates.
    """

    equation: str
    first: Discretisation
    count: int
    measure: Callable[[Any], Level]
    theory: Mapping[str, float]
    floor: Mapping[str, float]
    dimension: int = 1

    def levels(self) -> Iterator[tuple[Discretisation, Level]]:
        """Yield the discretisations from coarse to fine, each with its measured level.

        Raises the exceptions of ``Discretisation.solve`` and of ``measure``.
        """
        setting = self.first
        for k in range(self.count):
            setting = setting.refined() if k else setting
            solution, seconds = time_call(setting.solve)
            level = self.measure(solution)
            yield (
                setting,
                replace(
                    level,
                    settings=setting.settings + level.settings,
                    seconds=seconds,
                    size=exp(-sqrt(level.unknowns)) if setting.family == "tol" else setting.size,
                    promised=setting.promised,
                ),
            )

    def ladder(self) -> Ladder:
        """Return all levels and orders; tolerances that take no more unknowns are left out."""
        levels = [level for _, level in self.levels()]
        if self.first.family == "tol":  # two tolerances with the same answer are one level
            most = np.maximum.accumulate([0, *(level.unknowns for level in levels)])
            levels = [level for level, n in zip(levels, most, strict=False) if level.unknowns > n]
        h, degree = [level.size for level in levels], self.first.degree
        verdicts = {
            key: convergence(
                h, [v.errors[key] for v in levels], theory=self.theory.get(key), floor=low
            )
            for key, low in self.floor.items()
        }
        grid = {
            key: grid_convergence(
                [v.functionals[key] for v in levels], theory=order, floor=self.floor[key]
            )
            for key, order in self.theory.items()
            if key in levels[-1].functionals
        }
        name = f"h, p = {degree}" if degree else self.first.name
        of = self.equation, self.dimension, self.first.family, degree
        return Ladder(name, *of, tuple(levels), verdicts, grid)


def time_call(work: Callable[[], T]) -> tuple[T, float]:
    """Return the value of one call and its seconds of processor time."""
    start = process_time()
    value = work()
    return value, process_time() - start


def timing(
    work: Callable[[], Any], first: float, coefficients: TimedCoefficients | None = None
) -> dict[str, Any]:
    """Return the times of ``work`` as fields of ``Level``; its first call took ``first`` seconds.

    Above ``LONG_RUN`` ``work`` is not called, and ``first`` is the only time. ``coefficients``: the
    coefficients that ``work`` evaluates, if the time spent in them is to be measured.
    """
    if first > LONG_RUN:
        return {"seconds": first}
    before = coefficients.seconds if coefficients else nan
    _, warm = time_call(work)
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
