"""Hard cases of motion without noise: the energy falls, or stays, and there is no density."""

from dataclasses import replace

import numpy as np
from hard_case import Check, HardCase
from hard_systems import with_stops
from numpy.typing import NDArray

from fpk.answer.names import parse_observable
from fpk.system.system import System
from sim.montecarlo import MonteCarlo
from sim.sample.ensemble import Ensemble
from sim.step.arrays import LANES
from sim.step.schemes import SCHEMES
from sim.step.step_size import chosen_step

Array = NDArray[np.float64]

MANY_STEPS = 1_000_000


def _released(system: System, dt: float) -> Ensemble:
    """Trajectories at rest, pushed into the stops and beside them, up to five kT of the system."""
    ensemble = Ensemble(system, SCHEMES["exact_flow"], dt, LANES, 1, 1)
    states = 0.0 * ensemble.states
    states[0, 1] = np.linspace(-0.7, 0.7, LANES)
    ensemble.restore({**ensemble.saved(), "states": states})
    energy = float(np.max(_energies(system, ensemble)))
    ensemble.energy = energy
    return ensemble


def _without(system: System, *, damping: float) -> System:
    return replace(
        system, damping=damping * system.damping, noise_intensity=0.0 * system.noise_intensity
    )


def _energies(system: System, ensemble: Ensemble) -> Array:
    """H of all trajectories half a kick on: states are stored just before one."""
    q, p = ensemble.phase_points()
    p = p.copy()
    for stop in system.stops:
        sign = 1.0 if stop.side == "right" else -1.0
        overlap = np.maximum(sign * q[:, stop.index] - stop.clearance, 0.0)
        p[:, stop.index] -= 0.5 * ensemble.dt * sign * stop.force(overlap)
    return system.hamiltonian(q, p)


def no_noise() -> HardCase:
    """Damping without noise: the energy falls, and there is no density to ask for."""
    system = _without(with_stops(10.0), damping=1.0)
    dt = chosen_step(with_stops(10.0))
    ensemble, energies = _released(system, dt), []
    for _ in range(200):
        ensemble.advance(round(1.0 / dt))
        energies.append(_energies(system, ensemble))
    levels = np.array(energies)
    # Between two samples the energy of a step may stand above its mean by (ω dt)²/8 or so.
    allowed = 0.1 * levels[:-1] + 1e-12 * levels[0].max()
    rise = float(np.max((levels[1:] - levels[:-1]) - allowed))
    reason = MonteCarlo().refusal(system, parse_observable("q2", system.n)) or "taken"
    return HardCase(
        name="no noise",
        hard="the state decays into a point: no stationary density",
        plain="not run",
        ours=f"energy {levels[0].max():.2g} to {levels[-1].max():.1e}; densities refused",
        certificate=reason,
        checks=(
            Check("the energy falls", rise <= 0.0, f"largest rise beyond the step's {rise:.1e}"),
            Check("and away", bool(levels[-1].max() < 1e-3 * levels[0].max()), "see above"),
            Check("densities refuse", "no noise" in reason, reason),
        ),
    )


def nothing_lost() -> HardCase:
    """No damping, no noise: the energy after a million steps."""
    free = _without(with_stops(10.0), damping=0.0)
    drifts = []
    for part in (4.0, 8.0):
        ensemble = _released(free, chosen_step(with_stops(10.0)) / part)
        before, worst = _energies(free, ensemble), 0.0
        for _ in range(10):
            ensemble.advance(MANY_STEPS // 10)
            change = np.abs(_energies(free, ensemble) - before)
            worst = max(worst, float(np.max(change) / before.max()))
        drifts.append(worst)
    # A symmetric scheme keeps a Hamiltonian that differs from H by (ω dt)²; where a stop is touched
    # its force has no second derivative, and what that adds at random is of a higher order.
    bound, ratio = (0.45 / 4.0) ** 2, drifts[0] / drifts[1]
    return HardCase(
        name="no damping, no noise",
        hard="a million steps in and out of contact, in which a drift of the energy would add up",
        plain="not run",
        ours=f"change of the energy {drifts[0]:.1e} at a quarter of the step, {drifts[1]:.1e} at an"
        " eighth, of the largest",
        certificate="none: no density",
        checks=(
            Check("bounded by (ω dt)²", drifts[0] < bound, f"{drifts[0]:.1e}, bound {bound:.1e}"),
            Check("of second order at least", ratio > 3.0, f"halved step: {ratio:.1f} times less"),
        ),
    )
