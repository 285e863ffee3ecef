"""Feller classes of the ends of one energy and of the edges of two, where they are known."""

from dataclasses import replace

import numpy as np
import pytest
from processes import by_hand, competing, cox_ingersoll_ross, process_of

from averaging.zero_flux import solve_by_quadrature
from fpk.numeric.errors import NotCertified
from fpk.solvers.line.stationary import solve_stationary
from fpk.solvers.plane.stationary import solve_plane
from fpk.system.ends import classify, require_confined


@pytest.mark.parametrize(
    "a, kind",
    # Square-root process with b = 2 d H: 0 is reached where 2 a/(2 d) < 1 (Feller).
    [(1.5, "entrance"), (1.0, "entrance"), (0.9, "regular"), (0.1, "regular"), (-0.5, "exit")],
)
@pytest.mark.parametrize("d", [0.2, 7.0])
def test_square_root_process_at_zero(a, kind, d):
    process = cox_ingersoll_ross(a=a * d, d=d) if a > 0 else by_hand(lambda H: -H, d=d, n=a)
    assert classify(process)[0].kind == kind


def test_no_drift_at_zero_is_an_exit_and_another_diffusion_is_not_classified():
    assert classify(by_hand(lambda H: -H, n=0.0))[0].kind == "exit"
    process = by_hand(lambda H: -H)

    def squared(energy):
        return process.coefficients(energy)._replace(diffusion=energy**2)

    assert classify(type(process)(squared, (1.0,), (), 1))[0].kind == "not classified"


@pytest.mark.parametrize(
    "power, sign, kind",
    # Left in finite time where ∫dH/|s| converges: s ~ −H^r with r > 1.
    [(1.0, -1.0, "natural"), (1.5, -1.0, "entrance"), (0.5, -1.0, "natural"),
     (1.0, 1.0, "not confining")],
)  # fmt: skip
def test_infinity(power, sign, kind):
    found = classify(by_hand(lambda H: sign * H**power))[1]
    assert found.kind == kind and found.end == "H = ∞"


def pair(start, power=1.0):
    """dH_1 = (start − (1 + H_2) H_1^power) dt + √(2 H_1) dB: 0 is reached where start < 1."""

    def drift(H):
        out = 1.0 - H
        out[:, 0] = start - (1.0 + H[:, 1]) * H[:, 0] ** power
        return out

    return process_of(
        drift,
        lambda H: 2.0 * H[:, :, None] * np.eye(2),
        lambda H: np.full(H.shape, 2.0),
        (1.0, 1.0),
    )


def outwards(process):
    within = process.coefficients
    return replace(process, coefficients=lambda H: within(H)._replace(drift=-within(H).drift))


@pytest.mark.parametrize(
    "process, energy, end, kind",
    [
        (pair(1.5), 0, 0, "entrance"),
        (pair(1.0), 0, 0, "entrance"),
        (pair(0.5), 0, 0, "regular"),
        (pair(-0.5), 0, 0, "exit"),
        (pair(-0.5), 1, 0, "entrance"),
        (pair(1.0), 0, 1, "natural"),
        (pair(1.0, 2.0), 0, 1, "entrance"),
        (outwards(pair(1.0)), 0, 1, "not confining"),
    ],
)
def test_the_edges_of_two_energies(process, energy, end, kind):
    assert classify(process, energy)[end].kind == kind


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
    for undamped in (by_hand(lambda H: 0.1 * H, d=d), by_hand(lambda H: 0.0 * H, d=d, n=2.0)):
        with pytest.raises(NotCertified, match="does not fall off"):
            solve_stationary(undamped)


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


def coupled(coupling, scales=(1.0, 1.0)):
    return competing([0.1, 0.1], coupling, [0.1, 0.1], scales)


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
            refuse(coupled(coupling))


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
    require_confined(coupled(coupling, scales))
