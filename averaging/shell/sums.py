"""Integrals over the energy shell: those along rays, summed over all directions and refined."""

from collections.abc import Callable
from math import pi

import numpy as np
import scipy  # its parts are loaded at their first use: scipy.integrate takes long to import
from numpy.typing import NDArray

from averaging.shell.directions import circle_rule, cut_angles, hyperspherical
from averaging.shell.energy_shell import EnergyShell
from averaging.shell.rays import RULES, gauss_rules

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

NO_ORDERS: Integers = np.empty((0, 2), dtype=np.int64)
TARGET = 3e-12
"""Relative disagreement of two rules that ends the refinement and is reported as the error; as the
convergence is geometric down to round-off, the finer of the two is better than that."""
ROUND_OFF = 2e-15
"""Relative error of a sum of some dozens of positive terms."""
ROOT_ROUND_OFF = 4e-13
"""Relative error of a sum of a system of one mass, whose integrand is 1/√v, v = 1 − V/H: at the
Gauss point next to the turning point, where v ~ 1/points² cancels terms of order one, the relative
error is ε points²."""
MANY = 5
"""Masses from which the first rule along a line would be refused, as v^a is narrow."""
RADIAL_RULE = 2
"""Index of the rule of 24 points, enough along a ray for any contact stiffness; over angles, where
stiff contact leaves boundary layers, more are taken."""
CUBATURE_TOLERANCE = 1e-6
"""Relative tolerance over the directions of three or more contact masses; the cubature's own
estimate, which the true error stays below by two orders of magnitude."""

Combine = Callable[[Array, Array], Array]
"""Quantities (..., rays, quantities) from directions (rays, c) and integrals (..., rays, ·)."""


def shell_integrals(
    shell: EnergyShell,
    energy: Array,
    size: Callable[[Array], Array],
    *,
    orders: Integers = NO_ORDERS,
    combine: Combine | None = None,
    target: float = TARGET,
) -> tuple[Array, Array]:
    """Return integrals over the shells (energies, quantities) and their errors, of that shape.

    The quantities are the integrals along rays of ``ray_integrals``, with ``orders``, or what
    ``combine`` makes of them, summed over all directions. ``size`` takes sums and returns what
    their errors are relative to. The rules are refined until all errors are below ``target``.
    """

    def along(energy: Array, directions: Array, rule: int, rules: int = 1) -> Array:
        """The quantities of each ray by ``rules`` rules from ``rule`` on, (rules, rays, ·)."""
        out = np.zeros((rules, energy.size, 3 + len(orders)))
        points, n = gauss_rules(), shell.system.n
        shell.add_rays(energy, directions, shell.stops, n, orders, points, rule, out)
        return out if combine is None else combine(directions, out)

    def over_line(i: Integers, rule: int, rules: int) -> Array:
        right = np.ones((i.size, 1))
        total = along(energy[i], right, rule, rules)
        return 2.0 * total if shell.mirror else total + along(energy[i], -right, rule, rules)

    def over_circle(i: Integers, rule: int, rules: int) -> Array:
        sums = []
        for k in range(rule, rule + rules):
            which, directions, weights = circle_rule(cuts[i], RULES[k], mirror=shell.mirror)
            parts = along(energy[i[which]], directions, min(k, RADIAL_RULE))[0]
            sums.append([np.bincount(which, weights * x, minlength=i.size) for x in parts.T])
        return np.swapaxes(sums, 1, 2)

    if shell.count > 2:
        return _over_sphere(shell, energy, along, size)
    if shell.count == 2:
        cuts = cut_angles(shell, energy)
    sums = over_line if shell.count == 1 else over_circle
    first = 1 if shell.count == 1 and shell.system.n >= MANY else 0
    floor = ROUND_OFF if shell.system.n > 1 else ROOT_ROUND_OFF
    coarse, fine = sums(np.arange(energy.size), first, 2)
    error = np.abs(coarse - fine) / size(fine) + floor
    for rule in range(first + 2, len(RULES)):
        # A sum that is no number is refined, too.
        met = error <= target
        if met.all():
            return fine, error
        i = np.flatnonzero(~met.all(axis=1))
        finer = sums(i, rule, 1)[0]
        error[i] = np.abs(fine[i] - finer) / size(finer) + floor
        fine[i] = finer
    return fine, np.where(np.isnan(error), np.inf, error)


def _over_sphere(
    shell: EnergyShell,
    energy: Array,
    along: Callable[[Array, Array, int], Array],
    size: Callable[[Array], Array],
) -> tuple[Array, Array]:
    """Three or more contact masses: adaptive cubature over the directions."""
    angles = shell.count - 1
    factor = 2.0 if shell.mirror else 1.0
    upper = np.full(angles, pi)
    upper[-1] = 2.0 * pi / factor

    def integrand(points: Array) -> Array:
        directions, jacobian = hyperspherical(points)
        energies = np.tile(energy, points.shape[0])
        parts = along(energies, np.repeat(directions, energy.size, axis=0), 0)[0]
        return np.asarray(jacobian[:, None, None] * parts.reshape(-1, energy.size, parts.shape[-1]))

    result = scipy.integrate.cubature(
        integrand,
        np.zeros(angles),
        upper,
        rule="gk21",
        rtol=CUBATURE_TOLERANCE,
        max_subdivisions=2000,
    )
    error = np.abs(result.error) / size(result.estimate) + ROUND_OFF
    return factor * result.estimate, error
