"""Monte Carlo of the averaged equations as a method: paths of the averaged energies.

Theories and sampling are imported when a system is prepared: most commands register these routes
without using them.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Self

import numpy as np

from cases.scene.expect import Theory
from fpk.answer.dynamics import Passage, Transient, require_times
from fpk.answer.method import ROUTES, Method, Plan, Progress, Result, Route, register_route
from fpk.answer.names import Coordinate, Limit, Observable, Start, observable_name
from fpk.answer.question import Asked, answer
from fpk.numeric.arrays import Array
from fpk.numeric.errors import NotApplicable
from fpk.system.escape import require_held
from fpk.system.linear import modal_energies
from fpk.system.process import Process
from fpk.system.system import System
from sim.sample.settings import check_settings

STEP = 0.1
"""Default step in units of the fastest relaxation time; motion in time also runs at half of it."""


@dataclass(frozen=True)
class AveragedSimulation(Method):
    """Averaged energies (17) or energy (9) of a theory by simulation: its ``solver`` "simulation".

    The relaxation time of an energy is ``scale/d``, d the drift at H_i = 0, in which noise fills
    the scale. Paths run for ``BURN_IN`` of the slowest relaxation times and are sampled every half
    of it for ``SAMPLED``; steps are ``step`` times the fastest (``STATIONARY`` times that for
    stationary densities), or from sample to sample if steps are exact. These are constants of
    ``sim.questions.averaged.paths``. Two wells with rare passages relax more slowly. ``paths`` in
    all; ``threads`` None: all cores, on which the answer does not depend. ``tol``: largest expected
    L1 error by chance of a certified answer. ``seconds``: limit of the wall time.

    Raises ``InvalidInput`` naming the field that cannot be used.
    """

    theory: Theory
    paths: int = 8192
    step: float = STEP
    seed: int = 1
    threads: int | None = None
    tol: float | None = None
    seconds: float | None = None

    def __post_init__(self) -> None:
        """Raise ``InvalidInput`` naming the first field that cannot be used."""
        check_settings(self, ("step", "tol", "seconds"))

    @property
    def route(self) -> Route:
        """The route of the method."""
        return ROUTES[self.theory, "simulation"]

    def unasked(self, system: System, *, share: float = 1.0) -> Self:
        """Return the method itself, for any ``share``; ``NotApplicable`` for constant damping."""
        if not system.damping_terms:
            raise NotApplicable("damping is constant: closed-form has the same density")
        return self

    def prepare(self, system: System) -> Plan:
        """Return the plan for ``system``; raise ``NotApplicable`` if the theory does not apply."""
        return Plan(self._unknown, partial(self._sampled, self._process(system)))

    @answer
    def passage(self, asked: Asked) -> Passage:
        """Return the first passage of an energy by simulation in steps of ``step`` and of half it.

        ``tol``, the relative error wanted of the mean, by default that of the method, makes more of
        the ``paths`` where needed. Raises ``NotApplicable`` for limits of displacements, and for
        limits of modal energies by energy averaging. A state begins at its energies, H of the
        integrable theory anywhere on H1 + H2 + … = H.
        """
        from sim.questions.averaged.paths import energy_passage

        require_times(asked.times)
        form = self._form(self._process(asked.system))
        starts = self._starts(asked.system, asked.start)
        return energy_passage(self, form, self.limits(form, asked.limit), starts, asked)

    @answer
    def transient(self, asked: Asked) -> Transient:
        """Return the densities of energies at ``times``, in steps of ``step`` and of half it.

        ``tol``, the expected L1 error wanted at every time, makes more paths. A start is turned
        into energies as by ``passage``.
        """
        from sim.questions.averaged.paths import energy_transient

        require_held(asked.system)
        require_times(asked.times)
        if reason := self._unknown(asked.observable):
            raise NotApplicable(reason)
        form = self._form(self._process(asked.system))
        return energy_transient(self, form, self._starts(asked.system, asked.start), asked)

    def _process(self, system: System) -> Process:
        """Return the averaged process, or raise ``NotApplicable`` if the theory does not apply."""
        from averaging.energy_process import energy_process
        from averaging.modal.analysis import modal_analysis
        from averaging.modal.resonance import require_no_resonance

        if self.theory == "nonintegrable":
            return energy_process(system)
        modes = system.fact(modal_analysis)
        require_no_resonance(system, modes)
        return modes.process()

    def _form(self, process: Process) -> Any:
        from sim.questions.averaged.square_root import line_form, square_root_form

        return (line_form if self.theory == "nonintegrable" else square_root_form)(process)

    def limits(self, form: Any, limit: Limit) -> tuple[Array, Array]:
        """Return weights (limits, d) and values (limits,): passed if any ``weights @ X >= values``.

        X (d,) are the modal energies, or for energy averaging the transform of H by ``form``.
        Raises ``NotApplicable`` for a kind of limit that the theory does not have.
        """
        line, d = self.theory == "nonintegrable", form.scales.size
        if not limit.of_energy or (limit.kind == "modal" and line):
            known = "H" if line else "H and of modal energies"
            raise NotApplicable(f"{limit}: this theory knows limits of {known} only")
        if limit.kind == "modal":
            named = sorted((int(name[1:]) - 1, value) for name, value in limit.values.items())
            values = np.array([value for _, value in named])
            return np.eye(d)[[m for m, _ in named]], values
        values = np.array([limit.value])
        values = form.inverse(values[None])[0] if line else values
        return np.ones((1, d)), values

    def _starts(self, system: System, start: Start) -> Any:
        """Return ``draw(paths, stream)``, the energies (paths, d) at time 0.

        A start ``noise=F`` is the stationary state under F times the noise intensity: its energies
        are sampled by a simulation of ``BURN_IN`` relaxation times under that noise. H of the
        integrable theory is spread evenly over H1 + H2 + … = H, as on its shell. Raises
        ``NotApplicable`` for modal energies where contact leaves H open.
        """
        from sim.questions.averaged.paths import burnt_in

        line, n, values = self.theory == "nonintegrable", system.n, start.values
        if factor := values.get("noise", 0.0):
            louder = replace(system, noise_intensity=factor * system.noise_intensity)
            form = self._form(self._process(louder))
            return partial(burnt_in, self, form)
        if start.kind == "energy" and not line:

            def spread(paths: int, stream: np.random.Generator) -> Array:
                share = stream.exponential(size=(paths, n))
                return np.asarray(values["H"] * share / share.sum(axis=1, keepdims=True))

            return spread
        if start.kind == "energy":
            energies = np.array([values["H"]])
        elif start.kind == "modal":
            if line and system.stops:
                raise NotApplicable(f"{start}: modal energies leave H open where there is contact")
            energies = np.array([values[f"H{m + 1}"] for m in range(n)])
        else:
            q, p = start.state(n)
            total = np.array([float(system.hamiltonian(q, p))])
            energies = total if line else modal_energies(system, q, p)
        fixed = np.atleast_1d(energies.sum()) if line else energies
        return lambda paths, stream: np.tile(fixed, (paths, 1))

    def _unknown(self, observable: Observable) -> str | None:
        """Why the averaged energies do not give the observable, None if they do."""
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
        from sim.questions.averaged.paths import simulate_energies

        form = self._form(process)
        unknown = f"the bias of step = {self.step:g} is not known; use {STEP:g}"
        failures = () if form.damping is None or self.step <= STEP else (unknown,)
        return simulate_energies(self, form, observables, failures, progress)

    def refined(self) -> Self:
        """Return the method with four times the paths and half the step: half of both errors."""
        return replace(self, paths=4 * self.paths, step=0.5 * self.step)


def _register(theory: Theory, words: str, equation: str, colour: str) -> None:
    names, make = (theory, "simulation", words, equation), partial(AveragedSimulation, theory)
    register_route(Route(*names, "averaged", True, colour, make))


_register("nonintegrable", "energy averaging, simulated", "(24)", "#601626")
# The colour of the Gaussian of a linear chain, which has no energies.
_register("integrable", "modal averaging, simulated", "(17)", "#b86cfa")
