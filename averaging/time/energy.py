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
from averaging.time.start import FROM_NOISE, EnergyStart, limited_modes
from averaging.time.states import state_transient
from fpk.answer.dynamics import Rates
from fpk.answer.evolution import Passage, Transient, checked_times
from fpk.answer.observable import Coordinate
from fpk.answer.question import Asked
from fpk.numeric.errors import NotApplicable
from fpk.solvers.line.time.modulated import Modulated, modulated_transient, modulated_transition
from fpk.solvers.line.time.passage import fem_passage, modulated_passage
from fpk.solvers.line.time.spectrum import spectrum
from fpk.solvers.line.time.transition import Source, transition
from fpk.solvers.square_root import SquareRoot
from fpk.system.modulation import ROUND_OFF, require_constant_noise
from fpk.system.process import Process
from fpk.system.system import System


def transient(solver: str, asked: Asked) -> Transient:
    """Return the densities of the energy, or of one or two of (q, p).

    ``asked`` is settled by ``settled_energies``. Raises ``InvalidInput`` at the time 0 of an
    energy.
    """
    system, start, times, tol = asked.system, asked.start, asked.times, asked.tol
    modulation = system.modulation
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
        motion = Modulated(partial(_process, system), modulation, source)
        return modulated_transient(motion, times, asked.at[0], tol=tol)
    elif not modulation.last and times[-1] > modulation.times[-1]:
        raise NotApplicable(
            "after the end of the noise fem gives densities of the energy only, not of q, p"
        )
    else:
        motion = Modulated(partial(_process, system), modulation, source)
        solved = modulated_transition(motion, times, tol=tol)
    if not of_energy:
        return state_transient(solved, asked)
    numbers = solved.density(asked.at[0])
    return Transient(times, *numbers, "numerical", solved.certificate, solved.settings)


def passage(solver: str, asked: Asked) -> Passage:
    """Return the first passage of a limit of the energy from a start below it."""
    system, tol, times = asked.system, asked.tol, checked_times(asked.times)
    limited_modes(asked.limit, asked.start)
    limit, source, modulation = asked.limit.value, _source(system, asked.start), system.modulation
    if solver == "fem" and modulation is not None:
        motion = Modulated(partial(_process, system), modulation, source)
        return modulated_passage(motion, limit, times, tol=tol)
    if solver == "fem":
        return fem_passage(energy_process(system), limit, source, times, tol=tol)
    closed = square_root(system, solver)
    if asked.start.noise is not None:
        raise NotApplicable(FROM_NOISE)
    return closed.passage(limit, source.energy, times, tol=tol)


def relaxation(solver: str, asked: Asked) -> Rates:
    """Return the ``count`` least rates."""
    process = energy_process(asked.system)
    require_constant_noise(asked.system.modulation)
    if solver == "fem":
        return spectrum(process, asked.count, tol=asked.tol)
    return square_root(asked.system, solver).rates(asked.count, tol=asked.tol)


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
