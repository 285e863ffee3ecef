"""Arnoldi's method: orthonormal Krylov spaces, for polynomials, resolvents and first passage."""

from collections.abc import Callable, Iterator

import numpy as np

from fpk.numeric.arrays import Array

VECTORS, EVERY = 160, 10
"""Largest dimension of a space that solves equations, beyond which another elimination is faster;
and the number of vectors after which convergence is tested again."""
RESIDUAL = 1e-13
"""Relative residual of equations, and relative part of a vector outside a space, taken for
round-off."""


def krylov(
    apply: Callable[[Array], Array],
    first: Array,
    most: int,
    *,
    metric: Callable[[Array], Array] | None = None,
) -> Iterator[tuple[Array, Array, bool]]:
    """Yield orthonormal V (m, size) and H (rows, m) of Arnoldi's method, up to m = ``most``.

    V spans the columns of ``first`` (size, b), then of B ``first``, B² ``first``, …, b more in each
    step; ``apply`` multiplies columns by B. H[:m] represents B in V, the rows after them lead out
    of V; the last item says that there are none: V is invariant, and the iteration ends. Vectors
    are orthogonalised twice, in the inner product x·M y, ``metric`` multiplying by M; None: M = 1.
    """
    b, rows, m = first.shape[1], 0, 0
    V = np.zeros((most + b, len(first)), dtype=first.dtype)
    MV = V if metric is None else np.zeros_like(V)
    H = np.zeros((most + b, most), dtype=first.dtype)

    def extend(new: Array) -> Array:
        """Add ``new`` to the space unless it lies in it; return its coefficients."""
        nonlocal rows
        along = np.zeros(rows + 1, dtype=first.dtype)
        for _ in range(2):
            part = (MV[:rows] @ new.conj()).conj()  # copies no vectors of the space
            new = new - part @ V[:rows]
            along[:rows] += part
        image = new if metric is None else metric(new)
        length = float(np.sqrt(np.vdot(new, image).real))
        if length > RESIDUAL * float(np.linalg.norm(along)):
            along[rows], V[rows], MV[rows] = length, new / length, image / length
            rows += 1
        return along[:rows]

    for new in first.T:
        extend(new)
    while m < min(rows, most):
        for new in apply(V[m : min(rows, most)].T).T:
            along = extend(new)
            H[: along.size, m] = along
            m += 1
        yield V[:m], H[:rows, :m], m == rows
