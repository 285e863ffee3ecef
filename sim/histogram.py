"""Histograms: ranges and bins, the rows of the kernel that they count, and their densities."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import inf, nan

import numpy as np
from numpy.typing import NDArray

from fpk.certificate import Measured, certify
from fpk.density import SampledDensity
from fpk.modes import natural_modes
from fpk.observable import Coordinate, Observable
from fpk.system import System
from sim.arrays import StepArrays, WatchArrays, workspace
from sim.scheme import Scheme
from sim.statistics import Product, sampling_error

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

BINS = (1024, 128)
"""Bins of each axis of a histogram of one and of two coordinates."""

MARGIN = 0.3
"""Share of the pilot's range that is added beyond its extremes."""

LARGEST_TAIL = 1e-3
"""Share of samples outside a histogram above which its density is not certified."""


@dataclass(frozen=True, eq=False)
class Histogram:
    """Bins of one observable: equidistant edges of each axis."""

    observable: Observable
    edges: tuple[Array, ...]

    @property
    def size(self) -> int:
        """Number of bins, without that for outside."""
        return int(np.prod([e.size - 1 for e in self.edges]))


def pilot_coordinate(system: System, coordinate: Coordinate, q: Array, p: Array) -> Array:
    """Return one coordinate of states ``q``, ``p`` (samples, n), uncorrected for the step.

    H_m is the energy of a mode of the springs alone: nothing of a contact is in it.
    """
    if coordinate.kind == "H" and coordinate.index is not None:
        shapes, frequency = natural_modes(system)
        shape, omega = shapes[:, coordinate.index], frequency[coordinate.index]
        momentum, displacement = p @ shape, q @ (system.mass * shape)
        energy: Array = 0.5 * (momentum**2 + (omega * displacement) ** 2)
        return energy
    if coordinate.kind == "H":
        return system.hamiltonian(q, p)
    return (q if coordinate.kind == "q" else p)[:, coordinate.index]


def extremes(system: System, observables: Sequence[Observable], q: Array, p: Array) -> Array:
    """Return the least and the largest finite value of each coordinate, (coordinates, 2).

    Where there is none, infinity and minus infinity: extremes of several sets of states are those
    of all together.
    """
    # One layout: sums over the masses may round by it.
    q, p = np.ascontiguousarray(q), np.ascontiguousarray(p)
    ranges = []
    for coordinate in (c for observable in observables for c in observable):
        with np.errstate(over="ignore", invalid="ignore"):
            x = pilot_coordinate(system, coordinate, q, p)
        x = x[np.isfinite(x)]
        ranges.append((x.min(initial=np.inf), x.max(initial=-np.inf)))
    return np.array(ranges).reshape(-1, 2)


def covering(
    observables: Sequence[Observable], reached: Array, *, mirror: bool
) -> tuple[Histogram, ...]:
    """Return histograms that cover the ``extremes`` with a margin; energies start at 0."""
    histograms, pairs = [], iter(reached.tolist())
    for observable in observables:
        edges = []
        for coordinate in observable:
            low, high = next(pairs)
            if low > high:
                low, high = -1.0, 1.0
            if coordinate.kind == "H":
                low, high = 0.0, (1.0 + 2.0 * MARGIN) * high
            elif mirror:
                high = (1.0 + 2.0 * MARGIN) * max(-low, high)
                low = -high
            else:
                reach = MARGIN * (high - low)
                low, high = low - reach, high + reach
            edges.append(np.linspace(low, high, BINS[len(observable) - 1] + 1))
        histograms.append(Histogram(observable, tuple(edges)))
    return tuple(histograms)


def watch_arrays(
    system: System,
    scheme: Scheme,
    step: StepArrays,
    histograms: Sequence[Histogram],
    products: Sequence[Product],
) -> WatchArrays:
    """Return what the kernel reads to observe: processor, histograms, products of moments."""
    n, slots = system.n, step.slot_mass.size
    modes = modes_of(histograms)
    at = workspace(n, slots, step.matrix.shape[1], modes=len(modes), terms=step.terms is not None)
    kinds = {"q": at.q, "p": at.p, "f": at.force, "d": at.damping}
    shapes, frequency = natural_modes(system) if modes else (np.zeros((n, 0)), np.zeros(0))
    T = shapes.T[list(modes)]
    rows = np.full((len(histograms), 2), -1, dtype=np.int64)
    low, scale = np.zeros(rows.shape), np.ones(rows.shape)
    bins = np.ones(rows.shape, dtype=np.int64)
    for m, histogram in enumerate(histograms):
        for axis, (c, e) in enumerate(zip(histogram.observable, histogram.edges, strict=True)):
            if c.kind != "H":
                rows[m, axis] = kinds[c.kind] + (c.index or 0)
            else:
                rows[m, axis] = at.energy if c.index is None else at.modal + modes.index(c.index)
            low[m, axis], bins[m, axis] = e[0], e.size - 1
            scale[m, axis] = (e.size - 1) / (e[-1] - e[0])
    half = 0.5 * step.dt if scheme.symmetric else 0.0
    mass = system.mass[step.slot_mass]
    springs = half if scheme.springs_kicked else 0.0
    pairs = [(kinds[a] + i, kinds[b] + j) for a, i, b, j in products]
    return WatchArrays(
        half_kick=half,
        half_springs=springs * system.stiffness_matrix,
        term_shift=scheme.modified * step.dt**2,
        cross=scheme.modified * step.dt**2 * system.damping[:, step.slot_mass] / mass,
        mode_q=frequency[list(modes), None] * T * system.mass if modes else None,
        mode_p=np.ascontiguousarray(T) if modes else None,
        at=at,
        rows=rows,
        low=low,
        scale=scale,
        bins=bins,
        start=starts(histograms)[:-1],
        products=np.array(pairs, dtype=np.int64).reshape(-1, 2),
    )


def modes_of(histograms: Sequence[Histogram]) -> tuple[int, ...]:
    """Return the modes whose energies are observed, counted from 0, ascending."""
    coordinates = {c for h in histograms for c in h.observable if c.kind == "H"}
    return tuple(sorted(c.index for c in coordinates if c.index is not None))


def starts(histograms: Sequence[Histogram]) -> Integers:
    """Return the first counter of each histogram, and the number of all; one more for outside."""
    return np.cumsum([0] + [h.size + 1 for h in histograms], dtype=np.int64)


def mirrored(histogram: Histogram, counts: Integers) -> Integers:
    """Return ``counts`` (batches, bins + 1) plus the counts of the mirrored states, (−q, −p).

    Of a system with mirror symmetry both are samples of the same stationary state. Energies do not
    change sign; the edges of all else lie symmetrically about zero. The total doubles, and so does
    what lies outside; batch by batch the same, so that errors shrink by what is truly gained.
    """
    shape = (-1, *(e.size - 1 for e in histogram.edges))
    axes = tuple(a for a, c in enumerate(histogram.observable, start=1) if c.kind != "H")
    reflected = np.flip(counts[:, :-1].reshape(shape), axis=axes).reshape(counts.shape[0], -1)
    return np.hstack([counts[:, :-1] + reflected, 2 * counts[:, -1:]])


def sampled_density(
    histogram: Histogram,
    counts: Integers,
    *,
    taken: int,
    mirror: bool = False,
    residual: float = 0.0,
    tol: float = inf,
    failures: Sequence[str] = (),
) -> SampledDensity:
    """Return the density of ``counts`` (batches, bins + 1), certified; nothing is rescaled.

    ``taken`` is the number of samples that were taken; with ``mirror`` each counts as its mirror
    image, too. ``residual`` is the largest |z| of the moment identities, ``tol`` the tolerance of
    the expected L1 sampling error, and ``failures`` say what is wrong with the sample itself.
    """
    total = counts.sum(axis=0)
    tail, words = float(total[-1]) / max(1, taken), list(failures)
    if int(total.sum()) != taken:
        words.append(f"{int(total.sum())} samples were counted of {taken} taken")
    if tail > LARGEST_TAIL:
        words.append(f"{tail:.2g} of the samples lie outside the histogram")
    if mirror:
        counts = mirrored(histogram, counts)
    whole, samples = max(1, counts.sum()), np.maximum(1, counts.sum(axis=1, keepdims=True))
    shape = tuple(e.size - 1 for e in histogram.edges)
    area = float(np.prod([e[1] - e[0] for e in histogram.edges]))
    density = SampledDensity(
        histogram.observable,
        histogram.edges,
        (counts.sum(axis=0)[:-1] / (whole * area)).reshape(shape),
        (counts[:, :-1] / (samples * area)).reshape(-1, *shape),
        UNJUDGED,
        one_sample=1.0 / (whole * area),
    )
    measured = Measured(
        l1_error=sampling_error(density),
        mass_defect=abs(float(total.sum()) / max(1, taken) - 1.0),
        minimum=float(total[:-1].min()) / max(1, int(total[:-1].max())),
        residual=residual,
        tail_mass=tail,
        failures=tuple(words),
    )
    return replace(density, certificate=certify(measured, tol=tol, sampled=True))


UNJUDGED = certify(Measured(nan, nan, nan, nan, nan), tol=0.0)
"""Certificate of a density before it is judged: every check fails."""
