"""Averaged energies at the time 0, of the starts that a user names."""

from dataclasses import dataclass

import numpy as np

from averaging.modal.analysis import ModalAnalysis
from fpk.arrays import Array
from fpk.errors import InvalidInput, NotApplicable
from fpk.limit import Limit
from fpk.observable import number_text
from fpk.start import Start
from fpk.system import System

FROM_NOISE = "from a stationary state first passage has no closed form; use fem"


@dataclass(frozen=True, eq=False)
class EnergyStart:
    """The ``energies`` at time 0, or the multiple ``noise`` of D under which they are stationary.

    ``energies`` are those of the modes (n,), or the total energy (1,); 0 where ``noise`` is given.
    """

    energies: Array
    noise: float | None = None

    def require_below(self, limit: Limit) -> None:
        """Raise ``InvalidInput`` where an energy, or the sum of all, is at or beyond its limit."""
        reached = {f"H{m + 1}": float(H) for m, H in enumerate(self.energies)}
        reached["H"] = sum(reached.values())
        if any(reached[name] >= value for name, value in limit.values.items()):
            given = ",".join(map(number_text, self.energies.tolist()))
            raise InvalidInput("start", given, f"must be below the limit {limit}")


def total_energy_start(system: System, start: Start) -> EnergyStart:
    """Return where the total energy begins; raise ``NotApplicable`` for energies of the modes."""
    if start.rest or start.kind == "noise":
        return EnergyStart(np.zeros(1), start.values.get("noise") or None)
    if start.kind == "modal":
        raise NotApplicable("this theory knows the total energy only; start from H=.. or a state")
    if start.kind == "energy":
        return EnergyStart(np.array([start.values["H"]]))
    return EnergyStart(np.array([float(system.hamiltonian(*start.state(system.n)))]))


def modal_start(system: System, modes: ModalAnalysis, start: Start) -> EnergyStart:
    """Return where the modal energies begin.

    Raises ``NotApplicable`` for a total energy that the modes share in an unknown way.
    """
    n = system.n
    if start.rest or start.kind == "noise":
        return EnergyStart(np.zeros(n), start.values.get("noise") or None)
    if start.kind == "modal":
        return EnergyStart(np.array([start.values[f"H{i + 1}"] for i in range(n)]))
    if start.kind == "energy" and n == 1:
        return EnergyStart(np.array([start.values["H"]]))
    if start.kind == "energy":
        raise NotApplicable(
            f"{start}: give every modal energy, H1=..,H2=..: their sum is not enough"
        )
    q, p = start.state(n)
    T, omega = modes.mode_shapes, modes.natural_frequency
    Q, P = T.T @ (system.mass * q), T.T @ p
    return EnergyStart(0.5 * (P**2 + (omega * Q) ** 2))
