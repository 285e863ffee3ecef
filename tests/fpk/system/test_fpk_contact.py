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
    for exponent in ([law.exponent] if law.exponent is not None else [1.0, 1.3, 2.0, 3.5])
]
OVERLAPS = np.geomspace(1e-3, 10.0, 41)


def increments(function):
    """∫ f dx between neighbouring overlaps by 16 Gauss points; a law is analytic beyond touch.

    A panel is 1.26 times as wide at its end as at its start, and the nearest point where x^r is not
    smooth, 0, lies 8.7 half-widths from its middle: the error falls by 17^-32.
    """
    x, w = panel_rule(OVERLAPS, 16)
    return np.sum(w * function(x), axis=-1)


def test_laws_were_found():
    assert {"hertz", "bilinear", "power"} <= set(LAWS)
    assert {name for name, _ in ROWS} == set(LAWS)


@pytest.mark.parametrize("name, exponent", ROWS)
def test_energy_is_the_integral_of_force_and_force_that_of_slope(name, exponent):
    law = LAWS[name]
    parts = ((law.energy, law.force), (law.force, law.slope))
    for whole, rate in parts:
        steps = np.diff(whole(OVERLAPS, exponent))
        # Round-off of a difference of neighbours, at least 0.2 of them: some ε/0.2.
        np.testing.assert_allclose(
            increments(lambda x, rate=rate: rate(x, exponent)), steps, rtol=2e-14
        )


@pytest.mark.parametrize("name, exponent", ROWS)
def test_energy_of_another_exponent_is_seen(name, exponent):
    steps = np.diff(OVERLAPS ** (exponent + 1.01) / (exponent + 1.01))
    with pytest.raises(AssertionError):
        np.testing.assert_allclose(
            increments(lambda x: LAWS[name].force(x, exponent)), steps, rtol=2e-14
        )


def test_a_law_that_is_no_power_passes():
    steps = np.diff(2.0 * np.sinh(0.5 * OVERLAPS) ** 2)
    np.testing.assert_allclose(increments(np.sinh), steps, rtol=2e-14)


@pytest.mark.parametrize("name, exponent", ROWS)
def test_force_starts_at_zero_and_rises(name, exponent):
    law = LAWS[name]
    zero = np.zeros(1)
    assert law.force(zero, exponent)[0] == 0.0
    assert law.energy(zero, exponent)[0] == 0.0
    assert np.isfinite(law.slope(zero, exponent)[0])
    x = np.concatenate([zero, OVERLAPS])
    assert np.all(np.diff(law.force(x, exponent)) > 0)
    assert np.all(np.diff(law.energy(x, exponent)) > 0)
    assert np.all(law.slope(OVERLAPS, exponent) > 0)


def test_hertz_is_the_three_halves_power_of_eq_2():
    contact = Contact(1, "right", 7.0, 0.5)
    assert contact.force(4.0) == pytest.approx(7.0 * 8.0, rel=1e-15)
    assert contact.energy(4.0) == pytest.approx(0.4 * 7.0 * 32.0, rel=1e-15)
    assert contact.power == 1.5


@pytest.mark.parametrize(
    "field, value",
    [
        ("side", "up"),
        ("stiffness", 0.0),
        ("stiffness", -1.0),
        ("stiffness", np.inf),
        ("stiffness", np.nan),
        ("clearance", -1e-9),
        ("clearance", np.nan),
        ("law", "glue"),
        ("exponent", 2.0),
    ],
)
def test_a_bad_field_is_named(field, value):
    fields = {"mass": 1, "side": "both", "stiffness": 1.0, "clearance": 0.5} | {field: value}
    with pytest.raises(InvalidInput, match=rf"^{field} = ") as caught:
        Contact(**fields)
    assert caught.value.key == field


@pytest.mark.parametrize("exponent", [None, 0.9, np.nan, np.inf])
def test_the_power_law_needs_its_exponent(exponent):
    with pytest.raises(InvalidInput, match=r"^exponent = "):
        Contact(1, "left", 1.0, 0.0, law="power", exponent=exponent)


def test_a_law_of_a_name_that_is_taken_is_refused():
    one = LAWS["hertz"]
    with pytest.raises(ValueError, match="registered already"):
        register_law(ContactLaw("hertz", 1.5, one.force, one.energy, one.slope))


def test_both_sides_are_a_left_and_a_right_stop():
    left, right = Contact(2, "both", 2.0, 0.3).one_sided()
    assert {left.side, right.side} == {"left", "right"}
    assert (left.stiffness, left.clearance, left.mass) == (2.0, 0.3, 2)
    assert Contact(2, "left", 2.0, 0.3).one_sided()[0].side == "left"
