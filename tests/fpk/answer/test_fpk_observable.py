"""Names of observables: what users write is what they read, and what cannot be is refused."""

import pytest

from fpk.answer.method import Method
from fpk.answer.names import Coordinate, observable_name, parse_observable
from fpk.numeric.errors import InvalidInput
from fpk.system.system import System


@pytest.mark.parametrize(
    "text", ["q1", "p3", "H", "H3", "q2,p2", "p1,p3", "q1,q2", "H,q1", "H1,H2"]
)
def test_names_survive_the_round_trip(text):
    assert observable_name(parse_observable(text, 3)) == text


def test_indices_count_from_zero_inside():
    assert parse_observable(" q2 , p1", 2) == (Coordinate("q", 1), Coordinate("p", 0))
    assert parse_observable("H", 1) == (Coordinate("H"),)
    assert parse_observable("q1000", 1000) == (Coordinate("q", 999),)


@pytest.mark.parametrize(
    "text",
    [
        *("", "q", "p", "q0", "q4", "p4", "H4", "x1", "Q1", "q1,", ",q1", "q1,q1", "q1,q2,q3"),
        *("q-1", "q1.0", "q01", "q²", "q１", "q1 p1", "h", "q1;p1", "q99999"),
    ],
)
def test_what_is_not_an_observable_is_refused_by_name(text):
    with pytest.raises(InvalidInput, match=r"^observable = ") as caught:
        parse_observable(text, 3)
    assert caught.value.value == text


@pytest.mark.parametrize("observables", [["q2"], "q2", [3], [()], [("q", 1)]])
def test_a_method_refuses_an_observable_that_is_not_parsed(observables):
    system = System([1, 1], [1, 1], [0.08, 0.04], [0.01, 0.02])

    class Never(Method):
        route = refined = None

        def prepare(self, system):
            raise AssertionError("prepared")

    with pytest.raises(InvalidInput, match="is not parsed; use parse_observable"):
        Never().solve(system, observables)
