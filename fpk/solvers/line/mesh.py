"""Where the density of one energy lies, and meshes that follow the coefficients from there.

A process is probed before there is any mesh, from far below to far above its energy scale. Elements
then are as long as the density falls by some nats; layers lie where smoothness is lost, and short
elements where a motion starts or ends.
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
"""Energies of a probe, in units of the process's scale."""
SAGITTA = 1.0
"""Largest (d²ln(p H)/d(ln H)²)·(Δ ln H)² between two points of a probe: eight times what ln p H
may rise above its chord. Asked for where p is within exp(−``PROBE_DEPTH``) of its maximum."""
PROBE_DEPTH = 100.0
"""Nats below the largest p H down to which a probe resolves it: 1e-43 of the mass."""
ELEMENT_FALL = 3.0
"""Fall of ln(p/T) over one element: exp(−3 t) is met by degree 10 to 1e-11."""
SMOOTH_FALL = 4.0
"""Fall of ln(p/T) over one element where ln(p/T) is linear in H: over n nats a polynomial of degree
p misses e^(−x) by n^(p+1)/((p+1)! 2^(2p+1)) of its largest value (Chebyshev), with the degree of a
tolerance (four more than its digits) 1e-1 to 1e-2 of the tolerance."""
CONTACT_GROWTH = 20.0
"""Largest ratio of the ends of an element that begins where contact does."""
GRADING = 0.15
"""Ratio of neighbouring lengths towards a point where smoothness is lost."""
GRADED_LAYERS = 5
DEEP_LAYERS = 14
"""Layers down to 3e-12 of the next element: T has such layers at stiff stops and small gaps."""
MAX_ELEMENT_DEGREE = 16
"""Highest degree of elements."""
LENGTH_RATIO = 1.6
"""Ratio of neighbouring lengths away from where f changes fast: f is as smooth on each of them."""
NODE_DISTANCE = 1e-3
"""Distance of two nodes, relative to the elements beside it, below which one is left out."""
LAYER = 0.5
"""Length of the elements at a start or a limit, in widths of the density at the first time."""
FAST = 20.0
"""Largest |z| t of the Laplace variables z of a contour that contribute at the time t."""
LARGEST_VALUE = 100.0
"""Largest value at H = 0, in norms in π ~ H^(n−1), of a polynomial: it multiplies round-off."""


@dataclass(frozen=True, eq=False)
class Probe:
    """The ``slope`` d ln p/dH and ``roughness`` |d ln(p/T)/dH| at ``energy``, all (points,)."""

    energy: Array
    slope: Array
    roughness: Array

    @cached_property
    def rate(self) -> Array:
        """d ln(p H)/d ln H, linear in ln H in between."""
        return 1.0 + self.energy * self.slope

    @cached_property
    def log_mass(self) -> Array:
        """ln(p H) up to a constant."""
        steps = 0.5 * (self.rate[1:] + self.rate[:-1]) * np.diff(np.log(self.energy))
        return np.append(0.0, steps.cumsum())

    def extent(self, tail: float) -> float:
        """Return an energy with the share ``tail`` of mass beyond, or raise ``NotCertified``."""
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
        """Return a bound of the mass above ``end`` from p there; infinite where p does not fall.

        Between two energies of the probe p falls at the lesser of the rates there.
        """
        first = int(np.searchsorted(self.energy, end, side="right"))
        rate = -np.append(np.interp(end, self.energy, self.slope), self.slope[first:])
        least = np.minimum(rate[:-1], rate[1:])
        with np.errstate(all="ignore"):
            fall = least * np.diff(self.energy[first:], prepend=end)
            share = np.exp(-np.append(0.0, fall.cumsum()))
            length = float(np.sum(-np.diff(share) / least) + share[-1] / rate[-1])
        # Not where p rises beyond all bounds, or at the end; and not 0 · ∞.
        falls = rate[-1] > 0.0 and math.isfinite(length)
        return density_at_end * length if falls else math.inf

    def e_fold(self, end: float) -> float:
        """Return the mean energy over which p/T changes by the factor e, below ``end``."""
        energy = np.concatenate([[0.0], self.energy[self.energy < end], [end]])
        return end / float(np.trapezoid(np.interp(energy, self.energy, self.roughness), energy))


def probe_process(process: Process) -> Probe:
    """Return the probe of a process, with points between which no maximum of p can hide.

    Raises ``NotCertified`` where the density does not fall off at the highest energies.
    """
    energy = process.energy_scale * PROBE_ENERGIES

    def sampled(energy: Array, c: Coefficients) -> tuple[Array, Array, Array]:
        return energy, log_density_slope(c), np.abs(2.0 * c.dissipation / c.diffusion)

    # Of energies farther out than that, those whose coefficients overflow are not judged.
    with np.errstate(over="ignore", invalid="ignore"):
        c = process.coefficients(energy)
        finite = np.isfinite(log_density_slope(c) * energy) | (FAR_OUT[0] >= PROBE_ENERGIES)
        if not finite.all():
            energy = energy[finite]
            c = Coefficients(*(np.broadcast_to(a, PROBE_ENERGIES.shape)[finite] for a in c))
        probe = Probe(*sampled(energy, c))
        require_falling(probe.energy, c, probe.slope)
    for _ in range(60 if process.state_damping else 0):
        bulk = (
            np.maximum(probe.log_mass[1:], probe.log_mass[:-1]) > probe.log_mass.max() - PROBE_DEPTH
        )
        bent = np.abs(np.diff(probe.rate)) * np.diff(np.log(probe.energy)) > SAGITTA
        i = np.flatnonzero(bulk & bent)
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
    """Return nodes from 0 to ``end``: on the nonsmooth energies, dense where p/T varies fast.

    ``nats`` is the fall of ln(p/T) over one element. Geometric ``layers`` lie above every nonsmooth
    energy H_c. Where that is tiny beside its element, T still changes with H/H_c: elements grow.
    """
    # As many nodes between two ends as ∫rate asks for, in equal shares of it.
    ends = np.array([0.0, *(H for H in nonsmooth if 0.0 < H < end), end])
    grid = end / 64.0 * np.arange(65.0)
    rate = np.interp(grid, probe.energy, probe.roughness / nats)
    total = np.append(0.0, (0.5 * grid[1] * (rate[1:] + rate[:-1])).cumsum())
    amount = np.interp(ends, grid, total)
    number = np.append(0.0, np.maximum(np.ceil(np.diff(amount)), 1.0).cumsum())
    # The number of a node is linear in the amount between two ends.
    nodes: Array = np.interp(np.interp(np.arange(number[-1] + 1.0), number, amount), total, grid)
    nodes[number.astype(int)] = ends
    for H in ends[1:-1]:
        if nodes[np.searchsorted(nodes, H) + 1] > CONTACT_GROWTH * H:
            steps = np.arange(1.0, math.log(end / H) / math.log(CONTACT_GROWTH))
            nodes = np.unique(np.append(nodes, H * CONTACT_GROWTH**steps))
    return with_layers(nodes, nonsmooth, count=layers)


def with_layers(nodes: Array, nonsmooth: tuple[float, ...], *, count: int = GRADED_LAYERS) -> Array:
    """Return the nodes and geometric layers above those that are nonsmooth energies.

    They go from the last node down to ``count`` layers below the node next to H: wherever that is,
    the distance of the ends of an element from H is in the ratio ``GRADING`` or nearer to 1.
    """
    for H in nonsmooth:
        if count and nodes[0] <= H < nodes[-1]:
            reach = float(nodes[-1]) - H
            gap = float(nodes[np.searchsorted(nodes, H, side="right")]) - H
            layers = np.arange(1.0, count + 1.0 + math.log(gap / reach) / math.log(GRADING))
            nodes = np.unique(np.concatenate([nodes, H + reach * GRADING**layers]))
    return nodes


def split_points(left: Array, right: Array, nonsmooth: tuple[float, ...]) -> Array:
    """Return where to cut elements in two: half-way, towards 0 and nonsmooth left ends."""
    begins = (left[:, None] == np.array([0.0, *nonsmooth])).any(axis=1)
    return np.asarray(left + np.where(begins, GRADING, 0.5) * (right - left))


def first_degree(degree: int, n: int) -> int:
    """Return the degree of the element at H = 0, where T ~ H^(n−1): at the most ``degree``.

    The polynomial that is orthogonal in H^(n−1) to all of a lower degree k is (n+k−1 over k) at 0.
    """
    return max(
        k for k in range(1, degree + 1) if k == 1 or math.comb(k + n - 1, k) <= LARGEST_VALUE
    )


def layer_at(process: Process, limit: float, time: float) -> tuple[float, float]:
    """Return ``limit`` and the length of elements there, ~ √(b t), that still tells them apart."""
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
    """Return nodes from 0 to ``end`` for questions of time: fine where a motion starts or ends.

    To those of the density come energies of ``fine``, with the lengths of the elements beside them,
    which grow from there, and ``more`` nodes, but for those that nearly are others.
    """
    n = process.degrees_of_freedom
    nodes = initial_nodes(probe_process(process), end, process.nonsmooth, nats=SMOOTH_FALL)
    added = [nodes, more, end * np.array([0.25, 0.5, 0.75])]  # four elements at least
    if n > 2:
        # Of degree k the first element gives k + 2 times as many digits as its share of the scale.
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
    # Of two nodes that are nearly the same the right one is left out, or else the left one.
    right, left = close & ~kept[1:], close & kept[1:] & ~kept[:-1]
    return np.asarray(nodes[~(np.append(False, right) | np.append(left, False))])
