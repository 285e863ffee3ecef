"""Paths of averaged energies, their histograms and sampling errors."""

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from math import inf, nan

import numpy as np
from numpy.typing import NDArray

from fpk.density import SampledDensity
from fpk.errors import InvalidInput
from fpk.method import Progress, silent
from fpk.observable import Coordinate, Observable
from sim.averaged.square_root import SquareRootForm, square_root_step
from sim.histogram import Histogram, sampled_density

Array = NDArray[np.float64]

BATCHES = 64
"""Independent batches of paths, each with its own stream of random numbers."""
LEAST_PATHS = 4
"""Paths per batch at the least."""
PILOT_PATHS = 4096
MARGIN = 1.6
"""Range of a histogram over the largest energy of the pilot."""
BINS = (512, 64)
"""Bins of each axis of a histogram of one and of two energies."""


@dataclass(frozen=True)
class EnergySampling:
    """How averaged equations are simulated: steps of length ``dt``, or exact ones for infinity.

    ``paths`` in all are sampled every ``interval`` for ``time`` after ``burn_in``. Streams belong
    to batches of paths: the answer does not depend on ``threads``. A density whose expected L1
    error by chance exceeds ``tol`` is not certified.
    """

    dt: float
    time: float
    burn_in: float
    interval: float
    paths: int = 16384
    seed: int = 1
    threads: int = 1
    tol: float = inf

    def __post_init__(self) -> None:
        """Refuse what cannot be simulated."""
        for key in ("dt", "time", "interval"):
            if not getattr(self, key) > 0:
                raise InvalidInput(key, getattr(self, key), "must be > 0")
        if self.paths < BATCHES * LEAST_PATHS or self.paths % BATCHES:
            least = BATCHES * LEAST_PATHS
            raise InvalidInput("paths", self.paths, f"use a multiple of {BATCHES}, {least} or more")

    @property
    def inner(self) -> tuple[int, float]:
        """Steps from one sample to the next and their length, at most ``dt``."""
        count = 1 if self.dt == inf else int(np.ceil(self.interval / self.dt - 1e-9))
        return count, self.interval / count


def exact(form: SquareRootForm) -> bool:
    """Whether a step of any length is exact: nothing is split off, d and β are constants."""
    probe = np.ones((2, form.scales.size))
    constant = [f(probe * form.scales).shape[0] == 1 for f in (form.noise, form.slope)]
    return form.damping is None and all(constant)


def simulate_energies(
    form: SquareRootForm,
    observables: Sequence[Observable],
    sampling: EnergySampling,
    *,
    progress: Progress = silent,
) -> tuple[SampledDensity, ...]:
    """Return histogram densities of energies H_i, pairs of them and H = Σ H_i, with their errors.

    Ranges are those of a pilot with a stream of its own, and a margin; what falls outside is
    counted as such.
    """
    pilot = form.energies(_warm(form, sampling, PILOT_PATHS, _stream(sampling.seed, BATCHES)))
    histograms = [Histogram(o, tuple(_edges(pilot, c, BINS[len(o) - 1]) for c in o))
                  for o in observables]  # fmt: skip
    paths = sampling.paths // BATCHES
    samples = max(1, round(sampling.time / sampling.interval))
    counts = [np.zeros((BATCHES, h.size + 1), dtype=np.int64) for h in histograms]
    lost = np.zeros(BATCHES, dtype=bool)

    def batch(b: int) -> None:
        stream = _stream(sampling.seed, b)
        X = _warm(form, sampling, paths, stream)
        for _ in range(samples):
            X = _advanced(form, sampling, X, stream)
            H = form.energies(X)
            for count, histogram in zip(counts, histograms, strict=True):
                columns = [_column(H, c) for c in histogram.observable]
                inside = np.histogramdd(columns, bins=histogram.edges)[0]
                count[b, :-1] += inside.ravel().astype(np.int64)
        lost[b] = not np.isfinite(X).all()

    with ThreadPoolExecutor(sampling.threads) as pool:
        for done, _ in enumerate(pool.map(batch, range(BATCHES)), start=1):
            progress(done, BATCHES, "averaged simulation")
    provenance = {"dt": sampling.inner[1], "paths": sampling.paths, "seed": sampling.seed}
    densities = []
    for histogram, count in zip(histograms, counts, strict=True):
        count[:, -1] = paths * samples - count.sum(axis=1)
        density = sampled_density(
            histogram,
            count,
            taken=sampling.paths * samples,
            residual=nan,  # no identity of the averaged equations is evaluated
            tol=sampling.tol,
            failures=("an energy left the finite range",) if lost.any() else (),
        )
        values = density.batch_values.mean(axis=0)
        densities.append(replace(density, values=values, provenance=provenance))
    return tuple(densities)


def _stream(seed: int, batch: int) -> np.random.Generator:
    return np.random.Generator(np.random.Philox(key=np.array([seed, batch], dtype=np.uint64)))


def _advanced(
    form: SquareRootForm, sampling: EnergySampling, X: Array, stream: np.random.Generator
) -> Array:
    count, dt = sampling.inner
    for _ in range(count):
        X = square_root_step(form, X, dt, stream)
    return X


def _warm(
    form: SquareRootForm, sampling: EnergySampling, paths: int, stream: np.random.Generator
) -> Array:
    X = stream.exponential(form.scales, (paths, form.scales.size))
    for _ in range(int(np.ceil(sampling.burn_in / sampling.interval))):
        X = _advanced(form, sampling, X, stream)
    return X


def _column(H: Array, coordinate: Coordinate) -> Array:
    if coordinate.index is None:
        return np.asarray(H.sum(axis=1))
    return H[:, coordinate.index]


def _edges(H: Array, coordinate: Coordinate, bins: int) -> Array:
    return np.linspace(0.0, MARGIN * float(_column(H, coordinate).max()), bins + 1)
