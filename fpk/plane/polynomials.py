"""Polynomials of two energies in powers: their values, and fits of rising degree."""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Powers = NDArray[np.int64]

APART = 1e-13
"""Share of a column that the columns before leave of it: below, round-off may have made it."""


class Grid(NamedTuple):
    """Powers of the places along each axis, and their slopes, (places, degree + 1) each."""

    x: Array
    y: Array
    dx: Array
    dy: Array

    def values(self, c: Array) -> Array:
        """Σ c[i, j] x^i y^j at all pairs of places, (along x, along y)."""
        return np.asarray(self.x @ c @ self.y.T)

    def slopes(self, c: Array) -> tuple[Array, Array]:
        """Its slopes along x and along y there."""
        return np.asarray(self.dx @ c @ self.y.T), np.asarray(self.x @ c @ self.dy.T)


def grid_of(x: Array, y: Array, degree: int) -> Grid:
    """Return the powers up to ``degree`` along each axis."""
    (X, dX), (Y, dY) = powers_of(x, degree), powers_of(y, degree)
    return Grid(X, Y, dX, dY)


def powers_of(x: Array, degree: int) -> tuple[Array, Array]:
    """Return x^k (x.size, degree + 1), and the slopes k x^(k−1)."""
    X = np.vander(x, degree + 1, increasing=True)
    dX = np.zeros_like(X)
    dX[:, 1:] = X[:, :-1] * np.arange(1.0, degree + 1.0)
    return X, dX


def values_at(c: Array, x: Array, y: Array) -> Array:
    """Σ c[i, j] x^i y^j at places that broadcast together."""
    if x.ndim == 2 and x.shape[1] == 1 and y.ndim == 1:
        X, Y = (np.vander(z, n, increasing=True) for z, n in ((x[:, 0], len(c)), (y, c.shape[1])))
        return np.asarray(X @ c @ Y.T)
    powers = np.stack([y**j for j in range(c.shape[1])])
    across = np.tensordot(c, powers, axes=1)
    total = across[-1]
    for row in across[-2::-1]:
        total = total * x + row
    return np.asarray(np.broadcast_to(total, np.broadcast_shapes(x.shape, y.shape)))


def of_total_degree(degree: int) -> Powers:
    """Pairs of powers of that total degree, (degree + 1, 2)."""
    i = np.arange(degree + 1)
    return np.stack([i, degree - i], axis=1)


def fits(blocks: Iterable[tuple[Powers, Array]], right: Array) -> Iterable[tuple[Array, float]]:
    """Yield least-squares fits of ``right`` (places,) by ever more columns, each with its misfit.

    ``blocks``: powers (new, 2) of the coefficients that come in, and their columns (places, new).
    The factors of the columns so far are kept: a fit costs what its new ones do. Coefficients
    come as (degree + 1, degree + 1), the misfit relative to ``right``. Ends where the places do not
    tell the columns apart.
    """
    Q, R, y = np.empty((right.size, 0)), np.empty((0, 0)), np.empty(0)
    powers, left, size = np.empty((0, 2), np.int64), right, float(np.linalg.norm(right))
    for new, columns in blocks:
        n, own, above = len(R), columns, np.zeros((len(R), len(new)))
        # Twice is enough to be orthogonal to round-off.
        for _ in range(2 if n else 0):
            share = Q.T @ own
            own, above = own - Q @ share, above + share
        q, r = np.linalg.qr(own)
        if np.any(np.abs(np.diag(r)) <= APART * np.sqrt(np.sum(columns**2, axis=0))):
            return
        grown = np.zeros((n + len(new),) * 2)
        grown[:n, :n], grown[:n, n:], grown[n:, n:] = R, above, r
        more = q.T @ left
        R, left, y = grown, left - q @ more, np.concatenate([y, more])
        Q, powers = np.concatenate([Q, q], axis=1), np.concatenate([powers, new])
        phi = np.zeros((int(powers.max()) + 1,) * 2)
        phi[powers[:, 0], powers[:, 1]] = np.linalg.solve(R, y)
        yield phi, float(np.linalg.norm(left)) / size
