"""The stationary density of two energies p = w u on a tensor mesh, Eq. (19), and its error."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.ndimage import maximum_filter

from fpk.answer.certificate import DISTANCE_FACTOR, Certificate, Measured, certify
from fpk.numeric.arrays import EPS, Array
from fpk.numeric.piecewise import PiecewiseTensor
from fpk.numeric.quadrature import GAUSS_RULES, gauss_grid, integral
from fpk.solvers.line.elements import ENRICHMENT
from fpk.solvers.line.stationary import HALF_WAVE
from fpk.solvers.plane.elements import Nodes, null_function
from fpk.solvers.plane.weight import UNIT_WEIGHT, Weight
from fpk.system.process import Process


@dataclass(frozen=True, eq=False)
class PlaneSolution:
    """Density p(H1, H2) = w u with its measured numbers and certificate.

    The error estimate compares the piecewise polynomial u with ``enriched``, of a higher degree.
    ``beyond`` (2,) is the mass beyond each far edge; it and the error of ∫p add up to
    ``relative_error``, a relative error of p everywhere. From ``detailed_balance`` u and
    ``enriched`` are the same constant, and ``relative_error`` contains the bound for ln p, too.
    """

    process: Process
    u: PiecewiseTensor
    enriched: PiecewiseTensor
    weight: Weight
    beyond: Array
    relative_error: float
    measured: Measured
    certificate: Certificate

    @property
    def l1_error(self) -> float:
        """Estimate of ∫|p_h − p|."""
        return self.measured.l1_error

    @property
    def nodes(self) -> Nodes:
        """Ends of the elements along H1 and H2."""
        return self.u.nodes

    @property
    def panels(self) -> Nodes:
        """Nodes, refined in √H if there are few: Gauss rules between them have round-off only."""
        first, second = self.nodes
        # On more than four panels a dozen Gauss points integrate w u to round-off.
        while not self.weight.plain and first.size <= 4:
            first, second = (
                np.insert(x, range(1, x.size), 0.25 * (x[1:] ** 0.5 + x[:-1] ** 0.5) ** 2)
                for x in (first, second)
            )
        return first, second

    @property
    def degree(self) -> int:
        """Degree of u along each axis; 0 if no probability flows, so that w is the density."""
        return int(self.u.coefficients.shape[-1]) - 1

    @property
    def unknowns(self) -> int:
        """Degrees of freedom of the global finite element space."""
        first, second = ((x.size - 1) * self.degree + 1 for x in self.nodes)
        return first * second

    def density(self, H1: Array, H2: Array) -> Array:
        """Return p_h at ``H1`` and ``H2`` that broadcast; 0 outside the nodes."""
        return self.u(H1, H2) * self.weight(H1, H2)

    def far_ends(self, rise: float) -> Array:
        """Return the energies (2,) beyond which −ln w exceeds ``rise``; the last nodes if w = 1.
        Raises as ``Weight.ends`` does."""
        if self.weight.plain:
            return np.array([x[-1] for x in self.nodes])
        return np.array(self.weight.ends(rise))

    @cached_property
    def _around(self) -> tuple[Nodes, Array]:
        """Energies of a grid along each axis, and the error of √w u around each grid point.

        The distance to the enriched solution vanishes on lines where the error does not. As for one
        energy, the largest distance within two half-waves is used. The norm of the weak form is
        ∫(√w u)².
        """
        count = HALF_WAVE * (self.enriched.coefficients.shape[-1] - 1)
        share = 0.5 - 0.5 * np.cos(np.pi * np.arange(count + 1) / max(count, 1))
        x, y = (np.unique(z[:-1, None] + np.diff(z)[:, None] * share) for z in self.nodes)
        root = np.sqrt(self.weight(x[:, None], y))
        u, better = self.u.on_grid(x, y) * root, self.enriched.on_grid(x, y) * root
        rounding = 2.0 * EPS * self.degree**2 * np.abs(u).max()
        distance = DISTANCE_FACTOR * np.abs(u - better) + rounding
        return (x, y), maximum_filter(distance, 4 * HALF_WAVE + 1, mode="nearest")

    def pointwise_error(self, H1: Array, H2: Array) -> Array:
        """Return the estimate of |p_h − p| at ``H1`` and ``H2`` that broadcast; outside the nodes
        √w times the error of √w u at the nearest edge."""
        x, y = np.asarray(H1, float), np.asarray(H2, float)
        grid, error = self._around
        at = zip(grid, (x, y), strict=True)
        i, j = (np.searchsorted(z, H).clip(max=z.size - 1) for z, H in at)
        relative = self.relative_error + 2.0 * EPS * (self.degree**2 + self.weight.terms(x, y))
        own = error[i, j] * np.sqrt(self.weight(x, y))
        return np.asarray(own + relative * np.abs(self.density(x, y)))


def root_spaced_nodes(ends: Sequence[float] | Array, panels: int) -> Nodes:
    """Return nodes (``panels`` + 1,) along each axis, from 0 to ``ends``, equidistant in √H."""
    share = np.linspace(0.0, 1.0, panels + 1) ** 2
    return ends[0] * share, ends[1] * share


def gauss_points(nodes: Nodes, degree: int, weight: Weight) -> int:
    """Return the number of Gauss points along each axis of an element between ``nodes``. u has the
    ``degree``; a ``weight`` other than 1 takes more points."""
    # A weight is no polynomial: all panels of an axis share the points of the rule of one axis.
    more = 0 if weight.plain else GAUSS_RULES[1][-1] // min(x.size - 1 for x in nodes)
    return degree + ENRICHMENT + more


def tails(p: Array, grids: list[tuple[Array, Array]], points: int) -> tuple[Array, Array]:
    """Return the mass beyond each far edge (2,) and the e-folding energies measured there (2,).

    ``p`` is given on the ``grids``, Gauss points and weights of each axis. From its fall over the
    last ``points`` of each axis the marginal is continued with half of its logarithmic slope, as
    this may decrease. If the marginal does not fall, the mass is infinite and the e-folding energy
    0; if it falls to 0, both are 0.
    """
    beyond, e_fold = np.zeros(2), np.zeros(2)
    (x, v), (y, w) = grids
    for axis, (energy, marginal) in enumerate(((x, p @ w), (y, v @ p))):
        H, along = energy[-points:], np.abs(marginal[-points:])
        low, high = float(along[0]), float(along[-1])
        if not high < low:
            beyond[axis] = np.inf
        elif high > 0.0:
            e_fold[axis] = float(H[-1] - H[0]) / np.log(low / high)
            beyond[axis] = 2.0 * high * e_fold[axis]
    return beyond, e_fold


def solve_plane_on_mesh(
    process: Process,
    nodes: Nodes,
    degree: int,
    *,
    tol: float = np.inf,
    weight: Weight = UNIT_WEIGHT,
    longer: bool = False,
    solved: Callable[..., tuple[PiecewiseTensor, float]] = null_function,
) -> PlaneSolution:
    """Return the finite element solution p = w u, u of ``degree`` between ``nodes``.

    ``tol`` is the tolerance of the certificate; w is the ``weight``. If ``longer``, the mesh of the
    enriched solution extends along each axis until the marginal has fallen by another e², unless
    the mass beyond is round-off. The distance then contains 1 − e⁻² = 86 % of the error by ending
    the mesh, which exceeds the mass beyond if probability circulates. ``solved`` replaces
    ``null_function``. Raises ``NotCertified`` if the equations have no unique solution.
    """

    def of_mass_one(mesh: Nodes, degree: int, count: int) -> tuple[PiecewiseTensor, float]:
        """u of ``degree`` on ``mesh`` by ``count`` Gauss points, scaled to mass 1; its residual."""
        u, residual = solved(process, mesh, degree, count, weight)
        H, grids = gauss_grid(mesh, points=count)
        return PiecewiseTensor(mesh, u.coefficients / integral(u(*H) * weight(*H), grids)), residual

    points = gauss_points(nodes, degree, weight)
    H, grids = gauss_grid(nodes, points=points)
    u, residual = of_mass_one(nodes, degree, points)
    w = weight(*H)
    p = u(*H) * w
    mass_defect = abs(integral(p, grids) - 1.0)
    beyond, e_fold = tails(p, grids, points)
    # The mass beyond the mesh counts twice, there and elsewhere, as p_h has mass 1. If it is
    # round-off, its slope has no meaning.
    tail, reach = float(beyond.sum()), np.where(beyond > 2.0 * EPS, 2.0 * longer * e_fold, 0.0)
    first, second = (z * (1.0 + r / z[-1]) for z, r in zip(nodes, reach, strict=True))
    enriched, _ = of_mass_one((first, second), degree + ENRICHMENT, points + ENRICHMENT)
    relative, distance = tail + mass_defect, DISTANCE_FACTOR * np.abs(p - enriched(*H) * w)
    # Round-off of shape functions averages out over the elements; round-off of a weight does not.
    elements = (nodes[0].size - 1) * (nodes[1].size - 1)
    rounding = degree**2 * elements**0.5 + integral(np.abs(p) * weight.terms(*H), grids)
    measured = Measured(
        l1_error=integral(distance, grids) + tail + relative + 2.0 * EPS * rounding,
        mass_defect=mass_defect,
        minimum=float(p.min() / p.max()),
        residual=residual,
        tail_mass=tail,
        absolute_error=float(np.max(distance) / p.max()),
    )
    certificate = certify(measured, tol=tol)
    return PlaneSolution(process, u, enriched, weight, beyond, relative, measured, certificate)
