"""What is written down between the chunks of a simulation, for its diagnosis afterwards."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sim.arrays import LANES
from sim.diagnostics import Effective, effective_of_paths, effective_of_shares, variance_error
from sim.ensemble import batch_sizes
from sim.histogram import Histogram, starts
from sim.statistics import Product

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

SNAPSHOTS = (0, 5, 10, 15)
"""Chunks at whose beginning a single sample of every trajectory shows the variance of the squares:
σ² of 8192 trajectories to 2 % each, the error of var(path means) being about the same."""

LEVELS = 8
"""A density is watched by its shares below the octiles of a coordinate, of |x| with a mirror."""


@dataclass(eq=False)
class Record:
    """Cumulative means of every batch at the ends of chunks of ``chunk_samples`` samples.

    Quantities are the squares of q and v among the ``products`` of ``masses`` (n,) and the shares
    of samples below ``cuts``, the octiles of every coordinate in the first chunk.
    """

    histograms: Sequence[Histogram]
    products: Sequence[Product]
    masses: Array
    mirror: bool
    chunk_samples: int = 0
    cuts: list[Integers] = field(default_factory=list)
    ends: list[Array] = field(default_factory=list)  # each (batches, quantities)
    variances: list[Array] = field(default_factory=list)  # σ² of the squares, one a snapshot
    errors: list[Array] = field(default_factory=list)  # of these, relative

    @property
    def squares(self) -> list[tuple[str, int, float]]:
        """Name, product number and factor of every q_i² and v_i²."""
        n = self.masses.size
        asked = [(f"q{i + 1}²", ("q", i, "q", i), 1.0) for i in range(n)] + [
            (f"v{i + 1}²", ("p", i, "p", i), 1.0 / float(self.masses[i]) ** 2) for i in range(n)
        ]
        return [(name, self.products.index(p), f) for name, p, f in asked if p in self.products]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the quantities, in the order of the columns of ``ends``."""
        names = [name for name, _, _ in self.squares]
        for (label, _), cuts in zip(self._axes(), self.cuts, strict=True):
            names += [f"the distribution of {label}"] * cuts.size
        return tuple(names)

    def snapshot(self, before: Array, after: Array, live: Integers) -> None:
        """Note the variance of one sample: the difference of two ``sums`` of an ensemble.

        They cover the trajectories that have sums of their own.
        """
        samples = self._of_paths(after - before, live)
        self.variances.append(samples.var(axis=1, ddof=1))
        self.errors.append(variance_error(samples))

    def chunk_ends(self, ensemble: Any) -> None:
        """Note where the sums and counts of ``ensemble`` stand at the end of a chunk."""
        if not self.ends:
            self.chunk_samples = ensemble.samples
        means = ensemble.batch_means()
        columns = [means[:, k] * (f * ensemble.samples) for _, k, f in self.squares]
        size = batch_sizes(ensemble.edges, ensemble.paths)
        marginals = self._marginals(ensemble)
        if not self.cuts:
            self.cuts = [octiles(m.sum(axis=0)) for m in marginals]
        below = [
            np.cumsum(m, axis=1)[:, cuts] / size[:, None]
            for m, cuts in zip(marginals, self.cuts, strict=True)
        ]
        self.ends.append(np.hstack([*(c[:, None] for c in columns), *below]))

    def join_pairs(self) -> None:
        """Make one chunk of every two; their number must be even."""
        assert len(self.ends) % 2 == 0, "an odd number of chunks cannot be joined in pairs"
        self.ends, self.chunk_samples = self.ends[1::2], 2 * self.chunk_samples

    def means(self) -> Array:
        """Return the means of the chunks, (quantities, batches, chunks)."""
        ends = np.array([np.zeros_like(self.ends[0]), *self.ends])
        return np.ascontiguousarray(np.diff(ends, axis=0).transpose(2, 1, 0) / self.chunk_samples)

    def effective(self, ensemble: Any, interval: float) -> tuple[Effective, ...]:
        """Return the effective samples of every quantity; samples are ``interval`` apart.

        Of an interrupted chunk the squares are in, the distributions are not: both are means.
        """
        if not self.ends:
            return ()
        time = ensemble.samples * interval
        effective: list[Effective] = []
        if self.variances:
            means = self.path_means(ensemble)
            effective += effective_of_paths(
                [name for name, _, _ in self.squares],
                means,
                np.mean(self.variances, axis=0),
                np.mean(self.errors, axis=0) / np.sqrt(len(self.errors)),
                time=time,
                whole=ensemble.paths,
            )
        recorded = self.chunk_samples * len(self.ends)
        shares, column = self.ends[-1] / recorded, len(self.squares)
        for (label, _), cuts in zip(self._axes(), self.cuts, strict=True):
            part = shares[:, column : column + cuts.size]
            column += cuts.size
            if cuts.size:
                name = f"the distribution of {label}"
                effective.append(
                    effective_of_shares(name, part, ensemble.paths * recorded * interval)
                )
        return tuple(effective)

    def path_means(self, ensemble: Any) -> Array:
        """Return the means (squares, paths) of the squares over each trajectory that has its own.

        Those are the trajectories of the first blocks; see ``sim.ensemble.APART``.
        """
        means: Array = self._of_paths(ensemble.sums, ensemble.live) / ensemble.samples
        return means

    def saved(self) -> dict[str, NDArray[Any]]:
        """Return all that changes, as arrays: what ``restore`` needs."""
        cuts = np.concatenate([np.array([c.size, *c]) for c in self.cuts] or [np.zeros(0, int)])
        return {
            "record_ends": np.array(self.ends),
            "record_cuts": cuts.astype(np.int64),
            "record_variances": np.array(self.variances).reshape(
                len(self.variances), len(self.squares)
            ),
            "record_errors": np.array(self.errors).reshape(len(self.errors), len(self.squares)),
            "record_samples": np.array(self.chunk_samples),
        }

    def restore(self, saved: Any) -> None:
        """Go on from what ``saved`` returned."""
        self.ends, self.cuts = list(saved["record_ends"]), []
        cuts = saved["record_cuts"]
        while cuts.size:
            self.cuts.append(cuts[1 : 1 + cuts[0]])
            cuts = cuts[1 + cuts[0] :]
        self.variances = list(saved["record_variances"])
        self.errors = list(saved["record_errors"])
        self.chunk_samples = int(saved["record_samples"])

    def _of_paths(self, sums: Array, live: Integers) -> Array:
        """Squares (squares, paths) of the trajectories from ``sums`` (blocks, products, LANES)."""
        rows = np.stack([f * sums[:, k] for _, k, f in self.squares])
        return np.asarray(rows[:, np.arange(LANES) < live[: sums.shape[0], None]])

    def _axes(self) -> list[tuple[str, bool]]:
        """Label of every coordinate observed, and whether the octiles of |x| are meant."""
        axes = []
        for histogram in self.histograms:
            for c in histogram.observable:
                folded = self.mirror and c.kind != "H"
                axes.append((f"|{c}|" if folded else str(c), folded))
        return axes

    def _marginals(self, ensemble: Any) -> list[Integers]:
        """Counts (batches, bins) of every coordinate, of |x| from the middle where folded."""
        first, marginals = starts(self.histograms), []
        folded = iter(self._axes())
        for m, histogram in enumerate(self.histograms):
            shape = [e.size - 1 for e in histogram.edges]
            counts = ensemble.counted(first[m], first[m + 1])[:, :-1].reshape(-1, *shape)
            for axis, bins in enumerate(shape):
                others = tuple(1 + a for a in range(len(shape)) if a != axis)
                marginal = counts.sum(axis=others) if others else counts
                if next(folded)[1]:
                    marginal = marginal[:, bins // 2 :] + marginal[:, : bins // 2][:, ::-1]
                marginals.append(marginal)
        return marginals


def octiles(counts: Integers) -> Integers:
    """Return the bins up to which 1/8, 2/8 ... of ``counts`` (bins,) lie, each once."""
    below = np.cumsum(counts)
    wanted = np.arange(1, LEVELS) * int(below[-1])
    cuts = np.unique(np.searchsorted(LEVELS * below, wanted))
    # A cut below which all samples lie says nothing.
    return np.asarray(cuts[(below[cuts] > 0) & (below[cuts] < below[-1])], dtype=np.int64)
