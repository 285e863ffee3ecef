"""Detailed balance: where no probability flows, the weight is the density, p = w/∫w."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fpk.certificate import Measured, certify
from fpk.errors import NotCertified
from fpk.piecewise import PiecewiseTensor
from fpk.plane.probe import divided_by_diffusion
from fpk.plane.solution import ROUND_OFF, PlaneSolution, gauss_grid, tails
from fpk.plane.weight import Weight
from fpk.process import Process

Array = NDArray[np.float64]

RISE = 36.0
"""Least rise of −ln w up to the far edges: e^−36 = 2e-16."""
BEYOND = 1e-3
"""Fraction of the tolerance that w falls to at the far edges."""
POINTS = 22
"""Gauss points that integrate w over a panel of ``PANEL_RISE``: e^(−32 t) to 4e-14."""
PANEL_RISE = 32.0
QUARTERS = 4
"""Parts of each panel in the answer: over a rise of 8 twelve Gauss points give e^(−8 t) to 3e-16,
for whoever integrates p over its panels."""
MAX_PANELS = 24
"""Panels along one axis: more make more than 3e5 points."""


def detailed_balance(process: Process, weight: Weight, *, tol: float) -> PlaneSolution | None:
    """Return p = w/∫w if the flux of w vanishes, as far as the error ``tol`` is concerned.

    Zero flux is ``∇ ln p = b⁻¹ (2s − ∇·b)``; the integral along each axis of what −∇ ln w misses of
    it bounds how far ln p is off. There p does not count: behind a barrier a small difference in
    its slope moves mass from one side to the other. Returned is None where the bound is more than
    half the tolerance, or where w varies too fast for ``MAX_PANELS``.
    """
    weight = replace(weight, floor=0.0)
    try:
        nodes = weight.panels(max(RISE, -float(np.log(BEYOND * tol))), PANEL_RISE)
    except NotCertified:
        return None
    if max(x.size for x in nodes) > MAX_PANELS + 1:
        return None
    (x, y), (v, area) = gauss_grid(nodes, POINTS)
    w, *slopes = weight.on_grid(x, y)
    mass = float(v @ w @ area)
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
    first, second = (
        np.interp(np.arange(QUARTERS * (x.size - 1) + 1), QUARTERS * np.arange(x.size), x)
        for x in nodes
    )
    counts = (first.size - 1, second.size - 1)
    u = PiecewiseTensor((first, second), np.full((*counts, 1, 1), 1.0 / mass))
    tail = float(tails(w / mass, (x, y), (v, area), POINTS).sum())
    (x, y), (v, area) = gauss_grid(nodes, POINTS - 2)
    p = weight(x[:, None], y) / mass
    mass_defect = abs(float(v @ p @ area) - 1.0)
    rounding = ROUND_OFF * float(v @ (p * weight.terms(x[:, None], y)) @ area)
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
