"""Simulations of Eq. (6): set-up, burn-in, pilot, sampling, half the step, and the result."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from math import ceil, hypot, inf, nan
from typing import Any, Literal

import numpy as np

from fpk.answer.method import Progress, Result, silent
from fpk.answer.observable import Observable
from fpk.answer.quantities import Number
from fpk.numeric.arrays import Array
from fpk.numeric.errors import InvalidInput
from fpk.numeric.machine import left_out, usable_cores, working_time
from fpk.system.system import System, effects_of
from sim.sample import diagnostics
from sim.sample.diagnostics import CHUNKS
from sim.sample.ensemble import Ensemble
from sim.sample.histogram import Histogram, axis_of, covering, extremes, sampled_density
from sim.sample.plan import cost, with_long_steps
from sim.sample.record import Record
from sim.sample.settings import NOT_IN_STATE, Settings, default_step
from sim.sample.workers import Checkpoint, checkpoint_of, interruptible, workers_of
from sim.step.random import GOLDEN
from sim.step.schemes import SCHEMES, Scheme
from sim.step.step_size import relaxation_time, sampling_interval, stability_limit, temperature

PILOT_STATES, PILOT_PATHS = 16, 65536
"""States of the ensemble from which the ranges of the histograms are taken, and most trajectories:
the extremes of more lie within the margin. Between two states lie 8 intervals of samples, about a
period of the fastest mode."""
LEAST_CHUNKS = 8
"""Chunks before which a target error is not trusted: halves of four can be compared."""
STEP_BIAS = 1e-3
"""Defect of a moment identity, relative to its right side (a virial: to kT), that the step may
leave beyond chance."""


@dataclass(frozen=True, eq=False)
class Setup:
    """Everything that the numbers of one simulation of Eq. (6) depend on; times of the system.

    ``dt`` is the long step where ``scheme`` makes small ones. Each trajectory is sampled for
    ``time`` or, where ``seconds`` are finite, for so long in wall time, or until the expected L1
    error of the first observable is below ``tol``. ``histograms`` None: bins that cover what a
    pilot reaches. ``division`` and ``limited_by`` are in the report as ``small_steps`` and
    ``limited_by``; ``failures`` are reasons not to certify an answer.
    """

    method: Settings
    system: System
    observables: Sequence[Observable]
    scheme: Scheme
    dt: float
    time: float
    tol: float = inf
    seconds: float = inf
    histograms: tuple[Histogram, ...] | None = None
    division: str = ""
    limited_by: Literal["", "most_steps"] = ""
    failures: tuple[str, ...] = ()

    @cached_property
    def stride(self) -> int:
        """Steps from one sample to the next."""
        return max(1, round(sampling_interval(self.system) / self.dt))

    @cached_property
    def burn_in_steps(self) -> int:
        """Steps before the sampling begins."""
        return ceil(self.method.burn_in * relaxation_time(self.system) / self.dt)

    def checkpoint(self) -> Checkpoint:
        """Return the checkpoint in the folder of the method; another limit of time may go on."""
        limited = self.seconds < inf
        return checkpoint_of(self.method.checkpoint, (self, limited), less=NOT_IN_STATE)


def setup_of(method: Settings, system: System, observables: Sequence[Observable]) -> Setup:
    """Return the setup that ``method`` asks for; raise ``InvalidInput`` for an unstable step."""
    scheme, failures = SCHEMES[method.scheme], list[str]()
    dt = method.dt or method.step_factor * default_step(method, system, observables)
    limit = stability_limit(system, scheme)
    if not 0.0 < dt < limit:
        remedy = f"must be > 0 and below the stability limit {limit:.4g} of {scheme.name}"
        if not method.allow_unstable:
            raise InvalidInput("dt", dt, remedy)
        failures.append(f"the step {dt:g} was insisted on: it {remedy}")
    # Of its 2**40 words of random numbers a trajectory takes n a step, 5/4 n with long steps.
    relaxation = relaxation_time(system)
    longest = method.burn_in * relaxation + (method.time or 0.0)
    if dt < (shortest := 2.0**-39 * system.n * longest):
        remedy = f"takes more random numbers than a trajectory has; use at least {shortest:.2g}"
        raise InvalidInput("dt", dt, remedy)
    scheme, long, division = with_long_steps(system, scheme, dt)
    tol = method.tol if method.tol is not None and observables else inf
    own = 3.0 if method.step_pair else 1.0  # half the step takes twice as long
    seconds = method.seconds / own if method.seconds else method.longest if tol < inf else inf
    time = method.sampled_time(system, dt / cost(system, dt, scheme.small))
    limited = method.time is None and time < method.relaxations * relaxation
    return Setup(
        method, system, tuple(observables), scheme, dt=long, time=time, tol=tol, seconds=seconds,
        division=division, limited_by="most_steps" if limited else "", failures=tuple(failures),
    )  # fmt: skip


def run(
    method: Settings,
    system: System,
    observables: Sequence[Observable],
    progress: Progress,
    beside: Sequence[Observable] = (),
) -> Result:
    """Return the densities of ``observables``, and of ``beside``, with their report.

    A step pair compares them with a second run at half the step, unless one of both was interrupted
    or has no chunk by the limit of time.
    """
    setup = setup_of(method, system, [*observables, *beside])
    with workers_of(method.cluster, method.threads or usable_cores()) as workers:
        result = simulate(setup, workers=workers, progress=progress)
        report: Any = result.report
        densities: Any = result.densities  # of histograms
        if method.step_pair and report.diagnosis is not None:
            half = replace(
                setup,
                method=replace(method, seed=(method.seed + int(GOLDEN)) % 2**64),
                dt=0.5 * setup.dt,
                time=report.time,
                tol=inf,
                seconds=2.0 * setup.seconds if method.seconds else inf,
                histograms=tuple(Histogram(d.observable, d.bins) for d in densities),
            )
            second: Any = simulate(half, workers=workers, progress=progress)
            other: diagnostics.Report = second.report
            if other.diagnosis is None:
                words = "interrupted" if other.interrupted else "the limit of time came"
                report = replace(report, step_pair=f"not measured: {words}")
            else:
                pairs = zip(densities, second.densities, strict=True)
                biases = {a.name: diagnostics.l1_difference(a, b) for a, b in pairs}
                for name, a in report.moments.items():
                    b = other.moments[name]
                    biases[name] = Number(a.value - b.value, hypot(a.error, b.error))
                report = replace(report, step_biases=biases, step_pair="dt against dt/2")
    asked, others = densities[: len(observables)], densities[len(observables) :]
    settings = report.settings(asked)
    return replace(result, densities=asked, beside=others, report=report, settings=settings)


def simulate(setup: Setup, *, workers: Any = None, progress: Progress = silent) -> Result:
    """Sample the stationary state of Eq. (6), from a saved state of this ``setup`` on, if any."""
    method, cut, checkpoint = setup.method, "", setup.checkpoint()
    products = diagnostics.moment_products(setup.system.n, terms=bool(setup.system.damping_terms))
    covered = partial(covering, setup.observables, axis=partial(axis_of, setup.system))
    with checkpoint.alone(), interruptible(method.partial) as checkpoint.stopped:
        ensemble = Ensemble(
            setup.system, setup.scheme, setup.dt, method.paths, method.seed, workers=workers
        )
        saved = checkpoint.load()
        # Any ranges: with the kinds of observables as later there is one kernel for all.
        reached = np.full((sum(map(len, setup.observables)), 2), (-1.0, 1.0))
        ensemble.watch(covered(reached), products)
        with left_out():
            ensemble.advance(0, stride=0)  # compiles
        begin = working_time()
        checkpoint.deadline = begin + setup.seconds
        if "reached" in saved:
            reached = saved["reached"]
        else:
            if saved:
                ensemble.restore(saved)
            whole, pilot = setup.burn_in_steps, list[Array]()
            for k in range(1, CHUNKS + 1):
                if checkpoint.advance(ensemble, whole * k // CHUNKS - ensemble.done, stride=0):
                    break
                progress(k, CHUNKS, "burn-in")
            share = min(ensemble.done / whole, 1.0)
            done, step = share == 1.0, 8 * setup.stride
            for _ in range(PILOT_STATES if setup.histograms is None else 0):
                done = done and not checkpoint.advance(ensemble, step, stride=0, saving=False)
                if done or not pilot:
                    states = ensemble.phase_points(PILOT_PATHS)
                    pilot.append(extremes(setup.system, setup.observables, *states))
            if pilot:
                lowest, highest = np.min(pilot, axis=0)[:, 0], np.max(pilot, axis=0)[:, 1]
                reached = np.stack([lowest, highest], axis=1)
            cut = "" if done else f"after {share:.2g} of the burn-in"
        ensemble.watch(setup.histograms or covered(reached), products)
        record = Record(ensemble, elapsed=working_time() - begin)
        if "reached" in saved:
            ensemble.restore(saved)
            record.restore(saved)
        if cut:
            ensemble.advance(1, stride=setup.stride)  # a sample of the states that there are
        else:
            checkpoint.notes["reached"] = reached
            _sample(setup, record, checkpoint, progress)
            checkpoint.save(ensemble.saved())
    return _result(setup, record, checkpoint.interrupted, cut)


def _sample(setup: Setup, record: Record, checkpoint: Checkpoint, progress: Progress) -> None:
    """Advance until ``setup`` is met or ``checkpoint`` ends it; ``record`` gets whole chunks."""
    ensemble, stride, limited = record.ensemble, setup.stride, setup.seconds < inf
    begin = working_time() - record.elapsed
    checkpoint.deadline = begin + setup.seconds
    chunks = CHUNKS * (32 if limited else 1)
    first = max(1, ceil(setup.time / (stride * ensemble.dt * chunks)))
    record.chunk_samples = record.chunk_samples or first
    while True:
        start, length = working_time(), record.chunk_samples * stride
        begun = len(record.ends) * length
        if ensemble.phase == begun and record.chunks in range(0, CHUNKS, 5):
            record.snapshot(stride)
        record.elapsed = start - begin
        checkpoint.notes |= record.saved()
        stopped = checkpoint.advance(ensemble, begun + length - ensemble.phase, stride=stride)
        record.stepping += working_time() - start
        if stopped:
            return
        record.chunks += 1
        record.chunk_ends()
        record.elapsed = working_time() - begin
        ends = record.elapsed > setup.seconds or (not limited and record.chunks == CHUNKS)
        enough = record.chunks >= LEAST_CHUNKS and ensemble.samples >= record.target
        if setup.tol < inf and (ends or enough):
            taken, mirror = ensemble.paths * ensemble.samples, effects_of(setup.system).mirror
            error = sampled_density(*next(ensemble.counted()), taken=taken, mirror=mirror).l1_error
            record.target = ensemble.samples * (error / setup.tol) ** 2
            ends |= error <= setup.tol
        done = record.chunks / CHUNKS
        if limited:
            sampled = ensemble.samples / record.target if record.target else 0.0
            done = max(sampled, record.elapsed / setup.seconds)
        progress(min(CHUNKS, int(CHUNKS * done)), CHUNKS, "simulation")
        if ends:
            return
        if limited and len(record.ends) == 2 * CHUNKS:  # one of every two
            record.ends, record.chunk_samples = record.ends[1::2], 2 * record.chunk_samples


def _result(setup: Setup, record: Record, partial: bool, cut: str) -> Result:
    """Return the certified densities, the moment identities and the report.

    ``cut`` says in words where the burn-in ended early, and ``partial`` that Ctrl-C came. Of a
    system with mirror symmetry mirror images of samples count as samples.
    """
    ensemble, kT, failures = record.ensemble, temperature(setup.system), list[str]()
    taken, burnt = ensemble.samples * setup.stride, ensemble.done - ensemble.phase
    burn_in, diagnosed = min(setup.burn_in_steps, burnt) * setup.dt, None
    of = f" of {CHUNKS}" if setup.seconds == inf else ""
    interrupted = f"partial: interrupted {cut or f'after {record.chunks}{of} chunks'}"
    if partial:
        failures.append(interrupted)
    elif not record.chunks:
        where = cut or "in its first chunk, before any drift"
        failures.append(f"the limit of {setup.seconds:g} s came {where}; give it more time")
    whole = not failures
    failures += setup.failures
    identities = diagnostics.moment_identities(setup.system, ensemble.batch_means())
    judged = identities if burnt >= setup.burn_in_steps else ()
    chance = diagnostics.drift_limit(ensemble.edges.size - 1, len(identities))
    failures += [
        f"{i.name} is off by {i.z:.1f} standard errors; use a smaller dt"
        for i in judged
        if abs(i.value - i.expected) > chance * i.error + STEP_BIAS * (i.expected or kT)
    ]
    if whole:
        diagnosed = diagnostics.diagnosis(
            record.effective(), record.names, record.means(),
            time=ensemble.samples * (ensemble.dt * setup.stride), paths=ensemble.paths,
            burn_in=burn_in,
        )  # fmt: skip
        failures += diagnosed.failures
    densities = tuple(
        sampled_density(
            histogram,
            counts,
            taken=ensemble.paths * ensemble.samples,
            mirror=effects_of(setup.system).mirror,
            residual=max((abs(i.z) for i in judged), default=nan),
            tol=setup.tol if m == 0 else inf,
            failures=failures,
        )
        for m, (histogram, counts) in enumerate(ensemble.counted())
    )
    report = diagnostics.Report(
        dt=setup.dt / setup.scheme.small,
        paths=ensemble.paths,
        time=taken * setup.dt,
        burn_in=burn_in,
        relaxation_time=relaxation_time(setup.system),
        scheme=setup.scheme.name,
        steps=taken,
        stride=setup.stride,
        batches=ensemble.edges.size - 1,
        seed=ensemble.seed,
        threads=ensemble.threads,
        kT=kT,
        long_step=setup.dt,
        ns_per_particle_step=1e9 * record.stepping * ensemble.threads / (ensemble.paths * taken),
        small_steps=setup.division,
        limited_by=setup.limited_by,
        diagnosis=diagnosed,
        moments=record.moments(),
        interrupted=interrupted if partial else "",
    )
    method: Any = setup.method  # a ``MonteCarlo``
    return Result(method, densities, identities=identities, partial=partial, report=report)
