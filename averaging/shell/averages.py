"""Averages over the energy shell, relative to those without contact, Eqs. (10), (25), (28).

Without contact the density of states is ``T ~ H^(n−1)``, the phase volume ``T H / n`` and the power
of a damping term of degree d ``g_d H^(1 + d/2)``. Contact multiplies the first two by ratios
between 0 and 1 and makes g_d depend on H; below the first contact energy it changes nothing.
"""

from collections.abc import Callable
from math import gamma, lgamma, pi
from typing import Any, NamedTuple

import numpy as np
from scipy.special import beta

from averaging.shell.laplace import MOMENT_ROUND_OFF, PartitionLines, by_lines, parts_of
from averaging.shell.rays import EnergyShell, gauss_rules, ray_integrals
from averaging.zero_flux import ENERGY_RULES
from fpk.numeric.arrays import EPS, ROUNDINGS, Array, Integers
from fpk.numeric.piecewise import Piecewise, fit
from fpk.numeric.quadrature import gauss_legendre, panel_rule
from fpk.system.system import System, looks_the_same_mirrored

RAY_RULES = (14, 18, 24, 48, 96, 192)
"""Gauss points per panel of the successive refinements of an integral."""
RADIAL_RULE = 2
"""Index in ``RAY_RULES`` of the finest rule along rays of two contact masses: its 24 points suffice
there for any contact stiffness, but not over the angles."""
TARGET = 3e-12
"""Relative difference of two rules that ends the refinement; the difference is the stated error."""
POWER_TARGETS = (8e-13, 3e-14)
"""Relative difference of two rules that ends the refinement of the power of damping terms with one
contact mass, for n = 1 and for n > 1: close to round-off, because the power cancels against the
noise and its errors accumulate in ln p."""
ROOT_ROUND_OFF = 4e-13
"""Relative round-off of the sum for one mass, ε points²: the integrand is 1/√v, v = 1 − V/H, and at
the Gauss point next to the turning point v ~ 1/points²."""
GRADING, LAYERS = 0.2, 5
"""Ratio of neighbouring panels of a table above each contact energy H_c, and their number: terms in
(H − H_c)³ or less smooth begin there."""
FIT_TARGET = 1e-11
"""Size of the last two Legendre coefficients above which a panel of a table is split; the tabulated
ratios are of the order of 1."""


class ShellAverages(NamedTuple):
    """Averages over the energy shell at some energies; each array has the shape of the energies.

    ``states`` is T(H)/T_lin(H), T the density of states ∫δ(H − H(q,p)) dq dp (twice the T of (10),
    which integrates over ∂H/∂p_1 > 0 only; for n = 1 it is the period), T_lin without contact.
    ``volume`` is Φ/Φ_lin, Φ = ∫T dH the phase volume, ``log_slope`` is H T'/T. ``error`` is the
    relative error of ``states`` and of ``volume``. ``power`` is ⟨Σ c_ij v_i v_j⟩_H of the damping
    terms, energy/time, Eq. (10) for c_ij(q, v), and ``power_error`` its absolute error.
    """

    states: Array
    volume: Array
    log_slope: Array
    error: Array
    power: Array
    power_error: Array


def log_linear_states(system: System, energy: Array | float) -> Array:
    """Return ln T_lin at ``energy`` H > 0, T_lin = (2π)^n √(Π m/det K) H^(n−1)/Γ(n)."""
    n = system.n
    # det K of a chain that is fixed at one end is the product of its spring constants.
    prefactor = n * np.log(2.0 * pi) + 0.5 * np.sum(np.log(system.mass / system.stiffness))
    return np.asarray(prefactor - lgamma(n) + (n - 1) * np.log(energy))


def shell_averages(system: System, energy: Array) -> ShellAverages:
    """Return the averages at ``energy`` > 0 (energies,), for any contacts and damping terms.

    (10) reduces to ∫(H − V_red)^(n − c/2 − 1) dq_c over the c contact masses, times polynomials for
    the power. For one contact mass it is evaluated at each energy, for two interpolated in tables;
    if ``by_lines`` it follows from the partition function of the chain.
    """
    values, errors = np.swapaxes(shell_columns(system, energy), 0, 1)
    powers = energy[:, None] ** (1.0 + 0.5 * system.fact(parts_of).degrees)
    states, volume, log_slope = values[:, :3].T.copy()
    power, power_error = (np.vecdot(powers, x[:, 3:]) for x in (values, errors))
    return ShellAverages(states, volume, log_slope, errors[:, 0].copy(), power, power_error)


def shell_columns(system: System, energy: Array) -> Array:
    """Return T/T_lin, Φ/Φ_lin, H T'/T and the g_d at ``energy`` (energies,), and their errors.

    The array is (energies, 2, 3 + degrees), values before errors. Σ_d g_d H^(1 + d/2) is the power
    of the damping terms. The errors of the first two are relative and equal, the errors of g_d are
    absolute; the error of H T'/T is not estimated.
    """
    shell, parts = system.fact(EnergyShell), system.fact(parts_of)
    columns = np.zeros((energy.size, 2, 3 + parts.degrees.size))
    columns[:, 0, :3] = 1.0, 1.0, system.n - 1.0
    columns[:, 0, 3:] = parts.free
    first = shell.contact_energies[0] if shell.contact_energies else np.inf
    slack = 4.0 * EPS if system.n == 1 else 0.0  # round-off of H and of V at a stop
    above = energy > first * (1.0 - slack)
    if np.any(above) and len(system.contact_masses) == 1:
        columns[above] = _along_rays(system, energy[above])
    elif np.any(above) and by_lines(system):
        columns[above] = system.fact(PartitionLines)(energy[above], shell_columns)
    elif np.any(above):
        columns[above] = system.fact(_table_columns)(energy[above])
    columns[:, 1, 3:] += MOMENT_ROUND_OFF * parts.scale
    return columns


def _along_rays(system: System, energy: Array) -> Array:
    """Return the columns of ``shell_columns`` by integrals along rays, one or two contact masses.

    ``energy`` (energies,) is above the first contact energy.
    """
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
        # Round-off of 1 − V/H, V at a stop, which bounds the part of T beyond it by √(1 − V/H)/π.
        rises = rises / energy[:, None] + 4.0 * EPS * np.array([-1.0, 1.0])[:, None, None]
        beyond = np.diff(np.sqrt(np.maximum(rises, 0.0)), axis=0)[0].sum(axis=1) / pi
        columns[:, 1, :2] += beyond[:, None] * flat / states
    if parts.degrees.size:
        shifted, most = np.split(sums[:, 3:], 2, axis=1)
        columns[:, 0, 3:] = (shifted - 2.0 * most) / states
        # Errors of ``shifted`` <= 3 most, of 2 most, and of T, as |g_d| T <= most: 6 most in all.
        largest = errors[:, [0, *range(3, errors.shape[1])]].max(axis=1, keepdims=True)
        columns[:, 1, 3:] = 6.0 * largest * most / states
    return columns


def _integrals(system: System, energy: Array) -> tuple[Array, Array]:
    """Return integrals over the shells at ``energy``, and their relative errors.

    Both are (energies, 3 + 2 degrees): T, phase volume, H T', then for each degree T g_d + 2 b,
    where b bounds |T g_d|, so that the sum is positive, then the b. All are sums over directions of
    integrals along rays. The error of H T' is relative to the larger of H T' and T. Rules are
    refined until errors are below ``TARGET``, of the power with one contact mass below
    ``POWER_TARGETS``, or ``RAY_RULES`` end; an error that is NaN is returned as ∞.
    """
    shell, parts = system.fact(EnergyShell), system.fact(parts_of)
    n, c = system.n, len(system.contact_masses)
    add_rays = ray_integrals(shell.laws, 2 * n - c - 2 <= 0)
    cuts = _angles_of_cuts(shell, energy) if c == 2 else np.empty((energy.size, 0))
    mirror = system.fact(looks_the_same_mirrored)

    def sums(i: Integers, rules: range) -> Array:
        """Return the integrals at the energies of index ``i``, (rules, energies, integrals).

        ``rules`` are indices of ``RAY_RULES``.
        """
        which, directions, weights = _rays(cuts[i], RAY_RULES[rules[0]], mirror=mirror)
        H = energy[i[which]]
        nearest = shell.sides if c == 1 else shell.nearest(directions)
        last = len(RAY_RULES) if c == 1 else RADIAL_RULE
        radial = gauss_rules(tuple(RAY_RULES[min(k, last)] for k in rules))
        out = np.zeros((len(rules), which.size, 3 + len(parts.along)))
        add_rays(H, c, nearest, n, parts.along, *radial, out)
        if parts.degrees.size:
            of_degree, odd = parts.of_group @ (parts.of_degree > 0.0), parts.powers % 2
            widest = np.linalg.norm(shell.L, axis=1)
            radial_parts = out[..., 3 + parts.column] * parts.rest
            q = (directions @ shell.L.T)[:, None, :]
            # |q| <= ½ (f + q²/f), f the largest |q|: unlike |q| this bound has no kink.
            bound = 0.5 * (widest + q * q / widest)
            power = parts.coefficient * np.prod(q**parts.powers, axis=2)
            most = parts.size * np.prod(q ** (parts.powers - odd) * bound**odd, axis=2)
            power, most = ((radial_parts * x) @ of_degree for x in (power, most))
            # Positive sums, so that a relative error is meaningful.
            out = np.concatenate([out[..., :3], power + 2.0 * most, most], axis=-1)
        out *= weights[:, None]
        return np.add.reduceat(out, np.searchsorted(which, np.arange(i.size)), axis=1)

    def error_of(coarse: Array, fine: Array) -> Array:
        size = np.abs(fine)
        size[:, 2] = np.maximum(size[:, 2], fine[:, 0])
        return np.abs(coarse - fine) / size + (ROUNDINGS * EPS if n > 1 else ROOT_ROUND_OFF)

    # With one contact mass the rays are the same for both rules; with two each rule has its own.
    first = [range(2)] if c == 1 else [range(1), range(1, 2)]
    coarse, fine = np.concatenate([sums(np.arange(energy.size), rules) for rules in first])
    error = error_of(coarse, fine)
    targets = np.full(fine.shape[1], POWER_TARGETS[min(n, 2) - 1] if c == 1 else TARGET)
    targets[:3] = TARGET
    for rule in range(2, len(RAY_RULES)):
        i = np.flatnonzero(~np.all(error <= targets, axis=1))  # includes NaN
        if not i.size:
            break
        (finer,) = sums(i, range(rule, rule + 1))
        error[i], fine[i] = error_of(fine[i], finer), finer
    return fine, np.where(np.isnan(error), np.inf, error)


def _angles_of_cuts(shell: EnergyShell, energy: Array) -> Array:
    """Return the angles (energies, cuts) of y, c = 2, at which a stop begins or ceases to be met.

    They are radians, at the shells of ``energy`` (energies,); 0 for a stop that no ray meets. The
    first are the same for all energies: 0, π/2 and the angles of ``EnergyShell.corners``.
    """
    fixed = [0.0, 0.5 * pi, *np.arctan2(shell.corners[:, 1], shell.corners[:, 0])]
    touch, rows = shell.first_touch, shell.stops.reach
    angles = np.zeros((2, len(touch), energy.size))
    stop, level = np.nonzero(shell.potential(touch)[:, None] < energy)
    if stop.size:
        # On the line on which a stop is just touched V is convex: V = H once on either side of the
        # lowest point, not farther out than without the contact energy.
        (x0, y0), H = touch[stop].T, energy[level]
        dx, dy = np.array([-rows[stop, 1], rows[stop, 0]]) / np.linalg.norm(rows[stop], axis=1)
        end = np.array([[1.0], [-1.0]]) * (1.000000001 * np.sqrt(2.0 * H) + np.hypot(x0, y0))

        def excess(t: Array, x0: Array, y0: Array, dx: Array, dy: Array, H: Array) -> Array:
            return shell.potential(np.stack([x0 + t * dx, y0 + t * dy], axis=-1)) - H

        from scipy.optimize import elementwise  # noqa: PLC0415  (it takes 0.2 s)

        find_root: Any = elementwise.find_root  # typed without further arguments
        t = find_root(excess, (0.0 * end, end), args=(x0, y0, dx, dy, H)).x
        angles[:, stop, level] = np.arctan2(y0 + t * dy, x0 + t * dx)
    return np.hstack([np.tile(fixed, (energy.size, 1)), angles.reshape(-1, energy.size).T])


def _rays(cuts: Array, nodes: int, *, mirror: bool) -> tuple[Integers, Array, Array]:
    """Return the index of each ray's energy (rays,), directions (rays, c) and weights (rays,).

    ``cuts`` (energies, cuts) are angles; with none of them there is one contact mass and a ray to
    either side. With two contact masses there are ``nodes`` Gauss points between neighbouring cuts,
    in a variable whose sin² is the share of the panel: the half-integer powers of a Hertz contact
    become smooth. If ``mirror``, V is even and half of the directions suffice.
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
    keep = weight != 0.0  # True for NaN, which then makes the sum NaN
    directions = np.stack([np.cos(angle[keep]), np.sin(angle[keep])], axis=1)
    return np.nonzero(keep)[0], directions, weight[keep] * (2.0 * pi / period)


def _table_columns(system: System) -> Callable[[Array], Array]:
    """Return the columns for two contact masses as a function of the energies (energies,).

    They are smooth between contact energies. One energy takes milliseconds, and a solver needs
    thousands: a panel is fitted when as many energies are in it as the fit evaluates.
    """
    parts, breaks = system.fact(parts_of), system.fact(EnergyShell).contact_energies
    unit = np.append(np.ones(3), np.where(parts.scale > 0.0, parts.scale, 1.0))
    ends = np.array([*breaks, 2.0 * breaks[-1] if breaks[-1] > 0 else 1.0])
    # T changes over H itself, which may be much less than the gap to the next contact energy.
    gaps = np.minimum(np.diff(ends), np.where(ends[:-1] > 0.0, ends[:-1] / GRADING, np.inf))
    towards = ends[:-1, None] + gaps[:, None] * GRADING ** np.arange(1.0, LAYERS + 1.0)
    rising = np.minimum(ends[ends > 0.0][0] * GRADING ** -np.arange(60.0), ends[-1])
    # Above the highest contact energy each panel is twice as long as the one below it.
    above = ends[-1] * 2.0 ** np.arange(60.0)
    edges = np.unique(np.concatenate([breaks, towards.ravel(), rising, above]))
    panels: dict[int, Piecewise] = {}

    def fitted(ends: Array) -> Piecewise:
        """Return the fit between two ``ends``; its errors are a constant bound on each panel."""
        values = fit(
            lambda energy: np.asarray(_along_rays(system, energy) / unit),
            ends,
            FIT_TARGET,
            degree=ENERGY_RULES[0] - 1,
            cut=lambda left, right: left + GRADING * (right - left),
            estimate=lambda _, c: np.abs(c[:, -2:, 0]).max(axis=(1, 2)),
            rounds=8,  # down to 2e-6 of a panel: smaller panels fit errors of the quadrature
        )
        assert values.error is not None
        # Largest error of the integrals that the fit interpolates, at its Gauss points.
        largest = values(panel_rule(values.nodes, ENERGY_RULES[0])[0])[:, :, 1].max(axis=1)
        values.coefficients[:, :, 1] = 0.0
        values.coefficients[:, 0, 1] = 2.0 * values.error[:, None] + largest
        return values

    def columns(energy: Array) -> Array:
        index = np.searchsorted(edges, energy, side="right") - 1
        used, count = np.unique(index, return_counts=True)
        for k in used[count >= ENERGY_RULES[0]].tolist():
            if k not in panels:
                panels[k] = fitted(edges[k : k + 2])
        result = np.empty((energy.size, 2, unit.size))
        for k in panels.keys() & set(used.tolist()):
            result[index == k] = panels[k](energy[index == k])
        others = ~np.isin(index, list(panels))
        if np.any(others):
            result[others] = _along_rays(system, energy[others]) / unit
        return np.asarray(result * unit)

    return columns
