"""Transients, first passage and relaxation of the averaged total energy of a system.

No other energy acts on it. By finite elements, or, without contact, as a square-root process.
"""

from dataclasses import replace
from functools import partial

import numpy as np
from scipy.linalg import block_diag

from averaging.energy_process import damping_and_noise, energy_process
from averaging.gaussian_state import state_rows
from averaging.modal.time.closed_form import orbit_transient
from averaging.time.start import FROM_NOISE, DensityQuestion, EnergyStart
from averaging.time.states import state_transient
from fpk.answer.dynamics import Rates
from fpk.answer.evolution import Passage, Transient, checked_times
from fpk.answer.observable import Coordinate
from fpk.numeric.arrays import Array
from fpk.numeric.errors import NotApplicable
from fpk.solvers.line.time.modulated import modulated_transient, modulated_transition
from fpk.solvers.line.time.passage import fem_passage, modulated_passage
from fpk.solvers.line.time.spectrum import spectrum
from fpk.solvers.line.time.transition import Source, transition
from fpk.solvers.square_root import SquareRoot
from fpk.system.modulation import ROUND_OFF, require_constant_noise
from fpk.system.process import Process
from fpk.system.system import System


def transient(system: System, solver: str, asked: DensityQuestion) -> Transient:
    """Return the densities of the energy, or of one or two of (q, p).

    Raises ``InvalidInput`` at the time 0 of an energy.
    """
    start, times, tol, modulation = asked.start, asked.times, asked.tol, system.modulation
    of_energy = asked.observable == (Coordinate("H"),)
    checked_times(times, positive=start.noise is None or (solver == "fem" and not of_energy))
    energy = float(start.energies[0])
    if solver != "fem":
        closed = square_root(system, solver)
        if of_energy:
            return closed.transient(energy, start.noise, times, asked.at[0], tol=tol)
        rows = state_rows(asked.observable, system.n)
        # At temperature 1; K and M are not coupled.
        shape = block_diag(system.compliance, np.diag(system.mass))[np.ix_(rows, rows)]
        return orbit_transient([(closed, energy, shape)], asked)

    source = _source(system, start)
    if modulation is None:
        solved = transition(energy_process(system), source, times, tol=tol)
    elif of_energy:
        return modulated_transient(
            partial(_process, system), modulation, source, times, asked.at[0], tol=tol
        )
    elif not modulation.last and times[-1] > modulation.times[-1]:
        raise NotApplicable(
            "after the end of the noise fem gives densities of the energy only, not of q, p"
        )
    else:
        under = partial(_process, system)
        solved = modulated_transition(under, modulation, source, times, tol=tol)
    if not of_energy:
        return state_transient(system, solved, asked)
    numbers = solved.density(asked.at[0])
    return Transient(times, *numbers, "numerical", solved.certificate, solved.settings)


def passage(
    system: System, solver: str, start: EnergyStart, limit: float, times: Array, *, tol: float
) -> Passage:
    """Return the first passage of ``limit`` from a start below it."""
    checked_times(times)
    source, modulation = _source(system, start), system.modulation
    if solver == "fem" and modulation is not None:
        under = partial(_process, system)
        return modulated_passage(under, modulation, source, limit, times, tol=tol)
    if solver == "fem":
        return fem_passage(energy_process(system), limit, source, times, tol=tol)
    closed = square_root(system, solver)
    if start.noise is not None:
        raise NotApplicable(FROM_NOISE)
    return closed.passage(limit, source.energy, times, tol=tol)


def relaxation(system: System, solver: str, count: int, *, tol: float) -> Rates:
    """Return the ``count`` least rates."""
    process = energy_process(system)
    require_constant_noise(system.modulation)
    if solver == "fem":
        return spectrum(process, count, tol=tol)
    return square_root(system, solver).rates(count, tol=tol)


def square_root(system: System, solver: str) -> SquareRoot:
    """Return the total energy without contact, where τ = H/n.

    dH = (n d − c H) dt + √(2 d H) dB with c = Σ (c_ii/m_i)/n and d = Σ (D_ii/m_i)/n. Raises
    ``NotApplicable`` where it is no such process, or the ``solver`` is none for questions of time.
    """
    if solver != "closed-form":
        raise NotApplicable(
            "quadrature gives stationary densities only; in time, use fem or closed-form"
        )
    if system.contacts or system.damping_terms:
        what = "contacts" if system.contacts else "damping terms"
        raise NotApplicable(f"the system has {what}: in time there is no closed form; use fem")
    (damping, noise), n = damping_and_noise(system), system.n
    error = ROUND_OFF if system.modulation else 0.0
    return SquareRoot(n, damping / n, noise / n, error, system.modulation)


def _process(system: System, factor: float) -> Process:
    """The averaged energy under ``factor`` times the noise intensity."""
    if factor == 1.0:
        return energy_process(system)
    return energy_process(replace(system, noise_intensity=factor * system.noise_intensity))


def _source(system: System, start: EnergyStart) -> Source:
    if start.noise is None:
        return Source(float(start.energies[0]))
    return Source(process=_process(system, start.noise))
