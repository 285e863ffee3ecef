"""The two-dimensional solver against (34), against manufactured problems, and its orders."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from processes import competing, process_of

from fpk.answer.certificate import DISTANCE_FACTOR
from fpk.numeric.quadrature import panel_rule
from fpk.solvers.operator import solve_by_scikit_fem
from fpk.solvers.plane.solution import solve_plane_on_mesh
from fpk.solvers.plane.stationary import solve_plane
from fpk.solvers.plane.weight import UNIT_WEIGHT, Weight


def square_root_process(c, d):
    """Two independent CIR processes, (33) with unit modal masses: ln p = −Σ c_i H_i/d_i."""
    return competing(c, np.zeros((2, 2)), d, tuple(np.divide(d, c)))


def constructed(log_p, slope, diffusion, divergence, swirl, scales):
    """The process with the stationary density p, ∇ ln p = ``slope``, and its ln p.

    J = (∂ψ/∂H2, −∂ψ/∂H1), ψ = swirl H1 H2 p: free of divergence, tangential to both axes, and zero
    without ``swirl``.
    """

    def drift(H):
        g = slope(H)
        s = 0.5 * divergence(H) + 0.5 * np.einsum("nij,nj->ni", diffusion(H), g)
        turned = np.stack([H[:, 0], -H[:, 1]], axis=1) * (1.0 + (H * g)[:, ::-1])
        return s + swirl * turned

    return process_of(drift, diffusion, divergence, scales), log_p


def manufactured(cross, swirl):
    """The density exp(−H1 − 1.5 H2 − 0.3 H1 H2); b depends on both energies; b_12 ~ ``cross``."""

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

    return constructed(log_p, slope, diffusion, divergence, swirl, (1.0, 0.7))


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

    return competing(g, coupling, d, tuple(scales)), log_p


def mixture(
    shares=(0.6, 0.4), means=((1.0, 0.5), (0.4, 1.25)), noise=(1.0, 0.5), common=0.25, swirl=0.3
):
    """Full diffusion diag(2 d_i H_i) + 2 κ H Hᵀ, with p a mixture of exponentials.

    One energy is large or the other: ln p is no polynomial.
    """
    d, slopes = np.array(noise), -1.0 / np.array(means)
    heights = np.log(np.array(shares) * slopes.prod(axis=1))

    def log_p(x, y):
        parts = heights + np.stack(np.broadcast_arrays(x, y), axis=-1) @ slopes.T
        return np.asarray(np.logaddexp.reduce(parts, axis=-1))

    def diffusion(H):
        return 2.0 * (d * H)[:, :, None] * np.eye(2) + 2.0 * common * H[:, :, None] * H[:, None]

    def divergence(H):
        return 2.0 * d + 6.0 * common * H

    def slope(H):
        parts = heights + H @ slopes.T
        return np.exp(parts - np.logaddexp.reduce(parts, axis=1)[:, None]) @ slopes

    scales = tuple(np.array(shares) @ np.array(means))
    return constructed(log_p, slope, diffusion, divergence, swirl, scales)


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
    "no potential": manufactured(0.4, 1.0),
    **COUPLED,
}
QUICK = [("square roots", 1e-4), ("square roots", 1e-10), ("circulating", 1e-8)]
QUICK += [("no potential", 1e-6)]


@pytest.mark.parametrize(
    ("name", "tol"),
    [
        *QUICK,
        *((name, 1e-9) for name in COUPLED),
        *(pytest.param(name, 1e-10, marks=pytest.mark.slow) for name in KNOWN),
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


def test_scikit_fem_gives_the_density_of_two_energies():
    process, log_p = KNOWN["correlated"]
    assert_within(solve_by_scikit_fem(process, tol=1e-4), log_p, 1e-4)


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


LARGEST_RATIO = 2.1
"""Error over the distance to the enriched solution, named at ``DISTANCE_FACTOR``."""
MASS_ROUND_OFF = 2e-14
"""Round-off of the reference's own mass."""


def drawn(seed):
    """A mixture of exponentials, a manufactured or a van der Pol density, and a tolerance."""
    rng = np.random.default_rng(seed)
    tol = 10.0 ** rng.integers(-11, -2)
    kind = rng.integers(3)
    if kind == 0:
        count = int(rng.integers(2, 4))
        shares = rng.dirichlet(2.0 * np.ones(count)).tolist()
        means = np.exp(rng.normal(0.0, 0.5, (count, 2))).tolist()
        first, second = np.exp(rng.normal(0.0, 0.4, 2)).tolist()
        common, swirl = float(rng.choice([0.0, 0.25])), float(rng.choice([0.0, 0.05, 0.3]))
        return *mixture(shares, means, (first, second), common, swirl), tol
    if kind == 1:
        return *manufactured(rng.uniform(-0.5, 0.5), 10.0 ** rng.uniform(-9.0, 0.0)), tol
    pairs = rng.uniform(-0.3, 0.3, 2), rng.uniform(0.03, 0.3, 2), 10.0 ** rng.uniform(-2, -0.5, 2)
    (g1, g2), (a1, a2), (d1, d2) = (pair.tolist() for pair in pairs)
    return *van_der_pol((g1, g2), (a1, a2), rng.uniform(0.0, 14.0), (d1, d2)), tol


def test_errors_at_points_hold_where_the_distance_vanishes():
    """.06 % of the points of 300 seeds are outside; by the distance at a point alone 2.7 %."""
    outside, count = 0, 0
    for seed in range(16):
        process, log_p, tol = drawn(seed)
        solution = solve_plane(process, tol=tol)
        if not solution.certificate.certified:
            continue
        rng = np.random.default_rng(1000 + seed)
        x, y = (nodes[-1] * rng.uniform(0.0, 1.0, 3000) ** 2 for nodes in solution.nodes)
        rules = [panel_rule(np.append(nodes, 1.5 * nodes[-1]), 24) for nodes in solution.panels]
        (a, wa), (b, wb) = ((t.ravel(), w.ravel()) for t, w in rules)
        p = np.exp(log_p(x, y)) / (wa @ np.exp(log_p(a[:, None], b)) @ wb)
        missed = np.abs(solution.density(x, y) - p) - MASS_ROUND_OFF * p
        seen = p > 1e-14 * p.max()
        outside += np.count_nonzero(missed[seen] > solution.pointwise_error(x, y)[seen])
        count += np.count_nonzero(seen)
    assert count > 2e4 and outside < 1e-3 * count


# Of seed 2467, 20 and 22 points on two panels were both off by 3.5e-13, of one another by 1.1e-13.
@pytest.mark.parametrize(
    "seeds",
    [
        range(10),
        range(2467, 2468),
        *(pytest.param(range(k, k + 250), marks=pytest.mark.slow) for k in range(0, 3000, 250)),
    ],
)
def test_random_densities_are_within_their_stated_error(seeds):
    certified = 0
    for seed in seeds:
        process, log_p, tol = drawn(seed)
        solution = solve_plane(process, tol=tol)
        if solution.certificate.certified:
            certified += 1
            error = l1_error(solution, log_p) - MASS_ROUND_OFF
            assert error <= solution.l1_error <= tol, f"seed {seed}"
            assert error <= LARGEST_RATIO / DISTANCE_FACTOR * solution.l1_error, f"seed {seed}"
    assert certified >= 0.95 * len(seeds)
