"""Reference densities of a chain, written from the equations with NumPy and mpmath alone.

``EnergyReference``: densities that depend on the total energy, ρ = u(H), Eqs. (7), (11), (22),
(29), (30), with stops on one mass at most. ``LinearReference`` and ``ModalReference``: without
contact, Eqs. (12)-(16), (20), (33)-(36), with forty digits. None stands for what has no reference.
"""

from functools import cached_property
from math import gamma
from typing import NamedTuple

import mpmath
import numpy as np

mp = mpmath.mp.clone()
mp.dps = 40
NATS = 60.0
"""Fall of a density at which integrals over it end: e^-60 = 9e-27 of the maximum."""
REFERENCE = 1e-12
"""Relative error of the references where nothing worse is known."""

# Double exponential rule on (0, 1), with the nodes near 0 to full accuracy.
STEP = 1.0 / 32.0
_S = 0.5 * np.pi * np.sinh(_T := np.arange(-4.0, 4.0 + STEP / 2, STEP))
FRACTION, WEIGHT = (
    1.0 / (1.0 + np.exp(-2.0 * _S)),
    STEP * 0.25 * np.pi * np.cosh(_T) / np.cosh(_S) ** 2,
)


class Stop(NamedTuple):
    """One-sided stop at mass ``index`` (from 0): B (sign·q − clearance)₊^exponent."""

    index: int
    sign: float
    stiffness: float
    clearance: float
    exponent: float


class Term(NamedTuple):
    """c_ii gains coefficient · q_a², · v_a² or · H (``kind``), masses from 0."""

    i: int
    coefficient: float
    kind: str
    a: int = 0


class Chain(NamedTuple):
    """The numbers of Eq. (1): masses, springs, damping and noise matrices, stops, damping terms."""

    mass: np.ndarray
    stiffness: np.ndarray
    damping: np.ndarray
    noise: np.ndarray
    stops: tuple = ()
    terms: tuple = ()

    @property
    def n(self):
        return len(self.mass)

    @property
    def touching(self):
        return tuple(sorted({s.index for s in self.stops}))

    def compliance(self, first, last):
        """Σ 1/k of the springs from mass ``first`` (−1 is the wall) to mass ``last``."""
        return float(np.sum(1.0 / self.stiffness[first + 1 : last + 1]))

    def contact_energy_of(self, stop):
        """Least energy at which the stop is reached."""
        return 0.5 * stop.clearance**2 / self.compliance(-1, stop.index)


def chain_of(system, terms=()):
    """The numbers of a record of the product that has no other damping terms than ``terms``."""
    stops = (Stop(s.index, s.sign, s.stiffness, s.clearance, s.power) for s in system.stops)
    numbers = system.mass, system.stiffness, system.damping, system.noise_matrix
    return Chain(*numbers, tuple(stops), terms)


def pieces(f, cuts):
    """∫f over the pieces between ``cuts`` (..., m + 1), ascending; ``f`` takes (..., m, nodes).

    The double exponential rule takes any integrable singularity at the cuts.
    """
    left, length = cuts[..., :-1, None], np.diff(cuts, axis=-1)[..., None]
    with np.errstate(divide="ignore", invalid="ignore"):
        values = f(left + length * FRACTION) * (length * WEIGHT)
    return np.sum(np.where(length > 0.0, values, 0.0), axis=(-2, -1))


def increasing_root(f, low, high):
    """Root of an increasing function between arrays ``low`` and ``high``, by bisection."""
    for _ in range(90):
        middle = 0.5 * (low + high)
        below = f(middle) < 0.0
        low, high = np.where(below, middle, low), np.where(below, high, middle)
    return 0.5 * (low + high)


def distance_to_level(f, scale):
    """Least x >= 0 with f(x) >= 0 for an f that increases from f(0) <= 0, scales in ``scale``."""
    while (short := f(scale) < 0.0).any():
        scale = np.where(short, 2.0 * scale, scale)
    return increasing_root(f, np.zeros_like(scale), scale)


class EnergyReference:
    """Densities of H, q_i and p_i that belong to the averaged energy process of a chain.

    With N quadratic coordinates besides the contact mass (n momenta and the masses without contact)
    and V the potential minimised over these, ``p(H) ~ u(H) ∫(H − V)^(N/2 − 1)/Γ(N/2) dq_c`` and
    ``p(q) ~ ∫W(V) dq_hidden`` with the Weyl integral ``W_ν(E) = ∫u(E + x) x^(ν − 1)/Γ(ν) dx``.
    Here u = exp(−Ψ), Ψ = αH + ½ βH² (β of damping terms in proportion to H).
    """

    def __init__(self, chain):
        self.chain, self.quadratic = chain, 2 * chain.n - len(chain.touching)
        noise = float(np.sum(np.diag(chain.noise) / chain.mass))
        self.alpha = float(np.sum(np.diag(chain.damping) / chain.mass)) / noise
        self.beta = sum(t.coefficient / chain.mass[t.i] for t in chain.terms) / noise
        self.known = len(chain.touching) < 2 and all(t.kind == "H" for t in chain.terms)

    def psi(self, energy):
        return energy * (self.alpha + 0.5 * self.beta * energy)

    def weyl(self, order, energy, offset=0.0):
        """exp(``offset``) W_order(``energy``)."""
        a, b = self.alpha + self.beta * energy, self.beta
        if b == 0.0:
            return self.alpha**-order * np.exp(offset - self.psi(energy))
        if order == 0.0:
            return np.exp(offset - self.psi(energy))
        end = 2.0 * NATS / (a + np.sqrt(a * a + 2.0 * b * NATS))
        # x^(ν−1) is singular or peaked at 0 beside the fall of u: two more cuts.
        cuts, a = end[..., None] * np.array([0.0, 0.02, 0.2, 1.0]), a[..., None, None]

        def f(x):
            return x ** (order - 1.0) * np.exp(-x * (a + 0.5 * b * x)) / gamma(order)

        return np.exp(offset - self.psi(energy)) * pieces(f, cuts)

    def contact_energy(self, q):
        """Contact energy at displacements of the mass that has the stops."""
        over = [(s, np.maximum(s.sign * q - s.clearance, 0.0)) for s in self.chain.stops]
        return sum(
            (s.stiffness / (s.exponent + 1.0) * x ** (s.exponent + 1.0) for s, x in over), 0.0
        )

    def contact_force(self, q):
        over = [(s, np.maximum(s.sign * q - s.clearance, 0.0)) for s in self.chain.stops]
        return sum((s.sign * s.stiffness * x**s.exponent for s, x in over), 0.0)

    def with_stops(self, low, high):
        """Ends and the stops between them, (..., m + 1)."""
        stops = sorted({s.sign * s.clearance for s in self.chain.stops})
        parts = [low, *(np.clip(s, low, high) for s in stops), high]
        return np.stack(np.broadcast_arrays(*parts), axis=-1)

    def states(self, energy):
        """∫(H − V)₊^(N/2 − 1)/Γ(N/2) dq_c with its error, energies (points,)."""
        order = 0.5 * self.quadratic
        if not self.chain.touching:
            value = energy ** (order - 1.0) / gamma(order)
        elif order < 1.0:
            value = self.period(energy)
            # Beside the energy of contact the period grows like a root: round-off of H counts.
            moved = [self.period(energy * (1.0 + s * 4e-16)) - value for s in (-1.0, 1.0)]
            return value, REFERENCE * value + np.max(np.abs(moved), axis=0)
        else:
            k = 1.0 / self.chain.compliance(-1, *self.chain.touching)
            reach = np.sqrt(2.0 * energy / k)

            def V(x):
                return 0.5 * k * x * x + self.contact_energy(x)

            left, right = (
                increasing_root(lambda x, s=s: V(s * x) - energy, 0.0 * reach, reach)
                for s in (-1.0, 1.0)
            )

            def f(x):
                free = np.maximum(energy[:, None, None] - V(x), 0.0)
                return free ** (order - 1.0) / gamma(order)

            value = pieces(f, self.with_stops(-left, right))
        return value, REFERENCE * value

    def period(self, energy):
        """The integral of n = 1, singular at the turning points X, over distances d = X − |q|.

        H − V is formed as V(X) − V(X − d), term by term without cancellation.
        """
        (k,), total = self.chain.stiffness, 0.0
        for sign in (1.0, -1.0):
            B, gap, e = next(
                (
                    (s.stiffness, s.clearance, s.exponent + 1.0)
                    for s in self.chain.stops
                    if s.sign == sign
                ),
                (0.0, 0.0, 2.0),
            )  # without a stop, a stop of no stiffness
            room = energy - 0.5 * k * gap**2

            def rise(x, B=B, gap=gap, e=e, room=room):
                return x * (k * gap + 0.5 * k * x) + B / e * x**e - room

            free_reach = np.sqrt(2.0 * energy / k)
            overlap = increasing_root(rise, 0.0 * energy, np.where(room > 0.0, free_reach, 0.0))
            X = np.where(room > 0.0, gap + overlap, free_reach)[:, None, None]
            cuts = np.stack([0.0 * energy, overlap, X.ravel()], axis=-1)

            def f(d, B=B, e=e, X=X, o=overlap[:, None, None]):
                share = np.where(d < o, -np.expm1(e * np.log1p(-np.minimum(d / o, 1.0))), 1.0)
                contact = B / e * np.where(o > 0.0, share * o**e, 0.0)
                return 1.0 / np.sqrt(0.5 * k * d * (2.0 * X - d) + contact)

            total = total + pieces(f, cuts)
        return total / np.sqrt(np.pi)

    def over_contact(self, order, stiffness, centre, energy):
        """∫W_order(energy + ½ stiffness (y − centre)² + U(y)) dy as (value, ln of its unit).

        y is the displacement of the contact mass; ``centre`` and ``energy`` are (points,).
        """

        def at(y):
            more = (...,) + (None,) * (np.ndim(y) - 1)
            return energy[more] + 0.5 * stiffness * (y - centre[more]) ** 2 + self.contact_energy(y)

        def slope(y):
            return stiffness * (y - centre) + self.contact_force(y)

        rest = increasing_root(slope, np.minimum(centre, 0.0), np.maximum(centre, 0.0))
        bottom = at(rest)
        offset, a = self.psi(bottom), self.alpha + self.beta * bottom
        rise = 2.0 * NATS / (a + np.sqrt(a * a + 2.0 * self.beta * NATS))
        scale = 1e-3 * np.sqrt(rise / stiffness)
        ends = [
            rest + s * distance_to_level(lambda d, s=s: at(rest + s * d) - bottom - rise, scale)
            for s in (-1.0, 1.0)
        ]
        cuts = self.with_stops(*ends)
        more = (..., None, None)
        return pieces(lambda y: self.weyl(order, at(y), offset[more]), cuts), -offset

    def marginal(self, order, energy):
        """∫W_order(V + ``energy``) over displacements with contact, as (value, ln of its unit)."""
        if not self.chain.touching:
            return self.weyl(order, energy, self.psi(energy)), -self.psi(energy)
        stiffness = 1.0 / self.chain.compliance(-1, *self.chain.touching)
        return self.over_contact(order, stiffness, 0.0 * energy, energy)

    def normalised(self, value, log, extra, doubt=0.0):
        """A density and its error from an integral, ln of its unit and a factor exp(``extra``)."""
        norm, log_norm = self.marginal(0.5 * self.quadratic, np.zeros(1))
        scale = np.exp(log - log_norm + extra) / norm
        return value * scale, (doubt + 2.0 * REFERENCE * value) * scale

    def of_energy(self, energy):
        """p(H) and its error."""
        if not self.known:
            return None
        p, error, inside = np.zeros_like(energy), np.zeros_like(energy), energy > 0.0
        if inside.any():
            value, doubt = self.states(energy[inside])
            p[inside], error[inside] = self.normalised(value, -self.psi(energy[inside]), 0.0, doubt)
        return p, error

    def of_displacement(self, i, q):
        """p(q_i) and its error."""
        if not self.known:
            return None
        chain, order = self.chain, 0.5 * self.quadratic
        wall = 1.0 / chain.compliance(-1, i)
        if i in chain.touching:
            E = 0.5 * wall * q * q + self.contact_energy(q)
            return self.normalised(self.weyl(order, E, self.psi(E)), -self.psi(E), 0.0)
        # One quadratic coordinate fewer is left; its variance at unit temperature, the contact mass
        # held, gives the constant.
        order -= 0.5
        if not chain.touching:
            E, spread = 0.5 * wall * q * q, 1.0 / wall
            value, log = self.weyl(order, E, self.psi(E)), -self.psi(E)
        else:
            (c,) = chain.touching
            between = 1.0 / chain.compliance(min(i, c), max(i, c))
            if i < c:
                spread = 1.0 / (wall + between)
                value, log = self.over_contact(order, between, q, 0.5 * wall * q * q)
            else:  # of both springs at the contact mass
                held, spread = 1.0 / chain.compliance(-1, c), 1.0 / between
                both = held + between
                centre, E = q * (between / both), 0.5 * held * between / both * q * q
                value, log = self.over_contact(order, both, centre, E)
        return self.normalised(value, log, -0.5 * np.log(2.0 * np.pi * spread))

    def of_momentum(self, i, p):
        """p(p_i) and its error."""
        if self.known and self.beta:
            value, log = self.marginal(0.5 * (self.quadratic - 1), 0.5 * p * p / self.chain.mass[i])
            return self.normalised(value, log, -0.5 * np.log(2.0 * np.pi * self.chain.mass[i]))
        return None if self.chain.terms else gaussian(self.chain.mass[i] / self.alpha, p)


def gaussian(variance, x):
    """Normal density of mean zero with its reference error."""
    variance = float(variance)
    p = np.exp(-0.5 * x * x / variance) / np.sqrt(2.0 * np.pi * variance)
    return p, REFERENCE * p * (1.0 + x * x / variance)


def sum_density(scales, shape, x):
    """Density at x (points,) of Σ gamma variables of one ``shape`` and the given ``scales``.

    The Laplace transform Π (1 + θ s)^−shape is inverted on Talbot's contour with 24 digits.
    """

    def transform(s):
        return mp.exp(-shape * sum(mp.log(1 + c * s) for c in scales))

    options = {"method": "talbot", "degree": 40}
    p = [
        float(mp.invertlaplace(transform, mp.mpf(float(t)), **options)) if t > 0.0 else 0.0
        for t in x
    ]
    return np.array(p), REFERENCE * np.abs(p) + 1e-30


def springs_of(chain):
    """The stiffness matrix with forty digits."""
    K = mp.zeros(chain.n)
    for i, k in enumerate(chain.stiffness.tolist()):
        for a in {i, i - 1} - {-1}:
            for b in {i, i - 1} - {-1}:
                K[a, b] += mp.mpf(k) * (1 if a == b else -1)
    return K


class LinearReference:
    """Gaussian stationary density of the linear chain: A C + C Aᵀ + b = 0."""

    def __init__(self, chain):
        self.chain = chain

    @cached_property
    def covariance(self):
        chain, n, K = self.chain, self.chain.n, springs_of(self.chain)
        A, pairs = mp.zeros(2 * n), [(i, j) for i in range(2 * n) for j in range(i + 1)]
        for i in range(n):
            A[i, n + i] = 1 / mp.mpf(float(chain.mass[i]))
            for j in range(n):
                A[n + i, j] = -K[i, j]
                A[n + i, n + j] = -mp.mpf(float(chain.damping[i, j])) / float(chain.mass[j])
        place = {pair: k for k, (i, j) in enumerate(pairs) for pair in ((i, j), (j, i))}
        M, right = mp.zeros(len(pairs)), mp.zeros(len(pairs), 1)
        for k, (i, j) in enumerate(pairs):
            for r in range(2 * n):
                M[k, place[r, j]] += A[i, r]
                M[k, place[i, r]] += A[j, r]
            if j >= n:
                right[k] = -2 * mp.mpf(float(chain.noise[i - n, j - n]))
        solution = mp.lu_solve(M, right)
        return mp.matrix([[solution[place[i, j]] for j in range(2 * n)] for i in range(2 * n)])

    def of_energy(self, energy):
        """By the λ of H = ½ Σ λ χ²_1: eigenvalues of Lᵀ G L, C = L Lᵀ, 2 H the form of G."""
        n, L, G = self.chain.n, mp.cholesky(self.covariance), mp.zeros(2 * self.chain.n)
        G[:n, :n] = springs_of(self.chain)
        for i in range(n):
            G[n + i, n + i] = 1 / mp.mpf(float(self.chain.mass[i]))
        return sum_density(list(mp.eigsy(L.T * G * L, eigvals_only=True)), mp.mpf(1) / 2, energy)

    def of_displacement(self, i, q):
        return gaussian(self.covariance[i, i], q)

    def of_momentum(self, i, p):
        return gaussian(self.covariance[self.chain.n + i, self.chain.n + i], p)


class ModalReference:
    """Densities of (34), (36): independent exponential modal energies, contacts left out.

    With damping h(H) D or with one mode the density is u(H) again, without contacts.
    """

    def __init__(self, chain):
        self.chain = chain._replace(stops=())
        by_energy = [t.kind for t in chain.terms] == ["H"] * chain.n
        self.by_energy = EnergyReference(self.chain) if by_energy else None

    @cached_property
    def modes(self):
        """Modes as columns of unit modal mass, ascending ω², and mean energies θ."""
        chain = self.chain
        scale = mp.diag([1 / mp.sqrt(mp.mpf(m)) for m in chain.mass.tolist()])
        squares, vectors = mp.eigsy(scale * springs_of(chain) * scale)
        T = scale * vectors
        c, D = (T.T * mp.matrix(x.tolist()) * T for x in (chain.damping, chain.noise))
        return T, list(squares), [D[i, i] / c[i, i] for i in range(chain.n)]

    def of_energy(self, energy):
        if self.chain.terms:
            return self.by_energy and self.by_energy.of_energy(energy)
        return sum_density(self.modes[2], 1, energy)

    def of_modal_energy(self, i, energy):
        if not self.chain.terms:
            theta = float(self.modes[2][i])
            p = np.exp(-energy / theta) / theta
            return p, REFERENCE * p * (1.0 + energy / theta)
        if self.by_energy is None or self.chain.n == 1:
            return self.by_energy and self.by_energy.of_energy(energy)
        n = float(self.chain.n)
        p = self.by_energy.weyl(n - 1.0, energy) / self.by_energy.weyl(n, np.zeros(1))
        return p, REFERENCE * p

    def of_displacement(self, i, q):
        if self.chain.terms:
            return self.by_energy and self.by_energy.of_displacement(i, q)
        T, squares, theta = self.modes
        return gaussian(sum(T[i, k] ** 2 * theta[k] / squares[k] for k in range(len(theta))), q)

    def of_momentum(self, i, p):
        if self.chain.terms:
            return self.by_energy and self.by_energy.of_momentum(i, p)
        T, _, theta = self.modes
        mass = mp.mpf(float(self.chain.mass[i]))
        return gaussian(mass**2 * sum(T[i, k] ** 2 * theta[k] for k in range(len(theta))), p)
