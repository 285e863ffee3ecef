"""Gauss-Legendre rules on panels."""

from functools import lru_cache

import numpy as np

from fpk.arrays import Array


@lru_cache
def gauss_legendre(points: int) -> tuple[Array, Array]:
    """Return the nodes and weights on [−1, 1], exact for polynomials of degree 2 points − 1."""
    x, w = np.polynomial.legendre.leggauss(points)
    x.setflags(write=False)
    w.setflags(write=False)
    return x, w


def panel_rule(nodes: Array, points: int) -> tuple[Array, Array]:
    """Return nodes and weights (panels, points) on the panels between ascending ``nodes``."""
    x, w = gauss_legendre(points)
    half = 0.5 * np.diff(nodes)[:, None]
    middle = 0.5 * (nodes[1:] + nodes[:-1])[:, None]
    return middle + half * x, half * w
