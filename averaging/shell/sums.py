"""Sums of ray integrals over all directions, refined until two rules agree."""

from collections.abc import Callable, Sequence
from math import pi
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import cubature

from averaging.shell.directions import circle_rule, hyperspherical, line_rule
from averaging.shell.reduced import ReducedPotential

Array = NDArray[np.float64]

REFINEMENTS = (12, 16, 24, 48, 96, 192)
"""Gauss points per panel; an energy moves on to the next while two levels disagree."""
TARGET = 3e-12
"""Relative disagreement of two levels that ends the refinement and is reported as the error; as the
convergence is geometric down to round-off, the finer of the two is better than that."""
ROUND_OFF = 2e-15
"""Relative error of a sum of some dozens of positive terms."""
ROOT_ROUND_OFF = 4e-13
"""Relative error of a sum of a system of one mass, whose integrand is 1/√v, v = 1 − V/H: at the
Gauss point next to the turning point, where v ~ 1/points² cancels terms of order one, the relative
error is ε points²."""
RADIAL_POINTS = 20
"""Gauss points along a ray are enough at this number for any contact stiffness; over the angle,
where stiff contact leaves boundary layers, more are taken."""
CUBATURE_TOLERANCE = 1e-6
"""Relative tolerance over the directions of three or more contact masses, half a second an energy;
the cubature's own estimate, which the true error stays below by two orders of magnitude."""


class RayIntegrals(Protocol):
    """Integrals along rays: of some energies (rays,) and directions (rays, c), by several rules."""

    def __call__(self, energy: Array, directions: Array, *, rules: Sequence[int]) -> Array:
        """Shape (rules, rays, quantities)."""
        ...


def refined_sums(
    potential: ReducedPotential,
    energy: Array,
    rays: RayIntegrals,
    size: Callable[[Array], Array],
    *,
    target: float = TARGET,
) -> tuple[Array, Array]:
    """Return the integrals over the shell (energies, quantities) and their error (energies,).

    ``size`` takes sums (energies, quantities) and returns what their errors are relative to; the
    error is that of the worst quantity.
    """
    if potential.count > 2:
        return _over_sphere(potential, energy, rays, size)
    coarse, sums = _over_rays(potential, energy, rays, REFINEMENTS[:2])
    floor = ROUND_OFF if potential.n > 1 else ROOT_ROUND_OFF
    error = _disagreement(coarse, sums, size) + floor
    for points in REFINEMENTS[2:]:
        open_ = np.flatnonzero(error > target)
        if not open_.size:
            break
        finer = _over_rays(potential, energy[open_], rays, (points,))[0]
        error[open_] = _disagreement(sums[open_], finer, size) + floor
        sums[open_] = finer
    return sums, error


def _disagreement(coarse: Array, fine: Array, size: Callable[[Array], Array]) -> Array:
    relative: Array = np.max(np.abs(coarse - fine) / size(fine), axis=1)
    return relative


def _over_rays(
    potential: ReducedPotential, energy: Array, rays: RayIntegrals, rules: Sequence[int]
) -> Array:
    """Sums over one or two directions of contact, (rules, energies, quantities)."""
    if potential.count == 1:
        ends, weight = line_rule(potential)
        parts = (rays(energy, np.full((energy.size, 1), end), rules=rules) for end in ends)
        return weight * sum(parts, start=np.zeros(()))
    return np.stack([_over_circle(potential, energy, rays, points) for points in rules])


def _over_circle(
    potential: ReducedPotential, energy: Array, rays: RayIntegrals, points: int
) -> Array:
    which, directions, weights = circle_rule(potential, energy, points)
    found = rays(energy[which], directions, rules=(min(points, RADIAL_POINTS),))[0]
    parts = [np.bincount(which, weights * part, minlength=energy.size) for part in found.T]
    return np.stack(parts, axis=1)


def _over_sphere(
    potential: ReducedPotential,
    energy: Array,
    rays: RayIntegrals,
    size: Callable[[Array], Array],
) -> tuple[Array, Array]:
    """Three or more contact masses: adaptive cubature over the directions."""
    angles = potential.count - 1
    upper = np.full(angles, pi)
    upper[-1] = pi if potential.mirror else 2.0 * pi
    factor = 2.0 if potential.mirror else 1.0

    def integrand(points: Array) -> Array:
        directions, jacobian = hyperspherical(points)
        shape = (points.shape[0], energy.size)
        found = rays(
            np.broadcast_to(energy, shape).ravel(),
            np.repeat(directions, energy.size, axis=0),
            rules=REFINEMENTS[:1],
        )[0]
        return np.asarray(jacobian[:, None, None] * found.reshape(*shape, found.shape[-1]))

    found = cubature(
        integrand,
        np.zeros(angles),
        upper,
        rule="gk21",
        rtol=CUBATURE_TOLERANCE,
        max_subdivisions=2000,
    )
    error = np.max(np.abs(found.error) / size(found.estimate), axis=1) + ROUND_OFF
    return factor * found.estimate, error
