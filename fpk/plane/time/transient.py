"""Densities of two energies at times after a start, with their errors."""

from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np

from fpk.arrays import Array
from fpk.certificate import Measured, certify
from fpk.density import SMALLEST
from fpk.evolution import Transient
from fpk.plane.solution import Nodes, graded
from fpk.plane.time.exponential import Evolved, evolved
from fpk.plane.time.levels import Frame, operators
from fpk.plane.time.operator import PlaneOperator
from fpk.plane.time.start import PointStart, Start
from fpk.plane.time.view import View

HEIGHT = 12.0
"""Largest rise of −ln w up to a start: errors of p grow by the root of its exponential, here 400.
A start higher up gets a flatter weight."""
SHARE = 0.05
"""Share of the largest difference of two levels, anywhere, that is in the error at every point:
their difference crosses zero."""
ROUNDING = 8.0
"""Multiple of the estimated relative round-off that is stated: up to 3 times it was measured."""
UNRESOLVED = 0.1
"""L1 distance of two levels above which neither resolves the density: the error is unknown."""
GIVEN_UP = (13, 0.5)
"""Degree from which on an L1 distance larger than that ends the search: the last level resolves
times a quarter as long, and no shorter ones."""
KRYLOV = 1e-2
"""Fraction of the tolerance to which e^(tA) is computed."""


class Level(NamedTuple):
    """The coefficients at all times, in all functions, of one operator."""

    op: PlaneOperator
    evolved: Evolved
    g: Array
    change: Array


def transient_densities(
    frame: Frame,
    start: Start,
    view: View,
    times: Array,
    at: tuple[Array, ...],
    *,
    tol: float,
    coefficients_error: Callable[..., Array] | None = None,
) -> Transient:
    """Return the densities seen at ``times`` > 0, ascending, at points ``at`` (points,) each.

    Levels rise until two of them agree to ``tol`` in L1 and in units of the largest density; the
    answer is that of the finer one. A time too short for the last level is not certified.
    ``coefficients_error(t, *at)`` is the relative error of p by that of the coefficients.
    """
    return resolved(frame, start, view, times, at, tol=tol, coefficients_error=coefficients_error)[
        0
    ]


def resolved(
    frame: Frame,
    start: Start,
    view: View,
    times: Array,
    at: tuple[Array, ...],
    *,
    tol: float,
    coefficients_error: Callable[..., Array] | None = None,
) -> tuple[Transient, tuple[Level, Level]]:
    """Return the answer of ``transient_densities``, and its last two levels, the finer last."""
    previous: Level | None = None
    for level in _levels(frame, start, times, tol):
        if previous is not None:
            answer, unresolved = _compared(
                previous, level, start, view, times, at, tol, coefficients_error
            )
            both = previous, level
            hopeless = level.op.degree >= GIVEN_UP[0] and answer.certificate.failures
            if answer.certificate.certified or (hopeless and unresolved > GIVEN_UP[1]):
                break
        previous = level
    return answer, both


def _levels(frame: Frame, start: Start, times: Array, tol: float) -> Iterator[Level]:
    height, share = 0.0, 1.0
    least = np.zeros(2)
    if isinstance(start, PointStart):
        height = frame.height(*start.energies)
        share = min(1.0, HEIGHT / max(height, HEIGHT))
    else:
        share = min(1.0, 1.0 / start.factor)
        least = np.array([x[-1] for x in start.density.nodes])

    longest = frame.rise(tol, height, 0)

    def nodes(rise: float, panels: int) -> Nodes:
        longer = 1.0 + 0.03 * (rise - longest)
        return graded(np.maximum(frame.ends(rise), least * longer), panels)

    for op in operators(frame, nodes, tol=tol, height=height, share=share):
        A, M, _ = op.matrices
        parts = evolved(A, M, start.dual(op), times, tol=KRYLOV * tol)
        yield Level(op, parts, op.spread(parts.values), op.spread(parts.change))


def _compared(
    coarse: Level,
    fine: Level,
    start: Start,
    view: View,
    times: Array,
    at: tuple[Array, ...],
    tol: float,
    coefficients_error: Callable[..., Array] | None,
) -> tuple[Transient, float]:
    """The finer answer, its error by the distance to the coarser one, the largest distance."""
    axes, area = view.grid(fine.op)
    p, other = (view.on_grid(level.op, level.g, axes) for level in (fine, coarse))
    flat = p.reshape(times.size, -1)
    lost = np.abs(p - other) + np.abs(view.on_grid(fine.op, fine.change, axes))
    largest = np.max(np.abs(flat), axis=1)
    mass = fine.evolved.values @ fine.op.matrices.shares
    rounding = ROUNDING * fine.evolved.rounding + 2.0 * np.abs(mass - 1.0)
    highest = np.max(lost.reshape(times.size, -1), axis=1) + rounding * largest
    values, coarser, change = (
        view.at(level.op, g, at)
        for level, g in ((fine, fine.g), (coarse, coarse.g), (fine, fine.change))
    )
    # What lies beyond the mesh is less than what there is at its end.
    within = tuple(np.clip(x, 0.0, y[-1]) for x, y in zip(at, _ends(view, fine.op), strict=True))
    outside = np.any([x != y for x, y in zip(at, within, strict=True)], axis=0)
    beyond = np.abs(view.at(fine.op, fine.g, within)) * outside
    errors = np.abs(values - coarser) + np.abs(change) + beyond + SHARE * highest[:, None]
    errors = np.maximum(errors, (rounding * largest)[:, None])
    model = np.zeros(times.size)
    if coefficients_error is not None:
        for k, t in enumerate(times):
            errors[k] += coefficients_error(t, *at) * np.abs(values[k])
            grid = np.meshgrid(*axes, indexing="ij", sparse=True)
            model[k] = float(np.sum(area * np.abs(p[k]) * coefficients_error(t, *grid)))
    negative = np.min(np.broadcast_arrays(*at), axis=0) < 0.0
    distance = np.sum((lost * area).reshape(times.size, -1), axis=1)
    unresolved = ~(distance <= UNRESOLVED)
    errors = np.where(unresolved[:, None], np.inf, errors)
    errors = np.where(negative, 0.0, errors) + SMALLEST
    l1 = (lost * area).reshape(times.size, -1).sum(axis=1) + model + rounding + start.l1_error
    inside = np.all(
        [
            x <= y[-1]
            for x, y in zip(np.meshgrid(*axes, indexing="ij"), _ends(view, coarse.op), strict=True)
        ],
        axis=0,
    )
    tail = np.abs(p * area * ~inside).reshape(times.size, -1).sum(axis=1)
    absolute = float(np.max(highest / largest))
    measured = Measured(
        l1_error=float(np.max([*l1, absolute])),
        mass_defect=float(np.max(np.abs(mass - 1.0))),
        minimum=float(np.min(flat.min(axis=1) / largest)),
        residual=float(np.max([fine.evolved.residual, coarse.evolved.residual])),
        tail_mass=float(np.max(tail)),
        absolute_error=absolute,
        failures=tuple(f"the time {t:.4g} is too short for the mesh" for t in times[unresolved]),
    )
    settings = {
        "unknowns": fine.g[0].size,
        "degree": fine.op.degree,
        "L1 error at the first time": float(l1[0]),
        "L1 error at the last time": float(l1[-1]),
    }
    certificate = certify(measured, tol=tol)
    answer = Transient(times, values, errors, "numerical", certificate, settings)
    return answer, float(np.max(distance))


def _ends(view: View, op: PlaneOperator) -> tuple[Array, ...]:
    """Nodes of the axes seen."""
    if view.seen == "pair":
        return op.nodes
    if view.seen == "sum":
        return (np.array([0.0, op.nodes[0][-1] + op.nodes[1][-1]]),)
    return (op.nodes[int(view.seen == "second")],)
