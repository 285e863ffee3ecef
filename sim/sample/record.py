"""Means at the end of every chunk of a simulation, from which the sample is diagnosed."""

from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fpk.answer.quantities import Number
from fpk.numeric.arrays import Array, Integers
from fpk.system.system import effects_of
from sim.sample.diagnostics import (
    Effective,
    effective_of_paths,
    effective_of_shares,
    variance_error,
)
from sim.sample.ensemble import Ensemble
from sim.step.arrays import LANES


@dataclass(eq=False)
class Record:
    """Cumulative sums of every batch of ``ensemble`` at the ends of chunks of ``chunk_samples``.

    Quantities are the squares of q and v, and the shares of samples below the octiles of every
    observed coordinate in the first chunk, bins ``cuts`` of its axis. Single samples of every
    trajectory show the variance of the squares: σ² of 8192 trajectories to 2 %, about as well as
    var(path means). ``stepping`` of the ``elapsed`` seconds were spent on samples; at ``target``
    samples the error of the first density is computed again.
    """

    ensemble: Ensemble
    chunk_samples: int = 0
    chunks: int = 0
    stepping: float = 0.0
    elapsed: float = 0.0
    target: float = 0.0
    cuts: list[Any] = field(default_factory=list)  # pairs of an axis and a bin
    ends: list[Array] = field(default_factory=list)  # each (batches, quantities)
    variances: list[Array] = field(default_factory=list)  # σ² of the squares, and relative errors

    def __post_init__(self) -> None:
        """Name, product number and factor of every q_i² and v_i²; label and fold of every axis."""
        system, products = self.ensemble.system, self.ensemble.products
        self.squares = [
            (f"{name}{i + 1}²", products.index((kind, i, kind, i)), 1.0 / m**power)
            for name, kind, power in (("q", "q", 0), ("v", "p", 2))
            for i, m in enumerate(system.mass.tolist())
        ]
        coordinates = [c for histogram in self.ensemble.histograms for c in histogram.observable]
        self.folds = [effects_of(system).mirror and c.kind != "H" for c in coordinates]
        names = (f"|{c}|" if f else c for c, f in zip(coordinates, self.folds, strict=True))
        self.axes = [f"the distribution of {name}" for name in names]

    @property
    def names(self) -> list[str]:
        """Names of the quantities, in the order of the columns of ``ends``."""
        return [name for name, _, _ in self.squares] + [self.axes[axis] for axis, _ in self.cuts]

    def snapshot(self, stride: int) -> None:
        """Take a sample by one step, and note its variance over the trajectories."""
        before = self.ensemble.sums.copy()
        self.ensemble.advance(1, stride=stride)
        samples = self._of_paths(self.ensemble.sums - before)
        self.variances.append(np.array([samples.var(axis=1, ddof=1), variance_error(samples)]))

    def chunk_ends(self) -> None:
        """Note where the sums and counts of the ensemble stand at the end of a chunk."""
        ensemble, below, folds = self.ensemble, list[Integers](), iter(self.folds)
        for histogram, counts in ensemble.counted():
            own = counts[:, :-1].reshape(-1, *histogram.shape)
            for axis, bins in enumerate(histogram.shape, start=1):
                marginal = own.sum(axis=tuple({1, own.ndim - 1} - {axis}))
                if next(folds):  # |x|, from the middle on
                    marginal = marginal[:, bins // 2 :] + marginal[:, : bins // 2][:, ::-1]
                below.append(np.cumsum(marginal, axis=1))
        if not self.ends:
            cuts = [octiles(share.sum(axis=0)).tolist() for share in below]
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

    def effective(self) -> list[Effective]:
        """Return the effective samples of every quantity, squares first."""
        effective: list[Effective] = []
        if self.variances:
            variance, error = np.mean(self.variances, axis=0)
            means = self._of_paths(self.ensemble.sums) / self.ensemble.samples
            found = effective_of_paths(means, variance, error / np.sqrt(len(self.variances)))
            effective += zip(self.names, *(x.tolist() for x in found), strict=False)
        shares = self.ends[-1] / (self.chunk_samples * len(self.ends))
        for axis, name in enumerate(self.axes):
            columns = [len(self.squares) + k for k, cut in enumerate(self.cuts) if cut[0] == axis]
            if columns:
                effective.append((name, *effective_of_shares(shares[:, columns])))
        return effective

    def moments(self) -> dict[str, Number]:
        """Return E q_i² and E v_i², with errors from the means of single trajectories."""
        ensemble = self.ensemble
        of_paths = self._of_paths(ensemble.sums) / ensemble.samples
        errors = np.sqrt(of_paths.var(axis=1, ddof=1) / ensemble.paths)
        means = ensemble.batch_paths() @ ensemble.batch_means() / ensemble.paths
        return {
            name: Number(factor * float(means[k]), float(error))
            for (name, k, factor), error in zip(self.squares, errors, strict=True)
        }

    def saved(self) -> dict[str, NDArray[Any]]:
        """Return all fields but the ensemble, as arrays: what ``restore`` needs."""
        return {f"record_{f.name}": np.array(getattr(self, f.name)) for f in fields(self)[1:]}

    def restore(self, saved: Any) -> None:
        """Go on from what ``saved`` returned."""
        for f in fields(self)[1:]:
            setattr(self, f.name, type(getattr(self, f.name))(saved[f"record_{f.name}"]))

    def _of_paths(self, sums: Array) -> Array:
        """Squares (squares, paths) of the trajectories from ``sums`` (blocks, products, LANES)."""
        rows = np.stack([f * sums[:, k] for _, k, f in self.squares])
        return np.asarray(rows[:, np.arange(LANES) < self.ensemble.live[:, None]])


def octiles(below: Integers) -> Integers:
    """Return the bins up to which 1/8, 2/8 … of the samples ``below`` (bins,) their ends lie."""
    cuts = np.unique(np.searchsorted(8 * below, np.arange(1, 8) * int(below[-1])))
    # A cut below which all samples lie says nothing.
    return np.asarray(cuts[(below[cuts] > 0) & (below[cuts] < below[-1])], dtype=np.int64)
