"""Reference densities that depend on the total energy, ρ = u(H): Eqs. (7), (11), (22), (29), (30).

Written from the equations with NumPy alone. With N quadratic coordinates besides the contact masses
(n momenta and the masses without contact) and V the potential minimised over these,
``p(H) ~ u(H) ∫(H − V)^(N/2 − 1)/Γ(N/2) dq_c`` and ``p(q) ~ ∫W(V) dq_hidden`` with the Weyl integral
``W_ν(E) = ∫u(E + x) x^(ν − 1)/Γ(ν) dx``; constants cancel in the normalisation by W itself.
"""

from functools import cached_property
from itertools import pairwise
from math import gamma
from typing import NamedTuple

import numpy as np
from attack_quadrature import adaptive, distance_to_level, increasing_root, pieces
from numpy.polynomial import chebyshev

NATS = 60.0
"""Fall of a density at which integrals over it end: e^-60 = 9e-27 of the maximum."""
REFERENCE = 1e-12
"""Relative error of the references where nothing worse is known."""


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

    def contact_energy(self, i, q):
        total = np.zeros_like(q)
        for s in self.stops:
            if s.index == i:
                overlap = np.maximum(s.sign * q - s.clearance, 0.0)
                total = total + s.stiffness / (s.exponent + 1.0) * overlap ** (s.exponent + 1.0)
        return total

    def contact_force(self, i, q):
        total = np.zeros_like(q)
        for s in self.stops:
            if s.index == i:
                overlap = np.maximum(s.sign * q - s.clearance, 0.0)
                total = total + s.sign * s.stiffness * overlap**s.exponent
        return total


class Reduced:
    """Potential of some masses of a chain, the others at their minimum: again a chain.

    Springs in series join neighbours; what hangs beyond the last mass exerts no force. Nothing
    cancels, however different the springs are.
    """

    def __init__(self, chain, masses):
        self.chain, self.masses = chain, masses
        ends = [-1, *masses]
        self.k = [1.0 / np.sum(1.0 / chain.stiffness[a + 1 : b + 1]) for a, b in pairwise(ends)]

    def __call__(self, *x):
        total, last = 0.0, 0.0
        for i, k, q in zip(self.masses, self.k, x, strict=True):
            total = total + 0.5 * k * (q - last) ** 2 + self.chain.contact_energy(i, q)
            last = q
        return total

    def slope(self, a, *x):
        """∂V/∂x_a."""
        before = x[a - 1] if a else 0.0
        force = self.k[a] * (x[a] - before) + self.chain.contact_force(self.masses[a], x[a])
        if a + 1 < len(x):
            force = force - self.k[a + 1] * (x[a + 1] - x[a])
        return force

    def bend(self, a):
        """∂²V/∂x_a² without contact."""
        return self.k[a] + (self.k[a + 1] if a + 1 < len(self.k) else 0.0)

    def rest(self, a, *x):
        """x_a that minimises V, the others fixed: between 0 and the place without contact."""
        before = x[a - 1] if a else np.zeros_like(x[-1] if a != len(x) - 1 else x[0])
        pull = self.k[a] * before
        if a + 1 < len(x):
            pull = pull + self.k[a + 1] * x[a + 1]
        free = pull / self.bend(a)

        def slope(y):
            return self.slope(a, *x[:a], y, *x[a + 1 :])

        return increasing_root(slope, np.minimum(free, 0.0), np.maximum(free, 0.0))

    def cuts(self, a, low, high):
        """Ends and stops of mass a between them, (..., m + 1)."""
        stops = [s.sign * s.clearance for s in self.chain.stops if s.index == self.masses[a]]
        parts = [low, *(np.clip(s, low, high) for s in sorted(set(stops))), high]
        return np.stack(np.broadcast_arrays(*parts), axis=-1)


class Gibbs:
    """u = exp(−α H): every Weyl integral is α^−ν exp(−α E)."""

    joints = ()

    def __init__(self, alpha):
        self.alpha = alpha

    def psi(self, energy):
        return self.alpha * energy

    def weyl(self, order, energy, offset):
        return self.alpha**-order * np.exp(offset - self.alpha * energy)

    def level(self, psi):
        return psi / self.alpha


class General:
    """u = exp(−Ψ(H)), Ψ of slope >= α₀ > 0 and smooth but at ``joints``."""

    def __init__(self, psi, alpha, joints=()):
        self.psi, self.alpha, self.joints = psi, alpha, joints

    def weyl(self, order, energy, offset):
        energy = np.asarray(energy, dtype=float)
        base = self.psi(energy)
        if order == 0.0:
            return np.exp(offset - base)
        end = distance_to_level(
            lambda x: self.psi(energy + x) - base - NATS, np.full_like(energy, 1e-3 / self.alpha)
        )
        joints = [np.clip(j - energy, 0.0, end) for j in self.joints]
        # x^(ν−1) is singular or peaked at 0 beside the fall of u: two more cuts.
        cuts = np.sort(np.stack([0 * end, 0.02 * end, 0.2 * end, *joints, end], axis=-1), axis=-1)

        def f(x):
            fall = self.psi(energy[..., None, None] + x) - base[..., None, None]
            return x ** (order - 1.0) * np.exp(-fall) / gamma(order)

        return np.exp(offset - base) * pieces(f, cuts)

    def level(self, psi):
        """The energy with Ψ = psi."""
        target = np.asarray(psi, dtype=float)
        return distance_to_level(
            lambda x: self.psi(x) - target, np.full_like(target, 1e-3 / self.alpha)
        )


class Graded:
    """A function on (0, end) by Chebyshev polynomials on panels graded to its joints."""

    DEGREE = 24

    def __init__(self, f, joints, end):
        # Beyond so deep a layer a power of the distance to the joint is far below round-off.
        layers = 0.2 ** np.arange(0, 20.0)
        places = [0.0, *(j for j in joints if 0.0 < j < end)]
        nodes = [0.0, end, *np.linspace(0.0, end, 41), *(end * layers)]
        for j in places[1:]:
            nodes += [j, *(j - j * layers), *(j + (end - j) * layers)]
        nodes = np.unique(nodes)
        self.nodes = nodes[np.append(True, np.diff(nodes) > 1e-15 * end)]
        t = chebyshev.chebpts1(self.DEGREE + 1)
        left, right = self.nodes[:-1, None], self.nodes[1:, None]
        x = 0.5 * (left + right) + 0.5 * (right - left) * t
        c = chebyshev.chebfit(t, f(x.ravel()).reshape(x.shape).T, self.DEGREE)
        self.integral = chebyshev.chebint(c, lbnd=-1) * (0.5 * np.diff(self.nodes))
        self.below = np.append(0.0, np.cumsum(self.integral.sum(axis=0)))
        self.slope = c[:, -1].sum()

    def antiderivative(self, x):
        flat = np.asarray(x, dtype=float).ravel()
        k = np.clip(np.searchsorted(self.nodes, flat, side="right") - 1, 0, self.nodes.size - 2)
        left, right = self.nodes[k], self.nodes[k + 1]
        t = np.clip((2.0 * flat - left - right) / (right - left), -1.0, 1.0)
        value = self.below[k]
        for at in range(0, flat.size, 100_000):  # each point has coefficients of its own
            part = slice(at, at + 100_000)
            value[part] += chebyshev.chebval(t[part], self.integral[:, k[part]], tensor=False)
        # Beyond the end, which lies far out, the function is continued by its last value.
        value += self.slope * np.maximum(flat - self.nodes[-1], 0.0)
        return value.reshape(np.shape(x))


class EnergyReference:
    """Densities of H, q_i and p_i that belong to the averaged energy process of a chain."""

    def __init__(self, chain):
        self.chain = chain
        self.contacts = Reduced(chain, chain.touching)
        self.quadratic = 2 * chain.n - len(chain.touching)
        self.error = REFERENCE

    @cached_property
    def law(self):
        chain = self.chain
        noise = float(np.sum(np.diag(chain.noise) / chain.mass))
        alpha = float(np.sum(np.diag(chain.damping) / chain.mass)) / noise
        if not chain.terms:
            return Gibbs(alpha)
        gain = sum(t.coefficient / chain.mass[t.i] for t in chain.terms if t.kind == "H") / noise
        rest = [t for t in chain.terms if t.kind != "H"]
        if not rest:
            return General(lambda H: alpha * H + 0.5 * gain * H * H, alpha)
        joints = sorted({self.contact_energy_of(s) for s in chain.stops})
        # Ψ >= αH, so that at this energy nothing of u is left.
        end = (3.0 * NATS) / alpha

        def added(energy):
            return sum(self.term_average(t, energy) for t in rest) / noise

        table = Graded(added, joints, end)
        self.error = 1e-11
        return General(
            lambda H: alpha * H + 0.5 * gain * H * H + table.antiderivative(H), alpha, joints
        )

    def contact_energy_of(self, stop):
        """Least energy at which the stop is reached."""
        return 0.5 * stop.clearance**2 / float(np.sum(1.0 / self.chain.stiffness[: stop.index + 1]))

    def term_average(self, term, energy):
        """⟨term · v_i²⟩ T/Φ: microcanonical averages of monomials by Gaussian moments and Γ.

        ∫δ(H − V − ½|z|²) g(z) dz = (2π)^(N/2) E[g] (H − V)^(N/2 + k − 1)/Γ(N/2 + k) for N
        quadratic coordinates and a g of degree 2k in them, z standard normal in E.
        """
        chain, N = self.chain, self.quadratic
        factor = term.coefficient / chain.mass[term.i]
        squares = self.shell(energy, 0.5 * N + 1.0)
        higher = self.shell(energy, 0.5 * N + 2.0) / squares
        if term.kind == "v":
            return factor * (3.0 if term.a == term.i else 1.0) / chain.mass[term.a] * higher
        series = np.cumsum(1.0 / chain.stiffness)
        if not chain.touching:
            return factor * series[term.a] * higher
        (c,), a = chain.touching, term.a
        between = float(np.sum(1.0 / chain.stiffness[min(a, c) + 1 : max(a, c) + 1]))
        mean, spread = (series[a] / series[c], between * series[a] / series[c])
        if a >= c:
            mean, spread = 1.0, between
        moved = self.shell(energy, 0.5 * N + 1.0, power=2) / squares
        return factor * (mean**2 * moved + spread * higher)

    def shell(self, energy, order, power=0):
        """∫q_c^power (H − V)₊^(order − 1)/Γ(order) dq_c at energies (points,), one contact mass."""
        energy = np.asarray(energy, dtype=float)
        if not self.chain.touching:
            return energy ** (order - 1.0) / gamma(order)
        V = self.contacts
        reach = np.sqrt(2.0 * energy / V.k[0])
        right = increasing_root(lambda x: V(x) - energy, 0.0 * reach, reach)
        left = increasing_root(lambda x: V(-x) - energy, 0.0 * reach, reach)

        def f(x):
            free = np.maximum(energy[:, None, None] - V(x), 0.0)
            return x**power * free ** (order - 1.0) / gamma(order)

        return pieces(f, V.cuts(0, -left, right))

    def states(self, energy):
        """∫(H − V)₊^(N/2 − 1)/Γ(N/2) dq_c with its error, energies (points,)."""
        order, count = 0.5 * self.quadratic, len(self.chain.touching)
        if count == 2:
            return self.states_of_two(energy, order)
        if count == 1 and order < 1.0:
            value = self.period(energy)
            # Beside the energy of contact the period grows like a root: round-off of H counts.
            moved = [self.period(energy * (1.0 + s * 4e-16)) - value for s in (-1.0, 1.0)]
            return value, REFERENCE * value + np.max(np.abs(moved), axis=0)
        value = self.shell(energy, order)
        return value, REFERENCE * value

    def period(self, energy):
        """The integral of n = 1, singular at the turning points X, over distances d = X − |q|.

        H − V is formed as V(X) − V(X − d), term by term without cancellation.
        """
        k, total = self.contacts.k[0], 0.0
        for sign in (1.0, -1.0):
            X, stops = np.sqrt(2.0 * energy / k), [s for s in self.chain.stops if s.sign == sign]
            overlap = None
            if stops:
                (s,) = stops
                room = energy - 0.5 * k * s.clearance**2

                def rise(x, s=s, room=room):
                    contact = s.stiffness / (s.exponent + 1.0) * x ** (s.exponent + 1.0)
                    return x * (k * s.clearance + 0.5 * k * x) + contact - room

                overlap = increasing_root(rise, 0.0 * X, np.where(room > 0.0, X, 0.0))
                X = np.where(room > 0.0, s.clearance + overlap, X)
            cuts = [0.0 * X, X] if overlap is None else [0.0 * X, overlap, X]

            def f(d, X=X[:, None, None], stops=stops, overlap=overlap):
                free = 0.5 * k * d * (2.0 * X - d)
                if stops:
                    (s,), o = stops, overlap[:, None, None]
                    e = s.exponent + 1.0
                    share = np.where(d < o, -np.expm1(e * np.log1p(-np.minimum(d / o, 1.0))), 1.0)
                    free = free + s.stiffness / e * np.where(o > 0.0, share * o**e, 0.0)
                return 1.0 / np.sqrt(free)

            total = total + pieces(f, np.stack(cuts, axis=-1))
        return total / np.sqrt(np.pi)

    def states_of_two(self, energy, order):
        V, energy = self.contacts, np.asarray(energy, dtype=float)

        def least(x):
            return V(x, V.rest(1, x, x))

        reach = np.sqrt(2.0 * energy / V.k[0])
        right = increasing_root(lambda x: least(x) - energy, 0.0 * reach, reach)
        left = increasing_root(lambda x: least(-x) - energy, 0.0 * reach, reach)
        cuts = [V.cuts(0, -left, right)]
        for s in self.chain.stops:  # where the stop of the second mass enters the shell
            if s.index != V.masses[1]:
                continue
            place = np.full_like(energy, s.sign * s.clearance)
            bottom = V.rest(0, 0.0 * place, place)
            inside = V(bottom, place) < energy
            for sign in (1.0, -1.0):
                far = distance_to_level(
                    lambda d, place=place, bottom=bottom, sign=sign, inside=inside: np.where(
                        inside, V(bottom + sign * d, place) - energy, 1.0
                    ),
                    reach,
                )
                cuts.append(np.clip(bottom + sign * far, -left, right)[:, None])
        cuts = np.sort(np.concatenate(cuts, axis=1), axis=1)

        def inner(owner, x):
            H = energy[owner][:, None]
            rest = V.rest(1, x, x)
            room = np.maximum(H - V(x, rest), 0.0)
            ends = []
            for sign in (-1.0, 1.0):
                most = np.sqrt(2.0 * room / V.k[1]) * (1.0 + 1e-12)
                reach = increasing_root(
                    lambda d, sign=sign: V(x, rest + sign * d) - H, 0.0 * most, most, steps=60
                )
                ends.append(rest + sign * reach)
            if order == 1.0:
                return ends[1] - ends[0]

            def f(y):
                free = np.maximum(H[..., None, None] - V(x[..., None, None], y), 0.0)
                return free ** (order - 1.0) / gamma(order)

            return pieces(f, V.cuts(1, *ends))

        value, error = adaptive(inner, cuts, rtol=1e-11)
        return value, error + 1e-11 * np.abs(value)

    def marginal(self, masses, values, order, energy):
        """∫W_order(V + energy) over the contact masses that are not in ``masses``, at ``values``.

        ``masses`` has one mass or none, ``values`` (points,) its displacements, ``energy``
        (points,) adds to V. Relative to exp(−Ψ) at the least V + energy; returns ln of that too.
        """
        hidden = [c for c in self.chain.touching if c not in masses]
        kept = sorted({*masses, *hidden})
        V, law = Reduced(self.chain, tuple(kept)), self.law
        fixed = {kept.index(m): values for m in masses}
        if not hidden:
            place = [values] if masses else []
            E = (V(*place) if masses else 0.0 * energy) + energy
            return law.weyl(order, E, law.psi(E)), -law.psi(E), 0.0 * energy

        free = [kept.index(h) for h in hidden]
        if len(free) == 1:
            return self._one_hidden(V, fixed, free[0], order, energy)
        return self._two_hidden(V, fixed, free, order, energy)

    def _one_hidden(self, V, fixed, a, order, energy, extra=()):
        law = self.law

        def at(y):
            more = (None,) * (np.ndim(y) - np.ndim(energy))
            arguments = dict(fixed) | {a: y}
            shaped = [
                np.asarray(arguments[j])[(..., *more)] if j != a else y for j in range(len(V.k))
            ]
            return V(*shaped) + energy[(..., *more)]

        others = [fixed.get(j, 0.0 * energy) for j in range(len(V.k))]
        rest = V.rest(a, *others)
        bottom = at(rest)
        top = law.level(law.psi(bottom) + NATS)
        scale = np.sqrt((top - bottom) / V.bend(a)) * 1e-3
        ends = [
            rest + s * distance_to_level(lambda d, s=s: at(rest + s * d) - top, scale)
            for s in (-1.0, 1.0)
        ]
        offset = law.psi(bottom)
        cuts = [V.cuts(a, *ends)]
        for joint in law.joints:  # where V passes an energy at which u is not smooth
            for s, end in zip((-1.0, 1.0), ends, strict=True):
                far = distance_to_level(
                    lambda d, s=s, j=joint: np.where(bottom < j, at(rest + s * d) - j, 1.0), scale
                )
                place = np.clip(rest + s * far, np.minimum(rest, end), np.maximum(rest, end))
                cuts.append(place[..., None])
        cuts = np.sort(np.concatenate(cuts, axis=-1), axis=-1)
        value = pieces(lambda y: law.weyl(order, at(y), offset[..., None, None]), cuts)
        return value, -offset, REFERENCE * value

    def _two_hidden(self, V, fixed, free, order, energy):
        law = self.law
        a, b = free  # outer, inner

        def with_rest(y):
            """Place of b at rest and V there, for a at y."""
            arguments = [fixed.get(j, 0.0 * y) for j in range(len(V.k))]
            arguments[a] = y
            # The place of b given the others; when they are not neighbours a does not matter.
            rest = V.rest(b, *arguments)
            arguments[b] = rest
            return arguments, V(*arguments) + energy

        def slope(y):
            return V.slope(a, *with_rest(y)[0])

        span = sum(np.abs(x) for x in fixed.values()) if fixed else 0.0 * energy
        rest = increasing_root(slope, -span - 1e-300, span + 1e-300)
        bottom = with_rest(rest)[1]
        top = law.level(law.psi(bottom) + NATS)
        scale = np.sqrt((top - bottom) / V.bend(a)) * 1e-3
        ends = [
            rest + s * distance_to_level(lambda d, s=s: with_rest(rest + s * d)[1] - top, scale)
            for s in (-1.0, 1.0)
        ]
        cuts = V.cuts(a, *ends)
        steps = np.linspace(0.0, 1.0, 9)
        mesh = ends[0][:, None] + (ends[1] - ends[0])[:, None] * steps
        cuts = np.sort(np.concatenate([cuts, mesh, rest[:, None]], axis=1), axis=1)
        offset = law.psi(bottom)

        def inner(owner, y):
            held = {j: np.broadcast_to(x[owner][:, None], y.shape) for j, x in fixed.items()}
            E = np.broadcast_to(energy[owner][:, None], y.shape)
            value, log, _ = self._one_hidden(V, held | {a: y}, b, order, E)
            return value * np.exp(log + offset[owner][:, None])

        value, error = adaptive(inner, cuts, rtol=1e-11)
        return value, -offset, error + REFERENCE * value

    @cached_property
    def norm(self):
        """(mantissa, ln, relative error) of ∫u over everything, in the units of ``marginal``."""
        value, log, error = self.marginal((), None, 0.5 * self.quadratic, np.zeros(1))
        return float(value[0]), float(log[0]), float(error[0] / value[0])

    def _normalised(self, value, log, error, extra):
        mantissa, log_norm, relative = self.norm
        scale = np.exp(log - log_norm + extra) / mantissa
        p = value * scale
        return p, error * scale + p * (relative + self.error)

    def of_energy(self, energy):
        """p(H) and its error."""
        energy = np.asarray(energy, dtype=float)
        p, error = np.zeros_like(energy), np.zeros_like(energy)
        inside = energy > 0.0
        if inside.any():
            H = energy[inside]
            value, doubt = self.states(H)
            result = self._normalised(value, -self.law.psi(H), doubt, 0.0)
            p[inside], error[inside] = result
        return p, error

    def of_displacement(self, i, q):
        """p(q_i) and its error."""
        q = np.asarray(q, dtype=float)
        new = i not in self.chain.touching
        # One quadratic coordinate fewer is left; its (2π)^½ and the determinants give the constant.
        order = 0.5 * (self.quadratic - (1 if new else 0))
        value, log, error = self.marginal((i,), q, order, np.zeros_like(q))
        extra = 0.0
        if new:
            extra = -0.5 * np.log(2.0 * np.pi * self.spread_given_contacts(i))
        return self._normalised(value, log, error, extra)

    def spread_given_contacts(self, i):
        """Variance of q_i at unit temperature, the contact masses held."""
        k = self.chain.stiffness
        below = max((c for c in self.chain.touching if c < i), default=-1)
        above = min((c for c in self.chain.touching if c > i), default=None)
        left = float(np.sum(1.0 / k[below + 1 : i + 1]))
        if above is None:
            return left
        right = float(np.sum(1.0 / k[i + 1 : above + 1]))
        return left * right / (left + right)

    def of_momentum(self, i, p):
        """p(p_i) and its error."""
        p, m = np.asarray(p, dtype=float), self.chain.mass[i]
        if isinstance(self.law, Gibbs):
            alpha = self.law.alpha
            value = np.sqrt(alpha / (2.0 * np.pi * m)) * np.exp(-0.5 * alpha * p * p / m)
            return value, 1e-14 * value
        order = 0.5 * (self.quadratic - 1)
        value, log, error = self.marginal((), None, order, 0.5 * p * p / m)
        return self._normalised(value, log, error, -0.5 * np.log(2.0 * np.pi * m))
