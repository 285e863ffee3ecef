"""Equations that hold in any stationary state, on a solution: a judge where nothing is exact."""

from dataclasses import dataclass

import numpy as np

from averaging.phase_space.equation.damping import (
    Polynomial,
    by_y,
    product,
    reach,
    state,
)
from averaging.phase_space.equation.elimination import Expansion
from averaging.phase_space.equation.frame import Frame
from averaging.phase_space.equation.others import Matrix, Space, first_and_second
from averaging.phase_space.moments import moments
from averaging.phase_space.refinement import SAFETY, Ladder
from fpk.arrays import Array
from fpk.method import Identity

MARGIN = 4.0
"""Factor on the distance to the coarser solution, which may be small by chance: the L1 error of the
densities, in units of the identity's own sides, is added."""


@dataclass(frozen=True, eq=False)
class Means:
    """Means of the forces f in an expansion, in the order of the frame.

    ``power`` E v_i f_i and ``virial`` E r_i f_i (n,); ``given`` (n, points) is that of f given y,
    times the density of y, in the weights of the points.
    """

    power: Array
    virial: Array
    given: Array


def force_means(frame: Frame, e: Expansion) -> Means:
    """Return the means of the forces of damping terms; 0 without any."""
    n, top, b = frame.n, 2 + reach(frame), e.basis
    if not frame.system.damping_terms:
        return Means(np.zeros(n), np.zeros(n), np.zeros((n, b.points.size)))
    space = Space.to(top, top, 2 * n - 1)
    s = state(frame, b.reference, e.factor, space)
    inside = [
        np.flatnonzero((space.level == level) & (space.counted <= e.degrees.others))
        for level in range(top + 1)
    ]
    levels = [e.functions(level, b.points) for level in range(top + 1)]
    first: Polynomial = {(0, 0): Matrix(([1.0], ([0], [0])), shape=(1, len(space.level)))}

    def given(*factors: Polynomial) -> Array:
        """Mean of a product given y, in the weights of the points."""
        row, total = first, np.zeros(b.points.size)
        for factor in factors:
            row = product(row, factor)
        for powers, X in row.items():
            x = X.toarray()[0]
            by_z = sum(x[at] @ u for at, u in zip(inside, levels, strict=True))
            total += by_y(frame, b, powers) * by_z
        return total

    pairs = tuple(zip(s.v, s.r, s.forces, strict=True))
    return Means(
        np.array([np.sum(given(v, f)) for v, _, f in pairs]),
        np.array([np.sum(given(r, f)) for _, r, f in pairs]),
        np.array([given(f) for f in s.forces]),
    )


def heat_into_masses(frame: Frame, e: Expansion) -> list[float]:
    """Return D_ii/m_i − Σ_j E c_ij v_i v_j of each mass, in the order of the frame.

    What a mass takes from its noise and loses to its damping in the mean; the springs carry it to
    the others, and the sum of all vanishes.
    """
    n, m = frame.n, moments(frame, e)
    second = m.covariance[n:, n:] + np.outer(m.mean[n:], m.mean[n:])
    heat = np.diag(frame.noise) - np.sum(frame.damping * second, axis=1)
    return [float(value) for value in heat - force_means(frame, e).power]


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
    terms = force_means(frame, e)
    sides = {
        "Σ c_ij E v_i v_j": (
            float(np.sum(frame.damping * second[n:, n:]) + np.sum(terms.power)),
            float(np.trace(frame.noise)),
        )
    }
    for i in range(n):
        contact = float(w @ (u0 * y * force)) if i == 0 else 0.0
        right = frame.stiffness[i] @ second[:n, i] + frame.damping[i] @ second[n:, i] + contact
        right = right + terms.virial[i]
        sides[f"E p{frame.order[i] + 1}²/m"] = (float(second[n + i, n + i]), float(right))
    s = float(np.sqrt(m.covariance[0, 0]))
    sine, cosine = np.sin(y / s), np.cos(y / s) / s
    given, square = _given(frame, e)
    left = float(w @ (square * cosine))
    mean_force = frame.stiffness[0] @ given[:n] + frame.damping[0] @ given[n:]
    right = float(w @ (sine * mean_force) + sine @ terms.given[0])
    sides[f"E v{first}² cos(q{first}/s)/s"] = (left, right + float(w @ (u0 * sine * force)))
    sides[f"E v{first} sin(q{first}/s)"] = (float(m.flow @ sine), 0.0)
    return sides


def _given(frame: Frame, e: Expansion) -> tuple[Array, Array]:
    """Means of (y, r, v) and of v₁² given y, times the density of y over w, at the points."""
    n, b, C, y = frame.n, e.basis, e.factor, e.basis.points
    one, two = first_and_second(e.others, 2 * n - 1)
    u0, u1, u2 = e.functions(0, y)[0], e.functions(1, y), e.functions(2, y)
    z = C @ one @ u1
    r = z[n:] + (b.reference.slope[:, None] * y + b.reference.offset[:, None]) * u0
    square = C[0, 0] ** 2 * (u0 + two[0, 0] @ u2)
    return np.vstack([y * u0, r, z[:n]]), square
