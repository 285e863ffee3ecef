"""Averaged energies as an ensemble, and their questions: densities, first passage, transients."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from math import ceil, inf, nan
from typing import Any

import numpy as np

from fpk.answer.bins import BinAxis
from fpk.answer.evolution import Passage, Transient
from fpk.answer.method import Progress, silent
from fpk.answer.observable import Coordinate, Observable
from fpk.answer.question import Asked
from fpk.answer.sampled_density import SampledDensity
from fpk.numeric.arrays import ROUND_OFF, Array, Flags, Integers
from fpk.numeric.errors import InvalidInput
from fpk.system.modulation import Modulation
from sim.questions.averaged.square_root import (
    SquareRootForm,
    from_energies,
    limit_diffusion,
    square_root_step,
)
from sim.questions.limits import STEP_TO_LIMIT, first_step
from sim.questions.passage import AT_ONCE, Run, followed_for, passage_in_rounds
from sim.questions.passing import pass_under
from sim.questions.rounds import Watch
from sim.questions.transient import States, counted_in_rounds
from sim.sample.ensemble import Reader
from sim.sample.histogram import MARGIN, binned, covering, log_states, sampled_density
from sim.sample.workers import workers_of
from sim.step.arrays import GROUPS, LANES, in_blocks
from sim.step.random import stream_of

GROUP = 4
"""Blocks of paths that have one stream of random numbers, and are one task of a thread."""

STARTS = 1 << 63
"""Number of the first stream of a seed from which starts are drawn; steps have those before it."""

MOST_DRAWS = 3e7
"""Random numbers at most where no wall time is given, some 20 s of one core: paths are followed for
no longer than that allows."""

Starts = Callable[[int, np.random.Generator], Array]
"""Energies (paths, d) at time 0, drawn from a stream."""


@dataclass(eq=False)
class EnergyEnsemble:
    """Paths of X (paths, d) that advance together from the time ``begin``: an ``Ensemble`` of them.

    Each ``GROUP`` of blocks has a stream of its own of the ``seed``, from ``number`` · 2**32 on:
    the result does not depend on the workers. Readers see the rows (paths, rows) ``observed``.
    """

    form: SquareRootForm
    X: Array
    dt: float
    seed: int
    number: int
    workers: Any
    observed: Callable[[Array], Array] = np.asarray
    modulation: Modulation | None = None
    begin: float = 0.0
    streams: list[np.random.Generator] = field(default_factory=list)
    done: int = field(init=False, default=0)

    def __post_init__(self) -> None:
        """Make the streams, unless the motion goes on."""
        groups = range(len(self.streams), -(-len(self.X) // (GROUP * LANES)))
        self.streams += [stream_of(self.seed, (self.number << 32) + group) for group in groups]

    @property
    def time(self) -> float:
        """Time of the states."""
        return self.begin + self.done * self.dt

    def advance(
        self, steps: int, *arrays: Array, read: Reader | None = None, passed: Any = None
    ) -> None:
        """Advance all paths; ``read`` sees each state, and the one before them, with its arrays.

        ``passed``, by which an ``Ensemble`` finds unstable steps, is not used: no step of energies
        is unstable.
        """

        def advanced(group: int) -> Array:
            X = self.X[group * GROUP * LANES : (group + 1) * GROUP * LANES]
            trace = [in_blocks(self.observed(X))] if read else []
            for k in range(steps):
                now, stream = self.begin + (self.done + k) * self.dt, self.streams[group]
                X = square_root_step(self.form, X, self.dt, stream, self.modulation, now)
                if read:
                    trace.append(in_blocks(self.observed(X)))
            if read:
                own = (a[group * GROUP : (group + 1) * GROUP] for a in arrays)
                read(np.stack(trace, axis=1), steps, self.done, *own)
            return X

        groups = range(-(-len(self.X) // (GROUP * LANES)))
        self.X = np.concatenate(list(self.workers.executor.map(advanced, groups)))
        self.done += steps

    def onward(self, dt: float) -> "EnergyEnsemble":
        """Return the motion from the last state on, in steps of another ``dt``."""
        return replace(self, dt=dt, begin=self.time)

    def keep(self, lanes: Integers) -> None:
        """Go on with the paths ``lanes``."""
        self.X = self.X[lanes]


def simulate_energies(
    form: SquareRootForm,
    observables: Sequence[Observable],
    *,
    interval: float,
    steps: int,
    time: float,
    burn_in: float,
    paths: int = 16384,
    seed: int = 1,
    threads: int = 1,
    seconds: float | None = None,
    tol: float = inf,
    failures: Sequence[str] = (),
    progress: Progress = silent,
) -> tuple[SampledDensity, ...]:
    """Return sampled densities of energies H_i, pairs of them and H = Σ H_i, with their errors.

    ``paths`` in all are sampled every ``interval``, in ``steps`` steps, for ``time`` after
    ``burn_in``, at whose end they give the ranges of the histograms. ``seconds`` of wall time end
    it; nothing is certified where they are over in the burn-in.

    Raises ``InvalidInput`` for paths that fill no batches.
    """
    if paths < 4 * GROUPS or paths % GROUPS:
        raise InvalidInput("paths", paths, f"use a multiple of {GROUPS}, {4 * GROUPS} or more")
    start = stream_of(seed, STARTS).exponential(form.scales, (paths, form.scales.size))
    watch, samples, taken = Watch(seconds or inf, lambda: False), max(1, round(time / interval)), 0
    with workers_of(None, threads) as workers:
        ensemble = EnergyEnsemble(form, start, interval / steps, seed, 0, workers)
        for _ in range(ceil(burn_in / interval)):
            if not watch.ends():
                ensemble.advance(steps)
        failures = [*failures]
        if watch.ends():
            failures.append(f"{seconds or 0.0:.3g} s were over in the burn-in; give it more time")
        H = form.energies(ensemble.X)
        reached = np.array([(0.0, column(H, c).max()) for o in observables for c in o])
        histograms = covering(observables, reached, partial(energy_axis, form))
        counts = [np.zeros((GROUPS, h.size + 1), dtype=np.int64) for h in histograms]
        while taken < samples and not (taken and watch.ends()):
            ensemble.advance(steps)
            H, taken = form.energies(ensemble.X), taken + 1
            for total, histogram in zip(counts, histograms, strict=True):
                total += histogram.counted([column(H, c) for c in histogram.observable], GROUPS)
            progress(taken, samples, "averaged simulation")
    # No identity of the averaged equations is evaluated.
    known: dict[str, Any] = {"residual": nan, "tol": tol, "failures": failures}
    return tuple(
        sampled_density(histogram, total, taken=paths * taken, **known)
        for histogram, total in zip(histograms, counts, strict=True)
    )


def burnt_in(
    form: SquareRootForm,
    paths: int,
    stream: np.random.Generator,
    *,
    interval: float,
    steps: int,
    time: float,
    threads: int = 1,
) -> Array:
    """Return X (paths, d) after ``time``, in intervals of ``steps`` each, from exponential ones."""
    start, seed = stream.exponential(form.scales, (paths, form.scales.size)), stream.integers(2**63)
    with workers_of(None, threads) as workers:
        ensemble = EnergyEnsemble(form, start, interval / steps, int(seed), 0, workers)
        ensemble.advance(ceil(time / interval) * steps)
    return ensemble.X


def energy_axis(
    form: SquareRootForm, coordinate: Coordinate, low: float, high: float, bins: int,
    *, rises: bool = False,
) -> BinAxis:  # fmt: skip
    """Return bins of an energy seen up to ``high``, as ``sim.sample.histogram.axis_of`` does."""
    total = coordinate.index is None
    kinks = [*([0.0] if rises else []), *(form.kinks if total else ())]
    reference = partial(log_states, form.degrees_of_freedom if total else 1)
    high = (1.0 + 2.0 * MARGIN) * high
    return binned(0.0, high, kinks, bins, widening=True, reference=reference)


def column(H: Array, coordinate: Coordinate) -> Array:
    """Return one energy of the columns of H (paths, d), or their sum."""
    return np.asarray(H.sum(axis=1) if coordinate.index is None else H[:, coordinate.index])


def energy_passage(
    form: SquareRootForm,
    limits: tuple[Array, Array],
    starts: Starts,
    asked: Asked,
    *,
    dt: float,
    memory: float,
    paths: int,
    seed: int,
    threads: int = 1,
    seconds: float | None = None,
    tol: float | None = None,
) -> Passage:
    """Return the first passage of any of ``limits`` in steps of dt/2, beside steps of ``dt``.

    They are of sums of X: weights (limits, d) · X reach values (limits,). Where steps are exact
    (``form.damping`` None) both see the same paths, else paths of their own. Between steps each
    distance to a limit is a Brownian bridge. Paths are followed until they fail, for the cost of
    ``MOST_DRAWS``, or for ``seconds`` of wall time; as ``followed_for`` says where the noise ends.
    ``memory`` as of ``passage_of``. Raises ``InvalidInput`` for starts that all lie beyond a limit.
    """
    own, exact = min(-(-paths // LANES) * LANES, AT_ONCE), form.damping is None
    (weights, values), d, modulation = limits, form.noise.size, asked.system.modulation
    # From rest the mean of Σ w X under the largest noise is the limit L at the time L/(w · d).
    loudest = 1.0 if modulation is None else modulation.largest
    dt = min(dt, STEP_TO_LIMIT / (loudest * float(np.max(weights @ form.noise / values))))
    rounds, first = -(-paths // own), first_step(dt, asked.times)
    most = MOST_DRAWS / ((2 if exact else 3) * rounds * own * d)
    most = (most if seconds is None else 2.0**40) * dt  # the wall time ends it before
    longest = followed_for(most, float(np.max(asked.times, initial=0.0)), modulation)
    known: Any = {"rows": d + np.arange(values.size), "limits": values, "first": 0}
    see: Any = partial(
        pass_under, modulation=modulation, diffusion=limit_diffusion(form, weights), **known
    )

    def both(
        trace: Array, samples: int, done: int, *arrays: Array, dt: float, begin: float
    ) -> None:
        """Read every step, and every second one, of the same paths."""
        see(trace, samples, done, *arrays[:2], dt=dt, begin=begin)
        half = np.ascontiguousarray(trace[:, ::2])
        see(half, samples // 2, done // 2, *arrays[2:], dt=2.0 * dt, begin=begin)

    def begun(number: int) -> tuple[list[Run], Flags, Array]:
        stream = stream_of(seed, STARTS + number)
        X = from_energies(form, starts(own, stream))
        past = np.any((1.0 - ROUND_OFF) * values <= X @ weights.T, axis=1)
        rows = lambda X: np.hstack([np.sqrt(X), X @ weights.T])  # noqa: E731
        runs = list[Run]()
        for k, (many, read, which) in enumerate(
            [(2, both, (0, 1))] if exact else [(2, see, (0,)), (1, see, (1,))]
        ):
            known = seed, 2 * number + k, workers, rows, modulation
            make = partial(lambda read, h, begin: partial(read, dt=h, begin=begin), read)
            runs.append((EnergyEnsemble(form, X, first / many, *known), many, make, which))
        return runs, past, stream.exponential(size=(own, values.size))  # see ``pass_energies``

    with workers_of(None, threads) as workers:
        watch, steps = Watch(seconds or inf, lambda: False, tol), (first, dt, 1, longest, longest)
        settings = {"steps": "exact" if exact else "Strang splitting", "seed": seed}
        return passage_in_rounds(asked, watch, (rounds, rounds), begun, steps, memory, settings)


def energy_transient(
    form: SquareRootForm,
    starts: Starts,
    asked: Asked,
    *,
    dt: float,
    paths: int,
    seed: int,
    threads: int = 1,
    seconds: float | None = None,
    tol: float | None = None,
) -> Transient:
    """Return the densities of energies that are asked for, with standard errors.

    Where ``form.damping`` is None one exact step leads from time to time, and no error is that of a
    step; else it is in the error, and both steps have paths of their own. Two rounds of ``paths``
    are made; with ``tol`` one, and more until the expected L1 error is below it at all times, or
    ``seconds`` of wall time have passed.
    """
    exact, gaps = form.damping is None, np.diff(asked.times, prepend=0.0).tolist()

    def states(number: int) -> States:
        start = from_energies(form, starts(paths, stream_of(seed, STARTS + number)))
        known: Any = {"workers": workers, "modulation": asked.system.modulation}
        runs = [
            EnergyEnsemble(form, start, 0.0, seed, 2 * number + k, **known)
            for k in range(1 if exact else 2)
        ]
        for gap in gaps:
            for k, (run, longest) in enumerate(zip(runs, (0.5 * dt, dt), strict=False)):
                steps = 0 if gap == 0.0 else 1 if exact else ceil(gap / longest * (1.0 - 1e-12))
                runs[k] = run.onward(gap / max(1, steps))
                runs[k].advance(steps)
            if watch.ends():
                if not number:
                    raise InvalidInput("seconds", seconds, "are over in the first round; give more")
                return
            yield form.energies(runs[0].X), None if exact else form.energies(runs[1].X)

    def columns(H: Array) -> list[Array]:
        return [column(H, c) for c in asked.observable]

    with workers_of(None, threads) as workers:
        # Without an error that is wanted two rounds are enough, whatever the time.
        watch = Watch(seconds or inf, lambda: False, inf if tol is None else tol)
        settings = {"seed": seed, "steps": "exact" if exact else "Strang splitting"}
        axis = partial(energy_axis, form)
        return counted_in_rounds(asked, watch, states, columns, axis, 2, paths, dt, settings)
