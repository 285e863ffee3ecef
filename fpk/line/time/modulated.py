"""Certified densities of one energy in time under modulated noise."""

import math
from collections.abc import Callable
from functools import partial

import numpy as np

from fpk.arrays import Array
from fpk.errors import InvalidInput
from fpk.evolution import Transient
from fpk.line.time.modes import Modes
from fpk.line.time.pair import Pair
from fpk.line.time.propagation import Solution, Source, points
from fpk.line.time.stepping import STAGES, Matrices, matrices, start_of, stepped
from fpk.line.time.transition import SAFETY, Solutions, adapted, judged, posed
from fpk.modulation import Modulation
from fpk.process import Process

LEVELS = (1, 4)
"""Halvings of all steps: those with which the mesh is adapted, and the most."""
LEAST_TOL = 1e-9
"""Tolerances below it would take minutes of steps for a digit; the default where none is given."""


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
    last three levels of steps show. Works to ``tol`` or ``LEAST_TOL``, whichever is larger. Raises
    ``InvalidInput`` for a time before which there is no noise, and as ``posed`` does.
    """
    unit, tol = float(modulation.factor.max()) ** 2, max(tol, LEAST_TOL)
    process, first = under(unit), modulation.energy(float(times[0])) / unit
    if first == 0.0 and source.process is None:
        raise InvalidInput("times", float(times[0]), "no noise has acted yet: there is no density")
    question, pair = posed(process, source, first, tol)

    def carried(e: Modes, level: int) -> Solution:
        m = matrices(process, e)
        start = start_of(m, e, source)
        g, residual = stepped(m, start, modulation, unit, times, level=level)
        return Solution(process, e, partial(_times_factor, e, m, g), residual)

    def carried_pair(pair: Pair) -> Solutions:
        return carried(pair[0], LEVELS[0]), carried(pair[1], LEVELS[0])

    solved, _ = adapted(question, pair, carried_pair)
    own = solved.solution
    space = solved.distance
    x, w = points(process, own.elements)
    distances: list[float] = []
    for level in range(LEVELS[0] + 1, LEVELS[1] + 1):
        coarse, own = own, carried(own.elements, level)
        p, longer = (solution.density(x.ravel())[0] for solution in (own, coarse))
        moved = np.abs(p - longer).reshape(space.shape)
        distances.append(float((moved * w).sum(axis=(1, 2)).max()))
        if SAFETY * distances[-1] <= 0.25 * tol:
            break
    solved, _, _ = judged(question, own, solved.enriched, distance=space + moved)
    values, errors = solved.density(at)
    settings: dict[str, str | float | int] = {
        "equation": f"modulated noise, Radau IIA of order {2 * STAGES - 1}",
        "elements": own.elements.count,
        "halvings of the steps": level,
        "tol": tol,
    }
    if len(distances) > 1 and distances[-1] > 0.0:
        settings["observed order"] = math.log2(distances[-2] / distances[-1])
    return Transient(times, values, errors, "numerical", solved.certificate, settings)


def _times_factor(
    e: Modes, m: Matrices, g: Array, log_factor: Array, x: Array
) -> tuple[Array, Array]:
    """p/π of g (times, functions) times a factor at energies x, and the size of its terms."""
    k, h, v = e.shapes(x)
    f = np.concatenate([np.where(k > 0, 1.0 - h, 0.0)[:, None], h[:, None], v], axis=1)
    # The factor of each function may leave the range where its product with π does not.
    log_p = log_factor[:, None] + np.append(m.scale, -np.inf)[m.place[k]]
    terms = f * np.exp(log_p)
    each = np.array([terms * np.append(row, 0.0)[m.place[k]] for row in g])
    return each.sum(axis=2), np.abs(each).sum(axis=2)
