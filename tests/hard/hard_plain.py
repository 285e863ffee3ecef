"""What one would write without this program: run beside ours, for comparison."""

import warnings

import numpy as np
from numpy.typing import NDArray
from scipy.sparse.linalg import MatrixRankWarning, spsolve
from skfem import Basis, BilinearForm, ElementLineP2, LinearForm, MeshLine

from fpk.answer.density import Density
from fpk.system.process import Process
from fpk.system.system import System

Array = NDArray[np.float64]

CELLS = 1000
REACH = 20.0
"""The box of the plain solution in units of the energy scale: about what one would guess."""


def plain_elements(process: Process, reference: Density) -> tuple[float, float]:
    """Return the L1 error and the minimum, relative to the maximum, of plain P2 elements.

    ``CELLS`` equal cells, the weak form of the FPK equation as it stands, one row of the matrix
    replaced by the mass: scikit-fem as its examples use it.
    """
    mesh = MeshLine(np.linspace(0.0, REACH * process.energy_scale, CELLS + 1))
    basis = Basis(mesh, ElementLineP2())

    def flux(u, v, w):  # type: ignore[no-untyped-def]
        H = w.x[0]
        c = process.coefficients(H.ravel())
        a = (c.drift - 0.5 * c.divergence).reshape(H.shape)
        b = c.diffusion.reshape(H.shape)
        return (a * u - 0.5 * b * u.grad[0]) * v.grad[0]

    matrix = BilinearForm(flux).assemble(basis).tolil()
    mass = LinearForm(lambda v, w: v).assemble(basis)
    row = CELLS // 20
    matrix[row] = mass
    right = np.zeros(mass.size)
    right[row] = 1.0
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", MatrixRankWarning)
        p = spsolve(matrix.tocsr(), right)
    x = basis.global_coordinates()
    values = np.asarray(basis.interpolate(p))
    truth = np.where(x[0] > 0.0, reference.pdf(np.maximum(x[0], np.finfo(float).tiny)), 0.0)
    error = float(np.sum(np.abs(values - truth) * basis.dx))
    return error, float(values.min() / values.max())


def plain_euler(
    system: System, *, dt: float, time: float, paths: int, seed: int = 1
) -> tuple[float, Array]:
    """Return the share of lost paths and the final states (paths, 2n) of Euler-Maruyama in NumPy.

    Hertz contacts and constant damping; every path starts at rest.
    """
    generator = np.random.default_rng(seed)
    n, m = system.n, system.mass
    root = np.linalg.cholesky(2.0 * dt * system.noise_matrix + 1e-300 * np.eye(n))
    q, p = np.zeros((paths, n)), np.zeros((paths, n))
    with np.errstate(over="ignore", invalid="ignore"):
        for _ in range(round(time / dt)):
            force = -q @ system.stiffness_matrix - (p / m) @ system.damping.T
            for stop in system.stops:
                sign = 1.0 if stop.side == "right" else -1.0
                overlap = np.maximum(sign * q[:, stop.index] - stop.clearance, 0.0)
                force[:, stop.index] -= sign * stop.force(overlap)
            q, p = q + dt * p / m, p + dt * force + generator.standard_normal((paths, n)) @ root.T
    finite = np.all(np.isfinite(q) & np.isfinite(p), axis=1)
    return 1.0 - float(finite.mean()), np.hstack([q, p])
