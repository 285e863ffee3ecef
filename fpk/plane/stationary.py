"""Certified solution of the stationary FPK equation of two energies, Eq. (19).

The density is expanded as p = w u: w a positive weight near p, u a polynomial of order one, so that
p stays positive wherever it can be told from zero, and few unknowns give it. The equation is solved
from its coefficients alone: any w gives the same p, a good one sooner. Where probability circulates
much, u is a polynomial on each of a few elements; where no w is found the elements expand p itself.
"""

from collections.abc import Generator, Iterator

import numpy as np
from numpy.typing import NDArray

from fpk.ends import require_confined
from fpk.errors import InvalidInput, NotCertified
from fpk.plane.expansion import Solved, panels_of, solve_expansion
from fpk.plane.mesh import Probe, probed
from fpk.plane.on_mesh import solve_by_elements, solve_plane_on_mesh
from fpk.plane.solution import PlaneSolution, judged, mass_beyond
from fpk.plane.weight import Weight, flux_free_weight
from fpk.plane.weighted import KNOWN, lacking, solve_with_weight, weight_of
from fpk.process import Process

__all__ = ["PlaneSolution", "solve_plane", "solve_plane_on_mesh"]

Array = NDArray[np.float64]

DEGREES = (4, 8, 12, 16)
"""Degrees of u as one polynomial that are tried, one after the other."""
STEP = 4
ENRICHMENT = 2
"""Degrees by which the comparison solution exceeds the answer along both axes."""
POINTS = 18
"""Gauss points on each panel, beyond the degree: see ``fpk.plane.weight.NATS_PER_PANEL``."""
MORE_POINTS = 22
"""Those of the comparison solution: the distance to it holds the error of the integrals, too."""
LEAST_NATS = 36.0
"""Integrals go at least to w = e^−36 = 2e-16, beyond what the sign of p is looked at for."""
MORE_NATS = 4.0
"""Those of the comparison solution go farther: the distance holds what ending them costs, too."""
ROUGH = 1e-5
"""Tolerance of the finite elements to which a weight is fitted where no other is good enough."""


def solve_plane(
    process: Process, *, tol: float = 1e-10, degree: int | None = None
) -> PlaneSolution:
    """Return the stationary density of two energies to the L1 tolerance ``tol``.

    No boundary condition is imposed: at H_i = 0 the diffusion across vanishes, and zero flux is
    natural there and far out. The first weight is what the density would be if no probability
    flowed, or near that; degree by degree it is fitted again to p = w u. The estimate is the
    distance to a solution of two degrees more and other Gauss points. With a ``degree`` the finite
    elements of that degree are taken at once. What is returned without a certificate is the best
    that was found.

    Raises ``NotCertified`` where the density does not fall off, ``InvalidInput`` for a process
    that has not two energies.
    """
    if process.dimension != 2:
        raise InvalidInput("process", process.dimension, "must have two energies")
    require_confined(process)
    probe = probed(process)
    if degree is not None:
        return solve_by_elements(process, probe, tol=tol, degree=degree)
    best: PlaneSolution | None = None
    for solution in _attempts(process, probe, tol):
        if solution.certificate.certified:
            return solution
        if best is None or not best.l1_error <= solution.l1_error:
            best = solution
    if best is None:
        raise NotCertified("neither a weight nor an affordable mesh was found for the density")
    return best


def _attempts(process: Process, probe: Probe, tol: float) -> Iterator[PlaneSolution]:
    """Solutions, each made after the last one was found wanting."""
    weight = yield from _expanded(process, flux_free_weight(probe, process.energy_scales), tol)
    try:
        if weight is None:
            tolerance = max(tol, ROUGH)
            rough = solve_by_elements(process, probe, tol=tolerance, degree=None, strict=False)
            weight = weight_of(rough)
        if weight is not None:
            yield from solve_with_weight(process, weight, tol=tol)
        yield solve_by_elements(process, probe, tol=tol, degree=None)
    except NotCertified:
        return


def _expanded(
    process: Process, weight: Weight | None, tol: float
) -> Generator[PlaneSolution, None, Weight | None]:
    """Expansions of rising degree, each tried once more with a weight fitted to it.

    Ends where the digits that lack fall too slowly to get there in the degrees left, and returns
    the weight fitted to the best of them.
    """
    best, least, last = weight, np.inf, np.inf
    for steps, degree in zip(range(len(DEGREES) - 1, -1, -1), DEGREES, strict=True):
        solution = None if weight is None else _expansion(process, weight, degree, tol)
        if solution is None:
            break
        yield solution
        digits, fitted = lacking(solution, tol), weight_of(solution)
        if solution.l1_error < least:
            best, least = fitted or best, solution.l1_error
        again = None if fitted is None else _expansion(process, fitted, degree, tol)
        if again is not None:
            yield again
            if again.l1_error < solution.l1_error:
                weight, digits = fitted, lacking(again, tol)
            if again.l1_error < least:
                best, least = weight_of(again) or best, again.l1_error
        if least > KNOWN or not digits - (last - digits) * steps <= 0.0:
            break
        last = digits
    return best


def _expansion(process: Process, weight: Weight, degree: int, tol: float) -> PlaneSolution | None:
    # An error of size one at w = e^−n, such as the natural condition makes there, is one of
    # e^−n/2 in the norm weighted by w.
    nats = max(LEAST_NATS, -2.0 * float(np.log(tol)))
    try:
        nodes = panels_of(weight, nats + MORE_NATS)
        answer = solve_expansion(process, weight, nodes, degree, nats=nats, points=degree + POINTS)
        better = solve_expansion(
            process,
            weight,
            nodes,
            degree + ENRICHMENT,
            nats=nats + MORE_NATS,
            points=degree + MORE_POINTS,
        )
    except NotCertified:
        return None
    at = better.places
    u, enriched = (s.density.on_grid(*at.energies) for s in (answer, better))
    p = u * at.w
    rounding = answer.density.rounding(at.energies[0][:, None], at.energies[1])
    return judged(
        process,
        answer.density,
        better.density,
        (p, enriched * at.w, at.area),
        tol=tol,
        tail=_tail(better, p, degree + MORE_POINTS),
        rounding=float(np.sum(at.area * np.abs(p) * rounding)),
        residual=answer.residual,
    )


def _tail(solved: Solved, p: Array, last: int) -> float:
    """Mass where no integral was taken: between the nodes, and beyond the ``last`` points."""
    at = solved.places
    total = float(np.sum(np.where(at.seen, 0.0, np.abs(p)) * at.area))
    for axis, (H, nodes) in enumerate(zip(at.energies, at.nodes, strict=True)):
        width = at.area.sum(axis=1 - axis) / at.area.sum() * nodes[-1]
        along = np.abs((p * at.area).sum(axis=1 - axis) / width)
        total += mass_beyond(H[-last:], along[-last:])
    return total
