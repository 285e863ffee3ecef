"""Functions of the displacement y of the contact mass: polynomials on panels between its stops."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache, partial
from itertools import pairwise

import numpy as np
from scipy.linalg import null_space
from scipy.optimize import brentq

from averaging.phase_space.equation.degrees import Degrees
from averaging.phase_space.equation.frame import POWER, Frame, Reference
from fpk.numeric.arrays import SMALLEST, Array
from fpk.numeric.krylov import krylov
from fpk.numeric.quadrature import gauss_legendre

SUPPORT_DEPTH = 75.0
"""Fall of ln w from its maximum to the ends of the support, a factor of 3e-33."""
RULE_POINTS = 160
"""Gauss points of a panel, for products of polynomials of degree 60 with w and the contact
force."""
SAME_STOP = 1e-3
"""Distance of two stops over the width of the support below which there is no panel between them,
which changes densities by 3e-8."""


@dataclass(frozen=True, eq=False)
class Panel:
    """Polynomials in t(y), ``low`` < y < ``high``, orthonormal with the weight of the basis.

    Between stops (``direction`` 0) t = y. Beyond a stop at ``anchor``, on the right (1) or left
    (−1), t² = |y − anchor|/``length`` + 2 w₃ (U(y) − U(anchor)). ``last``: no further stop follows.
    ``degree`` is the number of polynomials, P_0 = ``first`` and t P_j = Σ_i recurrence[i, j] P_i,
    ``recurrence`` (degree + 1, degree).
    """

    low: float
    high: float
    direction: int
    last: bool
    anchor: float
    length: float
    degree: int
    first: float
    recurrence: Array

    def parts(self, count: int) -> Array:
        """Return the ends of ``count`` parts: equal, or beyond a stop graded, beginning there."""
        share = np.linspace(0.0, 1.0, count + 1)
        length = (self.high - self.low) * (share**4 if self.direction else share)
        return self.high - length if self.direction < 0 else self.low + length

    def rule(self, count: int) -> tuple[Array, Array]:
        """Return ``count`` Gauss points y and weights of dy; beyond a stop in |y − anchor|^½."""
        x, weight = gauss_legendre(count)
        x, weight, length = 0.5 * (1.0 + x), 0.5 * weight, self.high - self.low
        if self.direction == 0:
            return self.low + length * x, length * weight
        return self.anchor + self.direction * length * x**2, 2.0 * length * weight * x

    def polynomials(self, t: Array) -> tuple[Array, Array]:
        """Return P_j and dP_j/dt at ``t`` (points,), each (points, degree)."""
        P, dP = np.zeros((t.size, self.degree)), np.zeros((t.size, self.degree))
        P[:, 0] = self.first
        for j in range(1, self.degree):
            H = self.recurrence[: j + 1, j - 1]
            P[:, j] = (t * P[:, j - 1] - P[:, :j] @ H[:j]) / H[j]
            dP[:, j] = (P[:, j - 1] + t * dP[:, j - 1] - dP[:, :j] @ H[:j]) / H[j]
        return P, dP


@dataclass(frozen=True, eq=False)
class Basis:
    """Orthonormal functions of y in L²(w): continuous functions, and functions with jumps at stops.

    ``points`` and ``weights`` (q,) integrate f(y) w(y) dy with ∫ w = 1, w being divided by
    e^``log_norm``, and ``points`` and ``measure`` f(y) w(y)^σ dy, σ = ``POWER``. ``nodes`` are the
    ends of ``panels``. Both sets are matrices (polynomials of all panels, functions) of
    coefficients: ``continuous`` for levels of even degree, with zero slope in t at a stop, and
    ``broken`` for levels of odd degree, whose functions contain the derivatives of the others. The
    first ``counts[s][c]`` functions of set s (0 continuous, 1 broken) use at most c polynomials
    beyond a stop, 0 for c below any used. ``mirrored``: one set is even, the other odd.
    """

    frame: Frame
    reference: Reference
    degrees: Degrees
    panels: tuple[Panel, ...]
    nodes: Array
    points: Array
    weights: Array
    measure: Array
    log_norm: float
    mirrored: bool
    continuous: Array
    broken: Array
    counts: tuple[tuple[int, ...], tuple[int, ...]]

    def of_level(self, n: int) -> Array:
        """Return the coefficients of the functions of level ``n``, broken if n is odd."""
        return self.broken if n % 2 else self.continuous

    @cached_property
    def of_one(self) -> Array:
        """Coefficients of the function 1 in the continuous functions; all 0 if these are odd."""
        return np.asarray(self.continuous.T @ (self.at_points[0].T @ self.weights))

    def density(self, y: Array) -> Array:
        """Return w^σ at ``y``; 0 outside the support."""
        inside = (y >= self.nodes[0]) & (y <= self.nodes[-1])
        log_w = _log_weight(self.frame, self.reference, np.clip(y, *self.nodes[[0, -1]]))
        return np.where(inside, np.exp(POWER * (log_w - self.log_norm)), 0.0)

    @cached_property
    def at_points(self) -> tuple[Array, Array]:
        """The result of ``functions`` at the quadrature ``points``."""
        return self.functions(self.points)

    def functions(self, y: Array) -> tuple[Array, Array]:
        """Return the polynomials of all panels at ``y`` (points,), and their derivatives in y.

        Both are (points, polynomials); a panel's are 0 at points of other panels. A node belongs to
        the panel on its right; the first and the last panel include all points outside the support.
        """
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


def basis(frame: Frame, reference: Reference, degrees: Degrees, *, odd: bool = False) -> Basis:
    """Return the functions of y about ``reference`` at ``degrees``.

    ``odd``: for densities that change sign under reflection, with the two parities exchanged.
    """
    panels, points, weights = [], [], []
    for panel in _support_panels(frame, reference):
        width = float((panel.high - panel.low) * np.sqrt(reference.weight[1]))
        touched = panel.direction != 0
        degree = degrees.outer if panel.last else degrees.between(width, beyond=touched)
        panels.append(replace(panel, degree=degree))
        y, dy = panel.rule(RULE_POINTS)
        points.append(y)
        weights.append(dy * np.exp(_log_weight(frame, reference, y)))
    total = float(np.sum(weights))
    for k, (panel, y, w) in enumerate(zip(panels, points, weights, strict=True)):
        t, _ = _coordinate(frame, reference, panel, y)
        root = np.sqrt(w / total)
        *_, (_, H, _) = krylov(partial(np.multiply, t[:, None]), root[:, None], panel.degree)
        # The first vector is √w P_0.
        panels[k] = replace(panel, first=1.0 / float(np.linalg.norm(root)), recurrence=H)
    # Columns of the identity on the polynomials of all panels, by panel.
    size = sum(p.degree for p in panels)
    units = np.split(np.eye(size), np.cumsum([p.degree for p in panels])[:-1])
    # Conditions for continuous functions with zero slope in t at stops. Where two panels meet there
    # is the stop of at least one of them, at which its t is 0.
    rows = [
        p.polynomials(np.zeros(1))[1] @ e for p, e in zip(panels, units, strict=True) if p.direction
    ]
    for pair, (left, right) in zip(pairwise(panels), pairwise(units), strict=True):
        y = np.array([pair[0].high])
        a, b = (p.polynomials(_coordinate(frame, reference, p, y)[0])[0] for p in pair)
        rows.append(a @ left - b @ right)
    mirrored = frame.symmetric and not reference.weight[0]
    parity: list[list[Array]] = [[], []]
    if mirrored:
        # Conditions for even and for odd functions: P_j(−t) = (−1)^j P_j(t) on the middle panel;
        # beyond stops t is the same on both sides.
        for only, sign in zip(parity, (1.0, -1.0), strict=True):
            for k, p in enumerate(panels[: (len(panels) + 1) // 2]):
                image = sign * (1.0 if p.direction else (-1.0) ** np.arange(p.degree))
                only.append(units[k] - np.reshape(image, (-1, 1)) * units[-1 - k])
    sets = [*rows, *parity[odd]], parity[not odd]
    (continuous, broken), counts = zip(
        *(_function_sets(panels, degrees, own, fewer=k) for k, own in enumerate(sets)),
        strict=True,
    )
    nodes = np.array([panels[0].low, *(p.high for p in panels)])
    y, w = np.concatenate(points), np.concatenate(weights) / total
    log_norm = float(np.log(total))
    measure = w * np.exp((POWER - 1.0) * (_log_weight(frame, reference, y) - log_norm))
    given = frame, reference, degrees, tuple(panels), nodes, y, w, measure, log_norm, mirrored
    return Basis(*given, continuous, broken, counts)


def _function_sets(
    panels: Sequence[Panel], degrees: Degrees, rows: Sequence[Array], *, fewer: int
) -> tuple[Array, tuple[int, ...]]:
    """Return orthonormal functions that meet the conditions ``rows``, and numbers of functions.

    The functions are columns (polynomials of all panels, functions); the first numbers[c] of them
    use at most c polynomials beyond a stop. Sets of derivatives have ``fewer`` = 1: their degree in
    t is lower by one between stops, by two beyond a stop.
    """
    degree = np.concatenate([np.arange(p.degree) for p in panels])
    every = np.concatenate([np.zeros((0, degree.size)), *rows])
    every = every[every.any(axis=1)]
    columns, counts = np.zeros((degree.size, 0)), [0] * degrees.least
    for count in range(degrees.least, degrees.outer + 1):
        numbers = [
            (count if p.last else degrees.fewer(p.degree, count))
            - (2 if p.direction else 1) * fewer
            for p in panels
        ]
        used = degree < np.repeat(numbers, [p.degree for p in panels])
        C = every[:, used]
        solution = null_space(C) if C.size else np.eye(C.shape[1])
        space = np.zeros((degree.size, solution.shape[1]))
        space[used] = solution
        space -= columns @ (columns.T @ space)
        U, size, _ = np.linalg.svd(space, full_matrices=False)
        columns = np.hstack([columns, U[:, size > 0.5]])
        counts.append(columns.shape[1])
    return columns, tuple(counts)


def _coordinate(frame: Frame, reference: Reference, panel: Panel, y: Array) -> tuple[Array, Array]:
    """Return t at ``y`` (points,) of ``panel``, and dt/dy, set to 0 at a stop."""
    if panel.direction == 0:
        return y, np.ones(y.size)
    contact, sign = 2.0 * reference.weight[2], panel.direction
    beyond = np.maximum(sign * (y - panel.anchor), 0.0)
    energy = frame.contact_energy(y) - frame.contact_energy(np.array([panel.anchor]))[0]
    t = np.sqrt(np.maximum(beyond / panel.length + contact * energy, 0.0))
    square_rate = sign / panel.length + contact * frame.contact_force(y)
    return t, np.where(t > 0.0, 0.5 * square_rate / np.where(t > 0.0, t, 1.0), 0.0)


def _log_weight(frame: Frame, reference: Reference, y: Array) -> Array:
    """Return ln w at ``y`` (points,) of the reference, up to a constant."""
    linear, square, contact = reference.weight
    return np.asarray(-(linear * y + 0.5 * square * y**2 + contact * frame.contact_energy(y)))


@lru_cache(maxsize=4)
def _support_panels(frame: Frame, reference: Reference) -> tuple[Panel, ...]:
    """Return the panels without polynomials, on the support of w (``SUPPORT_DEPTH``)."""

    def root(f: Callable[[Array], Array], value: float, a: float, b: float) -> float:
        return float(brentq(lambda y: float(f(np.array([y]))[0]) - value, a, b, xtol=SMALLEST))

    linear, square, contact = reference.weight
    # The support without stops, which stops only make narrower.
    reach = 2.0 * (np.sqrt(2.0 * SUPPORT_DEPTH / square) + abs(linear / square))
    y = np.linspace(-reach, reach, 4001)
    log_w = _log_weight(frame, reference, y)
    top, lowest = y[log_w.argmax()], log_w.max() - SUPPORT_DEPTH
    low, high = (
        root(partial(_log_weight, frame, reference), lowest, *ends)
        for ends in ((-reach, top), (top, reach))
    )
    near = SAME_STOP * (high - low)
    # Displacements at which contact begins, on the left and on the right.
    stops = [(s.sign, s.sign * s.clearance * frame.root) for s in frame.system.stops]
    left, right = (
        np.unique([y for side, y in stops if side == s and low < y < high]) for s in (-1.0, 1.0)
    )
    if left.size and right.size and right[0] - left[-1] <= near:
        left[-1] = right[0] = 0.5 * (left[-1] + right[0])
    nodes = np.concatenate([[low], left, right, [high]])
    nodes = nodes[np.concatenate([[True], np.diff(nodes) > near])]
    panels = []
    for a, b in pairwise(map(float, nodes)):
        # A left stop is the anchor of the panel on its left, a right stop of that on its right.
        direction = int(np.any(np.abs(right - a) <= near)) or -int(np.any(np.abs(left - b) <= near))
        anchor, end = (b, a) if direction < 0 else (a, b)
        if direction:
            # ``length`` ends where 2 w₃ (U − U(anchor)) = 1, so that t² = 2, or with the panel.
            most = 0.5 / contact + frame.contact_energy(np.array([anchor]))[0]
            if frame.contact_energy(np.array([end]))[0] > most:
                end = root(frame.contact_energy, most, anchor, end)
        last = bool(direction) and (a == nodes[0] or b == nodes[-1])
        nothing = 0, 1.0, np.zeros((1, 0))
        panels.append(Panel(a, b, direction, last, anchor, abs(end - anchor), *nothing))
    return tuple(panels)
