"""Ensembles of averaged energies, and their stationary densities, first passage and transients."""

from collections import deque
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from math import ceil, inf, nan
from typing import Any

import numpy as np
from numpy.random import Generator

from fpk.answer.bins import BinAxis
from fpk.answer.certificate import tolerance
from fpk.answer.dynamics import Passage, Transient
from fpk.answer.method import Progress, Result, silent
from fpk.answer.names import Coordinate, Observable
from fpk.answer.question import Asked
from fpk.numeric.arrays import ROUND_OFF, Array, Flags, Integers
from fpk.numeric.errors import require
from fpk.numeric.machine import usable_cores
from fpk.system.modulation import Modulation
from sim.questions.averaged.square_root import SquareRootForm, square_root_step
from sim.questions.limits import CHUNK_STEPS, first_step
from sim.questions.passage import Run, noise_times, passage_in_rounds
from sim.questions.passing import pass_under
from sim.questions.rounds import MOST_SUMS, Watch, motions
from sim.questions.transient import transient_in_rounds
from sim.sample.ensemble import Reader
from sim.sample.histogram import MARGIN, bin_axis, covering, density_of_counts, log_states
from sim.sample.workers import workers_of
from sim.step.arrays import LANES, MAX_BATCHES, MAX_TRAJECTORIES, in_blocks
from sim.step.random import stream_of
from sim.step.step_size import STEP_PER_RATE

Starts = Callable[[int, Generator], Array]
"""``starts(paths, stream)`` returns energies (paths, d) at time 0, drawn from the stream."""

GROUP = 4
"""Number of blocks of ``LANES`` paths that share a random stream and make one task of a thread."""

BURN_IN, SAMPLED = 10.0, 20.0
"""Burn-in and sampled time of each path, in relaxation times."""

STATIONARY = 0.25
"""Step of stationary densities in units of ``step``: no second step measures their bias.
On vanderpol the standard deviation of H was off by 5 standard errors at a step of 0.1, by less than
half a standard error at 0.025."""

PER_PATH, MOST_PATHS = 1.1, 1 << 22
"""Standard deviation over mean of a first-passage time (1 for an exponential law), which sets the
number of paths for a relative error; largest number of paths."""

MOST_DRAWS = 3e7
"""Largest number of random numbers of a passage without a wall time: about 20 s on one core."""


@dataclass(eq=False)
class EnergyEnsemble:
    """Paths of X (paths, d) that advance together from the time ``begin``, as an ``Ensemble`` does.

    Each ``GROUP`` of blocks has its own stream of the ``seed``, from number ``number`` · 2**32 on.
    """

    form: SquareRootForm
    X: Array
    dt: float
    seed: int
    number: int
    workers: Any
    modulation: Modulation | None = None
    begin: float = 0.0
    streams: list[Generator] = field(default_factory=list)
    done: int = field(init=False, default=0)

    def __post_init__(self) -> None:
        """Make the streams, unless the motion continues with given streams."""
        groups = range(len(self.streams), -(-len(self.X) // (GROUP * LANES)))
        self.streams += [stream_of(self.seed, (self.number << 32) + group) for group in groups]

    @property
    def time(self) -> float:
        """Time of the states X, ``begin`` + ``done`` · ``dt``."""
        return self.begin + self.done * self.dt

    def advance(self, steps: int, *arrays: Array, read: Reader | None = None, **_: Any) -> None:
        """Advance X by ``steps``; ``read`` gets X before and after every step, and ``arrays``.

        It is called once for each ``GROUP`` of blocks. Other keywords have no effect.
        """

        def advance_group(group: int) -> Array:
            stream, first = self.streams[group], self.X[group * GROUP * LANES :][: GROUP * LANES]
            trace = deque([first], None if read else 1)
            for k in range(steps):
                noise = stream, self.modulation, self.begin + (self.done + k) * self.dt
                trace.append(square_root_step(self.form, trace[-1], self.dt, *noise))
            if read:
                own = (a[group * GROUP : (group + 1) * GROUP] for a in arrays)
                read(np.stack([*map(in_blocks, trace)], axis=1), steps, self.done, *own)
            return trace[-1]

        groups = range(-(-len(self.X) // (GROUP * LANES)))
        self.X = np.concatenate(list(self.workers.executor.map(advance_group, groups)))
        self.done += steps

    def onward(self, dt: float) -> "EnergyEnsemble":
        """Return a new ensemble from the last state on in steps ``dt``, with the same streams."""
        return replace(self, dt=dt, begin=self.time)

    def keep(self, lanes: Integers) -> None:
        """Continue with the paths number ``lanes`` alone, in this order."""
        self.X = self.X[lanes]


def relaxation_steps(method: Any, form: SquareRootForm) -> tuple[float, int]:
    """Return the longest relaxation time, and the steps in half of it, 1 if steps are exact.

    ``method``, here and below, is an ``AveragedSimulation``: its settings are described there.
    """
    times = form.scales / form.noise
    slowest, longest = float(times.max()), STATIONARY * method.step * float(times.min())
    return slowest, 1 if form.damping is None else ceil(0.5 * slowest / longest - 1e-9)


def simulate_energies(
    method: Any,
    form: SquareRootForm,
    observables: Sequence[Observable],
    failures: Sequence[str] = (),
    progress: Progress = silent,
) -> Result:
    """Return sampled densities of ``observables``: H_i, pairs of them, or H = Σ H_i.

    Paths are sampled every half of the slowest relaxation time. The last states of the burn-in give
    the ranges of the histograms. If ``seconds`` of wall time end in the burn-in, one sample is
    taken and nothing is certified. ``tol``, tolerance of the expected L1 error, decides on
    certification only; ``failures`` are words against it. ``threads`` do not change the numbers of
    a ``seed``. Raises ``InvalidInput`` if ``paths`` is no multiple of ``MAX_BATCHES``, or less than
    four times as large.
    """
    paths, seconds, tol = method.paths, method.seconds, inf if method.tol is None else method.tol
    many = f"use a multiple of {MAX_BATCHES}, {4 * MAX_BATCHES} or more"
    require(paths >= 4 * MAX_BATCHES and paths % MAX_BATCHES == 0, "paths", paths, many)
    slowest, steps = relaxation_steps(method, form)
    dt, samples, taken = 0.5 * slowest / steps, round(2.0 * SAMPLED), 0
    stream = stream_of(method.seed, 0, of_starts=True)
    start = stream.exponential(form.scales, (paths, form.scales.size))
    watch = Watch(seconds or inf, lambda: False)
    with workers_of(None, method.threads or usable_cores()) as workers:
        ensemble = EnergyEnsemble(form, start, dt, method.seed, 0, workers)
        for _ in range(ceil(2.0 * BURN_IN)):
            if not watch.ends():
                ensemble.advance(steps)
        over = f"{seconds or 0.0:.3g} s were over in the burn-in; give it more time"
        failures = [*failures, over] if watch.ends() else failures
        H = form.energies(ensemble.X)
        reached = np.array([(0.0, x.max()) for o in observables for x in energy_columns(o, H)])
        histograms = covering(observables, reached, partial(energy_axis, form))
        counts = [np.zeros((MAX_BATCHES, h.size + 1), dtype=np.int64) for h in histograms]
        while taken < samples and not (taken and watch.ends()):
            ensemble.advance(steps)
            H, taken = form.energies(ensemble.X), taken + 1
            for total, histogram in zip(counts, histograms, strict=True):
                total += histogram.counted(energy_columns(histogram.observable, H), MAX_BATCHES)
            progress(taken, samples, "averaged simulation")
    densities = tuple(  # without moment identities
        density_of_counts(h, total, taken=paths * taken, residual=nan, tol=tol, failures=failures)
        for h, total in zip(histograms, counts, strict=True)
    )
    settings: dict[str, str | float | int] = {
        "equation": method.route.equation,
        "relaxation time": slowest,
        "dt": dt,
        "steps": form.steps,
        "paths": paths,
        "time": SAMPLED * slowest,
        "seed": method.seed,
    }
    return Result(method, densities, settings=settings)


def burnt_in(method: Any, form: SquareRootForm, paths: int, stream: Generator) -> Array:
    """Return the energies (``paths``, d) after the burn-in from exponential X.

    ``stream`` draws X and the seed of the steps.
    """
    start, seed = stream.exponential(form.scales, (paths, form.scales.size)), stream.integers(2**63)
    slowest, steps = relaxation_steps(method, form)
    with workers_of(None, method.threads or usable_cores()) as workers:
        ensemble = EnergyEnsemble(form, start, 0.5 * slowest / steps, int(seed), 0, workers)
        ensemble.advance(ceil(2.0 * BURN_IN) * steps)
    return form.energies(ensemble.X)


def energy_axis(
    form: SquareRootForm, coordinate: Coordinate, low: float, high: float, bins: int,
    *, rises: bool = False,
) -> BinAxis:  # fmt: skip
    """Return about ``bins`` bins of an energy from 0 to ``high`` and a margin; see ``axis_of``.

    ``rises``: the density may rise towards 0. ``low`` is not used.
    """
    total = coordinate.index is None
    kinks = [*([0.0] if rises else []), *(form.kinks if total else ())]
    reference = partial(log_states, form.degrees_of_freedom if total else 1)
    high = (1.0 + 2.0 * MARGIN) * high
    return bin_axis(0.0, high, kinks, bins, widening=True, reference=reference)


def energy_columns(observable: Observable, H: Array) -> list[Array]:
    """Return the coordinates of ``observable``: columns of ``H`` (paths, d), or their sum."""
    return [H.sum(axis=1) if c.index is None else H[:, c.index] for c in observable]


def energy_passage(
    method: Any, form: SquareRootForm, limits: tuple[Array, Array], starts: Starts, asked: Asked
) -> Passage:
    """Return the first passage of any of ``limits`` in steps of dt/2, and of dt for comparison.

    Limits: weights (limits, d) · X reach values (limits,). Exact steps (``form.damping`` None) are
    made once and read at both steps; else each step has its own paths. dt, ``step`` times the
    fastest relaxation time, is shortened if the noise fills a limit soon. Paths are simulated for
    ``MOST_DRAWS`` or ``seconds``, more of them for ``tol``, the relative error of the mean, which
    otherwise decides on certification only.
    """
    exact, modulation, seed = form.damping is None, asked.system.modulation, method.seed
    times, seconds = form.scales / form.noise, method.seconds
    tol, dt = tolerance(asked.tol, method.tol), method.step * float(times.min())
    paths = method.paths if tol is None else max(method.paths, ceil((PER_PATH / tol) ** 2))
    paths = min(paths, MOST_PATHS)
    own = min(-(-paths // LANES) * LANES, MOST_SUMS // CHUNK_STEPS)
    (weights, values), d = limits, form.noise.size
    # From rest the mean of Σ w X with the largest noise reaches the limit L at the time L/(w · d).
    loudest = 1.0 if modulation is None else modulation.largest
    filling = loudest * float(np.max(weights @ form.noise / values))
    dt = min(dt, STEP_PER_RATE / filling)
    rounds, first = -(-paths // own), first_step(dt, asked.times)
    most = MOST_DRAWS / ((2 if exact else 3) * rounds * own * d)
    most = (most if seconds is None else 2.0**40) * dt  # with seconds the wall time ends it
    longest = max(min(most, noise_times(modulation)[1]), float(np.max(asked.times, initial=0.0)))
    known: Any = {"modulation": modulation, "diffusion": form.diffusion(weights)}
    known |= {"rows": d + np.arange(values.size), "limits": values, "first": 0}

    def see(trace: Array, samples: int, done: int, *arrays: Array, dt: float, begin: float) -> None:
        """Call ``pass_under`` with the first two ``arrays``; with two more at every second step."""
        for k in range(1, len(arrays) // 2 + 1):
            X, times = trace[:, ::k], arrays[2 * k - 2 : 2 * k]
            rows = np.concatenate([np.sqrt(X), weights @ X], axis=2)
            pass_under(rows, samples // k, done // k, *times, dt=k * dt, begin=begin, **known)

    def begun(number: int) -> tuple[list[Run], Flags, Array]:
        stream = stream_of(seed, number, of_starts=True)
        X = form.inverse(starts(own, stream))
        past = np.any((1.0 - ROUND_OFF) * values <= X @ weights.T, axis=1)
        reader = lambda motion: partial(see, dt=motion.dt, begin=motion.begin)  # noqa: E731
        runs = list[Run]()
        for k, (many, which) in enumerate([(2, (0, 1))] if exact else [(2, (0,)), (1, (1,))]):
            numbers = first / many, seed, 2 * number + k
            motion = EnergyEnsemble(form, X, *numbers, workers, modulation)
            runs.append((motion, many, reader, which))
        return runs, past, stream.exponential(size=(own, values.size))  # see ``pass_energies``

    with workers_of(None, method.threads or usable_cores()) as workers:
        watch, steps = Watch(seconds or inf, lambda: False, tol), (first, dt, 1, longest, longest)
        memory, settings = 2.0 * float(times.max()), {"steps": form.steps, "seed": seed}
        return passage_in_rounds(asked, watch, (rounds, rounds), begun, steps, memory, settings)


def energy_transient(method: Any, form: SquareRootForm, starts: Starts, asked: Asked) -> Transient:
    """Return the densities of energies ``asked.observable`` at ``asked.times``, certified.

    Exact steps (``form.damping`` None) lead from time to time; else steps dt, ``step`` times the
    fastest relaxation time, and dt/2 have their own paths. Two rounds of ``paths`` are made; with
    ``tol`` one, and more until the expected L1 error is below it at all times, or ``seconds`` of
    wall time have passed.
    """
    paths, seed = method.paths, method.seed
    dt = method.step * float(np.min(form.scales / form.noise))
    longest, many = (inf, (1,)) if form.damping is None else (dt, (2, 1))

    def seen(ensemble: EnergyEnsemble) -> list[Array]:
        return energy_columns(asked.observable, form.energies(ensemble.X))

    def states(number: int, begin: Callable[[], Any]) -> Iterable[tuple[Any, ...]]:
        X = form.inverse(starts(paths, stream_of(seed, number, of_starts=True)))

        def begun(dt: float, halved: bool) -> EnergyEnsemble:
            numbers = dt, seed, 2 * number + halved
            return EnergyEnsemble(form, X, *numbers, workers, asked.system.modulation)

        start = energy_columns(asked.observable, form.energies(X))
        return motions(begun, start, seen, asked.times, longest, many, begin)

    with workers_of(None, method.threads or usable_cores()) as workers:
        # Without a tolerance, two rounds whatever the time: no error is above inf.
        tol = tolerance(asked.tol, inf if method.tol is None else method.tol)
        watch = Watch(method.seconds or inf, lambda: False, tol)
        settings = {"seed": seed, "steps": form.steps}
        axis, rounds = partial(energy_axis, form), (2, max(1, MAX_TRAJECTORIES // paths))
        return transient_in_rounds(asked, watch, states, axis, rounds, dt, settings)
