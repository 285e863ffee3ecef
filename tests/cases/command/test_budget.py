"""The wall time that a command's simulations share: what each is given, by a clock of the test."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
from systems import ONE_MASS

from cases.compare import answering
from cases.compare.averaged import AveragedSimulation
from cases.compare.stationary import run_scene
from cases.scene.scene import load_scene
from fpk.answer.method import silent
from fpk.answer.names import REST, parse_limit, parse_observable
from fpk.numeric.errors import InvalidInput, NotCertified
from sim.montecarlo import MonteCarlo
from sim.questions.splitting.run import Splitting, rare_failure

SCENE = f"""{ONE_MASS.format(1.0, 1.0, 0.1, 0.1)}
[observe]
densities = ["q1"]
[[passage]]
limit = "H=1.0"
times = [5.0, 20.0]
[[transient]]
of = "H"
times = [5.0]
"""


@dataclass(frozen=True)
class Asked(MonteCarlo):
    """A simulation that notes what time it is given, and takes none."""

    given: Any = ()

    def prepare(self, system):
        return replace(super().prepare(system), solve=self._note, beside=False)

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
    # Stationary 8/3; passage half of 8/2, each of two times a half of 4; scout 8/2; transient.
    assert given == pytest.approx([8.0 / 3.0, 2.0, 2.0, 4.0, 8.0], rel=2e-2)


def test_too_little_time_is_said_in_one_line(written):
    term = "[[damping_term]]\ni = 1\nj = 1\ncoefficient = 0.1\nq = { 1 = 2 }\n[observe]"
    system = load_scene(written(SCENE.replace("[observe]", term))).system
    H, at, plain = parse_observable("H", 1), np.linspace(0, 1, 5), replace(system, damping_terms=())
    limit, later, quiet = parse_limit("H=1", 1), np.array([20.0]), {"tol": None, "progress": silent}
    averaged = AveragedSimulation("nonintegrable", seconds=1e-9)
    for method, own in ((MonteCarlo(seconds=1e-9), plain), (averaged, system)):
        with pytest.raises(InvalidInput, match="are over in the first round"):
            method.transient(own, H, REST, later, (at,), **quiet)
        (density,) = method.solve(own, [H]).densities
        assert "give it more time" in density.certificate.failures[0]
    assert not averaged.passage(system, limit, REST, later, **quiet).certificate.certified
    with pytest.raises(NotCertified, match="0 repetitions were finished"):
        rare_failure(plain, limit, REST, 5.0, settings=Splitting(seconds=1e-9))
