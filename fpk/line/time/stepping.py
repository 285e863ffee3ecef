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
from numpy.polynomial.legendre import legint, legvander
from scipy.sparse import block_diag, coo_array, csc_array, kron
from scipy.sparse.linalg import splu
from scipy.special import roots_jacobi

from fpk.arrays import Array
from fpk.line.time.elements import Elements
from fpk.line.time.resolvent import Evolved
from fpk.modulation import Modulation

STAGES = 5
"""Stages of a step of Radau IIA: of the order 2 · 5 − 1."""
FIRST = 1e-3
"""The first step, in units of the first time or kink of e: what it errs by is forgotten."""
RATIO = 3.0
"""Ratio of the ends of a step at the level 0, as long as steps grow with the time."""


class Matrices(NamedTuple):
    """M, K and C of the free functions, which are scaled to a mass of one.

    ``spread`` (functions of all elements, free functions) has e^(½ ``log_scale``) times the factor
    of each free function, where it is one of the element's.
    """

    M: csc_array
    K: csc_array
    C: csc_array
    spread: csc_array


def matrices(e: Elements, *, absorbing: bool = False) -> Matrices:
    """Return the matrices of the elements, which are of the reference noise.

    No flux leaves at the last end, or it absorbs.
    """
    size = e.degree + 1
    K_local = np.tile(np.eye(size), (e.count, 1, 1))
    K_local[:, :2, :2] = e.conductance[:, None, None] * np.array([[1.0, -1.0], [-1.0, 1.0]])
    # A vertex is of two elements, of which the one on its left has the function h_1.
    place = np.arange(e.count * size).reshape(e.count, size)
    place[1:, 0] = place[:-1, 1]
    masses = np.einsum("eii->ei", e.mass)
    used = masses != 0.0
    used[-1, 1] &= not absorbing
    numbers, free = np.unique(place[used], return_inverse=True)
    unit = np.broadcast_to(e.log_scale[:, None], place.shape)[used]
    log_mass = np.full(numbers.size, -np.inf)
    np.logaddexp.at(log_mass, free, np.log(masses[used]) + unit)
    factor, shape = np.exp(0.5 * (unit - log_mass[free])), (used.size, numbers.size)
    spread = csc_array(coo_array((factor, (np.flatnonzero(used), free)), shape))
    blocks = (block_diag(A, format="csc") for A in (e.mass, K_local, e.drift))
    M, K, C = (csc_array(spread.T @ A @ spread) for A in blocks)
    return Matrices(M, K, C, spread)


class Step(NamedTuple):
    """A step: its ``end`` and ``length``, g at its stages (stages, functions), and a residual."""

    end: float
    length: float
    stages: Array
    residual: float


class Stepped(NamedTuple):
    """The density at the times asked for, and its mass ``kept`` at the stages of all steps.

    ``at`` are the times of the stages, ``weights`` integrate over time (steps · stages,) each.
    """

    g: Evolved
    at: Array
    weights: Array
    kept: Array


def stepped(
    e: Elements, load: Array, modulation: Modulation, unit: float, times: Array, *, level: int,
    absorbing: bool = False,
) -> Stepped:  # fmt: skip
    """Return the density at ``times`` > 0 of what begins with ``load``, by ``steps_of``.

    No flux leaves at the last end, or it is ``absorbing``.
    """
    m, root = matrices(e, absorbing=absorbing), np.exp(0.5 * e.log_scale)[:, None]
    begun, shares = (m.spread.T @ each.ravel() for each in (load / root, e.load * root))
    A, c = radau(STAGES)
    steps = list(steps_of(m, begun, modulation, unit, times, level=level))
    ends, lengths = np.array([(s.end, s.length) for s in steps]).T[:, :, None]
    last = np.array([steps[k].stages[-1] for k in np.searchsorted(ends[:, 0], times)])
    values = root * (m.spread @ last.T).T.reshape(-1, *e.load.shape)
    return Stepped(
        Evolved(values, np.abs(values), float(np.max([s.residual for s in steps]))),
        (ends - lengths * (1.0 - c)).ravel(),
        (lengths * A[-1]).ravel(),
        np.array([s.stages @ shares for s in steps]).ravel(),
    )


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
