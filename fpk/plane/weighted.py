"""Elements with a weight, for densities whose u = p/w takes more than one polynomial per axis."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from fpk.errors import NotCertified
from fpk.plane.on_mesh import solve_plane_on_mesh
from fpk.plane.solution import NEGATIVE, PlaneSolution
from fpk.plane.weight import Weight, fitted_weight
from fpk.process import Process

Array = NDArray[np.float64]

FIRST = (4, 8)
"""Elements along each axis, and their degree, at first."""
MOST = (8, 18)
"""The degree is raised first, then the elements: a digit costs less so."""
PER_DEGREE = 0.7
"""Digits that a degree gains: 0.67 to 0.85 on 4 × 4 elements, measured for circulating van der Pol
damping and mixtures of exponentials; (4/5)^(p+1) for an error of order p + 1 is 0.65 at p = 12."""
GOOD = 1e-4
"""Estimate above which a better weight is tried before more unknowns."""
BEYOND = 1e-3
"""Share of the tolerance that w falls to at the far edges, at first."""
FIRST_NATS = 25.0
"""Nats at first, at the least: the weight may be far from p, and too much of p lie beyond."""
MORE_NATS = 4.0
"""Nats by which w is followed farther for the comparison solution."""
STEP = 1.05
"""The least share by which that is: the ends of a steep weight are found to 7 % only."""
LONGER = 5.0
"""Nats by which w is followed farther where too much lies beyond."""
KNOWN = 0.1
"""Relative error of p up to which its logarithm is fitted."""
LEAST_LEVEL = 6.0
"""Nats that p has to be known for before a weight is fitted to it."""
SAMPLES = 32
"""Places along each axis at which a weight is fitted."""


def solve_with_weight(process: Process, weight: Weight, *, tol: float) -> Iterator[PlaneSolution]:
    """Yield solutions on ever more elements of ever higher degree, each with a better weight.

    The nodes are equidistant in √H, the amplitude: where one energy is large the other one's
    damping is, and p changes within a layer along the axis. Ends where the density does not fall
    off with the weight, the error no longer falls, or the elements are too many.
    """
    (count, degree), nats, least = FIRST, -float(np.log(BEYOND * tol)), np.inf
    beyond, stalled = max(nats, FIRST_NATS), 0
    while count <= MOST[0] and stalled < 2:
        try:
            ends, farther = weight.ends(beyond), weight.ends(beyond + MORE_NATS)
        except NotCertified:
            return
        grading = np.linspace(0.0, 1.0, count + 1) ** 2
        nodes = ends[0] * grading, ends[1] * grading
        longer = tuple(
            np.append(H[:-1], max(end, STEP * H[-1])) for H, end in zip(nodes, farther, strict=True)
        )
        solution = solve_plane_on_mesh(
            process, nodes, degree, tol=tol, weight=weight, longer=(longer[0], longer[1])
        )
        yield solution
        if solution.certificate.tail_mass > 0.1 * tol or not solution.l1_error < 0.5 * least:
            nats = beyond + LONGER
        beyond = nats
        fitted = weight_of(solution)
        better = fitted is not None and solution.l1_error < 0.5 * least
        if not (better and solution.l1_error > GOOD):
            count, degree = _finer(count, degree, lacking(solution, tol))
        if fitted is not None and solution.l1_error < least:
            weight = fitted
        stalled = 0 if solution.l1_error < 0.5 * least else stalled + 1
        least = min(least, solution.l1_error)


def lacking(solution: PlaneSolution, tol: float) -> float:
    """Return the digits by which the error has to fall for a certificate.

    An error ε in the norm weighted by w ≈ p is one of ε √p: it turns p negative below ε² of its
    maximum, so that the least value counts half its digits.
    """
    negative = max(solution.certificate.minimum / NEGATIVE, 1.0)
    return float(np.log10(max(solution.l1_error / tol, negative**0.5, 1.0)))


def _finer(count: int, degree: int, digits: float) -> tuple[int, int]:
    """The next elements and degree, for so many digits more where the degree can give them."""
    if degree >= MOST[1]:
        return count + 1, degree
    more = min(digits / PER_DEGREE, float(MOST[1]))
    return count, min(degree + max(int(np.ceil(more)), 1), MOST[1])


def weight_of(solution: PlaneSolution) -> Weight | None:
    """Return a weight fitted to −ln p where p is known, None where that is too little.

    An error ε of p in the norm weighted by w ≈ p is one of ε √p: relative to p it is below
    ``KNOWN`` as far as p > (ε/KNOWN)² of its maximum.
    """
    level = -2.0 * float(np.log(min(solution.l1_error, 1.0) / KNOWN))
    if not level > LEAST_LEVEL:
        return None
    ends = [nodes[-1] for nodes in solution.nodes]
    for _ in range(2):
        # First to see how far p is known, then in what is known.
        x, y = (np.linspace(0.0, end, SAMPLES) for end in ends)
        p, better = (f(x[:, None], y) for f in (solution.answer, solution.enriched))
        known = (p > 0.0) & (better > 0.0) & (np.abs(p - better) < KNOWN * better)
        known &= better > np.exp(-level) * better.max()
        if not known.any():
            return None
        ends = [
            float(H[min(int(np.flatnonzero(known.any(axis=1 - axis))[-1]) + 1, SAMPLES - 1)])
            for axis, H in enumerate((x, y))
        ]
    log_p = np.log(np.where(known, better, 1.0))
    return fitted_weight((x, y), log_p, known, level)
