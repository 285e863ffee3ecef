"""Gauss-Legendre rules on panels."""

from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from fpk.numeric.arrays import Array

GAUSS_RULES = {1: (12, 16, 20), 2: (7, 9, 12)}
"""Gauss points per panel and axis of three rules, by the number of axes of a density. The last,
exact for polynomials of degree 39 and 23, gives integrals; the distances to the others their error.
At a kink within a panel one coarser rule may agree with it by chance, two hardly."""


@lru_cache
def gauss_legendre(points: int) -> tuple[Array, Array]:
    """Return Gauss nodes and weights on [−1, 1], exact up to the degree 2 ``points`` − 1. The
    arrays (``points``,) are read-only: later calls return the same arrays."""
    x, w = np.polynomial.legendre.leggauss(points)
    x.setflags(write=False)
    w.setflags(write=False)
    return x, w


def panel_rule(nodes: Array, points: int) -> tuple[Array, Array]:
    """Return Gauss points and weights, (panels, ``points``) each, between ascending ``nodes``."""
    x, w = gauss_legendre(points)
    half = 0.5 * np.diff(nodes)[:, None]
    middle = 0.5 * (nodes[1:] + nodes[:-1])[:, None]
    return middle + half * x, half * w


def gauss_grid(
    panels: Sequence[Array], *, points: int | None = None
) -> tuple[Sequence[Array], list[tuple[Array, Array]]]:
    """Return the sparse mesh of the Gauss points of ``panels``, and each axis's points and weights.

    ``panels`` are the ascending nodes of each axis; ``points`` is the number of Gauss points on a
    panel of an axis, by default the last of ``GAUSS_RULES``. The mesh has for each axis an array
    that broadcasts; points and weights are (panels · ``points``,).
    """
    rules = [panel_rule(nodes, points or GAUSS_RULES[len(panels)][-1]) for nodes in panels]
    grids = [(x.ravel(), w.ravel()) for x, w in rules]
    return np.meshgrid(*(x for x, _ in grids), indexing="ij", sparse=True), grids


def integral(values: Array, grids: list[tuple[Array, Array]]) -> float:
    """Return the integral of a function with ``values`` at the Gauss points of ``grids``, which are
    the second result of ``gauss_grid``; ``values`` broadcast to an axis for each of them."""
    total = np.broadcast_to(values, tuple(w.size for _, w in grids))
    for _, w in reversed(grids):
        total = total @ w
    return float(total)
