"""What averaging makes of the system without contacts, against the Gaussian and by simulation."""

import numpy as np
import pytest

from averaging import Linear, NonIntegrable
from cases.compare.doubt import rms_ratios
from fpk.answer.names import parse_observable
from fpk.numeric.errors import NotApplicable
from fpk.system.contact import Contact
from fpk.system.linear import natural_modes, stationary_covariance
from fpk.system.system import System
from sim import MonteCarlo


def frame(n, *, zeta=0.02, contacts=()):
    """Equal storeys on a shaken base, Rayleigh damping of ratio ``zeta`` in the first two modes."""
    ones = np.ones(n)
    bare = System(ones, ones, ones, ones)
    _, (first, second, *_) = natural_modes(bare)
    damping = 2.0 * zeta * (first * second * np.eye(n) + bare.stiffness_matrix) / (first + second)
    return System(ones, ones, damping, 0.01 * np.ones((n, n)), contacts=contacts)


def rms(method, system, name):
    (density,) = method.solve(system, [parse_observable(name, system.n)]).densities
    return density.rms()


def test_one_temperature_is_exact():
    """c/D is 4 for both masses: one temperature, by (8)."""
    system = System([1.0, 1.0], [1.0, 1.0], [0.08, 0.04], [0.02, 0.01])
    ratios, spread, damping = rms_ratios(system)
    assert [*ratios, spread] == pytest.approx([1.0] * 5, abs=1e-12)
    # Modes (1, φ) and (φ, -1) over √(1 + φ²) with φ = (1 + √5)/2 and ω = 1/φ, φ; c = 0.12, 0.04, 0.
    phi = (1.0 + 5.0**0.5) / 2.0
    first = (0.12 - 2.0 * 0.04 * phi + 0.04 * phi**2) / (1.0 + phi**2) / (2.0 / phi)
    second = (0.12 * phi**2 + 2.0 * 0.04 * phi + 0.04) / (1.0 + phi**2) / (2.0 * phi)
    assert damping == pytest.approx(max(first, second), rel=1e-12)


@pytest.mark.parametrize("n", [2, 5])
def test_the_ratio_is_that_of_the_two_methods(n):
    """Energy averaging of a shaken frame without contacts, over the Gaussian: 0.56 of 2, 0.20 of 5.

    Of light damping the ratio follows from the temperatures of the modes, which the load Σ_i φ_im
    of the base sets: θ_m = (Σ_i φ_im)² D/c_m.
    """
    system, name = frame(n), f"q{n}"
    ratios, spread, _ = rms_ratios(system)
    ratio = rms(NonIntegrable(), system, name).value / rms(Linear(), system, name).value
    assert ratios[n - 1] == pytest.approx(ratio, rel=1e-9) and ratio < 0.6
    shapes, omega = natural_modes(system)
    c = np.diag(shapes.T @ system.damping @ shapes)
    theta = shapes.sum(axis=0) ** 2 * 0.01 / c
    own = shapes[-1] ** 2 / omega**2
    expected = np.sqrt(0.01 * n / c.sum() * np.sum(own) / np.sum(theta * own))
    assert ratio == pytest.approx(expected, rel=0.01)
    assert spread == pytest.approx(theta.max() / theta.min(), rel=0.2)  # couplings are left out


def test_no_measure_where_it_would_mean_nothing():
    for system in (
        System([1.0], [1.0], [0.0], [0.1]),
        System([1.0, 1.0], [1.0, 1.0], [0.1, 0.1], [0.0, 0.0]),
    ):
        with pytest.raises(NotApplicable):
            rms_ratios(system)


@pytest.mark.slow
@pytest.mark.parametrize(("n", "stiffness", "clearance"), [
    (2, 10.0, 3.0), (2, 10.0, 1.0), (2, 1000.0, 1.0), (3, 10.0, 1.0), (3, 1000.0, 1.0),
])  # fmt: skip
def test_contacts_bring_averaging_nearer_but_not_near(n, stiffness, clearance):
    """Measured: between the ratio without contacts and 1, and still off by a factor.

    The roof of a frame beside a neighbour, ``clearance`` in rms without contact. With 3 rms 0.5563
    was measured where the system without contacts has 0.555.
    """
    scale = float(np.sqrt(stationary_covariance(frame(n))[n - 1, n - 1]))
    stop = Contact(
        mass=n, side="right", stiffness=stiffness / np.sqrt(scale), clearance=clearance * scale
    )
    system, name = frame(n, contacts=(stop,)), f"q{n}"
    sampled = rms(MonteCarlo(relaxations=20.0, seed=11), system, name)
    ratio = rms(NonIntegrable(), system, name).value / sampled.value
    error = 5.0 * sampled.error / sampled.value * ratio
    without = rms_ratios(system)[0][n - 1]
    assert without - error < ratio < 0.8
