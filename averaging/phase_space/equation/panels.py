"""Functions of the displacement of the contact mass: polynomials on panels between its stops."""

from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import pairwise

import numpy as np
from scipy.optimize import brentq

from averaging.phase_space.equation.degrees import Degrees
from averaging.phase_space.equation.frame import Frame, Reference
from fpk.arrays import Array
from fpk.quadrature import gauss_legendre

DEEP = 75.0
"""−ln w at the ends of the support: w is 3e-33 of its largest value there."""
RULE_POINTS = 160
"""Gauss points of a panel: products of polynomials of degree 60 with w and the contact force."""
SAME = 1e-3
"""Distance of two stops, in widths of the support, below which there is no panel between them: what
is not smooth at the second of them, (y − δ)^(5/2) in ln w, is 3e-8 there."""


@dataclass(frozen=True, eq=False)
class Panel:
    """Polynomials in t(y) between ``low`` and ``high``, orthonormal with the weight of the basis.

    Between stops (``direction`` 0) t is y. Beyond a stop at ``anchor``, on the right (1) or left
    (−1), t² = |y − anchor|/``length`` + 2 w₃ (U(y) − U(anchor)), where 2 w₃ U is 1 one ``length``
    beyond: so a polynomial in the energy is one of the same degree in t as in a velocity, and the
    contact force, which starts as (y − anchor)^e, is smooth in t for half-integer e. ``last`` says
    that no other stop follows.
    ``recurrence`` (degree + 1, degree) makes the polynomials: t P_j = Σ_i recurrence[i, j] P_i,
    and P_0 is ``first``.
    """

    low: float
    high: float
    direction: int
    last: bool
    anchor: float
    length: float
    first: float
    recurrence: Array

    @property
    def degree(self) -> int:
        """Number of polynomials."""
        return int(self.recurrence.shape[1])

    def parts(self, count: int) -> Array:
        """Ends of ``count`` parts of the panel, graded towards its stop, where y is not smooth."""
        share = np.linspace(0.0, 1.0, count + 1)
        if self.direction < 0:
            return self.high - (self.high - self.low) * share[::-1] ** 4
        return self.low + (self.high - self.low) * (share**4 if self.direction else share)

    def rule(self, count: int) -> tuple[Array, Array]:
        """``count`` Gauss points y, in |y − anchor|^½ beyond a stop, and weights that integrate."""
        x, weight = gauss_legendre(count)
        x, weight, length = 0.5 * (1.0 + x), 0.5 * weight, self.high - self.low
        if self.direction == 0:
            return self.low + length * x, length * weight
        return self.anchor + self.direction * length * x**2, 2.0 * length * weight * x

    def polynomials(self, t: Array) -> tuple[Array, Array]:
        """P_j(t) and dP_j/dt, shapes (points, degree)."""
        P, dP = np.zeros((t.size, self.degree)), np.zeros((t.size, self.degree))
        P[:, 0] = self.first
        for j in range(1, self.degree):
            H = self.recurrence[: j + 1, j - 1]
            P[:, j] = (t * P[:, j - 1] - P[:, :j] @ H[:j]) / H[j]
            dP[:, j] = (P[:, j - 1] + t * dP[:, j - 1] - dP[:, :j] @ H[:j]) / H[j]
        return P, dP


def coordinate(frame: Frame, reference: Reference, panel: Panel, y: Array) -> tuple[Array, Array]:
    """t at y of a panel, and dt/dy; 0 at a stop, where no function has a slope in t."""
    if panel.direction == 0:
        return y, np.ones(y.size)
    contact, sign = 2.0 * reference.weight[2], panel.direction
    beyond = np.maximum(sign * (y - panel.anchor), 0.0)
    energy = frame.contact_energy(y) - frame.contact_energy(np.array([panel.anchor]))[0]
    t = np.sqrt(np.maximum(beyond / panel.length + contact * energy, 0.0))
    square_rate = sign / panel.length + contact * frame.contact_force(y)
    return t, np.where(t > 0.0, 0.5 * square_rate / np.where(t > 0.0, t, 1.0), 0.0)


def log_weight(frame: Frame, reference: Reference, y: Array) -> Array:
    """Return ln w(y) of the reference, up to a constant."""
    linear, square, contact = reference.weight
    return np.asarray(-(linear * y + 0.5 * square * y**2 + contact * frame.contact_energy(y)))


def support(frame: Frame, reference: Reference) -> tuple[float, float]:
    """Return the ends between which ln w is within ``DEEP`` of its maximum."""
    linear, square, _ = reference.weight
    middle = -linear / square
    # Stops only narrow the Gaussian that is left without them.
    reach = np.sqrt(2.0 * DEEP / square) + abs(middle)
    y = np.linspace(-2.0 * reach, 2.0 * reach, 4001)
    log_w = log_weight(frame, reference, y)
    top = int(log_w.argmax())

    def depth(share: float) -> float:
        at = np.array([share * reach])
        return float(log_w[top] - log_weight(frame, reference, at)[0]) - DEEP

    ends = [brentq(depth, a / reach, b / reach) for a, b in ((y[0], y[top]), (y[top], y[-1]))]
    return float(ends[0] * reach), float(ends[1] * reach)


def bare_panels(frame: Frame, reference: Reference, degrees: Degrees) -> list[Panel]:
    """Panels between the stops and beyond them, with how many polynomials, but not yet which."""
    panels = []
    for panel in _panels(frame, reference):
        width = float((panel.high - panel.low) * np.sqrt(reference.weight[1]))
        touched = panel.direction != 0
        degree = degrees.outer if panel.last else degrees.between(width, beyond=touched)
        panels.append(replace(panel, recurrence=np.zeros((degree + 1, degree))))
    return panels


@lru_cache(maxsize=4)
def _panels(frame: Frame, reference: Reference) -> tuple[Panel, ...]:
    """Panels without polynomials: where they end, and the lengths beyond the stops."""
    low, high = support(frame, reference)
    left, right = (x[(x > low) & (x < high)] for x in frame.stops)
    near = SAME * (high - low)
    if left.size and right.size and right[0] - left[-1] <= near:
        left[-1] = right[0] = 0.5 * (left[-1] + right[0])
    nodes = np.concatenate([[low], left, right, [high]])
    nodes = nodes[np.concatenate([[True], np.diff(nodes) > near])]
    panels = []
    for a, b in pairwise(nodes):
        # A left stop anchors what is left of it, a right stop what is right of it.
        direction = -1 if np.any(np.abs(left - b) <= near) else 0
        direction = 1 if np.any(np.abs(right - a) <= near) else direction
        anchor = float(b if direction < 0 else a)
        length = _length(frame, reference, anchor, float(a + b - anchor)) if direction else 1.0
        last = bool(direction) and (a == nodes[0] or b == nodes[-1])
        nothing = np.zeros((1, 0))
        panels.append(Panel(float(a), float(b), direction, last, anchor, length, 1.0, nothing))
    return tuple(panels)


def _length(frame: Frame, reference: Reference, anchor: float, end: float) -> float:
    """Distance beyond a stop at which 2 w₃ (U − U(anchor)) is 1, at the most that to ``end``."""
    start = frame.contact_energy(np.array([anchor]))[0]

    def excess(share: float) -> float:
        energy = frame.contact_energy(np.array([anchor + share * (end - anchor)]))[0] - start
        return float(2.0 * reference.weight[2] * energy - 1.0)

    share = 1.0 if excess(1.0) <= 0.0 else float(brentq(excess, 0.0, 1.0))
    return share * abs(end - anchor)


def orthonormal(t: Array, w: Array, degree: int) -> tuple[float, Array]:
    """Return P_0 and the recurrence of ``degree`` orthonormal polynomials of the measure w at t.

    By Arnoldi's method, each orthogonalised twice.
    """
    P, H = np.zeros((t.size, degree)), np.zeros((degree + 1, degree))
    P[:, 0] = first = 1.0 / np.sqrt(w.sum())
    for j in range(1, degree):
        new = t * P[:, j - 1]
        for _ in range(2):
            part = P[:, :j].T @ (w * new)
            new = new - P[:, :j] @ part
            H[:j, j - 1] += part
        H[j, j - 1] = np.sqrt(w @ new**2)
        P[:, j] = new / H[j, j - 1]
    return float(first), H
