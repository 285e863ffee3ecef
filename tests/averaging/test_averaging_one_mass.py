"""The compiled integrals of one contact mass against their NumPy twin over rays."""

import numpy as np
import pytest
from averaging_systems import chain

from averaging.shell.one_mass.ratios import OneMassShell
from averaging.shell.ratios import energy_shell, integrated_ratios
from averaging.shell.reduced import reduced_potential
from fpk.contact import Contact

STOPS = {
    "both": (Contact(1, "both", 10.0, 0.5),),
    "stiff": (Contact(1, "right", 1e8, 0.5),),
    "skew": (Contact(1, "right", 10.0, 0.5), Contact(1, "left", 3.0, 0.8)),
    "two on a side": (Contact(1, "right", 10.0, 0.5), Contact(1, "right", 50.0, 0.8)),
    "three laws": (
        Contact(1, "right", 10.0, 0.3),
        Contact(1, "right", 50.0, 0.6, "bilinear"),
        Contact(1, "left", 2.0, 0.4, "power", 2.2),
    ),
    "no clearance": (Contact(1, "both", 10.0, 0.0),),
}


SLOW = ("three laws",)
"""Laws together that no other test compiles."""


@pytest.mark.parametrize("n", [1, 2, 3, 9, 10, 50])
@pytest.mark.parametrize(
    "stops",
    [pytest.param(name, marks=[pytest.mark.slow] if name in SLOW else []) for name in STOPS],
)
def test_equal_to_the_twin(n, stops):
    potential = reduced_potential(chain(n, STOPS[stops]))
    shell = energy_shell(chain(n, STOPS[stops]))
    first = shell.contact_energies[0]
    energies = np.concatenate([first + np.logspace(-4.0, 4.0, 25), [first + 1e-9]])
    found, expected = OneMassShell(potential)(energies), integrated_ratios(potential, energies).T
    # Two rules of either have agreed to 3e-12 or to what each reports; for many masses the compiled
    # one leaves out 1e-18 of an integrand that the other resolves. H T'/T ~ √(H − H_c) just beyond
    # contact makes of a rounding of H ε/√(1 − H_c/H).
    rounding = np.finfo(float).eps / np.sqrt(1.0 - first / energies)
    allowed = found[[3, 3, 4]] + expected[3] + 1e-13 + 4.0 * rounding
    sizes = np.abs(expected[:3])
    sizes[2] = np.maximum(sizes[2], 1.0)  # it passes through zero for n = 1
    assert np.all(np.abs(found[:3] - expected[:3]) <= allowed * sizes)
    assert np.median(found[3]) < 1e-12


def test_a_high_power_overflows_nothing():
    # At the root that the springs alone would have, x^101 is beyond double precision.
    potential = reduced_potential(chain(2, (Contact(2, "both", 1.0, 0.5, "power", 100.0),)))
    rigid = reduced_potential(chain(2, (Contact(2, "both", 1e12, 0.5),)))
    found, stiff = OneMassShell(potential)(np.array([1e6])), OneMassShell(rigid)(np.array([1e6]))
    assert np.all(np.isfinite(found))
    # The mass turns where its overlap is (101 H)^(1/101) = 1.2, a stiff one at the stop, 0.5.
    assert 2.0 < found[0, 0] / stiff[0, 0] < 4.0


def test_just_beyond_a_second_stop_nothing_cancels():
    # The rise beyond the second stop is 1e-9 of what the first one holds by then.
    potential = reduced_potential(chain(2, STOPS["two on a side"]))
    second = energy_shell(chain(2, STOPS["two on a side"])).contact_energies[1]
    above = OneMassShell(potential)(second * (1.0 + np.logspace(-10.0, -6.0, 9)))
    # H T'/T is continuous there and changes by less than its slope of order ten.
    assert np.all(above[3] < 1e-11)
    assert np.ptp(above[2]) < 1e-4
    assert np.all(np.diff(above[0]) < 0.0)


def test_stops_of_another_stiffness_are_told_apart():
    energies = np.array([1.0, 10.0])
    one = OneMassShell(reduced_potential(chain(2, (Contact(2, "both", 10.0, 0.5),))))(energies)
    other = OneMassShell(reduced_potential(chain(2, (Contact(2, "both", 10.1, 0.5),))))(energies)
    assert np.all(np.abs(one[0] / other[0] - 1.0) > 1e-4)
