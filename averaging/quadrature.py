"""The stationary density (11) of the averaged energy process, by quadrature of its exponent."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import NDArray

from fpk.line.mesh import initial_nodes, split_points
from fpk.probe import probed
from fpk.process import Coefficients, Process, log_density_slope_error
from fpk.quadrature import gauss_legendre, panel_rule

Array = NDArray[np.float64]

POINTS = 16
"""Gauss points per panel: the exponent is expanded in Legendre polynomials of degree 15."""
MOST_ROUNDS = 30
ROUND_OFF = 1e-15


@dataclass(frozen=True, eq=False)
class QuadratureSolution:
    """ln p of Eq. (11) as a piecewise polynomial, p = exp(ln p) on the panels between ``nodes``.

    ``smooth`` (panels, POINTS + 1) are Legendre coefficients of ∫(2s/σ² − n/H) dH continued over
    the panels, with the normalisation in them; ``l1_error`` estimates ∫|p_h − p|, ``log_error``
    what errors of 2s/σ² add up to in ln p from one end to the other.
    """

    process: Process
    nodes: Array
    smooth: Array
    l1_error: float
    mass_defect: float
    tail_mass: float
    log_error: float = 0.0

    def log_density(self, energy: Array) -> Array:
        """ln p at energies > 0 of any shape, −∞ outside the panels."""
        x = np.asarray(energy, dtype=float).ravel()
        k = np.clip(np.searchsorted(self.nodes, x, side="right") - 1, 0, self.nodes.size - 2)
        left, right = self.nodes[k], self.nodes[k + 1]
        t = (2.0 * x - left - right) / (right - left)
        smooth = np.einsum("xj,xj->x", legendre.legvander(t, POINTS), self.smooth[k])
        safe = np.clip(x, np.finfo(float).tiny, self.nodes[-1])
        c = self.process.coefficients(safe)
        n = self.process.degrees_of_freedom
        value = smooth + n * np.log(safe) - np.log(c.diffusion)
        inside = (x >= 0.0) & (x <= self.nodes[-1])
        return np.where(inside, value, -np.inf).reshape(np.shape(energy))


def solve_by_quadrature(process: Process, *, tol: float = 1e-10) -> QuadratureSolution:
    """Return p(H) = C/σ² exp(+∫2s/σ² dH), Eq. (11) with its sign corrected.

    The integrand is n/H at H → 0, so the integral of (11) from 0 diverges; n/H is integrated in
    closed form and the rest panel by panel, each halved until its Legendre coefficients decay
    below ``tol``.
    """
    probe = probed(process)
    nodes = initial_nodes(probe, probe.extent(1e-2 * tol), process.nonsmooth)
    special = np.array([0.0, *process.nonsmooth])
    left, right = nodes[:-1], nodes[1:]
    rate, c = _expanded_rate(process, left, right)
    for _ in range(MOST_ROUNDS):
        tail = (right - left) * np.sum(np.abs(rate[:, -2:]), axis=1)
        marked = tail > 0.1 * tol / left.size
        if process.state_damping:
            # What the coefficients do not know, no panel can resolve.
            marked &= tail > _accumulated(left, right, c)
        cut = split_points(left, right, special)
        marked &= (cut > left) & (cut < right) & (right - left > 1e-13 * right[-1])
        if not marked.any():
            break
        new_left = np.concatenate([left[marked], cut[marked]])
        new_right = np.concatenate([cut[marked], right[marked]])
        new_rate, new_c = _expanded_rate(process, new_left, new_right)
        order = np.argsort(np.concatenate([left[~marked], new_left]))
        left = np.concatenate([left[~marked], new_left])[order]
        right = np.concatenate([right[~marked], new_right])[order]
        rate = np.concatenate([rate[~marked], new_rate])[order]
        c = Coefficients(
            *(np.concatenate([a[~marked], b])[order] for a, b in zip(c, new_c, strict=True))
        )
    solution = _normalised(process, np.append(left, right[-1]), rate, c)
    x, w = panel_rule(solution.nodes, POINTS + 4)
    defect = abs(float(np.sum(w * np.exp(solution.log_density(x)))) - 1.0)
    last = float(np.exp(solution.log_density(solution.nodes[-1:])[0]))
    beyond = probe.tail_bound(float(solution.nodes[-1]), last)
    # An error of the exponent over one panel shifts the mass on one side of it against the other.
    share = np.sum(w * np.exp(solution.log_density(x)), axis=1)
    below = np.cumsum(share)
    moved = np.minimum(below, 1.0 - below + share)
    error = (
        2.0 * float(tail @ moved)
        + 2.0 * float(c.relative_error.max())
        + defect
        + 2.0 * beyond
        + ROUND_OFF * left.size
    )
    log_error = 0.0
    if process.state_damping:
        steps = _accumulated(solution.nodes[:-1], solution.nodes[1:], c)
        # The exponent is a running sum over all panels, whose round-off is relative to its size.
        round_off = np.finfo(float).eps * float(np.ptp(solution.smooth[:, 0]))
        error += 2.0 * float(steps @ moved) + round_off
        log_error = float(np.sum(steps) + np.sum(tail)) + round_off
    return replace(
        solution, l1_error=error, mass_defect=defect, tail_mass=beyond, log_error=log_error
    )


def _normalised(process: Process, nodes: Array, rate: Array, c: Coefficients) -> QuadratureSolution:
    """Integrate the rate over the panels one after another and normalise the density."""
    half = 0.5 * np.diff(nodes)[:, None]
    smooth = half * legendre.legint(rate, axis=1, lbnd=-1)
    smooth[1:, 0] += np.cumsum(smooth.sum(axis=1))[:-1]
    t, w = gauss_legendre(POINTS)
    energy = 0.5 * (nodes[1:] + nodes[:-1])[:, None] + half * t
    log_p = smooth @ legendre.legvander(t, POINTS).T
    log_p += process.degrees_of_freedom * np.log(energy) - np.log(c.diffusion)
    top = log_p.max()
    smooth[:, 0] -= top + np.log(np.sum(half * w * np.exp(log_p - top)))
    return QuadratureSolution(process, nodes, smooth, np.inf, np.inf, np.inf)


def _accumulated(left: Array, right: Array, c: Coefficients) -> Array:
    """Errors of 2s/σ² integrated over each panel, from the coefficients at its Gauss points."""
    _, w = gauss_legendre(POINTS)
    return np.asarray(0.5 * (right - left) * (log_density_slope_error(c) @ w))


def _expanded_rate(process: Process, left: Array, right: Array) -> tuple[Array, Coefficients]:
    """Legendre coefficients of 2s/σ² − n/H on panels, and the coefficients at Gauss points."""
    t, w = gauss_legendre(POINTS)
    energy = 0.5 * (left + right)[:, None] + 0.5 * (right - left)[:, None] * t
    flat = process.coefficients(energy.ravel())
    c = Coefficients(*(part.reshape(energy.shape) for part in flat))
    g = 2.0 * c.drift / c.diffusion - process.degrees_of_freedom / energy
    degrees = np.arange(POINTS)
    return g @ (w[:, None] * legendre.legvander(t, POINTS - 1) * (degrees + 0.5)), c
