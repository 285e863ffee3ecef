"""Paths of averaged energies, their histograms and sampling errors."""

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from math import inf, nan

import numpy as np
from numpy.typing import NDArray

from fpk.certificate import Measured, certify
from fpk.density import SampledDensity
from fpk.errors import InvalidInput
from fpk.method import Progress, silent
from fpk.observable import Coordinate, Observable
from sim.averaged.square_root import SquareRootForm, square_root_step
from sim.histogram import UNJUDGED
from sim.statistics import sampling_error

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
            raise InvalidInput(
                "paths",
                self.paths,
                f"must be a multiple of {BATCHES}, {BATCHES * LEAST_PATHS} or more",
            )

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

    Ranges are those of a pilot, with a margin; what falls outside is counted as such.
    """
    edges = _edges(form, observables, sampling)
    counts = [np.zeros((BATCHES, *(e.size - 1 for e in axes))) for axes in edges]
    lost = np.zeros(BATCHES, dtype=bool)

    def batch(b: int) -> int:
        stream = _stream(sampling.seed, b)
        X = _warm(form, sampling, sampling.paths // BATCHES, stream)
        for _ in range(_samples(sampling)):
            X = _advanced(form, sampling, X, stream)
            H = form.energies(X)
            for count, observable, axes in zip(counts, observables, edges, strict=True):
                columns = [_column(H, c) for c in observable]
                count[b] += np.histogramdd(columns, bins=axes)[0]
        lost[b] = not np.isfinite(X).all()
        return b

    with ThreadPoolExecutor(sampling.threads) as pool:
        for done, _ in enumerate(pool.map(batch, range(BATCHES)), start=1):
            progress(done, BATCHES, "averaged simulation")
    each = sampling.paths // BATCHES * _samples(sampling)
    failures = ("an energy left the finite range",) if lost.any() else ()
    return tuple(
        _density(o, axes, count, each, sampling, failures)
        for o, axes, count in zip(observables, edges, counts, strict=True)
    )


def _stream(seed: int, batch: int) -> np.random.Generator:
    return np.random.Generator(np.random.Philox(key=np.array([seed, batch], dtype=np.uint64)))


def _samples(sampling: EnergySampling) -> int:
    return max(1, round(sampling.time / sampling.interval))


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


def _edges(
    form: SquareRootForm, observables: Sequence[Observable], sampling: EnergySampling
) -> list[tuple[Array, ...]]:
    """Bins of each observable, from a pilot with a stream of its own."""
    H = form.energies(_warm(form, sampling, PILOT_PATHS, _stream(sampling.seed, BATCHES)))
    return [
        tuple(
            np.linspace(0.0, MARGIN * float(_column(H, c).max()), BINS[len(o) - 1] + 1) for c in o
        )
        for o in observables
    ]


def _density(
    observable: Observable,
    edges: tuple[Array, ...],
    counts: Array,
    each: int,
    sampling: EnergySampling,
    failures: tuple[str, ...],
) -> SampledDensity:
    area = float(np.prod([e[1] for e in edges]))
    batch_values = counts / (each * area)
    density = SampledDensity(
        observable,
        edges,
        batch_values.mean(axis=0),
        batch_values,
        UNJUDGED,
        {"dt": sampling.inner[1], "paths": sampling.paths, "seed": sampling.seed},
        one_sample=1.0 / (each * BATCHES * area),
    )
    values, outside = density.values, 1.0 - float(counts.sum()) / (each * BATCHES)
    measured = Measured(
        l1_error=sampling_error(density),
        mass_defect=abs(float(values.sum()) * area + outside - 1.0),
        minimum=float(values.min() / values.max()),
        residual=nan,  # no identity of the averaged equations is evaluated
        tail_mass=outside,
        failures=failures,
    )
    return replace(density, certificate=certify(measured, tol=sampling.tol, sampled=True))
