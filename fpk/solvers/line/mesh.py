"""Probe of a process of one energy, which finds where its density lies, and meshes based on it.

A process is probed from far below to far above its energy scale. Over an element ln(p/T) falls by a
few units; geometric layers lie where smoothness is lost, short elements where a motion starts.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from fpk.numeric.arrays import EPS, Array
from fpk.numeric.errors import NotCertified
from fpk.system.ends import FAR_OUT, OUT_OF_RANGE, require_falling
from fpk.system.process import Coefficients, Process, log_density_slope

PROBE_ENERGIES = np.concatenate(
    [np.logspace(-3.0, 0.0, 10), np.logspace(0.1, 2.0, 20), np.logspace(2.25, 4.0, 8), FAR_OUT[1:]]
)
"""Energies of a probe, in units of ``Process.energy_scale``."""
SAGITTA = 1.0
"""Largest (d²ln(p H)/d(ln H)²)·(Δ ln H)² between two points of a probe with p H > e^−PROBE_DEPTH of
its maximum: ln(p H) rises above its chord by at most an eighth of it."""
PROBE_DEPTH = 100.0
"""Depth in ln(p H) below its maximum down to which a probe resolves p: 4e-44 of the mass."""
ELEMENT_FALL = 3.0
"""Default fall of ln(p/T) over an element: degree 10 approximates exp(−3 t) to 6e-10."""
SMOOTH_FALL = 4.0
"""Fall n of ln(p/T) over one element if ln(p/T) is linear in H. A polynomial of degree p has the
error n^(p+1)/((p+1)! 2^(2p+1)) of the maximum of e^(−x) (Chebyshev), 1e-1 to 1e-2 of a tolerance
whose number of digits is p − 4."""
CONTACT_GROWTH = 20.0
"""Largest upper end of an element that begins at a contact energy H_c, over H_c."""
GRADING = 0.15
"""Ratio of the lengths of neighbouring elements towards an energy where smoothness is lost."""
GRADED_LAYERS = 5
"""Default number of layers from an energy where smoothness is lost to the next node: they divide
this distance down to 8e-5 of it."""
DEEP_LAYERS = 14
"""Number of layers for integrals above a contact energy, down to 3e-12 of the distance to the next
node: T varies within such layers at stiff stops and small clearances."""
MAX_ELEMENT_DEGREE = 16
"""Highest degree of elements in time."""
LENGTH_RATIO = 1.6
"""Ratio of the lengths of neighbouring elements away from a start or a limit."""
NODE_DISTANCE = 1e-3
"""Length of an element, over its longer neighbour, below which one of its nodes is dropped."""
LAYER = 0.5
"""Length of the elements at a start or a limit, in units of √(b t), b the diffusion σ² there and t
the first output time; at a start in units of ½ b' t if that is longer."""
FAST = 20.0
"""Largest |z| t of Laplace variables z that contribute to a density at the time t."""
LARGEST_VALUE = 100.0
"""Largest value at H = 0 of orthogonal polynomials of weight H^(n−1), over the value at the other
end: it amplifies round-off."""


@dataclass(frozen=True, eq=False)
class Probe:
    """``slope`` d ln p/dH and ``roughness`` |d ln(p/T)/dH| at ascending ``energy``, (points,): p is
    the stationary density, T the density of states."""

    energy: Array
    slope: Array
    roughness: Array

    @cached_property
    def rate(self) -> Array:
        """d ln(p H)/d ln H (points,), taken as linear in ln H between the points."""
        return 1.0 + self.energy * self.slope

    @cached_property
    def log_mass(self) -> Array:
        """ln(p H) (points,) up to a constant."""
        steps = 0.5 * (self.rate[1:] + self.rate[:-1]) * np.diff(np.log(self.energy))
        return np.append(0.0, steps.cumsum())

    def extent(self, tail: float) -> float:
        """Return the energy above which p H, p the stationary density, stays below ``tail`` times
        its maximum. Raises ``NotCertified`` if it never does, or if coefficients overflow."""
        if not np.isfinite(self.log_mass).all():
            raise NotCertified(OUT_OF_RANGE)
        energy, rate = self.energy, self.rate
        wanted = float(self.log_mass.max()) + math.log(tail)
        i = int(np.flatnonzero(~(self.log_mass < wanted))[-1]) + 1
        if i == energy.size:
            raise NotCertified(
                "the density does not fall off: damping does not balance the noise at high energy"
            )
        length = math.log(energy[i] / energy[i - 1])
        bend = (rate[i] - rate[i - 1]) / length
        fall = self.log_mass[i - 1] - wanted
        root = math.sqrt(max(rate[i - 1] ** 2 - 2.0 * bend * fall, 0.0))
        return float(energy[i - 1] * math.exp(min(2.0 * fall / (root - rate[i - 1]), length)))

    def tail_bound(self, end: float, density_at_end: float) -> float:
        """Return a bound of the mass above the energy ``end``, at which p = ``density_at_end``; inf
        if p rises at the last energy. Between two energies p falls at the smaller of both rates."""
        first = int(np.searchsorted(self.energy, end, side="right"))
        rate = -np.append(np.interp(end, self.energy, self.slope), self.slope[first:])
        least = np.minimum(rate[:-1], rate[1:])
        with np.errstate(all="ignore"):
            fall = least * np.diff(self.energy[first:], prepend=end)
            share = np.exp(-np.append(0.0, fall.cumsum()))
            length = float(np.sum(-np.diff(share) / least) + share[-1] / rate[-1])
        # Infinite if p rises at the end of the probe or overflows; never 0 · ∞.
        falls = rate[-1] > 0.0 and math.isfinite(length)
        return density_at_end * length if falls else math.inf

    def e_fold(self, end: float) -> float:
        """Return the mean energy difference, below ``end``, in which p/T changes by a factor e."""
        energy = np.concatenate([[0.0], self.energy[self.energy < end], [end]])
        return end / float(np.trapezoid(np.interp(energy, self.energy, self.roughness), energy))


def probe_process(process: Process) -> Probe:
    """Return a probe of ``process`` so fine that no maximum of p lies hidden between two energies.
    Far energies at which coefficients overflow are left out. Raises ``NotCertified`` if the density
    does not fall off at the highest of the others."""
    energy = process.energy_scale * PROBE_ENERGIES

    def sampled(energy: Array, c: Coefficients) -> tuple[Array, Array, Array]:
        return energy, log_density_slope(c), np.abs(2.0 * c.dissipation / c.diffusion)

    # Energies beyond FAR_OUT[0] at which coefficients overflow are left out.
    with np.errstate(over="ignore", invalid="ignore"):
        c = process.coefficients(energy)
        finite = np.isfinite(log_density_slope(c) * energy) | (FAR_OUT[0] >= PROBE_ENERGIES)
        if not finite.all():
            energy = energy[finite]
            c = Coefficients(*(np.broadcast_to(a, PROBE_ENERGIES.shape)[finite] for a in c))
        probe = Probe(*sampled(energy, c))
        require_falling(probe.energy, c, probe.slope)
    for _ in range(60 if process.state_damping else 0):
        log_mass, least = probe.log_mass, probe.log_mass.max() - PROBE_DEPTH
        bent = np.abs(np.diff(probe.rate)) * np.diff(np.log(probe.energy)) > SAGITTA
        i = np.flatnonzero((np.maximum(log_mass[1:], log_mass[:-1]) > least) & bent)
        if not i.size:
            break
        energy = np.sqrt(probe.energy[i] * probe.energy[i + 1])
        added = sampled(energy, process.coefficients(energy))
        of = probe.energy, probe.slope, probe.roughness
        probe = Probe(*(np.insert(x, i + 1, new) for x, new in zip(of, added, strict=True)))
    return probe


def initial_nodes(
    probe: Probe,
    end: float,
    nonsmooth: tuple[float, ...],
    *,
    nats: Array | float = ELEMENT_FALL,
    layers: int = GRADED_LAYERS,
) -> Array:
    """Return nodes from 0 to ``end``, with a node at each of the ``nonsmooth`` energies between.

    ``nats`` is the fall of ln(p/T) over one element, one number or one for each energy of the
    ``probe``. Above every nonsmooth energy H_c lie geometric layers, ``layers`` of them below the
    next node, 0 for none; if H_c is tiny compared with its element, elements grow from it by
    ``CONTACT_GROWTH``, as T changes with H/H_c.
    """
    # Between two ends the nodes divide ∫rate into equal shares, as few as ∫rate allows.
    ends = np.array([0.0, *(H for H in nonsmooth if 0.0 < H < end), end])
    grid = end / 64.0 * np.arange(65.0)
    rate = np.interp(grid, probe.energy, probe.roughness / nats)
    total = np.append(0.0, (0.5 * grid[1] * (rate[1:] + rate[:-1])).cumsum())
    amount = np.interp(ends, grid, total)
    number = np.append(0.0, np.maximum(np.ceil(np.diff(amount)), 1.0).cumsum())
    # Between two ends the number of a node is linear in ∫rate.
    nodes: Array = np.interp(np.interp(np.arange(number[-1] + 1.0), number, amount), total, grid)
    nodes[number.astype(int)] = ends
    for H in ends[1:-1]:
        if nodes[np.searchsorted(nodes, H) + 1] > CONTACT_GROWTH * H:
            steps = np.arange(1.0, math.log(end / H) / math.log(CONTACT_GROWTH))
            nodes = np.unique(np.append(nodes, H * CONTACT_GROWTH**steps))
    return with_layers(nodes, nonsmooth, count=layers)


def with_layers(nodes: Array, nonsmooth: tuple[float, ...], *, count: int = GRADED_LAYERS) -> Array:
    """Return ``nodes`` with geometric layers above each node that is a ``nonsmooth`` energy H.

    The layers go from the last node down to ``count`` layers below the node next to H, so that the
    ratio of the distances of both ends of any element from H is at least ``GRADING``. If ``count``
    is 0, ``nodes`` are returned.
    """
    for H in nonsmooth:
        if count and nodes[0] <= H < nodes[-1]:
            reach = float(nodes[-1]) - H
            gap = float(nodes[np.searchsorted(nodes, H, side="right")]) - H
            layers = np.arange(1.0, count + 1.0 + math.log(gap / reach) / math.log(GRADING))
            nodes = np.unique(np.concatenate([nodes, H + reach * GRADING**layers]))
    return nodes


def split_points(left: Array, right: Array, nonsmooth: tuple[float, ...]) -> Array:
    """Return where to cut elements from ``left`` to ``right`` (elements,): at the middle, or at
    ``GRADING`` of the length if the left end is 0 or ``nonsmooth``."""
    begins = (left[:, None] == np.array([0.0, *nonsmooth])).any(axis=1)
    return np.asarray(left + np.where(begins, GRADING, 0.5) * (right - left))


def first_degree(degree: int, n: int) -> int:
    """Return the degree of the element at H = 0, where T ~ H^(n−1), from 1 to ``degree``.

    The orthogonal polynomial of degree k in the weight H^(n−1), 1 at the right end, has the value
    (n+k−1 over k) at 0, which must not exceed ``LARGEST_VALUE``.
    """
    return max(
        k for k in range(1, degree + 1) if k == 1 or math.comb(k + n - 1, k) <= LARGEST_VALUE
    )


def layer_at(process: Process, limit: float, time: float) -> tuple[float, float]:
    """Return ``limit`` and the length of elements there, ``LAYER`` √(b ``time``) but at least 1e4
    round-offs; b is the diffusion σ² there."""
    b = float(process.coefficients(np.array([limit])).diffusion[0])
    return limit, max(LAYER * math.sqrt(b * time), 1e4 * EPS * limit)


def time_nodes(
    process: Process,
    end: float,
    degree: int,
    *,
    fine: Sequence[tuple[float, float]] = (),
    more: Array | Sequence[float] = (),
) -> Array:
    """Return nodes from 0 to ``end`` for elements of ``degree`` in time.

    They are the nodes for the stationary density of ``process``; nodes around the energies in
    ``fine``, pairs (energy, length of the elements beside it), with lengths that grow by
    ``LENGTH_RATIO``; and the nodes ``more``. Nodes beyond ``end`` are dropped, and one of two that
    nearly coincide, but not 0, ``end``, a nonsmooth energy or a positive one in ``fine``. Raises as
    ``probe_process`` does.
    """
    n = process.degrees_of_freedom
    nodes = initial_nodes(probe_process(process), end, process.nonsmooth, nats=SMOOTH_FALL)
    added = [nodes, more, end * np.array([0.25, 0.5, 0.75])]  # four elements at least
    if n > 2:
        # An error ~ (length/scale)^(k + 2) of the first element, of degree k, is round-off.
        beside_zero = [n * length / FAST for energy, length in fine if energy == 0.0]
        scale = min([process.energy_scale, end, *beside_zero])
        first = 10.0 ** (-16.0 / (first_degree(degree - 1, n) + 2)) * scale
        # ln T ~ (n − 1) ln H.
        ratio = min(math.exp(SMOOTH_FALL / (n - 1)), LENGTH_RATIO if beside_zero else np.inf)
        if first < 0.5 * nodes[1]:
            steps = int(math.log(end / first) / math.log(ratio))
            added.append(first * ratio ** np.arange(steps + 1.0))
        fine = [x for x in fine if x[0] > 0.0]
    gaps = np.diff(nodes)
    for energy, length in fine:
        count = 1.0 + max(math.log(end / length), 0.0) / math.log(LENGTH_RATIO)
        lengths = length * LENGTH_RATIO ** np.arange(count)
        ends = lengths.cumsum()
        added.append(np.array([energy]))
        for side in (1.0, -1.0):
            within = np.searchsorted(nodes, energy + side * (ends - 0.5 * lengths)) - 1
            shorter = lengths < gaps[np.clip(within, 0, gaps.size - 1)]
            added.append(energy + side * ends[shorter])
    nodes = np.unique(np.concatenate(added))
    nodes = nodes[(nodes >= 0.0) & (nodes <= end)]
    kept = np.isin(nodes, [0.0, end, *process.nonsmooth, *(energy for energy, _ in fine)])
    gaps = np.diff(nodes)
    close = gaps < NODE_DISTANCE * np.maximum(np.append(gaps[1:], 0.0), np.append(0.0, gaps[:-1]))
    # Of two nodes that nearly coincide the right one is dropped, or else the left one.
    right, left = close & ~kept[1:], close & kept[1:] & ~kept[:-1]
    return np.asarray(nodes[~(np.append(False, right) | np.append(left, False))])
