"""Equations that hold in any stationary state, on a solution: a judge where nothing is exact."""

import numpy as np

from averaging.phase_space.elimination import Expansion
from averaging.phase_space.frame import Frame
from averaging.phase_space.moments import Moments, moments
from averaging.phase_space.refinement import SAFETY, Ladder
from fpk.arrays import Array
from fpk.method import Identity

MARGIN = 4.0
"""Factor on the distance to the coarser solution, which may be small by chance: the L1 error of the
densities, in units of the identity's own sides, is added."""


def heat_into_masses(frame: Frame, m: Moments) -> list[float]:
    """Return D_ii/m_i − Σ_j c_ij E v_i v_j of each mass, in the order of the frame.

    What a mass takes from its noise and loses to its damping in the mean; the springs carry it to
    the others, and the sum of all vanishes.
    """
    n = frame.n
    second = m.covariance[n:, n:] + np.outer(m.mean[n:], m.mean[n:])
    heat = np.diag(frame.noise) - np.sum(frame.damping * second, axis=1)
    return [float(value) for value in heat]


def identities(ladder: Ladder) -> tuple[Identity, ...]:
    """Return the balance of power, the virials, and two with functions outside the trial space.

    For any f, E[v f(y)] = 0 and E[v₁² f'(y)] = E[f(y) ((K (y, r) + c v)₁ + g(y))]; f is the sine of
    y in standard deviations. The error is that of the coarser solution, by its distance.
    """
    finest, coarser = (_sides(ladder.frame, e) for e in (ladder.finest, ladder.coarser))
    scale = float(np.trace(ladder.frame.noise))
    out = []
    for name, (value, expected) in finest.items():
        before = coarser[name]
        distance = abs((value - expected) - (before[0] - before[1]))
        size = max(abs(value), abs(expected), scale)
        error = MARGIN * SAFETY * distance + max(ladder.errors.values()) * size
        out.append(Identity(name, value, expected, error))
    return tuple(out)


def _sides(frame: Frame, e: Expansion) -> dict[str, tuple[float, float]]:
    m, n, b = moments(frame, e), frame.n, e.basis
    y, w = b.points, b.weights
    second = m.covariance + np.outer(m.mean, m.mean)
    u0 = e.functions(0, y)[0]
    force = frame.contact_force(y)
    first = int(frame.order[0]) + 1
    sides = {
        "Σ c_ij E v_i v_j": (
            float(np.sum(frame.damping * second[n:, n:])),
            float(np.trace(frame.noise)),
        )
    }
    for i in range(n):
        contact = float(w @ (u0 * y * force)) if i == 0 else 0.0
        right = frame.stiffness[i] @ second[:n, i] + frame.damping[i] @ second[n:, i] + contact
        sides[f"E p{frame.order[i] + 1}²/m"] = (float(second[n + i, n + i]), float(right))
    s = float(np.sqrt(m.covariance[0, 0]))
    sine, cosine = np.sin(y / s), np.cos(y / s) / s
    given, square = _given(frame, e)
    left = float(w @ (square * cosine))
    right = float(w @ (sine * (frame.stiffness[0] @ given[:n] + frame.damping[0] @ given[n:])))
    sides[f"E v{first}² cos(q{first}/s)/s"] = (left, right + float(w @ (u0 * sine * force)))
    sides[f"E v{first} sin(q{first}/s)"] = (float(m.flow @ sine), 0.0)
    return sides


def _given(frame: Frame, e: Expansion) -> tuple[Array, Array]:
    """Means of (y, r, v) and of v₁² given y, times the density of y over w, at the points."""
    n, b, C, y = frame.n, e.basis, e.factor, e.basis.points
    u0, u1, u2 = e.functions(0, y)[0], e.functions(1, y), e.functions(2, y)
    z = np.zeros((2 * n - 1, y.size))
    for row, u in zip(e.degree(1), u1, strict=True):
        z += C[:, int(row.argmax()), None] * u
    r = z[n:] + (b.reference.slope[:, None] * y + b.reference.offset[:, None]) * u0
    square = C[0, 0] ** 2 * u0
    for row, u in zip(e.degree(2), u2, strict=True):
        if row[0] == 2:
            square = square + np.sqrt(2.0) * C[0, 0] ** 2 * u
    return np.vstack([y * u0, r, z[:n]]), square
