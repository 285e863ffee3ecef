"""The wall time that a command's simulations share: what each is given, by a clock of the test."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest

from cases.compare import answering
from cases.compare.attempts import Budget, budget_of
from cases.compare.averaged import AveragedSimulation
from cases.compare.stationary import run_scene
from cases.scene.scene import load_scene
from fpk.answer.method import silent
from fpk.answer.names import REST, parse_limit, parse_observable
from fpk.numeric.errors import InvalidInput, NotCertified
from sim.montecarlo import MonteCarlo
from sim.questions.splitting.run import Splitting, rare_failure

SCENE = """
[system]
mass = [1.0]
stiffness = [1.0]
damping = [0.1]
noise_intensity = [0.1]
[observe]
densities = ["q1"]
[[passage]]
limit = "H=1.0"
times = [5.0, 20.0]
[[transient]]
of = "H"
times = [5.0]
"""


def test_time_that_is_not_used_goes_on_to_those_that_follow():
    now, given = [0.0], []
    budget = Budget(12.0, 3, clock=lambda: now[0])

    def work(taken):
        def simulated(method):
            given.append(method.seconds)
            now[0] += taken

        return simulated

    budget.begin(2)  # 12 of 3 questions: 4
    budget.spend(MonteCarlo(), work(1.0))
    budget.spend(MonteCarlo(), work(1.0))
    budget.begin(1)  # 10 are left of 2
    budget.spend(MonteCarlo(), work(7.0))
    budget.begin(2)
    budget.spend(MonteCarlo(), work(4.0))
    budget.spend(MonteCarlo(), work(0.0))
    assert given == pytest.approx([2.0, 3.0, 5.0, 1.5, 1e-3])
    # Nothing is bounded where no time is given.
    budget = budget_of([MonteCarlo()], 3)
    budget.begin(1)
    assert budget.spend(MonteCarlo(), lambda own: own.seconds) is None


@dataclass(frozen=True)
class Asked(MonteCarlo):
    """A simulation that notes what time it is given, and takes none."""

    given: Any = ()

    def prepare(self, system):
        plan = super().prepare(system)
        return replace(plan, solve=self._note, beside=False)

    def _note(self, *asked, **how):
        self.given.append(self.seconds)
        raise NotCertified("no time was taken")

    passage = transient = _note


def test_a_run_shares_its_seconds(written, monkeypatch):
    given = []

    def split(*asked, **how):
        given.append(asked[2].seconds)
        raise NotCertified("no time was taken")

    monkeypatch.setattr(answering, "split_passage", split)
    run_scene(load_scene(written(SCENE)), [Asked(seconds=8.0, given=given)])
    stationary, passage, each_split, scout, transient = given
    assert stationary == pytest.approx(8.0 / 3.0, rel=1e-2)
    assert passage == pytest.approx(8.0 / 2.0 / 2.0, rel=2e-2)
    assert each_split == pytest.approx(4.0 / 2.0, rel=2e-2)  # two times
    assert scout == pytest.approx(8.0 / 2.0, rel=2e-2)
    assert transient == pytest.approx(8.0, rel=2e-2)


NO_TIME = 1e-9


def test_too_little_time_is_said_in_one_line(written):
    term = "[[damping_term]]\ni = 1\nj = 1\ncoefficient = 0.1\nq = { 1 = 2 }\n[observe]"
    path = written(SCENE.replace("[observe]", term))
    system, H, at = load_scene(path).system, parse_observable("H", 1), np.linspace(0, 1, 5)
    limit, later, quiet = parse_limit("H=1", 1), np.array([20.0]), {"tol": None, "progress": silent}
    averaged = AveragedSimulation("nonintegrable", seconds=NO_TIME)
    plain = replace(system, damping_terms=())
    for method, own in ((MonteCarlo(seconds=NO_TIME), plain), (averaged, system)):
        with pytest.raises(InvalidInput, match="are over in the first round"):
            method.transient(own, H, REST, later, (at,), **quiet)
        (density,) = method.solve(own, [H]).densities
        assert "give it more time" in density.certificate.failures[0]
    assert not averaged.passage(system, limit, REST, later, **quiet).certificate.certified
    with pytest.raises(NotCertified, match="0 repetitions were finished"):
        rare_failure(plain, limit, REST, 5.0, settings=Splitting(seconds=NO_TIME))
