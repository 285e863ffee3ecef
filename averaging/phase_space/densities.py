"""Densities of displacements and momenta by the last solution of a ladder, with their errors."""

import numpy as np
from scipy.ndimage import map_coordinates, maximum_filter

from averaging.phase_space.identities import heat_into_masses
from averaging.phase_space.marginals import marginal, moments
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
    factor, error = ladder.factors[observable], ladder.errors[observable]
    panels, pdf = marginal(ladder.finest, observable)
    _, coarser = marginal(ladder.coarser, observable)
    _, fewer = marginal(ladder.finest, observable, share=FEWER)
    count, window = GRID[len(panels)], WINDOW[len(panels)]
    axes = [np.linspace(nodes[0], nodes[-1], count) for nodes in panels]
    mesh = np.meshgrid(*axes, indexing="ij", sparse=True)
    values = np.asarray(pdf(*mesh))
    distance = np.abs(values - np.asarray(coarser(*mesh)))
    local, floor = maximum_filter(distance, window, mode="nearest"), ROUND_OFF * values.max()
    # Mass beyond the panels: the density at their ends times the length of the last ones, over
    # which it falls by more than e at the end of the support.
    tail = 0.0
    for axis, nodes in enumerate(panels):
        step = float(np.prod([x[1] - x[0] for k, x in enumerate(axes) if k != axis]))
        for end, length in ((nodes[0], nodes[1] - nodes[0]), (nodes[-1], nodes[-1] - nodes[-2])):
            at = [*axes[:axis], np.array([end]), *axes[axis + 1 :]]
            tail += float(np.abs(pdf(*at)).sum()) * step * float(length)
    measured = Measured(
        l1_error=error + tail,
        mass_defect=np.nan,
        minimum=np.inf,
        residual=ladder.finest.residual,
        tail_mass=tail,
        failures=(ladder.limit,) if ladder.limit and error > tol else (),
    )

    def integration_error(p: Array, *x: Array) -> Array:
        return np.abs(p - np.asarray(fewer(*x)))

    def pointwise(*x: Array) -> Array:
        place = [
            (a - nodes[0]) / (nodes[-1] - nodes[0]) * (count - 1)
            for a, nodes in zip(np.broadcast_arrays(*x), panels, strict=True)
        ]
        about = map_coordinates(local, np.array(place), order=1, mode="nearest")
        return np.asarray(factor * about + floor + integration_error(pdf(*x), *x))

    return certified_density(
        observable,
        panels,
        pdf,
        pointwise,
        measured=measured,
        tol=tol,
        added_error=integration_error,
    )


def settings_of(ladder: Ladder) -> dict[str, str | float | int]:
    """Return degrees, what ended the ladder, second moments and the power into each mass."""
    e = ladder.finest
    frame, d, m = e.basis.frame, e.basis.degrees, moments(e)
    settings: dict[str, str | float | int] = {
        "equation": "(6)",
        "highest degree": d.total,
        "degree in the other masses": d.others,
        "solutions": ladder.solutions,
    }
    if ladder.limit:
        settings["ended by"] = ladder.limit
    squares = np.diag(m.covariance) + m.mean**2
    for place, i in enumerate(frame.order):
        mass = frame.system.mass[i]
        settings[f"E q{i + 1}²"] = float(squares[place] / mass)
        settings[f"E p{i + 1}²"] = float(squares[frame.n + place] * mass)
    for i, heat in zip(frame.order, heat_into_masses(e, m), strict=True):
        settings[f"net power of damping and noise on mass {i + 1}"] = heat
    return settings
