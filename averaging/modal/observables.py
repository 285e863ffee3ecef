"""Densities of all observables of the modes from their energies', Eqs. (11), (19), (34)-(36).

The modal energies fall into groups that the damping couples; each is solved once.
"""

from collections.abc import Callable, Sequence
from functools import cache, partial, reduce
from math import prod

import numpy as np

from averaging.energy_process import closed_form
from averaging.gaussian import Gaussian
from averaging.modal.analysis import ModalAnalysis
from averaging.modal.characteristic import POINTS, joined, product_of, state_density
from averaging.zero_flux import (
    ZeroFluxDensity,
    density_of_energies,
    flux_residual,
    solved_energies,
)
from fpk.answer.density import Density, certified_density
from fpk.answer.names import Coordinate, Observable
from fpk.numeric.arrays import CHUNK, Array
from fpk.numeric.piecewise import fit
from fpk.numeric.quadrature import panel_rule
from fpk.solvers.line.stationary import StationarySolution
from fpk.solvers.plane.solution import PlaneSolution

Group = tuple[int, ...]
BY_ELEMENTS = ("fem", "scikit-fem")
"""Solvers of two energies at once."""


def unsolved(modes: ModalAnalysis, solver: str) -> str | None:
    """Return why the energies of the modes cannot be solved for, or None where they can."""
    largest = max(modes.averaged.groups, key=len)
    names = " and ".join(f"H{m + 1}" for m in largest)
    if len(largest) > 2:
        return f"the damping couples {names}: more than two energies are not solved for together"
    if len(largest) == 2 and solver not in BY_ELEMENTS:
        return f"the damping couples {names}, so their density is no product; use fem"
    return None


def modal_densities(
    modes: ModalAnalysis, observables: Sequence[Observable], solver: str, *, tol: float
) -> tuple[Density, ...]:
    """Return the densities of modal energies, their sum, displacements and momenta.

    Groups of modes are solved to a share of ``tol`` such that an observable of all of them meets
    it. With constant damping the closed forms are Gaussian.
    """
    closed, groups = modes.constant and solver == "closed-form", modes.averaged.groups
    energies, behind = list[bool](), list[list[Group]]()
    for observable in observables:
        energies.append(all(c.kind == "H" and c.index is not None for c in observable))
        index = tuple(c.row for c in observable) if energies[-1] else range(modes.n)
        if energies[-1] and modes.constant and solver in BY_ELEMENTS:
            behind.append([tuple(index)])  # (19) in two energies, though the density factors
        else:
            behind.append(list(dict.fromkeys(g for m in index for g in groups if m in g)))
    # An observable of all groups adds errors of its own.
    parts = max((len(b) * (2 - own) for own, b in zip(energies, behind, strict=True)), default=1)

    @cache
    def solved(group: Group) -> Density:
        return solved_group(modes, group, solver, share=tol / parts, tol=tol)

    def density(observable: Observable, of_energies: bool, behind: list[Group]) -> Density:
        if closed and not of_energies:
            return gaussian_modes(modes).density(observable, tol=tol)
        of_groups = [solved(group) for group in behind]
        if of_energies:
            return _product(observable, of_groups, tol)
        if observable[0].kind == "H":
            # p(H) = ∫p(H1, H − H1) dH1 within a group, and convolutions between groups.
            of_sum = partial(_of_sum, observable, share=tol / (2 * len(of_groups)), tol=tol)
            return reduce(of_sum, (p if len(p.panels) == 1 else of_sum(p) for p in of_groups))
        return state_density(modes, of_groups, observable, tol=tol)

    return tuple(map(density, observables, energies, behind))


def solved_group(
    modes: ModalAnalysis, group: Group, solver: str, *, share: float, tol: float
) -> Density:
    """Return the density of the energies of one or two modes on which no other acts.

    To the L1 error ``share``, judged by ``tol``. The round-off of γ θ/d counts by 1 + H/θ each.
    """
    process, theta = modes.process(group), modes.temperature[list(group)]
    p: PlaneSolution | StationarySolution | ZeroFluxDensity
    if solver == "closed-form":
        factors, (m,) = modes.averaged.factors, group  # γ/d in ascending powers of H_m
        alone = np.isin(factors, [0, m + 1]).all(axis=1)
        degree = np.count_nonzero(factors[alone], axis=1)
        rate = np.bincount(degree, modes.averaged.values[alone, m, m])
        p = closed_form(process, rate / modes.noise[m])
    else:
        p = solved_energies(process, solver, tol=share)

    def of_modes(*energies: Array) -> Array:
        reach = sum(1.0 + H / scale for H, scale in zip(energies, theta, strict=True))
        return np.asarray(modes.relative_error * reach)

    observable = tuple(Coordinate("H", m) for m in group)
    panels = p.panels if isinstance(p.panels, tuple) else (p.panels,)
    return density_of_energies(observable, p, panels, of_modes, tol=tol, added=True)


def _product(observable: Observable, parts: Sequence[Density], tol: float) -> Density:
    """The density of one or two modal energies, a product over independent groups of modes."""
    if parts[0].observable == observable:
        return parts[0]
    panels = {c: x for part in parts for c, x in zip(part.observable, part.panels, strict=True)}

    def marginals(which: str, energies: Sequence[Array]) -> list[Array]:
        """The densities of the groups, or their errors, integrated over energies not asked for."""
        given, factors = dict(zip(observable, energies, strict=True)), []
        for part in parts:
            function: Callable[..., Array] = getattr(part, which)
            if hidden := [c for c in part.observable if c not in given]:
                x, w = (a.ravel() for a in panel_rule(panels[hidden[0]], 2 * POINTS))
                at = (given[c][..., None] if c in given else x for c in part.observable)
                factors.append(np.asarray(function(*at) @ w))
            else:
                factors.append(function(*(given[c] for c in part.observable)))
        return factors

    def pointwise(*energies: Array) -> Array:
        both = (marginals(which, energies) for which in ("pdf", "pointwise"))
        return product_of(zip(*both, strict=True))[1]

    return certified_density(
        observable,
        tuple(panels[c] for c in observable),
        lambda *energies: np.asarray(prod(marginals("pdf", energies))),
        pointwise,
        measured=joined(parts),
        tol=tol,
    )


def _of_sum(observable: Observable, *parts: Density, share: float, tol: float) -> Density:
    """The density of H1 + H2 from p(H1, H2), or from those of two independent energies.

    Its panels are halved until the last coefficients fall below the L1 ``share``.
    """
    panels = tuple(x for part in parts for x in part.panels)
    end = panels[0][-1] + panels[1][-1]
    nodes = np.unique(np.concatenate([*panels, np.linspace(0.0, end, 9), [end]]))
    nodes = nodes[np.append(True, np.diff(nodes) > 1e-12 * end)]
    t, w = panel_rule(np.array([0.0, 1.0]), POINTS)

    def joint(x: Array, y: Array) -> tuple[Array, Array]:
        if len(parts) == 1:
            return parts[0].at(x, y)
        return product_of([parts[0].at(x), parts[1].at(y)])

    def along(energy: Array) -> Array:
        """∫joint(x, H − x) dx over 0 < x < H, cut where x or H − x passes from panel to panel."""
        sums = []
        size = energy.size * POINTS * (panels[0].size + panels[1].size)
        for part in np.array_split(energy, 1 + 2 * size // CHUNK):
            H = part[:, None]
            ends = np.hstack([np.minimum(panels[0], H), np.maximum(H - panels[1], 0.0)])
            ends = np.sort(np.clip(ends, 0.0, np.minimum(H, panels[0][-1])), axis=1)
            length = np.diff(ends, axis=1)[:, :, None]
            x = ends[:, :-1, None] + length * t
            values = np.stack(joint(x, np.clip(H[:, :, None] - x, 0.0, None)), axis=-1)
            sums.append(np.einsum("hkt,hktc->hc", length * w, values))
        return np.concatenate(sums)

    both = fit(
        along,
        nodes,
        0.5 * share / nodes.size,
        estimate=lambda lengths, series: lengths * np.abs(series[:, -2:, 0]).sum(axis=1),
    )
    assert both.error is not None
    local = 2.0 * both.error / np.diff(both.nodes)

    def pointwise(energy: Array) -> Array:
        k = np.clip(np.searchsorted(both.nodes, energy, side="right") - 1, 0, local.size - 1)
        return np.asarray(np.abs(both(energy)[..., 1]) + local[k])

    return certified_density(
        observable,
        (both.nodes,),
        lambda energy: both(energy)[..., 0],
        pointwise,
        measured=joined(parts, 2.0 * float(both.error.sum())),
        tol=tol,
    )


def gaussian_modes(modes: ModalAnalysis) -> Gaussian:
    """Return (34) as the Gaussian state that it is, of independent ω Q_i and P_i of variance θ_i.

    With M* = 1: ``cov q = T diag(θ_i/ω_i²) Tᵀ``, ``cov p = M T diag(θ_i) Tᵀ M``, Eqs. (20), (35).
    The residual is the largest flux of e^(−H/θ)/θ in the energy process (19) of a mode.
    """
    theta = modes.temperature

    def flux(m: int) -> float:
        nodes = np.linspace(0.0, 40.0 * theta[m], 21)
        return flux_residual(modes.process((m,)), nodes, lambda H: -H / theta[m] - np.log(theta[m]))

    return Gaussian(
        factor=modes.state_shapes * np.sqrt(np.tile(theta, 2)),
        relative_error=modes.relative_error,
        scales=theta,
        shape=1.0,
        scale_errors=modes.relative_error * theta,
        residual=float(np.max([flux(m) for m in range(modes.n)])),
    )
