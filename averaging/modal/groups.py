"""Densities of the energies of one mode, or of two that damping couples, Eqs. (11), (19), (34)."""

from collections.abc import Sequence

import numpy as np

from averaging.closed_form import closed_form
from averaging.energy_density import density_of_energies
from averaging.modal.analysis import ModalAnalysis
from averaging.quadrature import solve_by_quadrature
from averaging.zero_flux import ZeroFluxDensity
from fpk.arrays import Array
from fpk.certificate import Measured, outside, worst
from fpk.density import Density
from fpk.line.stationary import StationarySolution, solve_stationary
from fpk.observable import Coordinate
from fpk.plane.solution import PlaneSolution
from fpk.plane.stationary import solve_plane

Group = tuple[int, ...]

POINTS = 24
"""Gauss points per panel where an energy is integrated out: over three e-folds they miss 1e-30."""


def unsolved(modes: ModalAnalysis, solver: str) -> str | None:
    """Return why the energies of the modes cannot be solved for, or None where they can."""
    largest = max(modes.averaged.groups, key=len)
    names = " and ".join(f"H{m + 1}" for m in largest)
    if len(largest) > 2:
        return f"the damping couples {names}: more than two energies are not solved for together"
    if len(largest) == 2 and solver != "fem":
        return f"the damping couples {names}, so their density is no product; use fem"
    return None


def solved_group(
    modes: ModalAnalysis, group: Group, solver: str, *, share: float, tol: float
) -> Density:
    """Return the density of the energies of one or two modes on which no other acts.

    It is solved for to the L1 error ``share`` and judged by the tolerance ``tol``. The relative
    round-off of the modes, that of γ θ/d, counts by 1 + H/θ of each energy.
    """
    process, theta = modes.process(group), modes.temperature[list(group)]
    p: PlaneSolution | StationarySolution | ZeroFluxDensity
    if len(group) == 2:
        p = solve_plane(process, tol=share)
    elif solver == "closed-form":
        p = closed_form(process, modes.averaged.powers(*group) / modes.noise[group])
    else:
        p = (solve_stationary if solver == "fem" else solve_by_quadrature)(process, tol=share)

    def of_modes(*energies: Array) -> Array:
        reach = sum(1.0 + H / scale for H, scale in zip(energies, theta, strict=True))
        return np.asarray(modes.relative_error * reach)

    observable = tuple(Coordinate("H", m) for m in group)
    panels = p.panels if isinstance(p.panels, tuple) else (p.panels,)
    return density_of_energies(observable, p, panels, of_modes, tol=tol, added=True)


def joined(parts: Sequence[Density], added: float = 0.0) -> Measured:
    """Return what was measured on several independent densities, for what rests on all of them."""
    checks = [part.certificate for part in parts]
    return Measured(
        l1_error=sum(part.l1_error for part in parts) + added,
        mass_defect=sum(c.mass_defect for c in checks if c.mass_defect is not None),
        minimum=min(c.minimum for c in checks if c.minimum is not None),
        residual=worst(c.residual for c in checks),
        tail_mass=sum(outside(c) for c in checks),
        net_flux=worst(c.net_flux for c in checks),
        failures=tuple(dict.fromkeys(words for c in checks for words in c.failures)),
    )
