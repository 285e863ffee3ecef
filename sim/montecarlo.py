"""Monte Carlo of the full Ito system (6) as a method: sampled densities and answers in time.

The questions import numba and compile code: each is imported when it is first asked.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

from fpk.answer.dynamics import Curve, Passage, Transient
from fpk.answer.method import ROUTES, Method, Plan, Progress, Result, Route, register_route
from fpk.answer.names import Observable
from fpk.answer.question import Asked, answer
from fpk.system.system import System
from sim.sample.settings import Settings, require_stationary


@dataclass(frozen=True)
class MonteCarlo(Settings, Method):
    """Simulation of Eq. (6) with sampling errors from independent batches.

    Times are in the system's unit of time, except for ``seconds`` and ``longest`` (wall time in s).

    ``paths`` trajectories are sampled for ``time`` each, after ``burn_in`` relaxation times.
    ``time`` None: ``relaxations`` relaxation times, but no more than the cost of ``most_steps``
    uniform steps. ``scheme`` is a name in ``sim.step.schemes.SCHEMES``. ``dt`` None:
    ``step_factor`` times the step chosen for the system. ``seed``: of all random numbers.
    ``tol``: sample until the expected L1 error of the first observable, as it is returned at
    points, is below ``tol``, at most for ``longest`` seconds. ``seconds``: sample for this wall
    time in place of ``time`` and ``longest``. These limits include the burn-in but not the
    compilation; an answer whose burn-in or first chunk they cut short is not certified.
    ``step_pair``: run a second simulation at dt/2, in two thirds of ``seconds``, and report the
    difference of each density and moment. ``threads`` None: all cores. ``cluster``: the address of
    a Dask scheduler; the answer depends on neither. ``checkpoint``: a folder where the state is
    saved at intervals and from which a later run continues. ``partial``: Ctrl-C ends the sampling,
    and the answer so far, not certified, is returned. ``allow_unstable``: accept a ``dt`` at or
    above the stability limit; then nothing is certified. All questions but the stationary density
    take the ``scheme`` exact_flow and no ``checkpoint``. ::

        fpk.solve(system, ["q2"], methods=[MonteCarlo(paths=4096, relaxations=40.0, seed=7)])

    Motion in time; the second mass has the row 1::

        short, times = MonteCarlo(paths=4096, relaxations=5.0), np.array([5.0, 10.0])
        at = np.linspace(0.0, 1.0, 5)
        short.passage(system, parse_limit("H=0.3", 2), REST, times).mean
        short.transient(system, parse_observable("H", 2), REST, times, (at,)).values
        q2 = parse_observable("q2", 2)
        short.crossings(system, q2, at).values, short.correlation(system, q2, at).values
        short.spectrum(system, q2, at).values

    Raises ``InvalidInput`` naming the field that cannot be used.
    """

    @property
    def route(self) -> Route:
        """The registered route of method "montecarlo" and solver "simulation"."""
        return ROUTES["montecarlo", "simulation"]

    def prepare(self, system: System) -> Plan:
        """Return the plan; raise ``NotApplicable`` if ``system`` has no stationary density."""
        require_stationary(system)

        def solve(observables: Sequence[Observable], progress: Progress, **beside: Any) -> Result:
            from sim.sample.simulation import sample_stationary

            return sample_stationary(self, system, observables, progress, **beside)

        return Plan(lambda _: None, solve, beside=True)

    @answer
    def passage(self, asked: Asked) -> Passage:
        """Return mean, variance, failure rate and P(T > t) of first passage of ``asked.limit``."""
        from sim.questions.passage import sample_passage

        return sample_passage(self, asked)

    @answer
    def transient(self, asked: Asked) -> Transient:
        """Return densities of ``asked.observable`` at ``asked.times`` and points ``asked.at``."""
        from sim.questions.transient import sample_transient

        return sample_transient(self, asked)

    @answer
    def crossings(self, asked: Asked) -> Curve:
        """Return the stationary upcrossings per unit time of the levels ``asked.at`` by one q."""
        from sim.questions.curves import sample_crossings

        return sample_crossings(self, asked)

    @answer
    def spectrum(self, asked: Asked) -> Curve:
        """Return the two-sided spectrum S of one q at ω = ``asked.at``; ∫ S dω is the variance."""
        from sim.questions.curves import sample_spectrum

        return sample_spectrum(self, asked)

    @answer
    def correlation(self, asked: Asked) -> Curve:
        """Return the autocovariances of one q, about its mean, at the lags ``asked.at``."""
        from sim.questions.curves import sample_correlation

        return sample_correlation(self, asked)

    def refined(self) -> "MonteCarlo":
        """Return a new method with four times the sample, which halves the sampling error.

        ``time``, ``relaxations``, ``longest`` and ``seconds`` are four times as long; ``paths`` and
        ``seed`` stay. ``tol`` is halved. The step that is chosen for the system, not a ``dt``, is
        multiplied by 2**(−1/4), so that the bias of the default scheme halves, too.
        """
        return replace(
            self,
            time=self.time and 4.0 * self.time,
            relaxations=4.0 * self.relaxations,
            most_steps=5 * self.most_steps,  # 4 times the time, in steps 2**(−1/4) as long
            tol=self.tol and 0.5 * self.tol,
            longest=4.0 * self.longest,
            seconds=self.seconds and 4.0 * self.seconds,
            step_factor=self.step_factor * 2.0**-0.25,
        )


register_route(
    Route(
        method="montecarlo",
        solver="simulation",
        words="simulation",
        equation="(6)",
        solves="full",
        sampled=True,
        colour="#b50c01",
        make=MonteCarlo,
    )
)
