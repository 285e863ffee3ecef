"""A density of one or two coordinates as fits of ln p on boxes of bins, with its sampling error."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from math import inf

import numpy as np

from fpk.arrays import SMALLEST, Array, Flags, Integers
from fpk.bin_fit import ALARM, Box, Model, powers
from fpk.bins import LARGEST_LOG, NODES, BinAxis
from fpk.quadrature import panel_rule

Values = tuple[Array, Array]
"""Values and one standard error each."""

NEAR = 1e-9
"""Distance from a kink, as a share of the axis, in which a continuous density hardly changes."""
POINTS_TOGETHER = 65536
"""Points at which polynomials and batches are evaluated together: some 50 MB."""


@dataclass(frozen=True, eq=False)
class Fits:
    """Fits of ``fpk.bin_fit`` that cover all bins of ``axes``, from independent ``batches``.

    ``visit`` is the share of the samples that come together in one excursion, 0 where that is not
    known.
    """

    axes: tuple[BinAxis, ...]
    boxes: tuple[Box, ...]
    batches: int
    visit: float

    @cached_property
    def within(self) -> Array:
        """Share of each bin at its Gauss points, (bins, ``NODES``) for each axis."""
        spread = np.empty([k for axis in self.axes for k in (axis.edges.size - 1, NODES)])
        for box in self.boxes:
            theta = box.theta if box.theta.size else np.zeros(1)
            degree = int(powers(len(self.axes), theta.size).sum(axis=0).max())
            rules = [[x[s] for x in a.rule] for a, s in zip(self.axes, box.bins, strict=True)]
            own = tuple(s for bins in box.bins for s in (bins, slice(None)))
            spread[own] = Model(box.first, box.last, degree, rules).spread(theta)
        points = tuple(range(1, spread.ndim, 2))
        whole = spread.sum(axis=points, keepdims=True)
        none = whole == 0.0  # so far beyond a stop that p underflows
        shares: Array = np.where(none, 1.0 / NODES ** len(points), spread / (whole + none))
        return shares

    @property
    def unresolved(self) -> list[Box]:
        """The fits that do not give back the contents of the bins."""
        return [box for box in self.boxes if box.chance < ALARM]

    def are_unresolved(self, points: Array) -> Flags:
        """Return which points (axes, points) lie where a fit is wrong."""
        inside = np.zeros(points.shape[1], dtype=bool)
        for box in self.unresolved:
            ends = zip(points, self.axes, box.first, box.last, strict=True)
            rows = [(x >= axis.edges[a]) & (x <= axis.edges[b]) for x, axis, a, b in ends]
            inside |= np.all(rows, axis=0)
        return inside

    def at(self, points: Array) -> Values:
        """Return the density and its error at points (axes, points).

        The error is that of the fit by the independent batches; where fewer visits are expected
        than there are batches, at least that of Poisson's law of the visits. One visit more is
        always added: the variance of k visits is k, of which 0 may have been seen. At a kink the
        fit of the two with the smaller error counts. Outside the bins the density is 0, with the
        error at the nearest point of these.
        """
        ends = [axis.edges[[0, -1]] for axis in self.axes]
        near = np.array([np.clip(x, *end) for x, end in zip(points, ends, strict=True)])
        value, error = np.zeros((2, points.shape[1]))
        for first in range(0, value.size, POINTS_TOGETHER):
            k = slice(first, first + POINTS_TOGETHER)
            value[k], error[k] = self._at(near[:, k])
        return np.where(np.any(near != points, axis=0), 0.0, value), error

    def _at(self, points: Array) -> Values:

        def on_side(bins: Integers) -> Values:
            value, deviations, poisson, cells = self._evaluated(points, bins)
            variance, cell = standard_error(deviations.T) ** 2, cells.prod(axis=0)
            rare = value * cell < self.batches * self.visit
            variance = np.where(rare, np.maximum(variance, poisson), variance)
            relative, visit = np.sqrt(variance), self.visit / cell
            # ln p is normal: three errors of p reach as far up as three of ln p. The fit may leave
            # p open by decades where nothing was seen; that nothing was does not.
            chance = value * np.expm1(np.minimum(3.0 * relative, LARGEST_LOG)) / 3.0
            error = np.hypot(np.minimum(chance, value * relative + visit), visit)
            for axis, b in zip(self.axes, bins, strict=True):
                if axis.edges[0] in axis.kinks:  # p may change by any factor in the first bin
                    error[b == 0] = inf
            return value, error

        return self._better(points, on_side)

    def log_p(self, x: Array, bins: Integers) -> Array:
        """Return ln p of one coordinate by the fits of the ``bins``, at kinks of their side."""
        value = self._evaluated(x.reshape(1, -1), bins.reshape(1, -1))[0]
        return np.log(np.maximum(value, SMALLEST)).reshape(x.shape)

    def flux(self, weight: Callable[[Array], Array], nodes: Array, at: Array) -> Values:
        """Return ∫ weight(y) p(x, y) dy over the panels of ``nodes``, and one standard error.

        Of a joint density of (x, y), at x = ``at`` (points,). At a kink the fit with the smaller
        error counts; outside the bins it is 0, with the error at the end of these.
        """
        y, w = (a.ravel() for a in panel_rule(nodes, NODES))
        weights, shape = weight(y), (at.size, y.size)

        def on_side(bins: Integers) -> Values:
            value, deviations, _, cells = self._evaluated(points, bins)
            shares = value.reshape(shape) * w * weights
            flow = shares.sum(axis=1)
            apart = np.einsum("xy,xyb->bx", shares, deviations.reshape(*shape, -1))
            # One visit more counts by the mean of the weights, each weighted by itself.
            most = np.full(at.size, np.max(weights))
            more = np.divide(shares @ weights, flow, out=most, where=flow > 0.0)
            more = self.visit * more / cells[0].reshape(shape).min(axis=1)
            return flow, np.hypot(standard_error(apart), more)

        near = np.clip(at, *self.axes[0].edges[[0, -1]])
        points = np.stack([np.repeat(near, y.size), np.tile(y, at.size)])
        value, error = self._better(points, on_side)
        return np.where(near == at, value, 0.0), error

    def _better(self, points: Array, on_side: Callable[[Integers], Values]) -> Values:
        """Values and errors by the bins (axes, points) of ``points``; at kinks the better side."""
        bins = np.array([axis.bins_of(x) for axis, x in zip(self.axes, points, strict=True)])
        value, error = on_side(bins)
        for k, (axis, x) in enumerate(zip(self.axes, points, strict=True)):
            edges, other = axis.edges, bins.copy()
            for cut in axis.cuts[1:-1]:
                beside = np.abs(x - edges[cut]) <= NEAR * (edges[-1] - edges[0])
                other[k][beside] = np.where(bins[k] < cut, cut, cut - 1)[beside]
            if np.any(other != bins):
                values, errors = on_side(other)
                better = errors < error
                value, error = np.where(better, values, value), np.where(better, errors, error)
        return value, error

    def _evaluated(self, points: Array, bins: Integers) -> tuple[Array, Array, Array, Array]:
        """Density at points (axes, points), relative deviations, variance, and size of cells.

        Deviations are those of the batches (points, batches), the variance is that of independent
        visits (points,), and a cell (axes, points) has as many bins as a coefficient of its box.
        """
        count, many = points.shape[1], self.batches
        value, deviations, variance = np.zeros(count), np.zeros((count, many)), np.zeros(count)
        cells = np.empty(points.shape)
        for box, k, basis in self._located(points, bins):
            rows = zip(self.axes, points, bins, strict=True)
            log_r = sum(axis.log_r(x[k], b[k]) for axis, x, b in rows)
            degree = powers(len(points), box.theta.size).max(axis=1, initial=0)
            half = np.subtract(box.last, box.first) // (2 * (degree + 1))
            for a, axis in enumerate(self.axes):
                first = np.maximum(bins[a, k] - half[a], box.first[a])
                last = np.minimum(bins[a, k] + half[a] + 1, box.last[a])
                cells[a, k] = axis.edges[last] - axis.edges[first]
            if box.theta.size:
                value[k] = np.exp(basis @ box.theta + log_r)
                deviations[k] = basis @ box.deviations.T
                variance[k] = np.einsum("pk,kl,pl->p", basis, box.covariance, basis)
        return value, deviations, variance, cells

    def _located(self, points: Array, bins: Integers) -> Iterator[tuple[Box, Integers, Array]]:
        """Yield the boxes with the numbers of the points in each and the polynomials there."""
        numbers = [a.number(x, b) for a, x, b in zip(self.axes, points, bins, strict=True)]
        for box in self.boxes:
            inside = np.ones(points.shape[1], dtype=bool)
            for b, first, last in zip(bins, box.first, box.last, strict=True):
                inside &= (b >= first) & (b < last)
            k = np.flatnonzero(inside)
            if k.size:
                yield box, k, box.basis([u[k] for u in numbers])


def standard_error(batches: Array) -> Array:
    """Return one standard error of the mean of independent ``batches`` (batches, ...)."""
    spread: Array = np.std(batches, axis=0, ddof=1) / np.sqrt(batches.shape[0])
    return spread
