"""Systems that the tests of the simulation share, and how they ask for answers in time."""

from functools import partial
from itertools import count
from typing import Any

import asked
import numpy as np
import pytest
import systems
from asked import passage

from averaging.theory import Exact
from cases.compare.averaged import AveragedSimulation
from cases.compare.routes import method_for
from fpk.answer.method import silent
from fpk.answer.names import Coordinate, parse_limit, parse_observable, parse_start
from fpk.answer.question import Asked
from fpk.numeric.machine import working_time
from fpk.system.contact import Contact
from fpk.system.damping import DampingTerm
from fpk.system.system import System
from sim.montecarlo import MonteCarlo
from sim.questions.passage import passage_of
from sim.sample.histogram import axis_of, covering, extremes

CIR_RATE = 0.13742123052434
"""Failure rate of dH = (kT − H) dt + √(2 kT H) dB at 3 kT: 1F1(−λ; 1; 3) = 0, per decay time."""
CIR_MEAN = 8.25803
"""Mean time in which this energy first passes 3 kT from 0, in decay times: Ei(3) − ln 3 − γ."""


def fig6(*, clearance: float = 0.5, stiffness: float = 10.0) -> System:
    return systems.fig6(systems.both(stiffness, clearance))


def exact(*, clearance: float = 0.5) -> System:
    """c_i/D_i = 2 for both: the stationary density is exp(−2 H)."""
    contacts = systems.both(10.0, clearance)
    return System([1.0, 1.0], [1.0, 1.0], [0.2, 0.4], [0.1, 0.2], contacts=contacts)


def exact_density(system: System, name: str) -> Any:
    (density,) = asked.solved(Exact(), system, name)
    return density


def exact_square(clearance: float = 0.5) -> float:
    """E q2² of ``exact``."""
    return float(exact_density(exact(clearance=clearance), "q2").moment(2).value)


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
    return System([1.0 + 0.3 * i for i in range(n)], [1.0] * n, [0.1] * n, [0.05] * n)


def oscillator(damping: float = 0.05, kT: float = 0.5) -> System:
    return System([1.0], [1.0], [damping], [damping * kT])


def limit_cycle() -> System:
    """One mass fed below H = 2 and damped above, by its displacement and by its energy."""
    terms = (DampingTerm(1, 1, 0.16, q=((1, 2),)), DampingTerm(1, 1, 0.02, energy=1))
    return System([1.0], [1.0], [-0.2], [0.005], damping_terms=terms)


def one_mass(kT: float, side: str, B: float, gap: float, law: str = "hertz") -> System:
    contact = Contact(1, side, B, gap, law=law)
    return System([1.0], [1.0], [0.4], [0.4 * kT], contacts=(contact,))


def simulation(**settings: Any) -> MonteCarlo:
    return MonteCarlo(**({"threads": 1, "paths": 4096} | settings))


def averaged(theory: Any, **settings: Any) -> AveragedSimulation:
    return AveragedSimulation(theory, **({"threads": 1, "paths": 1024, "step": 0.2} | settings))


def passed(
    system: System, limit: str, start: str = "rest", times: Any = (), *, method: Any = None,
    **settings: Any,
) -> Any:  # fmt: skip
    """First passage of ``limit`` from ``start`` by ``method``, else ``simulation(**settings)``."""
    return passage(method or simulation(**settings), system, limit, start, times, tol=None)


def transient(
    system: System, of: str, start: str, times: Any, *at: Any, tol: float | None = None,
    method: Any = None, **settings: Any,
) -> Any:  # fmt: skip
    """Densities of ``of`` at ``times`` and points ``at``, by ``method`` or ``simulation()``."""
    method = method or simulation(**settings)
    return asked.transient(method, system, of, start, times, *at, tol=tol)


def curve(
    question: str, system: System, row: int, at: Any, *, route: str | None = None,
    tol: float | None = None, **settings: Any,
) -> Any:  # fmt: skip
    """Crossings, spectrum or correlation ``at`` levels, frequencies or lags of q of mass ``row``,
    from 0, by simulation of the full system or by the method named ``route``."""
    method = method_for(route, threads=1) if route else simulation(**settings)
    q = (Coordinate("q", row),)
    return getattr(method, question)(system, q, np.asarray(at), tol=tol, progress=silent)


def estimated(
    fine: Any, coarse: Any, until: Any, times: Any = (), *, limit: str = "H=1", step: float = 0.0,
    memory: float = 0.0, tol: float | None = None,
) -> Any:  # fmt: skip
    """First passage from failure times (paths,) at half the ``step`` and at it, to ``until``."""
    system = linear(1)
    known: Any = {"start": parse_start("rest", system), "limit": parse_limit(limit, 1)}
    times = np.array(times, dtype=float)
    question = Asked(system, tol, silent, times=times, **known)
    return passage_of(np.stack([fine, coarse, until]), question, tol, step, memory, {})


def slow(*row: Any) -> Any:
    return pytest.param(*row, marks=pytest.mark.slow)


def slow_clock(monkeypatch: Any) -> None:
    """Let the clock of questions gain 0.03 s at each call, however busy the machine is."""
    begin, looks = working_time(), count(1)
    monkeypatch.setattr("sim.questions.rounds.working_time", lambda: begin + 0.03 * next(looks))


def place(ensemble: Any, states: Any) -> None:
    """Put ``ensemble`` in ``states`` (blocks, 2n, LANES); its energy becomes their largest H."""
    ensemble.restore({**ensemble.saved(), "states": states})
    ensemble.energy = float(np.max(ensemble.system.hamiltonian(*ensemble.phase_points())))


def ranged(system: System, names: Any, size: float = 1.0) -> Any:
    """Histograms of the observables ``names`` that cover q, p = ± ``size`` with a margin."""
    q = size * np.array([[-1.0] * system.n, [1.0] * system.n])
    observables = [parse_observable(name, system.n) for name in names]
    reached = extremes(system, observables, q, q)
    return covering(observables, reached, partial(axis_of, system))
