"""Diffusion processes and systems that the tests of fpk share."""

import numpy as np

from fpk.numeric.quadrature import panel_rule
from fpk.system.contact import Contact
from fpk.system.process import Coefficients, Process
from fpk.system.system import System


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


def chain(n=2, contacts=(), mass=None):
    """The chain of Fig. 6 for any n: c from 0.04 n down to 0.04, D from 0.01 up to 0.01 n."""
    count = np.arange(1.0, n + 1.0)
    return System(
        mass=np.ones(n) if mass is None else mass,
        stiffness=np.ones(n),
        damping=0.04 * count[::-1],
        noise_intensity=0.01 * count,
        contacts=contacts,
    )


def both(stiffness, clearance=0.5, law="hertz", *, mass=1, exponent=None):
    return (Contact(mass + 1, "both", stiffness, clearance, law, exponent),)


def integral(function, nodes, *, points=24):
    x, w = panel_rule(nodes, points)
    return float(np.sum(w * function(x)))


def refined_nodes(*meshes):
    """All nodes of some meshes, with layers towards H = 0."""
    nodes = np.unique(np.concatenate(meshes))
    return np.unique(np.concatenate([nodes, nodes[1] * 0.15 ** np.arange(1.0, 13.0)]))
