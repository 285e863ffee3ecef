"""Density of one energy by quadrature of (11)."""

from dataclasses import replace
from functools import partial

import numpy as np

from averaging.zero_flux import ZeroFluxDensity, flux_residual
from fpk.arrays import EPS, Array
from fpk.certificate import Measured
from fpk.line.mesh import initial_nodes, split_points
from fpk.piecewise import Piecewise, fit
from fpk.probe import probed
from fpk.process import Process, log_density_slope_error
from fpk.quadrature import panel_rule

POINTS = 16
"""Gauss points per panel: the exponent is expanded in Legendre polynomials of degree 15."""
MOST_ROUNDS = 30
"""Cuts of a panel: towards H = 0 and contact energies each leaves 0.15 of it."""
NARROW = 1e-13
"""Length of a panel, relative to the last energy, below which it is not cut: what is left of a
singularity there is part of the stated error."""
ROUND_OFF = 1e-15
"""Relative error of p that a panel adds by its round-off."""


def solve_by_quadrature(process: Process, *, tol: float = 1e-10) -> ZeroFluxDensity:
    """Return p(H) = C/σ² exp(+∫2s/σ² dH), Eq. (11) with its sign corrected.

    The integrand is n/H at H → 0, so the integral of (11) from 0 diverges; n/H is integrated in
    closed form and the rest panel by panel, each halved until its Legendre coefficients decay
    below ``tol``.
    """
    probe = probed(process)
    nodes = initial_nodes(probe, probe.extent(1e-2 * tol), process.nonsmooth)
    rate = _expanded_rate(process, nodes, 0.1 * tol)
    nodes, lengths = rate.nodes, np.diff(rate.nodes)
    smooth = replace(rate, coefficients=rate.coefficients[..., 0], error=None).antiderivative()

    def log_p(energy: Array, *, over_states: bool = False) -> Array:
        c = process.coefficients(energy.ravel())
        log_n = process.degrees_of_freedom * np.log(energy)
        value = smooth(energy) + log_n - np.log(c.diffusion).reshape(energy.shape)
        states = c.log_density_of_states.reshape(energy.shape) if over_states else 0.0
        return np.asarray(value - states)

    x, w = panel_rule(nodes, POINTS)
    top = log_p(x).max()
    smooth.coefficients[:, 0] -= top + np.log(np.sum(w * np.exp(log_p(x) - top)))
    x, w = panel_rule(nodes, POINTS + 4)
    p = np.exp(log_p(x))
    tail_mass = probe.tail_bound(float(nodes[-1]), float(np.exp(log_p(nodes[-1:])[0])))
    # An error of the exponent over one panel shifts the mass on one side of it against the other.
    share = np.sum(w * p, axis=1)
    below = np.cumsum(share)
    moved = np.minimum(below, 1.0 - below + share)
    defect = abs(float(share.sum()) - 1.0)
    # Close to a contact energy T may be worse by far, where there is next to no mass.
    states = 2.0 * process.coefficients(x.ravel()).relative_error.reshape(x.shape)
    l1_error = float(np.sum(w * p * states)) + defect + 2.0 * tail_mass + ROUND_OFF * lengths.size
    steps = _truncation(lengths, rate.coefficients) + lengths * rate.coefficients[:, 0, 1]
    if process.state_damping:
        # The exponent is a running sum over all panels, whose round-off is relative to its size.
        l1_error += EPS * float(np.ptp(smooth.coefficients[:, 0]))
    l1_error += 2.0 * float(steps @ moved)
    # In ln p the errors add up from the median outwards.
    total, middle = np.cumsum(steps), int(np.searchsorted(below, 0.5))
    outwards = np.abs(total - total[min(middle, lengths.size - 1)]) + steps + states.max(axis=1)
    measured = Measured(
        l1_error, defect, float(p.min() / p.max()), flux_residual(process, nodes, log_p), tail_mass
    )

    def relative_error(energy: Array) -> Array:
        panel = np.searchsorted(nodes, energy, side="right") - 1
        # ln p is formed with ln H and ln b, which cancel.
        rounded = 4.0 * EPS * np.abs(np.log(energy))
        return np.asarray(l1_error + outwards[np.clip(panel, 0, nodes.size - 2)] + rounded)

    log_u = partial(log_p, over_states=True)
    return ZeroFluxDensity(process, nodes, log_u, relative_error, measured)


def _truncation(lengths: Array, coefficients: Array) -> Array:
    """Error of the integral over each panel by truncating the series, (panels,)."""
    return np.asarray(lengths * np.sum(np.abs(coefficients[:, -2:, 0]), axis=1))


def _expanded_rate(process: Process, nodes: Array, tol: float) -> Piecewise:
    """Return 2s/σ² − n/H on panels, and a bound of its error by those of the coefficients."""
    special = np.array([0.0, *process.nonsmooth])

    def rate_and_error(energy: Array) -> Array:
        c = process.coefficients(energy)
        rate = 2.0 * c.drift / c.diffusion - process.degrees_of_freedom / energy
        return np.stack([rate, log_density_slope_error(c)], axis=-1)

    def unresolved(lengths: Array, coefficients: Array) -> Array:
        error = _truncation(lengths, coefficients)
        # What the coefficients do not know, no panel can resolve.
        return np.where(error > lengths * coefficients[:, 0, 1], error, 0.0)

    def cut(left: Array, right: Array) -> Array:
        narrow = right - left <= NARROW * nodes[-1]
        return np.where(narrow, left, split_points(left, right, special))

    return fit(
        rate_and_error,
        nodes,
        tol / nodes.size,
        degree=POINTS - 1,
        cut=cut,
        estimate=unresolved,
        rounds=MOST_ROUNDS,
    )
