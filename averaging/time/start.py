"""Where energies begin in time, and the observables and limits of modal energies."""

from dataclasses import dataclass, replace

import numpy as np

from averaging.modal.analysis import ModalAnalysis
from fpk.answer.limit import Limit
from fpk.answer.observable import Observable, number_text, observable_name
from fpk.answer.question import Asked
from fpk.numeric.arrays import Array
from fpk.numeric.errors import InvalidInput, NotApplicable

TOL = 1e-8
"""Error of answers in time of modal energies where none is named."""


@dataclass(frozen=True, eq=False)
class EnergyStart:
    """The ``energies`` at time 0, or the multiple ``noise`` of D under which they are stationary.

    ``energies`` are those of the modes (n,), or the total energy (1,); 0 where ``noise`` is given.
    """

    energies: Array
    noise: float | None = None

    def known(self) -> Array:
        """Return the energies; raise ``NotApplicable`` where the start is a stationary state."""
        if self.noise is not None:
            words = "from a stationary state first passage has no closed form; use fem"
            raise NotApplicable(words)
        return self.energies


def settled_energies(asked: Asked, tol: float, modes: ModalAnalysis | None = None) -> Asked:
    """Return the question from the total energy, or from the energies of the ``modes``, to ``tol``.

    Its ``start`` is an ``EnergyStart``. Raises ``NotApplicable`` for energies of the modes where
    the total energy is asked for, and for a total energy that several modes share in an unknown
    way.
    """
    start, system, n = asked.start, asked.system, 1 if modes is None else modes.n
    values, noise = start.values, None
    if start.rest or start.kind == "noise":
        energies, noise = np.zeros(n), values.get("noise") or None
    elif start.kind == "modal":
        if modes is None:
            words = "this theory knows the total energy only; start from H=.. or a state"
            raise NotApplicable(words)
        energies = np.array([values[f"H{i + 1}"] for i in range(n)])
    elif start.kind == "energy":
        if n > 1:
            words = "give every modal energy, H1=..,H2=..: their sum is not enough"
            raise NotApplicable(f"{start}: {words}")
        energies = np.array([values["H"]])
    else:
        q, p = start.state(system.n)
        energies = np.array([float(system.hamiltonian(q, p))])
        if modes is not None:
            Q, P = modes.mode_shapes.T @ (system.mass * q), modes.mode_shapes.T @ p
            energies = 0.5 * (P**2 + (modes.natural_frequency * Q) ** 2)
    return replace(asked, start=EnergyStart(energies, noise), tol=tol)


def observed_modes(observable: Observable) -> list[int]:
    """Return the modes whose energies are asked for, none for the sum of all.

    Raises ``NotApplicable`` for displacements and momenta beside energies.
    """
    rows = [c.row for c in observable if c.index is not None]
    if any(c.kind != "H" for c in observable) or len(observable) != max(len(rows), 1):
        name = observable_name(observable)
        raise NotApplicable(
            f"{name}: in time modal energies H1, H2, …, two of them, or their sum H; "
            "or one or two of q and p"
        )
    return rows


def limited_modes(limit: Limit, start: EnergyStart) -> dict[int, float]:
    """Return the limits of modes, none for a limit of the sum of all.

    Raises ``NotApplicable`` for limits of displacements, ``InvalidInput`` where an energy, or the
    sum of all, is at or beyond its limit at the start.
    """
    if limit.kind == "q":
        raise NotApplicable(f"{limit}: averaged modal energies know no displacement; use H, H1, …")
    reached = {f"H{m + 1}": float(H) for m, H in enumerate(start.energies)}
    reached["H"] = sum(reached.values())
    if any(reached[name] >= value for name, value in limit.values.items()):
        given = ",".join(map(number_text, start.energies.tolist()))
        raise InvalidInput("start", given, f"must be below the limit {limit}")
    return {int(name[1:]) - 1: a for name, a in limit.values.items() if name != "H"}
