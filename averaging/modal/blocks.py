"""Groups of modes that state-dependent damping couples: the density of their energies."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import reduce
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from averaging.modal.analysis import ModalAnalysis
from averaging.modal.process import mode_process, modes_process
from averaging.quadrature import solve_by_quadrature
from fpk.certificate import Certificate
from fpk.line.mesh import initial_nodes
from fpk.line.stationary import solve_stationary
from fpk.plane.stationary import solve_plane
from fpk.probe import probed
from fpk.quadrature import panel_rule

Array = NDArray[np.float64]
Solver = Literal["closed-form", "fem", "quadrature"]

POINTS = 24
"""Gauss points per panel of integrals over energies: exact to degree 47, above twice that of the
finite elements."""
EPS = float(np.finfo(float).eps)


@dataclass(frozen=True, eq=False)
class EnergyDensity:
    """p of one or two energies, smooth between ``panels`` along each axis, 0 outside them.

    ``values`` takes one array per axis, which broadcast together, and returns p and an estimate of
    its error, stacked in front. ``l1_error`` estimates ∫|p − p_exact|.
    """

    panels: tuple[Array, ...]
    values: Callable[..., Array]
    l1_error: float
    certificate: Certificate

    def on_grid(self, points: Sequence[int]) -> tuple[tuple[Array, ...], Array]:
        """Return Gauss energies along each axis, and p and its error times the weights there."""
        rules = [
            [part.ravel() for part in panel_rule(x, n)]
            for x, n in zip(self.panels, points, strict=True)
        ]
        axes = np.meshgrid(*(x for x, _ in rules), indexing="ij", sparse=True)
        weights = reduce(np.multiply.outer, [w for _, w in rules])
        return tuple(x for x, _ in rules), self.values(*axes) * weights


def unsolved(modes: ModalAnalysis, solver: Solver) -> str | None:
    """Return why the energies of the modes cannot be solved for, or None where they can."""
    if modes.state is None:
        return None
    largest = max(modes.state.blocks(), key=len)
    names = " and ".join(f"H{m + 1}" for m in largest)
    if len(largest) > 2:
        return f"the damping couples {names}: more than two energies are not solved for together"
    if len(largest) == 2 and solver != "fem":
        return f"the damping couples {names}, so their density is no product; use fem"
    return None


def solved_block(
    modes: ModalAnalysis, block: tuple[int, ...], solver: Solver, *, tol: float
) -> EnergyDensity:
    """Return the density of the energies of one or two modes on which no other acts, Eq. (19)."""
    if len(block) == 2:
        plane = solve_plane(modes_process(modes, block), tol=tol)
        return EnergyDensity(
            plane.nodes,
            lambda x, y: np.stack([plane.density(x, y), plane.pointwise_error(x, y)]),
            plane.l1_error,
            plane.certificate,
        )
    if solver == "closed-form":
        return closed_mode(modes, block[0], tol=tol)
    process = mode_process(modes, block[0])
    if solver == "fem":
        line = solve_stationary(process, tol=tol)
        return EnergyDensity(
            (line.nodes,),
            lambda x: np.stack([line.density(x), line.pointwise_error(x)]),
            line.l1_error,
            line.certificate,
        )
    found = solve_by_quadrature(process, tol=tol)

    def values(x: Array) -> Array:
        p = np.exp(found.log_density(np.asarray(x, dtype=float)))
        return np.stack([p, found.l1_error * p])

    checks = Certificate(found.mass_defect, 0.0, 0.0, found.tail_mass)
    return EnergyDensity((found.nodes,), values, found.l1_error, checks)


def closed_mode(modes: ModalAnalysis, mode: int, *, tol: float) -> EnergyDensity:
    """Return p(H) = C exp(−∫γ(H) M*/d dH) of a mode whose damping depends on its energy alone.

    b ~ H and a constant period make (11) elementary but for C, which is a Gauss rule over panels;
    its error is the difference from a rule of half as many points, and a bound of the tail.
    """
    process = mode_process(modes, mode)
    probe = probed(process)
    nodes = initial_nodes(probe, probe.extent(1e-2 * tol), ())
    ratio = float(modes.modal_mass[mode] / modes.noise[mode])
    rate = np.array([modes.damping[mode] / modes.modal_mass[mode]])
    if modes.state is not None:
        rate = modes.state.of_block((mode,)).polynomial()
    exponent = np.polynomial.polynomial.polyint(-ratio * rate)

    def fall(x: Array) -> Array:
        return np.asarray(np.polynomial.polynomial.polyval(x, exponent))

    (x, w), (y, v) = (panel_rule(nodes, points) for points in (POINTS, POINTS // 2))
    top = float(fall(x).max())
    norm = float(np.sum(w * np.exp(fall(x) - top)))
    relative = abs(float(np.sum(v * np.exp(fall(y) - top))) / norm - 1.0)
    # ln p is a sum of terms of the size of the polynomial of their sizes.
    cancelling = np.polynomial.polynomial.polyval(np.abs(x), np.abs(exponent))
    share = w * np.exp(fall(x) - top) / norm
    relative += EPS * float(4.0 + nodes.size + 2.0 * np.sum(share * cancelling))
    end = float(np.exp(fall(nodes[-1:]) - top)[0]) / norm
    tail = probe.tail_bound(float(nodes[-1]), end)

    def values(x: Array) -> Array:
        x = np.asarray(x, dtype=float)
        inside = (x >= 0.0) & (x <= nodes[-1])
        p = np.where(inside, np.exp(fall(np.clip(x, 0.0, nodes[-1])) - top), 0.0) / norm
        sizes = np.polynomial.polynomial.polyval(np.abs(x), np.abs(exponent))
        return np.stack([p, (relative + tail + 2.0 * EPS * sizes) * p])

    checks = Certificate(relative, 0.0, 0.0, tail)
    return EnergyDensity((nodes,), values, relative + 2.0 * tail, checks)


def marginal(joint: EnergyDensity, axis: int) -> EnergyDensity:
    """Return the density of one of two energies, the other integrated out panel by panel."""
    x, w = (part.ravel() for part in panel_rule(joint.panels[1 - axis], POINTS))

    def values(energy: Array) -> Array:
        H = np.asarray(energy, dtype=float)[..., None]
        pair = joint.values(H, x) if axis == 0 else joint.values(x, H)
        return np.asarray(pair @ w)

    return EnergyDensity((joint.panels[axis],), values, joint.l1_error, joint.certificate)


def swapped(joint: EnergyDensity) -> EnergyDensity:
    """Return the density of two energies in the other order."""
    panels = (joint.panels[1], joint.panels[0])
    return EnergyDensity(panels, lambda x, y: joint.values(y, x), joint.l1_error, joint.certificate)


def product(first: EnergyDensity, second: EnergyDensity) -> EnergyDensity:
    """Return the joint density of two energies that are independent."""

    def values(x: Array, y: Array) -> Array:
        (p, p_error), (r, r_error) = first.values(np.asarray(x)), second.values(np.asarray(y))
        return np.stack([p * r, p_error * np.abs(r) + np.abs(p) * r_error])

    return EnergyDensity(
        first.panels + second.panels,
        values,
        first.l1_error + second.l1_error,
        joined_checks([first.certificate, second.certificate]),
    )


def joined_checks(checks: Sequence[Certificate]) -> Certificate:
    """Return the certificate of what rests on several independent densities."""
    return Certificate(
        mass_defect=sum(c.mass_defect for c in checks),
        minimum=min(c.minimum for c in checks),
        residual=max(c.residual for c in checks),
        tail_mass=sum(c.tail_mass for c in checks),
        net_flux=max((c.net_flux for c in checks if c.net_flux is not None), default=None),
        failures=tuple(words for c in checks for words in c.failures),
    )
