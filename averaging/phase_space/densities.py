"""Densities of displacements and momenta by the last solution of a ladder, with their errors."""

from collections.abc import Callable

import numpy as np
from scipy.ndimage import map_coordinates, maximum_filter

from averaging.phase_space.identities import heat_into_masses
from averaging.phase_space.marginals import marginal
from averaging.phase_space.moments import moments
from averaging.phase_space.refinement import ROUND_OFF, Ladder
from fpk.arrays import Array
from fpk.certificate import Measured
from fpk.density import Density, certified_density
from fpk.observable import Observable

GRID = {1: 721, 2: 181}
"""Points of an axis at which the distance to the coarser solution is sampled, by the axes."""
WINDOW = {1: 41, 2: 11}
"""Points over which its largest value is taken: a standard deviation, two half-waves of a Hermite
function of degree 20, as the error does not vanish where the distance does."""
FEWER = 0.8
"""Share of the points at which the contact displacement is integrated out, to see their error."""


def density_of(ladder: Ladder, observable: Observable, tol: float) -> Density:
    """Return the density of ``observable``; what ended the ladder fails beyond ``tol``.

    The error is the distance to the coarser solution about a point, as much larger as all of the
    L1 error is than all of that, and what fewer points of integration change.
    """
    frame, factor = ladder.frame, ladder.factors[observable]
    panels, pdf = marginal(frame, ladder.finest, observable)
    _, coarser = marginal(frame, ladder.coarser, observable)
    local, largest = _local_distance(panels, pdf, coarser)
    floor, tail = ROUND_OFF * largest, _tail(panels, pdf)
    measured = Measured(
        l1_error=ladder.errors[observable] + tail,
        mass_defect=np.nan,
        minimum=np.inf,
        residual=ladder.finest.residual,
        tail_mass=tail,
    )
    if ladder.limit and ladder.errors[observable] > tol:
        measured = measured.with_failures(ladder.limit)
    ends = np.array([[nodes[0], nodes[-1]] for nodes in panels])

    def pointwise(*x: Array) -> Array:
        arrays = np.broadcast_arrays(*x)
        place = [
            (a - low) / (high - low) * (GRID[len(panels)] - 1)
            for a, (low, high) in zip(arrays, ends, strict=True)
        ]
        distance = map_coordinates(local, np.array(place), order=1, mode="nearest")
        return np.asarray(factor * distance + floor)

    _, fewer = marginal(frame, ladder.finest, observable, share=FEWER)

    def integration_error(p: Array, *x: Array) -> Array:
        return np.abs(p - np.asarray(fewer(*x)))

    return certified_density(
        observable,
        panels,
        pdf,
        lambda *x: pointwise(*x) + integration_error(pdf(*x), *x),
        measured=measured,
        tol=tol,
        added_error=integration_error,
    )


def _local_distance(
    panels: tuple[Array, ...], pdf: Callable[..., Array], coarser: Callable[..., Array]
) -> tuple[Array, float]:
    """Largest distance to the coarser solution around the points of a grid, and largest density."""
    count, window = GRID[len(panels)], WINDOW[len(panels)]
    axes = [np.linspace(nodes[0], nodes[-1], count) for nodes in panels]
    mesh = np.meshgrid(*axes, indexing="ij", sparse=True)
    values = np.asarray(pdf(*mesh))
    distance = np.abs(values - np.asarray(coarser(*mesh)))
    return maximum_filter(distance, size=window, mode="nearest"), float(values.max())


def _tail(panels: tuple[Array, ...], pdf: Callable[..., Array]) -> float:
    """Mass beyond the panels: the density at their ends times the length of the last ones.

    The density falls by more than e over a panel at the end of the support.
    """
    total = 0.0
    for axis, nodes in enumerate(panels):
        others = [np.linspace(x[0], x[-1], GRID[2]) for k, x in enumerate(panels) if k != axis]
        weight = float(np.prod([x[1] - x[0] for x in others])) if others else 1.0
        for end, length in ((nodes[0], nodes[1] - nodes[0]), (nodes[-1], nodes[-1] - nodes[-2])):
            at = [np.array([end]), *others] if axis == 0 else [*others, np.array([end])]
            total += float(np.abs(pdf(*at)).sum()) * weight * float(length)
    return total


def settings_of(ladder: Ladder) -> dict[str, str | float | int]:
    """Return degrees, what ended the ladder, second moments and the power into each mass."""
    d, n = ladder.finest.degrees, ladder.frame.n
    settings: dict[str, str | float | int] = {
        "equation": "(6)",
        "highest degree": d.total,
        "degree in the other masses": d.others,
        "solutions": ladder.solutions,
    }
    if ladder.limit:
        settings["ended by"] = ladder.limit
    m = moments(ladder.frame, ladder.finest)
    order, mass = ladder.frame.order, ladder.frame.system.mass
    for place, i in enumerate(order):
        square = m.covariance[place, place] + m.mean[place] ** 2
        settings[f"E q{i + 1}²"] = float(square / mass[i])
        velocity = m.covariance[n + place, n + place] + m.mean[n + place] ** 2
        settings[f"E p{i + 1}²"] = float(velocity * mass[i])
    for i, heat in zip(order, heat_into_masses(ladder.frame, ladder.finest), strict=True):
        settings[f"net power of damping and noise on mass {i + 1}"] = heat
    return settings
