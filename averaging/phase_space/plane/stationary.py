"""The stationary density of one mass by finite elements, and its marginals."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import count
from math import ceil

import numpy as np

from averaging.phase_space.densities import sides, solution_settings
from averaging.phase_space.marginals import marginal
from averaging.phase_space.plane.elements import (
    EXTRA_POINTS,
    Elements,
    assemble_backward,
    panel_functions,
)
from averaging.phase_space.plane.first_passage import CHANCE_SHARE
from averaging.phase_space.plane.mesh import Mesh, energy_mesh
from averaging.phase_space.plane.oscillator import HIGHER, TRIALS, Oscillator, rarest_energy
from averaging.phase_space.refinement import (
    DENSITY_ROUND_OFF,
    SLOWEST_FALL,
    Ladder,
    Options,
    solution_distance,
)
from fpk.answer.certificate import DISTANCE_FACTOR
from fpk.answer.names import Coordinate, Observable
from fpk.numeric.arrays import Array
from fpk.numeric.errors import NotCertified
from fpk.numeric.quadrature import panel_rule

MOST_POINTS = 1_000_000
"""Largest number of points at which a density is evaluated at once."""
PANEL, FINER = 0.2, 0.72
"""Length of the panels of the first level over the largest speed; ratio of successive lengths."""
BYTES, OPERATIONS = 1.3e4, 4e5
"""Memory and operations of a solution over its number of unknowns: the factors have 60 entries for
each."""
OUTFLOW = 1e-10
"""Largest probability that passes the limit of the energy in a radian, or, in time, at all."""


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
        x, _ = m.coordinates(q.ravel(), np.zeros(q.size))
        row, a = panel_functions(m.x, m.degree, x, shared=0)
        of_s = np.einsum("pi,pik->pk", a, self.table[row])
        H = o.energy(q, v)
        assert m.energy is not None
        inside = m.energy > H
        v = np.where(q < 0.0, -v, v) if m.folded else v
        with np.errstate(divide="ignore", invalid="ignore"):
            s = np.where(inside, v / m.w(q), 0.0)
        column, b = panel_functions(m.s, m.degree, np.clip(s, m.s[0], m.s[-1]))
        number = np.arange(q.size).reshape((*q.shape, 1))
        u = np.sum(b * of_s[number, column], axis=-1)
        doubled = 0.5 if m.folded else 1.0
        return np.where(inside, doubled * u * np.exp(-o.psi(np.where(inside, H, 0.0))), 0.0)

    def rule(self, share: float = 1.0) -> tuple[Array, Array]:
        """Return displacements and weights of a Gauss rule on the panels of the mesh.

        ``share`` multiplies the number of points on a panel.
        """
        m = self.mesh
        x, w = panel_rule(m.x, ceil(share * (m.degree + EXTRA_POINTS)))
        q, slope = m.q(x)
        q, w = q.ravel(), (w * slope).ravel()
        return (np.append(-q[::-1], q), np.append(w[::-1], w)) if m.folded else (q, w)

    @cached_property
    def _measure(self) -> tuple[Array, Array, Array]:
        """Displacements (rows, 1), velocities and shares of the mass (rows, columns) of a rule."""
        m = self.mesh
        (q, of_q), s = self.rule(), panel_rule(m.s, m.degree + EXTRA_POINTS)
        w = m.w(q)[:, None]
        v = s[0].ravel() * w
        shares = self.density(q[:, None], v) * (of_q[:, None] * w * s[1].ravel())
        return q[:, None], v, shares

    def mean(self, function: Callable[[Array, Array], Array]) -> float:
        """Return the mean of a function of displacement and velocity."""
        q, v, shares = self._measure
        return float(np.sum(shares * function(q, v)))


def stationary_state(mesh: Mesh) -> PlaneState:
    """Return the density of motions that have never passed the limit of ``mesh``.

    It is the stationary density where the limit is so high that hardly any motion ever passes it.
    """
    e = assemble_backward(mesh)
    rate, y = e.slowest()
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
        s, weight = (a.ravel() for a in panel_rule(m.s, ceil(share * (m.degree + EXTRA_POINTS))))
        w = m.w(np.clip(q, ends[0], ends[-1]))[..., None]
        return np.asarray(e.density(q[..., None], s * w) @ weight * w[..., 0])

    def of_p(p: Array) -> Array:
        q, weight = e.rule(share)
        return np.asarray(joint(q, p[..., None]) @ weight)

    pdf: dict[tuple[str, ...], Callable[..., Array]]
    pdf = {("q",): of_q, ("p",): of_p, ("q", "p"): joint, ("p", "q"): lambda p, q: joint(q, p)}
    return tuple(panels[kind] for kind in kinds), pdf[tuple(kinds)]


@solution_settings.register
def _(e: PlaneState) -> dict[str, str | float | int]:
    o = e.mesh.oscillator
    _, damped, fed = sides(e)[0]
    return {
        "solver": "fem",
        "solved_by": "finite elements in the plane of displacement and momentum",
        "unknowns": e.unknowns,
        "degree": e.mesh.degree,
        "limit of the energy": e.mesh.energy or np.inf,
        "rate of passing it": e.outflow,
        "E q1²": e.mean(lambda q, v: q**2 + 0.0 * v),
        "E p1²": e.mean(lambda q, v: (o.mass * v) ** 2 + 0.0 * q),
        "net power of damping and noise on mass 1": fed - damped,
    }


@sides.register
def _(e: PlaneState) -> list[tuple[str, float, float]]:
    o = e.mesh.oscillator
    m, s = o.mass, np.sqrt(e.mean(lambda q, v: q**2 + 0.0 * v))

    def force(q: Array, v: Array) -> Array:
        return o.force(q) + o.drag(q, v) * v

    return [
        ("Σ c_ij E v_i v_j", e.mean(lambda q, v: o.drag(q, v) * v**2), o.noise / m),
        ("E p1²/m", e.mean(lambda q, v: m * v**2), e.mean(lambda q, v: q * force(q, v))),
        (
            "E v1² cos(q1/s)/s",
            e.mean(lambda q, v: v**2 * np.cos(q / s) / s),
            e.mean(lambda q, v: np.sin(q / s) * force(q, v) / m),
        ),
        ("E v1 sin(q1/s)", e.mean(lambda q, v: v * np.sin(q / s)), 0.0),
    ]


def plane_ladder_of(
    finest: PlaneState,
    coarser: PlaneState,
    observables: Sequence[Observable],
    before: Ladder | None = None,
    *,
    added: float = 0.0,
) -> Ladder:
    """Return the ladder of two solutions, the errors from the L1 distances of their densities.

    ``before`` is the ladder with ``coarser`` as its finer solution, or None. Distances that fall by
    a factor r < 2 from one mesh to the next leave an error of 1/(r − 1) of the last. ``added`` is a
    further L1 error.
    """
    ladder = Ladder(finest, coarser, {}, {}, {}, "", before.solutions + 1 if before else 2)
    single = [(Coordinate("q", 0),), (Coordinate("p", 0),)]
    least = CHANCE_SHARE * max(solution_distance(finest, coarser, one) for one in single)
    for one in observables:
        own = solution_distance(finest, coarser, one)
        ladder.believed[one] = max(own, least)
        error = DISTANCE_FACTOR * ladder.believed[one]
        if before and ladder.believed[one] > 0.0:
            rate = max(before.believed[one] / ladder.believed[one], SLOWEST_FALL)
            error *= max(1.0, 1.0 / (rate - 1.0))
        ladder.errors[one] = error + DENSITY_ROUND_OFF + added
        ladder.factors[one] = ladder.errors[one] / own if own > 0.0 else 0.0
    return ladder


def plane_ladder(
    o: Oscillator, observables: Sequence[Observable], options: Options
) -> Iterator[Ladder]:
    """Yield ladders of solutions on finer meshes; the last is yielded again with its ``limit``.

    Energies end where so little passes that the density does not feel it, and a little higher on
    each finer mesh, so that the difference of two solutions shows what is missing. Raises
    ``NotCertified`` if the density does not fall with the energy.
    """
    top, ladder = rarest_energy(o), None
    for _ in range(TRIALS):
        coarser = stationary_state(energy_mesh(o, top, 0, PANEL))
        if coarser.outflow < OUTFLOW * o.frequency:
            break
        top *= HIGHER
    else:
        raise NotCertified("the density does not fall with the energy")
    for level in count(1):
        mesh = energy_mesh(o, top * HIGHER ** (level / TRIALS), level, PANEL * FINER**level)
        unknowns = (mesh.x.size - 1) * (mesh.degree + 1) * (mesh.s.size - 1) * mesh.degree
        limit = options.refusal(BYTES * unknowns, OPERATIONS * unknowns)
        if ladder is not None and limit:
            break
        options.step(f"phase space, {unknowns} unknowns")(0.0)
        finest = stationary_state(mesh)
        ladder = plane_ladder_of(finest, coarser, observables, ladder)
        yield ladder
        coarser = finest
    assert ladder is not None
    yield replace(ladder, limit=limit)
