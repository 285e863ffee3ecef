"""Integrals over the energy shell: those along rays, summed over all directions and refined."""

from collections.abc import Callable
from math import pi
from typing import Any

import numpy as np
from numpy.typing import NDArray

from averaging.shell.energy_shell import EnergyShell
from averaging.shell.rays import RULES, gauss_rules
from fpk.arrays import Array, Integers
from fpk.quadrature import gauss_legendre
from fpk.system import looks_the_same_mirrored

NO_ORDERS: Integers = np.empty((0, 2), dtype=np.int64)
TARGET = 3e-12
"""Relative disagreement of two rules that ends the refinement and is reported as the error."""
ROUND_OFF = 2e-15
"""Relative error of a sum of some dozens of positive terms."""
ROOT_ROUND_OFF = 4e-13
"""Relative error of a sum of a system of one mass, ε points²: its integrand is 1/√v, v = 1 − V/H,
where v ~ 1/points² at the Gauss point next to the turning point."""
MANY = 5
"""Masses from which the first rule along a line would be refused, as v^a is narrow."""
RADIAL_RULE = 2
"""Index of the rule of 24 points, enough along a ray for any contact stiffness, not over angles."""
MARGIN = 1e-9
"""Relative length beyond which the springs alone hold more than H, round-off or not."""

Combine = Callable[[Array, Array], Array]
"""Quantities (..., rays, quantities) from directions (rays, c) and integrals (..., rays, ·)."""


def shell_integrals(
    shell: EnergyShell,
    energy: Array,
    *,
    orders: Integers = NO_ORDERS,
    combine: Combine | None = None,
    target: float = TARGET,
) -> tuple[Array, Array]:
    """Return integrals over the shells (energies, quantities) and their errors, of that shape.

    One or two masses have contact. The quantities are the integrals along rays of
    ``ray_integrals``, with ``orders``, or what ``combine`` makes of all but the first three, summed
    over all directions. Errors are relative, that of H T', which may vanish, to T at the least. The
    rules are refined until the errors of the first three are below ``TARGET``, all others below
    ``target``.
    """

    mirror = shell.system.fact(looks_the_same_mirrored)

    def along(energy: Array, directions: Array, rule: int, rules: int = 1) -> Array:
        """The quantities of each ray by ``rules`` rules from ``rule`` on, (rules, rays, ·)."""
        out = np.zeros((rules, energy.size, 3 + len(orders)))
        points, n = gauss_rules(), shell.system.n
        shell.add_rays(energy, directions, shell.stops, n, orders, points, rule, out)
        return out if combine is None else combine(directions, out)

    def over_line(i: Integers, rule: int, rules: int) -> Array:
        right = np.ones((i.size, 1))
        total = along(energy[i], right, rule, rules)
        return 2.0 * total if mirror else total + along(energy[i], -right, rule, rules)

    def over_circle(i: Integers, rule: int, rules: int) -> Array:
        sums = []
        for k in range(rule, rule + rules):
            which, directions, weights = _circle_rule(cuts[i], RULES[k], mirror=mirror)
            parts = along(energy[i[which]], directions, min(k, RADIAL_RULE))[0]
            sums.append([np.bincount(which, weights * x, minlength=i.size) for x in parts.T])
        return np.swapaxes(sums, 1, 2)

    def size(sums: Array) -> Array:
        size = np.abs(sums)
        size[:, 2] = np.maximum(size[:, 2], sums[:, 0])
        return size

    if shell.count == 2:
        cuts = _cut_angles(shell, energy)
    sums = over_line if shell.count == 1 else over_circle
    first = 1 if shell.count == 1 and shell.system.n >= MANY else 0
    floor = ROUND_OFF if shell.system.n > 1 else ROOT_ROUND_OFF
    coarse, fine = sums(np.arange(energy.size), first, 2)
    error = np.abs(coarse - fine) / size(fine) + floor
    targets = np.array([TARGET] * 3 + [target] * (fine.shape[1] - 3))
    for rule in range(first + 2, len(RULES)):
        # A sum that is no number is refined, too; the first three together, and all others.
        met = error <= targets
        if met.all():
            return fine, error
        left = ~met
        for group in (left[:, :3], left[:, 3:]):
            group |= group.any(axis=1, keepdims=True)
        i = np.flatnonzero(left.any(axis=1))
        finer = sums(i, rule, 1)[0]
        error[i] = np.where(left[i], np.abs(fine[i] - finer) / size(finer) + floor, error[i])
        fine[i] = np.where(left[i], finer, fine[i])
    return fine, np.where(np.isnan(error), np.inf, error)


def _circle_rule(cuts: Array, nodes: int, *, mirror: bool) -> tuple[NDArray[np.intp], Array, Array]:
    """Two contact masses: Gauss panels over the angle between ``cuts`` (energies, cuts).

    Returns the index of each ray's energy (rays,), the directions (rays, 2), the weights (rays,).
    The substitution sin² towards both ends of a panel turns the half-integer powers that Hertz
    contact leaves there into smooth functions. ``mirror`` says that V is even.
    """
    period = pi if mirror else 2.0 * pi
    cuts = np.sort(cuts % period, axis=1)
    cuts = np.concatenate([cuts, cuts[:, :1] + period], axis=1)
    t, w = gauss_legendre(nodes)
    psi = 0.25 * pi * (1.0 + t)
    share, slope = np.sin(psi) ** 2, 0.25 * pi * np.sin(2.0 * psi) * w
    length = np.diff(cuts, axis=1)
    angle = cuts[:, :-1, None] + length[:, :, None] * share
    weight = np.broadcast_to(length[:, :, None] * slope, angle.shape)
    keep = weight != 0.0  # a cut that is no number makes a sum that is none
    index = np.arange(len(cuts), dtype=np.intp)[:, None, None]
    which = np.broadcast_to(index, angle.shape)[keep]
    directions = np.stack([np.cos(angle[keep]), np.sin(angle[keep])], axis=1)
    return which, directions, weight[keep] * (2.0 * pi / period)


def _cut_angles(shell: EnergyShell, energy: Array) -> Array:
    """Return angles (energies, cuts) where a stop joins or leaves the shell; 0 for no cut."""
    fixed = [0.0, 0.5 * pi, *np.arctan2(shell.corners[:, 1], shell.corners[:, 0])]
    touch, rows = shell.first_touch, shell.stops.rows
    angles = np.zeros((2, len(touch), energy.size))
    stop, level = np.nonzero(shell.potential(touch)[:, None] < energy)
    if stop.size:
        # On the line where a stop is just touched V is convex: H is met once on either side of the
        # lowest point, no farther than where the springs alone reach it.
        (x0, y0), H = touch[stop].T, energy[level]
        dx, dy = np.array([-rows[stop, 1], rows[stop, 0]]) / np.linalg.norm(rows[stop], axis=1)
        side = np.array([1.0, -1.0])[:, None]
        end = side * ((1.0 + MARGIN) * np.sqrt(2.0 * H) + np.hypot(x0, y0))

        def excess(t: Array, *line: Array) -> Array:
            x0, y0, dx, dy, H = line
            return shell.potential(np.stack([x0 + t * dx, y0 + t * dy], axis=-1)) - H

        from scipy.optimize import elementwise  # noqa: PLC0415  (it takes 0.2 s)

        find_root: Any = elementwise.find_root  # typed without further arguments
        t = find_root(excess, (0.0 * end, end), args=(x0, y0, dx, dy, H)).x
        angles[:, stop, level] = np.arctan2(y0 + t * dy, x0 + t * dx)
    crossings = angles.reshape(-1, energy.size).T
    return np.hstack([np.tile(fixed, (energy.size, 1)), crossings])
