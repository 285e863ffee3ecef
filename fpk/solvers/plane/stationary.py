"""Certified solution of the stationary FPK equation of two energies, Eq. (19).

p = w u with a weight w near p and u of high degree on a few panels, on a ladder of finer and finer
meshes. In the norm of the weak form, weighted by w ≈ p, an error ε of u is an error ε √p of p, so
that p stays positive far below the tolerance. If this does not reach the tolerance, more elements
with w = 1 are used. Under detailed balance, without probability flux, the weight is the density:
p = w/∫w.
"""

from collections.abc import Callable, Iterator
from dataclasses import replace
from math import ceil

import numpy as np

from fpk.answer.certificate import Measured, certify
from fpk.answer.dynamics import LARGEST_ERROR
from fpk.numeric.arrays import BLOCK_SIZE, EPS
from fpk.numeric.errors import NotCertified, require
from fpk.numeric.piecewise import PiecewiseTensor
from fpk.numeric.quadrature import gauss_grid, integral
from fpk.solvers.line.elements import ENRICHMENT
from fpk.solvers.plane import weight as weights
from fpk.solvers.plane.elements import null_function
from fpk.solvers.plane.solution import PlaneSolution, root_spaced_nodes, solve_plane_on_mesh, tails
from fpk.solvers.plane.weight import Weight
from fpk.system.ends import require_confined
from fpk.system.process import Process

RUNGS = ((2, 6), (2, 10), *((4, p) for p in range(8, 19)), *((n, 18) for n in range(5, 9)))
"""Panels along each axis and degree of the attempts. Degrees above 10 lose digits to round-off on
two long panels; from four panels on a higher degree gains a digit at less cost than more panels."""
DIGITS_PER_RUNG = 0.6
"""Digits of the error gained from one of ``RUNGS`` to the next: measured 0.4 to 0.85."""
REFIT_ERROR = 1e-4
"""L1 error from which on a weight fitted to the solution is tried before a finer mesh."""


def solve_plane(process: Process, *, tol: float = 1e-10) -> PlaneSolution:
    """Return the stationary density of ``process``, of two energies, to the L1 tolerance ``tol``.

    Zero flux is natural far out and at H_i = 0, where the normal diffusion vanishes. If no attempt
    is certified, the attempt with the smallest error estimate is returned. Raises ``NotCertified``
    if the density does not fall off or no attempt succeeds, ``InvalidInput`` unless the process has
    two energies.
    """
    require(process.dimension == 2, "process", process.dimension, "must have two energies")
    require_confined(process)
    weight = weights.flux_free_weight(process)

    def attempts() -> Iterator[PlaneSolution]:
        """Solutions in the order of their cost, each computed when the last was not certified."""
        balanced = detailed_balance(process, weight, tol=tol)
        yield from () if balanced is None else (balanced,)
        try:
            yield from solve_with_weight(process, weight, tol=tol)
            yield solve_by_elements(process, weight, tol=tol)
        except NotCertified:
            return

    best: PlaneSolution | None = None
    for solution in attempts():
        if solution.certificate.certified:
            return solution
        if best is None or not best.l1_error <= solution.l1_error:
            best = solution
    if best is None:
        raise NotCertified("neither a weight nor an affordable mesh gives the density")
    return best


def detailed_balance(process: Process, weight: Weight, *, tol: float) -> PlaneSolution | None:
    """Return p = w/∫w if the flux of the ``weight`` w vanishes within the L1 tolerance ``tol``.

    The error of ln p is bounded by the integral along each axis of the difference between ∇ ln w
    and b⁻¹ (2s − ∇·b), without the factor p: behind a barrier a small slope error moves mass from
    one side to the other. Returns None if twice this bound exceeds half of the tolerance, if w does
    not fall off, or if it varies too fast for 24 panels along each axis. w is taken without its
    floor. Raises ``NotCertified`` if b is singular at a quadrature point.
    """
    weight = replace(weight, floor=0.0)
    try:
        ends = weight.ends(max(weights.NEGLIGIBLE_FALL, weights.negligible_rise(tol)))
    except NotCertified:
        return None
    for panels in (2, 4, 8, 16, 24):
        H, grids = gauss_grid(root_spaced_nodes(ends, panels), points=22)  # e^(−32 t) to 4e-14
        w = weight(*H)
        mass = integral(w, grids)
        # A finer rule for comparison: 11 points on each quarter of a panel give e^(−8 t) to 6e-15.
        nodes = root_spaced_nodes(ends, 4 * panels)
        finer_H, finer = gauss_grid(nodes, points=11)
        p = weight(*finer_H) / mass
        mass_defect = abs(integral(p, finer) - 1.0)
        if mass_defect <= 1e-13:  # it is part of the stated error
            break
    else:
        return None
    at = np.stack(np.broadcast_arrays(*H), axis=-1)
    c = process.coefficients(at.reshape(-1, 2))
    slope = np.stack(weight.slopes(*H), axis=-1).reshape(-1, 2)
    flow = 2.0 * c.drift - c.divergence
    flux = np.einsum("nij,nj->ni", c.diffusion, slope) + flow
    missed = np.abs(weights.inverse_diffusion(flux, c.diffusion)).reshape(at.shape)
    missed[w < np.exp(-weights.NEGLIGIBLE_FALL) * w.max()] = 0.0
    # Twice, as p is normalised: a factor on p in one place changes p everywhere else.
    along = zip((missed[..., 0].max(axis=1), missed[..., 1].max(axis=0)), grids, strict=True)
    wrong = 2.0 * float(sum(most @ v for most, (_, v) in along))
    if not wrong <= 0.5 * tol:
        return None
    u = PiecewiseTensor(nodes, np.full((4 * panels,) * 2 + (1, 1), 1.0 / mass))
    beyond, _ = tails(w / mass, grids, 22)
    tail, rounding = float(beyond.sum()), integral(p * weight.terms(*finer_H), finer)
    measured = Measured(
        l1_error=wrong + 2.0 * tail + mass_defect + 2.0 * EPS * rounding,
        mass_defect=mass_defect,
        minimum=float(w.min() / w.max()),
        residual=float(np.max(np.abs(flux).T * w.ravel()) / np.max(np.abs(flow).T * w.ravel())),
        tail_mass=tail,
    )
    relative, certificate = wrong + tail + mass_defect, certify(measured, tol=tol)
    return PlaneSolution(process, u, u, weight, beyond, relative, measured, certificate)


def solve_with_weight(process: Process, weight: Weight, *, tol: float) -> Iterator[PlaneSolution]:
    """Yield solutions with more unknowns and better weights, as long as these lower the error.

    ``weight`` is the first weight, ``tol`` the L1 tolerance. Ends after two solutions in a row with
    more than 0.3 of the least error, after the last of ``RUNGS``, or if a weight does not fall off;
    a certified solution does not end it. Raises as ``solve_plane_on_mesh`` does.
    """
    rung, least, stalled, best = 0, np.inf, 0, weight
    rise = weights.negligible_rise(tol)
    farthest = max(rise, 25.0)  # the first weight may be far from p
    while rung < len(RUNGS) and stalled < 2:
        panels, degree = RUNGS[rung]
        try:
            nodes = root_spaced_nodes(weight.ends(farthest), panels)
        except NotCertified:
            return
        solution = solve_plane_on_mesh(process, nodes, degree, tol=tol, weight=weight, longer=True)
        yield solution
        error, better = solution.l1_error, None
        gained = error < 0.3 * least
        # A mass beyond the mesh below a millionth of the error is not known accurately.
        if (solution.measured.tail_mass or 0.0) > 0.1 * max(tol, 1e-6 * error) or not gained:
            rise = farthest + weights.RISE
        farthest = rise
        if gained:
            best, better, least = weight, weight_of(solution), error
        # On the first rung an error above 10 REFIT_ERROR leaves too few points for a fit.
        if better is None or error < REFIT_ERROR or (rung == 0 and error > 10.0 * REFIT_ERROR):
            missing = float(np.log10(max(error / tol, 1.0))) if np.isfinite(error) else np.inf
            gain = ceil(min(missing / DIGITS_PER_RUNG, 5 if error > REFIT_ERROR else len(RUNGS)))
            # The second rung is four degrees above the first. No rung is skipped beyond the highest
            # degree on four panels.
            rung = max(rung + 1, min(rung + gain - 3 * (rung == 0), RUNGS.index((4, 18))))
        # A weight that does not lower the error extrapolates badly: return to the best weight.
        weight = best if better is None else better
        stalled = 0 if gained else stalled + 1


def weight_of(solution: PlaneSolution) -> Weight | None:
    """Return a weight fitted to −ln p of ``solution``; None if no fit is accepted by ``fit_weight``
    or too few digits of p are known for a fit.

    The fit uses points at which the relative error of p is below ``LARGEST_ERROR``: with the error
    ε √p of p these have p > (ε/LARGEST_ERROR)² of its maximum.
    """
    rise = -2.0 * float(np.log(min(solution.l1_error, 1.0) / LARGEST_ERROR))
    if not rise > 2.0 * weights.RISE_PER_DEGREE:
        return None
    # Four times as many points along each axis as the fit of the highest degree needs.
    ends, points = [nodes[-1] for nodes in solution.nodes], 4 * (weights.MAX_WEIGHT_DEGREE + 2)
    # First on the whole mesh, to find the box in which p is known; then on this box.
    for _ in range(2):
        x, y = (np.linspace(0.0, end, points) for end in ends)
        w = solution.weight(x[:, None], y)
        p, better = (u(x[:, None], y) * w for u in (solution.u, solution.enriched))
        known = (p > 0.0) & (better > 0.0) & (np.abs(p - better) < LARGEST_ERROR * better)
        known &= better > np.exp(-rise) * better.max()
        if not known.any():
            return None
        ends = [H[min(weights.last_index(known, k) + 1, points - 1)] for k, H in enumerate((x, y))]
    log_p = np.log(np.where(known, better, 1.0))
    return weights.fit_weight((x, y), log_p, known, rise, present=solution.weight)


def solve_by_elements(
    process: Process,
    weight: Weight,
    *,
    tol: float,
    degree: int | None = None,
    marked: float = 0.1,
    solved: Callable[..., tuple[PiecewiseTensor, float]] = null_function,
) -> PlaneSolution:
    """Return the solution with w = 1 to the L1 tolerance ``tol`` on adaptively refined meshes.

    ``degree`` follows from ``tol`` unless given. The first mesh has four intervals along each axis,
    up to the ends of the ``weight``. Intervals whose highest modes exceed ``marked`` times the
    largest are halved, and one interval is added at an edge with mass beyond, until the answer is
    certified or the next mesh has too many matrix entries. ``solved`` replaces ``null_function``.
    Raises ``NotCertified`` if the first mesh has too many entries or the weight does not fall off,
    and as ``solve_plane_on_mesh`` does.
    """
    if degree is None:  # 1.6 degrees for each digit are the cheapest in fig8b
        degree = int(np.clip(round(-1.6 * np.log10(tol)), 4, 18))
    solution = None
    first, second = root_spaced_nodes(weight.ends(-float(np.log(1e-2 * tol))), 4)
    # The element matrices of the enriched solution are affordable up to 5 blocks, 160 MB.
    while (first.size - 1) * (second.size - 1) * (degree + ENRICHMENT + 1) ** 4 <= 5 * BLOCK_SIZE:
        solution = solve_plane_on_mesh(
            process, (first, second), degree, tol=tol, longer=True, solved=solved
        )
        if solution.certificate.certified:
            break
        area = np.multiply.outer(np.diff(first), np.diff(second))
        size = np.abs(solution.u.coefficients) * area[:, :, None, None]
        highest = size[:, :, -2:].sum(axis=(1, 2, 3)), size[..., -2:].sum(axis=(0, 2, 3))
        limit = marked * max(x.max() for x in highest)
        first, second = (
            np.sort(np.append(x, 0.5 * (x[1:] + x[:-1])[rough >= limit]))
            for x, rough in zip((first, second), highest, strict=True)
        )
        first, second = (
            np.append(x, 2.0 * x[-1] - x[-2]) if far else x
            for x, far in zip((first, second), solution.beyond > 0.1 * tol, strict=True)
        )
    if solution is None:
        raise NotCertified(f"the tolerance {tol:.2g} takes more elements than are affordable")
    return solution
