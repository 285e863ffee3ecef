"""Transient densities of the full system (6): an ensemble from the start, at given times."""

from collections.abc import Iterator, Sequence
from math import ceil, inf

import numpy as np

from fpk.arrays import Array, Integers
from fpk.certificate import Measured, certify
from fpk.effects import effects_of
from fpk.errors import InvalidInput
from fpk.evolution import Transient
from fpk.method import Progress
from fpk.observable import Observable
from fpk.sampled_density import SampledDensity
from fpk.start import Start
from fpk.system import System
from sim.arrays import LANES, MAX_TRAJECTORIES
from sim.histogram import BINS, MARGIN, Histogram, sampled_density, values_of
from sim.montecarlo import MonteCarlo
from sim.motion.limits import largest_energy
from sim.motion.motion import Motion, in_rows, needs_steps
from sim.motion.starts import Origin
from sim.motion.stationary import interruption, lost_words, not_met, working
from sim.motion.steps import motion_step, require_times
from sim.random import OTHER_SEED
from sim.step_size import REACHED, temperature
from sim.workers import Workers

GROUPS = 64
"""Independent batches of trajectories, from which errors are taken."""

ROUNDS = 8
"""Rounds of ``paths`` trajectories where neither an error nor a time is wanted."""

CHUNK = 512
"""Steps at most from one sample to the next, so that Ctrl-C comes through."""


def transient(
    method: MonteCarlo,
    system: System,
    observable: Observable,
    start: Start,
    times: Array,
    at: tuple[Array, ...],
    *,
    tol: float | None,
    progress: Progress,
) -> Transient:
    """Return the densities of ``observable`` at ``times`` by histograms, with one standard error.

    In the error is, in quadrature, what changes at the step dt instead of dt/2, by the same random
    numbers, and on bins twice as wide. ``tol`` is the expected L1 error wanted at every time.
    """
    require_times(times)
    wanted = tol if tol is not None else method.tol
    energy = largest_energy(system, start) + REACHED * temperature(system)
    dt = motion_step(method, system, energy=energy, error=wanted)
    mirror = effects_of(system).mirror and (start.kind != "state" or start.rest)
    paths = -(-method.paths // LANES) * LANES
    counted = Counted(system, observable, mirror, len(times))
    with working(method, system, wanted, start) as (workers, watch, origin):
        for number in range(MAX_TRAJECTORIES // paths):
            rows = ensembles(origin, times, paths, number, dt, workers)
            for k, (fine, coarse) in enumerate(rows):
                counted.add(k, times[k], fine, coarse)
                done = ROUNDS * len(times)
                progress(min(done, number * len(times) + k + 1), done, "transient")
            error = inf if wanted is None else max(d.l1_error for d in counted.densities())
            enough = number + 1 >= ROUNDS or wanted is not None
            if watch.ends() or (enough and not not_met(method, wanted, error)):
                break
        words = interruption(watch)
    return _answer(counted, times, at, dt, method, words, inf if wanted is None else wanted)


def ensembles(
    origin: Origin, times: Array, paths: int, number: int, dt: float, workers: Workers
) -> Iterator[tuple[Array, Array | None]]:
    """Yield the states (paths, 2n) at each time, at steps of dt/2 and of ``dt``.

    The second is None where the step has no error: it is then as long as the time.
    """
    system, seed = origin.system, (origin.seed + number * OTHER_SEED) % 2**64
    stepped = needs_steps(system)
    q, p = origin.drawn(paths, number)
    states = [np.hstack([q, p]) for _ in range(2 if stepped else 1)]
    words, now = [0, 0], 0.0
    for time in times:
        if time > now:
            steps = ceil((time - now) / dt) if stepped else 1
            parts = ceil(steps / CHUNK)
            stride = ceil(steps / parts)
            long = (time - now) / (parts * stride)
            for k, (halved, many) in enumerate(((False, 2), (True, 1))[: len(states)]):
                q, p = np.split(states[k], 2, axis=1)
                motion = Motion(
                    system, q, p, long / (many if stepped else 1), seed, halved=halved,
                    stride=stride * (many if stepped else 1), word=words[k], workers=workers,
                )  # fmt: skip
                for _ in range(parts):
                    motion.advance(1)
                states[k], words[k] = in_rows(motion.last)[:, : 2 * system.n], motion.next_word
        now = float(time)
        yield states[0], states[1] if stepped else None


class Counted:
    """Histograms of one observable at several times, their ranges from the first round."""

    def __init__(self, system: System, observable: Observable, mirror: bool, times: int) -> None:
        """Begin with none."""
        self.system, self.observable, self.mirror = system, observable, mirror
        self.histograms: list[Histogram] = []
        self.counts: list[Integers] = []  # of each time: (2, GROUPS, bins + 1)
        self.paths, self.lost = [0] * times, 0
        self.stepped = False

    def add(self, k: int, time: float, fine: Array, coarse: Array | None) -> None:
        """Count the states (paths, 2n) of time number ``k``."""
        self.stepped = coarse is not None
        for which, states in enumerate((fine,) if coarse is None else (fine, coarse)):
            q, p = np.split(states, 2, axis=1)
            columns = [values_of(self.system, c, q, p) for c in self.observable]
            if k == len(self.histograms):
                self.histograms.append(self._covering(columns, time))
                self.counts.append(np.zeros((2, GROUPS, self.histograms[k].size + 1), np.int64))
            histogram, group = self.histograms[k], np.arange(len(states)) % GROUPS
            bins = np.zeros(len(states), dtype=np.int64)
            inside = np.ones(len(states), dtype=bool)
            for x, e, many in zip(columns, histogram.edges, histogram.shape, strict=True):
                place = (x - e[0]) * (many / (e[-1] - e[0]))
                inside &= (place >= 0.0) & (place < many)
                bins = bins * many + np.where(inside, place, 0.0).astype(np.int64)
            index = group * (histogram.size + 1) + np.where(inside, bins, histogram.size)
            counts = np.bincount(index, minlength=GROUPS * (histogram.size + 1))
            self.counts[k][which] += counts.reshape(GROUPS, -1)
            self.lost += int(np.count_nonzero(~np.isfinite(states).all(axis=1)))
        self.paths[k] += len(fine)

    def densities(self, which: int = 0) -> list[SampledDensity]:
        """Return the densities at all times, of the finer simulation or the coarser one (1)."""
        return [
            sampled_density(
                histogram, counts[which], taken=paths, mirror=self.mirror, system=self.system
            )
            for histogram, counts, paths in zip(
                self.histograms, self.counts, self.paths, strict=True
            )
        ]

    def _covering(self, columns: Sequence[Array], time: float) -> Histogram:
        edges = []
        for c, x in zip(self.observable, columns, strict=True):
            x = x[np.isfinite(x)]
            low, high = (float(x.min()), float(x.max())) if x.size else (0.0, 1.0)
            if not high - low > 1e-9 * max(abs(low), abs(high)):
                words = f"{c} is one value at t = {time:g}, and has no density; ask for later times"
                raise InvalidInput("times", time, words)
            reach = MARGIN * (high - low)
            low, high = low - reach, high + reach
            if c.kind == "H":
                low = max(low, 0.0)
            elif self.mirror:
                high = max(-low, high)
                low = -high
            edges.append(np.linspace(low, high, BINS[len(self.observable) - 1] + 1))
        return Histogram(self.observable, tuple(edges))


def _answer(
    counted: Counted, times: Array, at: tuple[Array, ...], dt: float, method: MonteCarlo,
    failures: list[str], tol: float,
) -> Transient:  # fmt: skip
    fine = counted.densities()
    coarse = counted.densities(1) if counted.stepped else fine
    values, errors, bias = [], [], 0.0
    for a, b in zip(fine, coarse, strict=True):
        value, error = a.at(*at)
        wider = a.joined(2).at(*at)[0]
        step = b.at(*at)[0] - value
        values.append(value)
        errors.append(np.sqrt(error**2 + (wider - value) ** 2 + step**2))
        bias = max(bias, float(np.max(np.abs(step), initial=0.0)))
    failures += lost_words(counted.lost, dt)
    certificates = [density.certificate for density in fine]
    failures += dict.fromkeys(words for c in certificates for words in c.failures)
    measured = Measured(
        l1_error=max(density.l1_error for density in fine),
        mass_defect=max(c.mass_defect for c in certificates),
        minimum=min(c.minimum for c in certificates),
        residual=max(c.residual for c in certificates),
        tail_mass=max(c.tail_mass for c in certificates),
        failures=tuple(failures),
    )
    settings: dict[str, str | float | int] = {
        "trajectories": min(counted.paths),
        "seed": method.seed,
        "scheme": method.scheme,
        "expected L1 error": measured.l1_error,
    }
    if counted.stepped:
        settings |= {"dt": 0.5 * dt, "coarse dt": dt, "largest difference of both": bias}
    certificate = certify(measured, tol=tol, sampled=True)
    return Transient(times, np.array(values), np.array(errors), "sampling", certificate, settings)
