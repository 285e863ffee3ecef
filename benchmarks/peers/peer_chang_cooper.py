"""Chang and Cooper's finite volumes in forty lines of scipy: positive, of second order."""

from functools import partial

from measure import Setting, cells, measure_all  # first: NumPy then has one thread

# isort: split

import numpy as np
from problems import PROBLEMS
from scipy.sparse import coo_array, diags_array, eye_array, kron
from scipy.sparse.linalg import splu

LINE_END, PLANE_END = 8.0, 20.0
"""Ends of the boxes: an energy, and multiples of each mean."""


def solved(problem, count):
    """Return the edges of the cells along each axis and p_h, of mass one."""
    scale = [LINE_END] if problem.dimension == 1 else PLANE_END * problem.temperature
    edges = [np.linspace(0.0, end, count + 1) for end in scale]
    number = np.arange(count**problem.dimension).reshape([count] * problem.dimension)
    rows, columns, entries, mixed = [], [], [], []
    for axis, edge in enumerate(edges):
        axes = [0.5 * (e[1:] + e[:-1]) for e in edges]
        axes[axis] = edge[1:-1]  # no flux crosses the outermost edges
        at = np.array(np.meshgrid(*axes, indexing="ij"))
        s, b, slope = (np.reshape(a, at.shape)[axis] for a in problem.coefficients(at))
        h = edge[1]
        w = h * (s - 0.5 * slope) / (0.5 * b)
        # Flux ½b/h (B(−w) p_left − B(w) p_right), B(w) = w/(e^w − 1), exact where it is constant.
        upper = 0.5 * b / h * _bernoulli(-w)
        lower = 0.5 * b / h * _bernoulli(w)
        left = np.take(number, range(count - 1), axis).ravel()
        right = np.take(number, range(1, count), axis).ravel()
        for row, sign in ((left, -1.0 / h), (right, 1.0 / h)):
            rows += [row, row]
            columns += [left, right]
            entries += [sign * upper.ravel(), -sign * lower.ravel()]
        if problem.dimension == 2 and (cross := problem.cross(at)) is not None:
            mixed += [_mixed(cross, axis, edges, left, right)]
    A = coo_array((np.hstack(entries), (np.hstack(rows), np.hstack(columns)))).tocsc()
    A = sum(mixed, A).tocsc()
    pin = int(number[tuple([count // 32] * problem.dimension)])
    rest = np.delete(number.ravel(), pin)
    p = np.ones(number.size)
    p[rest] = splu(A[rest][:, rest].tocsc()).solve(-A[rest][:, [pin]].toarray().ravel())
    return edges, p / (p.sum() * np.prod([e[1] for e in edges]))


def _mixed(cross, axis, edges, left, right):
    """Minus the divergence of the flux −½ b₁₂ ∂p along the other axis: central, not positive."""
    n = edges[0].size - 1
    steps = diags_array([-0.5, 0.5], offsets=[-1, 1], shape=(n, n)).tolil()
    steps[0, [0, 1]] = steps[-1, [-2, -1]] = -1.0, 1.0  # one-sided at the walls
    slope = kron(eye_array(n), steps) if axis == 0 else kron(steps, eye_array(n))
    slope = slope.tocsr() / edges[1 - axis][1]
    flux = diags_array(-0.25 * cross.ravel()) @ (slope[left] + slope[right])
    faces = np.arange(left.size)
    out = coo_array((np.ones(left.size), (left, faces)), shape=(n * n, left.size))
    into = coo_array((np.ones(left.size), (right, faces)), shape=(n * n, left.size))
    return (into - out) @ flux / edges[axis][1]


def _bernoulli(w):
    """w/(e^w − 1), 1 at w = 0."""
    safe = np.where(np.abs(w) < 1e-12, 1.0, w)
    return np.where(np.abs(w) < 1e-12, 1.0, safe / np.expm1(safe))


def setting(name, count):
    """Return one measurement."""
    problem = PROBLEMS[name]
    unit = " an axis" if problem.dimension == 2 else ""
    return Setting(
        name,
        f"{count} cells{unit}",
        partial(solved, problem, count),
        lambda answer: cells(*answer),
        lambda answer: answer[1].size,
    )


if __name__ == "__main__":
    settings = [setting("W1", count) for count in (1_000, 8_000, 200_000)]
    settings += [setting("W1, B = 1e4", 16_000)]
    settings += [setting("W2", count) for count in (32, 128, 256, 512)]
    settings += [setting(name, count) for name in ("W3", "W4") for count in (64, 128, 256)]
    measure_all("Chang-Cooper", "scipy", settings)
