"""The plain simulation that shows whether passages are rare is used where it answers."""

from typing import Any

import numpy as np
import pytest
from scipy.special import expi

from cases.compare.rare import passage_answer
from cases.scene.questions import PassageQuestion
from fpk.answer.method import silent
from fpk.answer.names import parse_limit, parse_start
from fpk.system.system import System
from sim.montecarlo import MonteCarlo
from sim.questions.passage import LEAST_TAIL_FAILURES


@pytest.mark.parametrize(("last", "simulations"), [(400.0, 1), (20.0, 2)])
def test_one_simulation_answers_where_most_have_failed(
    last: float, simulations: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    system, run, times = System([1.0], [1.0], [0.1], [0.05]), MonteCarlo.passage, []

    def counted(method: MonteCarlo, *asked: Any, **how: Any) -> Any:
        times.append(method.time)
        return run(method, *asked, **how)

    monkeypatch.setattr(MonteCarlo, "passage", counted)
    question = PassageQuestion(parse_limit("H=1.5", 1), parse_start("rest", system), (last,))
    method = MonteCarlo(paths=4096, threads=1)
    answer = passage_answer(method, system, question, tol=None, progress=silent)
    assert times == [last, None][:simulations] and answer.certificate.certified
    # The mean is 10 (Ei(3) − ln 3 − γ) but for averaging; 4 errors.
    assert abs(answer.mean.value - 82.58) < 4.0 * answer.mean.error
    assert np.all(np.abs(answer.survival) <= 1.0)


def test_a_passage_seldom_by_the_last_time_has_a_mean_where_it_can_be_waited_for() -> None:
    # Few of the paths pass by t = 25, nearly all in the time for which they may be followed.
    system = System([1.0], [1.0], [0.1], [0.05])
    question = PassageQuestion(parse_limit("H=3.5", 1), parse_start("rest", system), (25.0,))
    answer = passage_answer(
        MonteCarlo(paths=4096, threads=1), system, question, tol=None, progress=silent
    )
    x = 3.5 / 0.5
    exact = 10.0 * (expi(x) - np.log(x) - np.euler_gamma)
    assert answer.certificate.certified and "sampled_by" not in answer.settings
    assert 0.0 < (1.0 - answer.survival[0]) * 4096 < LEAST_TAIL_FAILURES
    assert abs(answer.mean.value - exact) < 4.0 * answer.mean.error
