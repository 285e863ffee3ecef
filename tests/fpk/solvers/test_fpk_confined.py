"""Far out: no certificate where nothing brings the energy back, none refused elsewhere."""

import numpy as np
import pytest
from processes import by_hand, process_of

from averaging.zero_flux import solve_by_quadrature
from fpk.numeric.errors import NotCertified
from fpk.solvers.line.stationary import solve_stationary
from fpk.solvers.plane.stationary import solve_plane
from fpk.system.ends import require_confined

WEAK_NOISE = 1e-6
"""So little that the bulk, at 1e-5, ends 5e5 times below the energy where damping turns around."""


def turning(first, second, third=0.0, *, d=WEAK_NOISE):
    """Damping γ(H) = first + second H + third H²."""
    scale = d / max(first, 1e-3)
    return by_hand(lambda H: -H * (first + H * (second + third * H)), d=d, scale=scale)


@pytest.mark.parametrize("solve", [solve_stationary, solve_by_quadrature])
@pytest.mark.parametrize("rate", [(0.1, -0.02), (0.1, 0.1, -1e-6), (0.1, 0.0, -1e-12)])
@pytest.mark.parametrize("d", [WEAK_NOISE, 1e-3])
def test_damping_that_turns_into_driving_far_out_is_refused(solve, rate, d):
    with pytest.raises(NotCertified, match="the drift points outwards"):
        solve(turning(*rate, d=d))


@pytest.mark.parametrize("d, resolved", [(1e-6, False), (1e-3, False), (0.1, True)])
def test_driving_in_between_makes_no_false_certificate(d, resolved):
    # γ < 0 between H = 1 and 10 only: nearly all of the mass is beyond, at 10, and a mesh of the
    # bulk near 0 would be all but empty. ln p = −(0.1/d) (H − 0.55 H² + H³/30).
    between = by_hand(lambda H: -0.1 * H * (1.0 - H) * (1.0 - 0.1 * H), d=d, scale=10.0 * d)
    solution = solve_stationary(between)
    assert solution.certificate.certified is resolved
    if resolved:
        low, high = solution.density(np.array([0.0, 10.0]))
        assert np.log(high / low) == pytest.approx(0.1 / d * (55.0 - 10.0 - 100.0 / 3.0), rel=1e-6)


@pytest.mark.parametrize("rate", [(0.1, 1e-9), (0.1, 0.1, 1e-6), (-0.1, 0.1), (0.1, -0.02, 0.002)])
@pytest.mark.parametrize("d", [1e-3, 0.1])
def test_damping_that_holds_is_solved(rate, d):
    assert solve_stationary(turning(*rate, d=d), tol=1e-8).certificate.certified


def pair(coupling, scales=(1.0, 1.0)):
    """Two energies with the damping γ = 0.1 + coupling H and unit noise of each."""
    A = np.array(coupling)
    return process_of(
        lambda H: 0.1 - H * (0.1 + H @ A.T),
        lambda H: 0.2 * H[:, :, None] * np.eye(2),
        lambda H: np.full(H.shape, 0.2),
        scales,
    )


@pytest.mark.parametrize(
    "coupling",
    [
        [[-1e-9, 0.0], [0.0, 0.1]],
        [[1.0, -2.0], [-2.0, 1.0]],  # outwards on the ray H1 = H2 alone, which attracts
        [[0.0, -1e-5], [-1e-5, 0.0]],
    ],
)
def test_two_energies_that_leave_for_infinity_are_refused(coupling):
    for refuse in (require_confined, solve_plane):
        with pytest.raises(NotCertified, match="does not fall off"):
            refuse(pair(coupling))


@pytest.mark.parametrize(
    "coupling",
    [
        [[0.0, 0.0], [0.0, 0.0]],
        [[1.0, -0.5], [-0.5, 1.0]],
        [[0.1, -3.0], [3.0, 0.1]],  # each energy gains as much as the other loses
        [[0.1, -3.0], [0.03, 0.1]],  # ... a hundred times less: Σ H_i/θ_i rises on some rays
        [[1.0, 1.0], [1e-6, 1e-6]],
    ],
)
@pytest.mark.parametrize("scales", [(1.0, 1.0), (1.0, 0.05)])
def test_two_energies_that_come_back_are_not_refused(coupling, scales):
    require_confined(pair(coupling, scales))
