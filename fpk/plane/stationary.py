"""Certified solution of the stationary FPK equation of two energies, Eq. (19).

One discretisation, two uses of it. The spectral solver writes p = w u, w a weight near p, u of high
degree on a few panels. Where it does not get to the tolerance plain finite elements expand p
itself: the smaller the smallest p that must be right, the more of them. Any w gives the same p, so
that neither rests on a guess.
"""

from collections.abc import Iterator

import numpy as np

from fpk.ends import require_confined
from fpk.errors import InvalidInput, NotCertified
from fpk.plane.balance import detailed_balance
from fpk.plane.plain import solve_by_elements
from fpk.plane.probe import Probe, probed
from fpk.plane.solution import PlaneSolution
from fpk.plane.spectral import solve_with_weight
from fpk.plane.weight import Weight, flux_free_weight
from fpk.process import Process


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
