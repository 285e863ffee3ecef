"""Monte Carlo of the averaged equations as a method: the process of a theory, sampled.

Theories and sampling are imported when a system is prepared: most commands register the routes
here without asking for them.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from math import ceil, inf, isfinite
from typing import Self

from cases.scene.expect import Theory
from fpk.cores import usable_cores
from fpk.errors import InvalidInput, NotApplicable
from fpk.method import Method, Plan, Progress, Result
from fpk.observable import Coordinate, Observable, observable_name
from fpk.process import Process
from fpk.route import ROUTES, Route, register
from fpk.system import System

BURN_IN, SAMPLED = 10.0, 20.0
"""Relaxation times that each path runs before it is sampled, and that it is sampled for."""


@dataclass(frozen=True)
class AveragedSimulation(Method):
    """Averaged energies (17) or energy (9) of a theory by simulation: its ``solver`` "simulation".

    Times come from the process: an energy relaxes in about the time in which noise fills its scale,
    ``scale/d``, d the drift at H_i = 0; paths run for ``BURN_IN`` of the slowest and are sampled
    every half of it for ``SAMPLED``, with steps of ``step`` times the fastest, or from sample to
    sample where steps are exact. Two wells with rare passages relax more slowly than that.
    ``paths`` in all; ``threads`` None: all that there are, the answer does not depend on it.
    ``tol``: the expected L1 error by chance above which an answer is not certified.

    Raises ``InvalidInput`` naming the field that cannot be used.
    """

    theory: Theory
    paths: int = 8192
    step: float = 0.1
    seed: int = 1
    threads: int | None = None
    tol: float | None = None

    def __post_init__(self) -> None:
        """Check every field."""
        if not 0 <= self.seed < 2**64:
            raise InvalidInput("seed", self.seed, "use an integer from 0 to 2**64 - 1")
        for key in ("step", "threads", "tol"):
            value = getattr(self, key)
            if value is not None and not (isfinite(value) and value > 0):
                raise InvalidInput(key, value, "must be a finite number > 0")

    @property
    def route(self) -> Route:
        """The route that the method follows."""
        return ROUTES[self.theory, "simulation"]

    def unasked(self, system: System, *, share: float = 1.0) -> Self:
        """Return the method; refuse where damping is constant, so that theories are closed."""
        if not system.damping_terms:
            raise NotApplicable("damping is constant: closed-form has the same density")
        return self

    def prepare(self, system: System) -> Plan:
        """Return the plan for ``system``; raise ``NotApplicable`` where it does not hold."""
        from averaging.energy_process import energy_process
        from averaging.modal.analysis import modal_analysis
        from averaging.modal.resonance import require_no_resonance

        if self.theory == "nonintegrable":
            return Plan(self._unknown, partial(self._sampled, energy_process(system)))
        modes = system.fact(modal_analysis)
        require_no_resonance(system, modes)
        return Plan(self._unknown, partial(self._sampled, modes.process()))

    def _unknown(self, observable: Observable) -> str | None:
        """Why the averaged energies do not give the observable, None where they do."""
        name = observable_name(observable)
        if any(c.kind != "H" for c in observable):
            return f"{name}: the averaged simulation samples energies only; use another solver"
        if self.theory == "nonintegrable" and observable != (Coordinate("H"),):
            return f"{name}: this theory knows the total energy only; ask for H"
        if len(observable) > 1 and any(c.index is None for c in observable):
            return f"{name}: of two quantities, both must be modal energies"
        return None

    def _sampled(
        self, process: Process, observables: Sequence[Observable], progress: Progress
    ) -> Result:
        from sim.averaged.paths import simulate_energies
        from sim.averaged.square_root import line_form, square_root_form

        form = (line_form if self.theory == "nonintegrable" else square_root_form)(process)
        times, exact = form.scales / form.noise, form.damping is None
        slowest, longest = float(times.max()), self.step * float(times.min())
        interval = 0.5 * slowest
        steps = 1 if exact else ceil(interval / longest - 1e-9)
        densities = simulate_energies(
            form,
            observables,
            interval=interval,
            steps=steps,
            time=SAMPLED * slowest,
            burn_in=BURN_IN * slowest,
            paths=self.paths,
            seed=self.seed,
            threads=self.threads or usable_cores(),
            tol=inf if self.tol is None else self.tol,
            progress=progress,
        )
        settings: dict[str, str | float | int] = {
            "equation": self.route.equation,
            "relaxation time": slowest,
            "dt": interval / steps,
            "steps": "exact" if exact else "Strang splitting",
            "paths": self.paths,
            "time": SAMPLED * slowest,
            "seed": self.seed,
        }
        return Result(self, densities, settings=settings)

    def refined(self) -> Self:
        """Return the method with four times the paths and half the step: half of both errors."""
        return replace(self, paths=4 * self.paths, step=0.5 * self.step)


def _register(theory: Theory, words: str, equation: str, colour: str) -> None:
    names, make = (theory, "simulation", words, equation), partial(AveragedSimulation, theory)
    register(Route(*names, "averaged", True, colour, make))


_register("nonintegrable", "energy averaging, simulated", "(24)", "#a8577e")
_register("integrable", "modal averaging, simulated", "(17)", "#9a6fc0")
