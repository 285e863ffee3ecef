"""Stochastic averaging of quasi-non-integrable Hamiltonian systems as a method, section 4."""

from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy.linalg import block_diag

from averaging.energy_process import (
    damping_and_noise,
    energy_process,
    rate_by_energy,
    state_closed_form,
)
from averaging.gaussian import state_rows
from averaging.modal.time.closed_form import energy_transient, orbit_transient
from averaging.theory import EnergyTheory, energy_only_refusal
from averaging.time import modal_limits, state_transient, with_energy_start
from averaging.weyl import StateDensity, density_by_tables
from averaging.zero_flux import solve_energies
from fpk.answer.dynamics import Passage, Rates, Transient, require_times
from fpk.answer.names import Coordinate
from fpk.answer.question import Asked, answer
from fpk.numeric.arrays import EPS, LARGEST_LOG
from fpk.numeric.errors import NotApplicable
from fpk.solvers.line.stationary import StationarySolution
from fpk.solvers.line.time.modulated import transient_with_modulation, transition_with_modulation
from fpk.solvers.line.time.passage import fem_passage, passage_with_modulation
from fpk.solvers.line.time.resolvent import relaxation_spectrum
from fpk.solvers.line.time.transition import Source, transition
from fpk.solvers.plane.solution import PlaneSolution
from fpk.solvers.square_root import SquareRoot
from fpk.system.escape import require_held
from fpk.system.modulation import require_constant_noise
from fpk.system.process import Process
from fpk.system.system import System

MODULATED_TOL = 1e-6
"""Smallest default tolerance by finite elements under modulated noise: it takes a second, 1e-10
takes ten, and may need more time steps than allowed if the noise begins or ends at 0."""


@dataclass(frozen=True)
class NonIntegrable(EnergyTheory):
    """Averaged total energy, Eqs. (24)-(28): its stationary density, and the marginals by Eq. (30).

    ``solver``: "fem" solves the FPK equation of the process by finite elements, "scikit-fem" by
    elements of one degree on uniformly refined meshes; "quadrature" evaluates (11); "closed-form"
    is (29) in its general form, for damping that is constant or depends on the energy only. The
    theory is exact if (8) holds; otherwise its error falls as contacts mix the modes more. ::

        fpk.solve(system, ["q2", "H"], methods=[NonIntegrable("fem", tol=1e-8)])

    First passage, density in time, relaxation rates and crossings::

        times, at = np.array([10.0]), (np.array([0.1, 0.5]),)
        NonIntegrable().passage(system, parse_limit("H=1", 2), REST, times).mean
        NonIntegrable().transient(system, parse_observable("H", 2), REST, times, at).values
        NonIntegrable().relaxation(system, 3).values
        NonIntegrable().crossings(system, parse_observable("q2", 2), np.array([0.0, 0.5])).values
    """

    solver: str = "fem"
    method = "nonintegrable"
    solvers = (
        ("fem", "energy averaging, finite elements", "(24)"),
        ("closed-form", "energy averaging, closed form", "(29)"),
        ("quadrature", "energy averaging, quadrature", "(11)"),
        ("scikit-fem", "energy averaging, scikit-fem", "(24)"),
    )
    solves = "averaged"
    colour = "#e07500"

    def exponential(self, system: System) -> bool:
        """Return whether u is computed as C exp(−αH): in closed form, with constant damping.

        Raises ``NotApplicable`` as ``energy_process`` does, in closed form as ``rate_by_energy``.
        """
        system.fact(energy_process)
        return self.solver == "closed-form" and rate_by_energy(system).size == 1

    @answer
    def transient(self, asked: Asked) -> Transient:
        """Return the densities of the energy, or of one or two of (q, p), at ``asked.times``.

        Without a tolerance ``tol_for`` gives it, at least ``MODULATED_TOL`` by finite elements
        under modulated noise. Raises ``InvalidInput`` for the time 0 if the start is a known energy
        or, by finite elements, if q or p is observed; ``NotApplicable`` for modal energies, by
        finite elements as ``state_transient`` and for q or p after modulated noise has ended at 0,
        by other solvers as ``square_root``.
        """
        system, observable, modulation = asked.system, asked.observable, asked.system.modulation
        require_held(system)
        process = system.fact(energy_process)
        asked = self._settled(asked)
        start, times, at, tol = asked.start, asked.times, asked.at, asked.tol
        of_energy = observable == (Coordinate("H"),)
        if not of_energy and (reason := energy_only_refusal(system, observable)):
            raise NotApplicable(reason)
        by_elements = self.solver == "fem"
        require_times(times, positive=start.noise is None or (by_elements and not of_energy))
        if not by_elements:
            closed, energy = square_root(system, self.solver), float(start.energies[0])
            if of_energy:
                return energy_transient([(closed, energy)], asked)
            rows = state_rows(observable, system.n)
            # At temperature 1; K and M are not coupled.
            shape = block_diag(system.compliance, np.diag(system.mass))[np.ix_(rows, rows)]
            return orbit_transient([(closed, energy, shape)], asked)
        source, under = _initial_density(asked), partial(_under, system)
        if modulation is None:
            solved = transition(process, source, times, tol=tol)
        elif of_energy:
            return transient_with_modulation(under, modulation, source, times, at[0], tol=tol)
        elif not modulation.last and times[-1] > modulation.times[-1]:
            raise NotApplicable(
                "after the end of the noise fem gives densities of the energy only, not of q, p"
            )
        else:
            solved = transition_with_modulation(under, modulation, source, times, tol=tol)
        if not of_energy:
            return state_transient(solved, asked)
        numbers = solved.density(at[0])
        return Transient(times, *numbers, "numerical", solved.certificate, solved.settings)

    @answer
    def passage(self, asked: Asked) -> Passage:
        """Return the first passage of the limit ``asked.limit`` by the energy H.

        Tolerance: see ``transient``. Raises ``NotApplicable`` for a limit of any other quantity and
        by other solvers than "fem" as ``square_root`` and for a stationary start, ``InvalidInput``
        for a start at or above the limit.
        """
        system, process = asked.system, asked.system.fact(energy_process)
        if asked.limit.kind != "H":
            words = "this theory knows the total energy only; give a limit H=.."
            raise NotApplicable(f"{asked.limit}: {words}")
        asked = self._settled(asked)
        modal_limits(asked.limit, asked.start)
        limit, times = asked.limit.value, require_times(asked.times)
        if self.solver != "fem":
            closed, energies = square_root(system, self.solver), asked.start.known()
            return closed.passage(limit, float(energies[0]), times, tol=asked.tol)
        source, modulation = _initial_density(asked), system.modulation
        if modulation is None:
            return fem_passage(process, limit, source, times, tol=asked.tol)
        under = partial(_under, system)
        return passage_with_modulation(under, modulation, source, limit, times, tol=asked.tol)

    @answer
    def relaxation(self, asked: Asked) -> Rates:
        """Return the ``asked.count`` smallest positive eigenvalues of −L, 1/time, ascending.

        L is the generator of the energy. Raises ``NotApplicable`` if the noise is modulated, and by
        other solvers than "fem" as ``square_root``.
        """
        system, tol = asked.system, asked.tol or self.tol_for(asked.system)
        require_held(system)
        process = system.fact(energy_process)
        require_constant_noise(system.modulation)
        if self.solver == "fem":
            return relaxation_spectrum(process, asked.count, tol=tol)
        return square_root(system, self.solver).rates(asked.count, tol=tol)

    def _settled(self, asked: Asked) -> Asked:
        """Return a copy of ``asked`` with an ``EnergyStart`` and a tolerance (``transient``)."""
        modulated = asked.system.modulation is not None and self.solver == "fem"
        default = max(self.tol_for(asked.system), MODULATED_TOL if modulated else 0.0)
        return with_energy_start(asked, asked.tol or default)

    def state(self, system: System) -> tuple[StateDensity, dict[str, str | float | int]]:
        """Return u = p/T, p the density of the averaged energy, and the settings of the solver.

        They are "equation", and unless in closed form "last energy", "tol" and "panels", or by
        elements "degree", "elements" and "unknowns".
        """
        if self.solver == "closed-form":
            return state_closed_form(system, rate_by_energy(system)), {"equation": "(29)"}
        tol = self.tol_for(system)
        solution = solve_energies(system.fact(energy_process), self.solver, tol=tol)
        assert not isinstance(solution, PlaneSolution)
        settings: dict[str, str | float | int] = {"equation": "FPK of (24)"}
        if isinstance(solution, StationarySolution):
            numbers = {"degree": solution.degree, "elements": solution.nodes.size - 1}
            settings |= {**numbers, "unknowns": solution.unknowns}
        else:
            settings = {"equation": "(11)", "panels": solution.nodes.size - 1}
        settings |= {"last energy": float(solution.nodes[-1]), "tol": tol}
        return density_by_tables(system, solution), settings


def square_root(system: System, solver: str) -> SquareRoot:
    """Return the averaged energy without contact, dH = (n d − c H) dt + √(2 d H) dB.

    n is the number of masses, c = Σ (c_ii/m_i)/n, d = Σ ((f D fᵀ)_ii/m_i)/n, with the
    modulation of the noise. Raises ``NotApplicable`` if it has contacts or damping terms, or if
    ``solver`` is not "closed-form".
    """
    if solver != "closed-form":
        raise NotApplicable(f"{solver} gives stationary densities only; use fem or closed-form")
    if system.contacts or system.damping_terms:
        what = "contacts" if system.contacts else "damping terms"
        raise NotApplicable(f"the system has {what}: in time there is no closed form; use fem")
    (damping, noise), n = damping_and_noise(system), system.n
    error = LARGEST_LOG * EPS if system.modulation else 0.0
    return SquareRoot(n, damping / n, noise / n, error, system.modulation)


def _under(system: System, factor: float) -> Process:
    """Return the averaged energy process of ``system`` with D replaced by ``factor`` D.

    σ² and the noise part of the drift are multiplied by ``factor``, the damping part stays. Raises
    ``NotApplicable`` for ``factor`` 0.
    """
    if factor == 1.0:  # computed once and stored in the system
        return system.fact(energy_process)
    return energy_process(replace(system, noise_intensity=factor * system.noise_intensity))


def _initial_density(asked: Asked) -> Source:
    """Return the initial density: a known energy, or stationary under ``start.noise`` times D."""
    if asked.start.noise is None:
        return Source(float(asked.start.energies[0]))
    return Source(process=_under(asked.system, asked.start.noise))


NonIntegrable.register()
