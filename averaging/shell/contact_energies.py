"""Energies at which the shell first reaches a stop, or several: T(H) is not smooth there."""

from itertools import combinations

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from averaging.shell.reduced import ReducedPotential

Array = NDArray[np.float64]

SAME = 1e-11
"""Relative distance below which two energies are one: mirror images differ by roundings, minima
by what their search leaves; a mesh between them would have no room."""

MOST_AT_ONCE = 3
"""Stops touched at once that are looked at: beyond, the loss of smoothness is of ever higher
order (each stop adds half a derivative at least)."""


def contact_energies(
    potential: ReducedPotential, *, at_once: int = MOST_AT_ONCE
) -> tuple[float, ...]:
    """Return the energies, ascending, at which T(H) loses smoothness.

    They are the minima of V_red over the points where one or several stops, ``at_once`` at the
    most, are just touched; for one stop and no other in the way this is H_c = ½ k_eff δ², which
    is 0 without clearance.
    """
    if potential.count == 1:
        # One mass: each stop is touched at one point.
        energies = set(potential((potential.clearance / potential.rows[:, 0])[:, None]).tolist())
        return _distinct(energies)
    energies = set()
    indices = range(len(potential.stops))
    for size in range(1, min(potential.count, at_once) + 1):
        for subset in combinations(indices, size):
            if len({potential.stops[s].mass for s in subset}) == size:
                energies.add(_lowest(potential, subset))
    return _distinct(energies)


def _distinct(energies: set[float]) -> tuple[float, ...]:
    """Return them ascending, those that differ by less than ``SAME`` once."""
    ascending = sorted(energies)
    return tuple(H for k, H in enumerate(ascending) if k == 0 or H - ascending[k - 1] > SAME * H)


def _lowest(potential: ReducedPotential, subset: tuple[int, ...]) -> float:
    rows = potential.rows[list(subset)]
    others = [s for s in range(len(potential.stops)) if s not in subset]
    if len(subset) == potential.count:
        # As many stops as masses: there is one such point.
        corner: Array = np.asarray(np.linalg.solve(rows, potential.clearance[list(subset)]), float)
        return float(0.5 * corner @ corner + _energy_of(potential, others, corner))
    foot: Array = np.linalg.pinv(rows) @ potential.clearance[list(subset)]
    overlap = potential.rows[others] @ foot - potential.clearance[others]
    if np.all(overlap <= 0.0):
        return float(0.5 * foot @ foot)
    _, _, basis = np.linalg.svd(rows)
    free = basis[len(subset) :].T

    def energy(t: Array) -> float:
        return float(potential(foot + free @ t))

    found = minimize(energy, np.zeros(free.shape[1]), tol=1e-12)
    return float(found.fun)


def _energy_of(potential: ReducedPotential, stops: list[int], y: Array) -> float:
    return float(
        sum(
            potential.stops[s].energy(max(potential.rows[s] @ y - potential.clearance[s], 0.0))
            for s in stops
        )
    )
