"""A density of one energy carried along in time, by inverse transforms of the resolvent."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from fpk.arrays import Array
from fpk.contour import Contour, contours
from fpk.line.time import chain
from fpk.line.time.mesh import GROWTH, HIGHEST, time_nodes
from fpk.line.time.modes import EPS, Modes, log_density, log_phase_density, modes, rule
from fpk.probe import probed
from fpk.process import Process


@dataclass(frozen=True, eq=False)
class Source:
    """What a density begins with: an energy, or the stationary density of another process."""

    energy: float = 0.0
    process: Process | None = None

    def load(self, e: Modes) -> tuple[Array, Array]:
        """Return its moments with h_a and v_j in each element."""
        at_ends, inner = np.zeros((e.count, 2)), np.zeros(e.gram.shape[:2])
        if self.process is None:
            (k,), (h,), v = e.shapes(np.array([self.energy]))
            at_ends[k], inner[k] = (1.0 - h if k else 0.0, h if k else 1.0), v[0]
            return at_ends, inner
        x, weights = self.samples(e)
        _, h, v = e.shapes(x)
        weights = weights.reshape(e.count, -1)
        at_ends[:, 1] = (weights * h.reshape(weights.shape)).sum(axis=1)
        at_ends[1:, 0] = weights.sum(axis=1)[1:] - at_ends[1:, 1]
        return at_ends, np.einsum("eq,eqv->ev", weights, v.reshape(*weights.shape, -1))

    def nodes(self, end: float, degree: int) -> Array:
        """Return energies up to ``end`` at which elements have to end to see the source.

        Beyond its extent they grow: it spreads from there.
        """
        if self.process is None:
            return np.zeros(0)
        last = min(end, self.extent)
        steps = np.arange(1.0, np.log(end / last) / np.log(GROWTH))
        return np.append(time_nodes(self.process, last, degree), last * GROWTH**steps)

    def samples(self, e: Modes) -> tuple[Array, Array]:
        """Return energies within the elements, and their weights in a mean over the source."""
        if self.process is None:
            return np.array([self.energy]), np.ones(1)
        x, w = points(self.process, e)
        k = int(np.searchsorted(e.left, self.extent))
        own = modes(self.process, e.left[:k], e.right[:k], e.degree)
        log = log_density(self.process, own, x[:k].ravel()) - self._log_total
        w[:k] *= np.exp(log).reshape(k, -1)
        w[k:] = 0.0
        return x.ravel(), w.ravel()

    @cached_property
    def extent(self) -> float:
        """Energy above which no more than the round-off of the source is."""
        return self.energy if self.process is None else float(probed(self.process).extent(EPS))

    @cached_property
    def _log_total(self) -> float:
        """ln ∫π of the process, in the unit in which u = 1 at H = 0."""
        assert self.process is not None
        nodes = time_nodes(self.process, self.extent, HIGHEST)
        return modes(self.process, nodes[:-1], nodes[1:], HIGHEST).log_total


@dataclass(frozen=True, eq=False)
class Propagation:
    """The density at ``times`` after a start on one mesh: its transform on contours in ``parts``.

    ``residual`` is what the solutions leave of their equations at the nodes.
    """

    process: Process
    elements: Modes
    times: Array
    parts: Sequence[tuple[Contour, chain.Solution]]
    residual: float

    def density(self, x: Array, *, of_state: bool = False) -> tuple[Array, Array]:
        """Return p (times, points) at energies x > 0 in the elements, and the size of its terms.

        Or u = p/T, with ``of_state``: by its own, as T vanishes at H = 0.
        """
        log_pi = (log_phase_density if of_state else log_density)(self.process, self.elements, x)
        factor = np.exp(log_pi - self._unit(x))
        p, size = np.zeros((2, self.times.size, x.size))
        for contour, f in self.parts:
            g = chain.values(self.elements, f, x, turned=True).T
            factors = contour.factors
            p[contour.index] = (factors @ g).imag * factor
            size[contour.index] = np.abs(factors) @ np.abs(g) * factor
        return p, size

    def _unit(self, x: Array) -> Array:
        return np.asarray(self.elements.log_scale[self.elements.element_of(x)])


def propagated(
    process: Process, e: Modes, source: Source, times: Array, *, more: int = 0
) -> Propagation:
    """Return the density at ``times`` > 0 after ``source``, ``more`` points on each contour."""
    at_ends, inner = source.load(e)
    turned = np.einsum("ew,ewv->ev", inner, e.diagonal[1])
    parts, residual = [], 0.0
    for c in contours(times, more=more):
        y = chain.admittances(e, c.z)
        f = chain.resolvent(e, y, at_ends, turned)
        residual = max(residual, chain.residual(e, y, f, at_ends, turned))
        parts.append((c, f))
    return Propagation(process, e, times, parts, residual)


def points(process: Process, e: Modes) -> tuple[Array, Array]:
    """Return points and weights (elements, points) that integrate π times a polynomial."""
    special = np.isin(e.left, np.array(process.nonsmooth))
    count = max(rule(e.degree, bool(s), 0).t.size for s in np.unique(special))
    x, w = np.zeros((2, e.count, count))
    for contact in np.unique(special):
        k, r = np.flatnonzero(special == contact), rule(e.degree, bool(contact), 0)
        h, size = (e.right[k] - e.left[k])[:, None], r.t.size
        x[k, :size], w[k, :size] = e.left[k, None] + h * r.t, h * r.weight
        x[k, size:] = x[k, size - 1 : size]
    return x, w
