"""The potential of the masses that can touch something, all other masses integrated out."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from averaging.conditional import conditionals
from fpk.contact import Contact
from fpk.effects import looks_the_same_mirrored
from fpk.system import System

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class ReducedPotential:
    """Potential over some masses, V_red = ½ q_cᵀ K_red q_c + Σ U_i(q_i), in whitened coordinates.

    A mass without contact enters V quadratically, so integrating it out of the phase space is
    exact and leaves the Schur complement ``K_red`` of the stiffness matrix. With ``q_c = L y`` and
    ``L Lᵀ = K_red⁻¹`` the springs become ½|y|². ``masses`` are those kept, counted from 0; ``L``
    has shape (c, c); ``stops`` are the one-sided contacts, ``rows`` (stops, c) the rows ±L of
    their masses, so that the overlap of stop s is ``rows[s] @ y − clearance[s]``; ``n`` is the
    number of degrees of freedom of the whole system; ``mirror`` says whether V(−q) = V(q).
    """

    n: int
    masses: tuple[int, ...]
    L: Array
    stops: tuple[Contact, ...]
    rows: Array
    clearance: Array
    mirror: bool

    def __call__(self, y: Array) -> Array:
        """V_red at whitened coordinates of shape (..., c)."""
        value: Array = 0.5 * np.sum(y * y, axis=-1)
        for stop, row, clearance in zip(self.stops, self.rows, self.clearance, strict=True):
            value = value + stop.energy(np.maximum(y @ row - clearance, 0.0))
        return value

    def slope(self, y: Array, direction: Array) -> Array:
        """Derivative of V_red along ``direction`` (c,) at whitened coordinates (..., c)."""
        slope: Array = y @ direction
        for stop, row, clearance in zip(self.stops, self.rows, self.clearance, strict=True):
            overlap = np.maximum(y @ row - clearance, 0.0)
            slope = slope + (row @ direction) * stop.force(overlap)
        return slope

    @property
    def count(self) -> int:
        """Number of masses kept, c."""
        return len(self.masses)


def reduced_potential(system: System, *extra: int) -> ReducedPotential:
    """Return the potential over the contact masses and the ``extra`` ones (from 0), ascending.

    Integrating masses out of a chain leaves a chain: each mass that stays hangs on the one before
    it by the springs between them in series. In the extensions of these springs, times the root of
    their stiffness, ½ qᵀ K_red q is ½|y|², and nothing cancels at any ratio of the springs.
    """
    masses = tuple(sorted({*system.contact_masses, *extra}))
    stiffness = [law.precision for law in conditionals(system, masses)]
    L: Array = np.tril(np.ones((len(masses), len(masses)))) / np.sqrt(stiffness)
    stops = system.stops
    signs = np.array([1.0 if stop.side == "right" else -1.0 for stop in stops])
    rows = np.array([L[masses.index(stop.index)] for stop in stops]).reshape(
        len(stops), len(masses)
    )
    return ReducedPotential(
        n=system.n,
        masses=masses,
        L=L,
        stops=stops,
        rows=signs[:, None] * rows,
        clearance=np.array([stop.clearance for stop in stops], dtype=float),
        mirror=looks_the_same_mirrored(system),
    )
