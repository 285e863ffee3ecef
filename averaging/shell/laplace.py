"""Density of states of many contact masses: inverse Laplace transform of the partition function.

The chain couples neighbours only, so that Z(β) = ∫exp(−βH) dq dp is one pass of integral operators
from its end to the wall, at a cost linear in the number of contact masses. With R = Z/Z_lin, where
Z_lin is Z of the chain without contact, and any β₀ > 0

``T/T_lin = 1 + Γ(n) H^(1−n)/(2πi) ∫ e^(βH) β^(−n) (R(β) − 1) dβ`` along Re β = β₀,

the phase volume the same with n + 1, T' with n − 1 in the place of n. The power of damping terms is
the same integral of moments of the displacements, by weights in the pass, with n + 1 or more in the
place of n. The integrand falls as |β|^(−n) (R − 1); the sum is well conditioned near β₀ = n/H.
``parts_of`` gives these moments, for integrals along rays as well.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from math import ceil, log
from typing import NamedTuple

import numpy as np
from scipy.special import erfc, gammaln
from threadpoolctl import threadpool_limits

from averaging.conditional import MOST_POINTS, WIDTHS_PER_PANEL, conditionals, stop_panels
from averaging.shell.rays import EnergyShell
from fpk.numeric.arrays import DEPTH, EPS, Array, Complexes, Integers
from fpk.numeric.errors import NotApplicable
from fpk.numeric.quadrature import panel_rule
from fpk.system.damping import gaussian_moment
from fpk.system.equivalent import power_given
from fpk.system.system import System

MOMENT_ROUND_OFF = 1e-14
"""Round-off of a sum of products of some dozens of Gaussian moments and factors, relative to the
sum of their absolute values."""
CHAIN_RULES = (15, 16)
"""Gauss points per panel of the comparison, which gives the error, and of the answer."""
RADIANS, RISE = 1.8, 16.0
"""Largest phase of exp(−i Im β V) between two points of the answer, in radians, at energies V of
the springs or a stop up to ``RISE``/β₀: sixteen points integrate 29 radians to 1e-13."""
MISSING = 1e-13
"""Relative size of the nearest alias of the trapezoidal rule, T(H + 2π/step) e^(−2πβ₀/step) or the
same of the power times T, and of the integrand at the end of a line."""
LINE_ENDS = (1.6, 16.0)
"""A line Re β = β₀ ends at Im β = 1.6 (``MISSING`` R)^(−1/m) β₀, R = Z/Z_lin at its beginning, at
most at 16 β₀. Measured with Hertz stops and n = 4 to 30 masses, the rest of the integral is about
(1.6/end)^m, with m = 2n, and m = 2n + 3 if the systems with one contact mass are subtracted."""
LONG_LINE = 10.0
"""Im β/β₀ at the end of a line beyond which the systems with one contact mass are subtracted."""
CANCELLATION = (0.4, 3.5)
"""ln of the largest term over the sum, at the lowest and highest energy that a line of β serves.
Without any cancellation the end of the line would omit most."""
SHORTER = (0.6, 1.2, 1.8)
"""ln of the factors by which three shorter lines of β omit more of the integral; the largest
difference of their answers to the answer is the error of ending the line."""
LINE_SAFETY = 1.5
"""Factor on the sum of the errors of ending a line of β and of the rule over displacements: in
25 random chains with two contact masses, 3 to 20 masses and stops of 1e-2 to 1e5 of the springs'
stiffness the true error, against integrals along rays, was at most 0.8 of the sum."""
CHECKED = 4
"""Equal parts of a line of β, at whose ends the ``CHAIN_RULES`` over displacements are compared."""
ROWS = 32
"""Points of one mass at which the integral over the next mass is evaluated at once, for the cache:
all at once takes three times as long."""
LINE_WINDOW = (0.3, 3.6)
"""Share of a line of β on which the window, a factor of the integrand, is 1; steepness of its fall
to 0 at the end."""
MOST_RAY_MASSES = 10
"""Largest number of masses, plus a quarter of the highest degree of damping terms, for which two
contact masses are integrated along rays. Beyond, v^a r^k is so narrow that the error of 24 points
along a ray exceeds the stated error: 3 times for 12 masses, and for 9 with a term of degree 8."""


class Parts(NamedTuple):
    """Σ c_ij v_i v_j of the damping terms, averaged given the contact displacements q_c.

    With momenta and the other displacements Gaussian at the temperature 1/β it is a sum of parts
    H^energy · coefficient · β^(−j) · Π q_c^powers. The order Σ powers + 2 j is the same for all
    parts of a term, whose degree is order − 2 + 2 energy. Without contact the power is
    Σ_d g_d H^(1 + d/2) over the ``degrees`` d.
    """

    powers: Integers  # (parts, c)
    coefficient: Array  # (parts,)
    size: Array  # (parts,), sum of the absolute values of the terms of each coefficient
    orders: Integers  # (groups,); a group is all parts of one degree and order
    of_group: Array  # (parts, groups), 1 if the part is in the group, else 0
    mean: Array  # (groups,), the mean without contact at β = 1
    spread: Array  # (groups,), a bound of |mean|
    degrees: Integers  # of the damping terms, ascending
    of_degree: Array  # (groups, degrees), Γ(n)/Γ(n + order/2) if the group is of the degree, else 0
    free: Array  # (degrees,), g_d without contact
    scale: Array  # (degrees,), a bound of |g_d| from the spread
    along: Integers  # (integrals, 2), distinct pairs (Σ powers, j) of the parts
    column: Integers  # (parts,), index of each part's pair
    rest: Array  # (parts,), Γ(N/2)/Γ(N/2 + j), N = 2n − c, see ``parts_of``


def parts_of(system: System) -> Parts:
    """Return the parts of all damping terms of ``system``.

    On an energy shell, given the contact displacements, the N = 2n − c numbers x = (√m v, K^½ ξ), ξ
    the other displacements, are uniform on the sphere ½|x|² = H − V_red: a moment of degree 2j is
    (H − V_red)^j Γ(N/2)/Γ(N/2 + j) times the moment of standard normal numbers.
    """
    keys, values = power_given(system, system.damping_terms)
    groups, group = np.unique(keys[:, :2], axis=0, return_inverse=True)
    of_group = np.eye(len(groups))[group.ravel()]
    powers, (coefficient, size) = keys[:, 2:], values.T
    # Terms that cancel leave round-off: set to 0, with its size still in ``size``.
    coefficient = np.where(np.abs(coefficient) > MOMENT_ROUND_OFF * size, coefficient, 0.0)
    L = system.fact(EnergyShell).L
    mean, square = (
        np.array([gaussian_moment(L @ L.T, tuple(row)) for row in (k * powers).tolist()])
        for k in (1, 2)
    )
    mean, spread = (coefficient * mean) @ of_group, (size * square**0.5) @ of_group
    degree, orders = groups.T
    degrees = np.unique(degree)
    rest = np.exp(gammaln(system.n) - gammaln(system.n + 0.5 * orders))
    of_degree = rest[:, None] * (degree[:, None] == degrees)
    free, scale = mean @ of_degree, spread @ of_degree
    free = np.where(np.abs(free) > MOMENT_ROUND_OFF * scale, free, 0.0)
    total, half_n = powers.sum(axis=1), system.n - 0.5 * powers.shape[1]
    j = (of_group @ orders - total).astype(int) // 2
    along, column = np.unique(np.stack([total, j], axis=1), axis=0, return_inverse=True)
    rest = np.exp(gammaln(half_n) - gammaln(half_n + j))
    found = coefficient, size, orders, of_group, mean, spread, degrees, of_degree, free, scale
    return Parts(powers, *found, along, column.ravel(), rest)


class PartitionLines:
    """T, phase volume, T' and damping power of the shell, from values of Z(β) on lines Re β = β₀.

    A line is evaluated when an energy first needs it, and serves a range of energies above n/β₀ set
    by ``CANCELLATION``. If a line would be long, with few masses, the systems with the contacts of
    one mass alone are subtracted: their averages follow along rays, and the rest falls faster.
    """

    def __init__(self, system: System) -> None:
        """Compute the step and the range of a line; evaluates no line."""
        self.system, self.n, self.masses = system, system.n, system.contact_masses
        self.springs = np.array([law.precision for law in conditionals(system, self.masses)])
        self.unit = max(system.fact(EnergyShell).contact_energies) or 1.0
        # At H = ρ n/β₀ the largest term exceeds the sum by the factor exp(n (ρ − 1 − ln ρ)).
        shares = np.linspace(1.0, 80.0, 8000)
        loss = self.n * (shares - 1.0 - np.log(shares))
        self.first, last = np.interp(CANCELLATION, loss, shares).tolist()
        self.factor = last / self.first
        self.parts = parts = system.fact(parts_of)
        most = self.n + 0.5 * max(parts.orders, default=0)
        alias = self.n * shares - most * np.log1p(shares / self.first)
        self.step = 2.0 * np.pi / float(shares[np.argmax(alias > -log(MISSING))])
        self.free, self.size = np.append(1.0, parts.mean), np.append(1.0, parts.spread)
        self.alone: list[System] = []
        if self._end(1.0) > LONG_LINE:
            touching = ([c for c in system.contacts if c.index == i] for i in self.masses)
            self.alone = [replace(system, contacts=tuple(own)) for own in touching]
        self.lines: dict[int, tuple[Complexes, Complexes, Array, float]] = {}

    def __call__(self, energy: Array, alone: Callable[[System, Array], Array]) -> Array:
        """Return the columns (energies, 2, 3 + degrees) of ``shell_columns`` at ``energy``.

        ``alone`` computes the same for a system with one contact mass. Raises ``NotApplicable`` if
        two contact masses are tied too stiffly (``_grids``).
        """
        # (row of the line, m) of T/T_lin, Φ/Φ_lin, T'/T_lin' and the power times T/T_lin of each
        # group: the inverse transform is relative to H^(n − 1 + m/2)/Γ(n + m/2).
        rows = [(0, 0), (0, 2), (0, -2), *enumerate(self.parts.orders.tolist(), start=1)]
        both = np.empty((energy.size, 2, len(rows)))  # values and errors
        index = np.floor(np.log(energy / self.unit) / np.log(self.factor)).astype(int)
        for k in np.unique(index).tolist():
            if k not in self.lines:
                with threadpool_limits(limits=1, user_api="blas"):  # the matrices are small
                    self.lines[k] = self._line(self.first * self.n / (self.unit * self.factor**k))
            (beta, change, error, known), here = self.lines[k], index == k
            # Windows that end the line, and end it earlier. A window that is flat at Im β = 0
            # changes T only by parts that are not smooth on the scale 1/(its end).
            ends = 1.0 - np.array([0.0, *SHORTER])[:, None] / (2.0 * self.n)
            flat, steepness = LINE_WINDOW
            share = (np.linspace(0.0, 1.0, beta.size) / ends - flat) / (1.0 - flat)
            window = 0.5 * erfc(steepness * (2.0 * share - 1.0))
            window[:, 0] *= 0.5
            s = energy[here, None] * beta
            size = energy[here, None] * (beta[1] - beta[0]).imag / np.pi
            for at, (row, order) in enumerate(rows):
                power = self.n + 0.5 * order
                terms = size * np.exp(s + gammaln(power) - power * np.log(s))
                by_window = (terms * change[row]).real @ window.T
                missing = np.abs(by_window[:, 1:] - by_window[:, :1]).max(axis=1)
                both[here, 0, at] = known * self.free[row] + by_window[:, 0]
                both[here, 1, at] = LINE_SAFETY * (missing + np.abs(terms) @ error[row])
        both = np.concatenate([both[..., :3], both[..., 3:] @ self.parts.of_degree], axis=-1)
        values, errors = np.swapaxes(both, 0, 1)
        free = np.array([1.0, 1.0, 1.0, *(self.parts.mean @ self.parts.of_degree)])
        for own in self.alone:
            x, dx = np.swapaxes(alone(own, energy), 0, 1)
            states, relative = x[:, :1], dx[:, :1]
            x[:, 2:3] /= self.n - 1.0
            values += np.hstack([x[:, :2], states * x[:, 2:]]) - free
            errors[:, :2] += relative * x[:, :2]
            errors[:, 3:] += (dx[:, 3:] + np.abs(x[:, 3:]) * relative) * states
        states = values[:, :1].copy()
        errors[:, :2] = np.max(errors[:, :2] / values[:, :2], axis=1, keepdims=True)
        values[:, 2:] /= states
        values[:, 2] *= self.n - 1.0
        errors[:, 3:] = errors[:, 3:] / states + np.abs(values[:, 3:]) * errors[:, :1]
        return both

    def _end(self, ratio: float) -> float:
        """Return Im β/β₀ at the end of a line Re β = β₀; ``ratio`` is R at its beginning."""
        order = 2.0 * self.n + (3.0 if self.alone else 0.0)
        return float(min(LINE_ENDS[0] * (MISSING * ratio) ** (-1.0 / order), LINE_ENDS[1]))

    def _line(self, real: float) -> tuple[Complexes, Complexes, Array, float]:
        """Return the points of the line Re β = ``real``, functions to invert, errors, ``known``.

        Functions and errors are (rows, points), of R and the transforms of the damping power, from
        which ``known`` (0 or 1) times the values without contact is subtracted.
        """
        end = self._end(1.0)
        both = np.array([real, complex(real, real * end)])
        (least, far), *_ = np.abs(self._transforms(self.system, both, self._grids(real, end)[0]))
        end = self._end(least / max(far, least))
        count = CHECKED * ceil(self.n * end / self.step / CHECKED)
        beta = np.empty(count + 1, dtype=complex)
        beta.real, beta.imag = real, real * end * np.arange(count + 1) / count
        lower, rule = self._grids(real, end)
        change = self._transforms(self.system, beta, rule)
        checked = slice(None, None, count // CHECKED)
        every = np.arange(count + 1)
        each = np.abs(self._transforms(self.system, beta[checked], lower) - change[:, checked])
        error = np.array([np.interp(every, every[checked], row) for row in each])
        # Of R and R − 1 the smaller is inverted.
        known = 1.0 if self.alone or least > 0.5 else 0.0
        largest = np.maximum(np.abs(change), self.size[:, None] * np.abs(change[0]))
        error += EPS * (count * largest + known * self.size[:, None])
        change -= known * self.free[:, None]
        for own, displacements in zip(self.alone, rule, strict=False):
            change -= self._transforms(own, beta, [displacements]) - self.free[:, None]
        return beta, change, error, known

    def _transforms(
        self, system: System, beta: Complexes, grids: Sequence[tuple[Array, Array]]
    ) -> Complexes:
        """Return R, and for each group of ``parts`` R β^(order/2) times its mean power without H^e.

        They are (1 + groups, beta.size) at equidistant ``beta``. ``grids`` are displacements and
        weights, (q,) each, of each contact mass of ``system``.
        """
        parts, masses = system.fact(parts_of), system.contact_masses
        both = np.vstack([np.zeros((1, len(masses)), dtype=np.int64), parts.powers])
        powers, column = np.unique(both, axis=0, return_inverse=True)
        f: Complexes = np.ones((beta.size, 1, len(powers)), dtype=complex)
        springs = [law.precision for law in conditionals(system, masses)]
        befores = [np.zeros(1), *(q for q, _ in grids[:-1])]
        links = zip(masses, springs, grids, befores, powers.T, strict=True)
        for mass, stiffness, (q, weights), before, power in reversed(list(links)):
            g = np.exp(-beta[:, None] * system.contact_energy(mass, q)) * weights
            g = f * g[:, :, None] * q[:, None] ** power
            f = np.empty((beta.size, before.size, len(powers)), dtype=complex)
            reach = np.sqrt(2.0 * DEPTH / (beta[0].real * stiffness))
            for rows in np.array_split(np.arange(before.size), ceil(before.size / ROWS)):
                x = before[rows, None]
                low, high = np.searchsorted(q, [x[0, 0] - reach, x[-1, 0] + reach])
                height = 0.5 * stiffness * (x - q[low:high]) ** 2
                kernel, turn = (np.exp(-b * height) for b in (beta[0], beta[1] - beta[0]))
                for k in range(beta.size):
                    f[k, rows] = kernel @ g[k, low:high]
                    kernel *= turn
            f *= np.sqrt(beta * stiffness / (2.0 * np.pi))[:, None, None]
        moments = f[:, 0] * beta[:, None] ** (0.5 * powers.sum(axis=1))
        first, *others = moments.T[column.ravel()]
        of_parts = np.reshape(others, (-1, beta.size)) * parts.coefficient[:, None]
        return np.vstack([first[None], parts.of_group.T @ of_parts])

    def _grids(self, real: float, end: float) -> list[list[tuple[Array, Array]]]:
        """Return displacements and weights of each mass by both ``CHAIN_RULES``.

        The outer list is over the rules, the inner over the contact masses. They serve β from
        ``real`` to ``real`` (1 + i ``end``). Next to a stop they are Gauss points in the root of
        the overlap, in which the contact energy of a Hertz law is a polynomial. Raises
        ``NotApplicable`` if a mass needs more than ``MOST_POINTS`` points.
        """
        turns = CHAIN_RULES[1] * RADIANS / end
        longest = min(WIDTHS_PER_PANEL, turns / (2.0 * RISE) ** 0.5)
        levels = [1.0]  # contact energies at which panels end, in units of 1/real
        while levels[-1] < DEPTH:
            levels.append(levels[-1] + min(levels[-1], turns if levels[-1] < RISE else DEPTH))
        energies = [level / real for level in levels]
        grids: list[list[tuple[Array, Array]]] = [[] for _ in CHAIN_RULES]
        for j, mass in enumerate(self.masses):
            width = longest / (real * float(self.springs[j : j + 2].sum())) ** 0.5
            nodes = stop_panels(self.system, mass, width=width, end=DEPTH / real, levels=energies)
            count = ceil((nodes[-1] - nodes[0]) / width) * CHAIN_RULES[1]
            if count > MOST_POINTS:
                raise NotApplicable(
                    f"mass {mass + 1} is tied too stiffly to another contact mass: the passes along"
                    f" the chain would take {count} points of it, {MOST_POINTS} at the most"
                )
            stops = [stop for stop in self.system.stops if stop.index == mass]
            for of_mass, points in zip(grids, CHAIN_RULES, strict=True):
                q, weights = panel_rule(nodes, points)
                for stop in stops:
                    overlap = stop.sign * nodes - stop.clearance
                    middle, root = overlap[1:] + overlap[:-1], np.sqrt(np.maximum(overlap, 0.0))
                    near = (middle > 0.0) & (middle < 2.0 * stop.overlap_at(1.0 / real))
                    s, ds = panel_rule(root, points)
                    q[near] = stop.sign * (stop.clearance + s[near] ** 2)
                    weights[near] = 2.0 * s[near] * np.abs(ds[near])
                of_mass.append((q.ravel(), weights.ravel()))
        return grids


def by_lines(system: System) -> bool:
    """Return whether shell averages are computed from the partition function, not along rays.

    True for three or more contact masses, and for two in a chain beyond ``MOST_RAY_MASSES``.
    """
    count = len(system.contact_masses)
    degree = max((term.degree for term in system.damping_terms), default=0)
    return count > 2 or (count == 2 and system.n + 0.25 * degree > MOST_RAY_MASSES)
