"""Densities from samples in bins, evaluated by fits of ln p on boxes of bins, with their errors."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, reduce
from math import inf, nan

import numpy as np
from numpy.typing import ArrayLike
from threadpoolctl import threadpool_limits

from fpk.answer.bins import ALARM, BIN_POINTS, BinAxis, Box, Model, boxes
from fpk.answer.certificate import Certificate
from fpk.answer.names import Observable, require_one_array_an_axis
from fpk.answer.quantities import ErrorKind, Function, Number, Quantities, largest_in_tails
from fpk.numeric.arrays import (
    BLOCK_SIZE,
    EPS,
    LARGEST_LOG,
    ROUND_OFF,
    SMALLEST,
    Array,
    Flags,
    Integers,
)
from fpk.numeric.quadrature import panel_rule

Values = tuple[Array, Array]
"""Values and their standard errors."""
Fits = tuple[tuple[BinAxis, ...], tuple[Box, ...]]
"""Axes, with the reference densities of the fits, and fits on boxes that cover all bins."""


def standard_error(batches: Array) -> Array:
    """Return one standard error (...) of the mean of two or more independent ``batches``
    (batches, ...)."""
    return np.asarray(np.std(batches, axis=0, ddof=1) / np.sqrt(batches.shape[0]))


@dataclass(frozen=True)
class SampledDensity(Quantities):
    """Density of one or two coordinates from the contents of bins, with its sampling error.

    ``bins`` are the bins of each axis, with kinks and reference density. ``values`` (*bins) are the
    shares of samples in each bin over its area, ``batch_values`` (batches, *bins) the same for each
    independent batch. The share of samples outside is ``certificate.tail_mass``. ``samples`` is the
    number of samples, 0 if unknown. ``l1_error`` is the expected ∫|p − p_exact| by sampling of the
    density that ``at`` returns, NaN if it was not computed. ``made`` are fits, if already made. ::

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

    def __repr__(self) -> str:
        """Return the observable and the numbers of bins and batches in one line."""
        return self.described(f"{self.values.size} bins, {self.batch_values.shape[0]} batches")

    def __call__(self, *points: ArrayLike) -> Array:
        """Return the density at ``points``, one number or array per axis; 0 outside the bins."""
        return self.at(*(np.asarray(x, dtype=float) for x in points))[0]

    @property
    def edges(self) -> tuple[Array, ...]:
        """The ascending bin edges of every axis."""
        return tuple(axis.edges for axis in self.bins)

    panels = edges

    @cached_property
    def areas(self) -> Array:
        """Length or area (*bins) of each bin."""
        return np.asarray(reduce(np.multiply.outer, map(np.diff, self.edges)))

    @property
    def standard_error(self) -> Array:
        """Standard errors (*bins) of ``values``."""
        return standard_error(self.batch_values)

    def expectation(self, function: Function, *, kinks: Sequence[float] = ()) -> Number:
        """Return E f(X) and one standard error; f is averaged over each bin by the fitted density.
        ``function`` takes one array per axis; ``kinks`` only enlarge the bound on f outside."""
        x = [panel_rule(e, BIN_POINTS)[0].ravel() for e in self.edges]
        f = np.asarray(function(*np.meshgrid(*x, indexing="ij")))
        within = self.within
        f = np.broadcast_to(f, [a.size for a in x]).reshape(within.shape) * within
        f = f.sum(axis=tuple(range(1, f.ndim, 2)))  # the mean of f over each bin
        shares = self.batch_values * self.areas
        total = np.tensordot(self.values * self.areas, f, f.ndim)
        chance = standard_error(np.tensordot(shares, f, f.ndim))
        # One visit more, at the largest |f| of bins with samples, if that is not 0.
        seen = float(np.max(np.abs(f), initial=0.0, where=self.values > 0.0))
        far = largest_in_tails(function, self.edges, kinks)
        visit = self.visit * (seen or float(np.max(np.abs(f))) or far)
        error = float(np.hypot(chance, visit) + (self.certificate.tail_mass or 0.0) * far)
        return Number(float(total), error)

    def _probability(self, low: float, high: float) -> Number:
        """Return P(``low`` < X <= ``high``); bins are divided by the fitted density. The standard
        error is at least ``visit``, plus the tail mass if the interval ends outside the bins."""
        edges = self._axis()
        inside = np.clip(edges, *np.clip([low, high], *edges[[0, -1]]))
        share = np.diff(inside) / np.diff(edges)
        for k in np.flatnonzero((share > 0.0) & (share < 1.0)):
            x, w = panel_rule(np.array([edges[k], *inside[k : k + 2], edges[k + 1]]), BIN_POINTS)
            parts = (w * self.at(x)[0]).sum(axis=1)
            if parts.sum() > 0.0:
                share[k] = parts[1] / parts.sum()
        held = share * np.diff(edges)
        tail = (self.certificate.tail_mass or 0.0) if low < edges[0] or high > edges[-1] else 0.0
        chance = standard_error(self.batch_values @ held)
        return Number(float(self.values @ held), float(np.hypot(chance, self.visit) + tail))

    def joined(self, most: int) -> "SampledDensity":
        """Return a copy without fits in which k bins are joined to one along every axis. k is the
        largest number <= ``most`` for which no joined bin contains a kink, at least 1."""
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
    def visit(self) -> float:
        """Share of all samples that one excursion contributes; 0 if ``samples`` is unknown.

        The number of its samples, at least 1, is the variance over the mean of the counts of
        batches, in cells that some but not all batches visited.
        """
        if not self.samples > 0.0:
            return 0.0
        few = self.joined(min(self.values.shape) // 100)  # cells of a hundredth of the axis
        batches = len(few.batch_values)
        held = (few.batch_values * few.areas).reshape(batches, -1) * (self.samples / batches)
        visited = np.count_nonzero(held, axis=0)
        rare = held[:, (visited > 0) & (visited < batches)]
        if not rare.size:
            return 1.0 / self.samples
        together = float(rare.var(axis=0, ddof=1).sum() / rare.mean(axis=0).sum())
        return max(1.0, together) / self.samples

    @cached_property
    def fits(self) -> Fits:
        """Fits of ln p on boxes of bins, made at first use."""
        return self.made or self._fitted()

    def _fitted(self, *, halve: bool = True) -> Fits:
        """Return new fits of ln p on boxes of bins, halved until they fit only if ``halve``."""
        axes = self.bins
        if len(axes) == 2:
            # The reference is the product of fits of each coordinate on unhalved boxes. It matters
            # only where samples are few, and with them the coefficients of a box.
            alone = [self.alone(k) for k in range(2)]
            plain = [replace(one, made=one._fitted(halve=False))._log_p for one in alone]
            pairs = zip(axes, plain, strict=True)
            axes = tuple(replace(axis, log_reference=log_r) for axis, log_r in pairs)
        shares, batches = self.values * self.areas, self.batch_values * self.areas
        samples = 1.0 / (self.visit or EPS)  # an unknown number: no sampling error
        with threadpool_limits(1, user_api="blas"):  # the matrices are small
            return axes, tuple(boxes(axes, shares, batches, samples, halve=halve))

    def alone(self, axis: int) -> "SampledDensity":
        """Return the marginal density of the coordinate ``axis``, 0 or 1, of a pair."""
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

        The error follows from the spread of the batches. If fewer visits than batches are expected,
        it is at least the error of Poisson counts. The share ``visit`` over the size of a cell is
        added in squares. The error is infinite in a first bin that begins at a kink. At other kinks
        the side with the smaller error is used. Outside the bins the density is 0, with the error
        at the nearest point inside. Raises ``InvalidInput`` unless there is one array per axis.
        """
        require_one_array_an_axis(self.observable, points)
        batches = len(self.batch_values)

        def on_side(points: Array, bins: Integers) -> Values:
            value, deviations, poisson, cells = self._evaluated(points, bins)
            variance, cell = standard_error(deviations.T) ** 2, cells.prod(axis=0)
            rare = value * cell < batches * self.visit
            variance = np.where(rare, np.maximum(variance, poisson), variance)
            relative, visit = np.sqrt(variance), self.visit / cell
            # ln p is normal: three errors of p reach up as far as three of ln p. Without samples
            # the fit leaves p open by decades, but one visit limits it.
            chance = value * np.expm1(np.minimum(3.0 * relative, LARGEST_LOG)) / 3.0
            error = np.hypot(np.minimum(chance, value * relative + visit), visit)
            for axis, b in zip(self.bins, bins, strict=True):
                if axis.edges[0] in axis.kinks:  # p may change by any factor in the first bin
                    error[b == 0] = inf
            return value, error

        arrays = np.broadcast_arrays(*(np.asarray(x, dtype=float) for x in points))
        x = np.stack([a.ravel() for a in arrays])
        value, error = np.zeros((2, x.shape[1]))
        together = BLOCK_SIZE // batches
        for first in range(0, value.size, together):
            k = slice(first, first + together)
            value[k], error[k] = self._better(x[:, k], on_side)
        return value.reshape(arrays[0].shape), error.reshape(arrays[0].shape)

    @cached_property
    def within(self) -> Array:
        """Shares, with the sum 1, of each bin's mass at its Gauss points: (bins, ``BIN_POINTS``),
        for a pair (bins, ``BIN_POINTS``, bins, ``BIN_POINTS``)."""
        axes, every = self.fits
        spread = np.empty([k for axis in axes for k in (axis.edges.size - 1, BIN_POINTS)])
        for box in every:
            theta = box.theta if box.theta.size else np.zeros(1)
            degree = int(box.degrees.sum(axis=0).max(initial=0))
            ends = zip(box.first, box.last, strict=True)
            own = tuple(s for a, b in ends for s in (slice(a, b), slice(None)))
            spread[own] = Model(axes, box.first, box.last, degree).spread(theta)
        points = tuple(range(1, spread.ndim, 2))
        whole = spread.sum(axis=points, keepdims=True)
        none = whole == 0.0  # so far beyond a stop that p underflows
        shares: Array = np.where(none, 1.0 / BIN_POINTS ** len(points), spread / (whole + none))
        return shares

    @property
    def unresolved(self) -> list[Box]:
        """Fits inconsistent with the contents of their bins, at the false-alarm rate ``ALARM``."""
        return [box for box in self.fits[1] if box.chance < ALARM]

    def are_unresolved(self, points: Array) -> Flags:
        """Return flags (points,): ``points`` (axes, points) in the box of an ``unresolved`` fit."""
        inside = np.zeros(points.shape[1], dtype=bool)
        for box in self.unresolved:
            ends = zip(points, self.edges, box.first, box.last, strict=True)
            rows = [(x >= e[a]) & (x <= e[b]) for x, e, a, b in ends]
            inside |= np.all(rows, axis=0)
        return inside

    def _log_p(self, x: Array, bins: Integers) -> Array:
        """Return ln p of the only coordinate at ``x`` by the fit of the box that has ``bins``, in
        the shape of both, at least ln ``SMALLEST``."""
        value = self._evaluated(x.reshape(1, -1), bins.reshape(1, -1))[0]
        return np.log(np.maximum(value, SMALLEST)).reshape(x.shape)

    def flux(self, weight: Callable[[Array], Array], nodes: Array, at: Array) -> Values:
        """Return ∫ ``weight``(y) p(x, y) dy of a pair at x = ``at``, and its standard error,
        (points,) each. ``nodes`` ascend and bound the panels of y."""
        y, w = (a.ravel() for a in panel_rule(nodes, BIN_POINTS))
        weights, shape = weight(y), (at.size, y.size)

        def on_side(points: Array, bins: Integers) -> Values:
            value, deviations, _, cells = self._evaluated(points, bins)
            shares = value.reshape(shape) * w * weights
            flow = shares.sum(axis=1)
            apart = np.einsum("xy,xyb->bx", shares, deviations.reshape(*shape, -1))
            # One visit more has the flux-weighted mean of the weight, ∫weight² p / ∫weight p.
            most = np.full(at.size, np.max(weights))
            more = np.divide(shares @ weights, flow, out=most, where=flow > 0.0)
            more = self.visit * more / cells[0].reshape(shape).min(axis=1)
            return flow, np.hypot(standard_error(apart), more)

        return self._better(np.stack([np.repeat(at, y.size), np.tile(y, at.size)]), on_side)

    def _better(self, points: Array, on_side: Callable[[Array, Integers], Values]) -> Values:
        """Return values and errors by ``on_side(points, bins)``, ``bins`` the numbers of the bins
        that contain ``points``, (axes, points) each. At a kink the side with the smaller error is
        used. Outside the bins values are 0, with the error at the nearest point inside."""
        given, edges = points, self.edges
        points = np.array([np.clip(x, *e[[0, -1]]) for x, e in zip(given, edges, strict=True)])
        ends = zip(edges, points, strict=True)
        bins = [np.clip(np.searchsorted(e, x, "right") - 1, 0, e.size - 2) for e, x in ends]
        value, error = on_side(points, np.array(bins))
        for k, (axis, x) in enumerate(zip(self.bins, points, strict=True)):
            e, other = axis.edges, np.array(bins)
            for cut in axis.cuts[1:-1]:
                close = np.abs(x - e[cut]) <= ROUND_OFF * (e[-1] - e[0])
                other[k][close] = np.where(bins[k] < cut, cut, cut - 1)[close]
            if np.any(other != bins):
                values, errors = on_side(points, other)
                better = errors < error
                value, error = np.where(better, values, value), np.where(better, errors, error)
        away = np.any(points != given, axis=0).reshape(value.size, -1).any(axis=1)
        return np.where(away, 0.0, value), error

    def _evaluated(self, points: Array, bins: Integers) -> tuple[Array, Array, Array, Array]:
        """Return p (points,) at ``points`` in ``bins``, (axes, points) each, and three measures.

        They are the deviations of ln p of the batches (points, batches), the variance of ln p by
        Poisson's law (points,), and the lengths of cells (axes, points) around the points: the
        bins of a box over the number of its coefficients, along each axis.
        """
        (axes, every), count, many = self.fits, points.shape[1], len(self.batch_values)
        value, deviations, variance = np.zeros(count), np.zeros((count, many)), np.zeros(count)
        cells = np.empty(points.shape)
        rows = list(zip(axes, points, bins, strict=True))
        numbers = np.array([axis.number(x, b) for axis, x, b in rows])
        for box in every:
            inside = [(b >= i) & (b < j) for b, i, j in zip(bins, box.first, box.last, strict=True)]
            k = np.flatnonzero(np.all(inside, axis=0))
            if not k.size:
                continue
            coefficients = box.degrees.max(axis=1, initial=0) + 1
            half = np.subtract(box.last, box.first) // (2 * coefficients)
            for a, axis in enumerate(axes):
                first = np.maximum(bins[a, k] - half[a], box.first[a])
                last = np.minimum(bins[a, k] + half[a] + 1, box.last[a])
                cells[a, k] = axis.edges[last] - axis.edges[first]
            if box.theta.size:
                basis = box.basis(list(numbers[:, k]))
                log_r = sum(axis.log_r(x[k], b[k]) for axis, x, b in rows)
                value[k] = np.exp(basis @ box.theta + log_r)
                deviations[k] = basis @ box.deviations.T
                variance[k] = np.einsum("pk,kl,pl->p", basis, box.covariance, basis)
        return value, deviations, variance, cells
