"""The full system (6) relative to its contact mass, linear in the other variables; references."""

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

LINEARISATIONS = 20
"""Number of linear systems solved in turn, each with the contact force averaged over the Gaussian
state of the last; fixed, since the states may alternate."""
FORCE_POINTS = 80
"""Gauss points of the average of the contact force over a Gaussian y."""


@dataclass(frozen=True, eq=False)
class Frame:
    """Eq. (6) in displacements and velocities times √m, with the contact mass first.

    ``contact`` is the 0-based contact mass, the last mass if there are no stops; ``order`` lists
    all masses, this first. ``stiffness``, ``damping`` (its constant part) and ``noise`` (n, n) are
    M^(−½) X M^(−½) in this order. y = √m q is of the contact mass, ``root`` its √m, r are the
    scaled displacements of the others and v all scaled velocities: ``dv = −(K (y, r) + c v + g(y)
    e₁) dt`` plus noise of covariance 2 ``noise`` dt. ``symmetric``: (q, p) and (−q, −p) are equally
    likely.
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
        """Return i and a factor: the q or p of ``c`` is the factor times entry i of (y, r, v)."""
        at, root = self.order.index(c.row), float(np.sqrt(self.system.mass[c.row]))
        return (at + self.n, root) if c.kind == "p" else (at, 1.0 / root)

    def contact_energy(self, y: Array) -> Array:
        """Return the contact energy U at ``y`` = √m q of any shape."""
        return self.system.contact_energy(self.contact, y / self.root)

    def contact_force(self, y: Array) -> Array:
        """Return g = dU/dy, U the contact energy, at ``y``."""
        q, force = y / self.root, np.zeros(np.shape(y))
        for s in self.system.stops:
            force = force + s.sign * s.force(np.maximum(s.sign * q - s.clearance, 0.0))
        return np.asarray(force / self.root)


def contact_frame(system: System) -> Frame:
    """Return the frame of ``system``; raise ``NotApplicable`` for stops on several masses."""
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
    """The density that a solution is expanded about: w(y) times a Gaussian in z = (v, x).

    x = r − a y − x₀ with a = ``slope`` and x₀ = ``offset`` (n − 1,); ``covariance`` S
    (2n − 1, 2n − 1) is of z. ln w(y) = −(w₁ y + ½ w₂ y² + w₃ U(y)), (w₁, w₂, w₃) = ``weight``, the
    potential of the force on the contact mass over S₁₁, so that the force cancels in the equations.
    """

    slope: Array
    offset: Array
    covariance: Array
    weight: Array

    @property
    def to_state(self) -> tuple[Array, Array]:
        """Matrix (2n, 2n) and vector (2n,) of the affine map from (y, v, x) to (y, r, v).

        r = x + a y + x₀.
        """
        n = self.slope.size + 1
        to = np.zeros((2 * n, 2 * n))
        to[0, 0] = 1.0
        to[1:n, 0], to[1:n, n + 1 :] = self.slope, np.eye(n - 1)
        to[n:, 1 : n + 1] = np.eye(n)
        return to, np.concatenate([[0.0], self.offset, np.zeros(n)])


def make_reference(frame: Frame, slope: Array, offset: Array, covariance: Array) -> Reference:
    """Return the reference with this ``slope``, ``offset`` and ``covariance`` (``Reference``).

    Raises ``LinAlgError`` if it is no density: covariance or weight is not positive definite.
    """
    own, others = frame.stiffness[0, 0], frame.stiffness[0, 1:]
    weight = np.array([others @ offset, own + others @ slope, 1.0]) / covariance[0, 0]
    if np.linalg.eigvalsh(covariance)[0] <= 0.0 or weight[1] <= 0.0:
        raise np.linalg.LinAlgError("the moments found are of no distribution")
    return Reference(slope, offset, covariance, weight)


def with_moments(frame: Frame, mean: Array, covariance: Array) -> Reference:
    """Return the reference whose slope, offset and S follow from moments of (y, r, v).

    The means of v in ``mean`` (2n,) are not used, and w(y) follows from the force and S₁₁, not from
    the moments of y; ``covariance`` is (2n, 2n). Raises as ``make_reference``.
    """
    n = frame.n
    slope = covariance[1:n, 0] / covariance[0, 0]
    offset = mean[1:n] - slope * mean[0]
    to_z = np.linalg.inv(Reference(slope, offset, covariance, np.zeros(3)).to_state[0])[1:]
    return make_reference(frame, slope, offset, to_z @ covariance @ to_z.T)


def gibbs_reference(frame: Frame) -> Reference:
    """Return the Gibbs state of T = tr D/tr c, with damping terms of the equivalent temperature.

    Raises ``NotApplicable`` if nothing is damped or no noise acts.
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
    return make_reference(frame, slope, np.zeros(n - 1), covariance)


def gaussian_start(frame: Frame) -> Reference:
    """Return the Gaussian state by statistical linearisation of the contact force.

    g(y) is replaced by E g + k (y − E y), k = E g (y − E y)/Var y, with the means over the Gaussian
    state of the linear system with this force (Roberts and Spanos, Random Vibration and Statistical
    Linearization, 1990). With damping terms it is ``gibbs_reference``. Raises ``LinAlgError`` if
    the linear system has no stationary state, otherwise as ``gibbs_reference``.
    """
    gibbs, n = gibbs_reference(frame), frame.n
    if frame.system.damping_terms:
        return gibbs
    x, weight = hermegauss(FORCE_POINTS)
    weight /= weight.sum()
    centre, variance = 0.0, 1.0 / gibbs.weight[1]
    noise = np.zeros((2 * n, 2 * n))
    noise[n:, n:] = 2.0 * frame.noise
    for _ in range(LINEARISATIONS):
        y = centre + np.sqrt(variance) * x
        force = frame.contact_force(y)
        k = float(weight @ (force * (y - centre))) / variance
        stiffness = frame.stiffness.copy()
        stiffness[0, 0] += k
        drift = np.block([[np.zeros((n, n)), np.eye(n)], [-stiffness, -frame.damping]])
        with warnings.catch_warnings():
            # A warning means an undamped motion; the covariance is then not positive.
            warnings.simplefilter("ignore", RuntimeWarning)
            covariance = solve_continuous_lyapunov(drift, -noise)
        means = np.linalg.solve(stiffness, (k * centre - float(weight @ force)) * np.eye(n)[0])
        if not covariance[0, 0] > 0.0:
            raise np.linalg.LinAlgError("the linear system has no stationary state")
        # Half a step, since a softer stop lets y move to where it is stiffer.
        centre, variance = 0.5 * (centre + means[0]), 0.5 * (variance + covariance[0, 0])
    # If mirror images are equally likely the means are 0 up to round-off.
    mean = np.zeros(2 * n) if frame.symmetric else np.concatenate([means, np.zeros(n)])
    return with_moments(frame, mean, covariance)


def linear_part(frame: Frame, reference: Reference) -> tuple[Array, Array, Array]:
    """Return F, G and (h₀, h₁) of dz = (F z + h(y)) dt + noise of covariance 2 G dt, dy = z₁ dt.

    z = (v, x), see ``Reference``; h(y) is ``h₀ + h₁ y − g(y) e₁``, (h₀, h₁) (2, 2n − 1).
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
