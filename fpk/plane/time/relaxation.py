"""The slowest relaxation rates of two energies."""

from itertools import pairwise

import numpy as np
from scipy.sparse.linalg import LinearOperator, eigs

from fpk.arrays import EPS, Array, Complexes
from fpk.dynamics import Rates, certified_rates
from fpk.errors import NotCertified
from fpk.plane.solution import SAFETY, Nodes, graded
from fpk.plane.time.exponential import factorised
from fpk.plane.time.levels import Frame
from fpk.plane.time.operator import PlaneOperator

VECTORS = (4, 30)
"""Arnoldi vectors: so many times those sought, and so many more. Rates of the same size are common,
of modes that decay alike, and a small space may miss one."""
HEIGHT = 8.0
"""Rise of −ln w by which meshes are longer than for densities: modes grow with the energy."""


def relaxation_rates(frame: Frame, count: int, *, tol: float, relative: float = 0.0) -> Rates:
    """Return the ``count`` eigenvalues of −L with the least real parts but 0.

    Levels rise until two of them agree to ``tol``, relative to each; the answer is that of the
    finer one. ``relative`` is the relative error of the coefficients. Raises ``NotCertified`` where
    the two finest levels have fewer unknowns than that.
    """

    def nodes(rise: float, panels: int) -> Nodes:
        return graded(frame.ends(rise), panels)

    # A rate of the order of the slowest: b/H² of the energies at their scales, the lesser one.
    scales = np.array(frame.process.energy_scales)
    b = frame.process.coefficients(scales[None, :]).diffusion[0]
    shift, sought, answer = float(np.min(np.diag(b) / scales**2)), 2 * count + 2, None
    vectors = VECTORS[0] * sought + VECTORS[1]
    levels = (
        (op, *_eigenvalues(op, sought, vectors, shift))
        for op in frame.operators(nodes, tol=tol, height=HEIGHT)
        if vectors < op.free.size
    )
    for (_, coarse, _), (op, every, residual) in pairwise(levels):
        values = every[:count]
        size = np.abs(values)
        errors = SAFETY * np.abs(coarse - values[:, None]).min(axis=1)
        # Round-off of an eigenvalue of the shifted inverse, relative to its largest.
        errors += 50.0 * EPS * (size + shift) ** 2 / shift
        errors += (relative + 2.0 * frame.relative_error) * size
        settings = {"unknowns": int(op.free.size), "degree": op.degree}
        answer = certified_rates(values, errors, tol=tol, residual=residual, settings=settings)
        if answer.certificate.certified:
            break
    if answer is None:
        raise NotCertified(f"{count} rates take more unknowns than are affordable")
    return answer


def _eigenvalues(
    op: PlaneOperator, sought: int, vectors: int, shift: float
) -> tuple[Complexes, float]:
    """Return the eigenvalues of −L but 0 with Im λ >= 0, and the residual of their equation."""
    A, M, _ = op.matrices
    factors = factorised((shift * M - A).tocsc())
    inverse = LinearOperator(A.shape, matvec=lambda x: factors.solve(M @ x), dtype=float)
    start: Array = np.random.default_rng(0).normal(size=A.shape[0])
    s, X = eigs(inverse, k=sought, ncv=vectors, v0=start, tol=0.0)
    values = 1.0 / s - shift
    # A double eigenvalue, which is real, splits by the root of round-off.
    values = np.where(np.abs(values.imag) <= 1e-9 * np.abs(values), values.real, values)
    defect = np.asarray(A @ X + (M @ X) * values)
    terms = np.asarray(abs(A) @ np.abs(X) + (M @ np.abs(X)) * np.abs(values))
    residual = float(np.max(np.abs(defect)) / np.max(terms))
    order = np.lexsort((values.imag, values.real))
    order = order[(values.imag[order] >= 0.0)]
    stationary = int(np.argmin(np.abs(values[order])))
    return np.asarray(np.delete(values[order], stationary)), residual
