"""Diffusion processes given by functions, and sums over panels, for tests of several rooms."""

import mpmath
import numpy as np

from fpk.numeric.quadrature import panel_rule
from fpk.system.process import Coefficients, Process

mp = mpmath.mp.clone()
mp.dps = 40


def process_of(drift, diffusion, divergence, energy_scales):
    """The process of s, b and Σ_j ∂b_ij/∂H_j as functions of energies (points, d)."""

    def coefficients(energies):
        if len(energy_scales) > 1:
            return Coefficients(drift(energies), diffusion(energies), divergence(energies))
        column, functions = energies.reshape(-1, 1), (drift, diffusion, divergence)
        return Coefficients(*(f(column).reshape(energies.shape) for f in functions))

    return Process(coefficients, energy_scales)


def competing(damping, coupling, noise, scales):
    """s_i = d_i − (γ_i + Σ_j A_ij H_j) H_i, b_ii = 2 d_i H_i: γ, A and d in this order."""
    g, A, d = (np.asarray(x, dtype=float) for x in (damping, coupling, noise))
    return process_of(
        lambda H: d - (g + H @ A.T) * H,
        lambda H: 2.0 * d * H[:, :, None] * np.eye(d.size),
        lambda H: np.broadcast_to(2.0 * d, H.shape),
        scales,
    )


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


# Exact answers of the square-root process s = n d − c H, b = 2 d H: x = c H/d, time in 1/c.


def moments(n, x):
    """c E T and c² Var T of the passage 0 → x, from Σ (a)_k x^k/(k! (n)_k) in powers of a."""
    x, term, first, second, harmonic = mp.mpf(x), mp.mpf(1), mp.mpf(0), mp.mpf(0), mp.mpf(0)
    for k in range(1, int(x + 40 * mp.sqrt(x)) + 120):
        term *= x / (n + k - 1)
        first += term / k
        second += harmonic * term / k
        harmonic += mp.mpf(1) / k
    return first, first**2 - 2 * second


def rate(n, x, guess):
    """The failure rate: the least zero in a of 1F1(−a; n; x)."""
    return mp.findroot(lambda a: mp.hyp1f1(-a, n, x, maxterms=10**6), guess, verify=False)


def failure(n, start, limit, t):
    """P(T <= t) by Talbot's inverse transform of 1F1(s; n; x_0)/1F1(s; n; x_f)/s."""

    def transform(s):
        above, below = (mp.hyp1f1(s, n, x, maxterms=10**6) for x in (start, limit))
        return above / below / s

    return mp.invertlaplace(transform, t, method="talbot", degree=40)


def density(n, x, start, t):
    """p(x, t | start), noncentral χ² of 2n degrees."""
    theta = 1 - mp.exp(-mp.mpf(t))
    x, y = mp.mpf(x) / theta, mp.mpf(start) * mp.exp(-mp.mpf(t)) / theta
    if y == 0:
        return x ** (n - 1) * mp.exp(-x) / mp.gamma(n) / theta
    bessel = mp.besseli(n - 1, 2 * mp.sqrt(x * y))
    return mp.exp(-x - y) * (x / y) ** (mp.mpf(n - 1) / 2) * bessel / theta
