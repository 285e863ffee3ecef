"""Displacements and momenta in time from two modal energies by finite elements, Eqs. (35), (36)."""

import numpy as np

from averaging.modal.analysis import ModalAnalysis
from averaging.modal.characteristic import state_density
from fpk.arrays import SMALLEST, Array
from fpk.certificate import Measured, outside
from fpk.density import Density, certified_density
from fpk.evolution import Transient
from fpk.observable import Coordinate, Observable
from fpk.plane.time.levels import Frame
from fpk.plane.time.start import Start
from fpk.plane.time.transient import ROUNDING, UNRESOLVED, Level, transient_densities
from fpk.plane.time.view import View

SHARE = 0.5
"""Share of the tolerance to which the energies are resolved."""


def state_transient(
    modes: ModalAnalysis,
    frame: Frame,
    start: Start,
    observable: Observable,
    times: Array,
    at: tuple[Array, ...],
    *,
    tol: float,
) -> Transient:
    """Return the densities of one or two of (q, p) of two modes at points ``at`` (points,) each.

    The phases are independent and uniform, whatever the energies. The certificate is that of the
    worst time; a time too short for the operator is not certified, its errors infinite.
    """
    none = np.zeros(0), np.zeros(0)
    answer, levels = transient_densities(frame, start, View("pair"), times, none, tol=SHARE * tol)
    tail = outside(answer.certificate)
    values, errors = np.empty((2, times.size, at[0].size))
    densities = []
    for k, t in enumerate(times.tolist()):
        group = _energies(modes, levels, k, t, l1_error=start.l1_error, tail=tail, tol=tol)
        densities.append(state_density(modes, [group], observable, tol=tol))
        values[k], errors[k] = densities[k].at(*at)
        errors[k] = errors[k] if group.l1_error <= UNRESOLVED else np.inf
    worst = max(densities, key=lambda d: (not d.certificate.certified, d.l1_error))
    return Transient(
        times, values, errors + SMALLEST, "numerical", worst.certificate, answer.settings
    )


def _energies(
    modes: ModalAnalysis,
    levels: tuple[Level, Level],
    k: int,
    t: float,
    *,
    l1_error: float,
    tail: float,
    tol: float,
) -> Density:
    """The joint density of both energies at the time ``t``, its error the distance of two levels.

    ``l1_error`` is that of the start, ``tail`` bounds the mass beyond the mesh.
    """
    coarse, fine = levels
    theta = modes.temperature * -np.expm1(-2.0 * modes.half_bandwidth * t)

    def of(level: Level, g: Array, H1: Array, H2: Array) -> Array:
        """The density with the coefficients ``g``, (energies, energies): H1 a column, H2 a row."""
        grid = View("pair").on_grid(level.op, g[k : k + 1], (H1.ravel(), H2.ravel()))
        return np.asarray(grid[0])

    def pdf(H1: Array, H2: Array) -> Array:
        return of(fine, fine.g, H1, H2)

    mass = float(fine.evolved.values[k] @ fine.op.matrices.shares)
    rounding = float(np.max(ROUNDING * fine.evolved.rounding)) + 2.0 * abs(mass - 1.0)

    def pointwise(H1: Array, H2: Array) -> Array:
        p = pdf(H1, H2)
        moved = np.abs(p - of(coarse, coarse.g, H1, H2)) + np.abs(of(fine, fine.change, H1, H2))
        of_modes = 2.0 * modes.relative_error * (1.0 + H1 / theta[0] + H2 / theta[1])
        return np.asarray(moved + (of_modes + rounding) * np.abs(p))

    return certified_density(
        (Coordinate("H", 0), Coordinate("H", 1)),
        fine.op.nodes,
        pdf,
        pointwise,
        measured=Measured(l1_error + 2.0 * tail, None, None, fine.evolved.residual, tail),
        tol=tol,
        added_error=lambda p, *H: pointwise(*H),
    )
