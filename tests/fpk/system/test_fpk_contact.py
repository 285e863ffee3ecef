"""Contact laws: force = energy', slope = force', monotone, zero at first touch, Eqs. (2), (5)."""

import numpy as np
import pytest

from fpk.numeric.errors import InvalidInput
from fpk.numeric.quadrature import panel_rule
from fpk.system.contact import Contact
from fpk.system.contact_law import LAWS, ContactLaw, register_law

ROWS = [
    (name, exponent)
    for name, law in sorted(LAWS.items())
    for exponent in ([law.exponent] if law.exponent is not None else [1.0, 1.3, 3.5])
]
OVERLAPS = np.geomspace(1e-3, 10.0, 41)


def increments(function):
    """∫ f dx between neighbouring overlaps by 16 Gauss points; a law is analytic beyond touch.

    A panel is 1.26 times as wide at its end as at its start, and the nearest point where x^r is not
    smooth, 0, lies 8.7 half-widths from its middle: the error falls by 17^-32.
    """
    x, w = panel_rule(OVERLAPS, 16)
    return np.sum(w * function(x), axis=-1)


@pytest.mark.parametrize("name, exponent", ROWS)
def test_energy_is_the_integral_of_force_and_force_that_of_slope(name, exponent):
    assert {"hertz", "bilinear", "power"} <= set(LAWS)
    law, zero = LAWS[name], np.zeros(1)
    for whole, rate in ((law.energy, law.force), (law.force, law.slope)):
        found = increments(lambda x, rate=rate: rate(x, exponent))
        # Round-off of a difference of neighbours, at least 0.2 of them: some ε/0.2.
        np.testing.assert_allclose(found, np.diff(whole(OVERLAPS, exponent)), rtol=2e-14)
        assert whole(zero, exponent)[0] == 0.0
        assert np.all(np.diff(whole(np.append(zero, OVERLAPS), exponent)) > 0)
    assert np.isfinite(law.slope(zero, exponent)[0]) and np.all(law.slope(OVERLAPS, exponent) > 0)
    # The energy of another exponent is seen.
    other = np.diff(OVERLAPS ** (exponent + 1.01) / (exponent + 1.01))
    assert np.max(np.abs(increments(lambda x: law.force(x, exponent)) / other - 1.0)) > 1e-3


def test_a_law_that_is_no_power_passes():
    steps = np.diff(2.0 * np.sinh(0.5 * OVERLAPS) ** 2)
    np.testing.assert_allclose(increments(np.sinh), steps, rtol=2e-14)


def test_hertz_is_the_three_halves_power_of_eq_2():
    contact = Contact(1, "right", 7.0, 0.5)
    assert contact.force(4.0) == pytest.approx(7.0 * 8.0, rel=1e-15)
    assert contact.energy(4.0) == pytest.approx(0.4 * 7.0 * 32.0, rel=1e-15)
    assert contact.power == 1.5


@pytest.mark.parametrize(
    "stop", [Contact(1, "right", 1e9, 0.1), Contact(1, "right", 1e-3, 0.1, "power", 40.0)]
)
@pytest.mark.parametrize("energy", [1e-6, 1.0, 1e3])
def test_the_overlap_at_an_energy(stop, energy):
    assert stop.energy(stop.overlap_at(energy)) == pytest.approx(energy, rel=1e-9)


BAD = {
    "mass": ["2", 1.5],
    "side": ["up"],
    "stiffness": [0.0, -1.0, np.inf, np.nan, "10"],
    "clearance": [-1e-9, np.nan, None],
    "law": ["glue"],
    "exponent": [None, 0.9, np.nan, np.inf, 101.0, "2"],
}


@pytest.mark.parametrize("field, value", [(f, v) for f, values in BAD.items() for v in values])
def test_a_bad_field_is_named(field, value):
    fields = {"mass": 2, "side": "both", "stiffness": 10.0, "clearance": 0.5, "law": "power"}
    with pytest.raises(InvalidInput, match=rf"^{field} = ") as caught:
        Contact(**{**fields, "exponent": 2.0, field: value})
    assert caught.value.key == field
    assert Contact(**fields, exponent=100.0).power == 100.0
    with pytest.raises(InvalidInput, match=r"^exponent = "):
        Contact(**{**fields, "law": "hertz", "exponent": 2.0})


def test_a_law_of_a_name_that_is_taken_is_refused():
    one = LAWS["hertz"]
    with pytest.raises(ValueError, match="registered already"):
        register_law(ContactLaw("hertz", 1.5, one.force, one.energy, one.slope))


def test_both_sides_are_a_left_and_a_right_stop():
    left, right = Contact(2, "both", 2.0, 0.3).one_sided()
    assert {left.side, right.side} == {"left", "right"}
    assert (left.stiffness, left.clearance, left.mass) == (2.0, 0.3, 2)
    assert Contact(2, "left", 2.0, 0.3).one_sided()[0].side == "left"
