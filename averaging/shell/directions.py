"""Quadrature over the directions of whitened coordinates: on a circle and on a sphere."""

from math import pi
from typing import Any

import numpy as np
from numpy.typing import NDArray

from averaging.shell.energy_shell import EnergyShell
from fpk.quadrature import gauss_legendre

Array = NDArray[np.float64]


def circle_rule(cuts: Array, nodes: int, *, mirror: bool) -> tuple[NDArray[np.intp], Array, Array]:
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
    keep = weight > 0
    index = np.arange(len(cuts), dtype=np.intp)[:, None, None]
    which = np.broadcast_to(index, angle.shape)[keep]
    directions = np.stack([np.cos(angle[keep]), np.sin(angle[keep])], axis=1)
    return which, directions, weight[keep] * (2.0 * pi / period)


def hyperspherical(angles: Array) -> tuple[Array, Array]:
    """Unit vectors (points, k+1) of ``angles`` (points, k) and the measure on the sphere."""
    sine, cosine = np.sin(angles), np.cos(angles)
    products = np.cumprod(np.hstack([np.ones((angles.shape[0], 1)), sine]), axis=1)
    directions = products * np.hstack([cosine, np.ones((angles.shape[0], 1))])
    powers = np.arange(angles.shape[1] - 1, -1, -1)
    return directions, np.prod(sine**powers, axis=1)


def cut_angles(shell: EnergyShell, energy: Array) -> Array:
    """Return angles (energies, cuts) where a stop joins or leaves the shell; 0 for no cut."""
    fixed = [0.0, 0.5 * pi, *np.arctan2(shell.corners[:, 1], shell.corners[:, 0])]
    crossings = [
        angle
        for row, clearance in zip(shell.stops.rows, shell.stops.clearance, strict=True)
        for angle in _line_crossings(shell, row, clearance, energy)
    ]
    return np.stack([np.full(energy.size, angle) for angle in fixed] + crossings, axis=1)


def _line_crossings(shell: EnergyShell, row: Array, clearance: float, energy: Array) -> list[Array]:
    """Angles of the two points with V = H on the line where a stop is just touched."""
    size = np.linalg.norm(row)
    foot = clearance * row / size**2
    along = np.array([-row[1], row[0]]) / size
    # V is convex along the line; the springs alone reach H at |t| <= bound.
    bound = np.sqrt(2.0 * energy)

    def points(t: Array) -> Array:
        return np.asarray(foot + t[:, None] * along)

    from scipy.optimize import elementwise  # noqa: PLC0415  (it takes 0.2 s)

    find_root: Any = elementwise.find_root  # typed without further arguments
    lowest = find_root(lambda t: shell.slope(points(t), along), (-bound, bound)).x
    inside = shell.potential(points(lowest)) < energy
    angles = []
    for end in (bound, -bound):
        angle = np.zeros(energy.size)
        if inside.any():
            t = find_root(
                lambda t, energy: shell.potential(points(t)) - energy,
                (lowest[inside], end[inside]),
                args=(energy[inside],),
            ).x
            point = points(t)
            angle[inside] = np.arctan2(point[:, 1], point[:, 0])
        angles.append(angle)
    return angles
