"""Probability densities given as functions, with their errors and certificates, and distances."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, cached_property, reduce
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import brentq

from fpk.answer.certificate import DISTANCE_FACTOR, NEGATIVE, Certificate, Measured, certify
from fpk.answer.names import Observable, require_one_array_an_axis
from fpk.answer.quantities import (
    ErrorKind,
    Function,
    Number,
    Quantities,
    largest_in_tails,
    with_points,
)
from fpk.answer.sampled_density import SampledDensity
from fpk.numeric.arrays import EPS, ROUND_OFF, SMALLEST, Array
from fpk.numeric.quadrature import GAUSS_RULES, gauss_grid, integral


@dataclass(frozen=True)
class Density(Quantities):
    """Density of one or two coordinates, given as a function, with its numerical error.

    ``panels`` holds for every axis the ascending nodes between which the density is smooth; the
    first and last are its support. ``pdf`` takes one array per axis (broadcast together) and
    returns the density, ``pointwise`` the estimate of its error there. Outside the support the
    density is 0, or the negligible tail of a closed form. ``l1_error`` estimates ∫|p − p_exact|,
    the mass outside the support included. ``source(observables)`` solves again and returns a
    ``Result``; the density can be pickled only if it has a source. ``provenance`` are the settings
    of the method, for readers. ::

        p = fpk.solve(fpk.load("fig6a").system, ["q2"], methods=["nonintegrable/fem"])["q2"]
        value, error = p.at(np.linspace(-1.5, 1.5, 31))
        p.mean(), p.std(), p.rms(), p.variance(), p.skewness(), p.kurtosis(), p.moment(4)
        p.exceedance(0.5), p.cdf(0.5), p.probability(-0.5, 0.5), p.quantile(0.99)
        p.expectation(np.abs, kinks=[0.0]), p.certificate.certified
        p.to_meshio(), p.to_pyvista()
    """

    observable: Observable
    panels: tuple[Array, ...]
    pdf: Callable[..., Array]
    pointwise: Callable[..., Array]
    l1_error: float
    certificate: Certificate
    provenance: Mapping[str, str | float | int] = field(default_factory=dict)
    error_kind: ErrorKind = "numerical"
    source: Callable[[Sequence[Observable]], Any] | None = None

    def __repr__(self) -> str:
        """Return the observable, the support and the error in one line."""
        return self.described(f"L1 error {self.l1_error:.2g}")

    def __getstate__(self) -> dict[str, Any]:
        """Return all fields but ``pdf`` and ``pointwise``; ``TypeError`` without a ``source``."""
        if self.source is None:
            words = "does not know what it follows from and cannot be pickled; take it from the"
            raise TypeError(f"the density of {self.name} {words} result of a method")
        own = self.__dataclass_fields__.keys() - {"pdf", "pointwise"}
        return {k: v for k, v in self.__dict__.items() if k in own}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Set the fields of ``state``. The first call of the density or its error solves again."""
        again = cache(lambda: state["source"]([state["observable"]]).densities[0])
        functions = {k: lambda *x, k=k: getattr(again(), k)(*x) for k in ("pdf", "pointwise")}
        self.__dict__.update(state, **functions)

    def __call__(self, *points: ArrayLike) -> Array:
        """Return the density at ``points``, one number or array per axis, in their common shape.
        Outside the support it is 0, or the negligible tail of a closed form."""
        return np.asarray(self.pdf(*(np.asarray(x, dtype=float) for x in points)))

    def at(self, *points: Array) -> tuple[Array, Array]:
        """Return the density, as a call does, and the estimate of its absolute error at ``points``,
        arrays that broadcast. Raises ``InvalidInput`` unless there is one array per axis."""
        require_one_array_an_axis(self.observable, points)
        return self.pdf(*points), self.pointwise(*points)

    def cell_averages(self, *edges: Array) -> Array:
        """Return the mean of the density over each cell of a grid, (cells, ...) by coordinate.
        ``edges`` are ascending arrays (cells + 1,), one per coordinate."""
        mesh, grids = gauss_grid(list(map(with_points, edges, self.panels)))
        values = self.pdf(*mesh)
        for axis, (e, (x, w)) in enumerate(zip(edges, grids, strict=True)):
            cell = np.searchsorted(e, x, side="right") - 1
            starts = np.searchsorted(cell, np.arange(e.size - 1))
            shape = [-1 if a == axis else 1 for a in range(values.ndim)]
            values = np.add.reduceat(values * w.reshape(shape), starts, axis=axis)
            values = values / np.diff(e).reshape(shape)
        return values

    def expectation(self, function: Function, *, kinks: Sequence[float] = ()) -> Number:
        """Return E f(X) and its error, by the error of p weighted by |f|, quadrature and the tails.
        ``function`` takes one array per axis and is smooth except at ``kinks``, which raise
        ``InvalidInput`` for two axes."""
        panels = (self._axis(kinks),) if kinks else self.panels
        keeps = not kinks and len(panels) == 1  # values of a pair take too much memory to store
        coarse_p, p, e = (self if keeps else replace(self, panels=panels))._at_nodes
        mesh, grids = gauss_grid(panels, points=GAUSS_RULES[len(panels)][1])
        coarse = integral(function(*mesh) * coarse_p, grids)
        mesh, grids = gauss_grid(panels)
        f = np.asarray(function(*mesh))
        value = integral(f * p, grids)
        e = e + SMALLEST  # if all pointwise errors are 0, the L1 error is distributed evenly
        least_l1 = max(self.l1_error, self.certificate.mass_defect or 0.0)
        error = integral(np.abs(f) * e, grids) * max(1.0, least_l1 / integral(e, grids))
        sizes = [np.repeat(_condition(nodes), GAUSS_RULES[len(panels)][-1]) for nodes in panels]
        rounding = EPS * integral(np.abs(f * p) * reduce(np.add.outer, sizes), grids)
        tail = (self.certificate.tail_mass or 0.0) * largest_in_tails(function, self.panels, kinks)
        return Number(value, error + rounding + abs(value - coarse) + tail)

    def _probability(self, low: float, high: float) -> Number:
        """Return P(``low`` < X <= ``high``) and its error; ``InvalidInput`` for two axes.

        As the total mass is 1, the error is at most the pointwise error integrated inside, and at
        most the pointwise error integrated outside the interval. The rest of the L1 error, at least
        |1 − mass|, is added, and the tail mass for each end of the interval outside the support.
        """
        value, error, rounding = (float(x) for x in self._share(low, high))
        of_all = float(self._panel_shares[1].sum())
        unlocated = max(self.l1_error - of_all, self.certificate.mass_defect or 0.0)
        located = max(min(error, of_all - error), 0.0)
        ends = (low < self.panels[0][0], high > self.panels[0][-1])
        tail = self.certificate.tail_mass or 0.0
        beyond_ends = sum(tail for cut_off in ends if cut_off)  # not 0 · ∞
        return Number(value, located + unlocated + beyond_ends + rounding)

    def share(self, low: float, high: float) -> float:
        """Return P(``low`` < X <= ``high``) without its error, twice as fast as ``probability``."""
        return float(self._share(low, high, rows=1)[0])

    def _share(self, low: float, high: float, *, rows: int = 3) -> Array:
        """Return the first ``rows`` of: ∫p, ∫error, round-off of ∫p from ``low`` to ``high``."""
        nodes = self._axis()
        low, high = np.clip([low, high], *nodes[[0, -1]])
        first, last = np.searchsorted(nodes, low), np.searchsorted(nodes, high, side="right") - 1
        whole: Array = self._panel_shares[:rows, first:last].sum(axis=1)
        cut = [(low, nodes[first]), (nodes[last], high)] if first <= last else [(low, high)]
        for a, b in cut:
            if a < b:
                mesh, grids = gauss_grid([np.array([a, b])])
                own = [integral(f(*mesh), grids) for f in (self.pdf, self.pointwise)[:rows]]
                k = np.clip(np.searchsorted(nodes, a, side="right") - 1, 0, nodes.size - 2)
                whole = whole + [*own, EPS * _condition(nodes)[k] * own[0]][:rows]
        return whole

    @cached_property
    def _panel_shares(self) -> Array:
        """∫p, ∫error and the round-off of ∫p over each panel of the only axis, (3, panels)."""
        _, [(_, w)] = gauss_grid(self.panels)
        weighted = [np.broadcast_to(f, w.shape) * w for f in self._at_nodes[1:]]
        value, error = np.reshape(weighted, (2, -1, GAUSS_RULES[1][-1])).sum(axis=2)
        return np.array([value, error, EPS * _condition(self.panels[0]) * value])

    @cached_property
    def _at_nodes(self) -> tuple[Array, Array, Array]:
        """p at Gauss points of the coarser rule; p and its error at Gauss points of the finer."""
        coarse, _ = gauss_grid(self.panels, points=GAUSS_RULES[len(self.panels)][1])
        mesh, _ = gauss_grid(self.panels)
        return self.pdf(*coarse), self.pdf(*mesh), self.pointwise(*mesh)


def _condition(nodes: Array) -> Array:
    """1 + max|x|/width (panels,) between ``nodes``: relative round-off of integrals / ``EPS``."""
    largest = np.maximum(np.abs(nodes[1:]), np.abs(nodes[:-1]))
    return np.asarray(1.0 + largest / np.diff(nodes))


def certify_density(
    observable: Observable,
    panels: tuple[Array, ...],
    pdf: Callable[..., Array],
    pointwise: Callable[..., Array],
    *,
    measured: Measured,
    tol: float,
    added_error: Callable[..., Array] | None = None,
    frame: tuple[Array, tuple[Array, ...]] | None = None,
) -> Density:
    """Return a density given by functions, with its certificate.

    ``panels``, ``pdf`` and ``pointwise`` become fields of ``Density``. ``measured`` comes from the
    solver, but its mass defect is replaced by |∫p − 1|, its minimum and ``absolute_error`` by the
    values at the Gauss points, unless the solver's minimum and its sum with the error are lower;
    ``tol`` is the L1 tolerance. ``added_error(p, *points)`` is a pointwise error of p whose
    integral is added to ``measured.l1_error``. With ``frame``, a matrix F and panels of y,
    integrals are taken over x = F y, for a ridge of correlated coordinates that no affordable
    panels of x resolve. Raises nothing if a check fails: the certificate has it.
    """
    jacobian, axes = (np.eye(len(panels)), panels) if frame is None else frame
    mesh, grids = gauss_grid(axes)
    if frame is not None:
        mesh = tuple(np.einsum("ij,j...->i...", jacobian, np.array(np.broadcast_arrays(*mesh))))
        grids[0] = (grids[0][0], grids[0][1] * abs(float(np.linalg.det(jacobian))))
    values = np.asarray(pdf(*mesh))
    largest = float(values.max(initial=0.0))
    smallest = float(values.min(initial=0.0)) / largest if largest > 0.0 else np.nan
    # p may be negative within its stated error.
    known = float(np.max(pointwise(*mesh))) / largest if smallest < NEGATIVE else 0.0
    if measured.minimum is not None and measured.minimum < smallest:
        solved = measured.minimum, measured.absolute_error
        smallest, known = min((smallest, known), solved, key=sum)
    added = 0.0 if added_error is None else integral(np.asarray(added_error(values, *mesh)), grids)
    checked = replace(
        measured,
        l1_error=measured.l1_error + added,
        mass_defect=abs(integral(values, grids) - 1.0),
        minimum=smallest,
        absolute_error=known,
    )
    certificate = certify(checked, tol=tol)

    def pointwise_error(*x: Array) -> Array:
        return np.asarray(pointwise(*x)) + SMALLEST

    return Density(observable, panels, pdf, pointwise_error, checked.l1_error, certificate)


AnyDensity = Density | SampledDensity


def l1_distance(a: AnyDensity, b: AnyDensity) -> float:
    """Return ∫|p_a − p_b|; raise ``ValueError`` as ``distance_with_error`` does."""
    return distance_with_error(a, b)[0]


def distance_with_error(a: AnyDensity, b: AnyDensity) -> tuple[float, float]:
    """Return ∫|p_a − p_b| and the error of its quadrature; errors of p_a and p_b are not included.

    A function is compared with a histogram by its averages over the bins, and the outside as one
    more bin: a sum, whose error is 0. Panels end where functions of one coordinate cross; for two
    coordinates the error covers such kinks. Raises ``ValueError`` for different observables, or
    histograms on different bins.
    """
    if a.observable != b.observable:
        raise ValueError(f"densities of {a.name} and of {b.name} cannot be compared")
    if isinstance(a, SampledDensity) or isinstance(b, SampledDensity):
        first, second = (a, b) if isinstance(a, SampledDensity) else (b, a)
        assert isinstance(first, SampledDensity)
        shares = bin_differences(first, second) * first.areas
        # The outside is one more bin; as both masses are 1, its difference is minus the sum.
        return float(np.sum(np.abs(shares)) + abs(np.sum(shares))), 0.0
    panels = list(map(np.union1d, a.panels, b.panels))

    def difference(*x: Any) -> Any:
        return a(*x) - b(*x)

    if len(panels) == 1:
        (x,), _ = gauss_grid(panels)
        d = difference(x)
        size = np.minimum(np.abs(d[1:]), np.abs(d[:-1]))
        known = size > ROUND_OFF * np.max(np.abs(a(x)))
        crossed = np.flatnonzero((d[1:] * d[:-1] < 0.0) & known)
        at = [brentq(lambda q: difference(np.array([q]))[0], *x[k : k + 2]) for k in crossed]
        panels = [np.union1d(panels[0], at)]
    of_panels = []  # summed by panel, as differences of rules may cancel between panels
    for points in GAUSS_RULES[len(panels)]:
        mesh, grids = gauss_grid(panels, points=points)
        shares = np.abs(difference(*mesh)) * reduce(np.multiply.outer, [w for _, w in grids])
        for axis in range(len(panels)):
            shares = np.add.reduceat(shares, range(0, shares.shape[axis], points), axis=axis)
        of_panels.append(shares)
    *coarser, fine = of_panels
    return float(fine.sum()), DISTANCE_FACTOR * sum(float(np.abs(fine - c).sum()) for c in coarser)


def bin_differences(sampled: SampledDensity, other: AnyDensity) -> Array:
    """Return the bin values of ``sampled`` minus the averages of ``other`` over the same bins,
    (*bins). Raises ``ValueError`` if ``other`` is sampled with other bins."""
    if isinstance(other, Density):
        return sampled.values - other.cell_averages(*sampled.edges)
    if not all(map(np.array_equal, sampled.edges, other.edges)):
        raise ValueError("two histograms can be compared on the same bins only")
    return sampled.values - other.values
