"""Transients, first passage and relaxation of one averaged energy of a system."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import block_diag

from averaging.energy_process import damping_and_noise, energy_process
from averaging.gaussian_state import state_rows
from averaging.time.orbits import OrbitPart, orbit_transient
from averaging.time.start import FROM_NOISE, DensityQuestion, EnergyStart
from averaging.time.states import state_transient
from fpk.arrays import Array
from fpk.dynamics import Rates
from fpk.errors import NotApplicable
from fpk.evolution import Passage, Transient, checked_times
from fpk.line.time.modulated import modulated_transient, modulated_transition
from fpk.line.time.passage import fem_passage, modulated_passage
from fpk.line.time.spectrum import spectrum
from fpk.line.time.transition import Source, transition
from fpk.modulation import ROUND_OFF, Modulation, require_constant_noise
from fpk.process import Process
from fpk.square_root import SquareRoot
from fpk.system import System

STATIONARY_ONLY = "quadrature gives stationary densities only; in time, use fem or closed-form"
AFTER_THE_NOISE = "after the end of the noise fem gives densities of the energy only, not of q, p"


@dataclass(frozen=True)
class OneEnergy:
    """An averaged energy that no other acts on, and how its equation is solved in time.

    ``under(F)`` is the process under F times the noise intensity. ``closed`` is the same process
    where it is the square-root process, ``reason`` why it is not. ``modulation`` is of the noise.
    """

    under: Callable[[float], Process]
    closed: SquareRoot | None
    reason: str = ""
    modulation: Modulation | None = None

    def transient(self, solver: str, asked: DensityQuestion) -> Transient:
        """Return the densities of the energy; ``InvalidInput`` at the time 0 of an energy."""
        start, times, (at,), tol = asked.start, asked.times, asked.at, asked.tol
        checked_times(times, positive=start.noise is None)
        if solver == "fem" and self.modulation is not None:
            return modulated_transient(
                self.under, self.modulation, self._source(start), times, at, tol=tol
            )
        if solver == "fem":
            solved = transition(self.under(1.0), self._source(start), times, tol=tol)
            numbers = solved.density(at)
            return Transient(times, *numbers, "numerical", solved.certificate, solved.settings)
        closed = self._closed(solver)
        return closed.transient(float(start.energies[0]), start.noise, times, at, tol=tol)

    def state_transient(self, system: System, solver: str, asked: DensityQuestion) -> Transient:
        """Return the densities of one or two of (q, p) of ``system``, whose energy this is."""
        start, times, tol = asked.start, asked.times, asked.tol
        checked_times(times, positive=start.noise is None or solver == "fem")
        if solver == "fem":
            source, e = self._source(start), self.modulation
            if e is None:
                solved = transition(self.under(1.0), source, times, tol=tol)
            elif not e.last and times[-1] > e.times[-1]:
                raise NotApplicable(AFTER_THE_NOISE)
            else:
                solved = modulated_transition(self.under, e, source, times, tol=tol)
            return state_transient(system, solved, asked)
        closed, rows = self._closed(solver), state_rows(asked.observable, system.n)
        # At temperature 1; K and M are not coupled.
        shape = block_diag(system.compliance, np.diag(system.mass))[np.ix_(rows, rows)]
        part = OrbitPart(closed, float(start.energies[0]), shape)
        return orbit_transient([part], asked)

    def passage(
        self, solver: str, start: EnergyStart, limit: float, times: Array, *, tol: float
    ) -> Passage:
        """Return the first passage of ``limit`` from a start below it."""
        checked_times(times)
        if solver == "fem" and self.modulation is not None:
            asked = self.under, self.modulation, limit, self._source(start), times
            return modulated_passage(*asked, tol=tol)
        if solver == "fem":
            return fem_passage(self.under(1.0), limit, self._source(start), times, tol=tol)
        closed = self._closed(solver)
        if start.noise is not None:
            raise NotApplicable(FROM_NOISE)
        return closed.passage(limit, float(start.energies[0]), times, tol=tol)

    def relaxation(self, solver: str, count: int, *, tol: float) -> Rates:
        """Return the ``count`` least rates."""
        require_constant_noise(self.modulation)
        if solver == "fem":
            return spectrum(self.under(1.0), count, tol=tol)
        return self._closed(solver).rates(count, tol=tol)

    def _source(self, start: EnergyStart) -> Source:
        if start.noise is None:
            return Source(float(start.energies[0]))
        return Source(process=self.under(start.noise))

    def _closed(self, solver: str) -> SquareRoot:
        if solver != "closed-form":
            raise NotApplicable(STATIONARY_ONLY)
        if self.closed is None:
            raise NotApplicable(f"{self.reason}: in time there is no closed form; use fem")
        return self.closed


def total_energy(system: System) -> OneEnergy:
    """Return the averaged total energy, Eq. (24).

    Without contact τ = H/n, so that dH = (n d − c H) dt + √(2 d H) dB with c = Σ (c_ii/m_i)/n and
    d = Σ (D_ii/m_i)/n: a square-root process.
    """

    def under(factor: float) -> Process:
        return energy_process(_with_noise(system, factor))

    energy_process(system)  # it refuses what has no stationary density
    if system.contacts or system.damping_terms:
        what = "contacts" if system.contacts else "damping terms"
        return OneEnergy(under, None, f"the system has {what}", system.modulation)
    damping, noise = damping_and_noise(system)
    n = system.n
    modulation = system.modulation
    error = ROUND_OFF if modulation else 0.0
    closed = SquareRoot(n, damping / n, noise / n, error, modulation)
    return OneEnergy(under, closed, modulation=modulation)


def _with_noise(system: System, factor: float) -> System:
    if factor == 1.0:
        return system
    return replace(system, noise_intensity=factor * system.noise_intensity)
