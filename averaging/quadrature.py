"""The stationary density (11) of the averaged energy process, by quadrature of its exponent."""

from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from averaging.zero_flux import flux_residual
from fpk.certificate import Measured
from fpk.line.mesh import initial_nodes, split_points
from fpk.piecewise import Piecewise, fit
from fpk.probe import probed
from fpk.process import Process, log_density_slope_error
from fpk.quadrature import panel_rule

Array = NDArray[np.float64]

POINTS = 16
"""Gauss points per panel: the exponent is expanded in Legendre polynomials of degree 15."""
MOST_ROUNDS = 30
"""Cuts of a panel: towards H = 0 and contact energies each leaves 0.15 of it."""
NARROW = 1e-13
"""Length of a panel, relative to the last energy, below which it is not cut: what is left of a
singularity there is part of the stated error."""
ROUND_OFF = 1e-15
"""Relative error of p that a panel adds by its round-off."""
EPS = float(np.finfo(float).eps)


@dataclass(frozen=True, eq=False)
class QuadratureSolution:
    """ln p of Eq. (11) as a piecewise polynomial, p = exp(ln p) on the panels between ``nodes``.

    ``smooth`` is ∫(2s/σ² − n/H) dH with the normalisation in it; ``relative_error`` (panels,) is
    that of p on each panel, which adds up from where the mass is; ``measured`` is what was measured
    on p.
    """

    process: Process
    smooth: Piecewise
    relative_error: Array
    measured: Measured

    @property
    def nodes(self) -> Array:
        """Energies between which p is smooth, (panels + 1,)."""
        return self.smooth.nodes

    @property
    def panels(self) -> Array:
        """Energies between which a Gauss rule integrates p to round-off, (panels + 1,)."""
        return self.smooth.nodes

    @property
    def l1_error(self) -> float:
        """Estimate of ∫|p_h − p|."""
        return self.measured.l1_error

    def log_density(self, energy: Array) -> Array:
        """ln p at energies > 0 of any shape, −∞ outside the panels."""
        return _log_density(self.process, self.smooth, np.asarray(energy, dtype=float))

    def phase_space_density(self, energy: Array) -> Array:
        """p/T (up to the constant left out of ln T) at energies of any shape; 0 outside."""
        flat = np.maximum(np.asarray(energy, dtype=float), np.finfo(float).tiny).ravel()
        log_t = self.process.coefficients(flat).log_density_of_states.reshape(np.shape(energy))
        return np.asarray(np.exp(self.log_density(energy) - log_t))

    def phase_space_error(self, energy: Array) -> Array:
        """Estimate of the error of p/T at energies of any shape."""
        return self.log_error(energy) * self.phase_space_density(energy)

    def log_error(self, energy: Array) -> Array:
        """Error of ln p at energies of any shape, constant on each panel."""
        panel = np.searchsorted(self.nodes, np.asarray(energy, dtype=float), side="right") - 1
        return np.asarray(self.relative_error[np.clip(panel, 0, self.nodes.size - 2)])

    def density(self, energy: Array) -> Array:
        """p at energies of any shape."""
        return np.asarray(np.exp(self.log_density(energy)))

    def pointwise_error(self, energy: Array) -> Array:
        """Estimate of the error of p at energies of any shape."""
        # ln p is formed with ln H and ln b, which cancel.
        logarithm = np.abs(np.log(np.maximum(energy, np.finfo(float).tiny)))
        relative = self.l1_error + self.log_error(energy) + 4.0 * EPS * logarithm
        return np.asarray(relative * self.density(energy))


def solve_by_quadrature(process: Process, *, tol: float = 1e-10) -> QuadratureSolution:
    """Return p(H) = C/σ² exp(+∫2s/σ² dH), Eq. (11) with its sign corrected.

    The integrand is n/H at H → 0, so the integral of (11) from 0 diverges; n/H is integrated in
    closed form and the rest panel by panel, each halved until its Legendre coefficients decay
    below ``tol``.
    """
    probe = probed(process)
    nodes = initial_nodes(probe, probe.extent(1e-2 * tol), process.nonsmooth)
    rate, truncation, slope_errors = _expanded_rate(process, nodes, 0.1 * tol)
    smooth = _normalised(process, rate.antiderivative())
    nodes, lengths = smooth.nodes, np.diff(smooth.nodes)
    x, w = panel_rule(nodes, POINTS + 4)
    p = np.exp(_log_density(process, smooth, x))
    last = float(np.exp(_log_density(process, smooth, nodes[-1:])[0]))
    tail_mass = probe.tail_bound(float(nodes[-1]), last)
    # An error of the exponent over one panel shifts the mass on one side of it against the other.
    share = np.sum(w * p, axis=1)
    below = np.cumsum(share)
    moved = np.minimum(below, 1.0 - below + share)
    defect = abs(float(share.sum()) - 1.0)
    states = float(process.coefficients(x.ravel()).relative_error.max())
    l1_error = 2.0 * states + defect + 2.0 * tail_mass + ROUND_OFF * lengths.size
    steps = truncation
    if process.state_damping:
        # The exponent is a running sum over all panels, whose round-off is relative to its size.
        l1_error += EPS * float(np.ptp(smooth.coefficients[:, 0]))
        steps = truncation + slope_errors
    l1_error += 2.0 * float(steps @ moved)
    # In ln p the errors add up from the median outwards.
    total, middle = np.cumsum(steps), int(np.searchsorted(below, 0.5))
    outwards = np.abs(total - total[min(middle, lengths.size - 1)]) + steps
    measured = Measured(
        l1_error=l1_error,
        mass_defect=defect,
        minimum=float(p.min() / p.max()),
        residual=flux_residual(process, nodes, partial(_log_density, process, smooth)),
        tail_mass=tail_mass,
    )
    return QuadratureSolution(process, smooth, l1_error + outwards, measured)


def _expanded_rate(process: Process, nodes: Array, tol: float) -> tuple[Piecewise, Array, Array]:
    """Return 2s/σ² − n/H on panels, and the errors of its integral over each of them, (panels,).

    First that of truncating its series, then that of the coefficients: what these do not know, no
    panel can resolve.
    """
    special = np.array([0.0, *process.nonsmooth])

    def rate_and_error(energy: Array) -> Array:
        c = process.coefficients(energy)
        rate = 2.0 * c.drift / c.diffusion - process.degrees_of_freedom / energy
        return np.stack([rate, log_density_slope_error(c)], axis=-1)

    def truncation(lengths: Array, coefficients: Array) -> Array:
        return np.asarray(lengths * np.sum(np.abs(coefficients[:, -2:, 0]), axis=1))

    def unresolved(lengths: Array, coefficients: Array) -> Array:
        error = truncation(lengths, coefficients)
        if process.state_damping:
            error = np.where(error > lengths * coefficients[:, 0, 1], error, 0.0)
        return error

    def cut(left: Array, right: Array) -> Array:
        narrow = right - left <= NARROW * nodes[-1]
        return np.where(narrow, left, split_points(left, right, special))

    both = fit(
        rate_and_error,
        nodes,
        tol / nodes.size,
        degree=POINTS - 1,
        cut=cut,
        estimate=unresolved,
        rounds=MOST_ROUNDS,
    )
    lengths = np.diff(both.nodes)
    errors = lengths * both.coefficients[:, 0, 1]
    rate = Piecewise(both.nodes, both.coefficients[..., 0])
    return rate, truncation(lengths, both.coefficients), errors


def _normalised(process: Process, smooth: Piecewise) -> Piecewise:
    """Return the exponent shifted so that p has mass one."""
    x, w = panel_rule(smooth.nodes, POINTS)
    log_p = _log_density(process, smooth, x)
    top = log_p.max()
    coefficients = smooth.coefficients.copy()
    coefficients[:, 0] -= top + np.log(np.sum(w * np.exp(log_p - top)))
    return replace(smooth, coefficients=coefficients)


def _log_density(process: Process, smooth: Piecewise, energy: Array) -> Array:
    nodes = smooth.nodes
    safe = np.clip(energy, np.finfo(float).tiny, nodes[-1])
    diffusion = process.coefficients(safe.ravel()).diffusion.reshape(safe.shape)
    value = smooth(safe) + process.degrees_of_freedom * np.log(safe) - np.log(diffusion)
    inside = (energy >= 0.0) & (energy <= nodes[-1])
    return np.where(inside, value, -np.inf)
