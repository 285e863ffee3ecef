"""Stochastic averaging of quasi-integrable Hamiltonian systems as a method, sections 5 and 6.3."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from averaging.modal.analysis import ModalAnalysis, modal_analysis
from averaging.modal.observables import coupling_refusal, gaussian_modes, modal_densities
from averaging.modal.resonance import correlations, nearest_resonance, require_no_resonance
from averaging.modal.time import closed_form, elements
from averaging.theory import Theory
from averaging.time import MODAL_TOL, with_energy_start
from fpk.answer.contacts import CLEARANCE_RULE
from fpk.answer.density import Density
from fpk.answer.dynamics import Curve, Passage, Rates, Transient, certify_curve, upcrossings
from fpk.answer.method import Plan, Progress, Result
from fpk.answer.names import Coordinate, Observable, observable_name
from fpk.answer.question import QUESTIONS, Asked, answer
from fpk.numeric.errors import NotApplicable
from fpk.system.escape import require_held
from fpk.system.modulation import require_constant_noise
from fpk.system.system import System

Answer = TypeVar("Answer", Transient, Passage, Rates)


@dataclass(frozen=True)
class Integrable(Theory):
    """Averaged modal energies, Eqs. (17), (33), their stationary density, Eqs. (34)-(36).

    Contacts are neglected; the result's ``neglected`` says so and evaluates the rule of section
    6.3, clearance > 2 rms. ``solver``: "closed-form" is (34), Π e^(−H_i/θ_i)/θ_i with the modal
    temperatures θ_i = d_i/c*_ii, whose displacements and momenta are Gaussian; "quadrature"
    evaluates (11), "fem" and "scikit-fem" (on uniformly refined meshes) solve the FPK equation;
    with constant damping these three give modal energies only. The theory assumes light damping, is
    refused near an internal resonance, and is exact if there are no contacts and (8) holds.

    Damping that depends on the state is averaged over the phases. It may couple the energies of two
    modes, whose joint density "fem" and "scikit-fem" solve for; three coupled energies are refused.
    Every solver then gives every observable, displacements and momenta by the characteristic
    function of the energies. ::

        fpk.solve(system, ["H1,H2"], methods=[Integrable("fem", tol=1e-9)])

    First passage, density in time, relaxation rates and crossings::

        times, at = np.array([10.0]), (np.array([0.1, 0.5]),)
        free = fpk.System([1, 1], [1, 1], [0.08, 0.04], [0.01, 0.02])
        Integrable().passage(free, parse_limit("H1=0.8", 2), REST, times).mean
        Integrable().transient(free, parse_observable("H1", 2), REST, times, at).values
        Integrable().relaxation(free, 3).values
        Integrable().crossings(free, parse_observable("q2", 2), np.array([0.0, 0.5])).values
    """

    method = "integrable"
    solvers = (
        ("closed-form", "modal averaging, closed form", "(34)"),
        ("fem", "modal averaging, finite elements", "(19)"),
        ("quadrature", "modal averaging, quadrature", "(11)"),
        ("scikit-fem", "modal averaging, scikit-fem", "(19)"),
    )
    solves = "averaged"
    colour = "#00a688"

    def prepare(self, system: System) -> Plan:
        """Return the plan for ``system``.

        Raises ``NotApplicable`` near a resonance, and for coupled modes that the solver refuses.
        """
        modes = system.fact(modal_analysis)
        require_no_resonance(system, modes)
        if reason := coupling_refusal(modes, self.solver):
            raise NotApplicable(reason)

        def solve(observables: Sequence[Observable], progress: Progress) -> Result:
            left_out = _contacts_left_out(system, modes)
            of_state = "" if modes.constant else ", damping of the state averaged"
            settings: dict[str, str | float | int] = {
                "equation": self.route.equation + of_state,
                "tol": self.tol_for(system),
                "nearest resonance": nearest_resonance(system, modes),
            }
            if modes.n > 1:
                settings["neglected correlation of modes"] = float(correlations(modes).max())
            densities = modal_densities(modes, observables, self.solver, tol=self.tol_for(system))
            neglected = "".join(left_out.values())
            return Result(self, densities, settings=settings | left_out, neglected=neglected)

        return Plan(lambda observable: self._refusal(observable, modes), solve)

    @answer
    def crossings(self, asked: Asked) -> Curve:
        """Return the upcrossings per unit time of levels by q, from the joint density of (q, p)."""
        system, row = asked.system, asked.row
        q, p = Coordinate("q", row), Coordinate("p", row)
        of_both, of_q = self.solve(system, [(q, p), (q,)], progress=asked.progress).densities
        assert isinstance(of_both, Density) and isinstance(of_q, Density)
        mass = float(system.mass[row])
        values, errors = upcrossings(of_both, mass, asked.at)
        velocity = float(np.sqrt(of_both.moment(0, 2).value)) / mass
        scale = QUESTIONS["crossings"].scale(of_q.rms().value, velocity)
        tol = asked.tol or self.tol_for(system)
        return certify_curve(values, errors, scale=scale, of=of_q, tol=tol)

    @answer
    def transient(self, asked: Asked) -> Transient:
        """Return densities of modal energies, of their sum, or of one or two of (q, p)."""
        return self._in_time(Transient, "transient", asked)

    @answer
    def passage(self, asked: Asked) -> Passage:
        """Return the first passage of limits by modal energies or by their sum."""
        return self._in_time(Passage, "passage", asked)

    @answer
    def relaxation(self, asked: Asked) -> Rates:
        """Return the ``asked.count`` slowest relaxation rates of the modal energies, 1/time."""
        return self._in_time(Rates, "relaxation", asked)

    def _in_time(self, kind: type[Answer], question: str, asked: Asked) -> Answer:
        """Return the answer of type ``kind`` to ``question``: transient, passage or relaxation.

        The tolerance is ``MODAL_TOL`` if ``asked`` has none. Raises ``NotApplicable`` near a
        resonance, for coupled modes that the solver refuses, for a solver other than "closed-form"
        and "fem", and for passage and relaxation under modulated noise.
        """
        system, tol = asked.system, asked.tol or MODAL_TOL
        if question != "passage":
            require_held(system)
        if question != "transient":
            require_constant_noise(system.modulation)
        modes = system.fact(modal_analysis)
        require_no_resonance(system, modes)
        if self.solver in ("quadrature", "scikit-fem"):
            raise NotApplicable(f"{self.solver} gives stationary densities; use closed-form or fem")
        if reason := coupling_refusal(modes, self.solver):
            raise NotApplicable(reason)
        by = closed_form if self.solver == "closed-form" else elements
        if question == "relaxation":
            answer: Answer = by.relaxation(modes, asked.count, tol=tol)
        else:
            answer = getattr(by, question)(modes, with_energy_start(asked, tol, modes))
        return replace(answer, settings={**answer.settings, **_contacts_left_out(system, modes)})

    def _refusal(self, observable: Observable, modes: ModalAnalysis) -> str | None:
        """Return in words why the solver does not give ``observable``, None if it does."""
        name, kinds = observable_name(observable), [c.kind for c in observable]
        total = any(c.kind == "H" and c.index is None for c in observable)
        if len(set(kinds) - {"q", "p"}) and (total or set(kinds) != {"H"}) and len(kinds) > 1:
            return f"{name}: of two quantities, both must be modal energies, or q and p"
        if modes.constant and self.solver != "closed-form" and (total or kinds[0] != "H"):
            return f"{name}: by {self.solver}, only modal energies H1, H2, … ; use closed-form"
        return None


def _contacts_left_out(system: System, modes: ModalAnalysis) -> dict[str, str]:
    """Return the setting {"contacts left out": words}, empty if there are no stops.

    The words state the number of stops, the smallest clearance over the rms displacement without
    contact, and whether the rule of section 6.3 holds.
    """
    if not system.stops:
        return {}
    rms = np.linalg.norm(gaussian_modes(modes).factor[: system.n], axis=1)
    ratio, mass = min((s.clearance / rms[s.index], s.mass) for s in system.stops)
    holds = "holds" if ratio > CLEARANCE_RULE else "does not hold"
    rule = f"the rule clearance > {CLEARANCE_RULE:g} rms {holds}"
    words = f"{len(system.stops)}; {rule}: least is {ratio:.3g} rms at mass {mass}"
    return {"contacts left out": words}


Integrable.register()
