"""Euler-Maruyama: drift and noise from the start of the step. A baseline, of first order.

Maruyama, Rend. Circ. Mat. Palermo 4, 1955, 48. It feeds energy to undamped vibration,
``(1 + h² ω²)`` in each step, and needs h well below ``2 ζ/ω`` to have a stationary state at all.
"""

import numpy as np

from fpk.system.linear import diffusion_matrix, drift_matrix
from fpk.system.system import System
from sim.step.flow import LinearMap, factored
from sim.step.schemes import Scheme, register


def euler_step(system: System, dt: float) -> LinearMap:
    """Return ``x' = (1 + A h) x + σ √h z`` of the system without its contacts."""
    return LinearMap(
        np.eye(2 * system.n) + dt * drift_matrix(system), factored(dt * diffusion_matrix(system))
    )


register(Scheme(name="euler_maruyama", weak_order=1, linear_map=euler_step, kick_first=False))
