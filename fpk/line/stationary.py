"""Certified finite element solution of the stationary FPK equation of one energy.

A tolerance is given, not a mesh: degree and mesh adapt until the estimate of the L1 error is met.
No boundary condition is imposed at H = 0 (an entrance boundary) nor at the far end: zero flux is
natural. The equation is solved from its coefficients alone, never from the known solution.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fpk.certificate import NEGATIVE, Certificate, Measured, certify
from fpk.errors import NotCertified
from fpk.line.assembly import SolvedElements, merged, solve_elements
from fpk.line.chain import Assembled, Checks, assembled, checks
from fpk.line.elements import Form, in_legendre
from fpk.line.mesh import (
    DEEP_LAYERS,
    GRADED_LAYERS,
    NATS_PER_ELEMENT,
    initial_nodes,
    nats_for,
    split_points,
    with_layers,
)
from fpk.line.rules import ENRICHMENT
from fpk.piecewise import Piecewise
from fpk.probe import Probe, probed
from fpk.process import Process, log_density_slope_error
from fpk.quadrature import panel_rule

Array = NDArray[np.float64]

SAFETY = 2.0
"""Factor on the distance to the comparison solution: at an algebraic singularity of order r of u it
keeps the share (p/(p+2))^(2r+2) of the error, at most a half for p >= 4; integrals beside a contact
energy have twice as many points there (``fpk.line.rules``)."""
MOST_ROUNDS = 40
MOST_ELEMENTS = 20_000
ROUND_OFF = 4e-16
ACCUMULATION_POINTS = 6
"""Gauss points an element at which the errors of the coefficients are summed: they are estimates.
"""
RESIDUAL = 1e-13
"""Largest algebraic residual that elimination in one element leaves, relative to the terms that
cancel in it: some hundred roundings, stricter than what a certificate asks of any answer."""


@dataclass(frozen=True, eq=False)
class StationarySolution:
    """Finite element density p(H) with its error estimate and certificate.

    ``answer`` is u, with p = u or p = T u by ``form``, and ``enriched`` that of a higher degree,
    there for the pointwise error. ``measured`` is what ``certificate`` was made of, to the
    tolerance asked for: densities made of the solution are certified from it.
    """

    process: Process
    form: Form
    degree: int
    answer: Piecewise
    enriched: Piecewise
    coefficient_error: float
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

    def phase_space_density(self, energy: Array) -> Array:
        """p_h/T (up to the constant left out of ln T) at energies of any shape; 0 outside."""
        return self.answer(energy, log_factor=self._log_factor(energy, of_p=False))

    def phase_space_error(self, energy: Array) -> Array:
        """Estimate of |p_h − p|/T at energies of any shape."""
        return self._error(energy, self._log_factor(energy, of_p=False))

    def density(self, energy: Array) -> Array:
        """p_h at energies of any shape; 0 outside the mesh."""
        return self.answer(energy, log_factor=self._log_factor(energy, of_p=True))

    def pointwise_error(self, energy: Array) -> Array:
        """Estimate of |p_h − p| at energies of any shape."""
        return self._error(energy, self._log_factor(energy, of_p=True))

    def _error(self, energy: Array, log_factor: Array) -> Array:
        """Error of u: distance to the enriched solution and what shifts all of p alike.

        The distance has about as many zeros in an element as its degree, and the error need not
        vanish there: the largest distance within half the way to the next one is taken.
        """
        x = np.asarray(energy, dtype=float)
        u = self.answer(x, log_factor=log_factor)
        k = np.clip(np.searchsorted(self.nodes, x, side="right") - 1, 0, self.nodes.size - 2)
        left, right = self.nodes[k], self.nodes[k + 1]
        half = 0.5 * (right - left) / (self.degree + ENRICHMENT)
        around = [x, np.clip(x - half, left, right), np.clip(x + half, left, right)]
        distance = np.max([np.abs(self._distance(y, log_factor)) for y in around], axis=0)
        floor = self.coefficient_error + self.measured.tail_mass + ROUND_OFF * self.nodes.size
        return np.asarray(SAFETY * distance + floor * np.abs(u))

    def _distance(self, energy: Array, log_factor: Array) -> Array:
        u = self.answer(energy, log_factor=log_factor)
        return np.asarray(u - self.enriched(energy, log_factor=log_factor))

    def _log_factor(self, energy: Array, *, of_p: bool) -> Array:
        """ln of what makes p, or else p/T, of u."""
        energy = np.asarray(energy, dtype=float)
        if of_p == (self.form == "drift-diffusion"):
            return np.zeros(energy.shape)
        safe = np.clip(energy, np.finfo(float).tiny, self.nodes[-1])
        log_states = self.process.coefficients(safe.ravel()).log_density_of_states
        return np.asarray((log_states if of_p else -log_states).reshape(energy.shape))


def solve_stationary(
    process: Process, *, tol: float = 1e-10, form: Form = "flux", degree: int | None = None
) -> StationarySolution:
    """Return the stationary density to the L1 tolerance ``tol``, adapting the mesh.

    The degree follows from ``tol`` unless given. The answer is certified or says what failed.
    Raises ``NotCertified`` where no stationary density exists.
    """
    # In the flux form u is smooth where T is not, as long as 2 F/b does not depend on H.
    smooth = form == "flux" and not process.state_damping
    if degree is None:
        degree = int(np.clip(round(-np.log10(tol)) + (4 if smooth else 0), 3, 16 if smooth else 12))
    probe = probed(process)
    if not np.all(np.isfinite(probe.log_mass)):
        raise NotCertified(
            "the coefficients leave the range of double precision: choose other units"
        )
    end = probe.extent(1e-2 * tol)
    nats = nats_for(probe, degree, tol) if smooth else NATS_PER_ELEMENT
    layers = 0 if smooth else DEEP_LAYERS if form == "drift-diffusion" else GRADED_LAYERS
    nodes = initial_nodes(probe, end, process.nonsmooth, nats=nats, layers=layers)
    elements = solve_elements(process, nodes[:-1], nodes[1:], degree, form)
    special = np.array([0.0, *process.nonsmooth])
    for _ in range(MOST_ROUNDS):
        whole = Assembled(*assembled(elements.solved))
        sums = Checks(*checks(elements.solved, whole, elements.coefficient_error))
        # Half of the tolerance is left to the tail, the coefficients and round-off.
        if SAFETY * sums.distance <= 0.5 * tol and sums.least >= NEGATIVE * sums.most:
            break
        negative = whole.p.min(axis=1) < NEGATIVE * sums.most
        marked = negative | (whole.indicator > 0.1 * tol / whole.indicator.size)
        left, right = elements.left[marked], elements.right[marked]
        cut = split_points(left, right, special)
        if (
            not marked.any()
            or marked.size > MOST_ELEMENTS
            or np.any((cut <= left) | (cut >= right))
        ):
            break
        new = solve_elements(
            process, np.concatenate([left, cut]), np.concatenate([cut, right]), degree, form
        )
        elements = merged(elements, new, ~marked)
    return _certified(process, probe, elements, whole, sums, degree, form, tol)


def solve_on_mesh(
    process: Process, nodes: Array, degree: int, *, form: Form = "flux"
) -> StationarySolution:
    """Return the finite element solution on a given mesh, for convergence studies."""
    elements = solve_elements(process, nodes[:-1], nodes[1:], degree, form)
    whole = Assembled(*assembled(elements.solved))
    sums = Checks(*checks(elements.solved, whole, elements.coefficient_error))
    return _certified(process, probed(process), elements, whole, sums, degree, form, np.inf)


def _certified(
    process: Process,
    probe: Probe,
    elements: SolvedElements,
    whole: Assembled,
    sums: Checks,
    degree: int,
    form: Form,
    tol: float,
) -> StationarySolution:
    """Bound the tail, estimate the error and check what must hold of the assembled solution."""
    nodes = np.append(elements.left, elements.right[-1])
    end_value = abs(float(whole.u[-1, 1])) * math.exp(whole.log_scale[-1])
    if form == "flux":
        end_value *= math.exp(elements.log_states[-1])
    tail = probe.tail_bound(float(nodes[-1]), end_value)
    # Errors of s and b shift d ln p/dH by as much. Their effect on ln p is bounded by the error
    # times the fall of ln p over the bulk of the mass, about one per energy scale; the worst
    # point of each element counts by its share of the mass.
    coefficient_error = 2.0 * sums.coefficient_error
    moved, accumulated = 0.0, 0.0
    if process.state_damping:
        moved, accumulated = _accumulated_error(process, nodes, np.abs(whole.share))
    estimate = SAFETY * sums.distance + 2.0 * tail + coefficient_error + moved
    estimate += ROUND_OFF * (nodes.size - 1 + degree**2)
    measured = Measured(
        l1_error=estimate,
        mass_defect=abs(sums.mass - 1.0),
        minimum=sums.least / sums.most,
        residual=sums.residual,
        tail_mass=tail,
        net_flux=sums.net_flux,
    )
    if not sums.residual < RESIDUAL:
        measured = measured.with_failures(f"the algebraic residual is {sums.residual:.2g}")
    return StationarySolution(
        process=process,
        form=form,
        degree=degree,
        answer=Piecewise(nodes, whole.u @ in_legendre(degree), whole.log_scale),
        enriched=Piecewise(
            nodes, whole.enriched @ in_legendre(degree + ENRICHMENT), whole.enriched_log_scale
        ),
        coefficient_error=coefficient_error + accumulated,
        measured=measured,
        certificate=certify(measured, tol=tol),
    )


def _accumulated_error(process: Process, nodes: Array, share: Array) -> tuple[float, float]:
    """L1 effect of the errors of 2s/b where they do not cancel, and their sum, a bound in ln p.

    An error of ln p over one element moves mass from one side of it to the other: at the most
    twice the smaller of the two, the element counted on both sides.
    """
    x, w = panel_rule(nodes, ACCUMULATION_POINTS)
    c = process.coefficients(x.ravel())
    steps = np.sum(w * log_density_slope_error(c).reshape(x.shape), axis=1)
    below = np.cumsum(share)
    moved = 2.0 * np.minimum(below, np.maximum(1.0 - below, 0.0) + share)
    return float(steps @ moved), float(steps.sum())
