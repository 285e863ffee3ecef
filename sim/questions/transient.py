"""Transient densities by simulation, counted in groups of trajectories at two steps."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from math import ceil, inf
from typing import Any

import numpy as np

from fpk.answer.bins import BinAxis
from fpk.answer.certificate import Measured, certify, outside, tolerance, worst
from fpk.answer.evolution import Transient
from fpk.answer.observable import Observable
from fpk.answer.question import Asked
from fpk.answer.sampled_density import SampledDensity
from fpk.numeric.arrays import Array, Integers
from fpk.numeric.errors import InvalidInput
from fpk.numeric.machine import left_out
from fpk.system.system import System, effects_of
from sim.questions import limits
from sim.questions.rounds import Watch, seed_of, working
from sim.sample import histogram
from sim.sample.ensemble import Ensemble, ensemble_from
from sim.sample.settings import Settings
from sim.step.arrays import GROUPS, LANES, MAX_TRAJECTORIES, in_rows
from sim.step.step_size import loudest

States = Iterable[tuple[Array, Array | None]]
"""States (paths, …) at each time, at half the step and at the step, None where it has no error."""


def transient(method: Settings, asked: Asked) -> Transient:
    """Return the densities that are asked for with one standard error.

    In the error is, in quadrature, what changes at the step dt instead of dt/2, by the same random
    numbers. ``asked.tol`` is the expected L1 error wanted at every time; eight rounds of ``paths``
    are made where neither it nor a time is given.
    """
    system, observable, start, times = asked.system, asked.observable, asked.start, asked.times
    limits.require_times(times)
    wanted, loud = tolerance(asked.tol, method.tol), loudest(system)
    reach = limits.reach_of(loud, None, start, float(np.max(times)))
    dt, failures = limits.motion_step(method, loud, reach, error=wanted)
    mirror = effects_of(system).mirror and (start.kind != "state" or start.rest)
    paths = -(-method.paths // LANES) * LANES

    def columns(states: Array) -> list[Array]:
        q, p = np.split(states, 2, axis=1)
        return [histogram.values_of(system, c, q, p) for c in observable]

    def states(number: int) -> States:
        def ended(share: float) -> bool:
            if not number:  # later, what there is will do
                watch.require("the first round", share)
            return number > 0 and watch.ends()

        seed = seed_of(method.seed, number)
        q, p = origin(paths, number)
        return motions(system, q, p, times, dt, seed, workers, ended)

    with working(method, system, wanted, start) as (workers, watch, origin):
        axis = partial(histogram.axis_of, system)
        settings = {"seed": method.seed, "scheme": method.scheme}
        counted = partial(counted_in_rounds, asked, watch, states, columns, axis, mirror=mirror)
        return counted(8, paths, dt, settings, failures)


def motions(
    system: System,
    q: Array,
    p: Array,
    times: Array,
    dt: float,
    seed: int,
    workers: Any = None,
    ended: Callable[[float], bool] = lambda share: False,
) -> States:
    """Yield the states (paths, 2n) of motions from q, p at each time, at steps of dt/2 and ``dt``.

    Where the step has no error it is as long as the time. There are no more states where it is
    ``ended``, of which it is asked with the share of the times that is done.
    """
    now, running = 0.0, list[Ensemble]()
    stepped = limits.needs_steps(system) or system.modulation is not None
    many = (2, 1) if stepped else (1,)
    known: Any = {"workers": workers, "modulation": system.modulation}
    begun = partial(ensemble_from, system, q, p, **known)
    for time in times.tolist():
        if time > now:
            steps = ceil((time - now) / dt) if stepped else 1
            parts = ceil(steps / limits.CHUNK)
            stride = ceil(steps / parts)
            long = (time - now) / (parts * stride)
            with left_out():
                if running:
                    pairs = zip(running, many, strict=True)
                    running = [ensemble.onward(long / each) for ensemble, each in pairs]
                else:  # by the same random numbers
                    both = [(long / each, each < many[0]) for each in many]
                    running = [begun(dt=h, seed=seed, halved=halved) for h, halved in both]
            for ensemble, each in zip(running, many, strict=True):
                for done in range(parts):
                    ensemble.advance(stride * each, stride=stride * each)
                    if ended((now + (time - now) * (done + 1) / parts) / times[-1]):
                        return
        now = time
        states = [in_rows(ensemble.last)[:, : 2 * system.n] for ensemble in running]
        states = states or [np.hstack([q, p])]
        yield states[0], states[-1] if stepped else None


def counted_in_rounds(
    asked: Asked,
    watch: Watch,
    states: Callable[[int], States],
    columns: Callable[[Array], Sequence[Array]],
    axis: Callable[..., BinAxis],
    rounds: int,
    paths: int,
    dt: float,
    settings: Mapping[str, Any],
    failures: Sequence[str] = (),
    *,
    mirror: bool = False,
) -> Transient:
    """Return the densities that are asked for, ``dt`` being the longer step.

    ``states(number)`` yields states of a round of ``paths``, of which ``columns`` returns the
    coordinates of the observable, (paths,) each; ``axis`` makes bins as ``axis_of`` does, over the
    ranges of the first round. Rounds follow until the ``watch`` ends them, ``rounds`` of them where
    no error is wanted. In the error are, in quadrature, one standard error by the groups and the
    change at the longer step. Where the bins do not show the density errors are inf and nothing is
    certified.
    """
    times, tol = asked.times, inf if watch.tol is None else watch.tol
    found = list[
        tuple[histogram.Histogram, Integers]
    ]()  # counts (2, GROUPS, bins + 1) of each time
    taken, stepped = np.zeros(times.size, dtype=np.int64), False

    def densities(which: int = 0) -> list[SampledDensity]:
        known: Any = {"mirror": mirror, "everywhere": False}
        return [
            histogram.sampled_density(bins, counts[which], taken=int(many), **known)
            for (bins, counts), many in zip(found, taken, strict=True)
        ]

    def error_after(number: int) -> float:
        nonlocal stepped
        for k, (fine, coarse) in enumerate(states(number)):
            stepped = coarse is not None
            for which, at_step in enumerate((fine,) if coarse is None else (fine, coarse)):
                values = columns(at_step)
                if k == len(found):
                    bins = bins_over(asked.observable, values, axis, times[k])
                    found.append((bins, np.zeros((2, GROUPS, bins.size + 1), np.int64)))
                found[k][1][which] += found[k][0].counted(values, GROUPS)
            taken[k] += len(fine)
            every = rounds * times.size
            asked.progress(min(every, number * times.size + k + 1), every, "transient")
        return inf if tol == inf else max(d.l1_error for d in densities())

    least, most = rounds if tol == inf else 1, max(1, MAX_TRAJECTORIES // paths)
    watch.until(error_after, least=least, most=most)
    fine, bias, wide = densities(), 0.0, list[str]()
    values, errors = np.zeros((2, times.size, asked.at[0].size))
    for k, (a, b) in enumerate(zip(fine, densities(1) if stepped else fine, strict=True)):
        values[k], errors[k] = a.at(*asked.at)
        step, lost = b.at(*asked.at)[0] - values[k], a.are_unresolved(np.stack(asked.at))
        errors[k] = np.where(lost, inf, np.hypot(errors[k], step))
        if lost.any():
            words = histogram.unresolved_words(a)[0]
            wide.append(f"at t = {times[k]:g} {words}; ask for later times")
        bias = max(bias, float(np.max(np.abs(step), initial=0.0)))
    certificates = [density.certificate for density in fine]
    own = dict.fromkeys(words for c in certificates for words in c.failures)
    measured = Measured(
        l1_error=max(density.l1_error for density in fine),
        mass_defect=worst(c.mass_defect for c in certificates),
        minimum=min((x for c in certificates if (x := c.minimum) is not None), default=None),
        residual=worst(c.residual for c in certificates),
        tail_mass=max(map(outside, certificates)),
        failures=(*failures, *watch.interruption(), *own, *wide[:1]),
    )
    settings = {"trajectories": int(min(taken)), **settings, "expected L1 error": measured.l1_error}
    if stepped:
        settings |= {"dt": 0.5 * dt, "coarse dt": dt, "largest difference of both": bias}
    certificate = certify(measured, tol=tol, sampled=True)
    return Transient(times, values, errors, "sampling", certificate, settings)


def bins_over(
    observable: Observable, columns: Sequence[Array], axis: Callable[..., BinAxis], time: float
) -> histogram.Histogram:
    """Return bins over the ``columns`` (paths,) of an observable; refuse one that is constant."""
    reached = np.array([(x.min(), x.max()) for x in columns])
    for c, (low, high) in zip(observable, reached.tolist(), strict=True):
        if not high - low > 1e-9 * max(abs(low), abs(high)):
            words = f"{c} is one value at t = {time:g}, and has no density"
            raise InvalidInput("times", time, f"{words}; ask for later times")
    pairs = zip(observable, columns, strict=True)
    rises = any(histogram.rises(x) for c, x in pairs if c.kind == "H")
    return histogram.covering([observable], reached, partial(axis, rises=rises))[0]
