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
from scipy.sparse import coo_array, csc_array, kron
from scipy.sparse.linalg import splu
from scipy.special import roots_jacobi

from fpk.arrays import Array, Integers
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
    """M, K and C of the free functions, ``place`` of those of each element (−1: none).

    The functions are scaled to a mass of one: ``scale`` is ln of the factor on each.
    """

    M: csc_array
    K: csc_array
    C: csc_array
    place: Integers
    scale: Array

    def assembled(self, each: Array, log_unit: Array | float = 0.0) -> Array:
        """Return the sums of ``each`` (elements, functions) in units e^``log_unit``: a load."""
        total, used = np.zeros(self.scale.size), self.place >= 0
        factor = np.exp(log_unit + self._log_factor)
        np.add.at(total, self.place[used], (each * factor)[used])
        return total

    def coefficients(self, g: Array, log_unit: Array) -> Array:
        """Return those (times, elements, functions) of ``g`` (times, free functions) in units."""
        padded = np.append(g, np.zeros((len(g), 1)), axis=1)
        return np.asarray(padded[:, self.place] * np.exp(log_unit + self._log_factor))

    @property
    def _log_factor(self) -> Array:
        return np.append(self.scale, -np.inf)[self.place]


def matrices(e: Elements, *, absorbing: bool = False) -> Matrices:
    """Return the matrices of the elements, which are of the reference noise.

    No flux leaves at the last end, or it absorbs.
    """
    size = e.degree + 1
    K = np.tile(np.eye(size), (e.count, 1, 1))
    K[:, :2, :2] = e.conductance[:, None, None] * np.array([[1.0, -1.0], [-1.0, 1.0]])
    place = np.empty((e.count, size), dtype=np.intp)
    place[:, 0], place[:, 1] = np.arange(-1, e.count - 1), np.arange(e.count)
    place[:, 2:] = e.count + np.arange(e.count * (size - 2)).reshape(e.count, size - 2)
    masses = np.einsum("eii->ei", e.mass)
    place[masses == 0.0] = -1
    if absorbing:
        place[-1, 1] = -1
    numbers = np.unique(place[place >= 0])
    place = np.where(place >= 0, np.searchsorted(numbers, place), -1)
    used, unit = place >= 0, np.broadcast_to(e.log_scale[:, None], place.shape)
    scale = np.full(numbers.size, -np.inf)
    np.logaddexp.at(scale, place[used], np.log(masses[used]) + unit[used])
    factor = np.where(used, np.exp(0.5 * (unit - scale[place])), 0.0)
    pair = factor[:, :, None] * factor[:, None, :]
    rows, columns = (np.broadcast_to(p, pair.shape) for p in (place[:, :, None], place[:, None, :]))
    keep = (rows >= 0) & (columns >= 0)
    at, shape = (rows[keep], columns[keep]), (numbers.size, numbers.size)
    made = [csc_array(coo_array(((A * pair)[keep], at), shape)) for A in (e.mass, K, e.drift)]
    return Matrices(made[0], made[1], made[2], place, -0.5 * scale)


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
    m, log_unit = matrices(e, absorbing=absorbing), e.log_scale[:, None]
    shares, (A, c) = m.assembled(e.load, log_unit), radau(STAGES)
    steps = list(steps_of(m, m.assembled(load), modulation, unit, times, level=level))
    ends, lengths = np.array([(s.end, s.length) for s in steps]).T[:, :, None]
    last = np.array([steps[k].stages[-1] for k in np.searchsorted(ends[:, 0], times)])
    values = m.coefficients(last, log_unit)
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
