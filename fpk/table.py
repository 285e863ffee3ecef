"""Joint densities tabulated once, from the points at which they are certified."""

import numpy as np
from numpy.polynomial import legendre

from fpk.arrays import Array
from fpk.piecewise import PiecewiseTensor
from fpk.quadrature import gauss_legendre


def tabulated(panels: tuple[Array, Array], values: Array, points: int) -> PiecewiseTensor:
    """Return the polynomials through ``values`` at ``points`` Gauss points a panel and axis.

    ``values`` broadcast to (panels · points, panels · points).
    """
    t, w = gauss_legendre(points)
    project = (np.arange(points) + 0.5)[:, None] * (legendre.legvander(t, points - 1).T * w)
    counts = [nodes.size - 1 for nodes in panels]
    blocks = np.broadcast_to(values, [points * n for n in counts])
    blocks = blocks.reshape(counts[0], points, counts[1], points)
    coefficients = np.einsum("ia,jb,kalb->klij", project, project, blocks, optimize=True)
    return PiecewiseTensor(panels, coefficients)
