"""Limits of wall time hold for the burn-in, too, and an answer says what it is worth then."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from sim_systems import fig6

from fpk.answer.names import Coordinate
from fpk.numeric.errors import InvalidInput
from fpk.system.system import System
from sim import MonteCarlo
from sim.sample.diagnostics import Report
from sim.sample.plan import Setup
from sim.sample.simulation import simulate

OF = [(Coordinate("q", 1),)]
SHORT = MonteCarlo(paths=4096, threads=1, seconds=0.5)


def light() -> System:
    """Return a system whose burn-in takes 1e7 steps: hours."""
    system = fig6()
    return System(
        system.mass, system.stiffness, 1e-6 * system.damping, 1e-6 * system.noise_intensity,
        contacts=system.contacts,
    )  # fmt: skip


@pytest.mark.parametrize("step_pair", [False, True])
@pytest.mark.parametrize(
    ("system", "dt", "words"),
    [
        (light(), None, "of the burn-in"),
        (fig6(), 1e-6, "of the burn-in"),
    ],
)
def test_the_limit_holds_for_the_burn_in(
    system: System, dt: float | None, words: str, *, step_pair: bool
) -> None:
    result = replace(SHORT, dt=dt, step_pair=step_pair).solve(system, OF)
    (density,), report = result.densities, result.report
    assert isinstance(report, Report) and report.diagnosis is None and not result.partial
    (failure,) = density.certificate.failures  # and no step is blamed
    assert failure.startswith("the limit of") and words in failure
    assert report.burn_in < 10.0 * report.relaxation_time
    assert np.all(np.isfinite(density(np.linspace(-0.5, 0.5, 5))))


def test_the_limit_holds_for_the_first_chunk() -> None:
    """A chunk that takes 1e5 times the limit, after a short burn-in."""
    method = replace(SHORT, time=1e9, burn_in=0.01)
    (density,) = method.solve(fig6(), OF).densities
    assert "in its first chunk, before any drift" in density.certificate.failures[0]


def test_a_step_for_which_there_are_no_random_numbers_is_refused() -> None:
    with pytest.raises(InvalidInput, match="more random numbers"):
        replace(SHORT, dt=1e-300).solve(fig6(), OF)


def test_a_burn_in_that_the_limit_ended_goes_on_from_its_state(tmp_path: Path) -> None:
    """With the state of the first run a second one comes to the end of the burn-in."""
    method = replace(SHORT, dt=0.002, seconds=0.3, checkpoint=tmp_path)
    shares = []
    for _ in range(2):
        failure = method.solve(fig6(), OF).densities[0].certificate.failures[0]
        shares.append(float(failure.split("after ")[1].split(" ")[0]))
    assert 0.0 < shares[0] < shares[1]


def test_the_limit_holds_for_the_second_simulation_of_a_pair(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A second simulation that is ten thousand times as slow ends when its share is over."""
    setups: list[Setup] = []

    def slow(setup: Setup, **options: Any) -> Any:
        if setups:
            setup = replace(setup, dt=1e-4 * setup.dt)
        setups.append(setup)
        return simulate(setup, **options)

    monkeypatch.setattr("sim.sample.simulation.simulate", slow)
    method = replace(SHORT, step_pair=True, burn_in=0.1, seconds=3.0)
    report = method.solve(fig6(), OF).report
    assert isinstance(report, Report) and report.diagnosis is not None
    assert [s.seconds for s in setups] == pytest.approx([1.0, 2.0])
    assert report.step_pair == "not measured: the limit of time came" and not report.step_biases
