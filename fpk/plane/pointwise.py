"""Compiled arithmetic at the places of an expansion and of the probe."""

import numpy as np
from numpy.typing import NDArray

from fpk.compiling import kept
from fpk.process import Process

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]


def evaluated(process: Process, energies: Array) -> tuple[Array, Array, Array]:
    """Return s, ∇·b and b at energies (points, 2), as arrays of one kind for compiled code."""
    c = process.coefficients(energies)
    s, divergence, b = (
        np.array(values, float, order="C") for values in (c.drift, c.divergence, c.diffusion)
    )
    return s, divergence, b


_compiled = kept()


@_compiled
def seen_points(x: Array, y: Array, seen: Flags, exponent: Array, area: Array) -> tuple[Array, ...]:
    """Return w·area on the grid, 0 where not ``seen``, and the energies (points, 2) where it is."""
    w, H, k = np.zeros(seen.shape), np.empty((np.count_nonzero(seen), 2)), 0
    for i in range(x.size):
        for j in range(y.size):
            if seen[i, j]:
                w[i, j] = np.exp(-exponent[i, j]) * area[i, j]
                H[k, 0], H[k, 1] = x[i], y[j]
                k += 1
    return w, H


@_compiled
def weighted_on_grid(
    w: Array, seen: Flags, first: Array, second: Array, s: Array, divergence: Array, b: Array
) -> Array:
    """Return w α_1, w α_2, −½ w b_11, −½ w b_12 and −½ w b_22 on the grid, 0 where not ``seen``.

    α = s − ½ ∇·b + ½ b ∇Φ from the slopes of Φ on the grid, and ``s``, ``divergence`` (points, 2)
    and ``b`` (points, 2, 2) where it is seen.
    """
    grids, k = np.zeros((5, *w.shape)), 0
    for i in range(w.shape[0]):
        for j in range(w.shape[1]):
            if seen[i, j]:
                half = -0.5 * w[i, j]
                b11, b12, b22 = half * b[k, 0, 0], half * b[k, 0, 1], half * b[k, 1, 1]
                along, across = first[i, j], second[i, j]
                a1 = w[i, j] * s[k, 0] + half * divergence[k, 0]
                a2 = w[i, j] * s[k, 1] + half * divergence[k, 1]
                grids[0, i, j] = a1 - b11 * along - b12 * across
                grids[1, i, j] = a2 - b12 * along - b22 * across
                grids[2, i, j], grids[3, i, j], grids[4, i, j] = b11, b12, b22
                k += 1
    return grids


@_compiled
def flux_free_slopes(s: Array, divergence: Array, b: Array, scales: Array) -> tuple[Array, bool]:
    """Return b⁻¹ (2s − ∇·b) (2, points) times ``scales``, and whether b is regular everywhere."""
    slopes, regular = np.empty((2, len(s))), True
    for k in range(len(s)):
        first, second = 2.0 * s[k, 0] - divergence[k, 0], 2.0 * s[k, 1] - divergence[k, 1]
        determinant = b[k, 0, 0] * b[k, 1, 1] - b[k, 0, 1] * b[k, 1, 0]
        regular = regular and determinant > 0.0
        slopes[0, k] = (b[k, 1, 1] * first - b[k, 0, 1] * second) * (scales[0] / determinant)
        slopes[1, k] = (b[k, 0, 0] * second - b[k, 1, 0] * first) * (scales[1] / determinant)
    return slopes, regular
