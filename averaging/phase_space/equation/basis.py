"""Functions of the contact displacement over all panels: continuous ones and their derivatives."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
from scipy.linalg import null_space

from averaging.phase_space.equation.degrees import Degrees
from averaging.phase_space.equation.frame import Frame, Reference
from averaging.phase_space.equation.panels import (
    RULE_POINTS,
    Panel,
    bare_panels,
    coordinate,
    log_weight,
    orthonormal,
)
from fpk.arrays import Array


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
    ``counts[s][c]`` is how many functions of set s, in front, have c polynomials beyond a stop, 0
    for fewer than any degree has.

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
        values, _ = self.at_points
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

    @cached_property
    def at_points(self) -> tuple[Array, Array]:
        """Functions of all panels and their derivatives at the points."""
        return self.functions(self.points)

    def functions(self, y: Array) -> tuple[Array, Array]:
        """Functions of all panels at y (points,) inside the support, and their derivatives in y."""
        starts = np.cumsum([0, *(p.degree for p in self.panels)])
        values, slopes = (np.zeros((y.size, starts[-1])) for _ in range(2))
        which = np.clip(np.searchsorted(self.nodes, y, side="right") - 1, 0, len(self.panels) - 1)
        for k, panel in enumerate(self.panels):
            at = np.flatnonzero(which == k)
            t, rate = coordinate(self.frame, self.reference, panel, y[at])
            P, dP = panel.polynomials(t)
            values[at, starts[k] : starts[k + 1]] = P
            slopes[at, starts[k] : starts[k + 1]] = dP * rate[:, None]
        return values, slopes


def basis(frame: Frame, reference: Reference, degrees: Degrees, *, odd: bool = False) -> Basis:
    """Return the functions of y of an expansion. Panels end at the stops.

    ``odd``: those of what changes its sign with the mirror image, odd ones for even ones and even
    ones for odd ones.
    """
    panels = bare_panels(frame, reference, degrees)
    y, dy = (np.concatenate(x) for x in zip(*(p.rule(RULE_POINTS) for p in panels), strict=True))
    w = dy * np.exp(log_weight(frame, reference, y))
    w /= (total := float(w.sum()))
    for k, panel in enumerate(panels):
        at = slice(k * RULE_POINTS, (k + 1) * RULE_POINTS)
        t, _ = coordinate(frame, reference, panel, y[at])
        first, recurrence = orthonormal(t, w[at], panel.degree)
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
        if count < degrees.least:
            counts.append(0)
            continue
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


def _continuity(frame: Frame, reference: Reference, panels: Sequence[Panel]) -> Array:
    """Rows that vanish on functions that are continuous and have no slope in t at a stop.

    Panels meet at a stop of at least one of them, where t of that one is 0.
    """
    starts = np.cumsum([0, *(p.degree for p in panels)])
    rows = []
    for k, (a, b) in enumerate(pairwise(panels)):
        row = np.zeros(starts[-1])
        for panel, at, sign in ((a, starts[k], 1.0), (b, starts[k + 1], -1.0)):
            t, _ = coordinate(frame, reference, panel, np.array([a.high]))
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
