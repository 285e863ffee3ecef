"""Densities sampled on equidistant bins, with the standard error of what follows from them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from math import nan
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from fpk.arrays import Array, Integers
from fpk.certificate import Certificate, outside
from fpk.number import Number
from fpk.observable import Observable, observable_name
from fpk.quadrature import panel_rule
from fpk.quantities import Function, Quantities, beyond
from fpk.reconstruction import LogReference, local_fit, radius_of, windows

ErrorKind = Literal["numerical", "sampling"]

EPSILON = float(np.finfo(float).eps)
"""Share of its largest value that stands for a sample where a histogram does not know its own."""
BIN_POINTS = 4
"""Gauss points along a bin at which a function is averaged over it."""
POINTS_TOGETHER = 4096
"""Points whose weights of a histogram's bins are computed together: some 10 MB of them."""


@dataclass(frozen=True)
class SampledDensity(Quantities):
    """Histogram density of one or two coordinates with its sampling error.

    ``edges`` are the bin edges of every axis (equidistant), ``values`` the share of samples in each
    bin divided by its area, ``batch_values`` (batches, *bins) the same of each of the independent
    batches, so that any linear function of the bins has an honest standard error. Samples outside
    are counted in ``certificate.tail_mass``, never folded in. ``one_sample`` is the density that a
    single sample makes of its bin. ``l1_error`` is the expected ∫|p − p_exact| by chance of the
    density as ``at`` returns it, not a number where it was not computed. ``log_references`` has for
    each axis the ln of a function about as steep as the density, kinks at stops included (none: a
    constant one), see ``at``. ::

        sampled = MonteCarlo(paths=4096, relaxations=20.0)
        p = fpk.solve(system, ["q2"], methods=[sampled])["q2"]
        value, error = p.at(np.linspace(-1.0, 1.0, 21))
    """

    observable: Observable
    edges: tuple[Array, ...]
    values: Array
    batch_values: Array
    certificate: Certificate
    provenance: Mapping[str, str | float | int] = field(default_factory=dict)
    error_kind: ErrorKind = "sampling"
    one_sample: float = 0.0
    l1_error: float = nan
    log_references: tuple[LogReference, ...] = ()

    @property
    def name(self) -> str:
        """The observable's name, such as ``q2,p2``."""
        return observable_name(self.observable)

    def __repr__(self) -> str:
        """Return what the density is of, its samples and its bins in one line."""
        return described(self, f"{self.values.size} bins, {self.batch_values.shape[0]} batches")

    def __call__(self, *points: ArrayLike) -> Array:
        """Return the density at ``points``, one number or array per axis, as ``at`` does."""
        return self.at(*(np.asarray(x, dtype=float) for x in points))[0]

    tabulated = __call__

    @property
    def panels(self) -> tuple[Array, ...]:
        """The bin edges: between them the density is constant."""
        return self.edges

    def axes(self) -> tuple[Array, ...]:
        """Return ``edges``."""
        return self.edges

    def expectation(self, function: Function, *, kinks: Sequence[float] = ()) -> Number:
        """Return E f(X) and one standard error, the correction for the width of the bins included.

        Within a bin the samples count as evenly spread. With the bin width h that errs by
        (h²/12) ∫f′p′ along every axis, which is corrected for and counted as an error, too.
        """
        # Within a single bin the kinks matter less than the correction.
        rules = [panel_rule(e, BIN_POINTS) for e in self.edges]
        f = np.asarray(function(*np.meshgrid(*(x.ravel() for x, _ in rules), indexing="ij")))
        f = np.broadcast_to(f, tuple(x.size for x, _ in rules))
        cell = float(np.prod([e[1] - e[0] for e in self.edges]))
        for axis, (_, w) in enumerate(rules):
            shape = (*f.shape[:axis], w.shape[0], BIN_POINTS, *f.shape[axis + 1 :])
            f = np.tensordot(f.reshape(shape), w[0], axes=(axis + 1, 0))
        every = np.concatenate([self.values[None], self.batch_values])
        plain = np.tensordot(every, f, f.ndim)
        change = sum(
            np.tensordot(np.diff(every, axis=axis + 1), np.diff(f, axis=axis), f.ndim) / 12.0
            for axis in range(f.ndim)
        )
        total = plain + change
        chance = _standard_error(total[1:])
        # One visit more, at what was seen; where only what was not seen counts, there.
        seen = float(np.max(np.abs(f), initial=0.0, where=self.values > 0.0))
        far = beyond(function, self.edges, kinks)
        visit = self._one_visit * cell * (seen or float(np.max(np.abs(f))) or far)
        tail = outside(self.certificate) * far
        error = float(np.hypot(chance, visit) + np.abs(np.asarray(change).flat[0]) + tail)
        return Number(float(total[0]), error)

    def _probability(self, low: float, high: float) -> Number:
        """Return P(low < X <= high) and one standard error, at least that of one visit.

        Of a bin that is cut its share counts; by the slope there that errs by h²|p′|/8 at the most.
        """
        edges = self._axis()
        inside = np.diff(np.clip(edges, low, high))
        tail = outside(self.certificate) if low < edges[0] or high > edges[-1] else 0.0
        cut = (inside > 0.0) & (inside < (1.0 - 1e-12) * np.diff(edges))
        slope = np.abs(np.gradient(self.values))
        bias = float(np.sum(slope[cut] * inside[cut])) / 8.0
        chance = _standard_error(self.batch_values @ inside)
        return Number(
            float(self.values @ inside),
            float(np.hypot(chance, self._one_visit * (edges[1] - edges[0])) + bias + tail),
        )

    @property
    def _one_visit(self) -> float:
        """The density that one excursion makes of a bin."""
        return self.samples_per_visit * self.one_sample

    @property
    def standard_error(self) -> Array:
        """One standard error of each bin, from the spread of the independent batches."""
        return _standard_error(self.batch_values)

    def joined(self, most: int) -> "SampledDensity":
        """Return the histogram with up to ``most`` neighbouring bins joined along every axis.

        It is the largest such number that divides the bins of each.
        """
        shape = self.values.shape
        factor = max([1, *(k for k in range(2, most + 1) if not any(bins % k for bins in shape))])
        every = np.concatenate([self.values[None], self.batch_values])
        for axis, bins in enumerate(shape, start=1):
            split = (*every.shape[:axis], bins // factor, factor, *every.shape[axis + 1 :])
            every = every.reshape(split).mean(axis=axis + 1)
        return replace(
            self,
            edges=tuple(e[::factor] for e in self.edges),
            values=every[0],
            batch_values=every[1:],
            one_sample=self.one_sample / factor ** len(self.edges),
            l1_error=nan,
        )

    @cached_property
    def samples_per_visit(self) -> float:
        """How many samples come together: variance over mean of what a batch holds of a rare bin.

        Rare are bins, as wide as the radius of ``at``, that some batches visited and some did not:
        the samples of one excursion are correlated, and there only the excursions are independent.
        """
        if not self.one_sample > 0.0:
            return 1.0
        batches = self.batch_values.shape[0]
        joined = self.joined(radius_of(min(self.values.shape)))
        held = joined.batch_values.reshape(batches, -1) / (joined.one_sample * batches)
        visited = np.count_nonzero(held, axis=0)
        rare = held[:, (visited > 0) & (visited < batches)]
        if not rare.size:
            return 1.0
        return max(1.0, float(rare.var(axis=0, ddof=1).sum() / rare.mean(axis=0).sum()))

    def at(self, *points: Array) -> tuple[Array, Array]:
        """Return the density and one standard error at ``points``, one array per axis.

        By ``fpk.reconstruction`` along every axis: free of the width of the bins. The error is that
        of the same linear function of the bins, from the batches; where some batch has nothing in
        the window, at least that of Poisson's law of its visits. One visit more is always added:
        the variance of k visits is k, of which 0 may have been seen.
        Zero outside the bins.
        """
        arrays = np.broadcast_arrays(*(np.asarray(x, dtype=float) for x in points))
        flat_points = np.stack([x.ravel() for x in arrays])
        inside = np.ones(flat_points.shape[1], dtype=bool)
        for x, e in zip(flat_points, self.edges, strict=True):
            inside &= (x >= e[0]) & (x <= e[-1])
        one_visit = self._one_visit
        value, error = np.zeros(inside.size), np.full(inside.size, one_visit)
        within = np.flatnonzero(inside)
        for first in range(0, within.size, POINTS_TOGETHER):
            where = within[first : first + POINTS_TOGETHER]
            bins, weights, worth = self._weights(flat_points[:, where])
            value[where] = np.sum(weights * self.values.ravel()[bins], axis=1)
            batches = np.empty((len(self.batch_values), where.size))
            rare = np.zeros(where.size, dtype=bool)
            for k, batch in enumerate(self.batch_values):
                held = batch.ravel()[bins]
                batches[k] = np.sum(weights * held, axis=1)
                rare |= ~held.any(axis=1)
            chance = one_visit * worth**2 * self.values.ravel()[bins].sum(axis=1)
            variance = np.maximum(_standard_error(batches) ** 2, np.where(rare, chance, 0.0))
            error[where] = np.sqrt(variance + (one_visit * worth) ** 2)
        return value.reshape(arrays[0].shape), error.reshape(arrays[0].shape)

    def fitted(self, points: Array, every: Array) -> Array:
        """Return the densities (..., points) of other histograms (..., bins) by the same weights.

        Of one coordinate, at ``points`` within the bins: the linear function of the bins that
        ``at`` takes of ``values``.
        """
        bins, weights, _ = self._weights(points[None])
        rows: Array = np.array([np.sum(weights * row[bins], axis=1) for row in every])
        return rows

    def _weights(self, points: Array) -> tuple[Integers, Array, Array]:
        """Return bins, their weights (points, window), and what a sample in one is worth there.

        The bins of the window are counted along the flattened ``values``.
        """
        index = [windows(e, x) for e, x in zip(self.edges, points, strict=True)]
        bins = index[0]
        if len(index) == 2:
            bins = bins[:, :, None] * self.values.shape[1] + index[1][:, None, :]
        held = self.values.ravel()[bins] / (
            self.one_sample or EPSILON * self.values.max(initial=1.0)
        )
        references = self.log_references or (np.zeros_like,) * len(index)
        weights, shares = np.ones((points.shape[1], 1)), np.ones((points.shape[1], 1))
        for axis, (e, x) in enumerate(zip(self.edges, points, strict=True)):
            own = held if len(index) == 1 else held.sum(axis=2 - axis)
            along, expected = local_fit(e, x, index[axis], own, log_reference=references[axis])
            weights = (weights[:, :, None] * along[:, None, :]).reshape(len(weights), -1)
            shares = (shares[:, :, None] * expected[:, None, :]).reshape(len(shares), -1)
        worth = np.sqrt(np.sum(shares * weights**2, axis=1))
        # No less than its share in the mean of the window: far out the weights may vanish.
        return bins.reshape(weights.shape), weights, np.maximum(worth, 1.0 / weights.shape[1])


def described(density: Any, error: str) -> str:
    """Return what a density is of, its support, whether it is certified and its error, in words."""
    support = " x ".join(f"[{x[0]:.3g}, {x[-1]:.3g}]" for x in density.panels)
    certified = "certified" if density.certificate.certified else "not certified"
    return f"{type(density).__name__}({density.name} on {support}; {certified}, {error})"


def _standard_error(batch_values: Array) -> Array:
    spread: Array = np.std(batch_values, axis=0, ddof=1) / np.sqrt(batch_values.shape[0])
    return spread
