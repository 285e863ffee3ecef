"""The density u(H) of the full state, and its Weyl integrals, of which marginals are multiples."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, cached_property, partial
from math import gamma
from typing import Literal

import numpy as np
from scipy.special import gammaincc

from averaging.zero_flux import ENERGY_RULES, ZeroFluxDensity
from fpk.answer.certificate import Measured
from fpk.numeric.arrays import EPS, SMALLEST, Array
from fpk.numeric.piecewise import Piecewise, legendre_coefficients
from fpk.numeric.quadrature import gauss_legendre, panel_rule
from fpk.solvers.line.mesh import probe_process
from fpk.solvers.line.stationary import StationarySolution
from fpk.system.system import System

Function = Callable[[Array], Array]
Solution = StationarySolution | ZeroFluxDensity
"""Density p = T u of the energy by a solver, T in the unit that the process uses."""
Part = Literal["value", "error", "table"]

COMPARISON_POINTS = (
    (1.0 - 1e-12) * 0.5 * (1.0 - np.cos(np.linspace(0.0, np.pi, 2 * ENERGY_RULES[1])))
)
"""Points in [0, 1) of an element at which two tables are compared, dense at its ends, where the
difference is largest."""


@dataclass(frozen=True, eq=False)
class StateDensity:
    """Stationary density of the full state, ρ(q, p) = u(H(q, p)), p(H) = T u, Eqs. (22), (30).

    ``solve`` computes p(H), called once, at the first use of ``solution``. T is relative to the
    density of states without contact at the energy ``unit``; u is 0 beyond ``end``. ``measured``
    holds for all marginal densities, since integrating out increases no L1 distance, but not for
    p(H). ``weyl(ν)(E, part)`` is Ψ_ν(E) = ∫_0^∞ u(E + x) x^(ν−1)/Γ(ν) dx: integrating u over 2ν
    quadratic coordinates gives (2π)^ν/√det times this. ``part`` is "value" for Ψ, "error" for the
    effect of the error of u on Ψ, "table" for the error of interpolating Ψ. u falls by a factor of
    about e over ``temperature``. ``closed``: u is a closed form, without the error of T; ``gibbs``:
    u is C exp(−H/``temperature``).
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
        """The density p(H) of the energy, solved for at the first use."""
        return self.solve()


def density_by_tables(system: System, solution: Solution, *, closed: bool = False) -> StateDensity:
    """Return the state density u = p/T of ``solution``, with tables of its Weyl integrals.

    u and its error are smooth between the panels of ``solution``; ``closed``: see ``StateDensity``.
    """
    process, end = solution.process, float(solution.nodes[-1])
    temperature = process.energy_scale / process.degrees_of_freedom
    if process.state_damping:
        # u need not fall at H = 0, and may change over much less than the scale of the energy.
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
    """Tables of the Weyl integrals of order ν = ``order`` of u, and of the error of u.

    The finer table of ln Ψ is the answer; its error is the largest relative difference to a coarser
    table in each element, plus the error of continuing u beyond the last node as an exponential. If
    damping depends on the state, u is no exponential: then the elements of the finer table are half
    as long, and the whole continuation counts as an error.
    """

    solution: Solution
    order: float

    @cached_property
    def nodes(self) -> tuple[Array, Array]:
        """Ends of elements of the coarser and finer table; the same without ``state_damping``."""
        meshes = [self.solution.panels]
        if not self.solution.process.state_damping:
            return meshes[0], meshes[0]
        # Halving an element lowers the error by about 2^-16; with many elements once is enough.
        for _ in range(2 if meshes[0].size < 100 else 1):
            x = meshes[-1]
            meshes.append(np.sort(np.append(x, 0.5 * (x[1:] + x[:-1]))))
        return meshes[-2], meshes[-1]

    @cached_property
    def value(self) -> Piecewise:
        """Finer table of ln Ψ; −∞ beyond the last node."""
        return weyl_table(self.order, self.nodes[1], self.solution.phase_space_density)

    @cached_property
    def error(self) -> Piecewise:
        """ln of the Weyl integral of order ν of the estimated error of u, on the finer mesh."""
        return weyl_table(self.order, self.nodes[1], self.solution.phase_space_error)

    @cached_property
    def distance(self) -> Piecewise:
        """Estimated relative error of Ψ by table and continuation, a constant in each element."""
        u, (coarse, fine) = self.solution.phase_space_density, self.nodes
        other = weyl_table(self.order, coarse, u, points=ENERGY_RULES[0])
        x = fine[:-1, None] + np.diff(fine)[:, None] * COMPARISON_POINTS
        relative = np.abs(np.expm1(other(x) - self.value(x))).max(axis=1)
        # Share of the continuation in Ψ, which rises with the energy.
        right = np.minimum(fine[1:], self.last)
        beyond = weyl_tail(self.order, right, fine, u) / np.exp(self.value(right))
        if not self.solution.process.state_damping:
            x, _ = panel_rule(fine[-2:], ENERGY_RULES[0])
            error = float((self.solution.phase_space_error(x) / np.maximum(u(x), SMALLEST)).max())
            before, end = np.maximum(u(fine[-2:]), SMALLEST)
            beyond *= error * (1.0 + 2.0 * self.order / max(float(np.log(before / end)), EPS))
        return Piecewise(fine, (relative + beyond)[:, None])

    @property
    def last(self) -> float:
        """Energy just below the last node; Ψ there bounds Ψ at all higher energies, given as 0."""
        return float(self.nodes[1][-1]) * (1.0 - 1e-9)

    def __call__(self, energy: Array, part: Part = "value") -> Array:
        """Return the ``part`` of Ψ, see ``StateDensity``, at ``energy`` of any shape.

        Beyond the last node the value is 0, with Ψ(``last``) as "error" and 0 as "table".
        """
        if part == "value":
            return np.exp(self.value(energy))
        within, inside = energy < self.last, np.minimum(energy, self.last)
        if part == "error":
            return np.where(within, np.exp(self.error(energy)), np.exp(self.value(self.last)))
        log_value = self.value(inside)
        # The round-off of ln Ψ is relative to its size.
        relative = self.distance(inside) + EPS * np.maximum(np.abs(log_value), 1.0)
        return np.where(within, np.exp(log_value) * relative, 0.0)


def weyl_table(
    order: float, nodes: Array, u: Function, *, points: int = ENERGY_RULES[1]
) -> Piecewise:
    """Return ln Ψ_ν(E), Ψ_ν = ∫_E^∞ u(H) (H − E)^(ν−1)/Γ(ν) dH for ν = ``order`` = 0, ½, 1, ...

    Ψ_0 is u, a function that is smooth between ``nodes``. The table has ``points`` coefficients on
    each element and is −∞ beyond the last node; there u is continued by ``weyl_tail``.
    """

    def log_weyl(energy: Array) -> Array:
        total = u(energy) if order == 0.0 else weyl_tail(order, energy, nodes, u)
        if order > 0.0:
            total = total + weyl_integral(order, nodes, u, energy, points=points)
        return np.log(np.maximum(total, SMALLEST))

    coefficients = legendre_coefficients(log_weyl, nodes[:-1], nodes[1:], points - 1)
    return Piecewise(nodes, coefficients, outside=-np.inf)


def weyl_integral(order: float, nodes: Array, u: Function, energy: Array, *, points: int) -> Array:
    """Return ∫_E^X u(H) (H − E)^(ν−1)/Γ(ν) dH, X the last of ``nodes``: Ψ_ν(E) without its tail.

    ν is ``order`` = ½, 1, ..., E is ``energy`` (energies,), u maps energies of any shape to
    arrays (*shape, *more); the result is (energies, *more), 0 for E above X. Each panel between
    nodes, or its part above E, has ``points`` Gauss points.
    """
    left, right = nodes[:-1, None], nodes[1:, None]
    x, w = panel_rule(nodes, points)
    values = np.einsum("kg,kg...->kg...", w, u(x))
    total = np.zeros((energy.size, *values.shape[2:]))
    far = left - energy >= right - left
    for here, x_k, weighted in zip(far, x, values, strict=True):
        total[here] += (x_k - energy[here, None]) ** (order - 1.0) @ weighted
    # The variable s, H = E + s², removes the root at E.
    k, i = np.nonzero(~far & (energy < right))
    low, high = (np.sqrt(np.maximum(nodes[k + end] - energy[i], 0.0))[:, None] for end in (0, 1))
    t, t_weights = gauss_legendre(points)
    s = 0.5 * (low + high) + 0.5 * (high - low) * t
    kernel = (high - low) * t_weights * s ** (2.0 * order - 1.0)
    np.add.at(total, i, np.einsum("kg,kg...->k...", kernel, u(energy[i, None] + s * s)))
    return np.asarray(total / gamma(order))


def weyl_tail(order: float, energy: Array, nodes: Array, u: Function) -> Array:
    """Return the part of Ψ_ν(E) from energies above the last of ``nodes``, ν = ``order``.

    u is continued there as an exponential with its mean rate of decrease over the last element; the
    result, of the shape of ``energy`` E, is 0 if u does not decrease there, and for ν = 0.
    """
    before, last = u(nodes[-2:])
    if order == 0 or not before > last > 0.0:
        return np.zeros(energy.shape)
    rate = np.log(before / last) / (nodes[-1] - nodes[-2])
    reach = rate * np.maximum(nodes[-1] - energy, 0.0)
    # Γ(ν, reach) underflows to 0 far from the end, its logarithm to −∞: the tail is 0 there.
    with np.errstate(divide="ignore"):
        log_share = reach + np.log(gammaincc(order, reach))
    return np.asarray(last * rate**-order * np.exp(log_share))
