"""Meshes of the states of one mass within a limit of q, v or H."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise
from math import asin, ceil, inf, log, pi, sqrt

import numpy as np
from scipy.integrate import cumulative_trapezoid

from averaging.phase_space.plane.oscillator import Oscillator
from fpk.answer.names import Limit
from fpk.numeric.arrays import SMALLEST, Array, Integers

GRADED = 1.1
"""Largest panel over its distance to a glancing point, where q scales as v³, or a turning point."""
PANEL, FINER = 1.6, 0.93
"""Panels of the first level over the velocity change by noise (``kick``); ratio of the panels of
successive levels."""
LEAST, CLOSER = 0.15, 0.45
"""Smallest panel at a glancing point over the velocity below which noise exceeds the restoring
force; ratio of the smallest panels of successive levels."""
STOP_GRADING = 1.5
"""Largest panel over its distance to a stop whose force is a fractional power of the overlap."""
SMOOTH_DEGREE = 8
"""Degree on meshes of densities that are nearly 0 at the limit."""
MARKED = 0.03
"""Panels are halved from this share of the largest unresolved part on, which by halving falls by up
to 2⁻⁹: smaller shares halve panels for nothing, larger ones take more solutions."""
LENGTH_SAMPLES = 401
"""Points on each half of an interval at which the length of panels is evaluated."""


@dataclass(frozen=True, eq=False)
class Mesh:
    """Panels in x and s, nodes ``x`` and ``s``, q = q(x), v = s w(q); polynomials of ``degree``.

    Within limits of q or v (``energy`` None) q = x and w = 1. Within H < E = ``energy``, q is
    ``centre`` + ``radius`` sin x and w = √(2 (E − V)/m), so that the limit is s = ±1. ``folded``: x
    >= 0 only, the state (−q, −v) being represented by (q, v). ``cut``: whether the left, right, low
    and high edge are no limit.
    """

    oscillator: Oscillator
    x: Array
    s: Array
    degree: int
    energy: float | None
    centre: float
    radius: float
    folded: bool
    cut: tuple[bool, ...] = (False, False, False, False)

    @property
    def functions_of_s(self) -> int:
        """Number of functions of s."""
        return (self.s.size - 1) * self.degree + 1

    @property
    def numbers_of_s(self) -> Integers:
        """Numbers (panels of s, degree + 1) of the functions of s; neighbours share one."""
        first = self.degree * np.arange(self.s.size - 1, dtype=np.int32)
        return np.add.outer(first, np.arange(self.degree + 1, dtype=np.int32))

    @property
    def unknowns(self) -> int:
        """About the number of unknowns."""
        return (self.x.size - 1) * (self.degree + 1) * (self.s.size - 1) * self.degree

    def settings(
        self, unknowns: int, words: str = "in the plane of displacement and momentum"
    ) -> dict[str, str | float | int]:
        """Return the settings of an answer with so many unknowns, in ``words`` how it is solved."""
        stated = {"solver": "fem", "solved_by": f"finite elements {words}"}
        return {"equation": "(6)", **stated, "unknowns": unknowns, "degree": self.degree}

    def refined(self, along: Array, across: Array) -> "Mesh":
        """Return the mesh with panels halved by the L1 norms of unresolved parts of a density.

        ``along`` and ``across`` are those on panels of x and of s, which stay symmetric.
        """
        parts = along, np.maximum(across, across[::-1])
        limit = MARKED * max(float(part.max()) for part in parts)
        x, s = (
            np.sort(np.append(nodes, (nodes[1:] + nodes[:-1])[part > limit] / 2.0))
            for nodes, part in zip((self.x, self.s), parts, strict=True)
        )
        return replace(self, x=x, s=s)

    def q(self, x: Array) -> tuple[Array, Array]:
        """Return q and dq/dx at ``x``."""
        if self.energy is None:
            return x, np.ones_like(x)
        return self.centre + self.radius * np.sin(x), self.radius * np.cos(x)

    def w(self, q: Array) -> Array:
        """Return w of v = s w at ``q``: the speed at the limiting energy, or 1 without it."""
        return np.ones_like(q) if self.energy is None else self.oscillator.speed(q, self.energy)

    def coordinates(self, q: Array, v: Array) -> tuple[Array, Array]:
        """Return x and s of the states ``q``, ``v`` (points,) within the limit."""
        if self.folded:
            mirrored = q < 0.0
            q, v = np.where(mirrored, -q, q), np.where(mirrored, -v, v)
        if self.energy is None:
            return q, v
        share = np.clip((q - self.centre) / self.radius, -1.0, 1.0)
        with np.errstate(divide="ignore", invalid="ignore"):
            s = np.where(v == 0.0, 0.0, v / self.w(q))
        return np.arcsin(share), np.clip(s, -1.0, 1.0)


def box_mesh(o: Oscillator, limit: Limit, top: float, level: int, *, rest: float) -> Mesh:
    """Return the mesh of ``level`` within a ``limit`` of q or v, for starts of energies to ``top``.

    ``top`` is the least energy at the limit or more. Where there is no limit, the mesh ends at a
    speed, and at its turning points, where a Gaussian of the width of a kick by noise has fallen to
    ``rest`` of its maximum. It is graded towards the glancing points (q, 0) of a limit of q, next
    to which T rises as the root of v and the sixth root of the distance, and towards a limit of v,
    where T is steep if the force turns v back.
    """
    of_q, both = limit.kind == "q", len(limit.ends) == 2
    radius = limit.value if of_q and both else inf
    kick = o.kick(radius) if of_q or not both else min(o.kick(radius), limit.value)
    step, beyond = PANEL * FINER**level * kick, (sqrt(-2.0 * log(rest)) + 0.7 * level) * kick
    swift = sqrt(2.0 * top / o.mass)
    farthest = 0.5 * o.mass * (swift + beyond) ** 2
    met, highest = zip(*(end for end in o.ends_of(limit) if end[1] <= farthest), strict=True)
    swift = max(sqrt(2.0 * max(highest) / o.mass), swift)
    of_x, of_s = (met, ()) if of_q else ((), met)
    sides = list(zip((-1.0, 1.0), limit.bounds, strict=True))
    left, right = (end if end in of_x else o.turning_point(farthest, side) for side, end in sides)
    low, high = (end if end in of_s else side * (swift + beyond) for side, end in sides)
    cut = left not in of_x, right not in of_x, low not in of_s, high not in of_s
    # Velocity below which noise exceeds the force: the scale of the singularity or steep layer.
    q = np.array([met] if of_q else [[left], [0.0], [right]])
    v = np.array([[0.0]] if of_q else [met])
    pull = np.max(np.abs(o.force(q) + o.drag(q, v) * v), axis=0) / o.mass
    slow = np.minimum(2.0 * o.diffusion / np.maximum(pull, 2.0 * o.diffusion / kick), kick)
    least = LEAST * CLOSER**level * slow
    smallest, steep = float(least.min()), of_s or (0.0,)

    def across(v: Array) -> Array:
        longest = np.where(np.abs(v) < swift + 3.0 * kick, step, 2.0 * step)
        near = np.min([np.abs(v - at) for at in steep], axis=0)
        return np.asarray(np.minimum(longest, GRADED * (near + smallest)))

    def along(q: Array) -> Array:
        graded = [GRADED * np.abs(q - at) for at in of_x]
        return np.asarray(np.min([_smooth_step(o, q, step, swift, level), *graded], axis=0))

    folded, closest = o.even and both, dict.fromkeys(steep, smallest)
    if low == -high:
        s = _nodes_at([0.0, high], across, closest)
        s = np.concatenate([-s[:0:-1], s])
    else:
        s = _nodes_at([low, *([0.0] if low < 0.0 < high else []), high], across, closest)
    first = 0.0 if folded else left
    closest = dict(zip(of_x, (least**3 / o.diffusion).tolist(), strict=of_q))
    x = _nodes_at([first, *(q for q, _ in o.stops if first < q < right), right], along, closest)
    return Mesh(o, x, s, 5 + 2 * level, None, 0.0, radius, folded, cut)


def energy_mesh(o: Oscillator, energy: float, level: int, panel: float | None = None) -> Mesh:
    """Return the mesh of ``level`` of states with H < ``energy``.

    Panels are graded towards the limit, and their length follows from ``Oscillator.kick``. For
    states that hardly ever come near the limit, ``panel`` is instead the length of the panels over
    the largest speed, the degree ``SMOOTH_DEGREE``, and there is no grading towards the limit.
    """
    left, right = (o.turning_point(energy, side) for side in (-1.0, 1.0))
    centre, radius = (0.0, right) if o.even else (0.5 * (left + right), 0.5 * (right - left))
    swift = sqrt(2.0 * energy / o.mass)
    step = PANEL * FINER**level * o.kick(radius) if panel is None else panel * swift
    pull = float(np.abs(o.force(np.array([left, right]))).max()) / o.mass
    slow = min(2.0 * o.diffusion / (pull * swift), 1.0)

    def along(x: Array) -> Array:
        q = centre + radius * np.sin(x)
        slope = radius * np.maximum(np.cos(x), 1e-3)
        smooth = _smooth_step(o, q, step, swift, level) / slope
        if panel is not None:
            return smooth
        return np.asarray(np.minimum(smooth, GRADED * (0.5 * pi - np.abs(x) + 0.3 * slow)))

    inside = [asin((q - centre) / radius) for q, _ in o.stops if left < q < right]
    first, last = 0.0 if o.even else -0.5 * pi, 0.5 * pi
    x = _nodes_at([first, *(a for a in inside if a > first), last], along, {})
    s = np.linspace(-1.0, 1.0, 1 + 2 * ceil(swift / step))
    degree = 5 + 2 * level if panel is None else SMOOTH_DEGREE
    return Mesh(o, x, s, degree, energy, centre, radius, o.even)


def _smooth_step(o: Oscillator, q: Array, step: float, swift: float, level: int) -> Array:
    """Return the panel lengths at ``q`` (points,) where T is smooth.

    Over such a length the velocity changes by ``step`` at the speed ``swift``, or at a higher speed
    that reaches ``q``. Beyond stops of a fractional power lengths grow with the overlap from a
    smallest length, which halves with each ``level``.
    """
    speed = np.sqrt(np.maximum(max(swift, step) ** 2, 2.0 * o.potential(q) / o.mass))
    slope = np.maximum(np.abs(o.force(q)) / (o.mass * speed), o.frequency)
    length = np.minimum(step / np.maximum(slope, SMALLEST), 0.5 * np.ptp(q))
    for at, side in o.stops:
        if side:
            overlap = np.maximum((q - at) * side, 0.0)
            stopped = float(o.energy(np.array(at), np.array(step)))
            most = np.minimum(length, abs(o.turning_point(stopped, side) - at))
            near = STOP_GRADING * (overlap + 0.03 * 0.5**level * most)
            length = np.where((q - at) * side >= 0.0, np.minimum(length, near), length)
    return np.asarray(length)


def _nodes_at(
    given: list[float], h: Callable[[Array], Array], closest: dict[float, float]
) -> Array:
    """Return nodes about h(x) apart that include the nodes ``given``.

    ``closest`` maps some of these to the length of the adjacent panels; towards these h is sampled
    at distances in geometric progression.
    """
    t, nodes = np.linspace(0.0, 1.0, LENGTH_SAMPLES), [np.array(given)]
    for a, b in pairwise(sorted(set(given))):
        middle, half = 0.5 * (a + b), 0.5 * (b - a)
        near, far = (
            least * (half / least) ** t if (least := closest.get(end, 0.0)) else half * t
            for end in (a, b)
        )
        x = np.concatenate([(a + near)[a + near < middle], [middle], (b - far)[b - far > middle]])
        x = np.unique(x)
        number = cumulative_trapezoid(1.0 / h(x), x, initial=0)
        count = max(1, ceil(number[-1]))
        inside = np.interp(np.linspace(0.0, number[-1], count + 1), number, x)
        nodes.append(inside[(inside > a) & (inside < b)])
    return np.unique(np.concatenate(nodes))
