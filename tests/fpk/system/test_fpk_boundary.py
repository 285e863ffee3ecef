"""Feller classes of the ends, against processes whose class is known."""

import pytest
from fpk_processes import both, by_hand, chain, cox_ingersoll_ross

from averaging.energy_process import energy_process
from fpk.system.ends import classify


@pytest.mark.parametrize(
    "a, kind",
    # Square-root process with b = 2 d H: 0 is reached where 2 a/(2 d) < 1 (Feller).
    [(1.5, "entrance"), (1.0, "entrance"), (0.9, "regular"), (0.1, "regular"), (-0.5, "exit")],
)
@pytest.mark.parametrize("d", [0.2, 1.0, 7.0])
def test_square_root_process_at_zero(a, kind, d):
    # Built directly: a <= 0 has no stationary density, but a class.
    process = cox_ingersoll_ross(a=a * d, d=d) if a > 0 else by_hand(lambda H: -H, d=d, n=a)
    assert classify(process)[0].kind == kind


def test_no_drift_at_zero_is_an_exit():
    assert classify(by_hand(lambda H: -H, n=0.0))[0].kind == "exit"


def test_a_diffusion_of_another_order_is_not_classified():
    process = by_hand(lambda H: -H)

    def squared(energy):
        c = process.coefficients(energy)
        return c._replace(diffusion=energy**2)

    assert classify(type(process)(squared, (1.0,), (), 1))[0].kind == "not classified"


@pytest.mark.parametrize(
    "dissipation, kind",
    [
        (lambda H: -H, "natural"),
        (lambda H: -(H**2), "entrance"),
        (lambda H: -(H**1.5), "entrance"),
        (lambda H: -(H**0.5), "natural"),
        (lambda H: +H, "not confining"),
    ],
)
def test_infinity(dissipation, kind):
    # Left in finite time where ∫dH/|s| converges: s ~ −H^r with r > 1.
    found = classify(by_hand(dissipation))[1]
    assert found.kind == kind and found.end == "H = ∞"


@pytest.mark.parametrize("n", [1, 2, 5])
@pytest.mark.parametrize("contact", [True, False])
def test_averaged_processes_enter_at_zero_and_never_reach_infinity(n, contact):
    # σ² ~ (2 D_Σ/n) H and s(0) = D_Σ: κ = n >= 1.
    system = chain(n, both(10.0, mass=n - 1) if contact else ())
    lower, upper = classify(energy_process(system))
    assert lower.kind == "entrance" and f"→ {n}" in lower.reason
    assert upper.kind == "natural"
