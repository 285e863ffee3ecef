"""Densities of energies with their certificates; of one energy by quadrature of zero flux, (11)."""

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

POINTS = (16, 20)
"""Gauss points per panel of integrals along H, and of the finer rule that tells their error."""


@dataclass(frozen=True, eq=False)
class ZeroFluxDensity:
    """p = T u of a process of one energy from ln u, as (11) gives it; 0 beyond the nodes.

    p is smooth between ``nodes``. ``log_u`` and ``relative_error``, that of u, take energies > 0,
    densities and their errors energies of any shape. ``measured`` is what was measured on p.
    """

    process: Process
    nodes: Array
    log_u: Callable[[Array], Array]
    relative_error: Callable[[Array], Array]
    measured: Measured

    @property
    def panels(self) -> Array:
        """The nodes: between them u is smooth, and T but for layers above contact energies."""
        return self.nodes

    @property
    def l1_error(self) -> float:
        """Estimate of ∫|p_h − p|."""
        return self.measured.l1_error

    def log_density(self, energy: Array) -> Array:
        """ln p, −∞ outside the nodes."""
        safe, positive = self._on_mesh(energy)
        log_states = self.process.coefficients(safe.ravel()).log_density_of_states
        return np.where(positive, self.log_u(safe) + log_states.reshape(safe.shape), -np.inf)

    def density(self, energy: Array) -> Array:
        """Density p at the energies; 0 outside the nodes."""
        return np.asarray(np.exp(self.log_density(energy)))

    def pointwise_error(self, energy: Array) -> Array:
        """Estimate of the error of p, but for that of T."""
        return self.relative_error(self._on_mesh(energy)[0]) * self.density(energy)

    def phase_space_density(self, energy: Array) -> Array:
        """u = p/T, T as the process gives it."""
        safe = self._on_mesh(energy)[0]
        return np.where(np.asarray(energy) <= self.nodes[-1], np.exp(self.log_u(safe)), 0.0)

    def phase_space_error(self, energy: Array) -> Array:
        """Estimate of the error of u."""
        return self.relative_error(self._on_mesh(energy)[0]) * self.phase_space_density(energy)

    def _on_mesh(self, energy: Array) -> tuple[Array, Flags]:
        return self.process.on_mesh(np.asarray(energy, dtype=float), float(self.nodes[-1]))


def flux_residual(process: Process, nodes: Array, log_density: Callable[[Array], Array]) -> float:
    """Return how far ln p is from zero flux, d ln(σ² p) = 2s/σ² dH, on the panels of ``nodes``.

    The largest |Δ ln(σ² p) − ∫2s/σ² dH| of a panel beyond what stated errors of s, σ² and the
    integral explain, relative to ∫2(|s_damping| + |s_noise|)/σ² dH; n/H in closed form.
    """
    inner, n, integrals = nodes[nodes > 0.0], process.degrees_of_freedom, []
    for points in POINTS:
        x, w = panel_rule(inner, points)
        c = Coefficients(*(a.reshape(x.shape) for a in process.coefficients(x.ravel())))
        integrals.append(np.sum(w * (2.0 * c.drift / c.diffusion - n / x), axis=1))
    parts = 2.0 * (np.abs(c.dissipation) + np.abs(c.drift - c.dissipation)) / c.diffusion
    at_nodes = process.coefficients(inner)
    log_flux = np.log(at_nodes.diffusion) + log_density(inner)
    defect = np.abs(np.diff(log_flux - n * np.log(inner)) - integrals[1])
    allowed = np.abs(integrals[1] - integrals[0]) + np.sum(w * log_density_slope_error(c), axis=1)
    # A logarithm of p or of σ² has the round-off of some dozens of operations.
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
    """Return the density of one or two energies that ``solution`` gives, with its certificate.

    ``relative_error`` returns at energies the relative error of p by that of the density of states
    or of the modes, which the solver does not know of; ``added`` says that it counts in L1, too.
    """

    def of_model(p: Array, *energies: Array) -> Array:
        return np.asarray(relative_error(*energies) * np.abs(p))

    def pointwise(*energies: Array) -> Array:
        p = solution.density(*energies)
        # Beyond the last energy, where p is 0, the error is what was dropped: less than at the end.
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


def solved_energies(
    process: Process, solver: str, *, tol: float
) -> StationarySolution | ZeroFluxDensity | PlaneSolution:
    """Return the stationary density of one or two energies to the L1 tolerance ``tol``.

    ``solver`` is "fem", "scikit-fem", or of one energy "quadrature".
    """
    if solver == "scikit-fem":
        from fpk.solvers.operator import solve_by_scikit_fem  # noqa: PLC0415  (scikit-fem takes 0.2 s)

        return solve_by_scikit_fem(process, tol=tol)
    if solver == "quadrature":
        return solve_by_quadrature(process, tol=tol)
    return (solve_stationary if process.dimension == 1 else solve_plane)(process, tol=tol)


def solve_by_quadrature(process: Process, *, tol: float = 1e-10) -> ZeroFluxDensity:
    """Return p(H) = C/σ² exp(+∫2s/σ² dH), Eq. (11) with its sign corrected.

    The integral of (11) diverges at H = 0 as that of n/H, which is integrated in closed form, the
    rest panel by panel, each halved until its Legendre coefficients decay below ``tol``.
    """
    probe, n = probe_process(process), process.degrees_of_freedom
    nodes = initial_nodes(probe, probe.extent(1e-2 * tol), process.nonsmooth)

    def rate_and_error(energy: Array) -> Array:
        """2s/σ² − n/H and a bound of its error by those of the coefficients."""
        c = process.coefficients(energy)
        rate = 2.0 * c.drift / c.diffusion - n / energy
        return np.stack([rate, log_density_slope_error(c)], axis=-1)

    def errors(lengths: Array, coefficients: Array) -> tuple[Array, Array]:
        """Errors of the integral over each panel, of a truncated series and of coefficients."""
        truncated = lengths * np.sum(np.abs(coefficients[:, -2:, 0]), axis=1)
        return truncated, lengths * coefficients[:, 0, 1]

    def unresolved(lengths: Array, coefficients: Array) -> Array:
        truncated, known = errors(lengths, coefficients)
        # What the coefficients do not know, no panel can resolve.
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

    x, w = panel_rule(nodes, POINTS[0])
    smooth.coefficients[:, 0] -= logsumexp(log_p(x), b=w)
    x, w = panel_rule(nodes, POINTS[1])
    p = np.exp(log_p(x))
    tail_mass = probe.tail_bound(float(nodes[-1]), float(np.exp(log_p(nodes[-1:])[0])))
    # An error of the exponent over one panel shifts the mass on one side of it against the other.
    share = np.sum(w * p, axis=1)
    below, defect = np.cumsum(share), abs(float(share.sum()) - 1.0)
    moved = np.minimum(below, 1.0 - below + share)
    # Close to a contact energy T may be worse by far, where there is next to no mass.
    states = 2.0 * process.coefficients(x.ravel()).relative_error.reshape(x.shape)
    l1_error = float(np.sum(w * p * states)) + defect + 2.0 * tail_mass + 4.0 * EPS * lengths.size
    steps = np.sum(errors(lengths, rate.coefficients), axis=0)
    if process.state_damping:
        # The exponent is a running sum over all panels, whose round-off is relative to its size.
        l1_error += EPS * float(np.ptp(smooth.coefficients[:, 0]))
    l1_error += 2.0 * float(steps @ moved)
    # In ln p the errors add up from the median outwards.
    total, middle = np.cumsum(steps), int(np.searchsorted(below, 0.5))
    outwards = np.abs(total - total[min(middle, lengths.size - 1)]) + steps + states.max(axis=1)

    def relative_error(energy: Array) -> Array:
        panel = np.clip(np.searchsorted(nodes, energy, side="right") - 1, 0, nodes.size - 2)
        # ln p is formed with ln H and ln b, which cancel.
        return np.asarray(l1_error + outwards[panel] + 4.0 * EPS * np.abs(np.log(energy)))

    residual = flux_residual(process, nodes, log_p)
    measured = Measured(l1_error, defect, float(p.min() / p.max()), residual, tail_mass)
    log_u = partial(log_p, over_states=True)
    return ZeroFluxDensity(process, nodes, log_u, relative_error, measured)
