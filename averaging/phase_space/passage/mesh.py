"""Meshes of the states within a limit: |q| < b, or H < E."""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from math import asin, ceil, pi, sqrt

import numpy as np

from averaging.phase_space.passage.oscillator import Oscillator
from fpk.arrays import Array

BEYOND = 8.5
"""Kicks of noise by which velocities are followed beyond the one that reaches the limit."""
GLANCING_Q, GLANCING_V, TIP = 1.1, 1.1, 1.1
"""Panels over their distance to a glancing point (q scales as v³ there) or a turning point."""
PANEL, FINER = 1.6, 0.93
"""Panels of the first level in kicks of noise, and the ratio of those of successive levels."""
LEAST, CLOSER = 0.15, 0.45
"""The least panel at a glancing point in units of the speed where noise outdoes the pull."""
STOP = 1.5
"""Panels over their distance to a stop whose force is a fractional power of the overlap."""
DEGREES = (5, 7, 9, 11, 13, 15)
"""Degree of each level."""
SAMPLES = 401
"""Points at which the lengths of panels are sampled, on each half of an interval."""


@dataclass(frozen=True, eq=False)
class Mesh:
    """Panels of x and s, with q = q(x) and v = s w(q).

    Within |q| < b: q = x and w = 1; s ends where velocities are cut off. Within H < E: q(x) is
    ``centre`` + ``radius`` sin x and w = √(2 (E − V)/m), so that s is from −1 to 1 and the limit is
    s = ±1. ``folded``: x >= 0 only, and the state at (−q, −v) is that at (q, v). ``degree`` is that
    of polynomials in x and in s on each panel.
    """

    oscillator: Oscillator
    x: Array
    s: Array
    degree: int
    energy: float | None
    centre: float
    radius: float
    folded: bool

    def q(self, x: Array) -> tuple[Array, Array]:
        """Return q and dq/dx."""
        if self.energy is None:
            return x, np.ones_like(x)
        return self.centre + self.radius * np.sin(x), self.radius * np.cos(x)

    def w(self, q: Array) -> Array:
        """Return the unit of velocity at q."""
        if self.energy is None:
            return np.ones_like(q)
        left = np.maximum(self.energy - self.oscillator.potential(q), 0.0)
        return np.asarray(np.sqrt(2.0 / self.oscillator.mass * left))

    def coordinates(self, q: Array, v: Array) -> tuple[Array, Array]:
        """Return x and s of states (points,) within the limit."""
        if self.folded:
            mirrored = q < 0.0
            q, v = np.where(mirrored, -q, q), np.where(mirrored, -v, v)
        if self.energy is None:
            return q, v
        share = np.clip((q - self.centre) / self.radius, -1.0, 1.0)
        with np.errstate(invalid="ignore"):
            s = np.where(v == 0.0, 0.0, v / self.w(q))
        return np.arcsin(share), np.clip(s, -1.0, 1.0)


def displacement_mesh(o: Oscillator, b: float, fastest: float, level: int) -> Mesh:
    """Return the mesh of ``level`` within |q| < ``b``, with starts up to the energy of ``fastest``.

    It is graded to (±b, 0), where T rises as the root of v and the sixth root of b − |q|. Where
    the energy of the largest velocity of the mesh does not reach b on one side, as beyond a stiff
    stop, the mesh ends at the turning point of that energy on this side.
    """
    kick, step = o.kick(b), PANEL * FINER**level * o.kick(b)
    ends = np.array([-b, b])
    height, beyond = o.potential(ends), (BEYOND + 0.7 * level) * kick
    swift = max(sqrt(2.0 * float(height.min()) / o.mass), fastest)
    farthest = 0.5 * o.mass * (swift + beyond) ** 2
    met = height <= farthest
    for side in np.flatnonzero(~met):
        ends[side] = o.turning_point(farthest, np.sign(ends[side]))
    swift = max(sqrt(2.0 * float(height[met].max()) / o.mass), swift)
    pull = np.abs(o.force(ends[met])) / o.mass
    # Where noise outdoes the pull, on either side: the scale of what is singular.
    slow = np.minimum(2.0 * o.diffusion / np.maximum(pull, 2.0 * o.diffusion / kick), kick)
    least = LEAST * CLOSER**level * slow
    end = swift + beyond

    def across(v: Array) -> Array:
        graded = GLANCING_V * (v + float(least.min()))
        longest = np.where(v < swift + 3.0 * kick, step, 2.0 * step)
        return np.asarray(np.minimum(longest, graded))

    def along(q: Array) -> Array:
        graded = np.min([GLANCING_Q * np.abs(q - at) for at in ends[met]], axis=0)
        return np.asarray(np.minimum(_smooth_step(o, q, step, swift, level), graded))

    half = _equidistributed(0.0, end, across, float(least.min()))
    first, last = 0.0 if o.even else float(ends[0]), float(ends[1])
    nodes = [first, *_inside(o, first, last), last]
    closest = dict(zip(ends[met].tolist(), (least**3 / o.diffusion).tolist(), strict=True))
    x = _joined(nodes, along, closest)
    return Mesh(o, x, _mirrored(half), DEGREES[level], None, 0.0, b, o.even)


def energy_mesh(o: Oscillator, energy: float, level: int) -> Mesh:
    """Return the mesh of ``level`` within H < ``energy``."""
    left, right = o.turning_points(energy)
    centre, radius = (0.0, right) if o.even else (0.5 * (left + right), 0.5 * (right - left))
    swift = sqrt(2.0 * energy / o.mass)
    step = PANEL * FINER**level * o.kick(radius)
    s = np.linspace(0.0, 1.0, 1 + ceil(swift / step))
    pull = float(np.abs(o.force(np.array([left, right]))).max()) / o.mass
    slow = min(2.0 * o.diffusion / (pull * swift), 1.0)
    ends = np.array([-0.5 * pi, 0.5 * pi])

    def along(x: Array) -> Array:
        q = centre + radius * np.sin(x)
        slope = radius * np.maximum(np.cos(x), 1e-3)
        smooth = _smooth_step(o, q, step, swift, level) / slope
        graded = np.minimum(*(TIP * (np.abs(x - at) + 0.3 * slow) for at in ends))
        return np.asarray(np.minimum(smooth, graded))

    inside = [asin((q - centre) / radius) for q in _inside(o, left, right)]
    first = 0.0 if o.even else float(ends[0])
    x = _joined([first, *(a for a in inside if a > first), float(ends[1])], along, {})
    return Mesh(o, x, _mirrored(s), DEGREES[level], energy, centre, radius, o.even)


def _smooth_step(o: Oscillator, q: Array, step: float, swift: float, level: int) -> Array:
    """Length over which a trajectory of the speed ``swift`` changes its velocity by ``step``.

    Shorter beyond a stop whose force is a fractional power of the overlap, where the length is at
    most the overlap that stops the speed ``step``.
    """
    slope = np.maximum(np.abs(o.force(q)) / (o.mass * max(swift, step)), o.frequency)
    length = np.minimum(step / np.maximum(slope, 1e-300), 0.5 * np.ptp(q))
    for at, side in o.stops:
        if side:
            overlap = np.maximum((q - at) * side, 0.0)
            stopped = float(o.energy(np.array(at), np.array(step)))
            most = np.minimum(length, abs(o.turning_point(stopped, side) - at))
            near = STOP * (overlap + 0.03 * 0.5**level * most)
            length = np.where((q - at) * side >= 0.0, np.minimum(length, near), length)
    return np.asarray(length)


def _inside(o: Oscillator, left: float, right: float) -> list[float]:
    """Stops between ``left`` and ``right``, ascending."""
    return [q for q, _ in sorted(o.stops) if left < q < right]


def _mirrored(half: Array) -> Array:
    return np.concatenate([-half[:0:-1], half])


def _joined(nodes: list[float], h: Callable[[Array], Array], closest: dict[float, float]) -> Array:
    """Nodes about h(x) apart that hold ``nodes``, with the least panel ``closest`` at some."""
    return np.unique(
        np.concatenate(
            [
                _equidistributed(a, b, h, closest.get(a, 0.0), closest.get(b, 0.0))
                for a, b in pairwise(sorted(set(nodes)))
            ]
        )
    )


def _equidistributed(
    a: float, b: float, h: Callable[[Array], Array], near: float = 0.0, far: float = 0.0
) -> Array:
    """Nodes from ``a`` to ``b`` about h(x) apart; the ends hold panels of ``near`` and ``far``."""
    t = np.linspace(0.0, 1.0, SAMPLES)
    middle, length = 0.5 * (a + b), b - a
    low = a + _ramp(near, 0.5 * length, t)
    high = b - _ramp(far, 0.5 * length, t)[::-1]
    x = np.unique(np.concatenate([low[low < middle], [middle], high[high > middle]]))
    density = 1.0 / h(x)
    number = np.concatenate([[0.0], np.cumsum(0.5 * (density[1:] + density[:-1]) * np.diff(x))])
    count = max(1, ceil(number[-1]))
    nodes = np.interp(np.linspace(0.0, number[-1], count + 1), number, x)
    return np.unique(np.concatenate([[a], nodes[(nodes > a) & (nodes < b)], [b]]))


def _ramp(least: float, length: float, t: Array) -> Array:
    """Distances from ``least`` to ``length``, by equal ratios where ``least`` is not 0."""
    return np.asarray(least * (length / least) ** t if least else length * t)
