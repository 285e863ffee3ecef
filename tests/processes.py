"""Diffusion processes given by functions, and sums over panels, for tests of several rooms."""

import numpy as np

from fpk.numeric.quadrature import panel_rule
from fpk.system.process import Coefficients, Process


def process_of(drift, diffusion, divergence, energy_scales):
    """The process of s, b and Σ_j ∂b_ij/∂H_j as functions of energies (points, d)."""

    def coefficients(energies):
        if len(energy_scales) > 1:
            return Coefficients(drift(energies), diffusion(energies), divergence(energies))
        column, functions = energies.reshape(-1, 1), (drift, diffusion, divergence)
        return Coefficients(*(f(column).reshape(energies.shape) for f in functions))

    return Process(coefficients, energy_scales)


def by_hand(dissipation, *, d=1.0, n=1.0, scale=1.0):
    """The process with b = 2 d H, T = H^(n−1) and a given dissipation F(H): s = F + d n."""

    def coefficients(energy):
        F = dissipation(energy)
        return Coefficients(
            drift=F + d * n,
            diffusion=2.0 * d * energy,
            divergence=np.full_like(energy, 2.0 * d),
            dissipation=F,
            log_density_of_states=(n - 1.0) * np.log(energy),
            relative_error=np.zeros_like(energy),
        )

    return Process(coefficients, (scale,), (), max(round(n), 1))


def cox_ingersoll_ross(*, a, c=1.0, d=1.0):
    """The square-root process s = a − c H, b = 2 d H: a gamma density of shape a/d, scale d/c."""
    return by_hand(lambda H: -c * H, d=d, n=a / d, scale=a / c)


def integral(function, nodes, *, points=24):
    x, w = panel_rule(np.asarray(nodes, dtype=float), points)
    return float(np.sum(w * function(x)))


def refined_nodes(*meshes):
    """All nodes of some meshes, with layers towards H = 0."""
    nodes = np.unique(np.concatenate(meshes))
    return np.unique(np.concatenate([nodes, nodes[1] * 0.15 ** np.arange(1.0, 13.0)]))
