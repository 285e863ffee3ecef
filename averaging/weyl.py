"""Densities u(H) of the full state, behind those of the energy, and their Weyl integrals."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, cached_property, partial
from math import gamma
from typing import Literal

import numpy as np
from scipy.special import gammaincc

from averaging.zero_flux import ZeroFluxDensity
from fpk.answer.certificate import Measured
from fpk.numeric.arrays import EPS, SMALLEST, Array
from fpk.numeric.piecewise import Piecewise, legendre_coefficients
from fpk.numeric.quadrature import gauss_legendre, panel_rule
from fpk.solvers.line.mesh import probe_process
from fpk.solvers.line.stationary import StationarySolution
from fpk.system.system import System

Function = Callable[[Array], Array]
Solution = StationarySolution | ZeroFluxDensity
"""Density of the energy by a solver: p = T u, T in the unit in which the process gives it."""
Part = Literal["value", "error", "table"]

POINTS = (14, 18)
"""Gauss points per element of a table and of its integrals, and of the finer table."""
COMPARED = (1.0 - 1e-12) * 0.5 * (1.0 - np.cos(np.linspace(0.0, np.pi, 2 * POINTS[1])))
"""Where two tables are compared, in [0, 1) of an element: dense at its ends, where they part."""


@dataclass(frozen=True, eq=False)
class StateDensity:
    """Stationary density of the full state, ρ(q, p) = u(H(q, p)), p(H) = T u, Eqs. (22), (30).

    ``solve`` gives p(H), the ``solution``, when it is asked for. ``unit`` is the energy in whose
    unit T is given, ``end`` the last energy; ``measured`` holds for all densities that follow but
    that of H itself: integrating out increases no L1 distance. ``weyl(ν)(E, part)`` is
    Ψ_ν(E) = ∫_0^∞ u(E + x) x^(ν−1)/Γ(ν) dx, what is left of u where 2ν quadratic coordinates are
    integrated out, a factor (2π)^ν/√det aside; ``part`` is "value", "error" what the error of u
    leaves in it, or "table" the error of interpolating it. Over ``temperature`` u falls by about
    1/e. ``closed``: u is a closed form, whose error is not that of T; ``gibbs``: it is
    C exp(−H/temperature).
    """

    system: System
    solve: Callable[[], Solution]
    weyl: Callable[[float], Callable[..., Array]]
    temperature: float
    unit: float
    end: float
    measured: Measured
    closed: bool = False
    gibbs: bool = False

    @cached_property
    def solution(self) -> Solution:
        """The density of the energy."""
        return self.solve()


def tabulated(system: System, solution: Solution, *, closed: bool = False) -> StateDensity:
    """Return the density whose u and error of u are smooth between the panels of ``solution``."""
    process, end = solution.process, float(solution.nodes[-1])
    temperature = process.energy_scale / process.degrees_of_freedom
    if process.state_damping:
        # u need not fall from H = 0, and may change much faster than over the scale of the energy.
        temperature = min(temperature, probe_process(process).e_fold(end))
    return StateDensity(
        system,
        lambda: solution,
        cache(partial(WeylIntegrals, solution)),
        temperature,
        process.energy_scale,
        end,
        solution.measured,
        closed=closed,
    )


@dataclass(frozen=True, eq=False)
class WeylIntegrals:
    """Tables of the Weyl integrals of one ``order`` of u and of its error.

    The finer table of u is the answer, the largest relative distance to a coarser one in each
    element its error. To it comes the error of the continuation of u beyond the last node: its
    relative error ε in the last element and the error of its rate there, 2 ε over the length of
    it, over the mean distance ν/rate beyond. Where the damping depends on the state u is no
    exponential: the finer table has elements half as long, and all that u was continued by counts.
    """

    solution: Solution
    order: float

    @cached_property
    def nodes(self) -> tuple[Array, Array]:
        """Ends of the elements of the coarser table and of the finer one."""
        meshes = [self.solution.panels]
        if not self.solution.process.state_damping:
            return meshes[0], meshes[0]
        # With 14 points an element a halving lowers the error by 2^-14: one is enough of many.
        for _ in range(2 if meshes[0].size < 100 else 1):
            x = meshes[-1]
            meshes.append(np.sort(np.append(x, 0.5 * (x[1:] + x[:-1]))))
        return meshes[-2], meshes[-1]

    @cached_property
    def value(self) -> Piecewise:
        """ln Ψ of u."""
        return weyl_table(self.order, self.nodes[1], self.solution.phase_space_density)

    @cached_property
    def error(self) -> Piecewise:
        """ln Ψ of the error of u."""
        return weyl_table(self.order, self.nodes[1], self.solution.phase_space_error)

    @cached_property
    def distance(self) -> Piecewise:
        """Relative error of Ψ by its table, a constant in each element."""
        u, (coarse, fine) = self.solution.phase_space_density, self.nodes
        other = weyl_table(self.order, coarse, u, points=POINTS[0])
        x = fine[:-1, None] + np.diff(fine)[:, None] * COMPARED
        relative = np.abs(np.expm1(other(x) - self.value(x))).max(axis=1)
        # The share of what u was continued by rises with the energy.
        right = np.minimum(fine[1:], self.last)
        beyond = continued(self.order, right, fine, u) / np.exp(self.value(right))
        if not self.solution.process.state_damping:
            x, _ = panel_rule(fine[-2:], POINTS[0])
            error = float((self.solution.phase_space_error(x) / np.maximum(u(x), SMALLEST)).max())
            before, end = np.maximum(u(fine[-2:]), SMALLEST)
            beyond *= error * (1.0 + 2.0 * self.order / max(float(np.log(before / end)), EPS))
        return Piecewise(fine, (relative + beyond)[:, None])

    @property
    def last(self) -> float:
        """An energy just short of the last node: Ψ here bounds what is dropped beyond."""
        return float(self.nodes[1][-1]) * (1.0 - 1e-9)

    def __call__(self, energy: Array, part: Part = "value") -> Array:
        """Return a part of Ψ as ``StateDensity.weyl`` does."""
        if part == "value":
            return np.exp(self.value(energy))
        within, inside = energy < self.last, np.minimum(energy, self.last)
        if part == "error":
            return np.where(within, np.exp(self.error(energy)), np.exp(self.value(self.last)))
        log_value = self.value(inside)
        # The logarithm has the round-off of its size.
        relative = self.distance(inside) + EPS * np.maximum(np.abs(log_value), 1.0)
        return np.where(within, np.exp(log_value) * relative, 0.0)


def weyl_table(order: float, nodes: Array, u: Function, *, points: int = POINTS[1]) -> Piecewise:
    """Return ln Ψ_ν(E), Ψ_ν = ∫_E u(H) (H − E)^(ν−1)/Γ(ν) dH for ν = ``order`` = 0, ½, 1, ...

    Ψ_0 is u. Its logarithm is smooth, and −∞ beyond the last node. There u, smooth between
    ``nodes``, is ``continued``: Ψ then keeps its relative accuracy up to that node.
    """

    def log_weyl(energy: Array) -> Array:
        total = u(energy) if order == 0.0 else continued(order, energy, nodes, u)
        if order > 0.0:
            total = total + weyl_integral(order, nodes, u, energy, points=points)
        return np.log(np.maximum(total, SMALLEST))

    coefficients = legendre_coefficients(log_weyl, nodes[:-1], nodes[1:], points - 1)
    return Piecewise(nodes, coefficients, outside=-np.inf)


def weyl_integral(order: float, nodes: Array, u: Function, energy: Array, *, points: int) -> Array:
    """Return Ψ_ν (n, *more) of u (*shape, *more) up to the last node, ν = ``order`` = ½, 1, ...

    By ``points`` of Gauss between ``nodes``, or on what of a panel is above E.
    """
    left, right = nodes[:-1, None], nodes[1:, None]
    x, w = panel_rule(nodes, points)
    values = np.einsum("kg,kg...->kg...", w, u(x))
    total = np.zeros((energy.size, *values.shape[2:]))
    far = left - energy >= right - left
    for here, x_k, weighted in zip(far, x, values, strict=True):
        total[here] += (x_k - energy[here, None]) ** (order - 1.0) @ weighted
    # H = E + s² takes out the root at E.
    k, i = np.nonzero(~far & (energy < right))
    low, high = (np.sqrt(np.maximum(nodes[k + end] - energy[i], 0.0))[:, None] for end in (0, 1))
    t, t_weights = gauss_legendre(points)
    s = 0.5 * (low + high) + 0.5 * (high - low) * t
    kernel = (high - low) * t_weights * s ** (2.0 * order - 1.0)
    np.add.at(total, i, np.einsum("kg,kg...->k...", kernel, u(energy[i, None] + s * s)))
    return np.asarray(total / gamma(order))


def continued(order: float, energy: Array, nodes: Array, u: Function) -> Array:
    """Ψ_ν of what lies beyond the last node, for u falling there as over the last element."""
    before, last = u(nodes[-2:])
    if order == 0 or not before > last > 0.0:
        return np.zeros(energy.shape)
    rate = np.log(before / last) / (nodes[-1] - nodes[-2])
    reach = rate * np.maximum(nodes[-1] - energy, 0.0)
    # ln of e^reach Γ(ν, reach)/Γ(ν) underflows to −∞ far from the end, where the tail is nothing.
    with np.errstate(divide="ignore"):
        log_share = reach + np.log(gammaincc(order, reach))
    return np.asarray(last * rate**-order * np.exp(log_share))
