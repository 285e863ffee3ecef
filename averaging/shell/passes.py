"""One integral operator of a chain at many β, compiled.

A library's product of matrices is no faster for so few columns, and its threads wait for each other
where another program runs (``cases/commands/cli.py``).
"""

import numpy as np

from fpk.arrays import Array, Complexes
from fpk.compiling import cached_njit


@cached_njit()
def passed(height: Array, begin: float, step: float, g: Complexes) -> Complexes:
    """Return Σ_c exp(−β_k height_rc) g_kcm (points, rows, m) at β_k = begin + i k step.

    ``height`` (rows, columns), ``g`` (points, columns, m).
    """
    rows, columns = height.shape
    points, _, count = g.shape
    # Real and imaginary parts apart: loops over rows become vector instructions.
    z, factor = np.empty((2, rows)), np.empty((2, rows))
    real, imaginary = np.zeros((points, count, rows)), np.zeros((points, count, rows))
    for c in range(columns):
        for r in range(rows):
            z[0, r], z[1, r] = np.exp(-begin * height[r, c]), 0.0
            if points > 1:
                angle = step * height[r, c]
                factor[0, r], factor[1, r] = np.cos(angle), -np.sin(angle)
        for k in range(points):
            for m in range(count):
                x, y = g[k, c, m].real, g[k, c, m].imag
                for r in range(rows):
                    real[k, m, r] += z[0, r] * x - z[1, r] * y
                    imaginary[k, m, r] += z[0, r] * y + z[1, r] * x
            for r in range(rows):
                turned = z[0, r] * factor[0, r] - z[1, r] * factor[1, r]
                z[1, r] = z[0, r] * factor[1, r] + z[1, r] * factor[0, r]
                z[0, r] = turned
    f = np.empty((points, rows, count), dtype=np.complex128)
    for k in range(points):
        for m in range(count):
            for r in range(rows):
                f[k, r, m] = complex(real[k, m, r], imaginary[k, m, r])
    return f
