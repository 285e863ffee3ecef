"""Densities of the groups of modes whose energies the damping couples, and of their sum.

Eqs. (11), (19), (34).
"""

from collections.abc import Sequence
from functools import partial, reduce

import numpy as np

from averaging.closed_form import closed_form
from averaging.modal.analysis import ModalAnalysis
from averaging.zero_flux import ZeroFluxDensity, density_of_energies, solved_energies
from fpk.arrays import Array
from fpk.certificate import Measured, outside, worst
from fpk.density import Density, certified_density
from fpk.line.stationary import StationarySolution
from fpk.observable import Coordinate, Observable
from fpk.piecewise import fit
from fpk.plane.solution import PlaneSolution
from fpk.quadrature import panel_rule

Group = tuple[int, ...]

BY_ELEMENTS = ("fem", "scikit-fem")
"""Solvers of two energies at once."""

POINTS = 24
"""Gauss points per panel where an energy is integrated out: over three e-folds they miss 1e-30."""
SUM_POINTS = 20
"""Gauss points per panel of the integral along H1 + H2 = H, where p is a product of polynomials."""
ROUNDS = 12
"""Halvings of a panel of the sum, at the most."""
CHUNK = 2_000_000
"""Points evaluated at once: 16 MB of each quantity."""


def unsolved(modes: ModalAnalysis, solver: str) -> str | None:
    """Return why the energies of the modes cannot be solved for, or None where they can."""
    largest = max(modes.averaged.groups, key=len)
    names = " and ".join(f"H{m + 1}" for m in largest)
    if len(largest) > 2:
        return f"the damping couples {names}: more than two energies are not solved for together"
    if len(largest) == 2 and solver not in BY_ELEMENTS:
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
    if solver == "closed-form":
        p = closed_form(process, modes.averaged.powers(*group) / modes.noise[group])
    else:
        p = solved_energies(process, solver, tol=share)

    def of_modes(*energies: Array) -> Array:
        reach = sum(1.0 + H / scale for H, scale in zip(energies, theta, strict=True))
        return np.asarray(modes.relative_error * reach)

    observable = tuple(Coordinate("H", m) for m in group)
    panels = p.panels if isinstance(p.panels, tuple) else (p.panels,)
    return density_of_energies(observable, p, panels, of_modes, tol=tol, added=True)


def joined(parts: Sequence[Density], added: float = 0.0) -> Measured:
    """Return what was measured on several independent densities, for what rests on all of them.

    Its smallest value is its own: what is wrong with that of a part is one of the failures.
    """
    checks = [part.certificate for part in parts]
    return Measured(
        l1_error=sum(part.l1_error for part in parts) + added,
        mass_defect=sum(c.mass_defect for c in checks if c.mass_defect is not None),
        minimum=None,
        residual=worst(c.residual for c in checks),
        tail_mass=sum(outside(c) for c in checks),
        net_flux=worst(c.net_flux for c in checks),
        failures=tuple(dict.fromkeys(words for c in checks for words in c.failures)),
    )


def total_energy(observable: Observable, parts: Sequence[Density], *, tol: float) -> Density:
    """Return p(H) of H = Σ H_i over independent groups of one or two energies.

    p(H) = ∫p(H1, H − H1) dH1 within a group, and convolutions between groups; each is expanded
    panel by panel, halved until its last coefficients fall below a share of ``tol``.
    """
    of_sum = partial(_of_sum, observable, share=tol / (2 * len(parts)), tol=tol)
    return reduce(of_sum, (part if len(part.panels) == 1 else of_sum(part) for part in parts))


def _of_sum(observable: Observable, *parts: Density, share: float, tol: float) -> Density:
    """The density of H1 + H2 from p(H1, H2), or from those of two independent energies."""
    panels = tuple(x for part in parts for x in part.panels)
    end = panels[0][-1] + panels[1][-1]
    nodes = np.unique(np.concatenate([*panels, np.linspace(0.0, end, 9), [end]]))
    nodes = nodes[np.append(True, np.diff(nodes) > 1e-12 * end)]

    def joint(x: Array, y: Array) -> tuple[Array, Array]:
        if len(parts) == 1:
            return parts[0].at(x, y)
        (p, p_error), (r, r_error) = parts[0].at(x), parts[1].at(y)
        return p * r, p_error * np.abs(r) + np.abs(p) * r_error

    def along(energy: Array) -> Array:
        """∫joint(x, H − x) dx over 0 < x < H, cut where x or H − x passes from panel to panel."""
        H = energy[:, None]
        ends = np.concatenate([np.minimum(panels[0], H), np.maximum(H - panels[1], 0.0)], axis=1)
        ends = np.sort(np.clip(ends, 0.0, np.minimum(H, panels[0][-1])), axis=1)
        t, w = panel_rule(np.array([0.0, 1.0]), SUM_POINTS)
        length = np.diff(ends, axis=1)[:, :, None]
        x = ends[:, :-1, None] + length * t
        values = np.stack(joint(x, np.clip(H[:, :, None] - x, 0.0, None)), axis=-1)
        return np.asarray(np.einsum("hkt,hktc->hc", length * w, values))

    def in_chunks(energy: Array) -> Array:
        count = 1 + energy.size * SUM_POINTS * (panels[0].size + panels[1].size) // CHUNK
        return np.concatenate([along(part) for part in np.array_split(energy, count)])

    def truncation(lengths: Array, coefficients: Array) -> Array:
        """L1 norm of the last two terms of p on each panel."""
        return np.asarray(lengths * np.sum(np.abs(coefficients[:, -2:, 0]), axis=1))

    both = fit(in_chunks, nodes, 0.5 * share / nodes.size, estimate=truncation, rounds=ROUNDS)
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
