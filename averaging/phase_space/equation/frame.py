"""The full system (6) seen from its contact mass: linear in all else, and its reference states."""

import warnings
from dataclasses import dataclass

import numpy as np
from numpy.polynomial.hermite_e import hermegauss
from scipy.linalg import solve_continuous_lyapunov

from fpk.answer.names import Coordinate
from fpk.numeric.arrays import Array
from fpk.numeric.errors import NotApplicable
from fpk.system.equivalent import equivalent_temperature
from fpk.system.system import System, looks_the_same_mirrored

ROUNDS = 20
"""Linear systems, each with the contact force of the state before; they may alternate."""
POINTS = 80
"""Gauss points of the mean contact force over a Gaussian y."""


@dataclass(frozen=True, eq=False)
class Frame:
    """Eq. (6) in displacements and velocities times √m, with the contact mass set apart.

    ``contact`` counts from 0 (the last mass where there are no stops); ``order`` lists it first.
    ``stiffness``, ``damping`` (its constant part) and ``noise`` (n, n) are M^(−½) X M^(−½) in this
    order. With y the displacement √m q of the contact mass, ``root`` its √m, ``r`` those of the
    others and ``v`` all velocities: ``dv = −(K (y, r) + c v + g(y) e₁) dt`` plus noise of
    covariance 2 ``noise`` dt. ``symmetric``: (q, p) and (−q, −p) are equally likely.
    """

    system: System
    contact: int
    order: tuple[int, ...]
    root: float
    symmetric: bool
    stiffness: Array
    damping: Array
    noise: Array

    @property
    def n(self) -> int:
        """Number of masses."""
        return len(self.order)

    def place(self, c: Coordinate) -> tuple[int, float]:
        """Return where a displacement or momentum stands in (y, r, v), and its unit there."""
        at, root = self.order.index(c.row), float(np.sqrt(self.system.mass[c.row]))
        return (at + self.n, root) if c.kind == "p" else (at, 1.0 / root)

    def contact_energy(self, y: Array) -> Array:
        """Contact energy U at displacements y."""
        return self.system.contact_energy(self.contact, y / self.root)

    def contact_force(self, y: Array) -> Array:
        """Force dU/dy of the stops at displacements y."""
        q, force = y / self.root, np.zeros(np.shape(y))
        for s in self.system.stops:
            force = force + s.sign * s.force(np.maximum(s.sign * q - s.clearance, 0.0))
        return np.asarray(force / self.root)


def contact_frame(system: System) -> Frame:
    """Return the frame of a system; raise ``NotApplicable`` for stops on several masses."""
    if len(system.contact_masses) > 1:
        raise NotApplicable(
            f"{len(system.contact_masses)} masses meet stops: the expansion is about one mass that "
            "does, all others being linear given its displacement"
        )
    contact = system.contact_masses[0] if system.contacts else system.n - 1
    order = (contact, *(i for i in range(system.n) if i != contact))
    scale = 1.0 / np.sqrt(np.outer(system.mass, system.mass))
    at = np.ix_(order, order)
    matrices = (system.stiffness_matrix, system.damping, system.noise_matrix)
    root, symmetric = float(np.sqrt(system.mass[contact])), looks_the_same_mirrored(system)
    scaled = ((scale * matrix)[at] for matrix in matrices)
    return Frame(system, contact, order, root, symmetric, *scaled)


@dataclass(frozen=True, eq=False)
class Reference:
    """The state that a solution is expanded about: Gaussian in z = (v, x), given y.

    ``slope`` a and ``offset`` x₀ (n − 1,) make x = r − a y − x₀; ``covariance`` S (2n − 1, 2n − 1)
    is that of z. ln w(y) is −(w₁ y + ½ w₂ y² + w₃ U(y)), (w₁, w₂, w₃) = ``weight``: the potential
    of the force on the contact mass over S₁₁, so that the force cancels in the equations.
    """

    slope: Array
    offset: Array
    covariance: Array
    weight: Array

    @property
    def to_state(self) -> tuple[Array, Array]:
        """Matrix and vector that make (y, r, v) of (y, v, x): r = x + a y + x₀."""
        n = self.slope.size + 1
        to = np.zeros((2 * n, 2 * n))
        to[0, 0] = 1.0
        to[1:n, 0], to[1:n, n + 1 :] = self.slope, np.eye(n - 1)
        to[n:, 1 : n + 1] = np.eye(n)
        return to, np.concatenate([[0.0], self.offset, np.zeros(n)])


def reference_of(frame: Frame, slope: Array, offset: Array, covariance: Array) -> Reference:
    """Return the reference of these moments; raise ``LinAlgError`` where they are of none."""
    own, others = frame.stiffness[0, 0], frame.stiffness[0, 1:]
    weight = np.array([others @ offset, own + others @ slope, 1.0]) / covariance[0, 0]
    if np.linalg.eigvalsh(covariance)[0] <= 0.0 or weight[1] <= 0.0:
        raise np.linalg.LinAlgError("the moments found are of no distribution")
    return Reference(slope, offset, covariance, weight)


def with_moments(frame: Frame, mean: Array, covariance: Array) -> Reference:
    """Return the reference with mean and covariance of (y, r, v); raises as ``reference_of``."""
    n = frame.n
    slope = covariance[1:n, 0] / covariance[0, 0]
    offset = mean[1:n] - slope * mean[0]
    to_z = np.linalg.inv(Reference(slope, offset, covariance, np.zeros(3)).to_state[0])[1:]
    return reference_of(frame, slope, offset, to_z @ covariance @ to_z.T)


def gibbs_reference(frame: Frame) -> Reference:
    """Return the Gibbs state of T = tr D/tr c, or at which damping terms balance the noise.

    Raises ``NotApplicable`` where nothing is damped or no noise acts.
    """
    K, n = frame.stiffness, frame.n
    if frame.system.damping_terms:
        T = equivalent_temperature(frame.system)
    else:
        noise, damping = float(np.trace(frame.noise)), float(np.trace(frame.damping))
        if not (noise > 0.0 and damping > 0.0):
            raise NotApplicable("a stationary density in phase space needs damping and noise")
        T = noise / damping
    slope = np.asarray(-np.linalg.solve(K[1:, 1:], K[1:, 0]), dtype=float)
    covariance = T * np.eye(2 * n - 1)
    covariance[n:, n:] = T * np.linalg.inv(K[1:, 1:])
    return reference_of(frame, slope, np.zeros(n - 1), covariance)


def start(frame: Frame) -> Reference:
    """Return the Gaussian state of the linear system that is nearest to a frame's.

    Statistical linearisation (Roberts and Spanos, Random Vibration and Statistical Linearization,
    1990): the contact force g(y) is E g + k (y − E y), k = E g (y − E y)/Var y, of the Gaussian y
    that this force makes. With damping terms it is the ``gibbs_reference``. Raises ``LinAlgError``
    where the linear system has no stationary state.
    """
    gibbs, n = gibbs_reference(frame), frame.n
    if frame.system.damping_terms:
        return gibbs
    x, weight = hermegauss(POINTS)
    weight /= weight.sum()
    centre, variance = 0.0, 1.0 / gibbs.weight[1]
    noise = np.zeros((2 * n, 2 * n))
    noise[n:, n:] = 2.0 * frame.noise
    for _ in range(ROUNDS):
        y = centre + np.sqrt(variance) * x
        force = frame.contact_force(y)
        k = float(weight @ (force * (y - centre))) / variance
        stiffness = frame.stiffness.copy()
        stiffness[0, 0] += k
        drift = np.block([[np.zeros((n, n)), np.eye(n)], [-stiffness, -frame.damping]])
        with warnings.catch_warnings():
            # Where a motion is not damped at all; the answer is then of no distribution.
            warnings.simplefilter("ignore", RuntimeWarning)
            covariance = solve_continuous_lyapunov(drift, -noise)
        means = np.linalg.solve(stiffness, (k * centre - float(weight @ force)) * np.eye(n)[0])
        if not covariance[0, 0] > 0.0:
            raise np.linalg.LinAlgError("the linear system has no stationary state")
        # Halfway, as a softer stop lets y out to where it is stiffer.
        centre, variance = 0.5 * (centre + means[0]), 0.5 * (variance + covariance[0, 0])
    # Of mirror images round-off is all that the means are.
    mean = np.zeros(2 * n) if frame.symmetric else np.concatenate([means, np.zeros(n)])
    return with_moments(frame, mean, covariance)


def linear_part(frame: Frame, reference: Reference) -> tuple[Array, Array, Array]:
    """Return F, G and the coefficients of h in dz = (F z + h(y)) dt + noise of covariance 2 G dt.

    h(y) is ``h₀ + h₁ y − g(y) e₁``; (h₀, h₁) are the rows of the third, (2, 2n − 1); dy = z₁ dt.
    """
    n, K, c = frame.n, frame.stiffness, frame.damping
    a, x0 = reference.slope, reference.offset
    F = np.zeros((2 * n - 1, 2 * n - 1))
    F[:n, :n], F[:n, n:] = -c, -K[:, 1:]
    F[n:, 0], F[n:, 1:n] = -a, np.eye(n - 1)
    G = np.zeros_like(F)
    G[:n, :n] = frame.noise
    h = np.zeros((2, 2 * n - 1))
    h[0, :n] = -K[:, 1:] @ x0
    h[1, :n] = -(K[:, 0] + K[:, 1:] @ a)
    return F, G, h
