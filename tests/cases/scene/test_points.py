"""Lists of points: as written, to the end, and refused with a reason."""

import numpy as np
import pytest

from cases.scene.errors import BadInput
from cases.scene.points import parse_points


def test_ranges_reach_their_end_and_hit_what_was_written():
    (x,) = parse_points("-1.5:1.5:0.1", 1)
    assert x.size == 31 and x[-1] == 1.5 and 0.0 in x and 0.3 in x
    (y,) = parse_points("-1,0,0.3", 1)
    assert y.tolist() == [-1.0, 0.0, 0.3]
    assert parse_points("1:0:-0.5", 1)[0].tolist() == [1.0, 0.5, 0.0]


def test_pairs_are_all_combinations():
    q, p = parse_points("-1:1:1 x 0,0.5", 2)
    assert q.tolist() == [-1, -1, 0, 0, 1, 1] and np.array_equal(p, [0, 0.5] * 3)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "a",
        "1:2",
        "1:2:0",
        "1:2:-1",
        "0:1e9:1e-9",
        "nan",
        "inf",
        "1e999",
        "1,,2",
        "1 x 2",
        "0:1:1e-99999999",
    ],
)
def test_what_is_no_list_is_refused(text):
    with pytest.raises(BadInput, match="--at"):
        parse_points(text, 1)


def test_a_pair_needs_two_lists():
    with pytest.raises(BadInput, match="two lists"):
        parse_points("1,2", 2)
