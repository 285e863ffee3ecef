"""Meshes of one energy: where they end, and how they follow the coefficients."""

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.optimize import brentq

from fpk.compiling import FLAGS, kept
from fpk.errors import NotCertified
from fpk.process import DiffusionProcess, log_density_slope

Array = NDArray[np.float64]

NATS_PER_ELEMENT = 3.0
"""Fall of ln(p/T) over one element: exp(−3 t) is met by degree 10 to 1e-11."""
EACH = 0.03
"""Share of the tolerance that a first mesh grants each of its elements, ten or so."""
UNDER = 1e-3
"""Largest error of an element relative to the density at its far end."""
SPREAD = 20.0
"""Largest ratio of the ends of an element that begins where contact does."""
GRADING = 0.15
"""Ratio of neighbouring lengths towards a point where smoothness is lost."""
GRADED_LAYERS = 5
DEEP_LAYERS = 14
"""Layers down to 3e-12 of the next element: beside a stiff stop and a small clearance T itself has
layers as thin as that."""
SAGITTA = 1.0
"""Largest (d²ln(p H)/d(ln H)²)·(Δ ln H)² between two points of a survey: eight times what ln p H
may rise above its chord. Asked for where p is within exp(−``DEEP``) of its maximum."""
DEEP = 100.0
SURVEY_ROUNDS = 20


@dataclass(frozen=True, eq=False)
class Survey:
    """Coarse look at the coefficients, from which a mesh starts; the answer does not rest on it.

    ``slope`` is d ln p/dH, ``roughness`` |d ln(p/T)/dH| and ``log_mass`` ln of p H up to a constant
    at ``energy``, all (points,).
    """

    energy: Array
    slope: Array
    roughness: Array
    log_mass: Array


GRID = np.concatenate([np.logspace(-3.0, 0.0, 10), np.logspace(0.0, 4.0, 41)[1:]])
"""Energies looked at, in units of the process's scale."""


def survey(process: DiffusionProcess) -> Survey:
    """Evaluate the slopes on a grid from far below to far above the process's energy scale."""
    energy = process.energy_scale * GRID
    view = _surveyed(energy, *_looked_at(process, energy))
    return _closer(process, view) if process.state_damping else view


def _looked_at(process: DiffusionProcess, energy: Array) -> tuple[Array, Array]:
    c = process.coefficients(energy)
    return log_density_slope(c), np.abs(2.0 * c.dissipation / c.diffusion)


def _surveyed(energy: Array, slope: Array, roughness: Array) -> Survey:
    return Survey(energy, slope, roughness, _log_mass(energy, slope))


def _closer(process: DiffusionProcess, view: Survey) -> Survey:
    """Add points until no maximum of p can hide between two of them: it may be narrow."""
    for _ in range(SURVEY_ROUNDS):
        log_mass = view.log_mass
        bulk = np.maximum(log_mass[1:], log_mass[:-1]) > log_mass.max() - DEEP
        rate = 1.0 + view.energy * view.slope
        bent = np.abs(np.diff(rate)) * np.diff(np.log(view.energy)) > SAGITTA
        i = np.flatnonzero(bulk & bent)
        if not i.size:
            break
        energy = np.sqrt(view.energy[i] * view.energy[i + 1])
        slope, roughness = _looked_at(process, energy)
        view = _surveyed(
            np.insert(view.energy, i + 1, energy),
            np.insert(view.slope, i + 1, slope),
            np.insert(view.roughness, i + 1, roughness),
        )
    return view


_compiled = kept()


@_compiled
def _log_mass(energy: Array, slope: Array) -> Array:
    """ln of p H, up to a constant."""
    # In the variable ln H, where the slope varies slowly: d ln(p H)/d ln H = 1 + H d ln p/dH.
    found = np.zeros(energy.size)
    for i in range(1, energy.size):
        rate = 2.0 + energy[i] * slope[i] + energy[i - 1] * slope[i - 1]
        found[i] = found[i - 1] + 0.5 * rate * np.log(energy[i] / energy[i - 1])
    return found


def truncation_energy(view: Survey, tail: float) -> float:
    """Return an energy beyond which about the share ``tail`` of the probability lies.

    The solver bounds the tail again from its own solution. Raises ``NotCertified`` where the
    density does not fall to that share.
    """
    found: float = _fallen_by(view.energy, view.slope, view.log_mass, math.log(tail))
    if not found < math.inf:
        raise NotCertified(
            "the density does not fall off: damping does not balance the noise at high energy"
        )
    return found


@_compiled
def _fallen_by(energy: Array, slope: Array, log_mass: Array, log_tail: float) -> float:
    """The first energy beyond the maximum of p H where ln of it has fallen by −``log_tail``."""
    top = np.argmax(log_mass)
    wanted = log_mass[top] + log_tail
    for i in range(top + 1, energy.size):
        if log_mass[i] < wanted:
            # As in ``_log_mass`` the rate is linear in ln H between two points.
            length = np.log(energy[i] / energy[i - 1])
            rate = 1.0 + energy[i - 1] * slope[i - 1]
            bend = (1.0 + energy[i] * slope[i] - rate) / length
            fall = log_mass[i - 1] - wanted
            root = np.sqrt(max(rate * rate - 2.0 * bend * fall, 0.0))
            found: float = energy[i - 1] * np.exp(min(2.0 * fall / (root - rate), length))
            return found
    return np.inf


def initial_nodes(
    view: Survey,
    end: float,
    nonsmooth: tuple[float, ...],
    *,
    nats: Array | float = NATS_PER_ELEMENT,
    layers: int = GRADED_LAYERS,
) -> Array:
    """Return nodes from 0 to ``end``: on the nonsmooth energies, dense where p/T varies fast.

    ``nats`` is the fall of ln(p/T) over one element, at the energies of the survey. Geometric
    ``layers`` lie above every nonsmooth energy (below it, the density is smooth up to it). Where
    that is tiny beside its element, T still changes with H/H_c: elements grow from there.
    """
    ends = np.array([0.0, *(H for H in nonsmooth if 0.0 < H < end), end])
    nodes: Array = _placed(view.energy, view.roughness / nats, ends)
    wide = [H for H in ends[1:-1] if nodes[np.searchsorted(nodes, H) + 1] > SPREAD * H]
    if wide:
        steps = np.concatenate(
            [H * SPREAD ** np.arange(1.0, np.log(end / H) / math.log(SPREAD)) for H in wide]
        )
        nodes = np.unique(np.concatenate([nodes, steps]))
    return with_layers(nodes, nonsmooth, count=layers)


@_compiled
def _placed(energy: Array, rate: Array, ends: Array) -> Array:
    """Nodes among them ``ends``, as many between two as ∫rate asks for, in equal shares of it."""
    count, last, segments = 64, ends[-1], ends.size - 1
    step, at, total = last / count, 0, np.zeros(count + 1)
    before = rate[0]
    for k in range(1, count + 1):
        while at < energy.size - 2 and energy[at + 1] < k * step:
            at += 1
        now = _between(k * step, energy, rate, at)
        total[k] = total[k - 1] + 0.5 * (before + now) * step
        before = now
    first, nodes = 0.0, np.empty(segments)
    pieces = np.empty(segments, np.int64)
    for i in range(segments):
        k = min(int(ends[i + 1] / step), count - 1)
        amount = total[k] + (total[k + 1] - total[k]) * (ends[i + 1] / step - k)
        nodes[i] = amount - first
        pieces[i] = max(math.ceil(amount - first), 1)
        first = amount
    found = np.empty(pieces.sum() + 1)
    at, k, first = 0, 0, 0.0
    for i in range(segments):
        for j in range(pieces[i]):
            wanted = first + nodes[i] * j / pieces[i]
            while k < count - 1 and total[k + 1] < wanted:
                k += 1
            share = (wanted - total[k]) / (total[k + 1] - total[k])
            found[at] = ends[i] if j == 0 else (k + share) * step
            at += 1
        first += nodes[i]
    found[at] = last
    return found


@njit(fastmath=FLAGS, error_model="numpy", forceinline=True)
def _between(x: float, energy: Array, values: Array, i: int) -> float:
    """Linear between the points i and i + 1, constant beyond the first and the last."""
    share = (x - energy[i]) / (energy[i + 1] - energy[i])
    value: float = values[i] + (values[i + 1] - values[i]) * min(max(share, 0.0), 1.0)
    return value


def nats_for(view: Survey, degree: int, tol: float) -> Array:
    """Return how far ln(p/T) may fall over one element of ``degree``, at the survey's energies.

    Over n nats the best polynomial misses e^(−x) by n^(p+1)/((p+1)! 2^(2p+1)) of its largest value
    (Chebyshev), and an element's error counts by its share of the mass, which is that of its start
    at the most. Each element gets ``EACH`` of ``tol``, but in the tail no more than what keeps the
    density positive, by far.
    """
    log_unit, log_steepest = _miss(degree)
    log_first = log_unit + math.log(EACH * tol)
    found: Array = _granted(view.log_mass, log_first, 1.0 / (degree + 1), log_steepest)
    return found


@_compiled
def _granted(log_mass: Array, log_first: float, power: float, log_most: float) -> Array:
    top = np.argmax(log_mass)
    found = np.empty(log_mass.size)
    for i in range(log_mass.size):
        depth = log_mass[i] - log_mass[top] if i > top else 0.0
        found[i] = np.exp(min((log_first - depth) * power, log_most))
    return found


@lru_cache
def _miss(degree: int) -> tuple[float, float]:
    """ln of (p+1)! 2^(2p+1), and of the n where an element's error is ``UNDER`` of e^(−n)."""
    p = degree + 1
    log_unit = math.lgamma(p + 1) + (2 * p - 1) * math.log(2.0)
    found = brentq(lambda n: p * math.log(n) - log_unit + n - math.log(UNDER), 1e-3, 1e3)
    return log_unit, math.log(found)


def with_layers(nodes: Array, nonsmooth: tuple[float, ...], *, count: int = GRADED_LAYERS) -> Array:
    """Return the nodes and geometric layers above those that are nonsmooth energies."""
    layers = GRADING ** np.arange(1.0, count + 1.0)
    for H in nonsmooth:
        if count and nodes[-1] > H:
            gap = nodes[np.searchsorted(nodes, H, side="right")] - H
            nodes = np.unique(np.concatenate([nodes, H + gap * layers]))
    return nodes


def split_points(left: Array, right: Array, special: Array) -> Array:
    """Return where to cut elements in two: towards a special point they begin at, else half-way."""
    share = np.where(np.isin(left, special), GRADING, 0.5)
    return left + share * (right - left)


def e_fold(view: Survey, end: float) -> float:
    """Return the mean energy over which p/T changes by the factor e, below ``end``."""
    inside = view.energy < end
    energy = np.concatenate([[0.0], view.energy[inside], [end]])
    nats = float(np.trapezoid(np.interp(energy, view.energy, view.roughness), energy))
    return end / nats


def tail_bound(view: Survey, end: float, density_at_end: float) -> float:
    """Return a bound of the mass above ``end``: p(end) over the least rate at which p falls there.

    The rate is that of the survey above ``end``, and taken not to drop below it further out.
    """
    rate: float = _least_rate(view.energy, view.slope, end)
    return density_at_end / rate if 0.0 < rate < math.inf else math.inf


@_compiled
def _least_rate(energy: Array, slope: Array, end: float) -> float:
    rate, i = np.inf, energy.size - 1
    while i >= 0 and energy[i] >= end:
        rate = min(rate, -slope[i])
        i -= 1
    # It may be that at the end itself, between two points of the survey.
    i = min(max(i, 0), energy.size - 2)
    return min(rate, -_between(end, energy, slope, i))
