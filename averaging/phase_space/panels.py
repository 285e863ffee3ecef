"""Functions of the displacement of the contact mass: polynomials on panels between its stops."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy.linalg import null_space
from scipy.optimize import brentq

from averaging.phase_space.degrees import Degrees
from averaging.phase_space.frame import Frame, Reference
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


@dataclass(frozen=True, eq=False)
class Basis:
    """Orthonormal functions of y in L²(w): continuous ones and their derivatives.

    ``points`` (q,) and ``weights`` (q,) integrate f(y) w(y) dy, ∫ w = 1; ``log_norm`` is the ln of
    what divides e^(ln w). ``nodes`` are the ends of the panels.

    ``continuous`` and ``broken`` (functions of all panels, functions) hold two sets by their
    coefficients. Those of the first are continuous, and have no term in t itself beyond a stop,
    whose slope in y has no bound; those of the second may jump at the stops and have the degrees of
    the derivatives of the first. The derivative of the first is then as good as any function of the
    second, and none of either is lost on the other. Levels of even degree have continuous
    functions, those of odd degree broken ones, as ∂/∂y connects a level with its neighbours only.
    ``counts[s][c]`` is how many functions of set s, in front, have c polynomials beyond a stop.

    Where state and mirror image are equally likely (``mirrored``) the first are even and the
    second are odd, or the other way round.
    """

    reference: Reference
    frame: Frame
    panels: tuple[Panel, ...]
    nodes: Array
    points: Array
    weights: Array
    log_norm: float
    mirrored: bool
    continuous: Array
    broken: Array
    counts: tuple[tuple[int, ...], tuple[int, ...]]

    def of_level(self, n: int) -> Array:
        """The functions of level n by their coefficients, (functions of all panels, functions)."""
        return self.broken if n % 2 else self.continuous

    def log_slope(self) -> Array:
        """d ln w/dy at the points."""
        linear, square, contact = self.reference.weight
        force = self.frame.contact_force(self.points)
        return np.asarray(-(linear + square * self.points + contact * force))

    def of_one(self) -> Array:
        """Coefficients of the function 1 in the continuous functions."""
        values, _ = self.functions(self.points)
        return np.asarray(self.continuous.T @ (values.T @ self.weights))

    def density(self, y: Array) -> Array:
        """w(y), 0 outside the support."""
        inside = (y >= self.nodes[0]) & (y <= self.nodes[-1])
        log_w = log_weight(self.frame, self.reference, np.clip(y, *self.nodes[[0, -1]]))
        return np.where(inside, np.exp(log_w - self.log_norm), 0.0)

    def rule(self, count: int) -> tuple[Array, Array]:
        """Points y, ``count`` a panel, and weights that integrate over y."""
        rules = [panel.rule(count) for panel in self.panels]
        return tuple(np.concatenate(x) for x in zip(*rules, strict=True))  # type: ignore[return-value]

    def fine_nodes(self, count: int) -> Array:
        """Ends of ``count`` parts of each panel."""
        return np.unique(np.concatenate([p.parts(count) for p in self.panels]))

    def functions(self, y: Array) -> tuple[Array, Array]:
        """Functions of all panels at y (points,) inside the support, and their derivatives in y."""
        starts = np.cumsum([0, *(p.degree for p in self.panels)])
        values, slopes = (np.zeros((y.size, starts[-1])) for _ in range(2))
        which = np.clip(np.searchsorted(self.nodes, y, side="right") - 1, 0, len(self.panels) - 1)
        for k, panel in enumerate(self.panels):
            at = np.flatnonzero(which == k)
            t, rate = _coordinate(self.frame, self.reference, panel, y[at])
            P, dP = panel.polynomials(t)
            values[at, starts[k] : starts[k + 1]] = P
            slopes[at, starts[k] : starts[k + 1]] = dP * rate[:, None]
        return values, slopes


def _coordinate(frame: Frame, reference: Reference, panel: Panel, y: Array) -> tuple[Array, Array]:
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


def polynomials(frame: Frame, reference: Reference, degrees: Degrees) -> tuple[int, ...]:
    """Return the number of polynomials of each panel."""
    return tuple(p.degree for p in _bare_panels(frame, reference, degrees))


def _bare_panels(frame: Frame, reference: Reference, degrees: Degrees) -> list[Panel]:
    """Panels between the stops and beyond them, with how many polynomials, but not yet which."""
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
        width = float((b - a) * np.sqrt(reference.weight[1]))
        degree = degrees.outer if last else degrees.between(width)
        nothing = np.zeros((degree + 1, degree))
        panels.append(Panel(float(a), float(b), direction, last, anchor, length, 1.0, nothing))
    return panels


def basis(frame: Frame, reference: Reference, degrees: Degrees, *, odd: bool = False) -> Basis:
    """Return the functions of y of an expansion. Panels end at the stops.

    ``odd``: those of what changes its sign with the mirror image, odd ones for even ones and even
    ones for odd ones.
    """
    panels = _bare_panels(frame, reference, degrees)
    y, dy = (np.concatenate(x) for x in zip(*(p.rule(RULE_POINTS) for p in panels), strict=True))
    w = dy * np.exp(log_weight(frame, reference, y))
    w /= (total := float(w.sum()))
    for k, panel in enumerate(panels):
        at = slice(k * RULE_POINTS, (k + 1) * RULE_POINTS)
        t, _ = _coordinate(frame, reference, panel, y[at])
        first, recurrence = _orthonormal(t, w[at], panel.degree)
        panels[k] = replace(panel, first=first, recurrence=recurrence)
    mirrored = frame.symmetric and not reference.weight[0]
    rows = _continuity(frame, reference, panels)
    parity = [_of_parity(panels, sign) if mirrored else rows[:0] for sign in (1, -1)]
    continuous = _nested(panels, degrees, np.vstack([rows, parity[odd]]), fewer=0)
    broken = _nested(panels, degrees, parity[not odd], fewer=1)
    return Basis(
        reference,
        frame,
        tuple(panels),
        np.array([panels[0].low, *(p.high for p in panels)]),
        y,
        w,
        float(np.log(total)),
        mirrored,
        continuous[0],
        broken[0],
        (continuous[1], broken[1]),
    )


def _nested(
    panels: Sequence[Panel], degrees: Degrees, rows: Array, *, fewer: int
) -> tuple[Array, tuple[int, ...]]:
    """Return orthonormal functions on which ``rows`` vanish, and how many come with each count.

    The first of them are those of few polynomials, so that sets of fewer are the front of the whole
    one. ``fewer`` is how often the derivative in y is taken: in t it lowers the degree by one
    between stops and, as t² is linear in y there, by two beyond one.
    """
    degree = np.concatenate([np.arange(p.degree) for p in panels])
    columns, counts = np.zeros((degree.size, 0)), []
    for count in range(degrees.outer + 1):
        numbers = [
            (count if p.last else degrees.fewer(p.degree, count))
            - (2 if p.direction else 1) * fewer
            for p in panels
        ]
        used = degree < np.repeat(numbers, [p.degree for p in panels])
        C = rows[:, used]
        solution = null_space(C) if C.size else np.eye(C.shape[1])
        space = np.zeros((degree.size, solution.shape[1]))
        space[used] = solution
        space -= columns @ (columns.T @ space)
        U, size, _ = np.linalg.svd(space, full_matrices=False)
        columns = np.hstack([columns, U[:, size > 0.5]])
        counts.append(columns.shape[1])
    return columns, tuple(counts)


def _length(frame: Frame, reference: Reference, anchor: float, end: float) -> float:
    """Distance beyond a stop at which 2 w₃ (U − U(anchor)) is 1, at the most that to ``end``."""
    start = frame.contact_energy(np.array([anchor]))[0]

    def excess(share: float) -> float:
        energy = frame.contact_energy(np.array([anchor + share * (end - anchor)]))[0] - start
        return float(2.0 * reference.weight[2] * energy - 1.0)

    share = 1.0 if excess(1.0) <= 0.0 else float(brentq(excess, 0.0, 1.0))
    return share * abs(end - anchor)


def _orthonormal(t: Array, w: Array, degree: int) -> tuple[float, Array]:
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


def _continuity(frame: Frame, reference: Reference, panels: Sequence[Panel]) -> Array:
    """Rows that vanish on functions that are continuous and have no slope in t at a stop.

    Panels meet at a stop of at least one of them, where t of that one is 0.
    """
    starts = np.cumsum([0, *(p.degree for p in panels)])
    rows = []
    for k, (a, b) in enumerate(pairwise(panels)):
        row = np.zeros(starts[-1])
        for panel, at, sign in ((a, starts[k], 1.0), (b, starts[k + 1], -1.0)):
            t, _ = _coordinate(frame, reference, panel, np.array([a.high]))
            row[at : at + panel.degree] = sign * panel.polynomials(t)[0][0]
        rows.append(row)
    for k, panel in enumerate(panels):
        if panel.direction:
            row = np.zeros(starts[-1])
            row[starts[k] : starts[k + 1]] = panel.polynomials(np.zeros(1))[1][0]
            rows.append(row)
    return np.array(rows).reshape(len(rows), starts[-1])


def _of_parity(panels: Sequence[Panel], sign: int) -> Array:
    """Rows that vanish on functions that are even (``sign`` 1) or odd (−1) in y."""
    starts = np.cumsum([0, *(p.degree for p in panels)])
    rows, last = [], len(panels) - 1
    for k in range((len(panels) + 1) // 2):
        for j in range(panels[k].degree):
            row = np.zeros(starts[-1])
            # P_j(−t) = (−1)^j P_j(t) in the middle; beyond stops t is the same on both sides.
            row[starts[k] + j] = 1.0
            row[starts[last - k] + j] -= sign * (1.0 if panels[k].direction else (-1.0) ** j)
            rows.append(row)
    return np.array([row for row in rows if row.any()]).reshape(-1, starts[-1])
