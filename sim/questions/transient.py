"""Transient densities by simulation at two steps, with errors from groups of trajectories."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from math import inf
from typing import Any

import numpy as np

from fpk.answer.bins import BinAxis
from fpk.answer.certificate import Measured, certify, largest_measured, tolerance
from fpk.answer.dynamics import Transient, require_times
from fpk.answer.names import Observable
from fpk.answer.question import Asked
from fpk.answer.sampled_density import SampledDensity
from fpk.numeric.arrays import Array, Integers
from fpk.numeric.errors import InvalidInput
from fpk.system.system import effects_of
from sim.questions import limits
from sim.questions.rounds import Watch, motions, seed_of, states_of, working
from sim.sample import histogram
from sim.sample.ensemble import ensemble_from
from sim.sample.settings import Settings
from sim.step.arrays import LANES, MAX_BATCHES, MAX_TRAJECTORIES
from sim.step.step_size import loudest


def sample_transient(method: Settings, asked: Asked) -> Transient:
    """Return the densities of ``asked.observable`` at dt/2; the change from dt is in the error.

    Both steps use the same random numbers; without stops, damping terms and modulation a single,
    exact step is made. ``asked.tol`` is the expected L1 error at every time; without it and
    ``seconds`` eight rounds of ``paths`` trajectories are made.
    """
    system, observable, start = asked.system, asked.observable, asked.start
    times, modulation = require_times(asked.times), system.modulation
    tol, loud = tolerance(asked.tol, method.tol), loudest(system)
    reach = limits.motion_reach(loud, None, start, float(np.max(times)))
    dt, failures = limits.motion_step(method, loud, reach, error=tol)
    mirror = effects_of(system).mirror and (start.kind != "state" or start.rest)
    paths = -(-method.paths // LANES) * LANES
    stepped = limits.needs_steps(system) or modulation is not None
    longest, many = (dt, (2, 1)) if stepped else (inf, (1,))

    def columns(states: Array) -> list[Array]:
        q, p = np.split(states, 2, axis=1)
        return [histogram.values_of(system, c, q, p) for c in observable]

    def states(number: int, begin: Callable[[], Any]) -> Iterable[tuple[Any, ...]]:
        q, p = origin(paths, number)
        settings: Any = {"seed": seed_of(method.seed, number), "workers": workers}
        begun = partial(ensemble_from, system, q, p, modulation=modulation, **settings)

        def seen(ensemble: Any) -> Sequence[Array]:
            return columns(states_of(ensemble))

        return motions(begun, columns(np.hstack([q, p])), seen, times, longest, many, begin)

    with working(method, system, tol, start) as (workers, watch, origin):
        axis, rounds = partial(histogram.axis_of, system), (8, max(1, MAX_TRAJECTORIES // paths))
        settings = {"seed": method.seed, "scheme": method.scheme}
        known = axis, rounds, dt, settings, failures
        return transient_in_rounds(asked, watch, states, *known, mirror=mirror)


def transient_in_rounds(
    asked: Asked,
    watch: Watch,
    states: Callable[..., Iterable[tuple[Any, ...]]],
    axis: Callable[..., BinAxis],
    rounds: tuple[int, int],
    dt: float,
    settings: Mapping[str, Any],
    failures: Sequence[str] = (),
    *,
    mirror: bool = False,
) -> Transient:
    """Return the densities of ``asked.observable``; ``dt`` is the longer step.

    ``states(number, begin)`` yields the coordinates (paths,) of a round as ``motions`` does, at
    half the step and, if the step has an error, at the step; ``axis`` makes bins as ``axis_of``
    does. ``rounds``: number without a tolerance, and the largest. The error is one standard error
    and the change at the longer step, added in squares, or inf at points in bins that do not
    resolve the density. ``failures``: words against certification.
    """
    times, tol = asked.times, inf if watch.tol is None else watch.tol
    sampled = list[tuple[histogram.Histogram, Integers]]()  # counts (2, GROUPS, bins + 1)
    taken, stepped = np.zeros(times.size, dtype=np.int64), False

    def densities(which: int = 0) -> list[SampledDensity]:
        known: Any = {"mirror": mirror, "everywhere": False}
        return [
            histogram.density_of_counts(bins, counts[which], taken=int(many), **known)
            for (bins, counts), many in zip(sampled, taken, strict=True)
        ]

    def error_after(number: int) -> float:
        nonlocal stepped
        first = partial(watch.required, "the first round")
        later = lambda: lambda share: watch.ends()  # noqa: E731
        for k, at_steps in enumerate(states(number, later if number else first)):
            stepped = len(at_steps) > 1
            for which, values in enumerate(at_steps):
                if k == len(sampled):
                    bins = bins_over(asked.observable, values, axis, times[k])
                    sampled.append((bins, np.zeros((2, MAX_BATCHES, bins.size + 1), np.int64)))
                sampled[k][1][which] += sampled[k][0].counted(values, MAX_BATCHES)
            taken[k] += at_steps[0][0].size
            every = rounds[0] * times.size
            asked.progress(min(every, number * times.size + k + 1), every, "transient")
        return inf if tol == inf else max(d.l1_error for d in densities())

    interrupted = watch.until(error_after, least=rounds[0] if tol == inf else 1, most=rounds[1])
    fine, bias, wide = densities(), 0.0, list[str]()
    values, errors = np.zeros((2, times.size, asked.at[0].size))
    for k, (a, b) in enumerate(zip(fine, densities(1) if stepped else fine, strict=True)):
        values[k], errors[k] = a.at(*asked.at)
        step, lost = b.at(*asked.at)[0] - values[k], a.are_unresolved(np.stack(asked.at))
        errors[k] = np.where(lost, inf, np.hypot(errors[k], step))
        if lost.any():
            words = histogram.words_on_resolution(a)[0]
            wide.append(f"at t = {times[k]:g} {words}; ask for later times")
        bias = max(bias, float(np.max(np.abs(step), initial=0.0)))
    certificates = [density.certificate for density in fine]
    own = dict.fromkeys(words for c in certificates for words in c.failures)
    measured = Measured(
        l1_error=max(density.l1_error for density in fine),
        mass_defect=largest_measured(c.mass_defect for c in certificates),
        minimum=min((x for c in certificates if (x := c.minimum) is not None), default=None),
        residual=largest_measured(c.residual for c in certificates),
        tail_mass=max(c.tail_mass or 0.0 for c in certificates),
        failures=(*failures, *interrupted, *own, *wide[:1]),
    )
    settings = {"trajectories": int(min(taken)), **settings, "expected L1 error": measured.l1_error}
    if stepped:
        settings |= {"dt": 0.5 * dt, "coarse dt": dt, "largest difference of both": bias}
    certificate = certify(measured, tol=tol, sampled=True)
    return Transient(times, values, errors, "sampling", certificate, settings)


def bins_over(
    observable: Observable, columns: Sequence[Array], axis: Callable[..., BinAxis], time: float
) -> histogram.Histogram:
    """Return bins over the ``columns`` (paths,) of ``observable`` at ``time``.

    Raises ``InvalidInput`` if a coordinate has the same value on all paths.
    """
    reached = np.array([(x.min(), x.max()) for x in columns])
    for c, (low, high) in zip(observable, reached.tolist(), strict=True):
        if not high - low > 1e-9 * max(abs(low), abs(high)):
            words = f"{c} is one value at t = {time:g}, and has no density"
            raise InvalidInput("times", time, f"{words}; ask for later times")
    pairs = zip(observable, columns, strict=True)
    rises = any(histogram.rises(x) for c, x in pairs if c.kind == "H")
    return histogram.covering([observable], reached, partial(axis, rises=rises))[0]
