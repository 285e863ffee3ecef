"""Finite elements of −L u = f on a mesh of states, with u = 0 where the limit is passed."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.polynomial.legendre import Legendre, legder, legval, legvander
from scipy.sparse import coo_array, csc_array

from averaging.phase_space.passage.mesh import Mesh
from fpk.arrays import Array, Integers
from fpk.quadrature import gauss_legendre

MORE_POINTS = 12
"""Gauss points in each direction beyond the degree: over a panel of large velocities, and of a
steep stop, the weight falls by up to e⁴⁰. With 4, K + Kᵀ had negative eigenvalues there."""


@lru_cache
def lobatto(degree: int) -> Array:
    """Return the Gauss-Lobatto nodes (degree + 1,) of [−1, 1]."""
    inner = Legendre.basis(degree).deriv().roots()
    return np.concatenate([[-1.0], np.sort(np.real(inner)), [1.0]])


def lagrange(degree: int, t: Array) -> tuple[Array, Array]:
    """Return values and slopes (points, degree + 1) of the polynomials of the Lobatto nodes."""
    inverse = np.linalg.inv(legvander(lobatto(degree), degree))
    slopes = legval(t, legder(np.eye(degree + 1))).T
    return legvander(t, degree) @ inverse, slopes @ inverse


@dataclass(frozen=True, eq=False)
class Elements:
    """The matrices K of −L and M of 1 in L²(exp(−c H/D)), and vectors (unknowns,) of the weak form.

    Functions may jump between panels of x, where the side that motion goes to decides, and are
    continuous in s. ``load`` tests the function 1. ``exit`` tests −L 1, which is what is lost at
    the limit: as K times the coefficients of 1 it would be lost to round-off where failure is rare.
    Functions are divided by their norms: ``scale`` is what a coefficient is multiplied by to give
    the value at its node. ``free`` are the places of the unknowns among all nodes.
    """

    mesh: Mesh
    K: csc_array
    M: csc_array
    load: Array
    exit: Array
    scale: Array
    free: np.ndarray[tuple[int, ...], np.dtype[np.intp]]

    def at(self, q: Array, v: Array, weights: Array) -> Array:
        """Return the coefficients of the functional Σ weights u(q, v) of states within."""
        m, n = self.mesh, self.mesh.degree + 1
        x, s = m.coordinates(q, v)
        (i, X), (j, S) = _values(m.x, m.degree, x), _values(m.s, m.degree, s)
        rows = i[:, None] * n + np.arange(n)
        columns = j[:, None] * m.degree + np.arange(n)
        size = (m.s.size - 1) * m.degree + 1
        functional = np.zeros((m.x.size - 1) * n * size)
        place = rows[:, :, None] * size + columns[:, None, :]
        np.add.at(functional, place, weights[:, None, None] * X[:, :, None] * S[:, None, :])
        return np.asarray(functional[self.free] * self.scale)


def elements(mesh: Mesh) -> Elements:
    """Return the matrices on ``mesh``.

    Of the backward operator in the coordinates (q, s), v = s w, times −w:
    −L u = −s w u_q − w' (1 − s²) u_s − exp(αmv²/2) (D/m²)/w² ∂_s exp(−αmv²/2) u_s, α = c/D, with
    w' = −V'/(m w); for w = 1 the second term is V'/m u_v.
    """
    o, n = mesh.oscillator, mesh.degree + 1
    t, weight = gauss_legendre(mesh.degree + MORE_POINTS)
    B, D = lagrange(mesh.degree, t)
    BB = np.einsum("gi,gk->gik", B, B).reshape(t.size, -1)
    BD = np.einsum("gi,gk->gik", B, D).reshape(t.size, -1)
    DD = np.einsum("gi,gk->gik", D, D).reshape(t.size, -1)
    hx, hs = 0.5 * np.diff(mesh.x), 0.5 * np.diff(mesh.s)
    x = 0.5 * (mesh.x[1:] + mesh.x[:-1])[:, None] + hx[:, None] * t
    s = 0.5 * (mesh.s[1:] + mesh.s[:-1])[:, None] + hs[:, None] * t
    q, slope = mesh.q(x)
    w, force = mesh.w(q), o.force(q)
    bend = np.ones_like(s) if mesh.energy is None else 1.0 - s * s
    q, slope, w, force = (a[:, None, :, None] for a in (q, slope, w, force))
    s, bend = s[None, :, None, :], bend[None, :, None, :]
    widths = hx[:, None, None, None] * hs[None, :, None, None]
    density = np.exp(-o.inverse_temperature * o.energy(q, s * w))
    area = density * weight[:, None] * weight
    flow = area * hs[None, :, None, None] * (s * w * w)  # dq/dx cancels
    turn = area * hx[:, None, None, None] * slope * force / o.mass * bend
    spread = area * (hx[:, None] / hs)[:, :, None, None] * slope * o.diffusion / w
    local = BB.T @ turn @ BD + BB.T @ spread @ DD - BD.T @ flow @ BB
    mass = BB.T @ (area * widths * slope * w) @ BB
    panels, across = mesh.x.size - 1, mesh.s.size - 1
    size = across * mesh.degree + 1
    row_x = np.arange(panels * n, dtype=np.int32).reshape(panels, 1, n, 1, 1, 1)
    column_s = np.add.outer(
        np.arange(across, dtype=np.int32) * mesh.degree, np.arange(n, dtype=np.int32)
    )
    shape = (panels, across, n, n, n, n)
    place = [
        np.broadcast_to(row_x * size + column_s[None, :, None, None, :, None], shape),
        np.broadcast_to(
            row_x.transpose(0, 1, 3, 2, 4, 5) * size + column_s[None, :, None, None, None, :], shape
        ),
    ]
    total = panels * n * size
    index = tuple(p.ravel() for p in place)
    # Both matrices at once, M as the imaginary part: the sorting is half of the work.
    pair = coo_array(((local + 1j * mass).ravel(), index), shape=(total, total)).tocsc()
    faces, lost = _faces(mesh, BB, column_s, total, s[0, :, 0, :], weight, hs)
    K, M = pair.real + faces, pair.imag.copy()
    inner = np.ones((panels * n, size), dtype=bool)
    if mesh.energy is not None:
        inner[:, [0, -1]] = False
        lost = -np.asarray(K @ (~inner.ravel()).astype(float))
    free = np.flatnonzero(inner.ravel())
    load = np.asarray(M @ np.ones(total))[free]
    if free.size < total:
        K, M = K[free][:, free], M[free][:, free]
    scale = 1.0 / np.sqrt(M.diagonal())
    for A in (K, M):
        A.data *= scale[A.indices] * np.repeat(scale, np.diff(A.indptr))
    return Elements(mesh, K, M, load * scale, lost[free] * scale, scale, free)


def _faces(
    mesh: Mesh, BB: Array, column_s: Integers, total: int, s: Array, weight: Array, hs: Array
) -> tuple[csc_array, Array]:
    """Return the matrix of |v| (u − u of where motion goes) at the panels' ends, and its exit."""
    o, n = mesh.oscillator, mesh.degree + 1
    size, panels = (mesh.s.size - 1) * mesh.degree + 1, mesh.x.size - 1
    q, _ = mesh.q(mesh.x)
    w = mesh.w(q)[:, None, None]
    density = np.exp(-o.inverse_temperature * o.energy(q[:, None, None], s * w))
    block = (np.abs(s) * w * w * density * weight * hs[:, None]) @ BB  # (nodes, across, n n)
    parts: list[tuple[Array, Integers, Integers]] = []

    def add(values: Array, row: Integers, column: Integers, flipped: bool = False) -> None:
        across = np.arange(values.shape[1])
        ahead = column_s[first : first + across.size]
        other = size - 1 - ahead if flipped else ahead
        shape = (row.size, across.size, n, n)
        rows = np.broadcast_to(row[:, None, None, None] * size + ahead[None, :, :, None], shape)
        columns = np.broadcast_to(
            column[:, None, None, None] * size + other[None, :, None, :], shape
        )
        parts.append((values.ravel(), rows.ravel(), columns.ravel()))

    half = (mesh.s.size - 1) // 2
    k = np.arange(panels)
    # v > 0 goes to the right: the right end of each panel; what is beyond the last one has failed.
    first = half
    add(block[1:, half:], k * n + n - 1, k * n + n - 1)
    add(-block[1:-1, half:], k[:-1] * n + n - 1, k[1:] * n)
    first = 0
    add(block[:-1, :half], k * n, k * n)
    add(-block[1:-1, :half], k[1:] * n, k[:-1] * n + n - 1)
    if mesh.folded:
        add(-block[:1, :half], k[:1] * n, k[:1] * n, flipped=True)
    values, rows, columns = (np.concatenate(column) for column in zip(*parts, strict=True))
    lost = np.zeros(total)
    ends = block.reshape(*block.shape[:2], n, n).sum(axis=3)
    np.add.at(lost, ((panels - 1) * n + n - 1) * size + column_s[half:], ends[-1, half:])
    if not mesh.folded:
        np.add.at(lost, column_s[:half], ends[0, :half])
    return coo_array((values, (rows, columns)), shape=(total, total)).tocsc(), lost


def _values(nodes: Array, degree: int, t: Array) -> tuple[Integers, Array]:
    """Panels and values (points, degree + 1) of the functions at t."""
    k = np.clip(np.searchsorted(nodes, t, side="right") - 1, 0, nodes.size - 2)
    local = 2.0 * (t - nodes[k]) / (nodes[k + 1] - nodes[k]) - 1.0
    return k, lagrange(degree, local)[0]
