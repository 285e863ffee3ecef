"""Means at the end of every chunk of a simulation, from which the sample is diagnosed."""

from collections.abc import Sequence
from dataclasses import dataclass, field, fields
from math import inf, nan
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fpk.arrays import Array, Integers
from sim.arrays import LANES
from sim.diagnostics import Effective, effective_of_paths, effective_of_shares, variance_error
from sim.histogram import Histogram, starts
from sim.report import Moment
from sim.statistics import Product

SNAPSHOTS = (0, 5, 10, 15)
"""Chunks at whose beginning a single sample of every trajectory shows the variance of the squares:
σ² of 8192 trajectories to 2 % each, the error of var(path means) being about the same."""

LEVELS = 8
"""A density is watched by its shares below the octiles of a coordinate, of |x| with a mirror."""


@dataclass(eq=False)
class Record:
    """Cumulative sums of every batch at the ends of chunks of ``chunk_samples`` samples.

    Quantities are the squares of q and v among the ``products`` of ``masses`` (n,) and the shares
    of samples below the octiles of every coordinate in the first chunk, bins ``cuts`` of its axis.
    ``stepping`` of the ``elapsed`` seconds were spent on samples; at ``target`` samples the
    ``error`` of the first density is computed again.
    """

    histograms: Sequence[Histogram]
    products: Sequence[Product]
    masses: Array
    mirror: bool
    chunk_samples: int = 0
    chunks: int = 0
    stepping: float = 0.0
    elapsed: float = 0.0
    error: float = inf
    target: float = 0.0
    cuts: list[Any] = field(default_factory=list)  # pairs of an axis and a bin
    ends: list[Array] = field(default_factory=list)  # each (batches, quantities)
    variances: list[Array] = field(default_factory=list)  # σ² of the squares, one a snapshot
    errors: list[Array] = field(default_factory=list)  # of these, relative

    def __post_init__(self) -> None:
        """Name, product number and factor of every q_i² and v_i²; label and fold of every axis."""
        masses = self.masses.tolist() if self.products else []
        asked = [(f"q{i}²", ("q", i - 1, "q", i - 1), 1.0) for i, _ in enumerate(masses, 1)]
        asked += [(f"v{i}²", ("p", i - 1, "p", i - 1), 1.0 / m**2) for i, m in enumerate(masses, 1)]
        self.squares = [(name, self.products.index(p), factor) for name, p, factor in asked]
        coordinates = [c for histogram in self.histograms for c in histogram.observable]
        self.folds = [self.mirror and c.kind != "H" for c in coordinates]
        self.axes = [
            f"the distribution of |{c}|" if fold else f"the distribution of {c}"
            for c, fold in zip(coordinates, self.folds, strict=True)
        ]

    @property
    def names(self) -> list[str]:
        """Names of the quantities, in the order of the columns of ``ends``."""
        return [name for name, _, _ in self.squares] + [self.axes[axis] for axis, _ in self.cuts]

    def snapshot(self, before: Array, after: Array, live: Integers) -> None:
        """Note the variance of one sample, the difference of two ``sums`` of an ensemble."""
        samples = self._of_paths(after - before, live)
        self.variances.append(samples.var(axis=1, ddof=1))
        self.errors.append(variance_error(samples))

    def chunk_ends(self, ensemble: Any) -> None:
        """Note where the sums and counts of ``ensemble`` stand at the end of a chunk."""
        below = [np.cumsum(m, axis=1) for m in self._marginals(ensemble.counts)]
        if not self.ends:
            self.chunk_samples = ensemble.samples
            self.cuts = [
                (axis, int(cut))
                for axis, share in enumerate(below)
                for cut in octiles(share.sum(axis=0))
            ]
        means, size = ensemble.batch_means(), ensemble.batch_paths()
        columns = [means[:, k] * (f * ensemble.samples) for _, k, f in self.squares]
        columns += [below[axis][:, cut] / size for axis, cut in self.cuts]
        self.ends.append(np.stack(columns, axis=1))

    def join_pairs(self) -> None:
        """Make one chunk of every two; their number must be even."""
        assert len(self.ends) % 2 == 0, "an odd number of chunks cannot be joined in pairs"
        self.ends, self.chunk_samples = self.ends[1::2], 2 * self.chunk_samples

    def means(self) -> Array:
        """Return the means of the chunks, (quantities, batches, chunks)."""
        ends = np.diff(np.array(self.ends), axis=0, prepend=0.0)
        return np.ascontiguousarray(ends.transpose(2, 1, 0) / self.chunk_samples)

    def effective(self, ensemble: Any) -> list[Effective]:
        """Return the effective samples of every quantity, squares first."""
        effective: list[Effective] = []
        if self.variances:
            numbers = effective_of_paths(
                self._of_paths(ensemble.sums, ensemble.live) / ensemble.samples,
                np.mean(self.variances, axis=0),
                np.mean(self.errors, axis=0) / np.sqrt(len(self.errors)),
                whole=ensemble.paths,
            )
            names = [name for name, _, _ in self.squares]
            effective += map(Effective, names, *(number.tolist() for number in numbers))
        shares = self.ends[-1] / (self.chunk_samples * len(self.ends))
        for axis, name in enumerate(self.axes):
            columns = [len(self.squares) + k for k, cut in enumerate(self.cuts) if cut[0] == axis]
            if columns:
                effective.append(Effective(name, *effective_of_shares(shares[:, columns])))
        return effective

    def moments(self, ensemble: Any, effective: Sequence[Effective]) -> tuple[Moment, ...]:
        """Return E q_i² and E v_i², with errors from the means of single trajectories."""
        each = self._of_paths(ensemble.sums, ensemble.live) / ensemble.samples
        errors = np.sqrt(each.var(axis=1, ddof=1) / ensemble.paths)
        means = ensemble.batch_paths() @ ensemble.batch_means() / ensemble.paths
        samples = {e.name: e.samples for e in effective}
        return tuple(
            Moment(name, factor * float(means[k]), float(error), samples.get(name, nan))
            for (name, k, factor), error in zip(self.squares, errors, strict=True)
        )

    def saved(self) -> dict[str, NDArray[Any]]:
        """Return all that changes, as arrays: what ``restore`` needs."""
        return {f"record_{name}": np.array(getattr(self, name)) for name in self._changing()}

    def restore(self, saved: Any) -> None:
        """Go on from what ``saved`` returned."""
        for name in self._changing():
            setattr(self, name, type(getattr(self, name))(saved[f"record_{name}"]))

    def _changing(self) -> list[str]:
        """Names of the fields that begin with a default and change as samples come."""
        given = "histograms", "products", "masses", "mirror"
        return [f.name for f in fields(self) if f.name not in given]

    def _of_paths(self, sums: Array, live: Integers) -> Array:
        """Squares (squares, paths) of the trajectories from ``sums`` (blocks, products, LANES)."""
        rows = np.stack([f * sums[:, k] for _, k, f in self.squares])
        return np.asarray(rows[:, np.arange(LANES) < live[: sums.shape[0], None]])

    def _marginals(self, counts: Integers) -> list[Integers]:
        """Counts (batches, bins) of every coordinate, of |x| from the middle where folded."""
        first, folds, marginals = starts(self.histograms), iter(self.folds), []
        for m, histogram in enumerate(self.histograms):
            own = counts[:, first[m] : first[m + 1] - 1].reshape(-1, *histogram.shape)
            for axis, bins in enumerate(histogram.shape, start=1):
                marginal = own.sum(axis=tuple({1, own.ndim - 1} - {axis}))
                if next(folds):
                    marginal = marginal[:, bins // 2 :] + marginal[:, : bins // 2][:, ::-1]
                marginals.append(marginal)
        return marginals


def octiles(below: Integers) -> Integers:
    """Return the bins up to which 1/8, 2/8 ... of the samples lie, each once.

    ``below`` (bins,) is the number of samples up to the end of each bin.
    """
    cuts = np.unique(np.searchsorted(LEVELS * below, np.arange(1, LEVELS) * int(below[-1])))
    # A cut below which all samples lie says nothing.
    return np.asarray(cuts[(below[cuts] > 0) & (below[cuts] < below[-1])], dtype=np.int64)
