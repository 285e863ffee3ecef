"""Orthonormal Krylov spaces by Arnoldi's method: of polynomials, resolvents and reliabilities."""

from collections.abc import Callable, Iterator

import numpy as np

from fpk.arrays import Array

INVARIANT = 1e-13
"""Part of a vector outside a space, relative to it, that is round-off."""


def krylov(
    apply: Callable[[Array], Array],
    first: Array,
    most: int,
    *,
    metric: Callable[[Array], Array] = np.asarray,
) -> Iterator[tuple[Array, Array, bool]]:
    """Yield orthonormal V (m, size) and H (rows, m) of Arnoldi's method, up to m = ``most``.

    V spans the b columns of ``first`` (size, b), the first vector that of the first column, then
    those of B ``first``, …, with B = ``apply`` of columns, b more in each step. H[:m] is B in V,
    and the rows behind are what leads out of V. The last item is whether nothing does, after which
    there are no more. Each vector is made orthogonal twice, in the inner product x·M y with
    ``metric`` M.
    """
    b, rows, m = first.shape[1], 0, 0
    V = np.zeros((most + b, len(first)), dtype=first.dtype)
    H = np.zeros((most + b, most), dtype=first.dtype)

    def outside(new: Array) -> tuple[Array, Array, float]:
        along = np.zeros(rows, dtype=first.dtype)
        for _ in range(2):
            part = V[:rows].conj() @ metric(new)
            new = new - part @ V[:rows]
            along += part
        return new, along, float(np.sqrt(np.vdot(new, metric(new)).real))

    for new in first.T:
        new, _, length = outside(new)
        V[rows] = new / length
        rows += 1
    while m < min(rows, most):
        for new in apply(V[m : min(rows, most)].T).T:
            new, along, length = outside(new)
            H[:rows, m] = along
            if length > INVARIANT * float(np.linalg.norm(along)):
                H[rows, m], V[rows] = length, new / length
                rows += 1
            m += 1
        yield V[:m], H[:rows, :m], m == rows
