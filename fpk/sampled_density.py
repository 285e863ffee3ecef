"""Densities sampled in bins, with the standard error of what follows from them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, reduce
from math import nan
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from threadpoolctl import threadpool_limits

from fpk.arrays import Array
from fpk.bin_fit import Counts
from fpk.bins import NODES, BinAxis
from fpk.certificate import Certificate, outside
from fpk.fits import Fits, standard_error
from fpk.number import ErrorKind, Number
from fpk.observable import Observable, observable_name
from fpk.quadrature import panel_rule
from fpk.quantities import Function, Quantities, beyond

EPSILON = float(np.finfo(float).eps)
"""Share of the samples that stands for one where a histogram does not know how many there are."""
CELLS = 100
"""Joined bins of an axis from which the correlation of rare samples is taken."""


@dataclass(frozen=True)
class SampledDensity(Quantities):
    """Density of one or two coordinates from the contents of bins, with its sampling error.

    ``bins`` are those of every axis, with what is known of the density along it;
    ``values`` is the share of samples in each bin divided by its area, ``batch_values``
    (batches, *bins) the same of each of the independent batches. Samples outside are counted in
    ``certificate.tail_mass``, never folded in. ``samples`` is how many were counted, 0 where that
    is not known. ``l1_error`` is the expected ∫|p − p_exact| by chance of the density as ``at``
    returns it, not a number where it was not computed. ::

        sampled = MonteCarlo(paths=4096, relaxations=20.0)
        p = fpk.solve(system, ["q2"], methods=[sampled])["q2"]
        value, error = p.at(np.linspace(-1.0, 1.0, 21))
    """

    observable: Observable
    bins: tuple[BinAxis, ...]
    values: Array
    batch_values: Array
    certificate: Certificate
    provenance: Mapping[str, str | float | int] = field(default_factory=dict)
    error_kind: ErrorKind = "sampling"
    samples: float = 0.0
    l1_error: float = nan
    made: Fits | None = None

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
    def edges(self) -> tuple[Array, ...]:
        """The ascending bin edges of every axis."""
        return tuple(axis.edges for axis in self.bins)

    @property
    def panels(self) -> tuple[Array, ...]:
        """The bin edges."""
        return self.edges

    def axes(self) -> tuple[Array, ...]:
        """Return ``edges``."""
        return self.edges

    @cached_property
    def areas(self) -> Array:
        """Length or area of each bin."""
        return np.asarray(reduce(np.multiply.outer, map(np.diff, self.edges)))

    @property
    def standard_error(self) -> Array:
        """One standard error of each of ``values``, from the spread of the independent batches."""
        return standard_error(self.batch_values)

    def expectation(self, function: Function, *, kinks: Sequence[float] = ()) -> Number:
        """Return E f(X) and one standard error, by the spread of the independent batches.

        Within a bin samples are spread as the fitted density is.
        """
        x = [panel_rule(e, NODES)[0].ravel() for e in self.edges]
        f = np.asarray(function(*np.meshgrid(*x, indexing="ij")))
        within = self.fits.within
        f = np.broadcast_to(f, [a.size for a in x]).reshape(within.shape) * within
        f = f.sum(axis=tuple(range(1, f.ndim, 2)))  # the mean of f over each bin
        shares = self.batch_values * self.areas
        total = np.tensordot(self.values * self.areas, f, f.ndim)
        chance = standard_error(np.tensordot(shares, f, f.ndim))
        # One visit more, at what was seen; where only what was not seen counts, there.
        seen = float(np.max(np.abs(f), initial=0.0, where=self.values > 0.0))
        far = beyond(function, self.edges, kinks)
        visit = self.visit * (seen or float(np.max(np.abs(f))) or far)
        error = float(np.hypot(chance, visit) + outside(self.certificate) * far)
        return Number(float(total), error)

    def _probability(self, low: float, high: float) -> Number:
        """Return P(low < X <= high) and one standard error, at least that of one visit.

        Of a bin that is cut the share counts that the fitted density has there.
        """
        edges = self._axis()
        inside = np.clip(edges, low, high)
        whole = (np.diff(inside) == np.diff(edges)).astype(float)
        for k in np.flatnonzero((np.diff(inside) > 0.0) & (whole == 0.0)):
            ends = [edges[k], inside[k], inside[k + 1], edges[k + 1]]
            x, w = panel_rule(np.array(ends), NODES)
            value = self.at(x.ravel())[0].reshape(w.shape)
            before, within, after = (w * value).sum(axis=1)
            total = before + within + after
            whole[k] = within / total if total > 0.0 else (ends[2] - ends[1]) / (ends[3] - ends[0])
        inside = whole * np.diff(edges)
        tail = outside(self.certificate) if low < edges[0] or high > edges[-1] else 0.0
        chance = standard_error(self.batch_values @ inside)
        return Number(float(self.values @ inside), float(np.hypot(chance, self.visit) + tail))

    def joined(self, most: int) -> "SampledDensity":
        """Return the density with up to ``most`` neighbouring bins joined along every axis.

        It is the largest such number that divides the bins of each between its kinks.
        """
        cuts = [np.diff(axis.cuts) for axis in self.bins]
        factor = max(k for k in range(1, max(most, 1) + 1) if not np.any(np.concatenate(cuts) % k))
        every = np.concatenate([self.values[None], self.batch_values]) * self.areas
        for axis, bins in enumerate(self.values.shape, start=1):
            split = (*every.shape[:axis], bins // factor, factor, *every.shape[axis + 1 :])
            every = every.reshape(split).sum(axis=axis + 1)
        bins = tuple(replace(axis, edges=axis.edges[::factor]) for axis in self.bins)
        every = every / reduce(np.multiply.outer, (np.diff(axis.edges) for axis in bins))
        return replace(
            self, bins=bins, values=every[0], batch_values=every[1:], l1_error=nan, made=None
        )

    @cached_property
    def samples_per_visit(self) -> float:
        """How many samples come together: variance over mean of what a batch holds of a rare cell.

        Rare are cells, a hundredth of each axis, that some batches visited and some did not: the
        samples of one excursion are correlated, and there only the excursions are independent.
        """
        if not self.samples > 0.0:
            return 1.0
        few = self.joined(min(self.values.shape) // CELLS)
        batches = len(few.batch_values)
        held = (few.batch_values * few.areas).reshape(batches, -1) * (self.samples / batches)
        visited = np.count_nonzero(held, axis=0)
        rare = held[:, (visited > 0) & (visited < batches)]
        if not rare.size:
            return 1.0
        return max(1.0, float(rare.var(axis=0, ddof=1).sum() / rare.mean(axis=0).sum()))

    @property
    def visit(self) -> float:
        """Share of the samples that come together in one excursion."""
        return self.samples_per_visit / self.samples if self.samples > 0.0 else 0.0

    @cached_property
    def fits(self) -> Fits:
        """The fits of ln p on boxes of bins, ``made`` or else made now."""
        return self._fitted() if self.made is None else self.made

    def _fitted(self, *, halve: bool = True) -> Fits:
        """Fit ln p; ``halve`` as of ``Counts.boxes``.

        Of a pair the reference is the product of plain fits of each coordinate alone: a box has few
        coefficients where there are few samples, and none where p is large depends on it.
        """
        axes = self.bins
        if len(axes) == 2:
            alone = [self.alone(k)._fitted(halve=False).log_p for k in range(2)]
            pairs = zip(axes, alone, strict=True)
            axes = tuple(replace(axis, log_reference=log_r) for axis, log_r in pairs)
        shares, batches = self.values * self.areas, self.batch_values * self.areas
        counts = Counts(axes, shares, batches, 1.0 / (self.visit or EPSILON))
        with threadpool_limits(1, user_api="blas"):  # the matrices are small
            return Fits(axes, tuple(counts.boxes(halve=halve)), len(batches), self.visit)

    def alone(self, axis: int) -> "SampledDensity":
        """Return the density of one coordinate of a pair."""
        width = np.diff(self.edges[1 - axis])
        return replace(
            self,
            observable=(self.observable[axis],),
            bins=(self.bins[axis],),
            values=np.moveaxis(self.values, axis, 0) @ width,
            batch_values=np.moveaxis(self.batch_values, axis + 1, 1) @ width,
            l1_error=nan,
            made=None,
        )

    def at(self, *points: Array) -> tuple[Array, Array]:
        """Return the density and one standard error at ``points``, one array per axis.

        By the fits, see ``Fits.at``; 0 outside the bins.
        """
        arrays = np.broadcast_arrays(*(np.asarray(x, dtype=float) for x in points))
        value, error = self.fits.at(np.stack([x.ravel() for x in arrays]))
        return value.reshape(arrays[0].shape), error.reshape(arrays[0].shape)


def described(density: Any, error: str) -> str:
    """Return what a density is of, its support, whether it is certified and its error, in words."""
    support = " x ".join(f"[{x[0]:.3g}, {x[-1]:.3g}]" for x in density.panels)
    certified = "certified" if density.certificate.certified else "not certified"
    return f"{type(density).__name__}({density.name} on {support}; {certified}, {error})"
