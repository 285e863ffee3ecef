"""Certified finite element solution of the stationary FPK equation of one energy.

Given a tolerance, degree and mesh adapt until the estimated L1 error is below it. No boundary
condition is imposed at H = 0 (an entrance boundary) nor at the far end: zero flux is natural. The
equation is solved from its coefficients alone; the known solution by quadrature is not used.
"""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.polynomial.legendre import legvander
from scipy.ndimage import maximum_filter1d

from fpk.answer.certificate import NEGATIVE, Certificate, Measured, certify
from fpk.numeric.arrays import BLOCK_SIZE, EPS, ROUND_OFF, SMALLEST, Array, Flags
from fpk.numeric.piecewise import Piecewise
from fpk.solvers.line.elements import Elements, NullVectors, element_rule, solve_elements
from fpk.solvers.line.mesh import (
    ELEMENT_FALL,
    GRADED_LAYERS,
    SMOOTH_FALL,
    Probe,
    initial_nodes,
    probe_process,
    split_points,
    with_layers,
)
from fpk.system.process import Process

LINE_FACTOR = 2.0
"""Stated L1 error over the distance to the enriched solution. At an algebraic singularity of order
r of u the enriched solution has the share (p/(p+2))^(2r+2) of the error, at most a half if r >= 3/2
and p <= 12; integrals above a contact energy have twice as many points in that solution."""
POINTWISE_FACTOR = 4.0
"""Stated error of p at a point over the distance to the enriched solution nearby. In 8 of 779
chains of 1 to 100 masses at tolerances from 2e-2 to 2e-10 the true error was two to three times
this distance, as the density of states rises by decades over an element."""

HALF_WAVE = 4
"""Samples of the distance to the enriched solution in each of its half-waves."""


@dataclass(frozen=True, eq=False)
class StationarySolution:
    """Finite element density p(H) with its error estimate and certificate.

    ``answer`` is u = p/T, ``enriched`` the solution of a higher degree. ``common_error`` is a
    relative error of p at all energies, by the coefficients and the mass. ``measured`` are the
    numbers behind ``certificate`` and the certificate of any density derived from the solution.
    """

    process: Process
    degree: int
    answer: Piecewise
    enriched: Piecewise
    common_error: float
    measured: Measured
    certificate: Certificate

    @property
    def l1_error(self) -> float:
        """Estimate of ∫|p_h − p| on (0, ∞)."""
        return self.measured.l1_error

    @property
    def nodes(self) -> Array:
        """Ends of the elements, (elements + 1,)."""
        return self.answer.nodes

    @property
    def panels(self) -> Array:
        """Nodes with layers where p is not smooth: Gauss rules between them have round-off only."""
        return with_layers(self.nodes, self.process.nonsmooth)

    @property
    def unknowns(self) -> int:
        """Degrees of freedom of the global finite element space."""
        return self.degree * (self.nodes.size - 1) + 1

    def density(self, energy: Array) -> Array:
        """Return p_h at ``energy`` of any shape; 0 outside the mesh."""
        return self.answer(energy, log_factor=self._log_states(energy))

    def phase_space_density(self, energy: Array) -> Array:
        """Return p_h/T at ``energy`` of any shape, T the density of states in the unit of
        ``Coefficients``; 0 outside the mesh."""
        return self.answer(energy)

    def pointwise_error(self, energy: Array) -> Array:
        """Return the estimate of |p_h − p| at ``energy`` of any shape: 0 below 0, beyond the mesh
        the local part of the estimate at its end."""
        return self._error(energy, self._log_states(energy))

    def phase_space_error(self, energy: Array) -> Array:
        """Return the estimate of |p_h − p|/T at ``energy`` of any shape: outside the mesh the local
        part of the estimate at the nearest end."""
        return self._error(energy, np.zeros(np.shape(energy)))

    def _error(self, energy: Array, factor: Array) -> Array:
        """Estimated absolute error of u e^``factor``, u = p_h/T, at ``energy``, with local and
        common errors; ``factor`` has the shape of ``energy``."""
        log_error, relative = self._of_elements
        x = np.asarray(energy, dtype=float)
        k = np.clip(np.searchsorted(self.nodes, x, side="right") - 1, 0, self.nodes.size - 2)
        share = np.clip((x - self.nodes[k]) / (self.nodes[k + 1] - self.nodes[k]), 0.0, 1.0)
        at = np.arccos(1.0 - 2.0 * share) * (log_error.shape[1] - 1) / np.pi
        point = np.minimum(at.astype(int), log_error.shape[1] - 2)
        below, above = log_error[k, point], log_error[k, point + 1]
        own = np.exp(below + (at - point) * (above - below) + factor)
        floor = self.common_error + (self.measured.tail_mass or 0.0) + relative[k]
        return np.asarray(own + floor * np.abs(self.answer(x, log_factor=factor)))

    def _log_states(self, energy: Array) -> Array:
        """ln T at ``energy`` of any shape; beyond the last node, ln T at this node; −∞ below 0, and
        at 0 for more than one degree of freedom."""
        end = float(self.nodes[-1])
        x, positive = self.process.on_mesh(np.asarray(energy, dtype=float), end)
        log_T = self.process.coefficients(x.ravel()).log_density_of_states.reshape(x.shape)
        return np.where(positive | (np.asarray(energy) > end), log_T, -np.inf)

    @cached_property
    def _of_elements(self) -> tuple[Array, Array]:
        """ln |error of u| (elements, points), and the relative round-off of p (elements,).

        The points are equidistant in the angle θ, H ~ 1 − cos θ, in which the distance to the
        enriched solution has half-waves of equal length; the largest distance of √T u within two
        half-waves is taken. Elimination of m unknowns leaves a round-off of up to m^(3/2) EPS
        (measured) of the largest p in the element, which rescales the elements of less mass.
        """
        count = HALF_WAVE * (self.enriched.coefficients.shape[1] - 1)
        t = -np.cos(np.pi * np.arange(count + 1) / count)
        u, better = (
            f.coefficients @ legvander(t, f.coefficients.shape[1] - 1).T
            for f in (self.answer, self.enriched)
        )
        scale, other = np.array([self.answer.log_scale, self.enriched.log_scale])[..., None]
        distance = np.abs(u - np.exp(other - scale) * better)
        x = self.nodes[:-1, None] + np.diff(self.nodes)[:, None] * 0.5 * (1.0 + t)
        share = element_rule(self.degree, self.process.degrees_of_freedom).share[0]
        log_T = self._log_states(np.maximum(x, self.nodes[1] * share))
        # The maximum filter would drop NaN: it is replaced by the largest number.
        distance = np.nan_to_num(distance, nan=1.0 / SMALLEST, posinf=1.0 / SMALLEST)
        weighted = np.log(np.maximum(distance, SMALLEST)) + 0.5 * log_T
        around = maximum_filter1d(weighted, 4 * HALF_WAVE + 1, axis=1, mode="nearest")
        p = np.abs(u) * np.exp(log_T + scale)
        most = self.degree**1.5 * p.max(axis=1)
        steps, top = (most[:-1] + most[1:]) / np.maximum(p[:-1, -1], SMALLEST), int(most.argmax())
        # Accumulated from the element with most mass outwards, so that its own share is least.
        below, above = np.cumsum(steps[:top][::-1])[::-1], np.cumsum(steps[top:])
        relative = self.nodes.size + np.concatenate([below, [0.0], above])
        own = math.log(POINTWISE_FACTOR) + around - 0.5 * log_T + scale
        rounding = np.log(np.maximum(2.0 * EPS * most[:, None], SMALLEST)) - log_T
        return np.logaddexp(own, rounding), 2.0 * EPS * relative


def solve_stationary(
    process: Process, *, tol: float = 1e-10, degree: int | None = None
) -> StationarySolution:
    """Return the stationary density of ``process``, of one energy, to the L1 tolerance ``tol``.

    ``degree`` of the elements follows from ``tol`` unless given. The certificate says if the
    tolerance was not reached. Raises ``NotCertified`` if no stationary density exists.
    """
    # If 2 F/b does not depend on H, u is smooth although T is not.
    smooth = not process.state_damping
    if degree is None:
        digits = round(-math.log10(tol))
        degree = min(max(digits + 4, 3), 16) if smooth else min(max(digits, 3), 12)
    probe = probe_process(process)
    nats: Array | float = ELEMENT_FALL
    if smooth:
        # The error of an element is weighted by its mass, and rises as nats^(degree + 1). Up to 7
        # nats p at the far end exceeds the error of its element, so that p stays positive.
        fall = probe.log_mass.max() - probe.log_mass
        nats = SMOOTH_FALL * np.exp(np.minimum(fall / (degree + 1), math.log(1.75)))
    end, layers = probe.extent(1e-2 * tol), 0 if smooth else GRADED_LAYERS
    nodes = initial_nodes(probe, end, process.nonsmooth, nats=nats, layers=layers)
    for _ in range(40):  # 2^−40 of a length is near the round-off of its ends
        elements = solve_elements(process, nodes, degree)
        solution, marked = _join_and_judge(process, probe, nodes, elements, degree, tol)
        # Element matrices of more than a block take seconds.
        if not marked.any() or marked.size * degree**2 > BLOCK_SIZE:
            break
        cut = split_points(nodes[:-1][marked], nodes[1:][marked], process.nonsmooth)
        before, nodes = nodes, np.unique(np.append(nodes, cut))
        if nodes.size < before.size + cut.size:
            break
    return solution


def solve_on_mesh(
    process: Process,
    nodes: Array,
    degree: int,
    *,
    tol: float = np.inf,
    null_vectors: NullVectors | None = None,
) -> StationarySolution:
    """Return the stationary density by elements of ``degree`` between ascending ``nodes``, with a
    certificate for the L1 tolerance ``tol``. For ``null_vectors`` see ``solve_elements``. Raises as
    ``probe_process`` does."""
    elements = solve_elements(process, nodes, degree, null_vectors)
    return _join_and_judge(process, probe_process(process), nodes, elements, degree, tol)[0]


def _join_and_judge(
    process: Process, probe: Probe, nodes: Array, e: Elements, degree: int, tol: float
) -> tuple[StationarySolution, Flags]:
    """Return the density of the elements ``e``, scaled to match at the nodes, and which to cut.

    They have the ``degree`` and lie between ``nodes``; ``tol`` is the L1 tolerance; ``probe``
    bounds the tail. The flags (elements,) mark the elements to cut in two.
    """
    series = e.u, e.enriched
    signed, log_scale, share = zip(*(_match_at_nodes(u, e.log_factor) for u in series), strict=True)
    p, better = share[0][:, None] * e.values, share[1][:, None] * e.enriched_values
    distance = float((e.weights * np.abs(p - better)).sum())
    # The mass of the enriched solution has a different quadrature error, so that both solutions
    # differ by a factor. Their distance may then vanish where p is wrong: the factor is an error.
    enriched_mass = float((e.weights * better).sum())
    size = np.abs(share[0])
    least, most, residual = float(p.min()), float(p.max()), float(e.residual.max())
    net_flux = float((size * e.net_flux).max() / (size * e.one_way).max())
    tail = probe.tail_bound(float(e.x[-1, -1]), abs(float(p[-1, -1])))
    # Relative errors of s and b are relative errors of d ln p/dH. Over the bulk of the mass ln p
    # falls by about 1, so that they are errors of ln p, too; each element is weighted by its mass.
    coefficient_error = 2.0 * float(size @ e.coefficient_error)
    # An error of ln p over one element moves mass from one side to the other, at most twice the
    # mass of the smaller side, the element included in both.
    below = np.cumsum(size)
    sides = np.minimum(below, np.maximum(1.0 - below, 0.0) + size)
    estimate = LINE_FACTOR * distance + 2.0 * tail + coefficient_error
    estimate += 2.0 * float(e.slope_error @ sides)
    estimate += 2.0 * EPS * (size.size + degree**2)  # round-off of sums over elements and functions
    measured = Measured(
        l1_error=estimate,
        mass_defect=abs(float((e.weights * p).sum()) - 1.0),
        minimum=least / most,
        residual=residual,
        tail_mass=tail,
        net_flux=net_flux,
    )
    if not residual < 0.1 * ROUND_OFF:  # elimination in an element leaves a few hundred EPS
        measured = measured.with_failures(f"the algebraic residual is {residual:.2g}")
    log_enriched_mass = math.log(max(abs(enriched_mass), SMALLEST))
    solution = StationarySolution(
        process=process,
        degree=degree,
        answer=Piecewise(nodes, signed[0], log_scale[0]),
        enriched=Piecewise(nodes, signed[1], log_scale[1] - log_enriched_mass),
        common_error=coefficient_error + 2 * abs(enriched_mass - 1.0) + float(e.slope_error.sum()),
        measured=measured,
        certificate=certify(measured, tol=tol),
    )
    # The other half of the tolerance is for the tail, the coefficients and round-off.
    if LINE_FACTOR * distance <= 0.5 * tol and least >= NEGATIVE * most:
        return solution, np.zeros(size.size, dtype=bool)
    # The error that an element causes: by its shape, and by its scale relative to its neighbours,
    # which changes the mass on the smaller side.
    step = np.minimum(below, 1.0 - below)[:-1] * np.abs(np.diff(log_scale[0] - log_scale[1]))
    own = size * np.sum(e.weights * np.abs(e.values - e.enriched_values), axis=1)
    own += np.append(step, 0.0) + np.append(0.0, step)
    return solution, (p.min(axis=1) < NEGATIVE * most) | (own > 0.1 * tol / own.size)


def _match_at_nodes(u: Array, log_factor: Array) -> tuple[Array, Array, Array]:
    """Scale elements so that they match at the nodes and their total mass is 1.

    ``u`` (elements, terms) are Legendre series; ∫T u is e^``log_factor`` for each. Returned are u
    with signs, positive in the element with most mass, ln of the scales and the signed masses,
    (elements,) each. The scales are NaN if the total mass is not positive.
    """
    # P_j is (−1)^j at the left end and 1 at the right one.
    ends = np.stack([u @ (-1.0) ** np.arange(u.shape[1]), u.sum(axis=1)])
    start, end = np.log(np.maximum(np.abs(ends), SMALLEST))
    log_scale = np.append(0.0, np.cumsum(end[:-1] - start[1:]))
    turned = (ends[1, :-1] < 0.0) != (ends[0, 1:] < 0.0)
    sign = np.append(1.0, np.where(turned, -1.0, 1.0).cumprod())
    log_mass = log_scale + log_factor
    top = int(log_mass.argmax())
    sign *= sign[top]
    mass = sign * np.exp(log_mass - log_mass[top])
    total = float(mass.sum())
    log_scale -= log_mass[top] + (math.log(total) if total > 0.0 else math.nan)
    return sign[:, None] * u, log_scale, mass / total
