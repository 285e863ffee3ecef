"""Integrators of Eq. (6): a kick by the contact force, then a random linear map.

``exact_flow``: the modified contact kick, then the exact flow of the linear system; of fourth order
in the step h with contact, exact for any h without. The force of Takahashi and Imada (J. Phys. Soc.
Japan 53, 1984, 3765), ``g_i (1 − h² g_i'/(12 m_i))``, leaves an error of second order that a change
of variables, the processor, removes; its derivation is in docs/theory.md, "The step of the
simulation". The other schemes are baselines. ``register_scheme`` adds a scheme.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.linalg.lapack import dpstrf

from fpk.numeric.arrays import Array
from fpk.system.linear import diffusion_matrix, drift_matrix, flow_covariance
from fpk.system.system import System
from sim.step.arrays import MAP_COLUMNS


@dataclass(frozen=True, eq=False)
class LinearMap:
    """The random linear map ``x' = propagator x + factor z``, x = (q, p), z standard normals."""

    propagator: Array  # (2n, 2n)
    factor: Array  # (2n, rank of the covariance)

    @property
    def matrix(self) -> Array:
        """``propagator`` and ``lower_trapezoidal`` factor side by side, by ``pad_columns``."""
        return pad_columns(np.hstack([self.propagator, lower_trapezoidal(self.factor)]))


def pad_columns(rows: Array) -> Array:
    """Return ``rows`` with columns of zeros up to a multiple of ``MAP_COLUMNS``."""
    return np.pad(rows, ((0, 0), (0, -rows.shape[1] % MAP_COLUMNS)))


def covariance_factor(covariance: Array) -> Array:
    """Return a factor L (m, rank) with L Lᵀ = ``covariance`` (m, m), which may be singular or 0.

    Cholesky with pivoting of the matrix scaled to unit diagonal, so that variances of different
    units and powers of the step have equal weight; it ends at a pivot of the size of round-off. An
    indefinite matrix is not refused, but L Lᵀ then differs from it.
    """
    scale = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    inverse = np.divide(1.0, scale, out=np.zeros_like(scale), where=scale > 0)
    unit, least = covariance * np.outer(inverse, inverse), 1e-13 * scale.size
    lower, order, rank, _ = dpstrf(unit, tol=least, lower=True)
    factor = np.empty((scale.size, rank))
    factor[order - 1] = np.tril(lower)[:, :rank]
    return scale[:, None] * factor


def lower_trapezoidal(factor: Array) -> Array:
    """Return L (m, rank) with L Lᵀ = ``factor`` ``factor``ᵀ and zeros right of the diagonal.

    Householder's QR of the transpose with scaled rows: the error of each row is its own round-off.
    """
    size = np.linalg.norm(factor, axis=1, keepdims=True)
    unit = np.divide(factor, size, out=np.zeros_like(factor), where=size > 0)
    upper: Array = np.asarray(np.linalg.qr(unit.T, mode="r"))
    return np.asarray(upper.T * size)


def exact_flow(system: System, dt: float) -> LinearMap:
    """Return the flow over ``dt`` of the system without its stops, exact for any ``dt``."""
    propagator, covariance = flow_covariance(drift_matrix(system), diffusion_matrix(system), dt)
    return LinearMap(propagator, covariance_factor(covariance))


@dataclass(frozen=True)
class Scheme:
    """An integrator of Eq. (6) with the step h: a kick by the contact force g, a random linear map.

    With ``kick_first``, damping terms act for h/2 before the kick and, in reverse order, for h/2
    after it; the observed state is in the middle of the kick, corrected by the processor. Without,
    damping terms act for h by Euler's rule.
    """

    name: str
    weak_order: int  # in h, of stationary averages, for sufficiently smooth contact forces
    linear_map: Callable[[System, float], LinearMap]  # without the springs if springs_kicked
    modified: float = 0.0  # w of the kick p_i -= h g_i (1 − w h² g_i'/m_i)
    kick_first: bool = True  # else the kick follows the map, by the force before the map
    springs_kicked: bool = False  # the spring force is part of the kick
    small: int = 1  # small steps in a long step, see ``sim.sample.plan``


SCHEMES: dict[str, Scheme] = {}


def register_scheme(scheme: Scheme) -> None:
    """Add ``scheme`` to ``SCHEMES``; raise ``ValueError`` if its name is there already."""
    if scheme.name in SCHEMES:
        raise ValueError(f"scheme {scheme.name!r} is registered already")
    SCHEMES[scheme.name] = scheme


def euler_step(system: System, dt: float) -> LinearMap:
    """Return Euler's rule ``x' = (1 + A h) x + σ √h z``, h = ``dt``, A and σσᵀ without contacts.

    Maruyama, Rend. Circ. Mat. Palermo 4, 1955, 48. Each step multiplies the energy of undamped
    vibration by ``1 + h² ω²``; there is a stationary state only for h below ``2 ζ/ω``.
    """
    propagator = np.eye(2 * system.n) + dt * drift_matrix(system)
    return LinearMap(propagator, covariance_factor(dt * diffusion_matrix(system)))


def drift_damp_drift(system: System, dt: float) -> LinearMap:
    """Return A O A of BAOAB over ``dt``: half drift, exact damping and noise, half drift.

    The half kicks B that meet between two steps are joined in the kick (Leimkuhler and Matthews,
    Appl. Math. Res. Express 2013, 34).
    """
    n = system.n
    velocity = np.diag(1.0 / system.mass)
    damped, covariance = flow_covariance(-system.damping @ velocity, 2.0 * system.noise_matrix, dt)
    one, zero = np.eye(n), np.zeros((n, n))
    drift = np.block([[one, 0.5 * dt * velocity], [zero, one]])
    damp = np.block([[one, zero], [zero, damped]])
    noise = covariance_factor(covariance)
    return LinearMap(drift @ damp @ drift, drift @ np.vstack([np.zeros_like(noise), noise]))


register_scheme(Scheme("baoab", 2, drift_damp_drift, springs_kicked=True))
register_scheme(Scheme("euler_maruyama", 1, euler_step, kick_first=False))
register_scheme(Scheme("exact_flow", 4, exact_flow, modified=1.0 / 12.0))
