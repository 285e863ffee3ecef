"""Certified densities of one energy in time under modulated noise."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from fpk.arrays import Array
from fpk.certificate import Measured, certify
from fpk.density import SMALLEST
from fpk.evolution import Transient
from fpk.line.modes import Modes, log_density, modes, refined
from fpk.line.propagation import Source, points
from fpk.line.stepping import STAGES, Matrices, matrices, start_of, stepped
from fpk.line.time_mesh import HIGHEST, time_nodes
from fpk.line.transition import (
    ENRICHMENT,
    LAYER,
    SAFETY,
    TAIL,
    common_error,
    extent,
    log_share_above,
    width_of,
)
from fpk.modulation import Modulation
from fpk.probe import probed
from fpk.process import Process

LEVELS = (1, 4)
"""Halvings of all steps: those with which the mesh is adapted, and the most."""
MOST_ROUNDS = 6
"""Rounds of cutting elements in two."""
LEAST_TOL = 1e-9
"""Tolerances below it would take minutes of steps for a digit; the default where none is given."""


@dataclass(frozen=True, eq=False)
class Carried:
    """The density at some times on one mesh, as ``stepped`` leaves it: g (times, functions)."""

    process: Process
    elements: Modes
    matrices: Matrices
    g: Array
    residual: float

    def density(self, x: Array) -> Array:
        """Return p (times, points) at energies x > 0 in the elements."""
        e, m = self.elements, self.matrices
        k, h, v = e.shapes(x)
        f = np.concatenate([np.where(k > 0, 1.0 - h, 0.0)[:, None], h[:, None], v], axis=1)
        # The factor of each function may leave the range where its product with π does not.
        log_p = log_density(self.process, e, x)[:, None] + np.append(m.scale, -np.inf)[m.place[k]]
        terms = f * np.exp(log_p)
        return np.array([(terms * np.append(g, 0.0)[m.place[k]]).sum(axis=1) for g in self.g])


def modulated_transient(
    under: Callable[[float], Process],
    modulation: Modulation,
    source: Source,
    times: Array,
    at: Array,
    *,
    tol: float,
) -> Transient:
    """Return the densities at ``times`` > 0 after ``source``; ``under(F)`` has F times the noise.

    By steps of Radau IIA of the order 9 on elements that adapt; the error is the distance to
    elements of a higher degree and to steps twice as long, and settings have the order that the
    last three levels of steps show. Works to ``tol`` or ``LEAST_TOL``, whichever is larger.
    """
    tol = max(tol, LEAST_TOL)
    unit = float(modulation.factor.max()) ** 2
    process, degree = under(unit), int(np.clip(round(-math.log10(tol)) + 4, 8, HIGHEST))
    share = log_share_above(probed(process), source.energy)
    ends = [extent(process, source, tail * tol, share) for tail in TAIL]
    ends[1] = max(ends[1], 1.1 * ends[0])
    first = modulation.energy(float(times[0])) / unit
    width = process.energy_scale
    fine: tuple[tuple[float, float], ...] = ()
    if source.process is None:
        width = width_of(process, source.energy, first)
        fine = ((source.energy, LAYER * width),)
    nodes = time_nodes(process, ends[0], degree, fine=fine)
    longer = np.append(nodes, ends[1])
    answer = modes(process, nodes[:-1], nodes[1:], degree)
    finer = modes(process, longer[:-1], longer[1:], degree + ENRICHMENT, enriched=True)

    def carried(e: Modes, level: int) -> Carried:
        m = matrices(process, e)
        return Carried(
            process, e, m, *stepped(m, start_of(m, e, source), modulation, unit, times, level=level)
        )

    for _ in range(MOST_ROUNDS):
        x, w = points(process, answer)
        shape = (times.size, *x.shape)
        p = carried(answer, LEVELS[0]).density(x.ravel())
        better = carried(finer, LEVELS[0]).density(x.ravel())
        space = np.abs(p - better).reshape(shape)
        own = (space * w).sum(axis=2).max(axis=0)
        marked = own > 0.1 * tol / own.size
        if SAFETY * own.sum() <= 0.25 * tol or not marked.any():
            break
        answer = refined(process, answer, marked)
        finer = refined(process, finer, np.append(marked, False), enriched=True)
    distances: list[float] = []
    for level in range(LEVELS[0] + 1, LEVELS[1] + 1):
        coarse, solved = p, carried(answer, level)
        p = solved.density(x.ravel())
        moved = np.abs(p - coarse).reshape(shape)
        distances.append(float((moved * w).sum(axis=(1, 2)).max()))
        if SAFETY * distances[-1] <= 0.25 * tol:
            break
    start = source.energy, width
    distance = (space + moved).max(axis=2)
    common = common_error(answer, start, p, np.zeros_like(p), x.ravel())
    pointwise = SAFETY * (space + moved).reshape(p.shape) + common
    at_end = np.abs(solved.density(answer.right[-1:])[:, 0])
    tail = probed(process).tail_bound(float(answer.right[-1]), float(at_end.max()))
    measured = Measured(
        l1_error=float((SAFETY * (space + moved) * w).sum(axis=(1, 2)).max())
        + float((common @ w.ravel()).max()) + 2.0 * tail,
        mass_defect=float(np.abs(p @ w.ravel() - 1.0).max()),
        minimum=float((p.min(axis=1) / p.max(axis=1)).min()),
        residual=solved.residual,
        tail_mass=float(tail),
        absolute_error=float((pointwise.max(axis=1) / p.max(axis=1)).max()),
    )  # fmt: skip
    inside = np.clip(at, SMALLEST, answer.right[-1])
    values = solved.density(inside)
    errors = SAFETY * distance[:, answer.element_of(inside)] + common_error(
        answer, start, values, np.zeros_like(values), inside
    )
    errors = np.where(at > answer.right[-1], errors + np.abs(values), errors) + SMALLEST
    settings: dict[str, str | float | int] = {
        "equation": f"modulated noise, Radau IIA of order {2 * STAGES - 1}",
        "elements": answer.count,
        "halvings of the steps": level,
        "tol": tol,
    }
    if len(distances) > 1 and distances[-1] > 0.0:
        settings["observed order"] = math.log2(distances[-2] / distances[-1])
    return Transient(
        times,
        np.where((at >= 0.0) & (at <= answer.right[-1]), values, 0.0),
        np.where(at >= 0.0, errors, 0.0),
        "numerical",
        certify(measured, tol=tol),
        settings,
    )
