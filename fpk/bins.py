"""Bins along one coordinate, and what is known of a density along it before it is sampled."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
import scipy  # its parts are loaded at their first use

from fpk.arrays import Array, Integers
from fpk.quadrature import panel_rule

LogReference = Callable[[Array, Integers], Array]
"""ln r of one coordinate at values and their bins, up to a constant, such as −U/kT."""
NODES = 3
"""Gauss points along a bin: its content is right to 1e-4 where ln p changes by 2 within it."""
LARGEST_LOG = 700.0
"""Largest |ln p/r| of a trial: its exponential is a number."""


def no_reference(x: Array, bins: Integers) -> Array:
    """Return ln 1."""
    return np.zeros_like(x)


@dataclass(frozen=True, eq=False)
class BinAxis:
    """Bins of one coordinate: ascending ``edges``, positions of ``kinks`` among them, and ln r.

    Between kinks bins are equally wide; above those of ``widening`` their edges are in proportion
    to the fourth power of their number.
    """

    edges: Array
    kinks: Sequence[float] = ()
    widening: Sequence[float] = ()
    log_reference: LogReference = no_reference

    @cached_property
    def cuts(self) -> list[int]:
        """Numbers of the edges at both ends and at the kinks, ascending."""
        return sorted({0, self.edges.size - 1, *np.searchsorted(self.edges, self.kinks).tolist()})

    @property
    def pieces(self) -> Iterator[tuple[float, float, int, bool]]:
        """Yield between each two kinks both ends, the number of bins, and whether these widen."""
        for a, b in pairwise(self.cuts):
            low, high = self.edges[[a, b]].tolist()
            yield low, high, b - a, low in self.widening

    @cached_property
    def _numbers(self) -> list[Callable[[Array], Array]]:
        number, interpolant = np.arange(self.edges.size) + 0.0, scipy.interpolate.PchipInterpolator
        own = [slice(a, b + 1) for a, b in pairwise(self.cuts)]
        return [interpolant(self.edges[s], number[s]) for s in own]

    def number(self, x: Array, bins: Integers) -> Array:
        """Return the continuous bin number at ``x``, a whole number at each edge.

        It is a smooth function of x between kinks. ``bins`` are the bins that x lies in.
        """
        value, piece = np.empty(x.shape), np.searchsorted(self.cuts, bins, side="right") - 1
        for k, interpolant in enumerate(self._numbers):
            value[piece == k] = interpolant(x[piece == k])
        return value

    def bins_of(self, x: Array) -> Integers:
        """Return the numbers of the bins that values within the edges lie in."""
        inside = np.searchsorted(self.edges, x, side="right") - 1
        return np.clip(inside, 0, self.edges.size - 2)

    @cached_property
    def rule(self) -> tuple[Array, Array]:
        """Bin numbers of the Gauss points of all bins (bins, ``NODES``), and weights times r."""
        x, w = panel_rule(self.edges, NODES)
        bins = np.broadcast_to(np.arange(len(x))[:, None], x.shape)
        return self.number(x, bins), w * np.exp(self.log_r(x, bins))

    def log_r(self, x: Array, bins: Integers) -> Array:
        """Return ln r, no less than half of ``LARGEST_LOG`` below 0: r is not to underflow."""
        return np.maximum(self.log_reference(x, bins), -0.5 * LARGEST_LOG)
