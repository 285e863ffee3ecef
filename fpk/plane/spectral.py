"""The spectral solver of p(H1, H2): p = w u, u a polynomial of high degree on each of few panels.

In the norm that the weak form weights by w ≈ p an error ε of u is one of ε √p of p, so that p stays
positive far below the tolerance: what plain elements need many unknowns for.
"""

from collections.abc import Iterator

import numpy as np

from fpk.certificate import NEGATIVE, outside
from fpk.errors import NotCertified
from fpk.plane.on_mesh import solve_plane_on_mesh
from fpk.plane.solution import PlaneSolution, graded
from fpk.plane.weight import Weight, fitted_weight
from fpk.process import Process

FIRST = (2, 6)
"""Panels along each axis and degree of the first attempts: they cost little, and give the weight.
Their degree is raised once, by ``STEP`` where that suffices: of high degree over long panels the
equations lose digits to round-off."""
SECOND = (4, 8)
"""Panels and least degree where the first panels do not suffice."""
LIMITS = (8, 18)
"""Most panels along each axis, and highest degree. The degree is raised first: a digit costs less
so."""
COARSE = 1e-4
"""Error above which the degree is raised by no more than ``STEP``: a better weight may follow."""
STEP = 4
TRIED = 1e-5
"""Error above which a better weight is tried on the same unknowns first, and gains more."""
DIGITS = (0.6, 3.0, 0.6)
"""Digits that a degree gains on the first panels, that ``SECOND`` gains on ``FIRST``, and that a
degree gains from there on: 0.4 to 0.7, 2.9 to 3.6 and 0.6 to 0.85, measured for circulating van
der Pol damping and mixtures of exponentials."""
NEGATIVE_DIGITS = 0.6
"""Digits of the error that a digit of the negative minimum counts: 1/1.6 was measured."""
BEYOND = 1e-4
"""Fraction of the tolerance that w falls to at the far edges: where w only continues what was known
of p, p may be a thousand times as large there."""
LEAST_RISE = 25.0
"""Least rise of −ln w up to the far edges of the first attempt, whose weight may be far from p."""
LONGER = 4.0
"""Rise of −ln w from the far edges of the answer to those of the enriched solution."""
LENGTHENING = 5.0
"""Further rise of −ln w up to the far edges where too much mass lies beyond."""
FAINT = 1e-6
"""Mass beyond the far edges, relative to the error, that says nothing: p is not that well known."""
MIN_EXTENSION = 1.05
"""Least relative lengthening of the mesh for the enriched solution: ``Weight.ends`` is good to 7 %
only."""
KNOWN = 0.1
"""Relative error of p up to which ln p is fitted."""
LEAST_KNOWN = 5.2
"""Rise of −ln p over which p must be known before a weight is fitted to it."""
SAMPLES = 32
"""Points along each axis at which a weight is fitted."""


def solve_with_weight(process: Process, weight: Weight, *, tol: float) -> Iterator[PlaneSolution]:
    """Yield solutions on more and more unknowns, each with a better weight.

    Ends where the weight does not fall off, the error no longer falls, or the panels are too many.
    """
    (panels, degree), rise, least = FIRST, -float(np.log(BEYOND * tol)), np.inf
    beyond, stalled, best = max(rise, LEAST_RISE), 0, weight
    while panels <= LIMITS[0] and stalled < 2:
        try:
            ends, farther = weight.ends(beyond), weight.ends(beyond + LONGER)
        except NotCertified:
            return
        nodes = graded(ends, panels)
        # All panels grow alike: to lengthen the last one alone would cost the enriched solution as
        # much there, where u is least smooth, as its degree gains.
        first, second = (
            H * max(end / H[-1], MIN_EXTENSION) for H, end in zip(nodes, farther, strict=True)
        )
        solution = solve_plane_on_mesh(
            process, nodes, degree, tol=tol, weight=weight, longer=(first, second)
        )
        yield solution
        halved = solution.l1_error < 0.5 * least
        if outside(solution.measured) > 0.1 * max(tol, FAINT * solution.l1_error) or not halved:
            rise = beyond + LENGTHENING
        beyond, better = rise, None
        if halved:
            best, better, least = weight, weight_of(solution), solution.l1_error
        if better is None or solution.l1_error < TRIED:
            panels, degree = _finer(panels, degree, solution, tol)
        # A weight that does not lower the error extrapolates badly: back to the one before.
        weight = best if better is None else better
        stalled = 0 if halved else stalled + 1


def _finer(panels: int, degree: int, solution: PlaneSolution, tol: float) -> tuple[int, int]:
    """The next panels and degree: as many degrees more as the missing digits take.

    An error ε in the norm weighted by w ≈ p is one of ε √p of p: p turns negative below ε² of its
    maximum, so that a negative minimum counts about half its digits.
    """
    negative = max((solution.measured.minimum or 0.0) / NEGATIVE, 1.0)
    missing = float(np.log10(max(solution.l1_error / tol, negative**NEGATIVE_DIGITS, 1.0)))
    coarse = solution.l1_error > COARSE
    if panels == FIRST[0]:
        if degree == FIRST[1] and missing <= STEP * DIGITS[0]:
            return panels, degree + STEP
        least, most = SECOND[1], SECOND[1] if coarse else LIMITS[1]
        return SECOND[0], int(np.clip(least + (missing - DIGITS[1]) / DIGITS[2] + 0.5, least, most))
    if degree >= LIMITS[1]:
        return panels + 1, degree
    # Where the density does not fall off at the edges infinitely many digits are missing.
    step = int(np.clip(np.ceil(missing / DIGITS[2]), 1, STEP if coarse else LIMITS[1]))
    return panels, min(degree + step, LIMITS[1])


def weight_of(solution: PlaneSolution) -> Weight | None:
    """Return a weight fitted to −ln p where p is known, None where no fit is much better.

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
    return fitted_weight((x, y), log_p, known, rise, present=solution.weight)
