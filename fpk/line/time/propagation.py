"""A density of one energy carried along in time, by inverse transforms of the resolvent."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np

from fpk.arrays import EPS, Array, Complexes
from fpk.contour import Contour, contours
from fpk.line.time import chain
from fpk.line.time.mesh import GROWTH, HIGHEST, rule, time_nodes
from fpk.line.time.modes import Modes, log_density, log_phase_density, modes
from fpk.probe import probed
from fpk.process import Process

Part = tuple[Contour, chain.Solution]
"""Solutions at the Laplace variables of a contour."""


@dataclass(frozen=True, eq=False)
class Source:
    """Initial density of a transient: at one energy, or the stationary one of another process."""

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
class Solution:
    """Densities at several times on one mesh, however they are computed.

    ``times_factor`` gives p/π times a factor, (times, points), and the size of its terms: of the
    ln of the factor at energies x > 0 in the elements, and these. ``residual`` is the largest of
    the equations solved, relative to the terms that cancel.
    """

    process: Process
    elements: Modes
    times_factor: Callable[[Array, Array], tuple[Array, Array]]
    residual: float

    def density(self, x: Array) -> tuple[Array, Array]:
        """Return p (times, points) at energies x > 0 in the elements, and the size of its terms."""
        return self.times_factor(log_density(self.process, self.elements, x), x)

    def state_density(self, x: Array) -> tuple[Array, Array]:
        """Return u = p/T likewise, by its own: T vanishes at H = 0."""
        return self.times_factor(log_phase_density(self.process, self.elements, x), x)


def transforms(
    e: Modes, source: Source, times: Array, *, more: int = 0, absorbing: bool = False
) -> tuple[list[Part], float]:
    """Return the transform of p/π on contours for ``times`` > 0 after ``source``, and its residual.

    There are ``more`` points on each contour. No flux leaves at the last end, or it absorbs.
    """
    at_ends, inner = source.load(e)
    turned = np.einsum("ew,ewv->ev", inner, e.diagonal[1])
    parts, residuals = [], [0.0]
    for c in contours(times, more=more):
        y = chain.admittances(e, c.z)
        f = chain.resolvent(e, y, at_ends, turned, absorbing=absorbing)
        residuals.append(chain.residual(e, y, f, at_ends, turned))
        parts.append((c, f))
    return parts, float(np.max(residuals))


def inverted(
    parts: Sequence[Part], value: Callable[[chain.Solution], Complexes], *shape: int
) -> tuple[Array, Array]:
    """Return what has the transform ``value`` (Laplace variables, …), and the size of its terms.

    Both are of ``shape``, times first.
    """
    p, size = np.zeros((2, *shape))
    for c, f in parts:
        g, factors = value(f), c.factors
        p[c.index], size[c.index] = (factors @ g).imag, np.abs(factors) @ np.abs(g)
    return p, size


def values_at(e: Modes, x: Array, f: chain.Solution) -> Complexes:
    """Return a solution at points x of the elements, (Laplace variables, points)."""
    return np.asarray(chain.values(e, f, x, turned=True).T)


def propagated(
    process: Process, e: Modes, source: Source, times: Array, *, more: int = 0
) -> Solution:
    """Return the density at ``times`` > 0 after ``source``, ``more`` points on each contour."""
    parts, residual = transforms(e, source, times, more=more)

    def times_factor(log_factor: Array, x: Array) -> tuple[Array, Array]:
        factor = np.exp(log_factor - e.log_scale[e.element_of(x)])
        p, size = inverted(parts, partial(values_at, e, x), times.size, x.size)
        return p * factor, size * factor

    return Solution(process, e, times_factor, residual)


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
