"""Elements: equal to a global assembly, and of the order that theory gives."""

import numpy as np
import pytest
from fpk_processes import both, chain, integral
from scikit_operator import Operator
from scipy.sparse import csr_matrix
from scipy.sparse.linalg import spsolve
from skfem import Basis, BilinearForm, ElementLineP1, ElementLineP2, ElementLinePp, MeshLine
from skfem.helpers import dot, grad

from averaging.energy_process import energy_process
from fpk.solvers.line.elements import element_rule
from fpk.solvers.line.stationary import solve_on_mesh
from fpk.solvers.plane.elements import shape_functions

FORMS = ["flux", "drift-diffusion"]
"""The solver's elements, and p itself as the polynomial, by the readable operator."""


def globally_assembled(process, nodes, degree):
    """The same Galerkin equations by scikit-fem: one value pinned, scaled to mass one.

    Returns the energies (elements, points) of its quadrature and the density there.
    """
    element = {1: ElementLineP1, 2: ElementLineP2}.get(degree, lambda: ElementLinePp(degree))()
    rule = element_rule(degree)
    basis = Basis(MeshLine(nodes), element, quadrature=(rule.share[None, :], rule.weight))
    energy = np.asarray(basis.global_coordinates())[0]
    c = process.coefficients(energy.ravel())
    c = type(c)(*(part.reshape(energy.shape) for part in c))
    T = np.exp(c.log_density_of_states)
    drift, diffusion = T * c.dissipation, T * c.diffusion

    @BilinearForm
    def flux_against_slope(u, v, w):
        return drift * u * grad(v)[0] - 0.5 * diffusion * dot(grad(u), grad(v))

    A = csr_matrix(flux_against_slope.assemble(basis))
    peak = np.abs(energy - process.energy_scale).argmin() // rule.share.size
    pinned = basis.nodal_dofs[0, peak]
    others = np.setdiff1d(np.arange(basis.N), pinned)
    u = np.ones(basis.N)
    u[others] = spsolve(A[np.ix_(others, others)].tocsc(), -A[others, pinned].toarray().ravel())
    p = T * np.asarray(basis.interpolate(u))
    return energy, p / np.sum(p * basis.dx)


@pytest.mark.parametrize("degree", [1, 2, 3, 4, 8])
def test_the_local_solution_is_that_of_a_global_assembly(degree):
    process = energy_process(chain(2, both(10.0)))
    nodes = np.concatenate([np.linspace(0.0, 0.0625, 4), np.linspace(0.07, 2.0, 12)])
    energy, expected = globally_assembled(process, nodes, degree)
    found = solve_on_mesh(process, nodes, degree).density(energy)
    # Condition of the global matrix: some 1e4 at these 16 elements.
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-10 * expected.max())


@pytest.mark.parametrize("degree", [1, 2, 5, 12])
def test_shape_functions_have_a_vertex_each_and_their_slopes(degree):
    t = np.linspace(0.05, 0.95, 7)
    value, slope = shape_functions(degree, t)
    ends, _ = shape_functions(degree, np.array([0.0, 1.0]))
    expected = np.zeros((degree + 1, 2))
    expected[0, 0] = expected[1, 1] = 1.0
    np.testing.assert_allclose(ends, expected, atol=1e-14)
    h = 1e-5
    difference = (shape_functions(degree, t + h)[0] - shape_functions(degree, t - h)[0]) / (2 * h)
    # Central difference: h²/6 times the third derivative, at most 12⁶ times the value.
    np.testing.assert_allclose(slope, difference, atol=1e-10 * max(degree, 2) ** 6 + 1e-9)
    assert np.linalg.matrix_rank(value[:, :]) == min(degree + 1, t.size)


# Truncated at the end of the mesh with zero flux, the density is C T exp(−αH) on [0, end] without
# a tail. α = 4, contact begins at H_c = ½ k_eff δ² with k_eff = ½ (two unit springs in a row).
ALPHA, END, H_C = 4.0, 1.5, 0.25
FINE = np.linspace(0.0, END, 6 * 64 + 1)


def chain_with(exponent):
    contacts = () if exponent is None else both(10.0, 1.0, "power", exponent=exponent)
    return energy_process(chain(2, contacts))


def density_on_mesh(process, form, degree, nodes):
    if form == "flux":
        return solve_on_mesh(process, nodes, degree).density
    operator = Operator(process, (nodes,), degree, degree + 4)
    u = operator.stationary()
    return lambda x: operator.density(u, x.ravel()).reshape(x.shape)


def refinement_errors(process, form, degree, counts, *, of_shape=False):
    """L1 errors against C T exp(−αH) on uniform meshes; ``of_shape``: after exact scaling."""

    def weight(x):
        c = process.coefficients(x.ravel())
        return np.exp(c.log_density_of_states - ALPHA * x.ravel()).reshape(x.shape)

    norm = integral(weight, FINE)
    errors = []
    for count in counts:
        nodes = np.linspace(0.0, END, count + 1)
        density = density_on_mesh(process, form, degree, nodes)
        panels = np.union1d(FINE, nodes)
        mass = integral(density, panels) if of_shape else 1.0
        errors.append(
            integral(lambda x, p=density, m=mass: abs(p(x) / m - weight(x) / norm), panels)
        )
    return np.array(errors)


def assert_order(errors, counts, order):
    assert errors.size >= 4
    # Round-off: one ε of the scale at every vertex.
    assert errors[-1] > 10.0 * np.finfo(float).eps * counts[-1]
    found = np.log(errors[:-1] / errors[1:]) / np.log(counts[1:] / counts[:-1])
    np.testing.assert_allclose(found, order, rtol=0, atol=0.15)


# What orders are to be expected. Above contact, T − T_lin ~ (H − H_c)^(r), r = e + 3/2 for n = 2
# and a force ~ overlap^e (overlap^(e+1) against the root of the turning point), followed by
# (H − H_c)^(2e + 3/2); so T is C² for Hertz, e = 3/2.
#
# * Flux form: u = p/T = exp(−αH) is smooth whatever the node, T enters as a weight: order p + 1
#   always. Off a node the scaling to mass one has a quadrature error ~ h^(r+1) = h⁴ of its own,
#   which degree 4 shows: the shape converges with order 5, the mass with order 4.
# * Drift-diffusion form: u = p is as smooth as T. Off a node, b' ~ (H − H_c)² in one element
#   costs a quadrature error ~ h³ of ln p from there on: order min(p + 1, 3). Measured at
#   refinements where H_c keeps its place (a third) in its element and the sign of that error does
#   not alternate; for degree 4 on fine meshes, where order 5 of the rest is gone. On a node, the
#   second power (H − H_c)^(9/2) leaves order 4.5 for degree 4; e = 5/2 (powers 4 and 13/2) lets
#   order p + 1 = 5 be seen.
TWO, FOUR = 2 ** np.arange(4), 4 ** np.arange(4)
ROWS = [
    *((form, None, p, p + 1, n * TWO) for form in FORMS for p, n in ((1, 48), (2, 48), (4, 12))),
    *((form, 1.5, p, p + 1, 48 * TWO) for form in FORMS for p in (1, 2)),
    ("flux", 1.5, 4, 5, 12 * TWO),
    ("drift-diffusion", 2.5, 4, 5, 24 * TWO),
    ("flux", 1.5, 1, 2, 50 * TWO),
    ("flux", 1.5, 2, 3, 50 * TWO),
    ("flux, of shape", 1.5, 4, 5, 8 * TWO),
    ("drift-diffusion", 1.5, 1, 2, 20 * FOUR),
    ("drift-diffusion", 1.5, 2, 3, 20 * FOUR),
    # Of 1280 elements the round-off of the sparse solution is larger than their error.
    ("drift-diffusion", 1.5, 4, 3, np.array([176, 302, 512, 860])),
]
assert {bool((H_C * row[-1][0] / END) % 1.0) for row in ROWS if row[1]} == {True, False}


@pytest.mark.parametrize("form, exponent, degree, order, counts", ROWS)
def test_observed_order(form, exponent, degree, order, counts):
    process = chain_with(exponent)
    expected = () if exponent is None else (H_C,)
    assert process.nonsmooth == pytest.approx(expected, rel=1e-14)
    form, _, of_shape = form.partition(", ")
    errors = refinement_errors(process, form, degree, counts, of_shape=bool(of_shape))
    assert_order(errors, counts, order)


def test_off_a_node_the_mass_converges_with_order_4():
    process = chain_with(1.5)
    defects = []
    for count in (32, 128, 512):
        nodes = np.linspace(0.0, END, count + 1)
        solution = solve_on_mesh(process, nodes, 4)
        defects.append(abs(integral(solution.density, np.union1d(FINE, nodes)) - 1.0))
    found = np.log(np.divide(defects[:-1], defects[1:])) / np.log(4.0)
    np.testing.assert_allclose(found, 4.0, atol=0.15)


@pytest.mark.parametrize("form, degree, order", [("flux", 1, 3), ("drift-diffusion", 4, 5)])
def test_the_harness_sees_a_wrong_order(form, degree, order):
    counts = 20 * FOUR
    errors = refinement_errors(chain_with(1.5), form, degree, counts)
    with pytest.raises(AssertionError, match="Not equal to tolerance"):
        assert_order(errors, counts, order)
