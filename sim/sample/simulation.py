"""Simulations of Eq. (6): burn-in, pilot, sampling in chunks, half the step, and the result."""

from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from functools import partial
from math import ceil, hypot, inf, nan
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fpk.answer.method import Progress, Result, silent
from fpk.answer.names import Observable
from fpk.answer.quantities import Number
from fpk.numeric.arrays import Array, Integers
from fpk.numeric.machine import pause_working_time, usable_cores, working_time
from fpk.system.system import System, effects_of
from sim.sample import diagnostics
from sim.sample.diagnostics import CHUNKS
from sim.sample.ensemble import Ensemble
from sim.sample.histogram import Histogram, axis_of, covering, density_of_counts, extremes
from sim.sample.plan import Setup, setup_of
from sim.sample.settings import Settings
from sim.sample.workers import Checkpoint, interruptible, workers_of
from sim.step.arrays import LANES
from sim.step.random import GOLDEN
from sim.step.step_size import relaxation_time, temperature

PILOT_STATES, PILOT_PATHS = 16, 65536
"""The ranges of the histograms are those of so many states of so many trajectories at most; more
would change them by less than the margin. Two states are 8 sampling intervals apart, about a period
of the fastest mode."""
LEAST_CHUNKS = 8
"""Least number of chunks before the target error can end a simulation: two halves of four chunks
then show a drift."""
LARGEST_Z = 5.0
"""Largest |z| of a moment identity by chance: Student's t exceeds it with the probability 2e-5 for
32 batches, 5e-6 for 64."""
STEP_BIAS = 1e-3
"""Allowed bias of a moment identity by the step, relative to its right side; of a virial, to kT."""


@dataclass(eq=False)
class Record:
    """Cumulative sums of every batch of ``ensemble`` at the ends of chunks of ``chunk_samples``.

    Quantities are the squares of q and v, and for every observed coordinate the shares of samples
    below the octiles of the first chunk, bins ``cuts`` of its axis. The variance of the squares is
    computed from single samples of all trajectories: σ² of 8192 trajectories to 2 %, about as
    precise as var(path means).
    """

    ensemble: Ensemble
    chunk_samples: int = 0
    chunks: int = 0  # all that were completed; joined chunks count as two
    elapsed: float = 0.0  # wall time in s, burn-in included
    untimed: int = 0  # steps of the burn-in in earlier processes, whose time is not known
    target: float = 0.0  # samples after which the error of the first density is computed again
    cuts: list[Any] = field(default_factory=list)  # pairs of an axis and a bin
    ends: list[Array] = field(default_factory=list)  # each (batches, quantities)
    variances: list[Array] = field(default_factory=list)  # σ² of the squares, and relative errors

    def __post_init__(self) -> None:
        """Set ``squares``: name, product number and factor of every q_i² and v_i²; the ``axes``."""
        system, products = self.ensemble.system, self.ensemble.products
        self.squares = [
            (f"{name}{i + 1}²", products.index((kind, i, kind, i)), 1.0 / m**power)
            for name, kind, power in (("q", "q", 0), ("v", "p", 2))
            for i, m in enumerate(system.mass.tolist())
        ]
        coordinates = [c for histogram in self.ensemble.histograms for c in histogram.observable]
        # In a system with mirror symmetry |q| and |p| are recorded.
        self.folds = [effects_of(system).mirror and c.kind != "H" for c in coordinates]
        names = (f"|{c}|" if f else c for c, f in zip(coordinates, self.folds, strict=True))
        self.axes = [f"the distribution of {name}" for name in names]

    @property
    def names(self) -> list[str]:
        """Names of the quantities, in the order of the columns of ``ends``."""
        return [name for name, _, _ in self.squares] + [self.axes[axis] for axis, _ in self.cuts]

    def snapshot(self, stride: int) -> None:
        """Advance by a step that ``stride`` observes; append σ² over paths to ``variances``."""
        before = self.ensemble.sums.copy()
        self.ensemble.advance(1, stride=stride)
        samples = self._of_paths(self.ensemble.sums - before)
        spread = samples.var(axis=1, ddof=1), diagnostics.variance_error(samples)
        self.variances.append(np.array(spread))

    def chunk_ends(self) -> None:
        """Append sums and counts to ``ends``; the first call sets ``cuts``, ``chunk_samples``."""
        ensemble, below, folds = self.ensemble, list[Integers](), iter(self.folds)
        for histogram, counts in ensemble.counted():
            own = counts[:, :-1].reshape(-1, *histogram.shape)
            for axis, bins in enumerate(histogram.shape, start=1):
                marginal = own.sum(axis=tuple({1, own.ndim - 1} - {axis}))
                if next(folds):  # bins of |x|, from the middle outwards
                    marginal = marginal[:, bins // 2 :] + marginal[:, : bins // 2][:, ::-1]
                below.append(np.cumsum(marginal, axis=1))
        if not self.ends:
            cuts = [diagnostics.octiles(share.sum(axis=0)).tolist() for share in below]
            self.chunk_samples = ensemble.samples
            self.cuts = [(axis, cut) for axis, own in enumerate(cuts) for cut in own]
        means, size = ensemble.batch_means(), ensemble.batch_paths()
        columns = [means[:, k] * (f * ensemble.samples) for _, k, f in self.squares]
        columns += [below[axis][:, cut] / size for axis, cut in self.cuts]
        self.ends.append(np.stack(columns, axis=1))

    def means(self) -> Array:
        """Return the means of the chunks, (quantities, batches, chunks)."""
        ends = np.diff(np.array(self.ends), axis=0, prepend=0.0)
        return np.ascontiguousarray(ends.transpose(2, 1, 0) / self.chunk_samples)

    def effective(self) -> list[tuple[str, float, float]]:
        """Return name, effective samples and their relative error of squares, then coordinates."""
        variance, error = np.mean(self.variances, axis=0)
        error = error / np.sqrt(len(self.variances))
        means = self._of_paths(self.ensemble.sums) / self.ensemble.samples
        of_squares = diagnostics.effective_of_paths(means, variance, error)
        effective = list(zip(self.names, *(x.tolist() for x in of_squares), strict=False))
        shares = self.ends[-1] / (self.chunk_samples * len(self.ends))
        for axis, name in enumerate(self.axes):
            columns = [len(self.squares) + k for k, cut in enumerate(self.cuts) if cut[0] == axis]
            if columns:
                effective.append((name, *diagnostics.effective_of_shares(shares[:, columns])))
        return effective

    def moments(self) -> dict[str, Number]:
        """Return E q_i² and E v_i² by name; errors from the spread of the trajectories' means."""
        ensemble = self.ensemble
        of_paths = self._of_paths(ensemble.sums) / ensemble.samples
        errors = np.sqrt(of_paths.var(axis=1, ddof=1) / ensemble.paths)
        means = ensemble.batch_paths() @ ensemble.batch_means() / ensemble.paths
        return {
            name: Number(factor * float(means[k]), float(error))
            for (name, k, factor), error in zip(self.squares, errors, strict=True)
        }

    def saved(self) -> dict[str, NDArray[Any]]:
        """Return all fields but the ensemble as arrays, by names such as "record_chunks"."""
        return {f"record_{f.name}": np.array(getattr(self, f.name)) for f in fields(self)[1:]}

    def restore(self, saved: Any) -> None:
        """Set all fields but the ensemble from ``saved``, arrays as ``self.saved()`` returns."""
        for f in fields(self)[1:]:
            setattr(self, f.name, type(getattr(self, f.name))(saved[f"record_{f.name}"]))

    def _of_paths(self, sums: Array) -> Array:
        """Return sums of q² and v² (squares, paths) from ``sums`` (blocks, products, LANES)."""
        rows = np.stack([f * sums[:, k] for _, k, f in self.squares])
        return np.asarray(rows[:, np.arange(LANES) < self.ensemble.live[:, None]])


def sample_stationary(
    method: Settings,
    system: System,
    observables: Sequence[Observable],
    progress: Progress,
    beside: Sequence[Observable] = (),
) -> Result:
    """Return the result with densities of ``observables``, and of ``beside``, and the report.

    With ``step_pair`` they are compared with a second run at half the step, unless either run was
    interrupted or completed no chunk within its time.
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
    """Return the result of sampling the stationary state of Eq. (6) by ``setup``.

    It continues from the checkpoint of this ``setup``, if there is one. ``workers`` None: one
    thread of this process. Raises ``Unavailable`` if the checkpoint is in use, is damaged or cannot
    be written.
    """
    method, cut, checkpoint = setup.method, "", setup.checkpoint()
    products = diagnostics.moment_products(setup.system.n, terms=bool(setup.system.damping_terms))
    covered = partial(covering, setup.observables, axis=partial(axis_of, setup.system))
    with checkpoint.alone(), interruptible(method.partial) as checkpoint.stopped:
        ensemble = Ensemble(
            setup.system, setup.scheme, setup.dt, method.paths, method.seed, workers=workers
        )
        saved = checkpoint.load()
        # Provisional ranges; the kernel depends only on the kinds of observables.
        reached = np.full((sum(map(len, setup.observables)), 2), (-1.0, 1.0))
        ensemble.watch(covered(reached), products)
        with pause_working_time():
            ensemble.advance(0, stride=0)  # compiles
        begin = working_time()
        checkpoint.deadline = begin + setup.seconds
        reached = saved.get("reached", reached)
        if saved and "reached" not in saved:
            ensemble.restore(saved)
        untimed = ensemble.done
        if "reached" not in saved:
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
                both = np.hstack(pilot)
                reached = np.stack([both.min(axis=1), both.max(axis=1)], axis=1)
            reach = "all" if share == 1.0 else f"{share:.2g}"
            cut = "" if done else f"after {reach} of the burn-in"
        ensemble.watch(setup.histograms or covered(reached), products)
        record = Record(ensemble, elapsed=working_time() - begin, untimed=untimed)
        if "reached" in saved:
            ensemble.restore(saved)
            record.restore(saved)
        if cut:
            ensemble.advance(1, stride=setup.stride)  # one sample
        else:
            checkpoint.notes["reached"] = reached
            _sample(setup, record, checkpoint, progress)
            checkpoint.save(ensemble.saved())
    return _result(setup, record, checkpoint.interrupted, cut)


def _sample(setup: Setup, record: Record, checkpoint: Checkpoint, progress: Progress) -> None:
    """Advance the ensemble of ``record`` until the time or error of ``setup`` is reached.

    A stop of ``checkpoint`` ends it earlier. Whole chunks are added to ``record``.
    """
    ensemble, stride, limited = record.ensemble, setup.stride, setup.seconds < inf
    begin = working_time() - record.elapsed
    checkpoint.deadline = begin + setup.seconds
    chunks = CHUNKS * (32 if limited else 1)
    first = max(1, ceil(setup.time / (stride * ensemble.dt * chunks)))
    record.chunk_samples = record.chunk_samples or first
    while True:
        length = record.chunk_samples * stride
        begun = len(record.ends) * length
        if ensemble.phase == begun and record.chunks in range(0, CHUNKS, 5):
            record.snapshot(stride)
        record.elapsed = working_time() - begin
        checkpoint.notes |= record.saved()
        stopped = checkpoint.advance(ensemble, begun + length - ensemble.phase, stride=stride)
        record.elapsed = working_time() - begin
        if stopped:
            return
        record.chunks += 1
        record.chunk_ends()
        ends = record.elapsed > setup.seconds or (not limited and record.chunks == CHUNKS)
        enough = record.chunks >= LEAST_CHUNKS and ensemble.samples >= record.target
        if setup.tol < inf and (ends or enough):
            taken, mirror = ensemble.paths * ensemble.samples, effects_of(setup.system).mirror
            error = density_of_counts(
                *next(ensemble.counted()), taken=taken, mirror=mirror
            ).l1_error
            record.target = ensemble.samples * (error / setup.tol) ** 2
            ends |= error <= setup.tol
        whole = ensemble.samples / (record.target or inf) if limited else record.chunks / CHUNKS
        done = max(whole, record.elapsed / setup.seconds)
        progress(min(CHUNKS, int(CHUNKS * done)), CHUNKS, "simulation")
        if ends:
            return
        if limited and len(record.ends) == 2 * CHUNKS:  # join chunks in pairs
            record.ends, record.chunk_samples = record.ends[1::2], 2 * record.chunk_samples


def _result(setup: Setup, record: Record, partial: bool, cut: str) -> Result:
    """Return the result from ``record``: densities, moment identities and the report.

    ``cut``: words on where the burn-in ended early, else empty; ``partial``: Ctrl-C was pressed.
    If the system has mirror symmetry, mirror images of samples count as samples.
    """
    ensemble, kT, failures = record.ensemble, temperature(setup.system), list[str]()
    paths, threads, samples = ensemble.paths, ensemble.threads, ensemble.samples
    taken, burnt = samples * setup.stride, ensemble.done - ensemble.phase
    burn_in, diagnosed = min(setup.burn_in_steps, burnt) * setup.dt, None
    planned = f" of {CHUNKS}" if setup.seconds == inf else ""
    interrupted = f"partial: interrupted {cut or f'after {record.chunks}{planned} chunks'}"
    if partial:
        failures.append(interrupted)
    elif not record.chunks:
        where = cut or "in its first chunk, before any drift"
        failures.append(f"the limit of {setup.seconds:g} s came {where}; give it more time")
    whole = not failures
    failures += setup.failures
    identities = diagnostics.moment_identities(setup.system, ensemble.batch_means())
    # Without a whole chunk contacts may be so rare that standard errors are too small.
    checked = identities if record.chunks and burnt >= setup.burn_in_steps else ()
    failures += [
        f"{i.name} is off by {i.z:.1f} standard errors; use a smaller dt"
        for i in checked
        if abs(i.value - i.expected) > LARGEST_Z * i.error + STEP_BIAS * (i.expected or kT)
    ]
    if whole:
        diagnosed = diagnostics.diagnosis(
            record.effective(), record.names, record.means(),
            time=samples * (ensemble.dt * setup.stride), paths=paths, burn_in=burn_in,
        )  # fmt: skip
        failures += diagnosed.failures
    densities = tuple(
        density_of_counts(
            histogram,
            counts,
            taken=paths * samples,
            mirror=effects_of(setup.system).mirror,
            residual=max((abs(i.z) for i in checked), default=nan),
            tol=setup.tol if m == 0 else inf,
            failures=failures,
        )
        for m, (histogram, counts) in enumerate(ensemble.counted())
    )
    ns = 1e9 * record.elapsed * threads / (paths * (ensemble.done - record.untimed))
    report = diagnostics.Report(
        dt=setup.dt / setup.scheme.small,
        paths=paths,
        time=taken * setup.dt,
        burn_in=burn_in,
        relaxation_time=relaxation_time(setup.system),
        scheme=setup.scheme.name,
        steps=taken,
        stride=setup.stride,
        batches=ensemble.edges.size - 1,
        seed=ensemble.seed,
        threads=threads,
        kT=kT,
        long_step=setup.dt,
        ns_per_particle_step=ns,
        small_steps=setup.division,
        limited_by=setup.limited_by,
        diagnosis=diagnosed,
        moments=record.moments(),
        interrupted=interrupted if partial else "",
    )
    method: Any = setup.method  # a ``MonteCarlo``
    return Result(method, densities, identities=identities, partial=partial, report=report)
