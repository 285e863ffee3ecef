"""Feller classes of the ends of one energy and of the edges of two, where they are known."""

from dataclasses import replace

import numpy as np
import pytest
from processes import by_hand, cox_ingersoll_ross, process_of
from systems import both, fig6

from averaging.energy_process import energy_process
from fpk.system.ends import classify


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


@pytest.mark.parametrize("n, contact", [(1, True), (2, False), (5, True)])
def test_averaged_processes_enter_at_zero_and_never_reach_infinity(n, contact):
    # σ² ~ (2 D_Σ/n) H and s(0) = D_Σ: κ = n >= 1.
    lower, upper = classify(energy_process(fig6(both(10.0, mass=n) if contact else (), n=n)))
    assert lower.kind == "entrance" and f"→ {n}" in lower.reason
    assert upper.kind == "natural"


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


@pytest.mark.parametrize(
    "start, kind", [(1.5, "entrance"), (1.0, "entrance"), (0.5, "regular"), (-0.5, "exit")]
)
def test_the_edge_of_two_energies_at_zero(start, kind):
    assert classify(pair(start), 0)[0].kind == kind
    assert classify(pair(start), 1)[0].kind == "entrance"


def test_the_edge_of_two_energies_at_infinity():
    assert classify(pair(1.0, 1.0), 0)[1].kind == "natural"
    assert classify(pair(1.0, 2.0), 0)[1].kind == "entrance"
    growing = pair(1.0)

    def outwards(H):
        c = growing.coefficients(H)
        return c._replace(drift=-c.drift)

    assert classify(replace(growing, coefficients=outwards), 0)[1].kind == "not confining"
