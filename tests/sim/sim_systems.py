"""Systems that the tests of the simulation share."""

from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np

from fpk.answer.dynamics import Passage
from fpk.answer.method import silent
from fpk.answer.names import parse_limit, parse_start
from fpk.answer.question import Asked
from fpk.system.contact import Contact
from fpk.system.system import System
from sim.montecarlo import MonteCarlo
from sim.questions.passage import passage_of
from sim.sample.diagnostics import Report
from sim.sample.ensemble import Ensemble
from sim.sample.histogram import Histogram, axis_of, covering, extremes


def fig6(*, clearance: float = 0.5) -> System:
    return System(
        mass=[1.0, 1.0],
        stiffness=[1.0, 1.0],
        damping=[0.08, 0.04],
        noise_intensity=[0.01, 0.02],
        contacts=(Contact(2, "both", 10.0, clearance),),
    )


def exact(*, clearance: float = 0.5) -> System:
    """c_i/D_i = 2 for both: the stationary density is exp(−2 H)."""
    return System(
        mass=[1.0, 1.0],
        stiffness=[1.0, 1.0],
        damping=[0.2, 0.4],
        noise_intensity=[0.1, 0.2],
        contacts=(Contact(2, "both", 10.0, clearance),),
    )


def mixed() -> System:
    """Three unequal masses, two laws, two stops on one side, full damping, correlated noise."""
    return System(
        mass=[1.0, 0.7, 1.6],
        stiffness=[1.0, 2.0, 0.5],
        damping=[[0.2, 0.05, 0.0], [0.05, 0.3, -0.02], [0.0, -0.02, 0.1]],
        noise_intensity=[[0.05, 0.02, 0.0], [0.02, 0.08, 0.0], [0.0, 0.0, 0.03]],
        contacts=(
            Contact(1, "right", 3.0, 0.1),
            Contact(3, "both", 8.0, 0.3, law="bilinear"),
            Contact(3, "left", 5.0, 0.4, law="power", exponent=2.0),
        ),
    )


def linear(n: int = 2) -> System:
    return System(
        mass=[1.0 + 0.3 * i for i in range(n)],
        stiffness=[1.0] * n,
        damping=[0.1] * n,
        noise_intensity=[0.05] * n,
    )


def estimated(
    fine: Any, coarse: Any, until: Any, times: Any = (), *, limit: str = "H=1", step: float = 0.0,
    memory: float = 0.0, tol: float | None = None,
) -> Passage:  # fmt: skip
    """First passage from failure times at half the step and at the step, some cut short."""
    system = linear(1)
    asked = Asked(
        system,
        tol,
        silent,
        start=parse_start("rest", system),
        limit=parse_limit(limit, 1),
        times=np.array(times, dtype=float),
    )
    return passage_of(np.stack([fine, coarse, until]), asked, tol, step, memory, {})


def report_of(method: MonteCarlo, system: System, observables: Sequence[Any] = ()) -> Report:
    """The report of a simulation."""
    report = method.solve(system, observables).report
    assert isinstance(report, Report)
    return report


def place(ensemble: Ensemble, states: Any) -> None:
    """Go on from other ``states`` (blocks, 2n, LANES), whose energy it may reach from then on."""
    ensemble.restore({**ensemble.saved(), "states": states})
    energy = float(np.max(ensemble.system.hamiltonian(*ensemble.phase_points())))
    ensemble.energy = energy


def ranged(system: System, observables: Sequence[Any], q: Any, p: Any) -> tuple[Histogram, ...]:
    """Histograms that cover the states ``q``, ``p`` (samples, n) with a margin."""
    reached = extremes(system, observables, q, p)
    return covering(observables, reached, partial(axis_of, system))
