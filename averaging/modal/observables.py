"""Densities of all observables of the modes, from those of their groups, Eqs. (34)-(36)."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from averaging.gamma_sum import gamma_sum_density
from averaging.gaussian import gaussian_density
from averaging.modal.analysis import ModalAnalysis
from averaging.modal.characteristic import state_density
from averaging.modal.groups import POINTS, Group, Solver, joined, solved_group
from averaging.modal.process import modes_process
from averaging.modal.total import total_energy
from averaging.zero_flux import flux_residual
from fpk.density import Density, certified_density
from fpk.observable import Observable
from fpk.quadrature import panel_rule

Array = NDArray[np.float64]
Provenance = Mapping[str, str | float | int]


RESIDUAL_PANELS = np.linspace(0.0, 40.0, 21)
"""Ends of panels, in units of the mean energy, on which the flux of a modal density is measured:
e^−40 of the mass lies beyond, and a panel of two means is integrated to round-off."""


def modal_densities(
    modes: ModalAnalysis,
    observables: Sequence[Observable],
    solver: Solver,
    *,
    tol: float,
    provenance: Provenance,
) -> tuple[Density, ...]:
    """Return the densities of modal energies, their sum, displacements and momenta.

    Each group of modes that the damping couples is solved once, to a share of ``tol`` such that
    what rests on all of them meets it. With constant damping the closed forms are those of a
    Gaussian with independent modes.
    """
    gaussian = modes.state is None and solver == "closed-form"
    asked = [(o, _groups_behind(modes, o, solver)) for o in observables]
    # What rests on all groups adds errors of its own.
    parts = [len(groups) * (1 if _energies(o) else 2) for o, groups in asked]
    share = tol / max(parts)
    closed = [o for o in observables if gaussian and not _energies(o)]
    needed = dict.fromkeys(group for o, groups in asked if o not in closed for group in groups)
    solved = {g: solved_group(modes, g, solver, share=share, tol=tol) for g in needed}

    def density(observable: Observable, groups: Sequence[Group]) -> Density:
        if observable in closed:
            return _of_gaussian(modes, observable, tol)
        behind = [solved[group] for group in groups]
        if not _energies(observable):
            if observable[0].kind == "H":
                return total_energy(observable, behind, tol=tol)
            return state_density(modes, behind, observable, tol=tol)
        if len(behind) == 2:
            pairs = zip(behind, observable, strict=True)
            return _product(observable, [_of(d, (c,), tol) for d, c in pairs], tol)
        return _of(behind[0], observable, tol)

    return tuple(replace(density(o, groups), provenance=provenance) for o, groups in asked)


def _energies(observable: Observable) -> bool:
    """Whether modal energies are asked for: not their sum, nor displacements or momenta."""
    return all(c.kind == "H" and c.index is not None for c in observable)


def _groups_behind(modes: ModalAnalysis, observable: Observable, solver: Solver) -> list[Group]:
    """The groups of modes whose energies an observable depends on, in its own order."""
    groups = modes.groups()
    if not _energies(observable):
        return list(groups)
    index = tuple(c.index or 0 for c in observable)
    if modes.state is None and solver == "fem":
        return [index]  # (19) in two energies, though the density factors
    return list(dict.fromkeys(next(group for group in groups if m in group) for m in index))


def _of(density: Density, observable: Observable, tol: float) -> Density:
    """One or both energies of a group, in the order asked for."""
    if density.observable == observable:
        return density
    if len(observable) == 2:
        return certified_density(
            observable,
            density.panels[::-1],
            lambda x, y: density.pdf(y, x),
            lambda x, y: density.pointwise(y, x),
            measured=joined([density]),
            tol=tol,
        )
    axis = density.observable.index(observable[0])
    hidden = density.panels[1 - axis]
    halves = np.insert(hidden, np.arange(1, hidden.size), 0.5 * (hidden[1:] + hidden[:-1]))

    def over(function: Callable[..., Array], panels: Array, energy: Array) -> Array:
        x, w = (part.ravel() for part in panel_rule(panels, POINTS))
        H = np.asarray(energy, dtype=float)[..., None]
        return np.asarray((function(H, x) if axis == 0 else function(x, H)) @ w)

    def rule(energy: Array) -> Array:
        return np.abs(over(density.pdf, halves, energy) - over(density.pdf, hidden, energy))

    return certified_density(
        observable,
        (density.panels[axis],),
        lambda energy: over(density.pdf, halves, energy),
        lambda energy: over(density.pointwise, halves, energy) + rule(energy),
        measured=joined([density]),
        tol=tol,
        added_error=rule,
    )


def _product(observable: Observable, factors: Sequence[Density], tol: float) -> Density:
    """The joint density of two energies that are independent: relative errors add."""
    first, second = factors
    return certified_density(
        observable,
        first.panels + second.panels,
        lambda x, y: first.pdf(x) * second.pdf(y),
        lambda x, y: first.pointwise(x) * second.pdf(y) + first.pdf(x) * second.pointwise(y),
        measured=joined(factors),
        tol=tol,
    )


def _of_gaussian(modes: ModalAnalysis, observable: Observable, tol: float) -> Density:
    """(34) and what it makes of q and p: Gaussian modes with the modal temperatures θ_i."""
    theta, relative = modes.temperature, modes.relative_error
    residual = max(_flux_residual(modes, m) for m in range(modes.n))
    if observable[0].kind == "H":
        errors = relative * theta
        return gamma_sum_density(theta, 1.0, errors, observable, residual=residual, tol=tol)
    return gaussian_density(
        modal_factor(modes), observable, relative=relative, residual=residual, tol=tol
    )


def modal_factor(modes: ModalAnalysis) -> Array:
    """Return F with F Fᵀ the covariance of (q, p) that belongs to (34), (2n, 2n), Eqs. (20), (35).

    ``cov q = T diag(θ_i/K*_i) Tᵀ``; as P = Tᵀ p, ``cov p = T⁻ᵀ diag(θ_i M*_i) T⁻¹``, where
    T⁻¹ = M*⁻¹ Tᵀ M; displacements and momenta are not correlated. Where (35) prints T_11^{-1} it
    means an element of the matrix T⁻¹, not 1/T_11.
    """
    theta, nothing = modes.temperature, np.zeros((modes.n, modes.n))
    q = modes.mode_shapes * np.sqrt(theta / modes.modal_stiffness)
    p = modes.momentum_shapes * np.sqrt(theta * modes.modal_mass)
    return np.block([[q, nothing], [nothing, p]])


def _flux_residual(modes: ModalAnalysis, mode: int) -> float:
    """How far e^(−H/θ)/θ is from zero flux in the energy process (19) of its own mode."""
    theta = float(modes.temperature[mode])

    def log_density(energy: Array) -> Array:
        return np.asarray(-energy / theta - np.log(theta))

    return flux_residual(modes_process(modes, (mode,)), theta * RESIDUAL_PANELS, log_density)
