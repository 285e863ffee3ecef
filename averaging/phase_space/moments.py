"""First and second moments of an expansion, and the reference that they suggest."""

from dataclasses import dataclass

import numpy as np

from averaging.phase_space.equation.elimination import Expansion
from averaging.phase_space.equation.frame import Frame, Reference, with_moments
from averaging.phase_space.equation.others import first_and_second
from fpk.arrays import Array


@dataclass(frozen=True, eq=False)
class Moments:
    """Mean (2n,) and covariance (2n, 2n) of (y, r, v), displacements and velocities times √m.

    They stand in the order of the frame: the contact mass first. ``flow`` is E[v₁ f(y)] as the
    values f of a function at the points of the basis, ∫ of their product: 0 in any stationary
    state, whatever f.
    """

    mean: Array
    covariance: Array
    flow: Array


def moments(frame: Frame, expansion: Expansion) -> Moments:
    """Return the moments of a solution, from its three lowest levels."""
    n, b, C = frame.n, expansion.basis, expansion.factor
    y, w, a = b.points, b.weights, b.reference.slope
    u0, u1, u2 = (expansion.functions(level, y) for level in range(3))
    one, two = first_and_second(expansion.others, 2 * n - 1)
    linear = one @ u1
    z, zy = C @ (linear @ w), C @ (linear @ (w * y))
    zz = C @ (np.eye(2 * n - 1) + two @ (u2 @ w)) @ C.T
    flow = C[0] @ linear * w
    mean_y, square_y = float(w @ (u0[0] * y)), float(w @ (u0[0] * y**2))
    mean = np.concatenate([[mean_y], z])
    second_moments = np.zeros((2 * n, 2 * n))
    second_moments[0, 0], second_moments[0, 1:], second_moments[1:, 0] = square_y, zy, zy
    second_moments[1:, 1:] = zz
    # (y, v, x) to (y, r, v): r = x + a y + x₀.
    to = np.zeros((2 * n, 2 * n))
    to[0, 0] = 1.0
    to[1:n, 0], to[1:n, n + 1 :] = a, np.eye(n - 1)
    to[n:, 1 : n + 1] = np.eye(n)
    covariance = to @ (second_moments - np.outer(mean, mean)) @ to.T
    shift = np.concatenate([[0.0], b.reference.offset, np.zeros(n)])
    return Moments(to @ mean + shift, 0.5 * (covariance + covariance.T), flow)


def refitted(frame: Frame, expansion: Expansion) -> Reference:
    """Return the reference with the first and second moments of a solution."""
    m = moments(frame, expansion)
    # Of mirror images round-off is all that the means are.
    mean = np.zeros_like(m.mean) if expansion.basis.mirrored else m.mean
    return with_moments(frame, mean, m.covariance)
