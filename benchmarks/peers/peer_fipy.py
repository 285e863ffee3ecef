"""FiPy: its exponential scheme on uniform meshes, solved once for the steady state.

Off-diagonal diffusion, which W3 has, takes p from the solve before: it is solved repeatedly.
"""

import os
from functools import partial

from measure import Setting, cells, measure_all, need  # first: NumPy then has one thread

# isort: split

import numpy as np
from problems import PROBLEMS

os.environ.setdefault("FIPY_SOLVERS", "scipy")
fipy = need("fipy")

LINE_END, PLANE_END = 8.0, 20.0
SOLVES = 9
"""Solves with off-diagonal diffusion, whose term holds the last solve's p: then p rests."""


def solved(problem, count):
    """Return the edges of the cells along each axis and p_h, of mass one."""
    ends = [LINE_END] if problem.dimension == 1 else PLANE_END * problem.temperature
    edges = [np.linspace(0.0, end, count + 1) for end in ends]
    if problem.dimension == 1:
        mesh = fipy.Grid1D(nx=count, dx=edges[0][1])
    else:
        mesh = fipy.Grid2D(nx=count, ny=count, dx=edges[0][1], dy=edges[1][1])
    at = np.maximum(np.array(mesh.faceCenters), 1e-100)
    s, b, slope = (
        np.reshape(a, at.shape)
        for a in problem.coefficients(at[0] if problem.dimension == 1 else at)
    )
    # Flux (s − ½ b') p − ½ b ∇p; without constraints it is zero through the outer faces.
    velocity = np.where(np.array(mesh.exteriorFaces), 0.0, s - 0.5 * slope)
    convection = fipy.FaceVariable(mesh=mesh, rank=1, value=velocity)
    half = 0.5 * b[0] if problem.dimension == 1 else np.array([0.5 * b])[0]
    diffusion = fipy.FaceVariable(mesh=mesh, rank=0 if problem.dimension == 1 else 1, value=half)
    # The steady equation leaves a factor open: a strong source holds p at 1 in one cell.
    target = [0.3] if problem.dimension == 1 else 0.5 * problem.temperature
    centres = np.array(mesh.cellCenters)
    pin = int(np.argmin(np.sum((centres - np.array(target)[:, None]) ** 2, axis=0)))
    hold = np.zeros(mesh.numberOfCells)
    hold[pin] = 1e10
    hold = fipy.CellVariable(mesh=mesh, value=hold)
    p = fipy.CellVariable(mesh=mesh, value=1.0)
    terms = fipy.DiffusionTerm(coeff=_tensor(diffusion, mesh, problem))
    terms = terms - fipy.ExponentialConvectionTerm(coeff=convection)
    equation = terms - fipy.ImplicitSourceTerm(coeff=hold) + hold
    for _ in range(SOLVES if problem.name == "W3" else 1):
        equation.solve(var=p, solver=fipy.LinearLUSolver(tolerance=1e-14))
    values = np.array(p.value)
    values = values / (values.sum() * np.prod([e[1] for e in edges]))
    shape = [count] * problem.dimension
    return edges, values.reshape(shape[::-1]).T


def _tensor(diffusion, mesh, problem):
    """Return the coefficient of the diffusion term: with two energies a diagonal tensor."""
    if problem.dimension == 1:
        return diffusion
    cross = problem.cross(np.array(mesh.faceCenters))
    both = np.zeros_like(diffusion.value[0]) if cross is None else 0.5 * cross
    value = np.array([[diffusion.value[0], both], [both, diffusion.value[1]]])
    return fipy.FaceVariable(mesh=mesh, rank=2, value=value)


def setting(name, count):
    """Return one measurement."""
    problem = PROBLEMS[name]
    unit = " an axis" if problem.dimension == 2 else ""
    return Setting(
        name, f"exponential, {count} cells{unit}", partial(solved, problem, count),
        lambda answer: cells(*answer), lambda answer: answer[1].size,
    )  # fmt: skip


if __name__ == "__main__":
    settings = [setting("W1", count) for count in (1_000, 8_000, 200_000)]
    settings += [setting("W1, B = 1e4", 16_000)]
    settings += [setting("W3", count) for count in (32, 128)]
    measure_all("FiPy", "FiPy", settings)
