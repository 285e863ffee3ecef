"""Densities of energies from solutions of their FPK equation, Eqs. (11), (19), (24)."""

from collections.abc import Callable

import numpy as np

from averaging.zero_flux import ZeroFluxDensity
from fpk.arrays import Array
from fpk.density import Density, certified_density
from fpk.line.stationary import StationarySolution
from fpk.observable import Observable
from fpk.plane.solution import PlaneSolution


def density_of_energies(
    observable: Observable,
    solution: StationarySolution | ZeroFluxDensity | PlaneSolution,
    panels: tuple[Array, ...],
    relative_error: Callable[..., Array],
    *,
    tol: float,
    added: bool,
) -> Density:
    """Return the density of one or two energies that ``solution`` gives, with its certificate.

    ``relative_error`` returns at energies the relative error of p by that of the density of states
    or of the modes, which the solver does not know of; ``added`` says that it counts in L1, too.
    """

    def of_model(p: Array, *energies: Array) -> Array:
        return np.asarray(relative_error(*energies) * np.abs(p))

    def pointwise(*energies: Array) -> Array:
        p = solution.density(*energies)
        # Beyond the last energy, where p is 0, the error is what was dropped: less than at the end.
        within = [np.minimum(H, x[-1]) for H, x in zip(energies, panels, strict=True)]
        dropped = np.abs(solution.density(*within) - p)
        error = np.abs(solution.pointwise_error(*energies)) + of_model(p, *energies) + dropped
        return np.where(np.min(np.broadcast_arrays(*energies), axis=0) >= 0.0, error, 0.0)

    return certified_density(
        observable,
        panels,
        solution.density,
        pointwise,
        measured=solution.measured,
        tol=tol,
        added_error=of_model if added else None,
    )
