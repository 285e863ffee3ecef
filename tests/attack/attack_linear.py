"""Reference densities of the chain without contacts: Lyapunov equation and modes, by mpmath.

Eqs. (12)-(16), (20), (33)-(36) with forty digits. A sum of exponential or of ½ λ χ² variables has
the Laplace transform Π (1 + θ s)^-shape, inverted on Talbot's contour.
"""

from functools import cached_property
from itertools import combinations_with_replacement

import mpmath
import numpy as np
from attack_energy import REFERENCE, Chain, EnergyReference

mp = mpmath.mp.clone()
mp.dps = 40


def spring_matrix(k):
    n = len(k)
    K = mp.zeros(n)
    for i in range(n):
        K[i, i] += mp.mpf(float(k[i]))
        if i:
            K[i - 1, i - 1] += mp.mpf(float(k[i]))
            K[i, i - 1] -= mp.mpf(float(k[i]))
            K[i - 1, i] -= mp.mpf(float(k[i]))
    return K


def gaussian(variance, x):
    """Normal density of mean zero with its reference error."""
    variance = float(variance)
    p = np.exp(-0.5 * x * x / variance) / np.sqrt(2.0 * np.pi * variance)
    return p, REFERENCE * p * (1.0 + x * x / variance)


def sum_density(scales, shape, x):
    """Density at x (points,) of Σ gamma variables of one ``shape`` and the given ``scales``.

    Fixed Talbot contour (Abate, Valkó 2004), 40 nodes with 50 digits: 24 digits of the
    transform's own scale.
    """
    values, nodes = [], 40
    with mp.workdps(50):
        logs = [mp.mpf(s) for s in scales]
        for point in x:
            if point <= 0.0:
                values.append(0.0)
                continue
            t = mp.mpf(float(point))
            r = 2 * mp.mpf(nodes) / (5 * t)

            def transform(s):
                return mp.exp(-shape * sum(mp.log(1 + c * s) for c in logs))

            total = mp.exp(r * t) * transform(r) / 2
            for k in range(1, nodes):
                angle = k * mp.pi / nodes
                cot = mp.cot(angle)
                s = r * angle * mp.mpc(cot, 1)
                sigma = angle + (angle * cot - 1) * cot
                total += (mp.exp(t * s) * transform(s) * mp.mpc(1, sigma)).real
            values.append(float(r / nodes * total))
    p = np.array(values)
    return p, REFERENCE * np.abs(p) + 1e-30


def exponential_sum_density(means, x):
    """Density at x (points,) of Σ exponential variables, by partial fractions with 150 digits.

    Means that are equal are taken 1e-30 apart, a relative error of that size.
    """
    with mp.workdps(150):
        theta = [mp.mpf(t) * (1 + k * mp.mpf(10) ** -30) for k, t in enumerate(means)]
        n, values = len(theta), []
        shares = [a ** (n - 2) / mp.fprod(a - b for b in theta if b is not a) for a in theta]
        for point in x:
            terms = (
                s * mp.exp(-mp.mpf(float(point)) / a) for s, a in zip(shares, theta, strict=True)
            )
            values.append(float(mp.fsum(terms)) if point > 0.0 else 0.0)
    p = np.array(values)
    return p, REFERENCE * np.abs(p)


class LinearReference:
    """Gaussian stationary density of the linear chain: A C + C Aᵀ + b = 0 solved with 40 digits."""

    def __init__(self, chain):
        self.chain = chain

    @cached_property
    def covariance(self):
        chain, n = self.chain, self.chain.n
        K, A, b = spring_matrix(chain.stiffness), mp.zeros(2 * n), mp.zeros(2 * n)
        for i in range(n):
            A[i, n + i] = 1 / mp.mpf(float(chain.mass[i]))
            for j in range(n):
                A[n + i, j] = -K[i, j]
                A[n + i, n + j] = -mp.mpf(float(chain.damping[i, j])) / float(chain.mass[j])
                b[n + i, n + j] = 2 * mp.mpf(float(chain.noise[i, j]))
        pairs = list(combinations_with_replacement(range(2 * n), 2))
        place = {pair: k for k, pair in enumerate(pairs)}
        M, right = mp.zeros(len(pairs)), mp.zeros(len(pairs), 1)
        for k, (i, j) in enumerate(pairs):
            for r in range(2 * n):
                M[k, place[min(r, j), max(r, j)]] += A[i, r]
                M[k, place[min(i, r), max(i, r)]] += A[j, r]
            right[k] = -b[i, j]
        solution = mp.lu_solve(M, right)
        C = mp.zeros(2 * n)
        for (i, j), k in place.items():
            C[i, j] = C[j, i] = solution[k]
        return C

    @cached_property
    def scales(self):
        """λ with H = ½ Σ λ χ²_1: eigenvalues of √G C √G, G the quadratic form of 2 H."""
        chain, n = self.chain, self.chain.n
        L = mp.cholesky(self.covariance)
        G, K = mp.zeros(2 * n), spring_matrix(chain.stiffness)
        for i in range(n):
            G[n + i, n + i] = 1 / mp.mpf(float(chain.mass[i]))
            for j in range(n):
                G[i, j] = K[i, j]
        return list(mp.eigsy(L.T * G * L, eigvals_only=True))

    def of_energy(self, energy):
        return sum_density(self.scales, mp.mpf(1) / 2, energy)

    def of_displacement(self, i, q):
        return gaussian(self.covariance[i, i], q)

    def of_momentum(self, i, p):
        j = self.chain.n + i
        return gaussian(self.covariance[j, j], p)


class ModalReference:
    """Densities of (34), (36): independent exponential modal energies, contacts left out.

    With damping c = h(H) f D fᵀ or one mode the density is u(H) again, without contacts; None
    stands for what has no reference.
    """

    def __init__(self, chain):
        self.chain = chain._replace(stops=())

    @cached_property
    def modes(self):
        """Modes as columns of unit modal mass, ascending ω², and mean energies θ."""
        chain, n = self.chain, self.chain.n
        K = spring_matrix(chain.stiffness)
        roots = [mp.sqrt(mp.mpf(float(m))) for m in chain.mass]
        S = mp.matrix(n, n)
        for i in range(n):
            for j in range(n):
                S[i, j] = K[i, j] / (roots[i] * roots[j])
        squares, vectors = mp.eigsy(S)
        T = mp.matrix(n, n)
        for i in range(n):
            for j in range(n):
                T[i, j] = vectors[i, j] / roots[i]
        c = T.T * mp.matrix(chain.damping.tolist()) * T
        D = T.T * mp.matrix(chain.noise.tolist()) * T
        return T, list(squares), [D[i, i] / c[i, i] for i in range(n)]

    @cached_property
    def by_energy(self):
        """The reference by u(H), where damping terms leave one."""
        chain = self.chain
        proportional = np.allclose(
            chain.damping * chain.noise[0, 0], chain.noise * chain.damping[0, 0], rtol=1e-13
        ) and _terms_in_proportion(chain)
        # For one mode the averages over its phase and over its shell are the same.
        return EnergyReference(chain) if proportional or chain.n == 1 else None

    def of_energy(self, energy):
        if self.chain.terms:
            return self.by_energy and self.by_energy.of_energy(energy)
        return exponential_sum_density(self.modes[2], energy)

    def of_modal_energy(self, i, energy):
        if not self.chain.terms:
            theta = float(self.modes[2][i])
            p = np.exp(-energy / theta) / theta
            return p, REFERENCE * p * (1.0 + energy / theta)
        if self.by_energy is None:
            return None
        law, n = self.by_energy.law, self.chain.n
        if n == 1:
            return self.by_energy.of_energy(np.maximum(energy, 1e-300))
        whole = law.weyl(float(n), np.zeros(1), np.zeros(1))
        p = law.weyl(n - 1.0, np.asarray(energy, dtype=float), 0.0 * energy) / whole
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


def _terms_in_proportion(chain: Chain) -> bool:
    """Whether the terms are h₁ H D: every mass with noise has its own, in proportion."""
    gains = np.zeros_like(chain.damping)
    for term in chain.terms:
        if term.kind != "H":
            return False
        gains[term.i, term.i] += term.coefficient
    ratio = np.trace(gains) / np.trace(chain.noise)
    return bool(np.allclose(gains, ratio * chain.noise, rtol=1e-13))
