"""The stationary density (11) of the averaged energy process, by quadrature of its exponent."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import NDArray

from averaging.zero_flux import flux_residual
from fpk.certificate import Measured
from fpk.line.mesh import initial_nodes, split_points
from fpk.probe import probed
from fpk.process import Coefficients, Process, log_density_slope_error
from fpk.quadrature import gauss_legendre, panel_rule

Array = NDArray[np.float64]

POINTS = 16
"""Gauss points per panel: the exponent is expanded in Legendre polynomials of degree 15."""
MOST_ROUNDS = 30
ROUND_OFF = 1e-15
"""Relative error of p that a panel adds by its round-off."""
UNMEASURED = Measured(*(float("nan"),) * 5)
"""Until something was measured: nothing that rests on it is certified."""


@dataclass(frozen=True, eq=False)
class QuadratureSolution:
    """ln p of Eq. (11) as a piecewise polynomial, p = exp(ln p) on the panels between ``nodes``.

    ``smooth`` (panels, POINTS + 1) are Legendre coefficients of ∫(2s/σ² − n/H) dH continued over
    the panels, with the normalisation in them; ``relative_error`` (panels,) is that of p on each
    panel, which adds up from where the mass is; ``measured`` is what was measured on p.
    """

    process: Process
    nodes: Array
    smooth: Array
    relative_error: Array
    measured: Measured

    @property
    def l1_error(self) -> float:
        """Estimate of ∫|p_h − p|."""
        return self.measured.l1_error

    def log_density(self, energy: Array) -> Array:
        """ln p at energies > 0 of any shape, −∞ outside the panels."""
        x = np.asarray(energy, dtype=float).ravel()
        k = self._panel(x)
        left, right = self.nodes[k], self.nodes[k + 1]
        t = (2.0 * x - left - right) / (right - left)
        smooth = np.einsum("xj,xj->x", legendre.legvander(t, POINTS), self.smooth[k])
        safe = np.clip(x, np.finfo(float).tiny, self.nodes[-1])
        c = self.process.coefficients(safe)
        n = self.process.degrees_of_freedom
        value = smooth + n * np.log(safe) - np.log(c.diffusion)
        inside = (x >= 0.0) & (x <= self.nodes[-1])
        return np.where(inside, value, -np.inf).reshape(np.shape(energy))

    def log_error(self, energy: Array) -> Array:
        """Error of ln p at energies of any shape, constant on each panel."""
        return np.asarray(self.relative_error[self._panel(np.asarray(energy, dtype=float))])

    def _panel(self, energy: Array) -> NDArray[np.intp]:
        panel = np.searchsorted(self.nodes, energy, side="right") - 1
        return np.clip(panel, 0, self.nodes.size - 2)


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
    nodes, smooth = _normalised(process, np.append(left, right[-1]), rate, c)
    solution = QuadratureSolution(process, nodes, smooth, np.zeros(left.size), UNMEASURED)
    x, w = panel_rule(nodes, POINTS + 4)
    p = np.exp(solution.log_density(x))
    last = float(np.exp(solution.log_density(nodes[-1:])[0]))
    tail_mass = probe.tail_bound(float(nodes[-1]), last)
    # An error of the exponent over one panel shifts the mass on one side of it against the other.
    share = np.sum(w * p, axis=1)
    below = np.cumsum(share)
    moved = np.minimum(below, 1.0 - below + share)
    defect = abs(float(share.sum()) - 1.0)
    l1_error = (
        2.0 * float(c.relative_error.max()) + defect + 2.0 * tail_mass + ROUND_OFF * left.size
    )
    steps = tail
    if process.state_damping:
        # The exponent is a running sum over all panels, whose round-off is relative to its size.
        l1_error += np.finfo(float).eps * float(np.ptp(smooth[:, 0]))
        steps = tail + _accumulated(nodes[:-1], nodes[1:], c)
    l1_error += 2.0 * float(steps @ moved)
    # In ln p the errors add up from the median outwards.
    total, middle = np.cumsum(steps), int(np.searchsorted(below, 0.5))
    outwards = np.abs(total - total[min(middle, left.size - 1)]) + steps
    measured = Measured(
        l1_error=l1_error,
        mass_defect=defect,
        minimum=float(p.min() / p.max()),
        residual=flux_residual(process, nodes, solution.log_density),
        tail_mass=tail_mass,
    )
    return replace(solution, relative_error=l1_error + outwards, measured=measured)


def _normalised(
    process: Process, nodes: Array, rate: Array, c: Coefficients
) -> tuple[Array, Array]:
    """Integrate the rate over the panels one after another; return nodes and ``smooth`` of p."""
    half = 0.5 * np.diff(nodes)[:, None]
    smooth = half * legendre.legint(rate, axis=1, lbnd=-1)
    smooth[1:, 0] += np.cumsum(smooth.sum(axis=1))[:-1]
    t, w = gauss_legendre(POINTS)
    energy = 0.5 * (nodes[1:] + nodes[:-1])[:, None] + half * t
    log_p = smooth @ legendre.legvander(t, POINTS).T
    log_p += process.degrees_of_freedom * np.log(energy) - np.log(c.diffusion)
    top = log_p.max()
    smooth[:, 0] -= top + np.log(np.sum(half * w * np.exp(log_p - top)))
    return nodes, smooth


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
