"""The stationary density of one mass by finite elements, and its marginals."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import ceil
from typing import TypeVar

import numpy as np
from numpy.polynomial.legendre import legvander

from averaging.phase_space.densities import sides, solution_settings
from averaging.phase_space.marginals import marginal
from averaging.phase_space.plane.elements import (
    POINTS,
    Elements,
    assemble_backward,
    panel_functions,
    to_lobatto,
)
from averaging.phase_space.plane.mesh import Mesh, energy_mesh
from averaging.phase_space.plane.oscillator import HIGHER, TRIALS, Oscillator, rarest_energy
from averaging.phase_space.refinement import (
    DENSITY_ROUND_OFF,
    DISTANCE_SAFETY,
    LEAST_SHARE,
    SLOWEST_FALL,
    Ladder,
    Options,
    solution_distance,
)
from fpk.answer.names import Coordinate, Observable
from fpk.numeric.arrays import Array
from fpk.numeric.errors import NotCertified
from fpk.numeric.quadrature import gauss_legendre, panel_rule

MOST_POINTS = 1_000_000
"""Largest number of points at which a density is evaluated at once."""
PANEL, FINER = 0.25, 0.72
"""Length of the panels of the first level over the largest speed; in time, ratio of the lengths of
successive levels."""
FASTEST_FALL = 8.0
"""Largest factor by which an error is taken to be below that of the coarser solution: then
``DISTANCE_SAFETY`` covers 1.5 times the largest of 104 errors, without bound a quarter of it."""
BYTES, OPERATIONS = 1.3e4, 4e5
"""Memory and operations of a solution over its number of unknowns: the factors have 60 entries for
each."""
OUTFLOW = 1e-10
"""Largest probability that may pass the limit of the energy."""
RESOLVED = 0.1
"""Largest unresolved part of a density whose square bounds the error of its outflow."""


Solution = TypeVar("Solution")


@dataclass(frozen=True, eq=False)
class PlaneState:
    """A density of (q, v) within the limit of the energy of ``mesh``, by elements.

    ``table`` are the coefficients (functions of x, functions of s) of its ratio to the weight
    exp(−Ψ(H)). ``unknowns`` of the equations; of a stationary density ``residual`` is that of its
    equation relative to the terms that cancel in it, and ``outflow`` the rate at which mass passes
    the limit; of a density in time None and NaN.
    """

    mesh: Mesh
    table: Array
    unknowns: int
    residual: float | None = None
    outflow: float = np.nan

    def density(self, q: Array, v: Array) -> Array:
        """Return the density of displacement and velocity (...), which broadcast; 0 beyond the
        limit."""
        m, o = self.mesh, self.mesh.oscillator
        axes = max(q.ndim, v.ndim)
        q, v = (a.reshape((*(axes - a.ndim) * (1,), *a.shape)) for a in (q, v))
        if np.broadcast(q, v).size > MOST_POINTS and max(len(q), len(v)) > 1:
            halves = [np.array_split(a, 2) if len(a) > 1 else [a, a] for a in (q, v)]
            return np.concatenate(list(map(self.density, *halves)))
        of_s = self.along(q.ravel())
        H = o.energy(q, v)
        assert m.energy is not None
        inside = m.energy > H
        column, b = panel_functions(m.s, m.degree, m.coordinates(q, v)[1])
        number = np.arange(q.size).reshape((*q.shape, 1))
        u = np.sum(b * of_s[number, column], axis=-1)
        return np.where(inside, u * np.exp(-o.psi(np.where(inside, H, 0.0))), 0.0)

    def along(self, q: Array) -> Array:
        """Return the coefficients (..., functions of s) of the ratio at displacements ``q``."""
        m = self.mesh
        x, _ = m.coordinates(q, np.zeros_like(q))
        row, a = panel_functions(m.x, m.degree, x, shared=0)
        # On a folded mesh the mass of the density is on half of the plane.
        of_s = np.einsum("...i,...ik->...k", a, self.table[row])
        return np.asarray(0.5 * of_s if m.folded else of_s)

    def values(self, share: float = 1.0) -> Array:
        """Return the functions of a panel at ``share`` of the Gauss points (points, degree + 1)."""
        t, _ = gauss_legendre(ceil(share * POINTS * self.mesh.degree))
        return panel_functions(np.array([-1.0, 1.0]), self.mesh.degree, t)[1]

    @cached_property
    def _measure(self) -> tuple[Array, Array, Array, Array]:
        """q, v, exp(−Ψ) dq dv, coefficients of the ratio; axes: panels of x, of s, points or
        functions of x, of s."""
        m, points = self.mesh, len(self.values())
        (x, of_x), (s, of_s) = (panel_rule(nodes, points) for nodes in (m.x, m.s))
        q, slope, of_x = (a[:, None, :, None] for a in (*m.q(x), of_x))
        v = s[:, None, :] * m.w(q)
        area = of_x * slope * m.w(q) * of_s[:, None, :]
        table = self.table.reshape(len(x), m.degree + 1, -1)[..., m.numbers_of_s].swapaxes(1, 2)
        return q, v, area * np.exp(-m.oscillator.psi(m.oscillator.energy(q, v))), table

    @cached_property
    def unresolved(self) -> tuple[Array, Array]:
        """L1 norms of the parts of the two highest degrees in x and in s, on the panels of each."""
        (*_, area, table), values, degree = self._measure, self.values(), self.mesh.degree
        t, _ = gauss_legendre(len(values))
        highest = legvander(t, degree)[:, -2:] @ to_lobatto(degree)[-2:]
        along, across = highest @ table @ values.T, values @ table @ highest.T
        return np.sum(np.abs(along) * area, (1, 2, 3)), np.sum(np.abs(across) * area, (0, 2, 3))

    @cached_property
    def lost(self) -> float:
        """Probability that passes the limit in the time in which the noise feeds the mean energy,
        about the relaxation time; 0 of a density in time."""
        o = self.mesh.oscillator
        return float(abs(np.nan_to_num(self.outflow)) * o.mass / o.noise * self.mean(o.energy))

    def mean(self, function: Callable[[Array, Array], Array]) -> float:
        """Return the mean of a function of displacement and velocity."""
        (q, v, area, table), values = self._measure, self.values()
        found = function(q, v)
        if self.mesh.folded:
            found = 0.5 * (found + function(-q, -v))
        return float(np.sum(values @ table @ values.T * area * found))


def stationary_state(mesh: Mesh) -> PlaneState:
    """Return the density of motions that have never passed the limit of ``mesh``.

    It is the stationary density where the limit is so high that hardly any motion ever passes it.
    """
    e = assemble_backward(mesh)
    rate, y = e.slowest
    residual = np.max(np.abs(e.K.T @ y - rate * (e.M.T @ y))) / np.max(abs(e.K).T @ np.abs(y))
    return state_of(e, y, residual=float(residual), outflow=rate)


def state_of(
    e: Elements, y: Array, *, residual: float | None = None, outflow: float = np.nan
) -> PlaneState:
    """Return the density with the coefficients ``y`` (unknowns,), see ``PlaneState``."""
    mesh = e.mesh
    table = np.zeros(((mesh.x.size - 1) * (mesh.degree + 1), mesh.functions_of_s))
    table.flat[e.free] = y / e.one
    return PlaneState(mesh, table, y.size, residual, outflow)


@marginal.register
def _(
    e: PlaneState, observable: Observable, *, share: float = 1.0
) -> tuple[tuple[Array, ...], Callable[..., Array]]:
    m, mass = e.mesh, e.mesh.oscillator.mass
    ends = m.q(m.x)[0]
    ends = np.unique(np.append(-ends, ends)) if m.folded else ends
    fastest = mass * float(np.max(m.w(ends)))
    panels = {"q": ends, "p": np.linspace(-fastest, fastest, 17)}
    kinds = [c.kind for c in observable]

    def joint(q: Array, p: Array) -> Array:
        return e.density(q, p / mass) / mass

    def of_q(q: Array) -> Array:
        values, w, o = e.values(share), m.w(q)[..., None, None], m.oscillator
        s, weight = panel_rule(m.s, len(values))
        area = weight * w * np.exp(-o.psi(o.energy(q[..., None, None], s * w)))
        ratio = e.along(q)[..., m.numbers_of_s] @ values.T
        return np.asarray(np.sum(ratio * area, axis=(-2, -1)))

    def of_p(p: Array) -> Array:
        x, weight = panel_rule(m.x, len(e.values(share)))
        q, slope = m.q(x.ravel())
        halves = [joint(side * q, p[..., None]) for side in ((-1.0, 1.0) if m.folded else (1.0,))]
        return np.asarray(sum(halves) @ (weight.ravel() * slope))

    pdf: dict[tuple[str, ...], Callable[..., Array]]
    pdf = {("q",): of_q, ("p",): of_p, ("q", "p"): joint, ("p", "q"): lambda p, q: joint(q, p)}
    return tuple(panels[kind] for kind in kinds), pdf[tuple(kinds)]


@solution_settings.register
def _(e: PlaneState) -> dict[str, str | float | int]:
    o = e.mesh.oscillator
    _, damped, fed = sides(e)[0]
    return {
        **e.mesh.settings(e.unknowns),
        "limit of the energy": e.mesh.energy or np.inf,
        "rate of passing it": e.outflow,
        "E q1²": e.mean(lambda q, v: q**2 + 0.0 * v),
        "E p1²": e.mean(lambda q, v: (o.mass * v) ** 2 + 0.0 * q),
        "net power of damping and noise on mass 1": fed - damped,
    }


@sides.register
def _(e: PlaneState) -> list[tuple[str, float, float]]:
    o, mean = e.mesh.oscillator, e.mean
    m, s = o.mass, np.sqrt(mean(lambda q, v: q**2 + 0.0 * v))

    def force(q: Array, v: Array) -> Array:
        return o.force(q) + o.drag(q, v) * v

    bent = mean(lambda q, v: v**2 * np.cos(q / s) / s)
    return [
        ("Σ c_ij E v_i v_j", mean(lambda q, v: o.drag(q, v) * v**2), o.noise / m),
        ("E p1²/m", mean(lambda q, v: m * v**2), mean(lambda q, v: q * force(q, v))),
        ("E v1² cos(q1/s)/s", bent, mean(lambda q, v: np.sin(q / s) * force(q, v) / m)),
        ("E v1 sin(q1/s)", mean(lambda q, v: v * np.sin(q / s)), 0.0),
    ]


def plane_ladder_of(
    finest: PlaneState,
    coarser: PlaneState,
    observables: Sequence[Observable],
    *,
    added: float = 0.0,
    solutions: int = 2,
) -> Ladder:
    """Return the ladder of two solutions, the errors from the L1 distances of their densities.

    An error is ``DISTANCE_SAFETY`` d/(r − 1), d the distance and r the factor by which the parts
    ``unresolved`` fall, from ``SLOWEST_FALL`` to ``FASTEST_FALL``, and ``added``, and ``lost``. A
    d below ``LEAST_SHARE`` of the larger distance of the densities of q and p is not believed.
    """
    ladder = Ladder(finest, coarser, {}, {}, {}, "", solutions)
    fine, coarse = (sum(float(part.sum()) for part in e.unresolved) for e in (finest, coarser))
    share = DISTANCE_SAFETY / (float(np.clip(coarse / fine, SLOWEST_FALL, FASTEST_FALL)) - 1.0)
    single = [(Coordinate("q", 0),), (Coordinate("p", 0),)]
    least = LEAST_SHARE * max(solution_distance(finest, coarser, one) for one in single)
    for one in observables:
        own = solution_distance(finest, coarser, one)
        ladder.believed[one] = max(own, least)
        ladder.errors[one] = share * ladder.believed[one] + DENSITY_ROUND_OFF + added + finest.lost
        ladder.factors[one] = max(ladder.errors[one] / own, 1.0) if own > 0.0 else 0.0
    return ladder


def uniform_solutions(
    o: Oscillator,
    top: float,
    panels: tuple[float, float],
    solve: Callable[[Mesh], tuple[Solution, bool]],
    options: Options,
) -> Iterator[tuple[Solution, str]]:
    """Yield solutions on finer meshes, and why there is no finer one, "" if there is.

    All panels become shorter: what changes in time may vary where the stationary density does not.
    ``panels`` are their first length over the largest speed, and the ratio of successive lengths.
    Energies end at ``top``, or higher if ``solve`` says that too much passes there, and higher on
    each finer mesh. Raises ``NotCertified`` if too much passes at ``HIGHER`` to the power
    ``TRIALS`` of ``top``.
    """
    highest, level, limit, (first, finer) = top * HIGHER**TRIALS, 0, "", panels
    while not limit:
        mesh = energy_mesh(o, top, level, first * finer**level)
        solution, passes = solve(mesh)
        if not passes:
            size = mesh.unknowns / finer**2
            limit = options.refusal(BYTES * size, OPERATIONS * size) if level else ""
            yield solution, limit
            level += 1
        elif top > highest:
            raise NotCertified("the density does not fall with the energy")
        top *= HIGHER if passes else HIGHER ** (1.0 / TRIALS)


def plane_ladder(
    o: Oscillator, observables: Sequence[Observable], options: Options
) -> Iterator[Ladder]:
    """Yield ladders of two solutions on refined meshes; the last is yielded again with its limit.

    The coarser is two degrees lower on the same mesh. Energies end where hardly any motion passes.
    Raises ``NotCertified`` as ``rarest_energy`` does.
    """
    top, trials, solutions, before = rarest_energy(o), 0, 0, np.inf
    mesh = energy_mesh(o, top, 0, PANEL)
    while True:
        finest = stationary_state(mesh)
        # A coarse mesh has an outflow of its own, which does not fall as the limit rises.
        rough = sum(float(part.sum()) for part in finest.unresolved)
        falls = OUTFLOW < finest.lost < before
        known = rough < RESOLVED and finest.lost > max(OUTFLOW, rough**2)
        if (falls or known) and trials < TRIALS:
            top, trials, before = HIGHER * top, trials + 1, finest.lost
            mesh = energy_mesh(o, top, 0, PANEL)
            continue
        options.step(f"phase space, {finest.unknowns} unknowns")(0.0)
        coarser = stationary_state(replace(finest.mesh, degree=mesh.degree - 2))
        solutions += 2
        ladder = plane_ladder_of(finest, coarser, observables, solutions=solutions)
        yield ladder
        mesh = finest.mesh.refined(*finest.unresolved)
        if limit := options.refusal(BYTES * mesh.unknowns, OPERATIONS * mesh.unknowns):
            yield replace(ladder, limit=limit)
            return
