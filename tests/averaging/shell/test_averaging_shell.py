"""Energy shells: one, two and three contact masses against independent integrals and limits."""

import numpy as np
import pytest
from processes import integral
from scipy.special import betainc
from systems import SKEW, both, chain, fig6, mirrored

from averaging.shell.averages import log_linear_states, shell_averages
from averaging.shell.rays import EnergyShell
from fpk import Contact, System


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


THREE = (Contact(1, "both", 5.0, 0.3), Contact(2, "both", 10.0, 0.5), Contact(3, "both", 8.0, 0.8))
CALCULUS = {
    "one": (fig6(both(10.0)), 1e-11),
    "one, n = 1": (chain(1, both(1e4, mass=1)), 1e-11),
    "one, n = 10": (chain(10, both(10.0, mass=5)), 1e-11),
    "one, stiff": (fig6(both(1e8)), 1e-11),
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


def test_three_masses_of_which_one_is_out_of_reach_are_two():
    far, energies = Contact(3, "both", 8.0, 50.0), np.array([0.3])
    three, two = (ratios(chain(3, c), energies) for c in ((*THREE[:2], far), THREE[:2]))
    for a, b in ((three.states, two.states), (three.volume, two.volume)):
        np.testing.assert_allclose(a, b, rtol=1e-6)
        assert np.all(np.abs(a / b - 1.0) <= three.error + two.error)
    assert ratios(chain(3, THREE[:1]), energies).states[0] > 1.01 * two.states[0]
    lowest = chain(3, THREE).fact(EnergyShell).contact_energies[0]
    assert np.all(ratios(chain(3, THREE), lowest * np.array([0.1, 0.99])).states == 1.0)


@pytest.mark.parametrize("n", [1, 2, 10])
@pytest.mark.parametrize("side", ["both", "right"])
def test_stiff_contact_tends_to_the_rigid_stop_and_soft_contact_to_none(n, side):
    # |q| <= δ (or q <= δ) only: T/T_lin = I_{k δ²/2H}(½, n − ½), or half of one more. The overlap
    # (5H/2B)^(2/5) makes the distance fall as B^(−2/5).
    energy, share = 3.0 * 0.125 / n, betainc(0.5, n - 0.5, 1.0 / 3.0)
    limit = share if side == "both" else 0.5 + 0.5 * share

    def distances(stiffness, limit):
        systems = (chain(n, (Contact(n, side, B, 0.5),)) for B in stiffness)
        return np.array([ratios(system, energy).states[0] - limit for system in systems])

    stiff, soft = (
        10.0 ** np.array([10.0, 12.0, 14.0, 16.0]),
        10.0 ** -np.array([3.0, 4.0, 5.0, 6.0]),
    )
    above, below = distances(stiff, limit), distances(soft, 1.0)
    assert np.all(above > 0.0) and above[-1] < 1e-5 and np.all(below < 0.0)
    # The next term of the expansion is B^(−4/5), 1e-4 relative here and falling.
    np.testing.assert_allclose(np.diff(np.log(above)) / np.diff(np.log(stiff)), -0.4, atol=0.002)
    np.testing.assert_allclose(np.diff(np.log(-below)) / np.diff(np.log(soft)), 1.0, atol=0.002)


def test_a_mirrored_system_has_the_same_shells():
    energies = np.array([0.1, 0.3, 2.0])
    for contacts in (SKEW, (Contact(2, "left", 10.0, 0.5),)):
        a, b = ratios(fig6(contacts), energies), ratios(mirrored(fig6(contacts)), energies)
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
    # A stop without clearance: the search for the end of the shell begins on the root itself.
    contacts = Contact(1, "left", 2.5, 0.6, "power", 1.0), Contact(2, "right", 0.9, 0.0)
    system = System([1.0, 1.0], [1.0, 1.0], [0.1, 0.1], [0.1, 0.1], contacts=contacts)
    energy = np.geomspace(0.01, 4.0, 200)
    averages = shell_averages(system, energy)
    # The phase volume of two masses is ∝ ∫(H − V) dq; a smooth integrand, but for its edge.
    side = np.sqrt(2.0 * energy[-1] / 0.38) * np.linspace(-1.0, 1.0, 601)
    q = np.stack(np.meshgrid(side, side, indexing="ij"), axis=-1)
    V = system.potential(q)
    free = 0.5 * np.einsum("...i,ij,...j->...", q, system.stiffness_matrix, q)
    for k in (60, 140, 199):
        area, of_free = (np.sum(np.maximum(energy[k] - x, 0.0)) for x in (V, free))
        assert averages.volume[k] == pytest.approx(area / of_free, rel=5e-3)
    assert np.all(np.abs(np.diff(averages.states)) < 0.02)


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


def test_numbers_of_contacts_may_be_integers():
    energy = np.array([0.8, 1.5, 4.0])
    whole, floats = (
        shell_averages(fig6((Contact(2, "right", *numbers, law="power", exponent=e),)), energy)
        for *numbers, e in ((10**25, 1, 2), (1e25, 1.0, 2.0))
    )
    assert np.all(whole.states == floats.states) and np.all(whole.states < 1.0)
