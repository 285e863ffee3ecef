"""Densities u(H) of the full state, behind those of the energy, and their Weyl integrals."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, cached_property
from math import gamma
from typing import Literal

import numpy as np
from scipy.special import gammaincc

from averaging.zero_flux import ZeroFluxDensity
from fpk.arrays import Array
from fpk.certificate import Measured
from fpk.line.stationary import StationarySolution
from fpk.piecewise import Piecewise, interpolated
from fpk.probe import probed
from fpk.quadrature import gauss_legendre, panel_rule
from fpk.system import System

Function = Callable[[Array], Array]
Solution = StationarySolution | ZeroFluxDensity
"""Density of the energy by a solver: p = T u, T in the unit in which the process gives it."""
Part = Literal["value", "error", "table"]

POINTS = (14, 18)
"""Gauss points per element of a table and of its integrals, and of the finer table."""
COMPARED = (1.0 - 1e-12) * 0.5 * (1.0 - np.cos(np.linspace(0.0, np.pi, 2 * POINTS[1])))
"""Where two tables are compared, in [0, 1) of an element: dense at its ends, where they part."""
EPS, TINY = float(np.finfo(float).eps), float(np.finfo(float).tiny)
MOST_NODES = 100
"""Nodes up to which a mesh is halved once more: with 14 points an element, error falls by 2^-14."""


@dataclass(frozen=True, eq=False)
class StateDensity:
    """Stationary density of the full state, ρ(q, p) = u(H(q, p)), p(H) = T u, Eqs. (22), (30).

    ``solve`` gives p(H), which is computed when it is asked for: ``solution``. ``unit`` is the
    energy in whose unit T is given, ``end`` the last energy; ``measured`` holds for all densities
    that follow but that of H itself. ``weyl(ν, E, part)`` is
    Ψ_ν(E) = ∫_0^∞ u(E + x) x^(ν−1)/Γ(ν) dx, what is left of u where 2ν quadratic coordinates are
    integrated out, a factor (2π)^ν/√det aside; ``part`` is "value" when left out, "error" what the
    error of u leaves in it, and "table" the error of interpolating it. ``temperature`` is an energy
    over which u falls by about 1/e. Integrating out increases no L1 distance: the L1 error of p
    holds for all marginals but for that of the tables and of quadrature. ``closed`` says that u is
    a closed form, whose error is not that of T; ``gibbs`` that it is C exp(−H/temperature).
    """

    system: System
    solve: Callable[[], Solution]
    weyl: Callable[..., Array]
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
    """Return the density whose u and error of u are smooth between the panels of ``solution``.

    Weyl integrals are tabulated twice: the finer table is the answer, the largest distance to the
    other one in each element its error. Beyond the last node u is continued exponentially, to the
    relative error of u and of its rate in the last element. Where the damping depends on the state
    u is no exponential: the finer table then has elements half as long, too, and all that u was
    continued by, where it falls ever faster, is part of the error.
    """
    process, nodes = solution.process, solution.panels
    u, u_error = solution.phase_space_density, solution.phase_space_error
    varying = process.state_damping
    coarse = _halved(nodes) if varying and nodes.size < MOST_NODES else nodes
    fine = _halved(coarse) if varying else nodes
    tables = {"coarse": (coarse, u, POINTS[0]), "value": (fine, u, POINTS[1])}
    tables["error"] = (fine, u_error, POINTS[1])

    @cache
    def table(order: float, name: str) -> Piecewise:
        grid, function, points = tables[name]
        return weyl_table(order, grid, function, points=points)

    @cache
    def distance(order: float) -> Piecewise:
        value, other = table(order, "value"), table(order, "coarse")
        x = fine[:-1, None] + np.diff(fine)[:, None] * COMPARED
        relative = np.abs(np.expm1(other(x) - value(x))).max(axis=1)
        return Piecewise(fine, relative[:, None])

    @cache
    def continued_error(order: float) -> float:
        """Relative error of what is continued beyond the last node.

        It is that of u in the last element, ε, and of its rate there, 2 ε over the element's
        length, which counts over the mean distance ν/rate beyond.
        """
        x, _ = panel_rule(nodes[-2:], POINTS[0])
        relative = float((u_error(x) / np.maximum(u(x), TINY)).max())
        before, end = np.maximum(u(nodes[-2:]), TINY)
        return relative * (1.0 + 2.0 * order / max(float(np.log(before / end)), EPS))

    @cache
    def log_continued(order: float) -> Piecewise:
        def log_beyond(energy: Array) -> Array:
            return np.log(np.maximum(continued(order, energy, fine, u), TINY))

        return Piecewise(fine, interpolated(log_beyond, fine[:-1], fine[1:], POINTS[0] - 1))

    # Short of the last node, beyond which the tables end. u falls from there on, so that Ψ falls at
    # any order: its value here bounds what is dropped at any higher energy.
    last = nodes[-1] * (1.0 - 1e-9)

    def weyl(order: float, energy: Array, part: Part = "value") -> Array:
        if part == "error":
            dropped = np.exp(table(order, "value")(last))
            return np.where(energy < last, np.exp(table(order, "error")(energy)), dropped)
        if part == "value":
            return np.exp(table(order, "value")(energy))
        inside = np.minimum(energy, last)
        log_value = table(order, "value")(inside)
        # The logarithm has the round-off of its size.
        relative = distance(order)(inside) + EPS * np.maximum(np.abs(log_value), 1.0)
        error = np.exp(log_value) * relative
        beyond = np.exp(log_continued(order)(inside))
        error += beyond * (1.0 if varying else continued_error(order))
        return np.where(energy < last, error, 0.0)

    temperature = process.energy_scale / process.degrees_of_freedom
    if varying:
        # u need not fall from H = 0, and may change much faster than over the scale of the energy.
        temperature = min(temperature, probed(process).e_fold(float(nodes[-1])))
    end, measured = float(nodes[-1]), solution.measured
    return StateDensity(
        system,
        lambda: solution,
        weyl,
        temperature,
        process.energy_scale,
        end=end,
        measured=measured,
        closed=closed,
    )


def weyl_table(order: float, nodes: Array, u: Function, *, points: int = POINTS[1]) -> Piecewise:
    """Return ln Ψ_ν(E), Ψ_ν = ∫_E u(H) (H − E)^(ν−1)/Γ(ν) dH for ν = ``order`` = 0, ½, 1, ...

    Ψ_0 is u. Ψ falls exponentially, so its logarithm is what is smooth; it is −∞ beyond the last
    node. There u, smooth between ``nodes``, is continued exponentially at the rate of the last
    element: Ψ then keeps its relative accuracy up to that node.
    """
    left, right = nodes[:-1, None], nodes[1:, None]
    x, w = panel_rule(nodes, points)
    t, t_weights = gauss_legendre(points)

    def log_weyl(energy: Array) -> Array:
        if order == 0.0:
            return np.log(np.maximum(u(energy), TINY))
        values, total = w * u(x), np.zeros(energy.size)
        far = left - energy >= right - left
        k, i = np.nonzero(~far & (energy < right))
        # H = E + s² takes out the root at E.
        low, high = (
            np.sqrt(np.maximum(nodes[k + end] - energy[i], 0.0))[:, None] for end in (0, 1)
        )
        s = 0.5 * (low + high) + 0.5 * (high - low) * t
        inner = u(energy[i, None] + s * s) * 2.0 * s ** (2.0 * order - 1.0)
        near = (0.5 * (high - low) * inner) @ t_weights
        total += np.bincount(i, near, minlength=energy.size)
        for here, points_of, weighted in zip(far, x, values, strict=True):
            total[here] += (points_of - energy[here, None]) ** (order - 1.0) @ weighted
        beyond = continued(order, energy, nodes, u)
        return np.log(np.maximum(beyond + total / gamma(order), TINY))

    coefficients = interpolated(log_weyl, nodes[:-1], nodes[1:], points - 1)
    return Piecewise(nodes, coefficients, outside=-np.inf)


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


def _halved(nodes: Array) -> Array:
    """The nodes of a mesh with elements half as long."""
    return np.sort(np.concatenate([nodes, 0.5 * (nodes[1:] + nodes[:-1])]))
