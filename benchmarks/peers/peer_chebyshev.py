"""Chebyshev collocation by hand: one domain, split at the contact energies, a tensor in two.

One energy: zero flux, ½(b p)' = s p, at Chebyshev points; the row at the start of a domain gives
way to continuity, that at the end of the first one to the mass. "mapped" puts H = H_c + x², which
takes away the half-integer powers of H − H_c: a step further than the rest, for whoever knows of
them. Two energies: the whole equation at the points of a tensor, zero flux at the far ends, one row
for the mass. All boxes were found by hand.
"""

from functools import partial

from measure import Sampled, Setting, measure_all  # first: NumPy then has one thread

# isort: split

import numpy as np
from numpy.polynomial.chebyshev import chebvander
from problems import PROBLEMS

from fpk.numeric.quadrature import panel_rule

JUDGED = 24
"""Gauss points on each of the panels on which an answer is judged."""


LINE_TINY = 1e-100
"""Stands for H = 0 where coefficients are asked for; the row there is p = 0."""


def chebyshev(n):
    """Return n + 1 Chebyshev points on [−1, 1], ascending, the matrix of d/dx and the weights."""
    k = np.arange(n + 1)
    ends = np.where((k == 0) | (k == n), 2.0, 1.0)
    sign = (-1.0) ** k * ends
    half = 0.5 * np.pi * k / n
    # x_i − x_j by sines: their difference would cancel.
    gap = 2.0 * np.sin(half[:, None] + half) * np.sin(half[:, None] - half)
    np.fill_diagonal(gap, 1.0)
    D = sign[:, None] / sign / gap
    np.fill_diagonal(D, 0.0)
    np.fill_diagonal(D, -D.sum(axis=1))
    moments = np.where(k % 2, 0.0, 2.0 / (1.0 - np.where(k % 2, 0.0, k) ** 2.0)) / ends
    weights = 2.0 / (n * ends) * (np.cos(np.pi * np.outer(k, k % (2 * n)) / n) @ moments)
    return -np.cos(np.pi * k / n), D, weights


def line(problem, nodes, degrees, mapped):
    """Return the panels (start, length, power, values) of p_h between the ``nodes``."""
    size = sum(degrees) + len(degrees)
    A, mass, panels, first = np.zeros((size, size)), np.zeros(size), [], 0
    grids = [chebyshev(n) for n in degrees]
    shares = [0.5 * (1.0 + x) for x, _, _ in grids]
    powers = [2 if mapped and left > 0.0 else 1 for left in nodes[:-1]]
    steps = list(zip(nodes[:-1], np.diff(nodes), shares, powers, strict=True))
    energy = np.concatenate([left + length * x**power for left, length, x, power in steps])
    s, b, slope = problem.coefficients(np.maximum(energy, LINE_TINY))
    for (left, length, share, power), (_, D, weights) in zip(steps, grids, strict=True):
        own = slice(first, first + share.size)
        jacobian = 0.5 * length * power * share ** (power - 1)
        A[own, own] = 0.5 * b[own, None] * D
        A[own, own] += np.diag((0.5 * slope[own] - s[own]) * jacobian)
        if first:
            A[first] = 0.0
            A[first, first - 1], A[first, first] = 1.0, -1.0
        mass[own] = weights * jacobian
        panels.append((own, left, length, power))
        first += share.size
    # One condition a domain: continuity has taken the rows at their starts, but of the first.
    A[0] = 0.0
    A[0, 0] = 1.0
    A[degrees[0]] = mass
    right = np.zeros(size)
    right[degrees[0]] = 1.0
    p = np.linalg.solve(A, right)
    return [(left, length, power, p[own]) for own, left, length, power in panels]


def line_sampled(panels):
    """Return p_h on Gauss points of panels that shrink towards the ends of its domains."""
    points, weights, values = [], [], []
    towards = np.concatenate([[0.0], 0.5 ** np.arange(16.0, 0.0, -1.0)])
    nodes = np.unique(np.concatenate([towards, np.linspace(0.5, 1.0, 24)]))
    share, w = (a.ravel() for a in panel_rule(nodes, JUDGED))
    for left, length, power, p in panels:
        points.append(left + length * share**power)
        weights.append(w * length * power * share ** (power - 1))
        values.append(chebvander(2.0 * share - 1.0, p.size - 1) @ coefficients(p))
    end = panels[-1][0] + panels[-1][1]
    return Sampled(np.concatenate(points)[None], *map(np.concatenate, (weights, values)), (end,))


def coefficients(p):
    """Return the Chebyshev coefficients of values at ascending Chebyshev points, along axis 0."""
    n = p.shape[0] - 1
    return np.linalg.solve(chebvander(-np.cos(np.pi * np.arange(n + 1) / n), n), p)


def plane(problem, n, ends):
    """Return the ends of the box and p_h at the tensor of n + 1 points an axis."""
    x, D, weights = chebyshev(n)
    m = n + 1
    share = 0.5 * (1.0 + x)
    at = np.array(np.meshgrid(*(end * share for end in ends), indexing="ij"))
    s, b, _ = problem.coefficients(at)
    A = np.zeros((m, m, m, m))
    k = np.arange(m)
    for axis, end in enumerate(ends):
        # J = s p − ½ (b p)' along the axis, on every line of the tensor: [line, row, column].
        slope = 2.0 / end * D
        lines = (np.moveaxis(a[axis], axis, -1) for a in (s, b))
        drift, diffusion = lines
        flux = drift[:, None, :] * np.eye(m) - 0.5 * slope * diffusion[:, None, :]
        change = slope @ flux
        if axis == 0:
            A[:, k, :, k] += change
            A[-1] = 0.0
            A[-1, k, :, k] = flux[:, -1]
        else:
            keep = A[-1].copy()
            A[k, :, k, :] += change
            A[-1] = keep
            A[:, -1] = 0.0
            A[k, -1, k, :] = flux[:, -1]
    mass = np.outer(*(0.5 * end * weights for end in ends)).ravel()
    A = A.reshape(m * m, m * m)
    if (cross := problem.cross(at)) is not None:
        A -= mixed(cross, 2.0 / ends[0] * D, 2.0 / ends[1] * D)
    A[0] = mass
    right = np.zeros(m * m)
    right[0] = 1.0
    return ends, np.linalg.solve(A, right).reshape(m, m)


def mixed(cross, first, second):
    """Return ∂₁∂₂(b₁₂ p), and at the far ends its part of the flux, ½ ∂(b₁₂ p) along them."""
    m = len(first)
    rows = first[:, None, :, None] * second[None, :, None, :]
    last = np.eye(m)[-1]
    rows[-1] = 0.5 * last[:, None] * second[:, None, :]
    rows[:, -1] = 0.5 * first[:, :, None] * last
    return rows.reshape(m * m, m * m) * cross.ravel()


def plane_sampled(answer):
    """Return p_h at a tensor of Gauss points."""
    ends, p = answer
    share, w = (a.ravel() for a in panel_rule(np.linspace(0.0, 1.0, 9), JUDGED))
    values = chebvander(2.0 * share - 1.0, p.shape[0] - 1)
    values = values @ coefficients(coefficients(p).T).T @ values.T
    points = np.array([a.ravel() for a in np.meshgrid(*(share * e for e in ends), indexing="ij")])
    return Sampled(points, np.outer(w * ends[0], w * ends[1]).ravel(), values.ravel(), ends)


def line_setting(name, degrees, end, mapped=False):
    """Return one measurement in one energy."""
    problem = PROBLEMS[name]
    split = len(degrees) > 1
    nodes = np.array([0.0, *(problem.contact_energies if split else ()), end])
    kind = ("split, mapped" if mapped else "split at H_c") if split else "one domain"
    return Setting(
        name,
        f"{kind}, degrees {' + '.join(map(str, degrees))}, box {end:g}",
        partial(line, problem, nodes, degrees, mapped),
        line_sampled,
        lambda panels: sum(p.size for *_, p in panels),
    )


def plane_setting(name, n, reach):
    """Return one measurement in two energies, the box ``reach`` means long."""
    problem = PROBLEMS[name]
    return Setting(
        name,
        f"tensor, degree {n}, box {reach:g} means",
        partial(plane, problem, n, tuple(float(reach * t) for t in problem.temperature)),
        plane_sampled,
        lambda answer: answer[1].size,
    )


def settings():
    """Return the ladder of each problem."""
    found = [line_setting("W1", (n,), 7.0) for n in (64, 256, 1024)]
    for name in ("W1", "W1, B = 1e4"):
        found += [line_setting(name, d, e) for d, e in SPLIT]
        found += [line_setting(name, d, e, mapped=True) for d, e in MAPPED]
    found += [plane_setting("W2", *step) for step in PLANE]
    found += [plane_setting("W3", *step) for step in COUPLED]
    return found + [plane_setting("W4", *step) for step in CIRCULATING]


SPLIT = (((8, 48), 6.5), ((10, 96), 7.5), ((10, 160), 7.5), ((10, 224), 7.5), ((10, 288), 7.5))
MAPPED = (((8, 32), 6.5), ((8, 48), 7.0), ((10, 72), 7.5), ((10, 96), 7.5), ((10, 128), 7.5))
PLANE = ((14, 12.0), (18, 14.0), (22, 18.0), (26, 22.0), (30, 26.0), (36, 29.0), (40, 32.0))
COUPLED = ((20, 14.0), (24, 15.0), (30, 18.0), (36, 20.0), (42, 22.0), (48, 24.0), (50, 26.0))

CIRCULATING = ((42, 7.0), (54, 8.0), (64, 9.0))


if __name__ == "__main__":
    measure_all("Chebyshev", "numpy", settings())
