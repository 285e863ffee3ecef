"""How numbers, errors and times are written: an error is never shown below what it is."""

import re

import numpy as np
import pytest

from cases.scene.written import bound, duration, up, with_error
from cases.show.page import TEMPLATES
from cases.show.study_page import cell


@pytest.mark.parametrize(
    ("value", "error", "text"),
    [
        (0.41234567, 0.00041, "0.4123(5)"),  # up
        (0.41234567, 0.00012, "0.41235(12)"),
        (-1.5, 0.0951, "-1.50(10)"),
        (0.4264499875718573, 2.7e-12, "0.4264500"),
        (1e-17, 1.7e-10, "0(2e-10)"),
        (0.0, 0.0, "0"),
        (123456.7, 2100.0, "123457(3000)"),
        (1.2345e-7, 3e-9, "1.23(3)e-07"),
        (3.25e9, 2e7, "3.25(2)e+09"),
        (-1.9e-5, 0.0018, "0.0000(18)"),  # no minus before a number that is shown as zero
        (0.5, None, "–"),
        (0.5, np.inf, "0.5(inf)"),
    ],
)
def test_a_number_is_shown_with_its_error(value, error, text):
    assert with_error(value, error) == text


def test_a_number_in_brackets_is_no_less_than_the_error():
    rng = np.random.default_rng(3)
    for value, error in zip(rng.normal(size=500), 10.0 ** rng.uniform(-9, 0, 500), strict=True):
        text = with_error(value, error)
        digits, _, rest = text.partition("(")
        decimals = len(digits.partition(".")[2])
        shown = float(rest.partition(")")[0]) if rest else 0.5
        unit = 1.0 if "e" in rest else 10.0**-decimals
        assert shown * unit >= error * (1.0 - 1e-11), text
        assert abs(float(digits) - value) <= max(0.5 * 10.0**-decimals, error) * (1 + 1e-9), text


def test_an_error_is_never_shown_below_what_it_is():
    rng, plain = np.random.default_rng(4), str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "-0123456789")
    for error in 10.0 ** rng.uniform(-20, 9, 500):
        text = up(error).replace(" × 10", "e").translate(plain)
        assert error * (1.0 - 1e-11) <= float(text) <= 1.1 * error, text
    assert (up(None), up(0.0), up(0.00121)) == ("–", "0", "0.0013")
    for error in 10.0 ** rng.uniform(-300, 300, 400):
        for digits in (1, 2, 3):
            shown = float(bound(error, digits))
            # At most one unit of the last digit more, but for round-off (1e-12) no less.
            assert -1e-11 <= shown / error - 1.0 <= 10.0 ** (1 - digits) + 1e-11
    assert [bound(x) for x in (None, 0.0, np.inf)] == ["–", "0", "inf"]
    assert bound(9.91e-3) == "1.0e-02"
    for template in TEMPLATES.glob("*.*"):  # a page rounds no error to the nearest
        nearest = re.findall(r"\b\w*(?:error|sampling|chance)\|num\b", template.read_text("utf-8"))
        assert not nearest, (template.name, nearest)


def test_times_have_units_that_suit_them():
    words = ["5e-06 ms", "2 ms", "1 s", "1.5 min", "3 h", "1 day", "2.31 days", "3.2e+06 years"]
    times = [5e-9, 2e-3, 1.0, 90.0, 10800.0, 86400.0, 2e5, 1e14]
    assert list(map(duration, times)) == words
    assert cell(2e-3, "seconds") == "2 ms" and cell(float("nan"), "seconds") == "–"
