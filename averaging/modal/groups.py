"""Densities of the energies of one mode, or of two that damping couples, Eqs. (11), (19), (34)."""

from collections.abc import Callable, Sequence
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from averaging.closed_form import ClosedForm, closed_form
from averaging.modal.analysis import ModalAnalysis
from averaging.quadrature import solve_by_quadrature
from fpk.certificate import Measured
from fpk.density import Density, certified_density
from fpk.line.stationary import solve_stationary
from fpk.observable import Coordinate
from fpk.plane.stationary import solve_plane

Array = NDArray[np.float64]
Group = tuple[int, ...]
Solver = Literal["closed-form", "fem", "quadrature"]
Solved = tuple[tuple[Array, ...], Callable[..., Array], Callable[..., Array], Measured]
"""Panels, density, its error at points, and what was measured on it."""

POINTS = 24
"""Gauss points per panel where an energy is integrated out: over three e-folds they miss 1e-30."""


def unsolved(modes: ModalAnalysis, solver: Solver) -> str | None:
    """Return why the energies of the modes cannot be solved for, or None where they can."""
    largest = max(modes.averaged.groups, key=len)
    names = " and ".join(f"H{m + 1}" for m in largest)
    if len(largest) > 2:
        return f"the damping couples {names}: more than two energies are not solved for together"
    if len(largest) == 2 and solver != "fem":
        return f"the damping couples {names}, so their density is no product; use fem"
    return None


def solved_group(
    modes: ModalAnalysis, group: Group, solver: Solver, *, share: float, tol: float
) -> Density:
    """Return the density of the energies of one or two modes on which no other acts.

    It is solved for to the L1 error ``share`` and judged by the tolerance ``tol``. The relative
    round-off of the modes, that of γ θ/d, counts by 1 + H/θ of each energy.
    """
    panels, pdf, error, measured = _solved(modes, group, solver, share)
    theta = modes.temperature[list(group)]

    def of_modes(*energies: Array) -> Array:
        reach = sum(1.0 + H / scale for H, scale in zip(energies, theta, strict=True))
        return np.asarray(modes.relative_error * reach * np.abs(pdf(*energies)))

    def pointwise(*energies: Array) -> Array:
        # Beyond the last energy, where p is 0, the error is what was dropped: less than at the end.
        within = [np.minimum(H, x[-1]) for H, x in zip(energies, panels, strict=True)]
        dropped = np.abs(pdf(*within) - pdf(*energies))
        return np.asarray(np.abs(error(*energies)) + of_modes(*energies) + dropped)

    return certified_density(
        tuple(Coordinate("H", m) for m in group),
        panels,
        pdf,
        pointwise,
        measured=measured,
        tol=tol,
        added_error=of_modes,
    )


def _solved(modes: ModalAnalysis, group: Group, solver: Solver, tol: float) -> Solved:
    process = modes.process(group)
    if len(group) == 2:
        plane = solve_plane(process, tol=tol)
        return plane.nodes, plane.density, plane.pointwise_error, plane.measured
    if solver == "closed-form":
        return _closed_form(
            closed_form(process, modes.averaged.powers(*group) / modes.noise[group])
        )
    line = (solve_stationary if solver == "fem" else solve_by_quadrature)(process, tol=tol)
    return (line.nodes,), line.density, line.pointwise_error, line.measured


def _closed_form(form: ClosedForm) -> Solved:
    """p(H) of a mode whose damping depends on its energy alone; T is its period, a constant."""
    end = form.nodes[-1]

    def pdf(energy: Array) -> Array:
        return np.where((energy >= 0.0) & (energy <= end), np.exp(form.log_u(energy)), 0.0)

    def error(energy: Array) -> Array:
        return form.relative_error(energy) * pdf(energy)

    return (form.nodes,), pdf, error, form.measured


def joined(parts: Sequence[Density], added: float = 0.0) -> Measured:
    """Return what was measured on several independent densities, for what rests on all of them."""
    checks = [part.certificate for part in parts]
    return Measured(
        l1_error=sum(part.l1_error for part in parts) + added,
        mass_defect=sum(c.mass_defect for c in checks),
        minimum=min(c.minimum for c in checks),
        residual=max(c.residual for c in checks),
        tail_mass=sum(c.tail_mass for c in checks),
        net_flux=max((c.net_flux for c in checks if c.net_flux is not None), default=None),
        failures=tuple(dict.fromkeys(words for c in checks for words in c.failures)),
    )
