"""Energy shells: one, two and three contact masses against independent integrals and limits."""

import numpy as np
import pytest
from averaging_systems import SKEW, TWO_MASSES, both, chain, fig6, integral, shell_integral
from scipy.integrate import quad
from scipy.optimize import brentq, minimize_scalar
from scipy.special import betainc

from averaging.shell.averages import log_linear_states, shell_averages
from averaging.shell.rays import EnergyShell
from fpk.system.contact import Contact
from fpk.system.system import System

LAWS = {"hertz": (None, 1.5), "bilinear": (None, 1.0), "power": (1.3, 1.3)}
REFERENCE = 1e-14
"""Error of the independent quadrature, asked for at 1e-13; 1e-15 against 30 digits (mpmath)."""


def ratios(system, energy):
    return shell_averages(system, np.atleast_1d(np.asarray(energy, dtype=float)))


def one_mass(n, side, stiffness, law, clearance=0.5):
    """A chain with contact of its last mass, and the same stops as (δ, B, e) left and right."""
    given, e = LAWS[law]
    left = right = None
    contacts = []
    if side in ("both", "right", "skew"):
        contacts.append(Contact(n, "right", stiffness, clearance, law, given))
        right = (clearance, stiffness, e)
    if side in ("both", "skew"):
        more = 1.0 if side == "both" else 1.7
        contacts.append(Contact(n, "left", stiffness, more * clearance, law, given))
        left = (more * clearance, stiffness, e)
    return chain(n, tuple(contacts)), (left, right)


def independent_ratios(n, stops, energy):
    k, a = 1.0 / n, n - 1.5
    free = (None, None)

    def ratio(H, exponent):
        return shell_integral(k, stops, H, exponent) / shell_integral(k, free, H, exponent)

    states, volume = ratio(energy, a), ratio(energy, a + 1.0)
    if n > 1:
        slope = energy * a * shell_integral(k, stops, energy, a - 1.0)
        return states, volume, slope / shell_integral(k, stops, energy, a)
    # Central difference of eighth order in ln H.
    weights = np.array([4.0 / 5.0, -1.0 / 5.0, 4.0 / 105.0, -1.0 / 280.0])
    h = 0.004
    log_states = [np.log(shell_integral(k, stops, energy * np.exp(j * h), a)) for j in (1, 2, 3, 4)]
    below = [np.log(shell_integral(k, stops, energy * np.exp(-j * h), a)) for j in (1, 2, 3, 4)]
    return states, volume, weights @ (np.array(log_states) - below) / h


@pytest.mark.parametrize("n", [1, 2, pytest.param(3, marks=pytest.mark.slow), 10])
@pytest.mark.parametrize("side", ["both", "right", "skew"])
@pytest.mark.parametrize(
    "stiffness, law",
    [
        *((B, "hertz") for B in (0.1, 1e8)),
        *((1e4, law) for law in ("bilinear", "power")),
        *(pytest.param(B, "hertz", marks=pytest.mark.slow) for B in (10.0, 1e4)),
        *(pytest.param(0.1, law, marks=pytest.mark.slow) for law in ("bilinear", "power")),
    ],
)
def test_one_contact_mass_against_scipy(n, side, stiffness, law):
    system, stops = one_mass(n, side, stiffness, law)
    contact_energy = 0.125 / n
    assert system.fact(EnergyShell).contact_energies[0] == pytest.approx(contact_energy, rel=1e-14)
    energies = contact_energy * np.array([1.0 + 1e-9, 1.3, 2.0, 4.0, 30.0, 1e4])
    found = ratios(system, energies)
    for i, energy in enumerate(energies):
        states, volume, slope = independent_ratios(n, stops, energy)
        for name, value, expected in (
            ("states", found.states[i], states),
            ("volume", found.volume[i], volume),
        ):
            assert value == pytest.approx(expected, rel=1e-12), name
            assert abs(value / expected - 1.0) <= found.error[i] + REFERENCE
        if n > 1:
            assert found.log_slope[i] == pytest.approx(slope, rel=1e-10)
            assert found.error[i] < 1e-10
        elif i >= 2:
            # T is not smooth at contact, where the difference quotient would reach across. The
            # slope of a period is a difference of two integrals, and nothing certified rests on
            # it: no error is stated, the largest here is 1.4e-9.
            assert abs(found.log_slope[i] - slope) <= 5e-9


def test_a_clearance_off_by_a_percent_is_seen():
    system, _ = one_mass(2, "both", 10.0, "hertz", clearance=0.505)
    _, stops = one_mass(2, "both", 10.0, "hertz")
    with pytest.raises(AssertionError):
        assert ratios(system, 0.2).states[0] == pytest.approx(
            independent_ratios(2, stops, 0.2)[0], rel=1e-3
        )


@pytest.mark.parametrize("n", [1, 2, 5])
def test_below_contact_the_ratios_are_exactly_one(n):
    system, _ = one_mass(n, "skew", 10.0, "hertz")
    below = ratios(system, 0.125 / n * np.array([1e-300, 1e-9, 0.5, 1.0 - 1e-12]))
    for part in (below.states, below.volume):
        assert np.all(part == 1.0)
    assert np.all(below.log_slope == n - 1.0) and np.all(below.error == 0.0)
    assert ratios(system, 0.125 / n * 1.5).states[0] < 1.0


def two_mass_states(system, energy):
    """Area {V < H} and ∫(H − V)₊ over q1, q2 by scipy, with turning points from min over q1."""
    k1, k2 = map(float, system.stiffness)
    stops = [
        (stop.index, 1.0 if stop.side == "right" else -1.0, stop.clearance, stop)
        for stop in system.stops
    ]

    def potential(x, y):
        total = 0.5 * k1 * x * x + 0.5 * k2 * (y - x) ** 2
        for mass, sign, clearance, stop in stops:
            overlap = sign * (y if mass else x) - clearance
            if overlap > 0.0:
                total += stop.stiffness / (stop.power + 1.0) * overlap ** (stop.power + 1.0)
        return total

    def lowest(y):
        found = minimize_scalar(lambda x: potential(x, y), bracket=(y - 1.0, y + 1.0))
        return found.x, found.fun

    def outer(sign):
        return brentq(lambda y: lowest(sign * y)[1] - energy, 1e-9, 10.0, xtol=1e-14) * sign

    def limits(y):
        bottom, value = lowest(y)
        if value >= energy:
            return bottom, bottom
        reach = 10.0
        return tuple(
            brentq(lambda x: potential(x, y) - energy, bottom, bottom + sign * reach)
            for sign in (-1.0, 1.0)
        )

    low, high = outer(-1.0), outer(1.0)
    middle, half = 0.5 * (low + high), 0.5 * (high - low)
    cuts = [stop.clearance * (1.0 if stop.side == "right" else -1.0) for stop in system.stops]

    def volume_at(y):
        a, b = limits(y)
        inside = sorted(c for c in cuts if a < c < b)
        return quad(
            lambda x: energy - potential(x, y), a, b, points=inside or None, epsabs=0.0, epsrel=1e-9
        )[0]

    def width(y):
        a, b = limits(y)
        return b - a

    results = []
    for part in (width, volume_at):
        # q2 = middle + half sin θ removes the roots at both ends.
        value, _ = quad(
            lambda t, f=part: f(middle + half * np.sin(t)) * half * np.cos(t),
            -0.5 * np.pi,
            0.5 * np.pi,
            epsabs=0.0,
            epsrel=1e-9,
            limit=200,
        )
        results.append(value)
    return results


@pytest.mark.parametrize(
    "contacts, energy", [(TWO_MASSES, 0.2), (TWO_MASSES, 0.9), (SKEW, 0.3), (SKEW, 1.5)]
)
def test_two_contact_masses_against_scipy(contacts, energy):
    system = System([1.0, 1.0], [1.0, 2.0], [0.1, 0.1], [0.1, 0.1], contacts=contacts)
    area, volume = two_mass_states(system, energy)
    # Without contact {V < H} is an ellipse: 2π H/√det K, and ∫(H − V) half of H times that.
    ellipse = 2.0 * np.pi * energy / np.sqrt(np.linalg.det(system.stiffness_matrix))
    found = ratios(system, energy)
    # scipy: 1e-9, cuts inside the outer integral not resolved to more than 1e-8.
    assert found.states[0] == pytest.approx(area / ellipse, rel=1e-8)
    assert found.volume[0] == pytest.approx(2.0 * volume / energy / ellipse, rel=1e-8)
    assert found.states[0] < 0.99


THREE = (Contact(1, "both", 5.0, 0.3), Contact(2, "both", 10.0, 0.5), Contact(3, "both", 8.0, 0.8))
CALCULUS = {
    "one": (fig6(both(10.0)), 1e-11),
    "one, n = 1": (chain(1, both(1e4, mass=0)), 1e-11),
    "one, n = 10": (chain(10, both(10.0, mass=4)), 1e-11),
    "one, stiff": (fig6(both(1e8)), 1e-11),
    "two": (fig6(TWO_MASSES), 1e-10),
    "two, skew": (fig6(SKEW), 1e-10),
    "two of five": (chain(5, (Contact(2, "both", 1e3, 0.3), Contact(5, "right", 9.0, 0.5))), 1e-10),
    "three": (chain(3, THREE), 1e-6),
}


def calculus_defects(system, low, high, *, points):
    """Relative defects of Φ' = T and of (ln T)' = log_slope/H, integrated over one panel."""
    n = system.n
    x, w = np.polynomial.legendre.leggauss(points)
    energy = np.concatenate([0.5 * (low + high) + 0.5 * (high - low) * x, [low, high]])
    w = 0.5 * (high - low) * w
    r = ratios(system, energy)
    T, phase_volume = r.states * energy ** (n - 1), r.volume * energy**n / n
    first = w @ T[:-2] / (phase_volume[-1] - phase_volume[-2]) - 1.0
    second = w @ (r.log_slope / energy)[:-2] - np.log(T[-1] / T[-2])
    return abs(first), abs(second)


@pytest.mark.parametrize(
    "name", [pytest.param(k, marks=[pytest.mark.slow] if k == "three" else []) for k in CALCULUS]
)
def test_states_are_the_slope_of_the_phase_volume(name):
    system, tol = CALCULUS[name]
    begins = system.fact(EnergyShell).contact_energies
    assert begins
    # Two smooth pieces: high above the last contact energy, and (where there is room) below it.
    pieces = [(1.5 * begins[-1], 1.8 * begins[-1]), (6.0 * begins[-1], 7.0 * begins[-1])]
    for low, high in pieces[: 1 if name == "three" else 2]:
        # Cubature over a sphere takes seconds: four points there, exact to degree 7.
        points = 16 if tol < 1e-6 else 4
        assert max(calculus_defects(system, low, high, points=points)) < tol


def test_the_calculus_sees_a_wrong_power_of_the_energy():
    system, tol = CALCULUS["one"]
    r = ratios(system, [0.2, 0.21])
    assert abs(np.log(r.states[1] / r.states[0]) / np.log(1.05) - r.log_slope.mean()) > 1e3 * tol


def test_three_masses_of_which_one_is_out_of_reach_are_two():
    far = Contact(3, "both", 8.0, 50.0)
    energies = np.array([0.3])
    three, two = (ratios(chain(3, c), energies) for c in ((*THREE[:2], far), THREE[:2]))
    for a, b in ((three.states, two.states), (three.volume, two.volume)):
        np.testing.assert_allclose(a, b, rtol=1e-6)
        assert np.all(np.abs(a / b - 1.0) <= three.error + two.error)
    assert ratios(chain(3, THREE[:1]), energies).states[0] > 1.01 * two.states[0]


def test_three_masses_held_rigidly_apart_do_not_matter_where_they_cannot_touch():
    system = chain(3, THREE)
    lowest = system.fact(EnergyShell).contact_energies[0]
    assert np.all(ratios(system, lowest * np.array([0.1, 0.99])).states == 1.0)


@pytest.mark.parametrize("n", [1, 2, 3, 10])
@pytest.mark.parametrize("side", ["both", "right"])
def test_stiff_contact_tends_to_the_rigid_stop(n, side):
    # |q| <= δ (or q <= δ) only: T/T_lin = I_{k δ²/2H}(½, n − ½), or half of one more. The overlap
    # (5H/2B)^(2/5) makes the distance fall as B^(−2/5).
    energy = 3.0 * 0.125 / n
    share = betainc(0.5, n - 0.5, 1.0 / 3.0)
    limit = share if side == "both" else 0.5 + 0.5 * share
    stiffness = 10.0 ** np.array([10.0, 12.0, 14.0, 16.0])
    distance = [
        ratios(one_mass(n, side, B, "hertz")[0], energy).states[0] - limit for B in stiffness
    ]
    assert np.all(np.array(distance) > 0.0)
    order = -np.diff(np.log(distance)) / np.diff(np.log(stiffness))
    # The next term of the expansion is B^(−4/5), 1e-4 relative here and falling.
    np.testing.assert_allclose(order, 0.4, atol=0.002)
    assert distance[-1] < 1e-5


@pytest.mark.parametrize("n", [1, 2, 10])
def test_soft_contact_tends_to_none(n):
    # First order in B.
    energy = 3.0 * 0.125 / n
    stiffness = 10.0 ** np.array([-3.0, -4.0, -5.0, -6.0])
    distance = [
        1.0 - ratios(one_mass(n, "both", B, "hertz")[0], energy).states[0] for B in stiffness
    ]
    order = np.diff(np.log(distance)) / np.diff(np.log(stiffness))
    np.testing.assert_allclose(order, 1.0, atol=0.002)


def test_a_mirrored_system_has_the_same_shells():
    mirrored = {"left": "right", "right": "left", "both": "both"}
    energies = np.array([0.1, 0.3, 2.0])
    for contacts in (SKEW, (Contact(2, "left", 10.0, 0.5),), TWO_MASSES):
        turned = tuple(
            Contact(c.mass, mirrored[c.side], c.stiffness, c.clearance, c.law) for c in contacts
        )
        a, b = ratios(fig6(contacts), energies), ratios(fig6(turned), energies)
        np.testing.assert_allclose(a.states, b.states, rtol=1e-12)
        np.testing.assert_allclose(a.volume, b.volume, rtol=1e-12)


@pytest.mark.parametrize("mass", [(1.0, 1.0), (0.5, 3.0)])
def test_linear_density_of_states_counts_phase_space(mass):
    # n = 2: Φ = volume of the 4-ball (π²/2) R⁴, R² = 2H, over √(det K/Π m); T = Φ'.
    system = fig6(mass=mass)
    energy = np.array([0.3, 2.0])
    expected = 4.0 * np.pi**2 * energy * np.sqrt(np.prod(mass) / np.prod(system.stiffness))
    np.testing.assert_allclose(np.exp(log_linear_states(system, energy)), expected, rtol=1e-14)
    # n = 1: the period.
    one = System([2.0], [3.0], [0.1], [0.1])
    period = 2.0 * np.pi * np.sqrt(2.0 / 3.0)
    assert np.exp(log_linear_states(one, energy)[0]) == pytest.approx(period, rel=1e-14)
    above = integral(lambda x: np.exp(log_linear_states(system, x)), [0.0, 2.0])
    assert above == pytest.approx(expected[1], rel=1e-13)  # Φ(2) = T(2)·2/2


def test_two_contact_masses_of_which_one_touches_from_rest():
    # Of a stop without clearance the springs alone end the shell where it is just touched: there
    # the search for that point began on the root itself, and found it or not by a rounding.
    contacts = (
        Contact(1, "left", 2.5, 0.6, law="power", exponent=1.0),
        Contact(2, "right", 0.9, 0.0),
    )
    system = System([1.0, 1.0], [1.0, 1.0], [0.1, 0.1], [0.1, 0.1], contacts=contacts)
    energy = np.geomspace(0.01, 4.0, 200)
    ratios = shell_averages(system, energy)
    # The phase volume of two masses is ∝ ∫(H − V) dq; a smooth integrand, but for its edge.
    side = np.sqrt(2.0 * energy[-1] / 0.38) * np.linspace(-1.0, 1.0, 601)
    q = np.stack(np.meshgrid(side, side, indexing="ij"), axis=-1)
    V = system.potential(q)
    free = 0.5 * np.einsum("...i,ij,...j->...", q, system.stiffness_matrix, q)
    for k in (60, 100, 140, 199):
        H = energy[k]
        area, of_free = (np.sum(np.maximum(H - x, 0.0)) for x in (V, free))
        assert ratios.volume[k] == pytest.approx(area / of_free, rel=5e-3)
    assert np.all(np.abs(np.diff(ratios.states)) < 0.02)


@pytest.mark.parametrize("more", [(), (Contact(1, "left", 1.0, 0.0),)], ids=["gaps", "none"])
def test_a_contact_energy_far_below_the_next_is_resolved(more):
    """Just above H_c T changes over H_c itself, 1e-8 of the panel up to the next contact energy."""
    stops = [Contact(mass, "right", 1e4, gap, law="power", exponent=1.0)
             for mass, gap in ((1, 0.5), (2, 1e-4))]  # fmt: skip
    system = System([1.0, 1.0], [1.0, 1.0], [0.1, 0.1], [0.02, 0.03], contacts=(*stops, *more))
    first, *_, last = [H for H in system.fact(EnergyShell).contact_energies if H > 0.0]
    assert first < 1e-7 * last
    energy = first * np.geomspace(1.001, 100.0, 40)  # so many at once are asked of the table
    averages = shell_averages(system, energy)
    assert np.max(averages.error) < 1e-10
    alone = [shell_averages(system, np.array([H])).states[0] for H in energy[::13]]
    np.testing.assert_allclose(averages.states[::13], alone, rtol=1e-10)


def test_numbers_of_contacts_that_are_no_floats():
    energy = np.array([0.8, 1.5, 4.0])
    contact = Contact(2, "right", 10**25, 1, law="power", exponent=2)
    same = Contact(2, "right", 1e25, 1.0, law="power", exponent=2.0)
    whole, floats = (
        shell_averages(
            System([1.0, 1.0], [1.0, 1.0], [0.1, 0.1], [0.02, 0.03], contacts=(c,)), energy
        )
        for c in (contact, same)
    )
    assert np.all(whole.states == floats.states) and np.all(whole.states < 1.0)
