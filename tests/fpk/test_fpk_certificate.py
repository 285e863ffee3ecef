"""What certificates take together."""

import numpy as np

from fpk.certificate import worst


def test_the_worst_of_what_was_measured_is_no_number_where_one_is_none():
    assert np.isnan(worst([1.0, np.nan])) and np.isnan(worst([np.nan, None, 1.0]))
    assert worst([None, 2.0, 1.0]) == 2.0 and worst([None]) is None
