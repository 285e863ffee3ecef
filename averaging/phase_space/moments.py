"""First and second moments of an expansion, and the reference that they suggest."""

from dataclasses import dataclass, replace

import numpy as np

from averaging.phase_space.elimination import Expansion
from averaging.phase_space.frame import Frame, Reference
from averaging.phase_space.panels import log_weight
from fpk.arrays import Array

BULK = 1e-10
"""Share of its largest value above which a density enters the fit of the weight of y."""


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
    first, second = expansion.sets[1].k, expansion.sets[2].k
    d = 2 * n - 1
    z, zy, zz = np.zeros(d), np.zeros(d), np.eye(d)
    flow = np.zeros(y.size)
    for row, u in zip(first, u1, strict=True):
        i = int(row.argmax())
        z[i], zy[i] = w @ u, w @ (u * y)
        flow += C[0, i] * w * u
    for row, u in zip(second, u2, strict=True):
        i, j = np.repeat(np.arange(d), row).tolist()
        zz[i, j] += (w @ u) * (np.sqrt(2.0) if i == j else 1.0)
        zz[j, i] = zz[i, j]
    z, zy, zz = C @ z, C @ zy, C @ zz @ C.T
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
    """Return the reference with the first and second moments of a solution, and its density of y.

    The weight is fitted to ln p(y) where p is not small; where that is no weight, the old one is
    kept.
    """
    n, b, m = frame.n, expansion.basis, moments(frame, expansion)
    slope = m.covariance[1:n, 0] / m.covariance[0, 0]
    offset = m.mean[1:n] - slope * m.mean[0]
    if b.mirrored:
        offset = np.zeros(n - 1)
    # (y, r, v) to z = (v, x): x = r − a y.
    to = np.zeros((2 * n - 1, 2 * n))
    to[:n, n:] = np.eye(n)
    to[n:, 0], to[n:, 1:n] = -slope, np.eye(n - 1)
    covariance = to @ m.covariance @ to.T
    new = replace(b.reference, slope=slope, offset=offset, covariance=covariance)
    if np.linalg.eigvalsh(covariance)[0] <= 0.0:
        return b.reference
    return replace(new, weight=_fitted_weight(frame, expansion))


def _fitted_weight(frame: Frame, expansion: Expansion) -> Array:
    b = expansion.basis
    y, u = b.points, expansion.functions(0, b.points)[0]
    p = u * np.exp(log_weight(frame, b.reference, y))
    at = p > BULK * p.max()
    columns = [-y, -0.5 * y**2, -frame.contact_energy(y), np.ones(y.size)]
    used = [not b.mirrored, True, bool(frame.system.contacts), True]
    A = np.stack([c for c, use in zip(columns, used, strict=True) if use], axis=1)[at]
    root = np.sqrt(b.weights[at] * u[at])
    solution = np.linalg.lstsq(root[:, None] * A, root * np.log(p[at]), rcond=None)[0]
    weight = np.zeros(4)
    weight[used] = solution
    if not (weight[1] > 0.0 and weight[2] >= 0.0):
        return b.reference.weight
    return weight[:3]
