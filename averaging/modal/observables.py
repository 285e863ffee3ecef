"""Densities of all observables of the modes, from those of their energies, Eqs. (34)-(36)."""

from collections.abc import Callable, Mapping, Sequence
from math import prod

import numpy as np

from averaging.gaussian_state import Gaussian
from averaging.modal.analysis import ModalAnalysis
from averaging.modal.characteristic import state_density
from averaging.modal.groups import BY_ELEMENTS, POINTS, Group, joined, solved_group, total_energy
from averaging.zero_flux import flux_residual
from fpk.arrays import Array
from fpk.density import Density, certified_density
from fpk.observable import Coordinate, Observable
from fpk.quadrature import panel_rule

Function = Callable[..., Array]

RESIDUAL_PANELS = np.linspace(0.0, 40.0, 21)
"""Panels, in units of the mean energy, on which the flux of a modal density is measured."""
FINE_POINTS = 2 * POINTS
"""Gauss points per panel where an energy is integrated out; the distance to ``POINTS`` of them is
the error."""


def modal_densities(
    modes: ModalAnalysis, observables: Sequence[Observable], solver: str, *, tol: float
) -> tuple[Density, ...]:
    """Return the densities of modal energies, their sum, displacements and momenta.

    Each group of modes that the damping couples is solved once, to a share of ``tol`` such that
    what rests on all of them meets it. With constant damping the closed forms are Gaussian.
    """
    closed = modes.constant and solver == "closed-form"
    groups = {o: _groups_behind(modes, o, solver) for o in observables}
    # What rests on all groups adds errors of its own.
    parts = [len(g) * (1 if _energies(o) else 2) for o, g in groups.items()]
    needed = {g for o in observables if _energies(o) or not closed for g in groups[o]}
    solved = {g: solved_group(modes, g, solver, share=tol / max(parts), tol=tol) for g in needed}

    def density(observable: Observable) -> Density:
        if closed and not _energies(observable):
            return gaussian_modes(modes).density(observable, tol=tol)
        behind = [solved[group] for group in groups[observable]]
        if _energies(observable):
            return _joint(observable, behind, tol)
        if observable[0].kind == "H":
            return total_energy(observable, behind, tol=tol)
        return state_density(modes, behind, observable, tol=tol)

    return tuple(density(observable) for observable in observables)


def _energies(observable: Observable) -> bool:
    """Whether modal energies are asked for: not their sum, nor displacements or momenta."""
    return all(c.kind == "H" and c.index is not None for c in observable)


def _groups_behind(modes: ModalAnalysis, observable: Observable, solver: str) -> list[Group]:
    """The groups of modes whose energies an observable depends on, in its own order."""
    groups = modes.averaged.groups
    if not _energies(observable):
        return list(groups)
    index = tuple(c.row for c in observable)
    if modes.constant and solver in BY_ELEMENTS:
        return [index]  # (19) in two energies, though the density factors
    return list(dict.fromkeys(next(group for group in groups if m in group) for m in index))


def _joint(observable: Observable, parts: Sequence[Density], tol: float) -> Density:
    """The density of one or two modal energies, a product over independent groups of modes."""
    if parts[0].observable == observable:
        return parts[0]
    panels = {c: x for part in parts for c, x in zip(part.observable, part.panels, strict=True)}
    hidden = len(panels) > len(observable)

    def marginals(which: str, energies: Sequence[Array], points: int) -> list[Array]:
        """The densities of the groups, or their errors, without the energies not asked for."""
        given = dict(zip(observable, energies, strict=True))
        return [_marginal(part, getattr(part, which), given, points) for part in parts]

    def pdf(*energies: Array) -> Array:
        return np.asarray(prod(marginals("pdf", energies, FINE_POINTS)))

    def rule_error(p: Array, *energies: Array) -> Array:
        return np.asarray(np.abs(p - prod(marginals("pdf", energies, POINTS))))

    def pointwise(*energies: Array) -> Array:
        p = marginals("pdf", energies, FINE_POINTS)
        errors = marginals("pointwise", energies, FINE_POINTS)
        total = sum(e * prod(p[:k] + p[k + 1 :]) for k, e in enumerate(errors))
        return np.asarray(total + rule_error(pdf(*energies), *energies) if hidden else total)

    return certified_density(
        observable,
        tuple(panels[c] for c in observable),
        pdf,
        pointwise,
        measured=joined(parts),
        tol=tol,
        added_error=rule_error if hidden else None,
    )


def _marginal(
    part: Density, function: Function, given: Mapping[Coordinate, Array], points: int
) -> Array:
    """A function of the energies of a group, integrated over the one that is not given, if any."""
    hidden = [x for c, x in zip(part.observable, part.panels, strict=True) if c not in given]
    if not hidden:
        return function(*(given[c] for c in part.observable))
    x, w = (a.ravel() for a in panel_rule(hidden[0], points))
    arguments = (np.asarray(given[c])[..., None] if c in given else x for c in part.observable)
    return np.asarray(function(*arguments) @ w)


def gaussian_modes(modes: ModalAnalysis) -> Gaussian:
    """Return (34) as the Gaussian state that it is, of independent ω Q_i and P_i of variance θ_i.

    With M* = 1: ``cov q = T diag(θ_i/ω_i²) Tᵀ``, ``cov p = M T diag(θ_i) Tᵀ M``, Eqs. (20), (35);
    displacements and momenta are not correlated. The residual is the largest flux of e^(−H/θ)/θ in
    the energy process (19) of a mode.
    """
    theta = modes.temperature

    def flux(m: int) -> float:
        nodes = theta[m] * RESIDUAL_PANELS
        return flux_residual(modes.process((m,)), nodes, lambda H: -H / theta[m] - np.log(theta[m]))

    return Gaussian(
        factor=modes.state_shapes * np.sqrt(np.tile(theta, 2)),
        relative_error=modes.relative_error,
        scales=theta,
        shape=1.0,
        scale_errors=modes.relative_error * theta,
        residual=float(np.max([flux(m) for m in range(modes.n)])),
    )
