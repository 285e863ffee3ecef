"""The potential of the masses that can touch something, all other masses integrated out."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

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

    @property
    def count(self) -> int:
        """Number of masses kept, c."""
        return len(self.masses)


def compliance_matrix(system: System) -> Array:
    """Return K⁻¹ of the chain: masses i, j share the springs up to the nearer of them."""
    chain = np.cumsum(1.0 / system.stiffness)
    i = np.arange(system.n)
    shared: Array = chain[np.minimum(i[:, None], i)]
    return shared


def reduced_potential(system: System, *extra: int) -> ReducedPotential:
    """Return the potential over the contact masses and the ``extra`` ones (from 0), ascending.

    The Schur complement is not formed: its inverse is the block of K⁻¹ that belongs to the masses
    kept, which for a chain is a sum of positive terms, exact to round-off at any stiffness ratio.
    """
    masses = tuple(sorted({*system.contact_masses, *extra}))
    compliance = compliance_matrix(system)[list(masses)][:, list(masses)]
    L: Array = np.zeros((0, 0))
    if masses:
        L = np.asarray(np.linalg.cholesky(compliance), dtype=float)
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
