"""scikit-fem as its examples use it: P1 and P2 on uniform meshes, a sparse direct solve."""

from functools import partial

from measure import Sampled, Setting, measure_all, need  # first: NumPy then has one thread

# isort: split

import numpy as np
from problems import PROBLEMS
from scipy.sparse.linalg import splu

skfem = need("skfem")

LINE_END, PLANE_END = 8.0, 20.0
"""Ends of the boxes: an energy, and multiples of each mean."""
ELEMENTS = {
    1: {1: skfem.ElementLineP1, 2: skfem.ElementLineP2},
    2: {1: skfem.ElementQuad1, 2: skfem.ElementQuad2},
}
LINE = ((1, 1_600), (1, 12_800), (1, 51_200), (2, 800), (2, 6_400), (2, 51_200))
PLANE = ((1, 64), (1, 256), (1, 512), (2, 32), (2, 128), (2, 256))
COUPLED = ((1, 64), (1, 256), (2, 32), (2, 128))
"""Degree and elements along an axis, each degree from its smallest."""


def solved(problem, degree, count):
    """Return the basis and the nodal values of p_h, of mass one."""
    if problem.dimension == 1:
        mesh = skfem.MeshLine(np.linspace(0.0, LINE_END, count + 1))
    else:
        axes = (np.linspace(0.0, PLANE_END * t, count + 1) for t in problem.temperature)
        mesh = skfem.MeshQuad.init_tensor(*axes)
    basis = skfem.Basis(mesh, ELEMENTS[problem.dimension][degree]())

    @skfem.BilinearForm
    def flux(p, v, w):
        """Minus the flux times the gradient of v: zero flux through the boundary is natural."""
        if problem.dimension == 1:
            s, b, slope = problem.coefficients(w.x[0])
            return (0.5 * b * p.grad[0] + (0.5 * slope - s) * p) * v.grad[0]
        s, b, slope = problem.coefficients(w.x)
        total = sum(
            (0.5 * b[i] * p.grad[i] + (0.5 * slope[i] - s[i]) * p) * v.grad[i] for i in range(2)
        )
        if (cross := problem.cross(w.x)) is not None:
            total += 0.5 * cross * (p.grad[0] * v.grad[1] + p.grad[1] * v.grad[0])
        return total

    @skfem.LinearForm
    def mass(v, w):
        return v

    A = flux.assemble(basis).tocsc()
    # p is known up to a factor: pin it at one node in the bulk, and scale afterwards.
    target = [0.3] if problem.dimension == 1 else 0.5 * problem.temperature
    x = basis.doflocs
    pin = int(np.argmin(np.sum((x - np.array(target)[:, None]) ** 2, axis=0)))
    p = np.ones(basis.N)
    rest = np.delete(np.arange(basis.N), pin)
    p[rest] = splu(A[rest][:, rest].tocsc()).solve(-A[rest][:, [pin]].toarray().ravel())
    return basis, p / (mass.assemble(basis) @ p)


def sampled(answer):
    """Return p_h at the points of a finer rule on its own elements."""
    basis, p = answer
    finer = skfem.Basis(basis.mesh, basis.elem, intorder=8 if basis.mesh.dim() == 1 else 6)
    x = finer.global_coordinates().value
    values = finer.interpolate(p).value
    ends = tuple(float(end) for end in basis.mesh.p.max(axis=1))
    return Sampled(x.reshape(x.shape[0], -1), finer.dx.ravel(), values.ravel(), ends)


def setting(name, degree, count):
    """Return one measurement."""
    problem = PROBLEMS[name]
    return Setting(
        name,
        f"P{degree} uniform, {count} elements" + (" an axis" if problem.dimension == 2 else ""),
        partial(solved, problem, degree, count),
        sampled,
        lambda answer: answer[0].N,
    )


if __name__ == "__main__":
    settings = [setting("W1", *step) for step in LINE]
    settings += [setting("W1, B = 1e4", 2, 6_400)]
    settings += [setting("W2", *step) for step in PLANE]
    settings += [setting("W3", *step) for step in COUPLED]
    settings += [setting("W4", 2, count) for count in (32, 128)]
    measure_all("scikit-fem", "scikit-fem", settings)
