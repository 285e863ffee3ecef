"""Stochastic averaging of quasi-non-integrable Hamiltonian systems as a method, section 4."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

from averaging.back_transformation import back_transformed, crossing_rates
from averaging.closed_form import averaged_rate, state_closed_form
from averaging.energy_process import energy_process
from averaging.theory import Theory, energy_only_refusal
from averaging.time import energy
from averaging.time.start import settled_energies
from averaging.weyl import StateDensity, tabulated
from averaging.zero_flux import solved_energies
from fpk.answer.dynamics import Curve, Rates
from fpk.answer.evolution import Passage, Transient
from fpk.answer.method import Plan, Progress, Result
from fpk.answer.observable import Coordinate, Observable
from fpk.answer.question import Asked, answer
from fpk.numeric.errors import NotApplicable
from fpk.solvers.line.stationary import StationarySolution
from fpk.solvers.plane.solution import PlaneSolution
from fpk.system.escape import require_held
from fpk.system.process import Process
from fpk.system.system import System

Settings = dict[str, str | float | int]

MODULATED_TOL = 1e-6
"""Least tolerance by finite elements under modulated noise where none is given: it takes a second;
1e-10 takes ten, of which noise that sets in or ends at 0 may need more than there are steps."""


@dataclass(frozen=True)
class NonIntegrable(Theory):
    """Averaged energy, Eqs. (24)-(28), its stationary density and what follows from it, Eq. (30).

    ``solver``: "fem" solves the FPK equation of the process by finite elements, "scikit-fem" by
    elements of one degree on meshes refined uniformly; "quadrature" evaluates (11); "closed-form"
    is (29) in its general form, for damping that is constant or depends on the energy only. The
    theory is exact where the damping and noise meet (8), an approximation otherwise, and the better
    the more the contacts matter. ::

        fpk.solve(system, ["q2", "H"], methods=[NonIntegrable("fem", tol=1e-8)])

    First passage, the density in time, and the slowest rates::

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

    def prepare(self, system: System) -> Plan:
        """Return the plan for ``system``; raise ``NotApplicable`` where it does not hold."""
        process = energy_process(system)
        exponential = self.solver == "closed-form" and averaged_rate(system).size == 1

        def solve(observables: Sequence[Observable], progress: Progress) -> Result:
            source, settings = self._state_density(system, process)
            densities = tuple(
                back_transformed(source, o, tol=self.wanted(system)) for o in observables
            )
            return Result(self, densities, settings=settings)

        return Plan(partial(energy_only_refusal, system, exponential=exponential), solve)

    @answer
    def crossings(self, asked: Asked) -> Curve:
        """Return the upcrossings per unit time of q, by Rice's formula."""
        source, _ = self._state_density(asked.system, energy_process(asked.system))
        return crossing_rates(
            source, asked.row, asked.at, tol=asked.tol or self.wanted(asked.system)
        )

    @answer
    def transient(self, asked: Asked) -> Transient:
        """Return the densities of the energy, or of one or two of (q, p), at ``times``.

        ``tol`` None: that of the method, but no less than ``MODULATED_TOL`` by finite elements
        under modulated noise.
        """
        system, observable = asked.system, asked.observable
        require_held(system)
        energy_process(system)  # it refuses what has no stationary density
        settled = settled_energies(asked, asked.tol or self._tol_in_time(system))
        if observable != (Coordinate("H"),) and (reason := energy_only_refusal(system, observable)):
            raise NotApplicable(reason)
        return energy.transient(self.solver, settled)

    @answer
    def passage(self, asked: Asked) -> Passage:
        """Return the first passage of the energy through a limit; ``tol`` as of ``transient``."""
        energy_process(asked.system)  # it refuses what has no stationary density
        if asked.limit.kind != "H":
            words = "this theory knows the total energy only; give a limit H=.."
            raise NotApplicable(f"{asked.limit}: {words}")
        tol = asked.tol or self._tol_in_time(asked.system)
        return energy.passage(self.solver, settled_energies(asked, tol))

    @answer
    def relaxation(self, asked: Asked) -> Rates:
        """Return the slowest rates at which the energy forgets its past."""
        require_held(asked.system)
        wanted = asked.tol or self.wanted(asked.system)
        return energy.relaxation(self.solver, replace(asked, tol=wanted))

    def _tol_in_time(self, system: System) -> float:
        modulated = system.modulation is not None and self.solver == "fem"
        return max(self.wanted(system), MODULATED_TOL if modulated else 0.0)

    def _state_density(self, system: System, process: Process) -> tuple[StateDensity, Settings]:
        if self.solver == "closed-form":
            return state_closed_form(system, averaged_rate(system)), {"equation": "(29)"}
        solution = solved_energies(process, self.solver, tol=self.wanted(system))
        assert not isinstance(solution, PlaneSolution)
        settings: Settings = {"equation": "(11)", "panels": solution.nodes.size - 1}
        if isinstance(solution, StationarySolution):
            settings = {
                "equation": "FPK of (24)",
                "degree": solution.degree,
                "elements": solution.nodes.size - 1,
                "unknowns": solution.unknowns,
            }
        settings |= {"last energy": float(solution.nodes[-1]), "tol": self.wanted(system)}
        return tabulated(system, solution), settings


NonIntegrable.register()
