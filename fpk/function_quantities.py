"""Quantities of a density that is known as a function: expectations and probabilities."""

from collections.abc import Callable, Sequence
from functools import cached_property

import numpy as np

from fpk.arrays import EPS, SMALLEST, Array
from fpk.certificate import Certificate, missing, outside
from fpk.number import Number
from fpk.quadrature import GAUSS_POINTS, gauss_grid, integral
from fpk.quantities import Function, Quantities, beyond

FEWER = {1: 16, 2: 9}
"""Gauss points per panel and axis, by the number of axes, of the coarser rule: its distance from
that of ``GAUSS_POINTS`` is in the error of an expectation."""


class FunctionQuantities(Quantities):
    """Integrals of a density p and of its error, by Gauss rules on the panels of p.

    The attributes are those of ``fpk.density.Density``.
    """

    panels: tuple[Array, ...]
    pdf: Callable[..., Array]
    pointwise: Callable[..., Array]
    l1_error: float
    certificate: Certificate

    def axes(self) -> tuple[Array, ...]:
        """Return ``panels``."""
        return self.panels

    def expectation(self, function: Function, *, kinks: Sequence[float] = ()) -> Number:
        """Return E f(X) and its error: that of the density, weighted by |f|, and of the tails.

        ``function`` takes an array per axis; ``kinks`` (one axis only) are where it is not smooth.
        """
        panels = [self._axis(kinks)] if kinks else self.panels
        known = not kinks and len(panels) == 1
        coarse_p, p, e = self._at_nodes if known else self._at_nodes_of(panels)
        mesh, grids = gauss_grid(panels, points=FEWER[len(panels)])
        coarse = integral(function(*mesh) * coarse_p, grids)
        mesh, grids = gauss_grid(panels)
        f = np.asarray(function(*mesh))
        value = integral(f * p, grids)
        e = e + SMALLEST  # where there is none at points the L1 error is spread evenly
        least_l1 = max(self.l1_error, missing(self.certificate))
        error = integral(np.abs(f) * e, grids) * max(1.0, least_l1 / integral(e, grids))
        rounding = EPS * integral(np.abs(f * p) * _condition(panels), grids)
        tail = outside(self.certificate) * beyond(function, self.panels, kinks)
        return Number(value, error + rounding + abs(value - coarse) + tail)

    def _probability(self, low: float, high: float) -> Number:
        """Return P(low < X <= high) and its error.

        The error is the integral of the error at points over the interval or, as the whole mass is
        1, over all that is outside it, whichever is less. The part of the L1 error that the errors
        at points do not add up to, at least |1 − mass|, may lie anywhere and is added.
        """
        nodes = self._axis()
        first, last = (float(x) for x in np.clip([low, high], nodes[0], nodes[-1]))
        tail = outside(self.certificate)
        beyond_ends = (tail if low < nodes[0] else 0.0) + (tail if high > nodes[-1] else 0.0)
        shares = self._share(first, last, self.pdf, self.pointwise)
        value, error = (float(x) for x in shares)
        of_all = float(self._panel_shares[1].sum())
        unlocated = max(self.l1_error - of_all, missing(self.certificate))
        rounding = float(self._share(first, last, self.pdf, rounding=True)[0])
        located = max(min(error, of_all - error), 0.0)
        return Number(value, located + unlocated + beyond_ends + rounding)

    def share(self, low: float, high: float) -> float:
        """Return P(low < X <= high) without its error, which takes as long again."""
        ends = np.clip([low, high], *self._axis()[[0, -1]])
        return float(self._share(*ends, self.pdf)[0])

    def _share(
        self, low: float, high: float, *functions: Callable[..., Array], rounding: bool = False
    ) -> Array:
        """Integrals from ``low`` to ``high``, both within the support, of each of ``functions``.

        These are the density, and after it, if given, its error at points. With ``rounding`` each
        panel counts by the relative round-off of its nodes, so that the round-off is returned.
        """
        nodes = self.panels[0]
        each = EPS * condition_of(nodes) if rounding else np.ones(nodes.size - 1)
        first, last = np.searchsorted(nodes, low), np.searchsorted(nodes, high, side="right") - 1
        whole: Array = (self._panel_shares[: len(functions)] * each)[:, first:last].sum(axis=1)
        cut = [(low, nodes[first]), (nodes[last], high)] if first <= last else [(low, high)]
        for a, b in cut:
            if a < b:
                mesh, grids = gauss_grid([np.array([a, b])])
                own = each[min(max(np.searchsorted(nodes, a, side="right") - 1, 0), each.size - 1)]
                whole = whole + own * np.array([integral(f(*mesh), grids) for f in functions])
        return whole

    @cached_property
    def _panel_shares(self) -> Array:
        """∫ of the density and of its error over every panel of the one axis."""
        _, [(_, w)] = gauss_grid(self.panels)
        weighted = [np.broadcast_to(f, w.shape) * w for f in self._at_nodes[1:]]
        shares: Array = np.reshape(weighted, (2, -1, GAUSS_POINTS[1])).sum(axis=2)
        return shares

    @cached_property
    def _at_nodes(self) -> tuple[Array, Array, Array]:
        return self._at_nodes_of(self.panels)

    def _at_nodes_of(self, panels: Sequence[Array]) -> tuple[Array, Array, Array]:
        """The density at the Gauss points of the coarser and finer rule, and its error at these."""
        coarse, mesh = gauss_grid(panels, points=FEWER[len(panels)])[0], gauss_grid(panels)[0]
        return self.pdf(*coarse), self.pdf(*mesh), self.pointwise(*mesh)


def condition_of(nodes: Array) -> Array:
    """Return 1 + |x|/width of every panel between ``nodes``, |x| the larger of its ends.

    By this factor times the rounding of a double the width is rounded, relative to itself, and so
    is what changes over the panel by about as much as it is.
    """
    largest = np.maximum(np.abs(nodes[1:]), np.abs(nodes[:-1]))
    return np.asarray(1.0 + largest / np.diff(nodes))


def _condition(panels: Sequence[Array]) -> Array:
    """``condition_of`` at the Gauss points of all panels, summed over the axes."""
    each = [np.repeat(condition_of(nodes), GAUSS_POINTS[len(panels)]) for nodes in panels]
    return each[0] if len(each) == 1 else np.add.outer(*each)
