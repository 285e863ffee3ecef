"""Histograms: their ranges and bins, and the densities that follow from counts."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from math import inf, nan, pi, sqrt

import numpy as np

from fpk.arrays import Array, Integers
from fpk.certificate import Measured, certify
from fpk.linear import natural_modes
from fpk.observable import Coordinate, Observable
from fpk.reconstruction import radius_of
from fpk.sampled_density import SampledDensity
from fpk.system import System
from sim.step_size import temperature

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
    def shape(self) -> tuple[int, ...]:
        """Number of bins along each axis."""
        return tuple(e.size - 1 for e in self.edges)

    @property
    def size(self) -> int:
        """Number of bins, without that for outside."""
        return int(np.prod(self.shape))


def extremes(system: System, observables: Sequence[Observable], q: Array, p: Array) -> Array:
    """Return the least and the largest finite value of each coordinate, (coordinates, 2).

    Where there is none, infinity and minus infinity.
    """
    # One layout: sums over the masses may round by it.
    q, p = np.ascontiguousarray(q), np.ascontiguousarray(p)
    ranges = []
    for coordinate in (c for observable in observables for c in observable):
        with np.errstate(over="ignore", invalid="ignore"):
            x = values_of(system, coordinate, q, p)
        x = x[np.isfinite(x)]
        ranges.append((x.min(initial=np.inf), x.max(initial=-np.inf)))
    return np.array(ranges).reshape(-1, 2)


def values_of(system: System, coordinate: Coordinate, q: Array, p: Array) -> Array:
    """Return one coordinate of states ``q``, ``p`` (samples, n); H_m is that of a springs' mode."""
    if coordinate.kind == "H" and coordinate.index is not None:
        shapes, frequency = natural_modes(system)
        shape, omega = shapes[:, coordinate.index], frequency[coordinate.index]
        momentum, displacement = p @ shape, q @ (system.mass * shape)
        return np.asarray(0.5 * (momentum**2 + (omega * displacement) ** 2))
    if coordinate.kind == "H":
        return system.hamiltonian(q, p)
    return (q if coordinate.kind == "q" else p)[:, coordinate.index]


def covering(
    observables: Sequence[Observable],
    reached: Array,
    *,
    mirror: bool,
    bins: tuple[int, int] = BINS,
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
            edges.append(np.linspace(low, high, bins[len(observable) - 1] + 1))
        histograms.append(Histogram(observable, tuple(edges)))
    return tuple(histograms)


def starts(histograms: Sequence[Histogram]) -> Integers:
    """Return the first counter of each histogram, and the number of all; one more for outside."""
    return np.cumsum([0] + [h.size + 1 for h in histograms], dtype=np.int64)


def mirrored(histogram: Histogram, counts: Integers) -> Integers:
    """Return ``counts`` (batches, bins + 1) plus the counts of the mirrored states, (−q, −p).

    Of a system with mirror symmetry both are samples of the same stationary state. Energies do not
    change sign; the edges of all else lie symmetrically about zero.
    """
    axes = tuple(a for a, c in enumerate(histogram.observable, start=1) if c.kind != "H")
    reflected = np.flip(counts[:, :-1].reshape(-1, *histogram.shape), axis=axes)
    return np.hstack([counts[:, :-1] + reflected.reshape(len(counts), -1), 2 * counts[:, -1:]])


def contact_factor(system: System | None, coordinate: Coordinate, x: Array) -> Array:
    """Return −U_i(q)/kT, ln of the factor by which the stops shape p(q_i); 0 where there is none.

    Exact where Eq. (7) holds; otherwise of about the steepness, and with its kinks.
    """
    if system is None or coordinate.kind != "q" or coordinate.row not in system.contact_masses:
        return np.zeros_like(x)
    return -system.contact_energy(coordinate.row, x) / temperature(system)


def sampled_density(
    histogram: Histogram,
    counts: Integers,
    *,
    taken: int,
    mirror: bool = False,
    residual: float = 0.0,
    tol: float = inf,
    failures: Sequence[str] = (),
    system: System | None = None,
) -> SampledDensity:
    """Return the density of ``counts`` (batches, bins + 1) of ``taken`` samples, certified.

    With ``mirror`` each sample counts as its mirror image, too. ``residual`` is the largest |z| of
    the moment identities, ``tol`` the tolerance of the expected L1 sampling error, and ``failures``
    say what is wrong with the sample itself. ``system``: what has stops; None of averaged energies.
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
    area = float(np.prod([e[1] - e[0] for e in histogram.edges]))
    density = SampledDensity(
        histogram.observable,
        histogram.edges,
        (counts.sum(axis=0)[:-1] / (whole * area)).reshape(histogram.shape),
        (counts[:, :-1] / (samples * area)).reshape(-1, *histogram.shape),
        certify(Measured(nan, nan, nan, nan, nan), tol=0.0),  # until its error is known
        one_sample=1.0 / (whole * area),
        log_references=tuple(partial(contact_factor, system, c) for c in histogram.observable),
    )
    # On an axis of many bins, twice in the radius over which ``at`` averages.
    every = max(1, radius_of(histogram.size) // 2) if len(histogram.edges) == 1 else 1
    middles = (0.5 * (e[1:] + e[:-1])[every // 2 :: every] for e in histogram.edges)
    errors = density.at(*np.meshgrid(*middles, indexing="ij", sparse=True))[1]
    # √(2/π) standard errors: the expectation of |x| of a normal x.
    error = sqrt(2.0 / pi) * area * histogram.size * float(np.mean(errors))
    measured = Measured(
        l1_error=error,
        mass_defect=abs(float(total.sum()) / max(1, taken) - 1.0),
        minimum=float(total[:-1].min()) / max(1, int(total[:-1].max())),
        residual=residual,
        tail_mass=tail,
        failures=tuple(words),
    )
    certificate = certify(measured, tol=tol, sampled=True)
    return replace(density, l1_error=error, certificate=certificate)
