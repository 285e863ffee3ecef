"""The full system (6) relative to its contact mass, linear in the other variables; references."""

from dataclasses import dataclass

import numpy as np

from fpk.answer.names import Coordinate
from fpk.numeric.arrays import Array
from fpk.numeric.errors import NotApplicable
from fpk.system.equivalent import equivalent_temperature
from fpk.system.system import System, looks_the_same_mirrored

POWER = 0.75
"""σ: densities are polynomials times (w N)^σ, w N the weight of ``Reference``. With 1 the equations
for moments of low degree close, but for masses of unequal temperatures functions of high degree
grow without bound; with 1/2 no function can grow, but moments converge more slowly."""
LEAST_STIFFNESS = 0.25
"""Smallest stiffness w₂ S₁₁ of the weight of y over the stiffness with all other masses free. With
0.05 a noiseless mass before a stiff stop was no nearer, and single precision did not suffice."""


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
    """The weight w(y) N(z; 0, S) of the polynomials, N a Gaussian in z = (v, x).

    Its power σ = ``POWER`` is the density that a solution is expanded about. x = r − a y − x₀ with
    a = ``slope`` and x₀ = ``offset`` (n − 1,); S = ``covariance`` (2n − 1, 2n − 1), σ times the
    covariance of that density. ln w(y) = −(w₁ y + ½ w₂ y² + w₃ U(y)), (w₁, w₂, w₃) = ``weight``,
    the potential of the force on the contact mass over S₁₁, so that the force cancels in the
    equations.
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
    the moments of y; ``covariance`` is (2n, 2n). A slope by which the other masses would push the
    contact mass outwards is lowered (``LEAST_STIFFNESS``). Raises as ``make_reference``.
    """
    n, K = frame.n, frame.stiffness
    slope = covariance[1:n, 0] / covariance[0, 0]
    free = -np.linalg.solve(K[1:, 1:], K[1:, 0])
    most = (1.0 - LEAST_STIFFNESS) * (K[0, 0] + K[0, 1:] @ free)
    lost = K[0, 1:] @ (free - slope)
    if lost > most:
        slope = free + most / lost * (slope - free)
    offset = mean[1:n] - slope * mean[0]
    to_z = np.linalg.inv(Reference(slope, offset, covariance, np.zeros(3)).to_state[0])[1:]
    return make_reference(frame, slope, offset, POWER * to_z @ covariance @ to_z.T)


def gibbs_reference(frame: Frame) -> Reference:
    """Return the Gibbs state of ``equivalent_temperature``; raise ``NotApplicable`` as it does."""
    K, n, T = frame.stiffness, frame.n, equivalent_temperature(frame.system)
    slope = np.asarray(-np.linalg.solve(K[1:, 1:], K[1:, 0]), dtype=float)
    covariance = POWER * T * np.eye(2 * n - 1)
    covariance[n:, n:] = POWER * T * np.linalg.inv(K[1:, 1:])
    return make_reference(frame, slope, np.zeros(n - 1), covariance)


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
