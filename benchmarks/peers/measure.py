"""What every peer's script shares: how an answer is judged and timed, and the line it prints.

A script lists its settings; ``measure_all`` runs them and prints one JSON line each, with the keys
peer, version, problem, setting, unknowns, L1, seconds, minimum, mass, note. L1 is ∫|p_h − p| with
the probability beyond the box, in the quadrature of the answer itself where p_h is a function, over
its cells where it is one value a cell. ``minimum`` is relative to the largest value of p_h, and
``mass`` ∫p_h. Where a setting fails, L1 is null and the note says why.
"""

import os

os.environ.update(
    OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1", MKL_NUM_THREADS="1", NUMBA_NUM_THREADS="1"
)

import argparse
import json
import sys
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from statistics import median
from time import perf_counter
from types import ModuleType

import numpy as np
from numpy.typing import NDArray
from problems import PROBLEMS

Array = NDArray[np.float64]

MISSING = 3
"""Exit status of a script whose package is not installed."""
LONG = 1.0
"""Seconds above which the first run is the only one; what it loads, a smaller one has loaded."""
MOST, ENOUGH = 21, 0.4
"""Repeats at most, and seconds of repeats that are enough once there are three."""
KEPT = 160
"""Letters kept of a warning or an error."""


def need(module: str) -> ModuleType:
    """Return the module, or exit with the status ``MISSING``, naming it."""
    try:
        return import_module(module)
    except ImportError as error:
        print(f"missing: {module} ({error})", file=sys.stderr)
        sys.exit(MISSING)


def version_of(package: str) -> str:
    """Return the installed version of a distribution."""
    try:
        return version(package)
    except PackageNotFoundError:
        return "–"


@dataclass(frozen=True, eq=False)
class Sampled:
    """An answer at the points (dimension, N) of a quadrature with its weights (N,), to be judged.

    ``ends`` is where the box ends along each axis.
    """

    points: Array
    weights: Array
    values: Array
    ends: tuple[float, ...]


@dataclass(frozen=True, eq=False)
class Setting:
    """One measurement: ``work`` solves, coefficients and all, and its result goes to ``sampled``.

    ``unknowns`` takes the result, too. ``note`` says what a reader has to know of this setting,
    ``words`` what the result says of itself.
    """

    problem: str
    name: str
    work: Callable[[], object]
    sampled: Callable[..., Sampled]
    unknowns: Callable[..., int]
    note: str = ""
    words: Callable[..., str] | None = None


def measure_all(peer: str, package: str, settings: Sequence[Setting]) -> None:
    """Measure the settings that the command line asks for and print a JSON line for each."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--smallest", action="store_true", help="the first setting of each problem")
    parser.add_argument("--problem", choices=sorted(PROBLEMS), help="this problem only")
    arguments = parser.parse_args()
    chosen = [s for s in settings if arguments.problem in (None, s.problem)]
    if arguments.smallest:
        chosen = list({s.problem: s for s in reversed(chosen)}.values())[::-1]
    about = {"peer": peer, "version": version_of(package)}
    for setting in chosen:
        line = {"problem": setting.problem, "setting": setting.name, **measured(setting)}
        print(json.dumps(about | line), flush=True)


def measured(setting: Setting) -> dict[str, object]:
    """Solve, judge the answer and time it; a failure is a finding and goes into the note."""
    notes = [setting.note] if setting.note else []
    nothing = {"unknowns": None, "L1": None, "seconds": None, "minimum": None, "mass": None}
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            start = perf_counter()
            result = setting.work()
            first = perf_counter() - start
            sampled = setting.sampled(result)
        except Exception as error:  # whatever a peer raises is what this run found out
            message = f"fails: {type(error).__name__}: {error}"[:KEPT]
            return nothing | {"note": "; ".join([*notes, message])}
        seconds = timed(setting.work) if first <= LONG else first
    notes += [setting.words(result)] if setting.words else []
    notes += sorted({f"warns: {_words(w.message)}" for w in caught if _tells(w.category)})[:2]
    problem = PROBLEMS[setting.problem]
    exact = problem.exact(sampled.points)
    inside = float(sampled.weights @ np.abs(sampled.values - exact))
    found = {
        "unknowns": int(setting.unknowns(result)),
        "L1": _finite(inside + problem.tail(sampled.ends)),
        "seconds": seconds,
        "minimum": _finite(sampled.values.min() / np.abs(sampled.values).max()),
        "mass": _finite(sampled.weights @ sampled.values),
        "note": "; ".join(notes),
    }
    return found


def once(work: Callable[[], object]) -> float:
    """Return the wall time in seconds of one run."""
    start = perf_counter()
    work()
    return perf_counter() - start


def timed(work: Callable[[], object]) -> float:
    """Return the median wall time in seconds of repeats; ``work`` has been called before."""
    times: list[float] = []
    while len(times) < 3 or (len(times) < MOST and sum(times) < ENOUGH):
        times.append(once(work))
    return median(times)


def cells(edges: Sequence[Array], values: Array) -> Sampled:
    """Return an answer of one value a cell, judged at the middles of the cells.

    A value is compared with p at the middle, not throughout the cell: that is in its favour.
    """
    middles = np.meshgrid(*(0.5 * (e[1:] + e[:-1]) for e in edges), indexing="ij")
    widths = np.meshgrid(*(np.diff(e) for e in edges), indexing="ij")
    points = np.array([m.ravel() for m in middles])
    weights = np.prod([w.ravel() for w in widths], axis=0)
    return Sampled(points, weights, np.ravel(values), tuple(float(e[-1]) for e in edges))


def _tells(category: type[Warning]) -> bool:
    """A warning tells of the answer unless it is of the peer's own upkeep."""
    return not issubclass(category, (DeprecationWarning, FutureWarning, ImportWarning))


def _words(message: object) -> str:
    return " ".join(str(message).split())[:KEPT]


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
