"""Averages over the energy shell, relative to those without contact, Eqs. (10), (25), (28).

Without contact the density of states is ``T ~ H^(n−1)``, the phase volume ``T H / n`` and the power
of a damping term of degree d ``~ H^(1 + d/2)``. Contact multiplies the first two by ratios between
0 and 1, and lets the factor of the last depend on H; below the first contact energy it does not.
"""

from collections.abc import Callable
from math import gamma, lgamma, pi
from typing import Any, NamedTuple

import numpy as np
from scipy.special import beta

from averaging.shell.laplace import MOMENTS, PartitionLines, by_lines, parts_of
from averaging.shell.rays import EnergyShell, gauss_rules, ray_integrals
from fpk.numeric.arrays import EPS, Array, Integers
from fpk.numeric.piecewise import Piecewise, fit
from fpk.numeric.quadrature import gauss_legendre, panel_rule
from fpk.system.system import System, looks_the_same_mirrored

RULES = (14, 18, 24, 48, 96, 192)
"""Gauss points per panel, in the order in which an integral is refined."""
RADIAL_RULE = 2
"""Index of the rule of 24 points, enough along a ray for any contact stiffness, not over angles."""
TARGET = 3e-12
"""Relative disagreement of two rules that ends the refinement and is reported as the error."""
TARGETS = (8e-13, 3e-14)
"""Relative disagreement, for n = 1 and for more masses, that ends the refinement of the power over
one contact mass: near round-off, as it cancels against the noise and its error adds up in ln p."""
ROUND_OFF = 2e-15
"""Relative error of a sum of some dozens of positive terms."""
ROOT_ROUND_OFF = 4e-13
"""Relative error of a sum of a system of one mass, ε points²: its integrand is 1/√v, v = 1 − V/H,
where v ~ 1/points² at the Gauss point next to the turning point."""
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

    Left of (10) is ∫(H − V_red)^(n − c/2 − 1) dq_c over the c contact masses, times polynomials for
    the power: for one it is integrated afresh, for two interpolated, for more it follows from the
    partition function of the chain.
    """
    values, errors = np.swapaxes(shell_columns(system, energy), 0, 1)
    powers = energy[:, None] ** (1.0 + 0.5 * system.fact(parts_of).degrees)
    states, volume, log_slope = values[:, :3].T.copy()
    power, power_error = (np.vecdot(powers, x[:, 3:]) for x in (values, errors))
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
        if len(system.contact_masses) == 1:
            columns[touching] = _along_rays(system, above)
        elif by_lines(system):
            columns[touching] = system.fact(PartitionLines)(above, shell_columns)
        else:
            columns[touching] = system.fact(_table)(above)
    columns[:, 1, 3:] += MOMENTS * parts.scale  # of the parts, however they are integrated
    return columns


def _along_rays(system: System, energy: Array) -> Array:
    """The columns above the first contact energy, by quadrature over one or two contact masses."""
    shell, parts = system.fact(EnergyShell), system.fact(parts_of)
    n, c = system.n, len(system.contact_masses)
    sums, errors = _integrals(system, energy)
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
    if parts.degrees.size:
        shifted, most = np.split(sums[:, 3:], 2, axis=1)
        columns[:, 0, 3:] = (shifted - 2.0 * most) / states
        # The errors of shifted (at most 3 of most), of 2 most and of T (g is at most most).
        largest = errors[:, [0, *range(3, errors.shape[1])]].max(axis=1, keepdims=True)
        columns[:, 1, 3:] = 6.0 * largest * most / states
    return columns


def _integrals(system: System, energy: Array) -> tuple[Array, Array]:
    """Integrals over the shells (energies, quantities), and their errors, of that shape.

    These are T, phase volume and H T', then for each degree T g_d plus twice a bound of it, so that
    it is positive, and the bound: sums over all directions of integrals along rays. Errors are
    relative, of H T' to T at the least. Rules are refined down to ``TARGET``, or ``TARGETS``.
    """
    shell, parts = system.fact(EnergyShell), system.fact(parts_of)
    n, c = system.n, len(system.contact_masses)
    add_rays = ray_integrals(shell.laws, 2 * n - c - 2 <= 0)
    cuts = _cut_angles(shell, energy) if c == 2 else np.empty((energy.size, 0))
    mirror = system.fact(looks_the_same_mirrored)

    def sums(i: Integers, rules: range) -> Array:
        """The quantities at some energies by some of the ``RULES``, (rules, energies, ·)."""
        which, directions, weights = _rays(cuts[i], RULES[rules[0]], mirror=mirror)
        H = energy[i[which]]
        nearest = shell.sides if c == 1 else shell.nearest(directions)
        last = len(RULES) if c == 1 else RADIAL_RULE
        radial = gauss_rules(tuple(RULES[min(k, last)] for k in rules))
        out = np.zeros((len(rules), which.size, 3 + len(parts.along)))
        add_rays(H, c, nearest, n, parts.along, *radial, out)
        if parts.degrees.size:
            of_degree, odd = parts.of_group @ (parts.of_degree > 0.0), parts.powers % 2
            widest = np.linalg.norm(shell.L, axis=1)
            radial_parts = out[..., 3 + parts.column] * parts.rest
            q = (directions @ shell.L.T)[:, None, :]
            # |q| <= ½ (f + q²/f), f the largest |q|: smooth, as a kink would spoil the rules.
            bound = 0.5 * (widest + q * q / widest)
            power = parts.coefficient * np.prod(q**parts.powers, axis=2)
            most = parts.size * np.prod(q ** (parts.powers - odd) * bound**odd, axis=2)
            power, most = ((radial_parts * x) @ of_degree for x in (power, most))
            # Positive, so that no error is relative to nothing.
            out = np.concatenate([out[..., :3], power + 2.0 * most, most], axis=-1)
        out *= weights[:, None]
        if which.size == i.size:  # one ray an energy
            return out
        return np.add.reduceat(out, np.searchsorted(which, np.arange(i.size)), axis=1)

    def error_of(coarse: Array, fine: Array) -> Array:
        size = np.abs(fine)
        size[:, 2] = np.maximum(size[:, 2], fine[:, 0])
        return np.abs(coarse - fine) / size + (ROUND_OFF if n > 1 else ROOT_ROUND_OFF)

    # Rays of one contact mass serve both rules; of two each rule has its own.
    first = [range(2)] if c == 1 else [range(1), range(1, 2)]
    coarse, fine = np.concatenate([sums(np.arange(energy.size), rules) for rules in first])
    error = error_of(coarse, fine)
    targets = np.full(fine.shape[1], TARGETS[min(n, 2) - 1] if c == 1 else TARGET)
    targets[:3] = TARGET
    for rule in range(2, len(RULES)):
        i = np.flatnonzero(~np.all(error <= targets, axis=1))  # no number is refined, too
        if not i.size:
            break
        (finer,) = sums(i, range(rule, rule + 1))
        error[i], fine[i] = error_of(fine[i], finer), finer
    return fine, np.where(np.isnan(error), np.inf, error)


def _cut_angles(shell: EnergyShell, energy: Array) -> Array:
    """Angles (energies, cuts) where a stop joins or leaves the shell; 0 for no cut."""
    fixed = [0.0, 0.5 * pi, *np.arctan2(shell.corners[:, 1], shell.corners[:, 0])]
    touch, rows = shell.first_touch, shell.stops.reach
    angles = np.zeros((2, len(touch), energy.size))
    stop, level = np.nonzero(shell.potential(touch)[:, None] < energy)
    if stop.size:
        # On the line where a stop is just touched V is convex: H is met once on either side of the
        # lowest point, no farther than where the springs alone reach it.
        (x0, y0), H = touch[stop].T, energy[level]
        dx, dy = np.array([-rows[stop, 1], rows[stop, 0]]) / np.linalg.norm(rows[stop], axis=1)
        end = np.array([[1.0], [-1.0]]) * (1.000000001 * np.sqrt(2.0 * H) + np.hypot(x0, y0))

        def excess(t: Array, *line: Array) -> Array:
            x0, y0, dx, dy, H = line
            return shell.potential(np.stack([x0 + t * dx, y0 + t * dy], axis=-1)) - H

        from scipy.optimize import elementwise  # noqa: PLC0415  (it takes 0.2 s)

        find_root: Any = elementwise.find_root  # typed without further arguments
        t = find_root(excess, (0.0 * end, end), args=(x0, y0, dx, dy, H)).x
        angles[:, stop, level] = np.arctan2(y0 + t * dy, x0 + t * dx)
    return np.hstack([np.tile(fixed, (energy.size, 1)), angles.reshape(-1, energy.size).T])


def _rays(cuts: Array, nodes: int, *, mirror: bool) -> tuple[Integers, Array, Array]:
    """Index of each ray's energy (rays,), the directions (rays, c), the weights (rays,).

    Without ``cuts`` (energies, cuts) one mass has contact; of two there are Gauss panels over the
    angle between these: sin² towards both ends of a panel turns the half-integer powers that Hertz
    contact leaves there into smooth functions. ``mirror`` says that V is even.
    """
    if not cuts.shape[1]:
        sides = np.array([[1.0]] if mirror else [[1.0], [-1.0]])
        which, side = np.divmod(np.arange(len(cuts) * len(sides)), len(sides))
        return which, sides[side], np.full(which.size, 2.0 / len(sides))
    period = pi if mirror else 2.0 * pi
    cuts = np.sort(cuts % period, axis=1)
    cuts = np.concatenate([cuts, cuts[:, :1] + period], axis=1)
    t, w = gauss_legendre(nodes)
    psi = 0.25 * pi * (1.0 + t)
    share, slope = np.sin(psi) ** 2, 0.25 * pi * np.sin(2.0 * psi) * w
    length = np.diff(cuts, axis=1)[:, :, None]
    angle, weight = cuts[:, :-1, None] + length * share, length * slope
    keep = weight != 0.0  # a cut that is no number makes a sum that is none
    directions = np.stack([np.cos(angle[keep]), np.sin(angle[keep])], axis=1)
    return np.nonzero(keep)[0], directions, weight[keep] * (2.0 * pi / period)


def _table(system: System) -> Callable[[Array], Array]:
    """The columns over two contact masses, smooth between contact energies.

    One energy takes milliseconds, and a solver asks for thousands: a panel is fitted where enough
    of them are asked for at once. Powers are in units of their sizes.
    """
    parts, breaks = system.fact(parts_of), system.fact(EnergyShell).contact_energies
    unit = np.append(np.ones(3), np.where(parts.scale > 0.0, parts.scale, 1.0))
    ends = np.array([*breaks, 2.0 * breaks[-1] if breaks[-1] > 0 else 1.0])
    # T also changes over H itself, which may be far less than the gap to the next contact energy.
    gaps = np.minimum(np.diff(ends), np.where(ends[:-1] > 0.0, ends[:-1] / GRADING, np.inf))
    towards = ends[:-1, None] + gaps[:, None] * GRADING ** np.arange(1.0, LAYERS + 1.0)
    rising = np.minimum(ends[ends > 0.0][0] * GRADING ** -np.arange(60.0), ends[-1])
    # Above the highest contact energy each panel is twice as long as the one below it.
    above = ends[-1] * 2.0 ** np.arange(60.0)
    edges = np.unique(np.concatenate([breaks, towards.ravel(), rising, above]))
    panels: dict[int, Piecewise] = {}
    single: dict[float, Array] = {}  # the next question asks for the same: 20 ms, not 140

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
