"""Orthonormal Krylov spaces by Arnoldi's method: of polynomials, resolvents and reliabilities."""

from collections.abc import Callable, Iterator

import numpy as np

from fpk.numeric.arrays import Array

VECTORS, EVERY = 160, 10
"""Most vectors of a space that solves equations, beyond which another elimination takes less time;
and after how many more it is looked at."""
RESIDUAL = 1e-13
"""Residual of equations, or part of a vector outside a space, relative to it, that is round-off."""


def krylov(
    apply: Callable[[Array], Array],
    first: Array,
    most: int,
    *,
    metric: Callable[[Array], Array] | None = None,
) -> Iterator[tuple[Array, Array, bool]]:
    """Yield orthonormal V (m, size) and H (rows, m) of Arnoldi's method, up to m = ``most``.

    V spans the b columns of ``first`` (size, b), beginning with the first one, then those of
    B ``first``, …, with B = ``apply`` of columns, b more in each step. H[:m] is B in V, the rows
    behind lead out of V; the last item is whether none does, and ends the space. Vectors are made
    orthogonal twice, in the inner product x·M y with ``metric`` M, None: 1.
    """
    b, rows, m = first.shape[1], 0, 0
    V = np.zeros((most + b, len(first)), dtype=first.dtype)
    MV = V if metric is None else np.zeros_like(V)
    H = np.zeros((most + b, most), dtype=first.dtype)

    def added(new: Array) -> Array:
        """Add a vector unless it is in the space; return its parts along all before and itself."""
        nonlocal rows
        along = np.zeros(rows + 1, dtype=first.dtype)
        for _ in range(2):
            part = MV[:rows].conj() @ new
            new = new - part @ V[:rows]
            along[:rows] += part
        image = new if metric is None else metric(new)
        length = float(np.sqrt(np.vdot(new, image).real))
        if length > RESIDUAL * float(np.linalg.norm(along)):
            along[rows], V[rows], MV[rows] = length, new / length, image / length
            rows += 1
        return along[:rows]

    for new in first.T:
        added(new)
    while m < min(rows, most):
        for new in apply(V[m : min(rows, most)].T).T:
            along = added(new)
            H[: along.size, m] = along
            m += 1
        yield V[:m], H[:rows, :m], m == rows
