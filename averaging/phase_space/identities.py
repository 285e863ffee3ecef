"""Equations that hold in any stationary state, on a solution: a judge where nothing is exact."""

import numpy as np

from averaging.phase_space.equation.damping import Polynomial, by_y, product, reach, state
from averaging.phase_space.equation.elimination import Expansion
from averaging.phase_space.equation.space import Matrix, space_to
from averaging.phase_space.marginals import Moments, moments
from averaging.phase_space.refinement import SAFETY, Ladder
from fpk.arrays import Array
from fpk.method import Identity

MARGIN = 4.0
"""Factor on the distance to the coarser solution, which may be small by chance: the L1 error of the
densities, in units of the identity's own sides, is added."""


def force_means(e: Expansion) -> tuple[Array, Array, Array]:
    """Return the means of the forces f of damping terms, in the order of the frame.

    E v_i f_i and E r_i f_i (n,), and the means (n, points) of f given y, times the density of y,
    in the weights of the points. All are 0 without damping terms.
    """
    b = e.basis
    n, top = b.frame.n, 2 + reach(b.frame)
    if not b.frame.system.damping_terms:
        return np.zeros(n), np.zeros(n), np.zeros((n, b.points.size))
    space = space_to(top, top, 2 * n - 1)
    r, v, forces = state(b, e.factor, space)
    inside = [
        np.flatnonzero((space.level == n) & (space.counted <= b.degrees.others))
        for n in range(top + 1)
    ]
    levels = [e.functions(n, b.points) for n in range(top + 1)]
    first: Polynomial = {(0, 0): Matrix(([1.0], ([0], [0])), shape=(1, len(space.level)))}

    def given(*factors: Polynomial) -> Array:
        """Mean of a product given y, in the weights of the points."""
        row, total = first, np.zeros(b.points.size)
        for factor in factors:
            row = product(row, factor)
        for powers, X in row.items():
            x = X.toarray()[0]
            total += by_y(b, powers) * sum(x[at] @ u for at, u in zip(inside, levels, strict=True))
        return total

    power, virial = (
        np.array([np.sum(given(x, f)) for x, f in zip(of, forces, strict=True)]) for of in (v, r)
    )
    return power, virial, np.array([given(f) for f in forces])


def heat_into_masses(e: Expansion, m: Moments) -> list[float]:
    """Return D_ii/m_i − Σ_j E c_ij v_i v_j of each mass, in the order of the frame.

    What a mass takes from its noise and loses to its damping in the mean; the springs carry it to
    the others, and the sum of all vanishes.
    """
    frame, n = e.basis.frame, e.basis.frame.n
    second = m.covariance[n:, n:] + np.outer(m.mean[n:], m.mean[n:])
    heat = np.diag(frame.noise) - np.sum(frame.damping * second, axis=1)
    return [float(value) for value in heat - force_means(e)[0]]


def identities(ladder: Ladder) -> tuple[Identity, ...]:
    """Return the balance of power, the virials, and two with functions outside the trial space.

    For any f, E[v f(y)] = 0 and E[v₁² f'(y)] = E[f(y) ((K (y, r) + c v)₁ + g(y))]; f is the sine of
    y in standard deviations. The error is that of the coarser solution, by its distance.
    """
    finest, coarser = _sides(ladder.finest), _sides(ladder.coarser)
    scale, out = float(np.trace(ladder.finest.basis.frame.noise)), []
    for (name, value, expected), (_, *before) in zip(finest, coarser, strict=True):
        distance = abs((value - expected) - (before[0] - before[1]))
        size = max(abs(value), abs(expected), scale)
        error = MARGIN * SAFETY * distance + max(ladder.errors.values()) * size
        out.append(Identity(name, value, expected, error))
    return tuple(out)


def _sides(e: Expansion) -> list[tuple[str, float, float]]:
    """Names of the identities, and both sides of each."""
    m, b, frame = moments(e), e.basis, e.basis.frame
    n, y, w = frame.n, b.points, b.weights
    K, c = frame.stiffness, frame.damping
    second = m.covariance + np.outer(m.mean, m.mean)
    power, virial, force = force_means(e)
    # Of the contact and of the damping terms on the contact mass, given y, in the weights.
    contact = w * e.functions(0, y)[0] * frame.contact_force(y)
    left, right = float(np.sum(c * second[n:, n:]) + np.sum(power)), float(np.trace(frame.noise))
    sides = [("Σ c_ij E v_i v_j", left, right)]
    virial[0] += contact @ y
    for i in range(n):
        right = float(K[i] @ second[:n, i] + c[i] @ second[n:, i] + virial[i])
        sides.append((f"E p{frame.order[i] + 1}²/m", float(second[n + i, n + i]), right))
    s, first = float(np.sqrt(m.covariance[0, 0])), frame.contact + 1
    sine, cosine = np.sin(y / s), np.cos(y / s) / s
    mean_force = w * (K[0] @ m.given[:n] + c[0] @ m.given[n:]) + force[0] + contact
    left, right = float(w @ (m.square * cosine)), float(sine @ mean_force)
    sides.append((f"E v{first}² cos(q{first}/s)/s", left, right))
    sides.append((f"E v{first} sin(q{first}/s)", float(w @ (m.given[n] * sine)), 0.0))
    return sides
