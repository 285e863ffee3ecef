"""Averages over the energy shell, relative to those without contact, Eqs. (10), (25), (28).

Without contact the density of states is ``T ~ H^(n−1)``, the phase volume ``T H / n`` and the power
of a damping term of degree d ``~ H^(1 + d/2)``. Contact multiplies the first two by ratios between
0 and 1, and lets the factor of the last depend on H; below the first contact energy it does not.
"""

from collections.abc import Callable
from math import gamma, lgamma, pi
from typing import NamedTuple

import numpy as np
from scipy.special import beta

from averaging.shell.energy_shell import TARGET, EnergyShell
from averaging.shell.laplace import PartitionLines, by_lines
from averaging.shell.parts import ROUND_OFF, parts_along_rays, parts_of
from fpk.numeric.arrays import EPS, Array
from fpk.numeric.piecewise import Piecewise, fit
from fpk.numeric.quadrature import panel_rule
from fpk.system.system import System

TARGETS = (8e-13, 3e-14)
"""Disagreement of two rules, for n = 1 and more, that ends the refinement of the power over one
contact mass, near round-off: the power cancels against the noise, and its error adds up in ln p."""
GRADING, LAYERS = 0.2, 5
"""Panels of a table shrink by this ratio towards each contact energy from above, where (H − H_c)³
or rougher terms begin, and as many times at first."""
POINTS = 16
"""Gauss points of a panel of a table."""
FIT_TARGET = 1e-11
"""Last Legendre coefficients of a panel, relative to the largest, above which it is split."""


class ShellAverages(NamedTuple):
    """Averages over the energy shell at some energies; each array has the energies' shape.

    ``states`` = T(H)/T_lin(H) with T the density of states ∫δ(H − H(q,p)) dq dp (twice the T of
    (10), which integrates over ∂H/∂p_1 > 0 only; for n = 1 it is the period), ``volume`` the same
    of the phase volume Φ = ∫T dH, ``log_slope`` = H T'/T. ``error`` is the relative error of the
    first two. ``power`` is ⟨Σ c_ij v_i v_j⟩_H of the damping terms, energy/time, Eq. (10) for
    c_ij(q, v), and ``power_error`` its error.
    """

    states: Array
    volume: Array
    log_slope: Array
    error: Array
    power: Array
    power_error: Array


def log_linear_states(system: System, energy: Array | float) -> Array:
    """Return ln T_lin(H) of the chain without contacts, (2π)^n √(Π m / det K) H^(n−1)/Γ(n)."""
    n = system.n
    # det K of a chain that is fixed at one end is the product of its springs.
    prefactor = n * np.log(2.0 * pi) + 0.5 * np.sum(np.log(system.mass / system.stiffness))
    return np.asarray(prefactor - lgamma(n) + (n - 1) * np.log(energy))


def shell_averages(system: System, energy: Array) -> ShellAverages:
    """Return the averages at energies > 0 (energies,), for any contacts and damping terms.

    Of the (2n−1)-fold integrals of (10) those over momenta and displacements without contact are
    exact, which leaves ∫(H − V_red)^(n − c/2 − 1) dq_c over the c contact masses, times polynomials
    for the power: for one it is integrated afresh, for two interpolated, for more it follows from
    the partition function of the chain.
    """
    values, errors = np.swapaxes(shell_columns(system, energy), 0, 1)
    powers = energy[:, None] ** (1.0 + 0.5 * system.fact(parts_of).degrees)
    states, volume, log_slope = values[:, :3].T.copy()
    power, power_error = (np.sum(powers * x[:, 3:], axis=1) for x in (values, errors))
    return ShellAverages(states, volume, log_slope, errors[:, 0].copy(), power, power_error)


def shell_columns(system: System, energy: Array) -> Array:
    """Return T/T_lin, the same of the phase volume, H T'/T and the g_d, and their errors.

    An array (energies, 2, 3 + degrees), values before errors: Σ_d g_d H^(1 + d/2) is the power of
    the damping terms. The errors of the first two are equal and relative; H T'/T has none.
    """
    shell, parts = system.fact(EnergyShell), system.fact(parts_of)
    columns = np.zeros((energy.size, 2, 3 + parts.degrees.size))
    columns[:, 0, :3] = 1.0, 1.0, system.n - 1.0
    columns[:, 0, 3:] = parts.free
    first = shell.contact_energies[0] if shell.contact_energies else np.inf
    slack = 4.0 * EPS if system.n == 1 else 0.0  # a few roundings of H and of V at a stop
    touching = (energy > first * (1.0 - slack)).nonzero()[0]
    if touching.size:
        above = energy[touching]
        if shell.count == 1:
            columns[touching] = _along_rays(system, above)
        elif by_lines(shell):
            columns[touching] = system.fact(PartitionLines)(above, shell_columns)
        else:
            columns[touching] = system.fact(_table)(above)
    columns[:, 1, 3:] += ROUND_OFF * parts.scale  # of the parts, however they are integrated
    return columns


def _along_rays(system: System, energy: Array) -> Array:
    """The columns above the first contact energy, by quadrature over one or two contact masses."""
    shell, parts = system.fact(EnergyShell), system.fact(parts_of)
    n, c = system.n, shell.count
    target = TARGETS[min(n, 2) - 1] if c == 1 else TARGET
    sums, errors = shell.integrals(energy, *system.fact(parts_along_rays), target)
    a = n - 0.5 * c - 1.0
    flat = (2.0 * pi) ** (0.5 * c) * float(beta(a + 1.0, 0.5 * c)) / gamma(0.5 * c)
    states = sums[:, :1]
    columns = np.zeros((energy.size, 2, 3 + parts.degrees.size))
    columns[:, 0, :2] = sums[:, :2] / [flat, flat * (a + 1.0) / n]
    columns[:, 0, 2:3] = sums[:, 2:3] / states
    columns[:, 1, :2] = np.maximum(errors[:, :1], errors[:, 1:2])
    if n == 1:
        rises = energy[:, None] - shell.potential(shell.stops.touch[:, None] / shell.stops.reach)
        # The part of T_lin beyond a stop is up to √(1 − V/H)/π, V at the stop.
        rises = rises / energy[:, None] + 4.0 * EPS * np.array([-1.0, 1.0])[:, None, None]
        beyond = np.diff(np.sqrt(np.maximum(rises, 0.0)), axis=0)[0].sum(axis=1) / pi
        columns[:, 1, :2] += beyond[:, None] * flat / states
    if not parts.degrees.size:
        return columns
    shifted, most = np.split(sums[:, 3:], 2, axis=1)
    columns[:, 0, 3:] = (shifted - 2.0 * most) / states
    # The errors of shifted (at most 3 of most), of 2 most and of T (g is at most most).
    largest = errors[:, [0, *range(3, errors.shape[1])]].max(axis=1, keepdims=True)
    columns[:, 1, 3:] = 6.0 * largest * most / states
    return columns


def _table(system: System) -> Callable[[Array], Array]:
    """The columns over two contact masses, smooth between contact energies.

    One energy takes milliseconds, and a solver asks for thousands: a panel is fitted once as many
    energies are asked for as a fit needs. Powers are in units of their sizes.
    """
    parts, breaks = system.fact(parts_of), system.fact(EnergyShell).contact_energies
    unit = np.append(np.ones(3), np.where(parts.scale > 0.0, parts.scale, 1.0))
    ends = np.array([*breaks, 2.0 * breaks[-1] if breaks[-1] > 0 else 1.0])
    towards = ends[:-1, None] + np.diff(ends)[:, None] * GRADING ** np.arange(1.0, LAYERS + 1.0)
    # Above the highest contact energy each panel is twice as long as the one below it.
    edges = np.unique(np.concatenate([breaks, towards.ravel(), ends[-1] * 2.0 ** np.arange(60.0)]))
    panels: dict[int, Piecewise] = {}
    single: dict[float, Array] = {}  # solvers begin by asking for the same energies

    def fitted(ends: Array) -> Piecewise:
        """The fit between two edges, with a constant bound of the error on each of its panels."""
        values = fit(
            lambda energy: np.asarray(_along_rays(system, energy) / unit),
            ends,
            FIT_TARGET,
            degree=POINTS - 1,
            cut=lambda left, right: left + GRADING * (right - left),
            estimate=lambda _, c: np.abs(c[:, -2:, 0]).max(axis=(1, 2)),
            rounds=8,  # 2e-6 of a panel: errors of the quadrature no panel resolves
        )
        assert values.error is not None
        # The fit goes through what was evaluated at the Gauss points.
        largest = values(panel_rule(values.nodes, POINTS)[0])[:, :, 1].max(axis=1)
        values.coefficients[:, :, 1] = 0.0
        values.coefficients[:, 0, 1] = 2.0 * values.error[:, None] + largest
        return values

    def columns(energy: Array) -> Array:
        index = np.searchsorted(edges, energy, side="right") - 1
        used, count = np.unique(index, return_counts=True)
        for k in used[count >= POINTS].tolist():
            if k not in panels:
                panels[k] = fitted(edges[k : k + 2])
        result = np.empty((energy.size, 2, unit.size))
        for k in panels.keys() & set(used.tolist()):
            result[index == k] = panels[k](energy[index == k])
        others = ~np.isin(index, list(panels))
        asked = energy[others].tolist()
        if new := [H for H in asked if H not in single]:
            single.update(zip(new, _along_rays(system, np.array(new)) / unit, strict=True))
        result[others] = np.reshape([single[H] for H in asked], (-1, 2, unit.size))
        return np.asarray(result * unit)

    return columns
