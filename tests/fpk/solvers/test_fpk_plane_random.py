"""Random processes of two energies: the true L1 error is within the stated one, seed by seed."""

import numpy as np
import pytest
from test_fpk_plane import l1_error, manufactured, van_der_pol
from test_fpk_plane_weight import mixture

from fpk.answer.certificate import DISTANCE_FACTOR
from fpk.numeric.quadrature import panel_rule
from fpk.solvers.plane.stationary import solve_plane

LARGEST_RATIO = 2.1
"""Error over the distance to the enriched solution, named at ``DISTANCE_FACTOR``."""
ROUND_OFF = 2e-14
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


def assert_within(seeds):
    certified = 0
    for seed in seeds:
        process, log_p, tol = drawn(seed)
        solution = solve_plane(process, tol=tol)
        if solution.certificate.certified:
            certified += 1
            error = l1_error(solution, log_p) - ROUND_OFF
            assert error <= solution.l1_error <= tol, f"seed {seed}"
            assert error <= LARGEST_RATIO / DISTANCE_FACTOR * solution.l1_error, f"seed {seed}"
    assert certified >= 0.95 * len(seeds)


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
        missed = np.abs(solution.density(x, y) - p) - ROUND_OFF * p
        seen = p > 1e-14 * p.max()
        outside += np.count_nonzero(missed[seen] > solution.pointwise_error(x, y)[seen])
        count += np.count_nonzero(seen)
    assert count > 2e4 and outside < 1e-3 * count


# Of seed 2467, 20 and 22 points on two panels were both off by 3.5e-13, of one another by 1.1e-13.
@pytest.mark.parametrize("seeds", [range(10), range(2467, 2468)])
def test_random_densities_are_within_their_stated_error(seeds):
    assert_within(seeds)


@pytest.mark.slow
@pytest.mark.parametrize("first", range(0, 3000, 250))
def test_three_thousand_random_densities(first):
    assert_within(range(first, first + 250))
