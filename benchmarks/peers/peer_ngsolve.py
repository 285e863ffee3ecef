"""NGSolve: P2 on uniform meshes, p = 8 to 16 on graded ones with a node at each contact energy.

Condensed, sparse LU. In two energies the coefficients are written as NGSolve's own functions. In
one they are integrals, evaluated by NumPy at the integration points of a whole mesh at once: a
function evaluated point by point would cost hundreds of times more. Meshes and boxes were found by
hand.
"""

from functools import partial
from itertools import pairwise

from measure import Sampled, Setting, measure_all, need  # first: NumPy then has one thread

# isort: split

import numpy as np
from problems import PROBLEMS

from fpk.numeric.quadrature import panel_rule

ngs = need("ngsolve")
need("ngsolve.comp")
netgen = need("netgen.meshing")

ngs.SetNumThreads(1)
LINE_END = 8.0


def mesh_of(axes):
    """Return the mesh of intervals or of rectangles between the nodes of ``axes``."""
    m = netgen.Mesh(dim=len(axes))
    grid = np.meshgrid(*axes, indexing="ij")
    flat = np.array([g.ravel() for g in grid])
    flat = np.vstack([flat, np.zeros((3 - len(axes), flat.shape[1]))])
    ids = [m.Add(netgen.MeshPoint(netgen.Pnt(*x))) for x in flat.T]
    number = np.arange(flat.shape[1]).reshape(grid[0].shape)
    if len(axes) == 1:
        for i in range(len(ids) - 1):
            m.Add(netgen.Element1D([ids[i], ids[i + 1]], index=1))
        m.Add(netgen.Element0D(ids[0], index=1))
        m.Add(netgen.Element0D(ids[-1], index=2))
        m.SetMaterial(1, "box")
        return ngs.Mesh(m)
    m.SetMaterial(1, "box")
    m.Add(netgen.FaceDescriptor(surfnr=1, domin=1, bc=1))
    corners = (number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:])
    for four in zip(*(c.ravel() for c in corners), strict=True):
        m.Add(netgen.Element2D(1, [ids[k] for k in four]))
    for side in (number[:, 0], number[-1, :], number[::-1, -1], number[0, ::-1]):
        for i, j in pairwise(side):
            m.Add(netgen.Element1D([ids[i], ids[j]], index=1))
    return ngs.Mesh(m)


def functions(problem, mesh, degree):
    """Return ½b_ii, ½∇·b − s and ½b_12 as functions of NGSolve, and the rule to integrate with."""
    if problem.dimension == 2:
        s, b, slope, cross = problem.written(ngs.x, ngs.y, _sigmoid)
        rest = [(0.5 * slope[i] - s[i]).Compile() for i in range(2)]
        return [0.5 * d for d in b], rest, None if cross is None else 0.5 * cross, ngs.dx
    # A space of values at integration points: its order is that of its polynomials, degree + 1
    # points. Its GetIntegrationRules has no rule for intervals (6.2.2608): whoever passes it
    # integrates at other points than the values belong to, see the page.
    space = ngs.comp.IntegrationRuleSpace(mesh, order=degree)
    rules = {ngs.SEGM: ngs.IntegrationRule(ngs.SEGM, 2 * degree)}
    s, b, slope = problem.coefficients(at_points(space, ngs.x))
    return [given(space, 0.5 * b)], [given(space, 0.5 * slope - s)], None, ngs.dx(intrules=rules)


def _sigmoid(z):
    return 1.0 / (1.0 + ngs.exp(-z))


def at_points(space, function):
    """Return the values of a coefficient function at the integration points."""
    found = ngs.GridFunction(space)
    found.Interpolate(function)
    return found.vec.FV().NumPy().copy()


def given(space, values):
    """Return a function that has these values at the integration points."""
    found = ngs.GridFunction(space)
    found.vec.FV().NumPy()[:] = values
    return found


def solved(problem, axes, degree):
    """Return the axes and p_h, of mass one."""
    mesh = mesh_of(axes)
    space = ngs.H1(mesh, order=degree)
    diffusion, rest, cross, rule = functions(problem, mesh, degree)
    p, v = space.TnT()
    A = ngs.BilinearForm(space, condense=True)
    for i in range(len(axes)):
        flux = diffusion[i] * ngs.grad(p)[i] + rest[i] * p
        if cross is not None:
            flux += cross * ngs.grad(p)[1 - i]
        A += flux * ngs.grad(v)[i] * rule
    A.Assemble()
    found = ngs.GridFunction(space)
    free = ngs.BitArray(space.FreeDofs(coupling=True))
    pin = _pinned(problem, axes)
    free.Clear(pin)
    found.vec[pin] = 1.0
    residual = (-A.mat * found.vec).Evaluate()
    residual += A.harmonic_extension_trans * residual
    found.vec.data += A.mat.Inverse(free, inverse="umfpack") * residual
    found.vec.data += A.harmonic_extension * found.vec
    found.vec.data /= ngs.Integrate(found, mesh, order=2 * degree)
    return axes, found, degree


def _pinned(problem, axes):
    """Return the number of a node in the bulk: p is known up to a factor."""
    target = (0.3,) if problem.dimension == 1 else 0.5 * problem.temperature
    index = [int(np.argmin(np.abs(a - t))) for a, t in zip(axes, target, strict=True)]
    return int(np.ravel_multi_index(index, [a.size for a in axes]))


def sampled(answer):
    """Return p_h at Gauss points of its elements."""
    axes, found, degree = answer
    count = degree + 4
    rules = [[a.ravel() for a in panel_rule(nodes, count)] for nodes in axes]
    points = np.array([g.ravel() for g in np.meshgrid(*(x for x, _ in rules), indexing="ij")])
    weights = rules[0][1] if len(axes) == 1 else np.outer(rules[0][1], rules[1][1]).ravel()
    values = np.ravel(found(found.space.mesh(*points)))
    return Sampled(points, weights, values, tuple(float(a[-1]) for a in axes))


def graded_line(problem, count, end, layers, power):
    """Return nodes at the contact energies: ``layers`` shrinking ones above each, few far out."""
    energies = problem.contact_energies
    far = energies[-1] + (end - energies[-1]) * np.linspace(0.0, 1.0, count + 1) ** power
    nodes = [[0.0], far]
    for contact, after in zip(energies, (*energies[1:], far[1]), strict=True):
        nodes += [[contact], contact + (after - contact) * 0.4 ** np.arange(layers + 1.0)]
    return (np.unique(np.concatenate(nodes)),)


def graded_axis(count, reach, degree):
    """Return nodes with equal shares of the error of e^(−x) in elements of ``degree``."""
    c = degree + 2.0
    share = np.linspace(0.0, 1.0, count + 1)
    return -c * np.log1p(share * np.expm1(-reach / c))


def line_setting(name, degree, words, axes):
    """Return one measurement in one energy."""
    problem = PROBLEMS[name]
    return Setting(
        name, f"p = {degree}, {words}", partial(solved, problem, axes, degree), sampled,
        lambda answer: answer[1].space.ndof,
    )  # fmt: skip


def plane_setting(name, degree, count, reach, words):
    """Return one measurement in two energies; ``reach`` in multiples of each mean."""
    problem = PROBLEMS[name]
    even = np.linspace(0.0, 1.0, count + 1)
    share = {"uniform": reach * even, "squares": reach * even**2}.get(words)
    share = graded_axis(count, reach, degree) if share is None else share
    axes = tuple(t * share for t in problem.temperature)
    return Setting(
        name, f"p = {degree}, {words}, {count} elements an axis, box {reach:g} means",
        partial(solved, problem, axes, degree), sampled, lambda answer: answer[1].space.ndof,
    )  # fmt: skip


LINE_GRADED = ((10, 7.2, 4, 2.5), (18, 7.5, 4, 3.0), (24, 7.5, 5, 2.5), (28, 7.6, 5, 3.0))
"""Elements far out, end of the box, layers above a contact energy, power of the grading far out."""
COUPLED = (
    (2, 128, 20.0, "uniform"),
    (8, 4, 18.0, "graded"),
    (8, 6, 20.0, "graded"),
    (8, 8, 22.0, "graded"),
    (8, 12, 23.0, "graded"),
    (8, 14, 24.0, "graded"),
    (8, 16, 24.0, "graded"),
    (12, 6, 24.0, "graded"),
    (12, 8, 26.0, "graded"),
    (16, 5, 26.0, "graded"),
    (16, 6, 28.0, "graded"),
)
CIRCULATING = (
    (8, 6, 8.0, "squares"),
    (8, 8, 9.0, "squares"),
    (8, 12, 10.0, "squares"),
    (8, 17, 10.5, "squares"),
    (12, 7, 10.5, "squares"),
    (12, 9, 11.0, "squares"),
    (16, 8, 12.0, "squares"),
)
"""Nodes are equidistant in √H: with both energies large p changes within a layer at the axes."""


def settings():
    """Return the ladder of each problem."""
    found = []
    for count in (640, 5_120, 20_480):
        nodes = np.linspace(0.0, LINE_END, count + 1)
        found.append(line_setting("W1", 2, f"uniform, {count} elements", (nodes,)))
    for name, problem in PROBLEMS.items():
        if problem.dimension == 1:
            for step in LINE_GRADED:
                axes = graded_line(problem, *step)
                words = f"graded, {axes[0].size - 1} elements, box {step[1]:g}"
                found.append(line_setting(name, 8, words, axes))
    found += [plane_setting("W3", *step) for step in COUPLED]
    return found + [plane_setting("W4", *step) for step in CIRCULATING]


if __name__ == "__main__":
    measure_all("NGSolve", "ngsolve", settings())
