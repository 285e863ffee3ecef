"""The compiled integrals along rays against plain NumPy on many points."""

from itertools import pairwise

import numpy as np
import pytest
from asked import solved
from scipy.optimize import brentq
from scipy.special import beta
from systems import chain

from averaging.nonintegrable import NonIntegrable
from averaging.shell.averages import shell_averages
from averaging.shell.rays import EnergyShell
from fpk.answer.density import l1_distance
from fpk.numeric.quadrature import gauss_legendre
from fpk.system.contact import Contact

STOPS = {
    "both": (Contact(1, "both", 10.0, 0.5),),
    "stiff": (Contact(1, "right", 1e8, 0.5),),
    "skew": (Contact(1, "right", 10.0, 0.5), Contact(1, "left", 3.0, 0.8)),
    "two on a side": (Contact(1, "right", 10.0, 0.5), Contact(1, "right", 50.0, 0.8)),
    "power": (Contact(1, "left", 2.0, 0.4, "power", 2.2),),
    "bilinear": (Contact(1, "both", 50.0, 0.6, "bilinear"),),
    "no clearance": (Contact(1, "both", 10.0, 0.0),),
}


@pytest.mark.parametrize(
    "n", [1, 2, 10, *(pytest.param(n, marks=pytest.mark.slow) for n in (3, 50))]
)
@pytest.mark.parametrize("stops", STOPS)
def test_equal_to_plain_quadrature(n, stops):
    system = chain(n, STOPS[stops])
    first = system.fact(EnergyShell).contact_energies[0]
    assert first == pytest.approx(0.5 / system.compliance[0, 0] * system.stops[0].clearance ** 2)
    energies = first + np.logspace(-2.0, 4.0, 13)
    ratios = shell_averages(system, energies)
    states, volume, slope = np.transpose([plain_ratios(system, H) for H in energies])
    # H − V of the plain sums cancels at the turning point: ε points² of T for n = 1.
    plain = 1e-9 if n == 1 else 1e-11
    assert np.all(np.abs(ratios.states / states - 1.0) <= ratios.error + plain)
    assert np.all(np.abs(ratios.volume / volume - 1.0) <= ratios.error + plain)
    if n > 1:
        change = np.abs(ratios.log_slope / slope - 1.0)
        assert np.all(change <= (1e-8 if n == 2 else plain))
    assert np.median(ratios.error) < 1e-12


def plain_ratios(system, H, points=240):
    """T/T_lin, Φ/Φ_lin and H T'/T of one contact mass, q = end ± length sin²φ between its stops."""
    n, mass = system.n, system.contact_masses[0]
    k, a = 1.0 / system.compliance[mass, mass], system.n - 1.5
    t, w = gauss_legendre(points)
    phi = 0.25 * np.pi * (1.0 + t)
    total = np.zeros(3)
    for side in ("right", "left"):
        here = [stop for stop in system.stops if stop.side == side]

        def potential(r, here=here):
            overlaps = ((s, np.maximum(r - s.clearance, 0.0)) for s in here)
            return 0.5 * k * r * r + sum(s.energy(x) for s, x in overlaps)

        R = brentq(lambda r: potential(r) / H - 1.0, 0.0, 1.1 * np.sqrt(2.0 * H / k), xtol=1e-300)
        cuts = sorted({0.0, R, *(s.clearance for s in here if s.clearance < R)})
        for low, high in pairwise(cuts):
            # sin² at both ends: half-integer powers at a stop, the root at the turning point.
            r = low + (high - low) * np.sin(phi) ** 2
            dr = (high - low) * np.sin(2.0 * phi) * 0.25 * np.pi * w
            v = 1.0 - potential(r) / H
            total += [dr @ v**a, dr @ v ** (a + 1.0), a * dr @ v ** (a - 1.0) if n > 1 else 0.0]
    unit = np.sqrt(2.0 * H / k)
    flat = unit * beta(0.5, a + 1.0), unit * beta(0.5, a + 2.0)
    return total[0] / flat[0], total[1] / flat[1], total[2] / total[0]


def test_a_high_power_overflows_nothing():
    # At the root that the springs alone would have, x^101 is beyond double precision.
    steep = chain(2, (Contact(2, "both", 1.0, 0.5, "power", 100.0),))
    rigid = chain(2, (Contact(2, "both", 1e12, 0.5),))
    found, stiff = (shell_averages(system, np.array([1e6])) for system in (steep, rigid))
    assert np.all(np.isfinite(found))
    # The mass turns where its overlap is (101 H)^(1/101) = 1.2, a stiff one at the stop, 0.5.
    assert 2.0 < found.states[0] / stiff.states[0] < 4.0


def test_just_beyond_a_second_stop_nothing_cancels():
    # The rise beyond the second stop is 1e-9 of the energy in the first one.
    system = chain(2, STOPS["two on a side"])
    second = system.fact(EnergyShell).contact_energies[1]
    above = shell_averages(system, second * (1.0 + np.logspace(-10.0, -6.0, 9)))
    # H T'/T is continuous there and changes by less than its slope of order ten.
    assert np.all(above[3] < 1e-11)
    assert np.ptp(above[2]) < 1e-4
    assert np.all(np.diff(above[0]) < 0.0)


@pytest.mark.parametrize("n", [1, 2])
@pytest.mark.parametrize(
    "apart", [1e-12, 1e-9, *(pytest.param(x, marks=pytest.mark.slow) for x in (1e-11, 1e-10, 1e-8))]
)
def test_contact_energies_that_nearly_coincide_cost_no_accuracy(n, apart):
    """Between them T of one mass is known to √apart only, where there is next to no mass."""
    stops = tuple(Contact(n, side, 10.0, c) for side, c in (("right", 0.5), ("left", 0.5 + apart)))
    system = chain(n, stops)
    (reference,) = solved(NonIntegrable("closed-form"), system, "H")
    for solver in ("quadrature", "fem"):
        (density,) = solved(NonIntegrable(solver), system, "H")
        assert density.certificate.certified, density.certificate.failures
        assert l1_distance(density, reference) <= density.l1_error + reference.l1_error
