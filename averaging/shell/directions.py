"""Quadrature over the directions of whitened coordinates: on a circle and on a sphere."""

from math import pi
from typing import Any

import numpy as np
from numpy.typing import NDArray

from averaging.shell.energy_shell import EnergyShell
from fpk.quadrature import gauss_legendre

Array = NDArray[np.float64]

MARGIN = 1e-9
"""Relative length beyond which the springs alone hold more than H, round-off or not."""


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
    keep = weight != 0.0  # a cut that is no number makes a sum that is none
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
