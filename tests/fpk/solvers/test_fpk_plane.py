"""The two-dimensional solver against (34), against manufactured problems, and its orders."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from processes import process_of

from fpk.numeric.errors import InvalidInput, NotCertified
from fpk.numeric.quadrature import panel_rule
from fpk.solvers.plane.solution import solve_plane_on_mesh
from fpk.solvers.plane.stationary import solve_plane
from fpk.solvers.plane.weight import UNIT_WEIGHT, Weight


def square_root_process(c, d):
    """Two independent CIR processes, (33) with unit modal masses: ln p = −Σ c_i H_i/d_i."""
    c, d = np.array(c), np.array(d)
    return process_of(
        lambda H: d - c * H,
        lambda H: 2.0 * d * H[:, :, None] * np.eye(2),
        lambda H: np.broadcast_to(2.0 * d, H.shape),
        tuple(d / c),
    )


def manufactured(cross, swirl):
    """Coupled process with the stationary density exp(−H1 − 1.5 H2 − 0.3 H1 H2), by construction.

    b is full (off-diagonal by ``cross``) and depends on both energies. The drift is what makes
    J = (∂ψ/∂H2, −∂ψ/∂H1), ψ = swirl H1 H2 p: free of divergence, tangential to both axes, and
    zero without ``swirl``. So p is stationary with, in general, circulating probability.
    """

    def log_p(x, y):
        return -x - 1.5 * y - 0.3 * x * y

    def slope(H):
        return np.stack([-1.0 - 0.3 * H[:, 1], -1.5 - 0.3 * H[:, 0]], axis=1)

    def diffusion(H):
        x, y = H.T
        b = np.empty((x.size, 2, 2))
        b[:, 0, 0], b[:, 1, 1] = 2.0 * x * (1.0 + 0.2 * y), 2.0 * y * (1.0 + 0.1 * x)
        b[:, 0, 1] = b[:, 1, 0] = cross * x * y / (1.0 + x + y)
        return b

    def divergence(H):
        x, y = H.T
        q = 1.0 + x + y
        first = 2.0 * (1.0 + 0.2 * y) + cross * x * (1.0 + x) / q**2
        second = 2.0 * (1.0 + 0.1 * x) + cross * y * (1.0 + y) / q**2
        return np.stack([first, second], axis=1)

    def drift(H):
        x, y = H.T
        g = slope(H)
        s = 0.5 * divergence(H) + 0.5 * np.einsum("nij,nj->ni", diffusion(H), g)
        s[:, 0] += swirl * x * (1.0 + y * g[:, 1])
        s[:, 1] -= swirl * y * (1.0 + x * g[:, 0])
        return s

    return process_of(drift, diffusion, divergence, (1.0, 0.7)), log_p


def l1_error(solution, log_p, *, beyond=1.5):
    """∫|p_h − p| as far as ``beyond`` times the mesh, p normalised by the same fine rule."""
    rules = [panel_rule(np.unique(np.append(x, beyond * x[-1])), 24) for x in solution.panels]
    (x, wx), (y, wy) = ((a.ravel(), w.ravel()) for a, w in rules)
    p = np.exp(log_p(x[:, None], y))
    p /= wx @ p @ wy
    return float(wx @ np.abs(solution.density(x[:, None], y) - p) @ wy)


def van_der_pol(gamma, alpha, cross, noise: tuple[float, float]):
    """s_i = d_i − (γ_i + α_i H_i + d_i cross H_j) H_i, b_ii = 2 d_i H_i: no flux, p in closed form.

    ``ln p = −Σ (γ_i H_i + ½ α_i H_i²)/d_i − cross H_1 H_2``; γ_i < 0 makes a ridge off the axis.
    """
    g, d = np.array(gamma), np.array(noise)
    coupling = np.diag(alpha) + cross * np.array([[0.0, d[0]], [d[1], 0.0]])
    own = np.array(alpha)
    scales = (np.sqrt(g**2 + 4.0 * own * d) - g) / (2.0 * own)

    def log_p(x, y):
        first, second = ((g[i] * H + 0.5 * own[i] * H**2) / d[i] for i, H in enumerate((x, y)))
        return -first - second - cross * x * y

    process = process_of(
        lambda H: d - (g + H @ coupling.T) * H,
        lambda H: 2.0 * d * H[:, :, None] * np.eye(2),
        lambda H: np.broadcast_to(2.0 * d, H.shape),
        (float(scales[0]), float(scales[1])),
    )
    return process, log_p


COUPLED = {
    "strong coupling": van_der_pol((0.1, 0.2), (0.1, 0.1), 10.0, (0.1, 0.1)),
    "Gibbs of H1 + H2": van_der_pol((0.05, 0.15), (0.03, 0.09), 0.3, (0.1, 0.3)),
    "ridge": van_der_pol((-0.3, 0.2), (0.3, 0.1), 10.0, (0.01, 0.01)),
    "one of two modes": van_der_pol((-0.2, -0.2), (0.2, 0.2), 13.0, (0.03, 0.03)),
}

ROUND_OFF = 1e-13
"""An error below is one of round-off, which the estimate need not be near."""


def assert_strictly_certified(solution):
    """Certified, and no value is below 0 by more than the stated error of p anywhere."""
    assert solution.certificate.certified, solution.certificate.failures
    x, y = (np.linspace(0.0, H[-1], 301) for H in solution.nodes)
    p = solution.density(x[:, None], y)
    allowed = 1e-14 + float(solution.pointwise_error(x[:, None], y).max() / p.max())
    assert min(solution.certificate.minimum, p.min() / p.max()) >= -allowed


def assert_within(solution, log_p, tol):
    """Strictly certified, and the true L1 error is at most the stated one, that at most ``tol``."""
    assert_strictly_certified(solution)
    error = l1_error(solution, log_p)
    assert error <= solution.l1_error <= tol
    return error


FIG8 = ((0.0511, 0.0689), (0.0155, 0.0145))
KNOWN = {
    "square roots": (square_root_process(*FIG8), lambda x, y: -x * 511 / 155 - y * 689 / 145),
    "product": manufactured(0.0, 0.0),
    "correlated": manufactured(0.4, 0.0),
    "circulating": manufactured(0.4, 0.2),
    **COUPLED,
}
QUICK = [("square roots", 1e-4), ("square roots", 1e-10), ("circulating", 1e-8)]
QUICK += [(name, 1e-9) for name in COUPLED]


@pytest.mark.parametrize(
    ("name", "tol"),
    [
        pytest.param(name, tol, marks=[] if (name, tol) in QUICK else pytest.mark.slow)
        for name in KNOWN
        for tol in (1e-4, 1e-8, 1e-9, 1e-10)
    ],
)
def test_known_densities_are_within_an_honest_estimate(name, tol):
    process, log_p = KNOWN[name]
    solution = solve_plane(process, tol=tol)
    error = assert_within(solution, log_p, tol)
    assert solution.l1_error <= 100.0 * error + ROUND_OFF
    assert solution.certificate.mass_defect < 1e-12
    if name in COUPLED:  # at most three times the unknowns of two uncoupled modes
        product = solve_plane(KNOWN["square roots"][0], tol=tol)
        assert solution.unknowns <= 3.0 * product.unknowns


def test_a_wrong_cross_diffusion_is_seen():
    process, _ = manufactured(0.4, 0.0)
    uncrossed, log_p = manufactured(0.0, 0.0)

    def coefficients(H):
        return uncrossed.coefficients(H)._replace(drift=process.coefficients(H).drift)

    wrong = replace(process, coefficients=coefficients)
    assert l1_error(solve_plane(wrong, tol=1e-5), log_p) > 1e-2


ANY = Weight(np.array([[0.0, 1.2], [0.8, 0.2]]), (1.0, 1.0))
"""Not that of the density: the order is that of u = p/w on even elements."""


@pytest.mark.parametrize(
    ("degree", "weight", "counts"),
    [
        (1, UNIT_WEIGHT, (16, 24, 36, 54)),
        (3, ANY, (8, 12, 18, 27)),
        pytest.param(2, UNIT_WEIGHT, (18, 27, 40, 60), marks=pytest.mark.slow),
        pytest.param(4, UNIT_WEIGHT, (12, 16, 22, 30), marks=pytest.mark.slow),
    ],
)
def test_observed_order_is_degree_plus_one(degree, weight, counts):
    # Without swirl no probability flows anywhere, so that p cut off at any far edges, where zero
    # flux is natural, is exact on the rest, and the error is that of the elements alone.
    process, log_p = manufactured(0.4, 0.0)
    errors = []
    for count in counts:
        nodes = (np.linspace(0.0, 5.0, count + 1), np.linspace(0.0, 4.0, count + 1))
        solution = solve_plane_on_mesh(process, nodes, degree, weight=weight)
        errors.append(l1_error(solution, log_p, beyond=1.0))
    orders = np.log(np.array(errors[:-1]) / errors[1:]) / np.log(np.divide(counts[1:], counts[:-1]))
    # Four levels; the finest error, 1e-9 or more, is far above round-off.
    assert_allclose(orders, degree + 1, atol=0.15)


def test_drift_outwards_is_not_certified_and_one_energy_is_refused():
    process = square_root_process((0.1, 0.1), (0.1, 0.1))
    within = process.coefficients
    process = replace(process, coefficients=lambda H: within(H)._replace(drift=0.1 + 0.1 * H))
    with pytest.raises(NotCertified, match="does not fall off along H1"):
        solve_plane(process)
    one = process_of(lambda H: -H, lambda H: H[:, :, None], np.ones_like, (1.0,))
    with pytest.raises(InvalidInput, match="two energies"):
        solve_plane(one)
