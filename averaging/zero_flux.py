"""Stationary densities of energies and their certificates; one energy by quadrature, Eq. (11)."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy.special import logsumexp

from fpk.answer.certificate import Measured
from fpk.answer.density import Density, certify_density
from fpk.answer.names import Observable
from fpk.numeric.arrays import EPS, ROUNDINGS, Array, Flags
from fpk.numeric.piecewise import fit
from fpk.numeric.quadrature import panel_rule
from fpk.solvers.line.mesh import initial_nodes, probe_process, split_points
from fpk.solvers.line.stationary import StationarySolution, solve_stationary
from fpk.solvers.plane.solution import PlaneSolution
from fpk.solvers.plane.stationary import solve_plane
from fpk.system.process import Coefficients, Process, log_density_slope_error

ENERGY_RULES = (16, 20)
"""Gauss points per panel of integrals and tables along the energy: of the comparison and of the
answer. The difference of the two is the stated error."""


@dataclass(frozen=True, eq=False)
class ZeroFluxDensity:
    """Density p = T u of one energy given by ln u, Eq. (11).

    p is smooth between ``nodes``; it is 0 below 0 and above the last node, but not between 0 and
    the first node. ``log_u`` and ``relative_error`` (of u) map energies > 0 of any shape to arrays
    of that shape; ``measured`` holds the errors and checks of p.
    """

    process: Process
    nodes: Array
    log_u: Callable[[Array], Array]
    relative_error: Callable[[Array], Array]
    measured: Measured

    @property
    def panels(self) -> Array:
        """The nodes: between them u is smooth; T is, except in layers above contact energies."""
        return self.nodes

    @property
    def l1_error(self) -> float:
        """Estimate of ∫|p_h − p|."""
        return self.measured.l1_error

    def log_density(self, energy: Array) -> Array:
        """Return ln p at ``energy`` of any shape, −∞ below 0 and above the last node."""
        safe, positive = self._on_mesh(energy)
        log_states = self.process.coefficients(safe.ravel()).log_density_of_states
        return np.where(positive, self.log_u(safe) + log_states.reshape(safe.shape), -np.inf)

    def density(self, energy: Array) -> Array:
        """Return p at ``energy`` of any shape, 0 below 0 and above the last node."""
        return np.asarray(np.exp(self.log_density(energy)))

    def pointwise_error(self, energy: Array) -> Array:
        """Return an estimate of |p − p_exact| at ``energy``, the error of T excluded."""
        return self.relative_error(self._on_mesh(energy)[0]) * self.density(energy)

    def phase_space_density(self, energy: Array) -> Array:
        """Return u = p/T at ``energy`` of any shape, T as in the process; 0 above the last node."""
        safe = self._on_mesh(energy)[0]
        return np.where(np.asarray(energy) <= self.nodes[-1], np.exp(self.log_u(safe)), 0.0)

    def phase_space_error(self, energy: Array) -> Array:
        """Return an estimate of |u − u_exact| at ``energy`` of any shape, 0 above the last node."""
        return self.relative_error(self._on_mesh(energy)[0]) * self.phase_space_density(energy)

    def _on_mesh(self, energy: Array) -> tuple[Array, Flags]:
        return self.process.on_mesh(np.asarray(energy, dtype=float), float(self.nodes[-1]))


def flux_residual(process: Process, nodes: Array, log_density: Callable[[Array], Array]) -> float:
    """Return the relative residual of zero flux, d ln(σ² p) = 2s/σ² dH, between ``nodes``.

    ``log_density`` is ln p. The residual is the largest excess of |Δ ln(σ² p) − ∫2s/σ² dH| of a
    panel over the stated errors of s, σ², p and the integral, relative to
    ∫2(|s_damping| + |s_noise|)/σ² dH. The part n/H of 2s/σ² is integrated in closed form.
    """
    inner, n, integrals = nodes[nodes > 0.0], process.degrees_of_freedom, []
    for points in ENERGY_RULES:
        x, w = panel_rule(inner, points)
        c = Coefficients(*(a.reshape(x.shape) for a in process.coefficients(x.ravel())))
        integrals.append(np.sum(w * (2.0 * c.drift / c.diffusion - n / x), axis=1))
    parts = 2.0 * (np.abs(c.dissipation) + np.abs(c.drift - c.dissipation)) / c.diffusion
    at_nodes = process.coefficients(inner)
    log_flux = np.log(at_nodes.diffusion) + log_density(inner)
    defect = np.abs(np.diff(log_flux - n * np.log(inner)) - integrals[1])
    allowed = np.abs(integrals[1] - integrals[0]) + np.sum(w * log_density_slope_error(c), axis=1)
    # Errors of ln p and ln σ² at both ends of a panel: stated error and round-off.
    ends = 2.0 * (at_nodes.relative_error + ROUNDINGS * EPS * (1.0 + np.abs(log_flux)))
    allowed += ends[1:] + ends[:-1]
    return float(np.max(np.maximum(defect - allowed, 0.0) / np.sum(w * parts, axis=1)))


def density_of_energies(
    observable: Observable,
    solution: StationarySolution | ZeroFluxDensity | PlaneSolution,
    panels: tuple[Array, ...],
    relative_error: Callable[..., Array],
    *,
    tol: float,
    added: bool,
) -> Density:
    """Return the density of one or two energies of ``solution`` with its certificate.

    ``tol`` is the L1 tolerance, ``panels`` are the panel nodes of each energy. ``relative_error``
    maps energies to the relative error of p from the density of states or the modes, which the
    solver does not include; if ``added``, this error is added to the L1 error, too.
    """

    def of_model(p: Array, *energies: Array) -> Array:
        return np.asarray(relative_error(*energies) * np.abs(p))

    def pointwise(*energies: Array) -> Array:
        p = solution.density(*energies)
        # Beyond the last energy p is given as 0; its error there is less than p at the end.
        within = [np.minimum(H, x[-1]) for H, x in zip(energies, panels, strict=True)]
        dropped = np.abs(solution.density(*within) - p)
        error = np.abs(solution.pointwise_error(*energies)) + of_model(p, *energies) + dropped
        return np.where(np.min(np.broadcast_arrays(*energies), axis=0) >= 0.0, error, 0.0)

    return certify_density(
        observable,
        panels,
        solution.density,
        pointwise,
        measured=solution.measured,
        tol=tol,
        added_error=of_model if added else None,
    )


def solve_energies(
    process: Process, solver: str, *, tol: float
) -> StationarySolution | ZeroFluxDensity | PlaneSolution:
    """Return the stationary density of the energy or the two energies of ``process``.

    ``solver`` is "fem", "scikit-fem", or for one energy "quadrature"; ``tol`` is the L1 tolerance.
    By quadrature it is a ``ZeroFluxDensity``, for two energies a ``PlaneSolution``. Raises
    ``NotCertified`` if there is no stationary density.
    """
    if solver == "scikit-fem":
        from fpk.solvers.operator import solve_by_scikit_fem  # noqa: PLC0415  (scikit-fem takes 0.2 s)

        return solve_by_scikit_fem(process, tol=tol)
    if solver == "quadrature":
        return solve_by_quadrature(process, tol=tol)
    return (solve_stationary if process.dimension == 1 else solve_plane)(process, tol=tol)


def solve_by_quadrature(process: Process, *, tol: float = 1e-10) -> ZeroFluxDensity:
    """Return p(H) = C/σ² exp(+∫2s/σ² dH), Eq. (11) with its sign corrected.

    The integrand of (11) is n/H near H = 0. This part is integrated in closed form, the rest on
    panels that are halved until the last Legendre coefficients fall below a share of the L1
    tolerance ``tol``. Raises ``NotCertified`` if p does not fall off at high energy.
    """
    probe, n = probe_process(process), process.degrees_of_freedom
    nodes = initial_nodes(probe, probe.extent(1e-2 * tol), process.nonsmooth)

    def rate_and_error(energy: Array) -> Array:
        """Return 2s/σ² − n/H at ``energy`` and its error by errors of s and σ², (points, 2)."""
        c = process.coefficients(energy)
        rate = 2.0 * c.drift / c.diffusion - n / energy
        return np.stack([rate, log_density_slope_error(c)], axis=-1)

    def errors(lengths: Array, coefficients: Array) -> tuple[Array, Array]:
        """Return two absolute errors (panels,) of the integral of 2s/σ² − n/H over each panel.

        Panels have ``lengths`` (panels,). The first error is due to truncating the series
        ``coefficients``, the second to s and σ².
        """
        truncated = lengths * np.sum(np.abs(coefficients[:, -2:, 0]), axis=1)
        return truncated, lengths * coefficients[:, 0, 1]

    def unresolved(lengths: Array, coefficients: Array) -> Array:
        truncated, known = errors(lengths, coefficients)
        # Errors of s and σ² cannot be lowered by halving a panel.
        return np.where(truncated > known, truncated, 0.0)

    rate = fit(
        rate_and_error,
        nodes,
        0.1 * tol / nodes.size,
        cut=lambda left, right: split_points(left, right, process.nonsmooth),
        estimate=unresolved,
    )
    nodes, lengths = rate.nodes, np.diff(rate.nodes)
    smooth = replace(rate, coefficients=rate.coefficients[..., 0], error=None).antiderivative()

    def log_p(energy: Array, *, over_states: bool = False) -> Array:
        c = process.coefficients(energy.ravel())
        states = c.log_density_of_states if over_states else 0.0
        known = np.asarray(np.log(c.diffusion) + states).reshape(energy.shape)
        return np.asarray(smooth(energy) + n * np.log(energy) - known)

    x, w = panel_rule(nodes, ENERGY_RULES[0])
    smooth.coefficients[:, 0] -= logsumexp(log_p(x), b=w)
    x, w = panel_rule(nodes, ENERGY_RULES[1])
    p = np.exp(log_p(x))
    tail_mass = probe.tail_bound(float(nodes[-1]), float(np.exp(log_p(nodes[-1:])[0])))
    # An error of the exponent over one panel changes the mass below it relative to that above.
    share = np.sum(w * p, axis=1)
    below, defect = np.cumsum(share), abs(float(share.sum()) - 1.0)
    moved = np.minimum(below, 1.0 - below + share)
    # Next to a contact energy the error of T may be much larger, where there is little mass.
    states = 2.0 * process.coefficients(x.ravel()).relative_error.reshape(x.shape)
    l1_error = float(np.sum(w * p * states)) + defect + 2.0 * tail_mass + 4.0 * EPS * lengths.size
    steps = np.sum(errors(lengths, rate.coefficients), axis=0)
    if process.state_damping:
        # The exponent is a sum over all panels, whose round-off is relative to its range.
        l1_error += EPS * float(np.ptp(smooth.coefficients[:, 0]))
    l1_error += 2.0 * float(steps @ moved)
    # In ln p the errors accumulate from the median outwards.
    total, middle = np.cumsum(steps), int(np.searchsorted(below, 0.5))
    outwards = np.abs(total - total[min(middle, lengths.size - 1)]) + steps + states.max(axis=1)

    def relative_error(energy: Array) -> Array:
        panel = np.clip(np.searchsorted(nodes, energy, side="right") - 1, 0, nodes.size - 2)
        # Round-off: ln p contains ln H and ln σ², which cancel.
        return np.asarray(l1_error + outwards[panel] + 4.0 * EPS * np.abs(np.log(energy)))

    residual = flux_residual(process, nodes, log_p)
    measured = Measured(l1_error, defect, float(p.min() / p.max()), residual, tail_mass)
    log_u = partial(log_p, over_states=True)
    return ZeroFluxDensity(process, nodes, log_u, relative_error, measured)
