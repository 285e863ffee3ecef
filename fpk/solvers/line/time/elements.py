"""Finite elements of one energy in time, coupled at their ends only.

With the stationary density π and m = ½ b π the generator is L f = (m f')'/π, and its weak form
−∫ m f' v' is symmetric. Each element has two kinds of functions (Craig and Bampton, AIAA J. 6
(1968) 1313): h_0 and h_1 = 1 − h_0, equal to 1 at its left and right end, and v_j, zero at both
ends, orthogonal to h_0 and h_1 in m and to each other in m and in π. The elements then form a chain
of conductances 1/∫dx/m, and every sum along it has positive terms only: a probability of 1e-200 has
relative accuracy. Elements come in pairs, for the answer and for the enriched solution, of a higher
degree, whose distance estimates the error.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, fields
from functools import cached_property, lru_cache
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.polynomial.legendre import legint, legvander
from numpy.typing import ArrayLike
from scipy.special import roots_jacobi

from fpk.numeric.arrays import Array, Flags, Integers
from fpk.numeric.quadrature import gauss_legendre
from fpk.solvers.line.elements import ENRICHMENT
from fpk.solvers.line.mesh import MAX_ELEMENT_DEGREE, first_degree, split_points
from fpk.solvers.plane.elements import shape_functions
from fpk.system.process import Coefficients, Process, log_density_slope_error

MOST_ROUNDS, MOST_ELEMENTS = 12, 1_000
"""Largest number of meshes of one solution, and number of elements above which none is cut."""
TAIL_SHARES = (1e-3, 1e-8)
"""Masses beyond the meshes of the answer and of the enriched solution, over the L1 tolerance."""
Settings = dict[str, str | float | int]


@dataclass(frozen=True, eq=False)
class Elements:
    """Elements of one degree of a ``process``; the first axis of every array is the element.

    Elements go from ``left`` to ``right``, from H = 0 on. In each, π is e^``log_scale`` times a
    local density, in which the integrals are given. The columns of ``shapes`` (…, degree + 1,
    functions) are the coefficients of f = (h_0, h_1, v_j) in the ``shape_functions``; ``mass`` is
    ∫π f_i f_j, ``load`` ∫π f_i and ``drift`` ∫π F f_i' f_j, F the part of the drift due to damping.
    ``conductance`` is 1/∫dx/m, ∫m v_j'² = 1 and ``relaxation`` is ∫π v_j². Zero flux at H = 0 is
    natural: in the first element h_0 = 0, h_1 = 1, the conductance is 0, and v_j(0) is free; it may
    have fewer v_j, and the others are 0. Σ ``weight`` f(``x``), (…, points), is ∫f dH for f = π
    times a polynomial.
    ``log_rise`` (…, terms) is a Legendre series of ln π/T, less its value at the left end, in ∛t in
    an element that begins at ``contact`` and in t elsewhere, t from 0 to 1; ``log_local`` is
    ln of the largest π, over π/T at the left end. ``relative_error`` is the error of π and m by the
    coefficients, ``slope_error`` the resulting error of ln π from one end to the other.
    """

    process: Process
    left: Array
    right: Array
    contact: Flags
    shapes: Array
    mass: Array
    load: Array
    relaxation: Array
    drift: Array
    conductance: Array
    x: Array
    weight: Array
    log_local: Array
    log_rise: Array
    relative_error: Array
    slope_error: Array

    @property
    def count(self) -> int:
        """Number of elements."""
        return self.left.size

    @property
    def degree(self) -> int:
        """Degree of the polynomials."""
        return int(self.shapes.shape[1]) - 1

    @property
    def nodes(self) -> Array:
        """Ends of the elements, (elements + 1,)."""
        return np.append(self.left, self.right[-1])

    @cached_property
    def log_u(self) -> Array:
        """ln(π/T) at the nodes, (elements + 1,), 0 at H = 0; π is the stationary density."""
        return np.append(0.0, np.cumsum(self.log_rise.sum(axis=1)))

    @cached_property
    def log_scale(self) -> Array:
        """ln of the unit in which π is given in each element, (elements,)."""
        return self.log_u[:-1] + self.log_local

    @cached_property
    def steps(self) -> Array:
        """Unit of π in each element but the last, over the unit in the next, (elements − 1,)."""
        return np.exp(-np.diff(self.log_scale))

    @cached_property
    def log_mass(self) -> Array:
        """ln of the stationary mass ∫π in each element, (elements,), with π/T = 1 at H = 0."""
        return np.asarray(self.log_scale + np.log(self.load[:, :2].sum(axis=1)))

    @property
    def log_range(self) -> float:
        """ln of the largest ratio of the units of π in two elements."""
        return float(np.ptp(self.log_scale))

    def coefficient_error(self, upto: float = 0.0) -> float:
        """Return the relative error of densities and rates by the errors of the coefficients.

        Each element is weighted by its share of the mass, and of the distance ∫dH/√b up to the
        energy ``upto`` or through all but 1e-6 of the mass, the longer of both: short elements near
        a contact energy have large errors.
        """
        mass = np.exp(self.log_mass - np.logaddexp.reduce(self.log_mass))
        bulk = (mass[::-1].cumsum()[::-1] > 1e-6) | (self.left < upto)
        way = np.sqrt(self.relaxation.sum(axis=1))
        weights = mass + way / way[bulk].sum()
        return float(weights @ self.relative_error + self.slope_error.sum())

    def within(self, x: Array) -> tuple[Integers, Array]:
        """Return the element of each point ``x`` (points,), at a node the element on its right, and
        its local coordinate, 0 to 1; a point outside has the nearest end."""
        k = np.clip(np.searchsorted(self.nodes, x, side="right") - 1, 0, self.count - 1)
        return k, np.clip((x - self.left[k]) / (self.right[k] - self.left[k]), 0.0, 1.0)

    def functions(self, x: Array) -> tuple[Integers, Array]:
        """Return the element of each point ``x`` (points,), and the values of its functions h_0,
        h_1, v_j there, (points, functions)."""
        k, t = self.within(x)
        return k, np.einsum("px,xpi->xi", shape_functions(self.degree, t)[0], self.shapes[k])

    def at(self, x: Array, f: Array, size: Array | None = None) -> tuple[Array, Array]:
        """Return the function of coefficients ``f`` (…, elements, functions) at ``x``, (…, points),
        and the sum of the sizes of its terms. ``size``, if given, replaces |``f``| in that sum."""
        k, values = self.functions(x)

        def summed(a: Array, v: Array) -> Array:
            every = [np.einsum("xi,xi->x", each[k], v) for each in a.reshape(-1, *f.shape[-2:])]
            return np.array(every).reshape(*f.shape[:-2], x.size)

        return summed(f, values), summed(np.abs(f) if size is None else size, np.abs(values))

    def log_density(self, x: Array, *, of_states: bool = False) -> Array:
        """Return ln π, or ln(π/T) if ``of_states``, at ``x`` > 0 (points,). π/T is 1 at H = 0, and
        constant beyond the last node."""
        k, t = self.within(x)
        s = np.where(self.contact[k], np.cbrt(t), t)
        series = legvander(2.0 * s - 1.0, self.log_rise.shape[1] - 1)
        log_u = self.log_u[k] + (series * self.log_rise[k]).sum(axis=1)
        log_T = 0.0 if of_states else self.process.coefficients(x).log_density_of_states
        return np.asarray(log_u + log_T)


Answer = TypeVar("Answer")
Pair = tuple[Elements, Elements]
"""The elements of the answer and of the enriched solution."""


class ChainDensity(NamedTuple):
    """Coefficients of p/π, or of a backward solution, on ``elements`` at several times.

    ``values`` (times, elements, functions) are in the units 1/e^``log_scale`` of the elements for a
    density p, else in one unit; ``size``, of the same shape, are the sums of the sizes of the terms
    of which they are computed. ``residual`` is the largest relative residual of the equations.
    """

    elements: Elements
    values: Array
    size: Array
    residual: float

    def density(self, x: Array, *, of_states: bool = False) -> tuple[Array, Array]:
        """Return p, or p/T if ``of_states``, at ``x`` > 0 (points,), and the sum of the sizes of
        its terms, (times, points) each. The solution must be a density; beyond the last node it
        is continued with constant p/T, not 0."""
        e = self.elements
        p, size = e.at(x, self.values, self.size)
        factor = np.exp(e.log_density(x, of_states=of_states) - e.log_scale[e.within(x)[0]])
        return p * factor, size * factor


@lru_cache
def rule(degree: int, contact: bool, steepness: int) -> tuple[Array, ...]:
    """Return the quadrature of an element of ``degree`` on [0, 1], with ``contact`` from 0 on.

    Returned are points t and weights; Legendre polynomials of s at the points (points, terms); the
    matrix (terms, points) from values to the Legendre series of their integral from 0 to t; the
    ``shape_functions`` and their slopes (points, degree + 1). The points are Gauss points of s,
    with s = ∛t at contact, as π is smooth in ∛(H − H_c), and s = t elsewhere. For π ~ t^k,
    k = ``steepness`` > 7, without contact they are Gauss-Jacobi points, and the integral from 0 to
    t is t times the mean of the values.
    """
    count = 3 * degree + 8 if contact else degree + 6
    steep = steepness > 7 and not contact
    x, w = roots_jacobi(count, 0, steepness) if steep else gauss_legendre(count)
    s = 0.5 * (1.0 + x)
    t, stretch = (s**3, 3.0 * s**2) if contact else (s, np.ones(count))
    project = (np.arange(count) + 0.5)[:, None] * (legvander(x, count - 1).T * w)
    integral = 0.5 * np.asarray(legint(project, lbnd=-1.0)) * stretch
    weight = 0.5 * w * stretch
    if steep:
        weight = np.exp(np.log(w) - (steepness + 1) * np.log(2.0) - steepness * np.log(t))
        integral[:] = np.eye(count + 1, 2).sum(axis=1, keepdims=True) * 0.5 / count
    values, slopes = shape_functions(degree, t)
    series = np.asarray(legvander(x, count), dtype=float)
    return t, weight, series, integral, values.T, slopes.T


def chain_elements(
    process: Process, left: Array, right: Array, degree: int, *, enriched: bool = False
) -> Elements:
    """Return the elements of ``degree`` for ``process`` from ``left`` to ``right``, ascending
    (elements,). At H = 0 the degree may be lower, and is then one higher if ``enriched``."""
    kind = np.isin(left, process.nonsmooth) + 2 * (left == 0.0)
    alike = [np.flatnonzero(kind == k) for k in np.unique(kind)]
    own = [_elements_of_kind(process, left[k], right[k], degree, enriched=enriched) for k in alike]
    order, (_, *names) = np.argsort(np.concatenate(alike)), (x.name for x in fields(Elements))
    columns = (np.concatenate([getattr(part, name) for part in own])[order] for name in names)
    return Elements(process, *columns)


def _elements_of_kind(
    process: Process, left: Array, right: Array, degree: int, *, enriched: bool
) -> Elements:
    """Elements of ``degree`` from ``left`` to ``right`` (elements,), of one kind: they begin at
    H = 0, or all at contact energies, or all elsewhere. For ``enriched`` see ``chain_elements``."""
    n, first = process.degrees_of_freedom, left[0] == 0.0
    contact = bool(left[0] in process.nonsmooth)
    t, w, series, integral, values, derivatives = rule(degree, contact, n - 1 if first else 0)
    h = (right - left)[:, None]
    x = left[:, None] + h * t
    flat = process.coefficients(x.ravel())
    c = Coefficients(*(np.broadcast_to(a, x.size).reshape(x.shape) for a in flat))
    slope = 2.0 * c.dissipation / c.diffusion
    if not process.state_damping:
        slope = np.broadcast_to(np.median(slope, axis=1, keepdims=True), x.shape)
    log_rise = h * (slope @ integral.T)
    log_density = c.log_density_of_states + log_rise @ series.T
    log_local = log_density.max(axis=1)
    weight = h * w * np.exp(log_density - log_local[:, None])
    # The functions that vanish at both ends, then the function of the right end.
    own = min(first_degree(degree - 1, n) + enriched, degree - 1) if first else degree - 1
    inner = [0, *range(2, own + 1)] if first else [*range(2, degree + 1)]
    slopes = derivatives[:, [*inner, 1]] / h[:, :, None]
    half = np.sqrt(0.5 * c.diffusion * weight)
    R: Array = np.asarray(np.linalg.qr(half[:, :, None] * slopes, mode="r"), dtype=float)
    inverse = np.linalg.inv(R[:, :own, :own])
    v = values[:, inner] @ inverse
    turn = np.linalg.eigh(np.swapaxes(v, 1, 2) @ (weight[:, :, None] * v))[1]
    shapes = np.zeros((left.size, degree + 1, degree + 1))
    shapes[:, inner, 2 : 2 + own] = inverse @ turn
    shapes[:, 1, 1] = 1.0
    # The constant has no slope: at H = 0 it is h_1.
    shapes[:, inner, 1] = np.eye(1, own) if first else -(inverse @ R[:, :own, own:])[:, :, 0]
    shapes[:, :2, 0] = 1.0
    shapes[:, :, 0] -= shapes[:, :, 1]
    f = values @ shapes
    slopes = np.swapaxes(derivatives @ shapes / h[:, :, None], 1, 2)
    steps = np.zeros(left.size)
    if process.state_damping:
        steps = (h * log_density_slope_error(c)) @ integral.sum(axis=0)
    # All kinds of elements get as many points and terms as the kind with most.
    more = rule(degree, bool(process.nonsmooth), 0)[0].size - t.size
    behind = np.zeros((left.size, more))
    mass = np.swapaxes(f, 1, 2) @ (weight[:, :, None] * f)
    return Elements(
        process=process,
        left=left,
        right=right,
        contact=np.full(left.size, contact),
        shapes=shapes,
        mass=mass,
        load=mass[:, :, 0] + mass[:, :, 1],
        relaxation=np.einsum("eii->ei", mass)[:, 2:],
        drift=slopes @ ((weight * c.dissipation)[:, :, None] * f),
        conductance=np.zeros(left.size) if first else R[:, own, own] ** 2,
        x=np.hstack([x, behind + x[:, -1:]]),
        weight=np.hstack([h * w, behind]),
        log_local=log_local,
        log_rise=np.hstack([log_rise, behind]),
        relative_error=c.relative_error.max(axis=1),
        slope_error=steps,
    )


def degree_for(tol: float) -> int:
    """Return the degree of elements for the tolerance ``tol``: its digits, 4 to 12, plus 4."""
    return int(np.clip(round(-math.log10(tol)), 4, MAX_ELEMENT_DEGREE - 4)) + 4


def element_pair(process: Process, nodes: Array, degree: int, *, beyond: ArrayLike = ()) -> Pair:
    """Return elements of ``degree`` between ``nodes``, and the elements of the enriched solution.

    The latter have ``degree`` + ``ENRICHMENT`` and the further nodes ``beyond`` the last.
    """
    every, finer = np.append(nodes, beyond), degree + ENRICHMENT
    answer = chain_elements(process, nodes[:-1], nodes[1:], degree)
    return answer, chain_elements(process, every[:-1], every[1:], finer, enriched=True)


def solve_with_refinement(pair: Pair, solve: Callable[[Pair], tuple[Answer, Flags]]) -> Answer:
    """Return the answer of ``solve(pair)`` on the first mesh of which it marks no element, or with
    more than ``MOST_ELEMENTS``, or after ``MOST_ROUNDS``. ``solve`` returns an answer and flags
    (elements,): which elements of the answer to cut in two for the next pair; ``pair`` is the
    first."""
    for _ in range(MOST_ROUNDS):
        answer, marked = solve(pair)
        if not marked.any() or marked.size > MOST_ELEMENTS:
            break
        e, every = pair[0], pair[1].nodes
        at = split_points(e.left[marked], e.right[marked], e.process.nonsmooth)
        nodes = np.sort(np.append(e.nodes, at))
        pair = element_pair(e.process, nodes, e.degree, beyond=every[e.count + 1 :])
    return answer
