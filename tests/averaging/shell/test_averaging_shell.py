"""Energy shells: one, two and three contact masses against independent integrals and limits."""

from itertools import pairwise
from math import factorial

import numpy as np
import pytest
from asked import solved
from scipy.optimize import brentq
from scipy.special import beta
from systems import SKEW, both, chain, fig6

from averaging.nonintegrable import NonIntegrable
from averaging.shell.averages import log_linear_states, shell_averages
from averaging.shell.rays import EnergyShell
from fpk import Contact, System
from fpk.answer.density import l1_distance
from fpk.numeric.quadrature import gauss_legendre, panel_rule


def ratios(system, energy):
    return shell_averages(system, np.atleast_1d(np.asarray(energy, dtype=float)))


@pytest.mark.parametrize("n", [1, 2, 5])
def test_below_contact_the_ratios_are_exactly_one(n):
    system = chain(n, both(10.0, mass=n))
    below = ratios(system, 0.125 / n * np.array([1e-300, 1e-9, 0.5, 1.0 - 1e-12]))
    for part in (below.states, below.volume):
        assert np.all(part == 1.0)
    assert np.all(below.log_slope == n - 1.0) and np.all(below.error == 0.0)
    assert ratios(system, 0.125 / n * 1.5).states[0] < 1.0


@pytest.mark.parametrize("n", [1, 3, 10])
def test_without_contact_the_states_are_those_of_an_ellipsoid(n):
    # The volume of a ball of 2n dimensions is π^n/n! r^2n, and H = ½ r²: T = dΦ/dH.
    system, H = fig6(n=n, mass=np.linspace(0.5, 3.0, n)), 0.7
    axes = np.prod(system.mass) / np.linalg.det(system.stiffness_matrix)
    volume = (2.0 * np.pi * H) ** n / factorial(n) * np.sqrt(axes)
    assert log_linear_states(system, H) == pytest.approx(np.log(n * volume / H), rel=1e-12)


THREE = (Contact(1, "both", 5.0, 0.3), Contact(2, "both", 10.0, 0.5), Contact(3, "both", 8.0, 0.8))
CALCULUS = {
    "two, skew": (fig6(SKEW), 1e-10),
    "two of five": (chain(5, (Contact(2, "both", 1e3, 0.3), Contact(5, "right", 9.0, 0.5))), 1e-10),
    "three": (chain(3, THREE), 1e-6),
}


@pytest.mark.parametrize(
    "name", [pytest.param(k, marks=[pytest.mark.slow] if k == "three" else []) for k in CALCULUS]
)
def test_states_are_the_slope_of_the_phase_volume(name):
    (system, tol), n = CALCULUS[name], CALCULUS[name][0].n
    begins = system.fact(EnergyShell).contact_energies
    assert begins
    # Two smooth pieces: high above the last contact energy, and (where there is room) below it.
    pieces = [(1.5 * begins[-1], 1.8 * begins[-1]), (6.0 * begins[-1], 7.0 * begins[-1])]
    for low, high in pieces[: 1 if name == "three" else 2]:
        # Cubature over a sphere takes seconds: four points there, exact to degree 7.
        x, w = panel_rule(np.array([low, high]), 16 if tol < 1e-6 else 4)
        energy = np.append(x, [low, high])
        r = ratios(system, energy)
        T, phase_volume = r.states * energy ** (n - 1), r.volume * energy**n / n
        # Φ' = T and (ln T)' = log_slope/H, integrated.
        assert abs(w.ravel() @ T[:-2] / np.diff(phase_volume)[-1] - 1.0) < tol
        rise = w.ravel() @ (r.log_slope / energy)[:-2]
        assert abs(rise - np.log(T[-1] / T[-2])) < tol


def test_two_contact_masses_of_which_one_touches_from_rest():
    # A stop without clearance: the search for the end of the shell begins on the root itself.
    def averages(gap):
        stops = Contact(1, "left", 2.5, 0.6, "power", 1.0), Contact(2, "right", 0.9, gap)
        return ratios(fig6(stops), np.geomspace(0.01, 4.0, 50))

    none, hardly = averages(0.0), averages(1e-9)
    np.testing.assert_allclose(none.volume, hardly.volume, rtol=1e-7)
    np.testing.assert_allclose(none.states, hardly.states, rtol=1e-7)
    assert np.all(none.error < 1e-9)


@pytest.mark.parametrize("more", [(), (Contact(1, "left", 1.0, 0.0),)], ids=["gaps", "none"])
def test_a_contact_energy_far_below_the_next_is_resolved(more):
    """Just above H_c T changes over H_c itself, 1e-8 of the panel up to the next contact energy."""
    stops = [Contact(m, "right", 1e4, gap, "power", 1.0) for m, gap in ((1, 0.5), (2, 1e-4))]
    system = System([1.0, 1.0], [1.0, 1.0], [0.1, 0.1], [0.02, 0.03], contacts=(*stops, *more))
    first, *_, last = [H for H in system.fact(EnergyShell).contact_energies if H > 0.0]
    assert first < 1e-7 * last
    energy = first * np.geomspace(1.001, 100.0, 40)  # so many at once are asked of the table
    averages = shell_averages(system, energy)
    assert np.max(averages.error) < 1e-10
    alone = [shell_averages(system, np.array([H])).states[0] for H in energy[::13]]
    np.testing.assert_allclose(averages.states[::13], alone, rtol=1e-10)


STOPS = {
    "both": (Contact(1, "both", 10.0, 0.5),),
    "stiff": (Contact(1, "right", 1e8, 0.5),),
    "all but rigid": (Contact(1, "both", 1e16, 0.5),),
    "all but absent": (Contact(1, "right", 1e-6, 0.5),),
    "skew": (Contact(1, "right", 10.0, 0.5), Contact(1, "left", 3.0, 0.8)),
    "two on a side": (Contact(1, "right", 10.0, 0.5), Contact(1, "right", 50.0, 0.8)),
    "power": (Contact(1, "left", 2.0, 0.4, "power", 2.2),),
    "bilinear": (Contact(1, "both", 50.0, 0.6, "bilinear"),),
    "no clearance": (Contact(1, "both", 10.0, 0.0),),
}


@pytest.mark.parametrize("n", [1, 2, 10])
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
@pytest.mark.parametrize("apart", [1e-12, 1e-9])
def test_contact_energies_that_nearly_coincide_cost_no_accuracy(n, apart):
    """Between them T of one mass is known to √apart only, where there is next to no mass."""
    stops = tuple(Contact(n, side, 10.0, c) for side, c in (("right", 0.5), ("left", 0.5 + apart)))
    system = chain(n, stops)
    (reference,) = solved(NonIntegrable("closed-form"), system, "H")
    for solver in ("quadrature", "fem"):
        (density,) = solved(NonIntegrable(solver), system, "H")
        assert density.certificate.certified, density.certificate.failures
        assert l1_distance(density, reference) <= density.l1_error + reference.l1_error
