"""Diffusion processes given by functions, for tests of several rooms."""

from fpk.system.process import Coefficients, Process


def process_of(drift, diffusion, divergence, energy_scales):
    """The process of s, b and Σ_j ∂b_ij/∂H_j as functions of energies (points, d)."""

    def coefficients(energies):
        if len(energy_scales) > 1:
            return Coefficients(drift(energies), diffusion(energies), divergence(energies))
        column, functions = energies.reshape(-1, 1), (drift, diffusion, divergence)
        return Coefficients(*(f(column).reshape(energies.shape) for f in functions))

    return Process(coefficients, energy_scales)
