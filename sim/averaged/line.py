"""One averaged energy as a square-root process, by a change of the variable."""

import numpy as np

from fpk.errors import NotApplicable
from fpk.process import Process, log_density_slope
from fpk.quadrature import panel_rule
from sim.averaged.square_root import SquareRootForm

NATS = 40.0
"""Fall of ln p up to the last energy of the table: 4e-18 of the mass lies beyond."""

CELLS = 4096
"""Cells of the tables; linear interpolation between them is good to 1e-7."""

FIRST = 8
"""Cells next to 0 with the γ of the next one: a difference of equal numbers is divided by X."""


def line_form(process: Process) -> SquareRootForm:
    """Return X = R², R = ∫ dH/√b from 0: a square-root process with β = 4 whatever b(H) is.

    By Ito's formula ``dX = μ dt + 2 √X dB``, ``μ = 1 + 2 R (s − b'/4)/√b``, and μ(0) = 2n with n
    degrees of freedom. d = 2n and β = 4 are constants, so that steps are of weak order two however
    b depends on H, and exact for the square-root process itself (no contact, constant damping).
    Where contact has no clearance γ is steep next to 0, and the order is lost there.

    Raises ``NotApplicable`` where the density does not fall off.
    """
    nodes = _last_energy(process) * np.linspace(0.0, 1.0, CELLS + 1) ** 2
    # H = t²: the integrand 2 t/√b(t²) is smooth at 0, where b ~ H.
    t, w = panel_rule(np.sqrt(nodes), 4)
    b = process.coefficients((t**2).ravel()).diffusion.reshape(t.shape)
    R = np.concatenate([[0.0], np.cumsum(np.sum(w * 2.0 * t / np.sqrt(b), axis=1))])
    c = process.coefficients(nodes[1:])
    mu = 1.0 + 2.0 * R[1:] * (c.drift - 0.25 * c.divergence) / np.sqrt(c.diffusion)
    noise = 2.0 * process.degrees_of_freedom
    gamma = (noise - mu) / R[1:] ** 2
    gamma[:FIRST] = gamma[FIRST]
    table = np.concatenate([gamma[:1], gamma]) - gamma[0]
    # H/R² varies slowly; H itself would be off by the square of a cell next to 0.
    ratio = nodes[1:] / R[1:] ** 2
    ratio = np.concatenate([ratio[:1], ratio])
    scale = float(np.interp(process.energy_scale, nodes, R)) ** 2
    # What the table itself is good for counts as nothing.
    alike = float(np.max(np.abs(table))) <= 1e-6 * abs(float(gamma[-1]))
    return SquareRootForm(
        noise=np.array([noise]),
        slope=np.array([4.0]),
        damping=None if alike else lambda X: np.interp(np.sqrt(X), R, table),
        linear=gamma[:1],
        energies=lambda X: np.asarray(X * np.interp(np.sqrt(X), R, ratio)),
        scales=np.array([scale]),
        times=np.array([scale / noise]),
    )


def _last_energy(process: Process) -> float:
    grid = process.energy_scale * np.logspace(-3.0, 3.0, 600)
    slope = log_density_slope(process.coefficients(grid))
    log_p = np.concatenate([[0.0], np.cumsum(0.5 * (slope[1:] + slope[:-1]) * np.diff(grid))])
    deep = np.flatnonzero(np.maximum.accumulate(log_p) - log_p > NATS)
    if not deep.size:
        raise NotApplicable("the density of the energy does not fall off: nothing is stationary")
    return float(grid[deep[0]])
