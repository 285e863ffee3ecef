"""A density of one energy on finite elements: where it begins, and what it is at later times."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from fpk.arrays import EPS, Array
from fpk.line.time.elements import Elements, elements
from fpk.line.time.mesh import GROWTH, HIGHEST, time_nodes
from fpk.line.time.resolvent import Evolved, evolved
from fpk.probe import probed
from fpk.process import Process


@dataclass(frozen=True, eq=False)
class Source:
    """Initial density of a transient: at one energy, or the stationary one of another process."""

    energy: float = 0.0
    process: Process | None = None

    def load(self, e: Elements) -> Array:
        """Return its moments with the functions of each element, (elements, functions)."""
        x, weights = self.samples(e)
        k, values = e.functions(x)
        load = np.zeros(e.load.shape)
        np.add.at(load, k, weights[:, None] * values)
        return load

    def nodes(self, end: float, degree: int) -> Array:
        """Return energies up to ``end`` at which elements have to end to see the source.

        Beyond its extent they grow: it spreads from there.
        """
        if self.process is None:
            return np.zeros(0)
        last = min(end, self.extent)
        steps = np.arange(1.0, np.log(end / last) / np.log(GROWTH))
        return np.append(time_nodes(self.process, last, degree), last * GROWTH**steps)

    def samples(self, e: Elements) -> tuple[Array, Array]:
        """Return energies within the elements, and their weights in a mean over the source."""
        if self.process is None:
            return np.array([self.energy]), np.ones(1)
        k = int(np.searchsorted(e.left, self.extent))
        own, x = elements(self.process, e.left[:k], e.right[:k], e.degree), e.x[:k]
        log = own.log_density(self.process, x.ravel()) - self._log_total
        return x.ravel(), (e.weight[:k] * np.exp(log).reshape(x.shape)).ravel()

    @cached_property
    def extent(self) -> float:
        """Energy above which no more than the round-off of the source is."""
        return self.energy if self.process is None else float(probed(self.process).extent(EPS))

    @cached_property
    def _log_total(self) -> float:
        """ln ∫π of the process, in the unit in which u = 1 at H = 0."""
        assert self.process is not None
        nodes = time_nodes(self.process, self.extent, HIGHEST)
        return elements(self.process, nodes[:-1], nodes[1:], HIGHEST).log_total


@dataclass(frozen=True, eq=False)
class Solution:
    """Densities at several times on one mesh: the coefficients ``g`` of p/π, however computed.

    ``g`` is in the units 1/e^``log_scale`` of the elements, its residual the largest of the
    equations solved, relative to the terms that cancel.
    """

    process: Process
    elements: Elements
    g: Evolved

    def density(self, x: Array) -> tuple[Array, Array]:
        """Return p (times, points) at energies x > 0 in the elements, and the size of its terms."""
        return self._times(self.elements.log_density(self.process, x), x)

    def state_density(self, x: Array) -> tuple[Array, Array]:
        """Return u = p/T likewise, by its own: T vanishes at H = 0."""
        return self._times(self.elements.log_phase_density(x), x)

    def _times(self, log_factor: Array, x: Array) -> tuple[Array, Array]:
        """p/π times a factor."""
        e = self.elements
        p, size = e.at(x, self.g.values, self.g.size)
        factor = np.exp(log_factor - e.log_scale[e.element_of(x)])
        return p * factor, size * factor


def propagated(
    process: Process, e: Elements, source: Source, times: Array, *, more: int = 0
) -> Solution:
    """Return the density at ``times`` > 0 after ``source``, ``more`` points on each contour."""
    return Solution(process, e, evolved(e, source.load(e), times, more=more))
