"""The spectral solver of p(H1, H2): p = w u, u a polynomial of high degree on each of few panels.

In the norm that the weak form weights by w ≈ p an error ε of u is one of ε √p of p, so that p stays
positive far below the tolerance: what plain elements need many unknowns for.
"""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from fpk.certificate import NEGATIVE
from fpk.errors import NotCertified
from fpk.plane.on_mesh import solve_plane_on_mesh
from fpk.plane.solution import PlaneSolution, graded
from fpk.plane.weight import Weight, fitted_weight
from fpk.process import Process

Array = NDArray[np.float64]

FIRST = (4, 8)
"""Panels along each axis and degree of the first attempt."""
LIMITS = (8, 18)
"""Most panels along each axis, and highest degree. The degree is raised first: a digit costs less
so."""
DIGITS_PER_DEGREE = 0.7
"""Digits that a degree gains: 0.67 to 0.85 on 4 × 4 panels, measured for circulating van der Pol
damping and mixtures of exponentials; (4/5)^(p+1) for an error of order p + 1 is 0.65 at p = 12."""
COARSE = 1e-4
"""Error above which a better weight gains more than unknowns do: it is tried first, and the degree
is raised by no more than ``COARSE_STEP``."""
COARSE_STEP = 4
BEYOND = 1e-3
"""Fraction of the tolerance that w falls to at the far edges."""
LEAST_RISE = 25.0
"""Least rise of −ln w up to the far edges of the first attempt, whose weight may be far from p."""
LONGER = 4.0
"""Rise of −ln w from the far edges of the answer to those of the enriched solution."""
LENGTHENING = 5.0
"""Further rise of −ln w up to the far edges where too much mass lies beyond."""
MIN_EXTENSION = 1.05
"""Least relative lengthening of the mesh for the enriched solution: ``Weight.ends`` is good to 7 %
only."""
KNOWN = 0.1
"""Relative error of p up to which ln p is fitted."""
LEAST_KNOWN = 6.0
"""Rise of −ln p over which p must be known before a weight is fitted to it."""
SAMPLES = 32
"""Points along each axis at which a weight is fitted."""


def solve_with_weight(process: Process, weight: Weight, *, tol: float) -> Iterator[PlaneSolution]:
    """Yield solutions on more and more unknowns, each with a better weight.

    Ends where the weight does not fall off, the error no longer falls, or the panels are too many.
    """
    (panels, degree), rise, least = FIRST, -float(np.log(BEYOND * tol)), np.inf
    beyond, stalled = max(rise, LEAST_RISE), 0
    while panels <= LIMITS[0] and stalled < 2:
        try:
            ends, farther = weight.ends(beyond), weight.ends(beyond + LONGER)
        except NotCertified:
            return
        nodes = graded(ends, panels)
        first, second = (
            np.append(H[:-1], max(end, MIN_EXTENSION * H[-1]))
            for H, end in zip(nodes, farther, strict=True)
        )
        solution = solve_plane_on_mesh(
            process, nodes, degree, tol=tol, weight=weight, longer=(first, second)
        )
        yield solution
        halved = solution.l1_error < 0.5 * least
        if solution.measured.tail_mass > 0.1 * tol or not halved:
            rise = beyond + LENGTHENING
        beyond = rise
        better = weight_of(solution)
        if not (halved and better is not None and solution.l1_error > COARSE):
            panels, degree = _finer(panels, degree, solution, tol)
        if better is not None and solution.l1_error < least:
            weight = better
        stalled = 0 if halved else stalled + 1
        least = min(least, solution.l1_error)


def _missing_digits(solution: PlaneSolution, tol: float) -> float:
    """Digits by which the error must fall for a certificate.

    An error ε in the norm weighted by w ≈ p is one of ε √p of p: p turns negative below ε² of its
    maximum, so that a negative minimum counts half its digits.
    """
    negative = max(solution.measured.minimum / NEGATIVE, 1.0)
    return float(np.log10(max(solution.l1_error / tol, negative**0.5, 1.0)))


def _finer(panels: int, degree: int, solution: PlaneSolution, tol: float) -> tuple[int, int]:
    """The next panels and degree: as many degrees more as the missing digits take."""
    if degree >= LIMITS[1]:
        return panels + 1, degree
    step = max(int(np.ceil(_missing_digits(solution, tol) / DIGITS_PER_DEGREE)), 1)
    if solution.l1_error > COARSE:
        step = min(step, COARSE_STEP)
    return panels, min(degree + step, LIMITS[1])


def weight_of(solution: PlaneSolution) -> Weight | None:
    """Return a weight fitted to −ln p where p is known, None where that is too little.

    An error ε of p in the norm weighted by w ≈ p is one of ε √p: relative to p it is below
    ``KNOWN`` as far as p > (ε/KNOWN)² of its maximum.
    """
    rise = -2.0 * float(np.log(min(solution.l1_error, 1.0) / KNOWN))
    if not rise > LEAST_KNOWN:
        return None
    ends = [nodes[-1] for nodes in solution.nodes]
    # First on the whole mesh, to see how far p is known; then on the box in which it is.
    for _ in range(2):
        x, y = (np.linspace(0.0, end, SAMPLES) for end in ends)
        p, better = (f(x[:, None], y) for f in (solution.density, solution.enriched_density))
        known = (p > 0.0) & (better > 0.0) & (np.abs(p - better) < KNOWN * better)
        known &= better > np.exp(-rise) * better.max()
        if not known.any():
            return None
        ends = [
            float(H[min(int(np.flatnonzero(known.any(axis=1 - axis))[-1]) + 1, SAMPLES - 1)])
            for axis, H in enumerate((x, y))
        ]
    log_p = np.log(np.where(known, better, 1.0))
    return fitted_weight((x, y), log_p, known, rise)
