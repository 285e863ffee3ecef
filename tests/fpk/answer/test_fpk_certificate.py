"""What certificates take together."""

import numpy as np

from fpk.answer.certificate import Measured, largest_measured
from fpk.answer.density import certify_density
from fpk.answer.dynamics import certify_curve
from fpk.answer.names import parse_observable


def test_the_worst_of_what_was_measured_is_no_number_where_one_is_none():
    assert np.isnan(largest_measured([1.0, np.nan])) and np.isnan(
        largest_measured([np.nan, None, 1.0])
    )
    assert largest_measured([None, 2.0, 1.0]) == 2.0 and largest_measured([None]) is None


def test_a_curve_keeps_what_else_is_wrong_with_its_density():
    # Only that the density misses a tolerance of its own is not of the curve.
    nodes = np.array([0.0, 1.0])
    measured = Measured(1e-3, 0.0, 0.0, 0.0, 0.0, failures=("the ladder ended",))
    one = parse_observable("q1", 1)
    density = certify_density(
        one, (nodes,), np.ones_like, np.zeros_like, measured=measured, tol=1e-6
    )
    assert density.certificate.missed is not None
    curve = certify_curve(np.ones(1), np.zeros(1), scale=1.0, of=density, tol=1e-6)
    assert curve.certificate.failures == ("the ladder ended",)
