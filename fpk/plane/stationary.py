"""Certified solution of the stationary FPK equation of two energies, Eq. (19).

One discretisation, two uses of it. The spectral solver writes p = w u, w a weight near p, u of high
degree on a few panels. Where it does not get to the tolerance plain finite elements expand p
itself: the smaller the smallest p that must be right, the more of them. Any w gives the same p, so
that neither rests on a guess. Under detailed balance, where no probability flows, the weight is the
density: p = w/∫w.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from fpk.certificate import Measured, certify
from fpk.ends import require_confined
from fpk.errors import InvalidInput, NotCertified
from fpk.piecewise import PiecewiseTensor
from fpk.plane.on_mesh import solve_by_elements
from fpk.plane.probe import Probe, divided_by_diffusion, probed
from fpk.plane.solution import ROUND_OFF, PlaneSolution, gauss_grid, graded, tails
from fpk.plane.spectral import solve_with_weight
from fpk.plane.weight import BEYOND, Weight, flux_free_weight
from fpk.process import Process

RISE = 36.0
"""Least rise of −ln w up to the far edges: e^−36 = 2e-16."""
POINTS = 22
"""Gauss points of each panel of the integral of w: e^(−32 t) is integrated to 4e-14."""
PANELS = (2, 4, 8, 16, 24)
"""Panels along each axis, equidistant in √H, the amplitude, tried until the integral of w is known:
more make more than 3e5 points."""
QUARTERS = 4
"""Parts of each panel in the answer: over a rise of 8 twelve Gauss points give e^(−8 t) to 3e-16,
for whoever integrates p over its panels."""
QUADRATURE = 1e-12
"""Relative difference of the integrals by rules of ``POINTS`` and two points fewer, up to which
panels are fine enough; what is left of it is in the stated error."""


def solve_plane(
    process: Process, *, tol: float = 1e-10, degree: int | None = None
) -> PlaneSolution:
    """Return the stationary density of two energies to the L1 tolerance ``tol``.

    No boundary condition is imposed: at H_i = 0 the diffusion across vanishes, and zero flux is
    natural there and far out. With a ``degree`` plain elements of that degree are used at once. If
    no attempt is certified, the one of the least error estimate is returned, not certified.

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
        raise NotCertified("neither a weight nor an affordable mesh gives the density")
    return best


def _attempts(process: Process, probe: Probe, tol: float) -> Iterator[PlaneSolution]:
    """Solutions, each made after the one before was not certified.

    Where no polynomial falls off, the first w is the product of exponentials of the scales.
    """
    weight = flux_free_weight(probe, process.energy_scales)
    if weight is None:
        first, second = process.energy_scales
        weight = Weight(np.array([[0.0, 1.0], [1.0, 0.0]]), (first, second))
    balanced = detailed_balance(process, weight, tol=tol)
    if balanced is not None:
        yield balanced
    try:
        yield from solve_with_weight(process, weight, tol=tol)
        yield solve_by_elements(process, probe, tol=tol)
    except NotCertified:
        return


def detailed_balance(process: Process, weight: Weight, *, tol: float) -> PlaneSolution | None:
    """Return p = w/∫w if the flux of w vanishes, as far as the error ``tol`` is concerned.

    Zero flux is ``∇ ln p = b⁻¹ (2s − ∇·b)``; the integral along each axis of what −∇ ln w misses of
    it bounds how far ln p is off. There p does not count: behind a barrier a small difference in
    its slope moves mass from one side to the other. Returned is None where the bound is more than
    half the tolerance, or where w varies too fast for any of ``PANELS``.
    """
    weight = replace(weight, floor=0.0)
    try:
        ends = weight.ends(max(RISE, -float(np.log(BEYOND * tol))))
    except NotCertified:
        return None
    for panels in PANELS:
        nodes = graded(ends, panels)
        (x, y), (v, area) = gauss_grid(nodes, POINTS)
        w, *slopes = weight.on_grid(x, y)
        mass = float(v @ w @ area)
        (fewer_x, fewer_y), fewer = gauss_grid(nodes, POINTS - 2)
        p = weight(fewer_x[:, None], fewer_y) / mass
        mass_defect = abs(float(fewer[0] @ p @ fewer[1]) - 1.0)
        if mass_defect <= QUADRATURE:
            break
    else:
        return None
    points = np.stack(np.broadcast_arrays(x[:, None], y), axis=-1)
    c = process.coefficients(points.reshape(-1, 2))
    slope = np.stack(slopes, axis=-1).reshape(-1, 2)
    flow = 2.0 * c.drift - c.divergence
    flux = np.einsum("nij,nj->ni", c.diffusion, slope) + flow
    missed = np.abs(divided_by_diffusion(flux, c.diffusion)).reshape(points.shape)
    missed[w < np.exp(-RISE) * w.max()] = 0.0
    # Twice, as p is normalised: a factor in one place is a factor everywhere else.
    wrong = 2.0 * float(missed[..., 0].max(axis=1) @ v + missed[..., 1].max(axis=0) @ area)
    if not wrong <= 0.5 * tol:
        return None
    u = PiecewiseTensor(
        graded(ends, QUARTERS * panels), np.full((QUARTERS * panels,) * 2 + (1, 1), 1.0 / mass)
    )
    tail = float(tails(w / mass, (x, y), (v, area), POINTS)[0].sum())
    sizes = p * weight.terms(fewer_x[:, None], fewer_y)
    rounding = ROUND_OFF * float(fewer[0] @ sizes @ fewer[1])
    terms = np.abs(flow) * w.reshape(-1, 1)
    measured = Measured(
        l1_error=wrong + 2.0 * tail + mass_defect + rounding,
        mass_defect=mass_defect,
        minimum=float(w.min() / w.max()),
        residual=float(np.max(np.abs(flux) * w.reshape(-1, 1)) / terms.max()),
        tail_mass=tail,
    )
    relative, certificate = wrong + tail + mass_defect, certify(measured, tol=tol)
    return PlaneSolution(process, u, u, weight, relative, measured, certificate)
