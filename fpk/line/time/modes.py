"""Finite elements of one energy in their own modes: from them any linear question of time.

With the stationary density π and m = ½ b π the generator is L f = (m f')'/π, and its weak form
−∫ m f' v' is symmetric. A polynomial of an element is the sum of h_0 and h_1, which are one at its
left and right end and orthogonal in m to all that vanishes at both, and of functions v_j that do:
(Craig and Bampton, AIAA J. 6 (1968) 1313). The elements then hang together at their ends alone,
as conductances 1/∫dx/m in a chain, and every sum along it has positive terms only: what is as
rare as 1e-200 keeps its relative digits.
They come in pairs: the elements of the answer, and those of the enriched solution that judges it.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import cached_property

import numpy as np

from fpk.arrays import Array, Flags, Integers
from fpk.line.mesh import split_points
from fpk.line.time.mesh import HIGHEST, NONE, first_degree, rule
from fpk.piecewise import legendre_at
from fpk.process import Process, log_density_slope_error

BEYOND_BULK = 1e-6
"""Share of the mass beyond the bulk, which ends where errors are weighted."""
ENRICHMENT = 2
"""Degrees by which the enriched solution, of the error estimate, exceeds the answer."""
FEWEST_DIGITS, MORE = 4, 4
"""Digits below which elements have no lower degree, and degrees beyond the digits wanted."""
MOST_ROUNDS = 12
"""Most rounds of cutting elements in two."""


@dataclass(frozen=True, eq=False)
class Modes:
    """Elements of one ``degree``; every array has one entry for each of them, from H = 0 up.

    π is e^``log_scale`` times the local density in which all else is given: ``conductance``
    1/∫dx/m, ``load`` (…, 2) ∫π h_a, ``mass`` (…, 3) ∫π h_0², ∫π h_0 h_1, ∫π h_1², ``gram``
    (…, modes, modes) ∫π v_j v_k and ``coupling`` (…, modes, 2) ∫π v_j h_a, the v_j orthonormal in
    ∫m v'v'. ``series`` (…, degree + 1, 1 + modes) are Legendre coefficients of h_1 and the v_j. At
    H = 0 no flux is natural: in the first element h_0 = 0, h_1 = 1 and v_j(0) is free.
    ``relative_error`` is that of π and m by the coefficients; ``slope_error`` what it leaves in
    ln π from one end to the other. ``fall`` is ln u, u = π/T, at the right end less that at the
    left.
    """

    left: Array
    right: Array
    conductance: Array
    load: Array
    mass: Array
    gram: Array
    coupling: Array
    series: Array
    log_local: Array
    fall: Array
    relative_error: Array
    slope_error: Array

    @property
    def count(self) -> int:
        """Number of elements."""
        return self.left.size

    @property
    def degree(self) -> int:
        """Degree of the polynomials."""
        return int(self.series.shape[1]) - 1

    @property
    def nodes(self) -> Array:
        """Ends of the elements, (elements + 1,)."""
        return np.append(self.left, self.right[-1])

    @cached_property
    def log_u(self) -> Array:
        """ln u at the nodes, 0 at H = 0."""
        return np.append(0.0, np.cumsum(self.fall))

    @cached_property
    def log_scale(self) -> Array:
        """ln of the unit of π in each element."""
        return self.log_u[:-1] + self.log_local

    @cached_property
    def steps(self) -> Array:
        """Unit of π in each element but the last, divided by that in the next."""
        return np.exp(self.log_scale[:-1] - self.log_scale[1:])

    @cached_property
    def log_mass(self) -> Array:
        """ln ∫π over each element."""
        return np.asarray(self.log_scale + np.log(self.load.sum(axis=1)))

    @cached_property
    def log_total(self) -> float:
        """ln ∫π over all."""
        return float(np.logaddexp.reduce(self.log_mass))

    @cached_property
    def diagonal(self) -> tuple[Array, Array]:
        """ν (elements, modes) and the v_j turned so that ``gram`` is diag ν: coefficients of them.

        The second is (elements, modes, modes), one new function a column.
        """
        return np.linalg.eigh(self.gram)

    def coefficient_error(self, upto: float = 0.0) -> float:
        """Relative error that the coefficients leave in densities and rates.

        An element counts by its share of the mass and of the way through the bulk, in units of
        √b: near a contact energy errors are large on very short elements. ``upto`` is an energy
        that the way reaches at least.
        """
        mass = np.exp(self.log_mass - self.log_total)
        bulk = (mass[::-1].cumsum()[::-1] > BEYOND_BULK) | (self.left < upto)
        way = np.sqrt(np.trace(self.gram, axis1=1, axis2=2))
        weights = mass + way / way[bulk].sum()
        return float(weights @ self.relative_error + self.slope_error.sum())

    def element_of(self, x: Array) -> Integers:
        """Elements that hold the points x."""
        return np.clip(np.searchsorted(self.nodes, x, side="right") - 1, 0, self.count - 1)

    def shapes(self, x: Array) -> tuple[Integers, Array, Array]:
        """Elements of the points x, h_1 (points,) there and the v_j (points, modes)."""
        k, P = legendre_at(self.nodes, x, self.degree)
        f = np.einsum("xp,xpv->xv", P, self.series[k])
        return k, f[:, 0], f[:, 1:]


Pair = tuple[Modes, Modes]
"""The elements of the answer and of the enriched solution."""


def modes(
    process: Process, left: Array, right: Array, degree: int, *, enriched: bool = False
) -> Modes:
    """Return the elements between ``left`` and ``right`` (elements,), sorted.

    The element at H = 0 may be of a lower degree; ``enriched`` has it one higher.
    """
    contact, first = np.isin(left, np.array(process.nonsmooth)), left == 0.0
    parts = []
    for kind in ((True, True), (True, False), (False, True), (False, False)):
        k = np.flatnonzero((first == kind[0]) & (contact == kind[1]))
        if k.size:
            parts.append(_batch(process, left[k], right[k], degree, *kind, enriched))
    return joined(parts)


def joined(parts: Sequence[Modes]) -> Modes:
    """Return all elements in one record, ascending."""
    order = np.argsort(np.concatenate([part.left for part in parts]))
    arrays = (np.concatenate([getattr(part, f.name) for part in parts]) for f in fields(Modes))
    return Modes(*(array[order] for array in arrays))


def refined(process: Process, e: Modes, marked: Flags, *, enriched: bool = False) -> Modes:
    """Return the elements with those ``marked`` cut in two, towards a point that is singular."""
    left, right = e.left[marked], e.right[marked]
    special = np.array([0.0, *process.nonsmooth])
    cut = split_points(left, right, special)
    ends = np.append(left, cut), np.append(cut, right)
    new = modes(process, *ends, e.degree, enriched=enriched)
    return joined([Modes(*(getattr(e, f.name)[~marked] for f in fields(Modes))), new])


def log_density(process: Process, e: Modes, x: Array) -> Array:
    """Return ln π at points x > 0 within the elements, in the unit of ``Modes.log_scale``."""
    return np.asarray(
        process.coefficients(x).log_density_of_states + log_phase_density(process, e, x)
    )


def log_phase_density(process: Process, e: Modes, x: Array) -> Array:
    """Return ln u = ln π/T at points x > 0 within the elements, 0 at H = 0."""
    k = e.element_of(x)
    log_u = e.log_u[k]
    if not process.state_damping:
        return np.asarray(log_u + e.fall[k] * (x - e.left[k]) / (e.right[k] - e.left[k]))
    for contact in (True, False):
        at = np.flatnonzero(np.isin(e.left[k], np.array(process.nonsmooth)) == contact)
        if at.size:
            r, base = rule(e.degree, contact, 0), e.left[k][at, None]
            h = x[at, None] - base
            c = process.coefficients((base + h * r.t).ravel())
            slope = (2.0 * c.dissipation / c.diffusion).reshape(at.size, -1)
            log_u[at] += h[:, 0] * (slope @ r.total)
    return np.asarray(log_u)


def _batch(
    process: Process, left: Array, right: Array, degree: int, first: bool, contact: bool,
    enriched: bool,
) -> Modes:  # fmt: skip
    n = process.degrees_of_freedom
    r = rule(degree, contact, n - 1 if first else 0)
    h = (right - left)[:, None]
    x = left[:, None] + h * r.t
    flat = process.coefficients(x.ravel())
    b, F, log_T, error = (
        np.broadcast_to(a, flat.drift.shape).reshape(x.shape)
        for a in (flat.diffusion, flat.dissipation, flat.log_density_of_states, flat.relative_error)
    )
    slope = 2.0 * F / b
    if not process.state_damping:
        slope = np.broadcast_to(np.median(slope, axis=1, keepdims=True), x.shape)
    log_density = log_T + h * (slope @ r.running.T)
    log_local = log_density.max(axis=1)
    density = np.exp(log_density - log_local[:, None])
    half = np.sqrt(0.5 * b * density * r.weight / h)  # √(m dt/h): of slopes in t
    count = degree - 1
    if first:
        own = min(first_degree(count, n) + enriched, count)  # other functions are left at zero
        columns = r.values[:, :own]
    else:
        own, columns = count, np.roll(r.values[:, :degree], -1, axis=1)
    R: Array = np.asarray(np.linalg.qr(half[:, :, None] * columns, mode="r"), dtype=float)
    inverse = np.linalg.inv(R[:, :own, :own])
    slopes = np.zeros((left.size, degree, 1 + count))
    if first:
        slopes[:, :own, 1 : 1 + own] = inverse
    else:
        slopes[:, 1:, 1:] = inverse
        slopes[:, 0, 0] = 1.0
        slopes[:, 1:, 0] = -np.einsum("eij,ej->ei", inverse, R[:, :own, own])
    series = r.antiderivative @ slopes
    if first:
        series[:, 0] -= series.sum(axis=1)  # v_j = 0 at the right end
        series[:, 0, 0] = 1.0
    f = np.einsum("qp,epv->eqv", r.values, series)
    weight = h * r.weight * density
    h1, v = f[:, :, 0], f[:, :, 1:]
    h0 = np.zeros_like(h1) if first else 1.0 - h1
    weighted = weight[:, :, None] * v
    conductance = np.zeros(left.size) if first else R[:, own, own] ** 2
    steps = np.zeros(left.size)
    if process.state_damping:
        steps = (h * log_density_slope_error(flat).reshape(x.shape)) @ r.total
    return Modes(
        left=left,
        right=right,
        conductance=conductance,
        load=np.stack([(weight * h0).sum(axis=1), (weight * h1).sum(axis=1)], axis=1),
        mass=np.stack([(weight * a * b).sum(axis=1) for a, b in ((h0, h0), (h0, h1), (h1, h1))], 1),
        gram=np.swapaxes(weighted, 1, 2) @ v,
        coupling=np.einsum("eqv,aeq->eva", weighted, np.stack([h0, h1])),
        series=series,
        log_local=log_local,
        fall=h[:, 0] * (slope @ r.total),
        relative_error=error.max(axis=1),
        slope_error=steps,
    )


def degree_for(tol: float) -> int:
    """Return the degree of the elements of an answer to the tolerance ``tol``."""
    return int(np.clip(round(-math.log10(tol)), FEWEST_DIGITS, HIGHEST - MORE)) + MORE


def meshed(process: Process, nodes: Array, degree: int, *, beyond: Array = NONE) -> Pair:
    """Return elements between ``nodes``; those of the enriched solution end at ``beyond``, too."""
    every = np.append(nodes, beyond)
    return (
        modes(process, nodes[:-1], nodes[1:], degree),
        modes(process, every[:-1], every[1:], degree + ENRICHMENT, enriched=True),
    )


def cut(process: Process, pair: Pair, marked: Flags) -> Pair:
    """Return a pair with the elements of the answer that are ``marked`` cut in two in both."""
    more = np.append(marked, np.zeros(pair[1].count - marked.size, dtype=bool))
    return refined(process, pair[0], marked), refined(process, pair[1], more, enriched=True)
