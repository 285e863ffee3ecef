"""The spectral solver of p(H1, H2): p = w u, u a polynomial of high degree on each of few panels.

In the norm that the weak form weights by w ≈ p an error ε of u is one of ε √p of p, so that p stays
positive far below the tolerance: what plain elements need many unknowns for.
"""

from collections.abc import Iterator

import numpy as np

from fpk.certificate import outside
from fpk.errors import NotCertified
from fpk.plane.on_mesh import solve_plane_on_mesh
from fpk.plane.solution import PlaneSolution, graded
from fpk.plane.weight import Weight, fitted_weight
from fpk.process import Process

LEVELS = ((2, 6), (2, 10), *((4, p) for p in range(8, 19)), *((n, 18) for n in range(5, 9)))
"""Panels along each axis and degree of the attempts. Those on two panels cost little, and give the
weight; of higher degree over so long panels the equations lose digits to round-off. From four on
the degree is raised first: a digit costs less so."""
DIGITS, DOUBLED = 0.6, 3.0
"""Digits of the error that a degree gains, and degrees that twice as many panels are worth: 0.4 to
0.85 and 2.9 to 3.6 digits with two more degrees, measured for circulating van der Pol damping and
mixtures of exponentials."""
COARSE, STEP = 1e-4, 5.0
"""Error above which at most ``STEP`` degrees are gained at once: a better weight may follow."""
TRIED = 1e-5
"""Error above which a better weight is tried on the same unknowns first, and gains more."""
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
    level, rise, least = 0, -float(np.log(BEYOND * tol)), np.inf
    beyond, stalled, best = max(rise, LEAST_RISE), 0, weight
    while level < len(LEVELS) and stalled < 2:
        panels, degree = LEVELS[level]
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
            level = _finer(level, solution.l1_error, tol)
        # A weight that does not lower the error extrapolates badly: back to the one before.
        weight = best if better is None else better
        stalled = 0 if halved else stalled + 1


def _finer(level: int, error: float, tol: float) -> int:
    """Return the next of ``LEVELS``: as many degrees more as the missing digits of the error take.

    Where the density does not fall off at the edges infinitely many are missing.
    """
    panels, degree = np.array(LEVELS).T
    worth = degree + DOUBLED * np.log2(panels)
    by_degree = worth[panels <= 4][:-1]  # no level beyond the highest degree is skipped to
    missing = float(np.log10(max(error / tol, 1.0))) / DIGITS
    wanted = worth[level] + (min(missing, STEP) if error > COARSE else missing)
    return max(level + 1, int(np.searchsorted(by_degree, wanted)))


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
