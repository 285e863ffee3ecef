"""Transient densities by simulation, counted in groups of trajectories at two steps."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from math import ceil, inf

import numpy as np

from fpk.answer.bins import BinAxis
from fpk.answer.certificate import Measured, certify, outside, tolerance, worst
from fpk.answer.evolution import Transient
from fpk.answer.method import Progress
from fpk.answer.observable import Observable
from fpk.answer.question import Asked
from fpk.answer.sampled_density import SampledDensity
from fpk.numeric.arrays import Array, Integers
from fpk.numeric.errors import InvalidInput
from fpk.numeric.machine import left_out
from fpk.system.system import effects_of
from sim.questions import limits
from sim.questions.rounds import Watch, both_steps, seed_of, working
from sim.questions.starts import Origin
from sim.sample import histogram
from sim.sample.ensemble import Ensemble, ensemble_from
from sim.sample.settings import Settings
from sim.step.arrays import GROUPS, LANES, MAX_TRAJECTORIES, in_rows
from sim.step.reachable import loudest
from sim.step.step_size import REACHED

CHUNK = 512
"""Steps at most from one sample to the next, so that Ctrl-C comes through."""


def transient(method: Settings, asked: Asked) -> Transient:
    """Return the densities that are asked for with one standard error.

    In the error is, in quadrature, what changes at the step dt instead of dt/2, by the same random
    numbers. ``asked.tol`` is the expected L1 error wanted at every time; eight rounds of ``paths``
    are made where neither it nor a time is given.
    """
    system, observable, start, times = asked.system, asked.observable, asked.start, asked.times
    limits.require_times(times)
    wanted = tolerance(asked.tol, method.tol)
    loud = loudest(system)
    kT = limits.temperature_reached(loud, start, float(np.max(times)))
    reach = limits.Reach(kT, limits.largest_energy(system, start) + REACHED * kT)
    dt, failures = limits.motion_step(method, loud, reach, error=wanted)
    mirror = effects_of(system).mirror and (start.kind != "state" or start.rest)
    paths = -(-method.paths // LANES) * LANES

    def read(states: Array) -> list[Array]:
        q, p = np.split(states, 2, axis=1)
        return [histogram.values_of(system, c, q, p) for c in observable]

    counted = Counted(observable, read, partial(histogram.axis_of, system), mirror)
    with working(method, system, wanted, start) as (_, watch, origin):
        return counted_in_rounds(
            counted,
            lambda number: ensembles(origin, times, paths, number, dt),
            times,
            asked.at,
            watch,
            dt,
            rounds=8,
            least=8 if wanted is None else 1,
            most=MAX_TRAJECTORIES // paths,
            what="transient",
            progress=asked.progress,
            failures=failures,
            settings={"seed": method.seed, "scheme": method.scheme},
        )


def ensembles(
    origin: Origin, times: Array, paths: int, number: int, dt: float
) -> Iterator[tuple[Array, Array | None]]:
    """Yield the states (paths, 2n) at each time, at steps of dt/2 and of ``dt``.

    The second is None where the step has no error: it is then as long as the time. Where the watch
    of the origin ends it there are no more; in the first round it raises ``InvalidInput``.
    """
    system, seed, now, running = origin.system, seed_of(origin.seed, number), 0.0, list[Ensemble]()
    stepped = limits.needs_steps(system) or system.modulation is not None
    q, p, many = *origin.drawn(paths, number), (2, 1) if stepped else (1,)
    for time in times.tolist():
        if time > now:
            steps = ceil((time - now) / dt) if stepped else 1
            parts = ceil(steps / CHUNK)
            stride = ceil(steps / parts)
            long = (time - now) / (parts * stride)
            with left_out():
                if running:
                    pairs = zip(running, many, strict=True)
                    running = [ensemble.onward(long / each) for ensemble, each in pairs]
                elif stepped:
                    running = both_steps(
                        system, q, p, long, seed, workers=origin.workers,
                        modulation=system.modulation,
                    )  # fmt: skip
                else:
                    running = [ensemble_from(system, q, p, long, seed, workers=origin.workers)]
            for ensemble, each in zip(running, many, strict=True):
                for done in range(parts):
                    ensemble.advance(stride * each, stride=stride * each)
                    if origin.watch and origin.watch.ends():
                        if number:  # what there is will do
                            return
                        share = (now + (time - now) * (done + 1) / parts) / times[-1]
                        origin.watch.require("the first round", share)
        now = time
        states = [in_rows(ensemble.last)[:, : 2 * system.n] for ensemble in running]
        states = states or [np.hstack([q, p])]
        yield states[0], states[-1] if stepped else None


@dataclass(eq=False)
class Counted:
    """Histograms of one observable at several times, their ranges from the first round.

    ``read`` gives the coordinates of the observable, (paths,) each, of states (paths, ...);
    ``axis`` makes the bins of a coordinate, as ``axis_of`` does. ``paths`` have been counted so
    far, at two steps where they are ``stepped``.
    """

    observable: Observable
    read: Callable[[Array], Sequence[Array]]
    axis: Callable[..., BinAxis]
    mirror: bool = False
    histograms: list[histogram.Histogram] = field(default_factory=list)
    counts: list[Integers] = field(default_factory=list)  # of each time: (2, GROUPS, bins + 1)
    paths: list[int] = field(default_factory=list)
    stepped: bool = False

    def add(self, k: int, time: float, fine: Array, coarse: Array | None) -> None:
        """Count the states (paths, ...) of time number ``k``, at half the step and at the step."""
        self.stepped = coarse is not None
        for which, states in enumerate((fine,) if coarse is None else (fine, coarse)):
            columns = self.read(states)
            if k == len(self.histograms):
                reached = np.array([(x.min(), x.max()) for x in columns])
                for c, (low, high) in zip(self.observable, reached.tolist(), strict=True):
                    if not high - low > 1e-9 * max(abs(low), abs(high)):
                        words = f"{c} is one value at t = {time:g}, and has no density"
                        raise InvalidInput("times", time, f"{words}; ask for later times")
                energies = [
                    x for c, x in zip(self.observable, columns, strict=True) if c.kind == "H"
                ]
                axis = partial(self.axis, rises=any(map(histogram.rises, energies)))
                self.histograms += histogram.covering([self.observable], reached, axis)
                self.counts.append(np.zeros((2, GROUPS, self.histograms[k].size + 1), np.int64))
                self.paths.append(0)
            self.counts[k][which] += self.histograms[k].counted(columns, GROUPS)
        self.paths[k] += len(fine)

    def densities(self, which: int = 0) -> list[SampledDensity]:
        """Return the densities at all times, of the finer simulation or the coarser one (1)."""
        return [
            histogram.sampled_density(
                bins, counts[which], taken=paths, mirror=self.mirror, everywhere=False
            )
            for bins, counts, paths in zip(self.histograms, self.counts, self.paths, strict=True)
        ]


def counted_in_rounds(
    counted: Counted,
    states: Callable[[int], Iterable[tuple[Array, Array | None]]],
    times: Array,
    at: tuple[Array, ...],
    watch: Watch,
    dt: float,
    *,
    rounds: int,
    least: int,
    most: int,
    what: str,
    progress: Progress,
    settings: Mapping[str, str | float | int],
    failures: Sequence[str] = (),
) -> Transient:
    """Return the densities at ``times`` at the points ``at``, ``dt`` being the longer step.

    ``states(number)`` yields those at each time in a round of trajectories, at half the step and at
    the step; rounds follow, ``least`` to ``most``, until the ``watch`` ends them; ``progress`` is
    shown for so many ``rounds``. In the error are, in quadrature, one standard error by the groups
    and what changes at the longer step. Where the bins do not show the density errors are inf and
    nothing is certified.
    """

    def error_after(number: int) -> float:
        done = rounds * len(times)
        for k, (fine, coarse) in enumerate(states(number)):
            counted.add(k, times[k], fine, coarse)
            progress(min(done, number * len(times) + k + 1), done, what)
        return inf if watch.tol in (None, inf) else max(d.l1_error for d in counted.densities())

    watch.until(error_after, least=least, most=most)
    fine = counted.densities()
    coarse = counted.densities(1) if counted.stepped else fine
    values, errors, bias, wide = [], [], 0.0, list[str]()
    for time, a, b in zip(times.tolist(), fine, coarse, strict=True):
        value, error = a.at(*at)
        step, lost = b.at(*at)[0] - value, a.are_unresolved(np.stack(at))
        values.append(value)
        errors.append(np.where(lost, inf, np.hypot(error, step)))
        if lost.any():
            wide.append(f"at t = {time:g} {histogram.unresolved_words(a)[0]}; ask for later times")
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
    settings = {
        "trajectories": min(counted.paths),
        **settings,
        "expected L1 error": measured.l1_error,
    }
    if counted.stepped:
        settings |= {"dt": 0.5 * dt, "coarse dt": dt, "largest difference of both": bias}
    certificate = certify(measured, tol=inf if watch.tol is None else watch.tol, sampled=True)
    return Transient(times, np.array(values), np.array(errors), "sampling", certificate, settings)
