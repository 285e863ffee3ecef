"""The wall time is watched from the burn-in on, and what it leaves no time for is refused."""

import re
from typing import Any

import numpy as np
import pytest
from sim_systems import fig6, linear

from fpk.answer.dynamics import Curve
from fpk.answer.names import Coordinate, parse_observable
from fpk.numeric.errors import InvalidInput
from fpk.system.contact import Contact
from fpk.system.system import System
from sim.montecarlo import MonteCarlo


def asked(question: str, system: System, at: Any = (0.0,), **settings: Any) -> Curve:
    method = MonteCarlo(**({"threads": 1, "paths": 4096} | settings))
    answer: Curve = getattr(method, question)(system, (Coordinate("q", 0),), np.array(at))
    return answer


def stiff() -> System:
    """The burn-in takes 4e6 steps, tens of seconds."""
    return System([1.0], [1.0], [0.1], [0.05], contacts=(Contact(1, "both", 1e8, 0.0),))


@pytest.mark.parametrize("question", ["crossings", "spectrum", "correlation"])
def test_seconds_that_end_in_the_burn_in_are_refused(question: str) -> None:
    with pytest.raises(InvalidInput, match=r"burn-in, which takes about .* s; give it more"):
        asked(question, stiff(), seconds=0.05)


def test_a_few_samples_after_the_burn_in_are_not_judged() -> None:
    # The first sample is far from stationary; that says nothing of the step.
    method = MonteCarlo(threads=1, paths=4096, burn_in=1e-4, seconds=1e-9)
    (density,) = method.solve(stiff(), [parse_observable("q1", 1)]).densities
    (words,) = density.certificate.failures
    assert words.endswith("after all of the burn-in; give it more time")


def test_a_linear_system_burns_in_in_one_step() -> None:
    # Its burn-in is 2e10 time units; what is left ends within the first chunk, or right after it.
    weak = System([1.0], [1.0], [1e-9], [1e-9])
    answer = asked("crossings", weak, seconds=0.1)
    (words,) = answer.certificate.failures
    assert re.search(r"first chunk|second chunk", words)
    assert abs(answer.values[0] - 0.5 / np.pi) < 4.5 * answer.errors[0]


@pytest.mark.parametrize("question", ["spectrum", "correlation"])
def test_seconds_that_end_in_the_first_windows_are_refused(question: str) -> None:
    with pytest.raises(InvalidInput, match="first 4096 windows"):
        asked(question, linear(1), seconds=1e-9)


def test_more_frequencies_than_can_be_summed_are_refused() -> None:
    with pytest.raises(InvalidInput, match="ask for 1024"):
        asked("spectrum", linear(1), np.linspace(1.0, 2.0, 1025))


def test_chunks_of_unequal_lengths_show_no_drift() -> None:
    # 30 steps in 20 chunks: of lengths 1 and 2 the first one would be by half below the rest.
    answer = asked("crossings", linear(1), dt=0.25, time=7.5)
    assert answer.certificate.certified, answer.certificate.failures


def test_crossings_that_end_within_a_chunk_do_not_drift() -> None:
    answer = asked("crossings", fig6(), seconds=1.5, dt=0.02)
    assert not any("drift by" in words for words in answer.certificate.failures)
