"""Integrators of Eq. (6): a contact kick, then a random linear map, with the state observed.

``exact_flow``: the modified contact kick, then the exact flow of everything linear; fourth order
in the contact, and without contact exact for any h. The force of Takahashi and Imada (J. Phys. Soc.
Japan 53, 1984, 3765), ``g_i (1 − h² g_i'/(12 m_i))``, leaves an error of second order that a change
of variables removes, the processor; its derivation is in docs/theory.md, "The step of the
simulation". The others are baselines. ``register`` adds one.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from fpk.system.linear import diffusion_matrix, drift_matrix
from fpk.system.system import System
from sim.step.flow import LinearMap, exact_flow, factored, flow_covariance


@dataclass(frozen=True)
class Scheme:
    """One integrator of Eq. (6): kick by the contact force g, then a random linear map.

    The kick is ``p_i -= h g_i (1 − w h² g_i'/m_i)`` with ``w = modified``; for ``kick_first``
    False it comes after the map, by the force before it. Where it is first, observed is the state
    in the middle of the kick, corrected by the processor for ``w > 0``.
    ``weak_order`` is the order in h of stationary averages, contact forces being smooth enough;
    ``linear_map(system, h)`` the rest of the step, without the springs if they are kicked, too.

    Damping terms act for h/2 before the kicks and, in reverse order, for h/2 after them; where the
    kick is not first for h by Euler's rule. With ``small`` > 1 a step is a long one of so many
    small ones (``sim.sample.plan``).
    """

    name: str
    weak_order: int
    linear_map: Callable[[System, float], LinearMap]
    modified: float = 0.0
    kick_first: bool = True
    springs_kicked: bool = False
    small: int = 1


SCHEMES: dict[str, Scheme] = {}


def register(scheme: Scheme) -> Scheme:
    """Add an integrator to the registry and return it; a name is taken once."""
    if scheme.name in SCHEMES:
        raise ValueError(f"scheme {scheme.name!r} is registered already")
    SCHEMES[scheme.name] = scheme
    return scheme


def euler_step(system: System, dt: float) -> LinearMap:
    """Return Euler-Maruyama's ``x' = (1 + A h) x + σ √h z`` of the system without its contacts.

    Of first order; drift and noise from the start of the step (Maruyama, Rend. Circ. Mat. Palermo
    4, 1955, 48). It feeds energy to undamped vibration, ``(1 + h² ω²)`` in each step, and needs h
    well below ``2 ζ/ω`` to have a stationary state at all.
    """
    return LinearMap(
        np.eye(2 * system.n) + dt * drift_matrix(system), factored(dt * diffusion_matrix(system))
    )


def drift_damp_drift(system: System, dt: float) -> LinearMap:
    """Return A O A of BAOAB over ``dt``, exact damping and noise in O; the springs kick before it.

    Half kick, half drift, O, half drift, half kick: the two half kicks that meet between steps are
    one (Leimkuhler and Matthews, Appl. Math. Res. Express 2013, 34).
    """
    n = system.n
    velocity = np.diag(1.0 / system.mass)
    damped, covariance = flow_covariance(-system.damping @ velocity, 2.0 * system.noise_matrix, dt)
    one, zero = np.eye(n), np.zeros((n, n))
    drift = np.block([[one, 0.5 * dt * velocity], [zero, one]])
    damp = np.block([[one, zero], [zero, damped]])
    noise = factored(covariance)
    return LinearMap(drift @ damp @ drift, drift @ np.vstack([np.zeros_like(noise), noise]))


register(Scheme("baoab", 2, drift_damp_drift, springs_kicked=True))
register(Scheme("euler_maruyama", 1, euler_step, kick_first=False))
EXACT_FLOW = register(Scheme("exact_flow", 4, exact_flow, modified=1.0 / 12.0))
