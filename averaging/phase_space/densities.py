"""Densities of q and p from an expansion in Hermite functions, and moment identities, with errors.

The identities hold exactly in any stationary state, and most of them to round-off for an expansion
of any degree: a violation shows that the equations are wrong, not that the degree is too low.
"""

from functools import singledispatch
from typing import Any

import numpy as np
from scipy.ndimage import map_coordinates, maximum_filter

from averaging.gaussian import GAUSSIAN_REACH
from averaging.phase_space.equation.chain import (
    Polynomial,
    by_y,
    damping_degree,
    polynomial_product,
    state_polynomials,
)
from averaging.phase_space.equation.degrees import Matrix, space_to
from averaging.phase_space.equation.elimination import Expansion
from averaging.phase_space.marginals import marginal, moments
from averaging.phase_space.refinement import DENSITY_ROUND_OFF, DISTANCE_SAFETY, Ladder
from fpk.answer.certificate import Measured
from fpk.answer.density import Density, certify_density
from fpk.answer.method import Identity
from fpk.answer.names import Coordinate, Observable, observable_name
from fpk.numeric.arrays import Array

DISTANCE_POINTS = {1: 721, 2: 181}
"""Points along an axis at which the difference to the coarser solution is sampled, by the number of
axes. Errors use its maximum within a standard deviation: at its zeros the error is not 0."""
COMPARISON_SHARE = 0.8
"""Points of the comparison rule over points of the answer in integrals over the contact
displacement."""


def expansion_density(ladder: Ladder, observable: Observable, tol: float) -> Density:
    """Return the density of ``observable`` by the finest solution of ``ladder``.

    The error at a point is the scaled maximum of the difference to the coarser solution nearby plus
    the error of quadrature. If the ladder ended with an L1 error above the tolerance ``tol``, the
    certificate fails and gives the reason.
    """
    factor, error = ladder.factors[observable], ladder.errors[observable]
    panels, pdf = marginal(ladder.finest, observable)
    _, coarser = marginal(ladder.coarser, observable)
    _, fewer = marginal(ladder.finest, observable, share=COMPARISON_SHARE)
    count = DISTANCE_POINTS[len(panels)]
    axes = [np.linspace(nodes[0], nodes[-1], count) for nodes in panels]
    mesh = np.meshgrid(*axes, indexing="ij", sparse=True)
    values = np.asarray(pdf(*mesh))
    distance = np.abs(values - np.asarray(coarser(*mesh)))
    local = maximum_filter(distance, int(0.5 * count / GAUSSIAN_REACH) + 1, mode="nearest")
    floor = DENSITY_ROUND_OFF * values.max()
    # Bound of the mass outside the panels: the density at their ends times the length of the last
    # panel, over which it falls by more than a factor e.
    tail = 0.0
    for axis, nodes in enumerate(panels):
        step = float(np.prod([x[1] - x[0] for k, x in enumerate(axes) if k != axis]))
        for end, length in zip((0, -1), np.diff(nodes)[[0, -1]], strict=True):
            tail += float(np.abs(values.take(end, axis)).sum() * step * length)
    measured = Measured(
        l1_error=error + tail,
        mass_defect=np.nan,
        minimum=np.inf,
        residual=ladder.finest.residual,
        tail_mass=tail,
        failures=(ladder.limit,) if ladder.limit and error > tol else (),
    )

    def quadrature_error(p: Array, *x: Array) -> Array:
        return np.abs(p - np.asarray(fewer(*x)))

    def pointwise(*x: Array) -> Array:
        place = [
            (a - nodes[0]) / (nodes[-1] - nodes[0]) * (count - 1)
            for a, nodes in zip(np.broadcast_arrays(*x), panels, strict=True)
        ]
        about = map_coordinates(local, np.array(place), order=1, mode="nearest")
        return np.asarray(factor * about + floor + quadrature_error(pdf(*x), *x))

    return certify_density(
        observable, panels, pdf, pointwise, measured=measured, tol=tol, added_error=quadrature_error
    )


def expansion_settings(ladder: Ladder) -> dict[str, str | float | int]:
    """Return degrees, why the ladder ended, second moments and the power into each mass.

    The keys are "equation", "solutions" (their number), "ended by" if there is a limit, and of an
    expansion "highest degree", "degree in the other masses", for each mass "E q1²" and "E p1²", and
    "net power of damping and noise on mass 1".
    """
    ended = {"ended by": ladder.limit} if ladder.limit else {}
    return {
        "equation": "(6)",
        "solutions": ladder.solutions,
        **ended,
        **solution_settings(ladder.finest),
    }


@singledispatch
def solution_settings(e: Any) -> dict[str, str | float | int]:
    """Return the settings of one solution, an ``Expansion`` or another one that is registered."""
    frame, d, (mean, covariance) = e.basis.frame, e.basis.degrees, moments(e)
    settings: dict[str, str | float | int] = {
        "highest degree": d.total,
        "degree in the other masses": d.others,
    }
    second = covariance + np.outer(mean, mean)
    for i in frame.order:
        for c in (Coordinate("q", i), Coordinate("p", i)):
            at, unit = frame.place(c)
            settings[f"E {observable_name((c,))}²"] = float(second[at, at] * unit**2)
    # D_ii/m_i − Σ_j E c_ij v_i v_j: power from the noise less power of the damping. The springs
    # carry it to the other masses; the sum over all masses is 0.
    n = frame.n
    heat = np.diag(frame.noise) - np.sum(frame.damping * second[n:, n:], axis=1)
    heat -= force_means(e)[0]
    for i, power in zip(frame.order, heat, strict=True):
        settings[f"net power of damping and noise on mass {i + 1}"] = float(power)
    return settings


def force_means(e: Expansion) -> tuple[Array, Array, Array]:
    """Return E v_i f_i and E r_i f_i (n,), −f the scaled forces of the damping terms on the masses.

    The masses are in the frame's order, r_1 is y. The third result is E(f_i | y) at the points y
    times the weights of the basis, (n, points). Without damping terms all are 0.
    """
    b = e.basis
    n, top = b.frame.n, 2 + damping_degree(b.frame)
    if not b.frame.system.damping_terms:
        return np.zeros(n), np.zeros(n), np.zeros((n, b.points.size))
    space = space_to(b.degrees.total + top, b.degrees.others + top, 2 * n - 1)
    r, v, forces = state_polynomials(b, e.factor, space)
    inside = (space.level <= b.degrees.total) & (space.counted <= b.degrees.others)
    first: Polynomial = {(0, 0): Matrix(space.integral()[None])}

    def given(*factors: Polynomial) -> Array:
        """Return E(Π ``factors`` | y) at the basis's points y, times its weights, (points,)."""
        row, total = first, np.zeros(b.points.size)
        for factor in factors:
            row = polynomial_product(row, factor)
        for powers, X in row.items():
            total += by_y(b, powers) * e.given(X.toarray()[0, inside])
        return total

    power, virial = (
        np.array([np.sum(given(x, f)) for x, f in zip(of, forces, strict=True)]) for of in (v, r)
    )
    return power, virial, np.array([given(f) for f in forces])


def identities(ladder: Ladder) -> tuple[Identity, ...]:
    """Return the power balance, the virial identities, and two with a test function sin(y/s).

    s is the standard deviation of y; the sine is no function of the expansion. Errors follow from
    the coarser solution.
    """
    finest, coarser = sides(ladder.finest), sides(ladder.coarser)
    scale, out = abs(finest[0][2]), []  # the power of the noise
    for (name, value, expected), (_, *before) in zip(finest, coarser, strict=True):
        distance = abs((value - expected) - (before[0] - before[1]))
        size = max(abs(value), abs(expected), scale)
        error = DISTANCE_SAFETY * distance + max(ladder.errors.values()) * size
        out.append(Identity(name, value, expected, error))
    return tuple(out)


@singledispatch
def sides(e: Any) -> list[tuple[str, float, float]]:
    """Return (name, left side, right side) of each identity, named by the left side's formula.

    ``e`` is an ``Expansion`` or another solution that is registered.
    """
    (mean, covariance), b, frame = moments(e), e.basis, e.basis.frame
    n, y, K, c = frame.n, b.points, frame.stiffness, frame.damping
    second = covariance + np.outer(mean, mean)
    power, virial, force = force_means(e)
    # Means given y times the weights: of (y, r, v), of v₁² and of the contact force.
    (p, first, products), (to, shift) = e.space.first_moments, b.reference.to_state
    p, first, square = map(e.given, (p, first, products[0, 0]))
    given = to @ np.vstack([y * p, e.factor @ first]) + shift[:, None] * p
    square *= e.factor[0, 0] ** 2
    contact = p * frame.contact_force(y)
    sides = [
        ("Σ c_ij E v_i v_j", np.sum(c * second[n:, n:]) + np.sum(power), np.trace(frame.noise))
    ]
    virial[0] += contact @ y
    for i, row in enumerate(frame.order):
        right = K[i] @ second[:n, i] + c[i] @ second[n:, i] + virial[i]
        sides.append((f"E p{row + 1}²/m", second[n + i, n + i], right))
    s, number = float(np.sqrt(covariance[0, 0])), frame.contact + 1
    sine, cosine = np.sin(y / s), np.cos(y / s) / s
    mean_force = K[0] @ given[:n] + c[0] @ given[n:] + force[0] + contact
    sides.append((f"E v{number}² cos(q{number}/s)/s", square @ cosine, sine @ mean_force))
    sides.append((f"E v{number} sin(q{number}/s)", given[n] @ sine, 0.0))
    return [(name, float(left), float(right)) for name, left, right in sides]
