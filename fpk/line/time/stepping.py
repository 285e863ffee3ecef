"""Densities of one energy in time under modulated noise, by implicit Runge-Kutta steps.

With noise e² times that of a reference and π that of the reference, p = π g has the flux
J = π ((1 − e²) F g − e² ½ b g'), F the part of the drift due to damping, so that
M ∂g/∂t = (−e² K + (1 − e²) C) g.
"""

from collections.abc import Iterator
from functools import lru_cache
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.polynomial.legendre import legder, legint, legvander
from scipy.sparse import coo_array, csc_array, kron
from scipy.sparse.linalg import splu
from scipy.special import roots_jacobi

from fpk.arrays import Array, Integers
from fpk.line.time.modes import Modes, log_phase_density
from fpk.line.time.propagation import Source, points
from fpk.modulation import Modulation
from fpk.process import Process

STAGES = 5
"""Stages of a step of Radau IIA: of the order 2 · 5 − 1."""
FIRST = 1e-3
"""The first step, in units of the first time or kink of e: what it errs by is forgotten."""
RATIO = 3.0
"""Ratio of the ends of a step at the level 0, as long as steps grow with the time."""


class Matrices(NamedTuple):
    """M, K and C of the free functions, ``place`` of each element's h_0, h_1, v_j (−1: none).

    The functions are scaled to a mass of one: ``scale`` is ln of the factor on each.
    """

    M: csc_array
    K: csc_array
    C: csc_array
    place: Integers
    scale: Array


def matrices(process: Process, e: Modes, *, absorbing: bool = False) -> Matrices:
    """Return the matrices of the elements, which are of the reference noise.

    No flux leaves at the last end, or it absorbs.
    """
    x, w = points(process, e)
    c = process.coefficients(x.ravel())
    f, slope = _functions(e, x)
    log_u = log_phase_density(process, e, x.ravel())
    log_local = (c.log_density_of_states + log_u).reshape(x.shape) - e.log_scale[:, None]
    density = np.exp(log_local)
    F, b = (a.reshape(x.shape) for a in (c.dissipation, c.diffusion))
    M = np.einsum("eqi,eqj->eij", f * (w * density)[:, :, None], f)
    K = np.einsum("eqi,eqj->eij", slope * (0.5 * w * b * density)[:, :, None], slope)
    C = np.einsum("eqi,eqj->eij", slope * (w * F * density)[:, :, None], f)
    modes = f.shape[2] - 2
    place = np.empty((e.count, modes + 2), dtype=np.intp)
    place[:, 0], place[:, 1] = np.arange(-1, e.count - 1), np.arange(e.count)
    place[:, 2:] = e.count + np.arange(e.count * modes).reshape(e.count, modes)
    place[np.einsum("eii->ei", M) == 0.0] = -1
    if absorbing:
        place[-1, 1] = -1
    numbers = np.unique(place[place >= 0])
    place = np.where(place >= 0, np.searchsorted(numbers, place), -1)
    used = place >= 0
    log_mass = np.full((e.count, modes + 2), -np.inf)
    log_mass[used] = np.log(np.einsum("eii->ei", M)[used])
    log_mass += e.log_scale[:, None]
    scale = np.full(numbers.size, -np.inf)
    np.logaddexp.at(scale, place[used], log_mass[used])
    factor = np.where(used, np.exp(0.5 * (e.log_scale[:, None] - scale[place])), 0.0)
    pair = factor[:, :, None] * factor[:, None, :]
    rows, columns = (np.broadcast_to(p, pair.shape) for p in (place[:, :, None], place[:, None, :]))
    keep = (rows >= 0) & (columns >= 0)
    at, shape = (rows[keep], columns[keep]), (numbers.size, numbers.size)
    made = [csc_array(coo_array(((A * pair)[keep], at), shape)) for A in (M, K, C)]
    return Matrices(made[0], made[1], made[2], place, -0.5 * scale)


def _functions(e: Modes, x: Array) -> tuple[Array, Array]:
    """h_0, h_1, v_j and their derivatives at points (elements, points) of each element."""
    t = (2.0 * x - (e.left + e.right)[:, None]) / (e.right - e.left)[:, None]
    P = legvander(t, e.degree)
    D = P[..., :-1] @ legder(np.eye(e.degree + 1)) * (2.0 / (e.right - e.left))[:, None, None]
    f, slope = (np.einsum("eqp,epv->eqv", A, e.series) for A in (P, D))
    h, dh = 1.0 - f[:, :, :1], -slope[:, :, :1]
    h[0], dh[0] = 0.0, 0.0
    return np.concatenate([h, f], axis=2), np.concatenate([dh, slope], axis=2)


def start_of(m: Matrices, e: Modes, source: Source) -> Array:
    """Return the load of the start on the functions."""
    at_ends, inner = source.load(e)
    each = np.concatenate([at_ends, inner], axis=1)
    load, used = np.zeros(m.scale.size), m.place >= 0
    np.add.at(load, m.place[used], each[used])
    return load * np.exp(m.scale)


def shares_of(m: Matrices, e: Modes) -> Array:
    """Return ∫π f of the functions f: their product with g is the mass."""
    each, used = np.concatenate([e.load, e.coupling.sum(axis=2)], axis=1), m.place >= 0
    shares = np.zeros(m.scale.size)
    unit = np.exp(e.log_scale[:, None] + m.scale[m.place])
    np.add.at(shares, m.place[used], (each * unit)[used])
    return shares


class Step(NamedTuple):
    """A step: its ``end`` and ``length``, g at its stages (stages, functions), and a residual."""

    end: float
    length: float
    stages: Array
    residual: float


def stepped(
    m: Matrices, load: Array, modulation: Modulation, unit: float, times: Array, *, level: int
) -> tuple[Array, float]:
    """Return g (times, functions) at ``times`` > 0, and the residual of the equations of steps."""
    steps = steps_of(m, load, modulation, unit, times, level=level)
    rows = [(s.end, s.stages[-1], s.residual) for s in steps]
    ends, g, residuals = zip(*rows, strict=True)
    return np.array([g[ends.index(t)] for t in times.tolist()]), float(np.max(residuals))


def steps_of(
    m: Matrices, load: Array, modulation: Modulation, unit: float, times: Array, *, level: int
) -> Iterator[Step]:
    """Yield the steps from the start up to the last of ``times`` > 0.

    e² is in units of ``unit``, the reference's. Steps end at the times and at the kinks of e; there
    are 2^``level`` of them in each of the level 0.
    """
    A, c = radau(STAGES)
    eye = np.eye(STAGES)
    g, before = None, 0.0
    for end, step in _intervals(modulation, times, level):
        r = modulation(before + step * c) ** 2 / unit
        system = csc_array(
            kron(m.M, eye) + kron(m.K, step * A * r) - kron(m.C, step * A * (1.0 - r))
        )
        right = np.repeat(load if g is None else m.M @ g, STAGES)
        stages = splu(system).solve(right)
        size = float(np.max(abs(system) @ np.abs(stages)))
        missed = float(np.max(np.abs(system @ stages - right)))
        residual = missed / size if size > 0.0 else missed  # nothing is left where all is 0
        yield Step(end, step, stages.reshape(-1, STAGES).T, residual)
        g = stages[STAGES - 1 :: STAGES]
        before = end


def _intervals(modulation: Modulation, times: Array, level: int) -> list[tuple[float, float]]:
    """Ends and lengths of the steps: they grow like the time, and divide all intervals."""
    stops = np.unique(np.append(times, modulation.times[modulation.times < times[-1]]))
    stops = stops[stops > 0.0]
    ends = [0.0]
    first = FIRST * stops[0]
    grown = first * RATIO ** np.arange(0.0, np.ceil(np.log(stops[-1] / first) / np.log(RATIO)))
    for stop in stops.tolist():
        inner = grown[(grown > ends[-1] * (1.0 + FIRST)) & (grown < stop * (1.0 - FIRST))]
        ends += [*inner.tolist(), stop]
    parts = 2**level
    steps: list[tuple[float, float]] = []
    for a, b in pairwise(ends):
        inner = a + (b - a) * np.arange(1.0, parts + 1.0) / parts
        inner[-1] = b
        steps += [(float(x), (b - a) / parts) for x in inner]
    return steps


@lru_cache
def radau(stages: int) -> tuple[Array, Array]:
    """Return the coefficients a_ij and the points c_i of Radau IIA, the last of which is 1."""
    x = np.append(roots_jacobi(stages - 1, 1, 0)[0], 1.0)
    V = legvander(x, stages - 1)
    A = 0.5 * legvander(x, stages) @ legint(np.linalg.inv(V), lbnd=-1.0)
    return A, 0.5 * (1.0 + x)
