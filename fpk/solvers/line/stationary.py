"""Certified finite element solution of the stationary FPK equation of one energy.

A tolerance is given, not a mesh: degree and mesh adapt until the estimate of the L1 error is met.
No boundary condition is imposed at H = 0 (an entrance boundary) nor at the far end: zero flux is
natural. The equation is solved from its coefficients alone, never from the known solution.
"""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.polynomial.legendre import legvander
from scipy.ndimage import maximum_filter1d

from fpk.answer.certificate import NEGATIVE, Certificate, Measured, certify
from fpk.numeric.arrays import EPS, ROUND_OFF, SMALLEST, Array, Flags
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

SAFETY = 2.0
"""Factor on the distance to the enriched solution: at an algebraic singularity of order r of u it
keeps the share (p/(p+2))^(2r+2) of the error, at most a half for p >= 4; integrals beside a contact
energy have twice as many points there (``fpk.solvers.line.elements``)."""
POINTWISE_SAFETY = 4.0
"""Factor on that distance for the error of p at a point. Where the density of states rises by
decades over an element 2 is too little: of 779 chains of 1 to 100 masses at tolerances from 2e-2 to
2e-10 the error at a point was above twice the distance in 8, up to three times it."""
MOST_ELEMENTS = 20_000
"""Elements beyond which none is cut any more: a solution of so many takes seconds."""
HALF_WAVE = 4
"""Points at which the distance to the enriched solution is sampled, for each of its half-waves."""


@dataclass(frozen=True, eq=False)
class StationarySolution:
    """Finite element density p(H) with its error estimate and certificate.

    ``answer`` is u = p/T, ``enriched`` that of a higher degree. ``common_error`` is the relative
    error that shifts all of p alike, of the coefficients and of the mass. ``measured`` is what
    ``certificate``, and that of any density made of the solution, follows from.
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
        """The nodes, with layers where p is not smooth: between them, quadrature of p is exact."""
        return with_layers(self.nodes, self.process.nonsmooth)

    @property
    def unknowns(self) -> int:
        """Degrees of freedom of the global finite element space."""
        return self.degree * (self.nodes.size - 1) + 1

    def density(self, energy: Array) -> Array:
        """p_h at energies of any shape; 0 outside the mesh."""
        return self.answer(energy, log_factor=self._log_states(energy))

    def phase_space_density(self, energy: Array) -> Array:
        """p_h/T (up to the constant left out of ln T) at energies of any shape; 0 outside."""
        return self.answer(energy)

    def pointwise_error(self, energy: Array) -> Array:
        """Estimate of |p_h − p| at energies of any shape."""
        return self._error(energy, self._log_states(energy))

    def phase_space_error(self, energy: Array) -> Array:
        """Estimate of |p_h − p|/T at energies of any shape."""
        return self._error(energy, np.zeros(np.shape(energy)))

    def _error(self, energy: Array, factor: Array) -> Array:
        """Error of u e^``factor``: its own, and what shifts all of p alike."""
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
        """ln T at energies of any shape; beyond the last node, ln T of that node."""
        end = float(self.nodes[-1])
        x, positive = self.process.on_mesh(np.asarray(energy, dtype=float), end)
        log_T = self.process.coefficients(x.ravel()).log_density_of_states.reshape(x.shape)
        return np.where(positive | (np.asarray(energy) > end), log_T, -np.inf)

    @cached_property
    def _of_elements(self) -> tuple[Array, Array]:
        """ln of the error of u around points of each element, and its relative round-off in each.

        At equal angles θ, H ~ 1 − cos θ, the distance to the enriched solution has half-waves of
        one length; the largest of √T u within two is taken. Elimination of m unknowns leaves up to
        m^(3/2) roundings (measured) of the largest p everywhere in the element, and at a node where
        p is much less it spoils the scale of all elements on the side of less mass.
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
        # A filter of maxima drops what is no number: that is as far as can be.
        distance = np.nan_to_num(distance, nan=1.0 / SMALLEST, posinf=1.0 / SMALLEST)
        weighted = np.log(np.maximum(distance, SMALLEST)) + 0.5 * log_T
        around = maximum_filter1d(weighted, 4 * HALF_WAVE + 1, axis=1, mode="nearest")
        p = np.abs(u) * np.exp(log_T + scale)
        most = self.degree**1.5 * p.max(axis=1)
        steps, top = (most[:-1] + most[1:]) / np.maximum(p[:-1, -1], SMALLEST), int(most.argmax())
        # Added up from the most massive element outwards: farther out they grow without bound.
        below, above = np.cumsum(steps[:top][::-1])[::-1], np.cumsum(steps[top:])
        relative = self.nodes.size + np.concatenate([below, [0.0], above])
        own = math.log(POINTWISE_SAFETY) + around - 0.5 * log_T + scale
        rounding = np.log(np.maximum(2.0 * EPS * most[:, None], SMALLEST)) - log_T
        return np.logaddexp(own, rounding), 2.0 * EPS * relative


def solve_stationary(
    process: Process, *, tol: float = 1e-10, degree: int | None = None
) -> StationarySolution:
    """Return the stationary density to the L1 tolerance ``tol``, or what failed in its certificate.

    Raises ``NotCertified`` where no stationary density exists.
    """
    # u is smooth where T is not, as long as 2 F/b does not depend on H.
    smooth = not process.state_damping
    if degree is None:
        digits = round(-math.log10(tol))
        degree = min(max(digits + 4, 3), 16) if smooth else min(max(digits, 3), 12)
    probe = probe_process(process)
    nats: Array | float = ELEMENT_FALL
    if smooth:
        # The error of an element counts by its mass, and rises with the nats to this power; over 7
        # nats p still exceeds its error at the far end, so that it stays positive.
        fall = probe.log_mass.max() - probe.log_mass
        nats = SMOOTH_FALL * np.exp(np.minimum(fall / (degree + 1), math.log(1.75)))
    end, layers = probe.extent(1e-2 * tol), 0 if smooth else GRADED_LAYERS
    nodes = initial_nodes(probe, end, process.nonsmooth, nats=nats, layers=layers)
    for _ in range(40):  # 2^−40 of a length is near the round-off of its ends
        elements = solve_elements(process, nodes, degree)
        solution, marked = _join_and_judge(process, probe, nodes, elements, degree, tol)
        if not marked.any() or marked.size > MOST_ELEMENTS:
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
    """Return the finite element solution on a given mesh; ``null_vectors`` as in elements."""
    elements = solve_elements(process, nodes, degree, null_vectors)
    return _join_and_judge(process, probe_process(process), nodes, elements, degree, tol)[0]


def _join_and_judge(
    process: Process, probe: Probe, nodes: Array, e: Elements, degree: int, tol: float
) -> tuple[StationarySolution, Flags]:
    """Return the elements scaled to one density, judged, and which of them to cut in two."""
    series = e.u, e.enriched
    signed, log_scale, share = zip(*(_match_at_nodes(u, e.log_factor) for u in series), strict=True)
    p, better = share[0][:, None] * e.values, share[1][:, None] * e.enriched_values
    distance = float((e.weights * np.abs(p - better)).sum())
    # The enriched solution has the mass 1 by a rule with more, or half, of the error of this one:
    # both differ by their masses everywhere, so that their distance may vanish where p is wrong.
    enriched_mass = float((e.weights * better).sum())
    size = np.abs(share[0])
    least, most, residual = float(p.min()), float(p.max()), float(e.residual.max())
    net_flux = float((size * e.net_flux).max() / (size * e.one_way).max())
    tail = probe.tail_bound(float(e.x[-1, -1]), abs(float(p[-1, -1])))
    # Errors of s and b shift d ln p/dH by as much. Their effect on ln p is bounded by the error
    # times the fall of ln p over the bulk of the mass, about one per energy scale; the worst
    # point of each element counts by its share of the mass.
    coefficient_error = 2.0 * float(size @ e.coefficient_error)
    # They add up where they do not cancel: over one element an error of ln p moves mass from one
    # side of it to the other, at most twice the smaller of the two with the element on both sides.
    below = np.cumsum(size)
    sides = np.minimum(below, np.maximum(1.0 - below, 0.0) + size)
    estimate = SAFETY * distance + 2.0 * tail + coefficient_error
    estimate += 2.0 * float(e.slope_error @ sides)
    estimate += 2.0 * EPS * (size.size + degree**2)  # a sum over elements and functions
    measured = Measured(
        l1_error=estimate,
        mass_defect=abs(float((e.weights * p).sum()) - 1.0),
        minimum=least / most,
        residual=residual,
        tail_mass=tail,
        net_flux=net_flux,
    )
    if not residual < 0.1 * ROUND_OFF:  # elimination in one element leaves some hundred roundings
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
    # Half of the tolerance is left to the tail, the coefficients and round-off.
    if SAFETY * distance <= 0.5 * tol and least >= NEGATIVE * most:
        return solution, np.zeros(size.size, dtype=bool)
    # Its own making: its shape, and steps to neighbours, which move the lesser mass beside them.
    step = np.minimum(below, 1.0 - below)[:-1] * np.abs(np.diff(log_scale[0] - log_scale[1]))
    own = size * np.sum(e.weights * np.abs(e.values - e.enriched_values), axis=1)
    own += np.append(step, 0.0) + np.append(0.0, step)
    return solution, (p.min(axis=1) < NEGATIVE * most) | (own > 0.1 * tol / own.size)


def _match_at_nodes(u: Array, log_factor: Array) -> tuple[Array, Array, Array]:
    """Scale elements so that they match at the nodes and make a density of mass 1.

    ``u`` (elements, terms) are Legendre series of the mass 1 times e^``log_factor`` each. Returned
    are these with signs, positive where mass is most, ln of their scales, and masses with signs.
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
