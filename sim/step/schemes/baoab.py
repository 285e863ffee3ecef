"""BAOAB: half kick, half drift, damping and noise, half drift, half kick. A baseline.

Leimkuhler and Matthews, Appl. Math. Res. Express 2013, 34. The two half kicks that meet between
steps are one: kick by springs and contact, then drift, Ornstein-Uhlenbeck process, drift.
"""

import numpy as np

from fpk.system.system import System
from sim.step.flow import LinearMap, factored, flow_covariance
from sim.step.schemes import Scheme, register


def drift_damp_drift(system: System, dt: float) -> LinearMap:
    """Return A O A over ``dt``; exact damping and noise in O. The springs kick before it."""
    n = system.n
    velocity = np.diag(1.0 / system.mass)
    damped, covariance = flow_covariance(-system.damping @ velocity, 2.0 * system.noise_matrix, dt)
    one, zero = np.eye(n), np.zeros((n, n))
    drift = np.block([[one, 0.5 * dt * velocity], [zero, one]])
    damp = np.block([[one, zero], [zero, damped]])
    noise = factored(covariance)
    return LinearMap(drift @ damp @ drift, drift @ np.vstack([np.zeros_like(noise), noise]))


BAOAB = register(
    Scheme(name="baoab", weak_order=2, linear_map=drift_damp_drift, springs_kicked=True)
)
