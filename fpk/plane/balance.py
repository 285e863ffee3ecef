"""Detailed balance: where no probability flows, the weight is the density, p = w/∫w."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fpk.certificate import Measured, certify
from fpk.errors import NotCertified
from fpk.plane.elements import gauss_rule
from fpk.piecewise import PiecewiseTensor
from fpk.plane.elements import gauss_energies
from fpk.plane.mesh import Nodes
from fpk.plane.on_mesh import gauss_weights, tails
from fpk.plane.probe import divided_by_diffusion
from fpk.plane.solution import PlaneSolution
from fpk.plane.weight import Weight
from fpk.plane.weighted import WeightedPolynomial
from fpk.process import Process

Array = NDArray[np.float64]

RISE = 36.0
"""Least rise of −ln w up to the far edges: e^−36 = 2e-16."""
BEYOND = 1e-3
"""Fraction of the tolerance that w falls to at the far edges."""
RULE = 20
"""Degree whose Gauss rule, of 22 points, integrates w over a panel of ``PANEL_RISE``: e^(−32 t) to
4e-14."""
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
    H1, H2 = (H.ravel() for H in gauss_energies(nodes, RULE))
    w, *slopes = weight.on_grid(H1, H2)
    steps = [_line_weights(x) for x in nodes]
    area = np.multiply.outer(*steps)
    share = w * area / np.sum(w * area)
    points = np.stack(np.broadcast_arrays(H1[:, None], H2), axis=-1)
    c = process.coefficients(points.reshape(-1, 2))
    slope = np.stack(slopes, axis=-1).reshape(-1, 2)
    flow = 2.0 * c.drift - c.divergence
    flux = np.einsum("nij,nj->ni", c.diffusion, slope) + flow
    missed = np.abs(divided_by_diffusion(flux, c.diffusion)).reshape(points.shape)
    missed[w < np.exp(-RISE) * w.max()] = 0.0
    # Twice, as p is normalised: a factor in one place is a factor everywhere else.
    wrong = 2.0 * sum(float(missed[..., k].max(axis=1 - k) @ steps[k]) for k in (0, 1))
    if not wrong <= 0.5 * tol:
        return None
    p = _constant(nodes, weight, 1.0 / float(np.sum(w * area)))
    quarters = tuple(
        np.interp(np.arange(QUARTERS * (x.size - 1) + 1), QUARTERS * np.arange(x.size), x)
        for x in nodes
    )
    answer = _constant((quarters[0], quarters[1]), weight, 1.0 / float(np.sum(w * area)))
    tail = float(tails(p, RULE).sum())
    mass = float(np.sum(gauss_weights(nodes, RULE - 2) * p.at_gauss(RULE - 2)))
    terms = np.abs(flow) * w.reshape(-1, 1)
    rounding = float(np.sum(share * answer.rounding(H1[:, None], H2)))
    measured = Measured(
        l1_error=wrong + 2.0 * tail + abs(mass - 1.0) + rounding,
        mass_defect=abs(mass - 1.0),
        minimum=float(w.min() / w.max()),
        residual=float(np.max(np.abs(flux) * w.reshape(-1, 1)) / terms.max()),
        tail_mass=tail,
    )
    relative = wrong + tail + abs(mass - 1.0)
    return PlaneSolution(process, answer, answer, relative, measured, certify(measured, tol=tol))


def _line_weights(nodes: Array) -> Array:
    """Quadrature weights along one axis that go with degree ``RULE``."""
    return np.asarray(np.multiply.outer(np.diff(nodes), gauss_rule(RULE)[1]).ravel())


def _constant(nodes: Nodes, weight: Weight, factor: float) -> WeightedPolynomial:
    """p = factor · w on the panels between ``nodes``."""
    panels = (nodes[0].size - 1, nodes[1].size - 1)
    return WeightedPolynomial(PiecewiseTensor(nodes, np.full((*panels, 1, 1), factor)), weight)
