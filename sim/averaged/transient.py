"""Transient densities of averaged energies by simulation, in steps of dt/2 and of dt."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from math import ceil, inf

import numpy as np

from fpk.arrays import Array
from fpk.errors import InvalidInput
from fpk.evolution import Transient
from fpk.method import Progress, silent
from fpk.modulation import Modulation
from fpk.observable import Observable
from sim.arrays import MAX_TRAJECTORIES
from sim.averaged.passage import Starts, from_energies
from sim.averaged.paths import BATCHES, Shares, column, energy_axis
from sim.averaged.square_root import SquareRootForm, advanced
from sim.motion.rounds import Watch
from sim.motion.transient import Counted, answer_of
from sim.random import stream_of

ROUNDS = 2
"""Rounds of ``paths`` paths, each with a stream of its own, between two looks at the error."""

States = tuple[Array, Array | None]
"""Energies (paths, d) at steps of dt/2 and at steps of dt; None where steps are exact."""


def energy_transient(
    form: SquareRootForm,
    observable: Observable,
    starts: Starts,
    times: Array,
    at: tuple[Array, ...],
    *,
    dt: float,
    paths: int,
    seed: int,
    modulation: Modulation | None = None,
    threads: int = 1,
    seconds: float | None = None,
    tol: float | None = None,
    progress: Progress = silent,
) -> Transient:
    """Return the densities of energies at ``times`` at the points ``at``, with standard errors.

    Where ``form.damping`` is None one exact step leads from time to time, and no error is that of a
    step; else it is in the error, ``answer_of``, and both steps have paths of their own.
    ``ROUNDS`` of ``paths`` are made; with ``tol`` as many again until the expected L1 error is
    below it at all times, or ``seconds`` of wall time have passed. The answer does not depend on
    ``threads``.
    """
    axis = partial(energy_axis, form)
    densities = Counted(observable, lambda H: [column(H, c) for c in observable], axis)
    over = Shares(seconds, 1).ends(BATCHES)
    simulated = partial(_simulated, form, starts, times, dt, paths, seed, modulation, over)
    most = max(ROUNDS, MAX_TRAJECTORIES // paths)

    def counted(number: int) -> float:
        rounds = range(number * ROUNDS, min((number + 1) * ROUNDS, most))
        for made, states in zip(rounds, pool.map(simulated, rounds), strict=True):
            if not (states or densities.histograms):
                raise InvalidInput("seconds", seconds, "are over in the first round; give more")
            for k, (fine, coarse) in enumerate(states):
                densities.add(k, times[k], fine, coarse)
            progress(min(made + 1, ROUNDS), ROUNDS, "transient, averaged")
        return densities.error

    with ThreadPoolExecutor(threads) as pool:
        Watch(inf, over, tol).until(counted, most=ceil(most / ROUNDS))
    settings = {"seed": seed, "steps": "exact" if form.damping is None else "Strang splitting"}
    return answer_of(densities, times, at, dt, settings=settings, tol=inf if tol is None else tol)


def _simulated(
    form: SquareRootForm, starts: Starts, times: Array, dt: float, paths: int, seed: int,
    modulation: Modulation | None, over: Callable[[], bool], number: int,
) -> list[States]:  # fmt: skip
    """The states at all times of round ``number``; none where it is ``over()`` before its end."""
    stream, exact = stream_of(seed, number), form.damping is None
    start, gaps, rows = from_energies(form, starts(paths, stream)), np.diff(times, prepend=0.0), []
    for longest in (0.5 * dt,) if exact else (0.5 * dt, dt):
        X, at_times = start, list[Array]()
        for time, gap in zip(times.tolist(), gaps.tolist(), strict=True):
            steps = 0 if gap == 0.0 else 1 if exact else ceil(gap / longest * (1.0 - 1e-12))
            h = gap / max(1, steps)
            X = advanced(form, X, h, steps, stream, modulation, time - gap, over)
            at_times.append(form.energies(X))
        if over():
            return []
        rows.append(at_times)
    return [(fine, None) for fine in rows[0]] if exact else list(zip(*rows, strict=True))
