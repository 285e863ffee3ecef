"""Elements and the readable operator: equal to each other, and of the order that theory gives."""

import numpy as np
import pytest
from processes import cox_ingersoll_ross, integral
from scikit_operator import Operator
from scipy.linalg import eig
from systems import both, fig6
from test_fpk_plane import manufactured

from averaging.energy_process import energy_process
from fpk.solvers.line.stationary import solve_on_mesh
from fpk.solvers.plane.elements import shape_functions
from fpk.solvers.plane.solution import solve_plane_on_mesh

FORMS = ["flux", "drift-diffusion"]
"""The solver's elements, and p itself as the polynomial, by the readable operator."""


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
    return energy_process(fig6(contacts))


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
    ("flux", None, 2, 3, 48 * TWO),
    ("flux", 1.5, 1, 2, 48 * TWO),
    ("flux", 1.5, 4, 5, 12 * TWO),
    ("flux", 1.5, 2, 3, 50 * TWO),
    ("flux, of shape", 1.5, 4, 5, 8 * TWO),
    ("drift-diffusion", 1.5, 2, 3, 48 * TWO),
    ("drift-diffusion", 1.5, 1, 2, 20 * FOUR),
]
# More degrees, and meshes on which H_c is no node.
SLOW = [
    *((form, None, p, p + 1, n * TWO) for form in FORMS for p, n in ((1, 48), (4, 12))),
    ("drift-diffusion", 2.5, 4, 5, 24 * TWO),
    ("flux", 1.5, 1, 2, 50 * TWO),
    ("drift-diffusion", 1.5, 2, 3, 20 * FOUR),
    # Of 1280 elements the round-off of the sparse solution is larger than their error.
    ("drift-diffusion", 1.5, 4, 3, np.array([176, 302, 512, 860])),
]
assert {bool((H_C * row[-1][0] / END) % 1.0) for row in ROWS if row[1]} == {True, False}


@pytest.mark.parametrize(
    "form, exponent, degree, order, counts",
    [*ROWS, *(pytest.param(*row, marks=pytest.mark.slow) for row in SLOW)],
)
def test_observed_order(form, exponent, degree, order, counts):
    process = chain_with(exponent)
    expected = () if exponent is None else (H_C,)
    assert process.nonsmooth == pytest.approx(expected, rel=1e-14)
    form, _, of_shape = form.partition(", ")
    errors = refinement_errors(process, form, degree, counts, of_shape=bool(of_shape))
    assert_order(errors, counts, order)


@pytest.mark.parametrize("form, degree, order", [("flux", 1, 3), ("drift-diffusion", 4, 5)])
def test_the_harness_sees_a_wrong_order(form, degree, order):
    counts = 20 * FOUR
    errors = refinement_errors(chain_with(1.5), form, degree, counts)
    with pytest.raises(AssertionError, match="Not equal to tolerance"):
        assert_order(errors, counts, order)


H = np.random.default_rng(20260705).uniform(0.05, 2.0, (200, 2))


@pytest.mark.parametrize("degree", [1, 2, 3, 8])
@pytest.mark.parametrize("contact", [False, True])
def test_the_stationary_vector_of_one_energy_is_that_of_single_elements(degree, contact):
    process = energy_process(fig6(both(10.0) if contact else ()))
    nodes = np.unique([*np.linspace(0.0, 4.0, 9), *process.nonsmooth])
    solved = solve_on_mesh(process, nodes, degree)
    # The points of an element are degree + MORE_POINTS.
    operator = Operator(process, (nodes,), degree, degree + 4, flux_form=True)
    u = operator.stationary()
    p, expected = operator.density(u, H[:, 0]), solved.density(H[:, 0])
    if contact:
        # Above the contact the solver takes the mass from points of its own, one factor of p.
        p = p * (expected @ p) / (p @ p)
    np.testing.assert_allclose(p, expected, rtol=1e-10, atol=1e-12 * expected.max())


@pytest.mark.parametrize("degree", [2, 5])
def test_the_stationary_vector_of_two_energies_is_that_of_the_factored_solver(degree):
    nodes, (process, _) = (
        (np.linspace(0.0, 6.0, 5), np.linspace(0.0, 5.0, 4)),
        manufactured(0.4, 0.0),
    )
    solved = solve_plane_on_mesh(process, nodes, degree)
    operator = Operator(process, nodes, degree, degree + 2)
    expected = solved.density(*H.T)
    p = operator.density(operator.stationary(), *H.T)
    np.testing.assert_allclose(p, expected, rtol=1e-9, atol=1e-11 * expected.max())


def test_the_rates_of_the_square_root_process_are_multiples_of_its_damping():
    # dH = (2 − H) dt + √(2 H) dB: Laguerre polynomials, e^(−40) of the mass beyond the mesh.
    operator = Operator(cox_ingersoll_ross(a=2.0), (np.linspace(0.0, 40.0, 21),), 8, 12)
    rates = np.sort(-eig(operator.A.toarray(), operator.M.toarray(), right=False).real)
    np.testing.assert_allclose(rates[:4], np.arange(4.0), atol=1e-7)
