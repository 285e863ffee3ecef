"""Exact densities of one or two masses with stops on one of them, by quadrature of their own.

Where c_i/D_i is the same for all masses p(q, v) ~ exp(−H/kT), Eq. (7). Here it is integrated in
other variables than the program uses: nothing of it is imported.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

Array = np.ndarray

GAUSS = np.polynomial.legendre.leggauss(24)


def integral(f: Callable[[Array], Array], nodes: Array) -> float:
    """∫f over the panels between ``nodes``, each graded to both its ends by t³(10 − 15t + 6t²)."""
    x, w = GAUSS
    t = 0.5 + 0.5 * x
    share, slope = t**3 * (10.0 - 15.0 * t + 6.0 * t * t), 30.0 * (t * (1.0 - t)) ** 2
    length = np.diff(nodes)[:, None]
    return float(np.sum(f(nodes[:-1, None] + length * share) * length * slope * 0.5 * w))


@dataclass(frozen=True)
class Gibbs:
    """Two springs in series (one mass: one) and a mass between stops, at the temperature kT.

    ``mass`` (n,), ``stiffness`` (n,) of the chain, ``contact`` the mass that is stopped (from 0),
    ``stops`` rows (sign, clearance, stiffness B, exponent e): force B (overlap)^e.
    """

    mass: tuple[float, ...]
    stiffness: tuple[float, ...]
    kT: float
    contact: int
    stops: tuple[tuple[float, float, float, float], ...]

    @property
    def n(self) -> int:
        return len(self.mass)

    @property
    def spring(self) -> float:
        """Stiffness at the stopped mass, the others following: 1/Σ 1/k up to it."""
        return 1.0 / sum(1.0 / k for k in self.stiffness[: self.contact + 1])

    def energy(self, q: Array) -> Array:
        """Contact energy at the displacement of the stopped mass."""
        total = np.zeros_like(q)
        for sign, gap, B, e in self.stops:
            total += B * np.maximum(sign * q - gap, 0.0) ** (e + 1.0) / (e + 1.0)
        return total

    def potential(self, q: Array) -> Array:
        return 0.5 * self.spring * q * q + self.energy(q)

    def depth(self, stop: tuple[float, float, float, float], level: float) -> float:
        """Overlap at which the contact energy is ``level``."""
        _, _, B, e = stop
        return float((level * (e + 1.0) / B) ** (1.0 / (e + 1.0)))

    def nodes(self) -> Array:
        """Panels of q, fine in the layers beyond the stops; e^−45 of p is left out."""
        reach = np.sqrt(90.0 * self.kT / self.spring)
        points = [-reach, reach, *np.linspace(-reach, reach, 25)]
        for stop in self.stops:
            layer = self.depth(stop, 45.0 * self.kT) * np.linspace(0.0, 1.0, 25)
            points += [*(stop[0] * (stop[1] + layer))]
        points = np.unique(points)
        return points[np.abs(points) <= reach]

    def q(self, x: Array) -> Array:
        """p(q) of the stopped mass."""
        whole = integral(lambda q: np.exp(-self.potential(q) / self.kT), self.nodes())
        return np.exp(-self.potential(x) / self.kT) / whole

    def p(self, x: Array) -> Array:
        """p(p) of the stopped mass."""
        variance = self.mass[self.contact] * self.kT
        return np.exp(-0.5 * x * x / variance) / np.sqrt(2.0 * np.pi * variance)

    def states(self, energy: Array) -> Array:
        """∫ (H − V)^(n − 3/2) dq over where V <= H, (energies,): the density of states."""
        x, w = GAUSS
        t = 0.5 + 0.5 * x
        share, slope = t**3 * (10.0 - 15.0 * t + 6.0 * t * t), 30.0 * (t * (1.0 - t)) ** 2
        total = np.zeros_like(energy)
        for side in (-1.0, 1.0):
            end = self.turning_point(side, energy)
            gaps = sorted({s[1] for s in self.stops if s[0] == side and s[1] > 0.0})
            # Panels between the stops, and such as shrink towards the turning point.
            starts = [np.zeros_like(end), *(np.minimum(g, end) for g in gaps)]
            last = starts[-1]
            nodes = [*starts, *(end - (end - last) * 0.25**k for k in range(1, 24)), end]
            d = end[:, None] - np.stack(nodes, axis=1)  # descending distances
            length = d[:, :-1] - d[:, 1:]
            distance = d[:, 1:, None] + length[:, :, None] * share
            f = self.below(side, end, distance) ** (self.n - 1.5)
            total += 0.5 * np.einsum("epx,ep,x->e", f, length, slope * w)
        return total

    def turning_point(self, side: float, energy: Array) -> Array:
        """|q| at which the potential reaches the energies, on one side."""
        low, high = np.zeros_like(energy), np.sqrt(2.0 * energy / self.spring)
        for _ in range(200):
            middle = 0.5 * (low + high)
            above = self.potential(side * middle) > energy
            low, high = np.where(above, low, middle), np.where(above, middle, high)
        return low

    def below(self, side: float, end: Array, d: Array) -> Array:
        """H − V at distances d (energies, ...) from the turning points, not as a difference."""
        end = end.reshape(-1, *[1] * (d.ndim - 1))
        total = 0.5 * self.spring * d * (2.0 * end - d)
        for sign, gap, B, e in self.stops:
            if sign == side:
                over = np.maximum(end - gap, 1e-300)
                with np.errstate(divide="ignore"):
                    share = -np.expm1((e + 1.0) * np.log1p(-np.minimum(d / over, 1.0)))
                total += np.where(end > gap, B * over ** (e + 1.0) / (e + 1.0) * share, 0.0)
        return np.maximum(total, 1e-300)

    def H(self, x: Array) -> Array:
        """p(H)."""
        starts = [0.0, *sorted(self.touching())]
        nodes = [0.0]
        for a, b in zip(starts, [*starts[1:], 45.0 * self.kT], strict=True):
            nodes += [a + (b - a) * s for s in np.linspace(0.0, 1.0, 25)[1:] ** 3]
        nodes_ = np.unique([x for x in nodes if x <= 45.0 * self.kT])

        def f(H: Array) -> Array:
            values = self.states(np.maximum(H.ravel(), 1e-14 * self.kT)).reshape(H.shape)
            return values * np.exp(-H / self.kT)

        return f(x) / integral(f, nodes_)

    def touching(self) -> list[float]:
        """Energies H at which stops are touched."""
        return sorted({float(self.potential(np.array(s[0] * s[1]))) for s in self.stops})

    def modes(self) -> tuple[Array, Array]:
        """Shapes (n, modes), normalised to Tᵀ M T = 1, and angular frequencies."""
        k = np.diag(self.stiffness)
        if self.n == 2:
            k[0, 0] += self.stiffness[1]
            k[0, 1] = k[1, 0] = -self.stiffness[1]
        root = 1.0 / np.sqrt(self.mass)
        square, vectors = np.linalg.eigh(root[:, None] * k * root)
        return root[:, None] * vectors, np.sqrt(square)

    def touching_mode(self, mode: int) -> list[float]:
        """Energies of one mode alone at which it touches stops."""
        shapes, omega = self.modes()
        share = shapes[self.contact, mode]
        return sorted({0.5 * (omega[mode] * s[1] / share) ** 2 for s in self.stops})

    def H_mode(self, mode: int, x: Array) -> Array:
        """p(H_m): the phase of the mode is uniform, the displacement by the other is normal."""
        shapes, omega = self.modes()
        size = np.sqrt(2.0 * x) * abs(shapes[self.contact, mode]) / omega[mode]
        others = [m for m in range(self.n) if m != mode]
        spread = np.sqrt(self.kT * sum((shapes[self.contact, m] / omega[m]) ** 2 for m in others))
        # 1/Z: Z = ∫∫ exp(−(H_m + U)/kT), as p(q) has it.
        whole = integral(lambda q: np.exp(-self.potential(q) / self.kT), self.nodes())
        free = np.sqrt(2.0 * np.pi * self.kT / self.spring)
        values = []
        for a in size:
            if spread == 0.0:
                values.append(self._over_phase(a, lambda q: np.exp(-self.energy(q) / self.kT)))
                continue
            smooth = [self._over_normal(q, spread) for q in a * np.cos(PHASES)]
            values.append(float(np.dot(PHASE_WEIGHTS, smooth)))
        return np.array(values) * np.exp(-x / self.kT) * free / whole / self.kT

    def _over_phase(self, a: float, f: Callable[[Array], Array]) -> float:
        """Mean of f(a cos φ) over φ, with panels at the stops and in their layers."""
        points = [0.0, np.pi, *np.linspace(0.0, np.pi, 41)]
        for stop in self.stops:
            layer = self.depth(stop, 45.0 * self.kT) * np.linspace(0.0, 1.0, 25) ** 2
            q = stop[0] * (stop[1] + layer)
            points += [*np.arccos(q[np.abs(q) < a] / a)] if a > 0.0 else []
        return integral(lambda phi: f(a * np.cos(phi)), np.unique(points)) / np.pi

    def _over_normal(self, q: float, spread: float) -> float:
        """Mean of exp(−U(q + spread z)/kT) over a normal z."""
        nodes = [*(q + spread * np.linspace(-9.5, 9.5, 20))]
        for stop in self.stops:
            layer = self.depth(stop, 45.0 * self.kT) * np.linspace(0.0, 1.0, 13) ** 2
            nodes += [*(stop[0] * (stop[1] + layer))]
        nodes_ = np.unique(nodes)
        nodes_ = nodes_[np.abs(nodes_ - q) <= 9.5 * spread]

        def f(x: Array) -> Array:
            z = (x - q) / spread
            return np.exp(-0.5 * z * z - self.energy(x) / self.kT)

        return integral(f, nodes_) / np.sqrt(2.0 * np.pi) / spread

    def mean(self, f: Callable[[Array], Array]) -> float:
        """E f(q) of the stopped mass."""
        return integral(lambda q: f(q) * self.q(q), self.nodes())

    def upcrossings(self, level: float) -> float:
        """Upcrossings per unit time of a displacement of the stopped mass."""
        speed = np.sqrt(self.kT / (2.0 * np.pi * self.mass[self.contact]))
        return float(self.q(np.array([level]))[0] * speed)


PHASES, PHASE_WEIGHTS = (
    0.5 * np.pi + 0.5 * np.pi * np.polynomial.legendre.leggauss(96)[0],
    0.5 * np.polynomial.legendre.leggauss(96)[1],
)
