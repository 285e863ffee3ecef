"""Density of states of many contact masses: inverse Laplace transform of the partition function.

The chain couples neighbours only, so that Z(β) = ∫exp(−βH) dq dp is one pass of integral operators
from its end to the wall, at a cost linear in the number of contact masses. With R = Z/Z_lin, Z_lin
that of the chain without contact, and any β₀ > 0

``T/T_lin = 1 + Γ(n) H^(1−n)/(2πi) ∫ e^(βH) β^(−n) (R(β) − 1) dβ`` along Re β = β₀,

the phase volume the same with n + 1 and T' with n − 1 in the place of n. What contact adds beyond a
stop falls along the line like |β|^(−n) times what R − 1 falls: well conditioned near β₀ = n/H. The
power of damping terms is the same of moments of the displacements, with weights in the pass, and
n + 1 or more in the place of n.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from math import ceil
from typing import NamedTuple

import numpy as np
from scipy.special import erfc, gammaln

from averaging.conditional import conditionals
from averaging.hidden import DEPTH, stop_panels
from averaging.shell.energy_shell import EnergyShell
from averaging.shell.parts import parts_of
from averaging.shell.passes import passed
from fpk.arrays import EPS, Array, Complexes
from fpk.errors import NotApplicable
from fpk.quadrature import panel_rule
from fpk.system import System

POINTS = (15, 16)
"""Gauss points per panel, of the rule that estimates the error and of the answer."""
WIDTHS = 1.8
"""Longest panel in units of the width of a displacement between its neighbours at β₀."""
RADIANS, RISE = 1.8, 16.0
"""Most radians of exp(−i Im β V) between two points of the answer where V, of springs or of a stop,
is up to ``RISE``/β₀: sixteen points integrate 29 radians to about 1e-13 of what is left there."""
ENDS = (1.6, 1e-13, 16.0)
"""A line ends at Im β = 1.6 (1e-13 R)^(−1/m) β₀, R at its beginning, at most at 16 β₀: what is
missing beyond ``end`` was measured to be about (1.6/end)^m, with Hertz stops and n = 4 to 30
masses; m is 2n, and 2n + 3 where the systems with one contact mass are taken off."""
LONG = 10.0
"""End of a line over β₀ beyond which the systems with one contact mass are taken off."""
ALIAS = 30.0
"""Nats by which the trapezoidal rule's nearest alias, T(H + 2π/step) e^(−2πβ₀/step) or the same of
the power times T, is down."""
NATS = (0.4, 3.5)
"""Loss of digits, in nats, at the least and the highest energy of a line. Just above n/β₀, where
none are lost, the end of the line misses most."""
SHORTER = (0.6, 1.2, 1.8)
"""Nats by which shorter ends of the same line miss more: their answers estimate what it misses."""
MOSTLY = 0.5
"""R at the beginning of a line below which R itself is inverted, not R − 1."""
SAFETY = 1.5
"""Factor on both: the error is at the most 0.8 of their sum in 25 random chains of two contact
masses, 3 to 20 masses, stops 1e-2 to 1e5 of the springs, against integrals along rays."""
CHECKED = 4
"""Parts of a line at whose ends the rule over displacements is checked by a lower one."""
MOST_POINTS = 4000
"""Points along one displacement: the kernel between two of them takes 256 MB then."""
ROWS = 32
"""Points of one mass at which the integral over the next one is evaluated at once."""
WINDOW = (0.3, 3.6)
"""Share of a line up to which nothing is taken off, and steepness of the fall to nothing."""
MOST_MASSES = 10
"""Masses, and a quarter of the highest degree of damping terms, up to which two contact masses are
integrated along rays: beyond, v^a r^k is so narrow that the 24 points along a ray miss more than is
stated (3 times of 12 masses and of 9 with a term of degree 8, 0.5 times of 8 with it)."""

Alone = Callable[[System, Array], Array]
"""Columns of ``averaging.shell.averages`` of a system with one contact mass."""


class Line(NamedTuple):
    """Points β (points,) of one line, what is inverted there, and its error, (rows, points).

    Row 0 is R, the others are the transforms of damping power. ``known`` is how often the chain
    without contact is in what was taken off: R − ``known``.
    """

    beta: Complexes
    change: Complexes
    error: Array
    known: float


class PartitionLines:
    """T, phase volume, T' and damping power of the shell, by lines of Z(β) on demand.

    A line serves energies above n/β₀, where up to ``NATS`` digits are lost. With few masses the
    line would have to be long; there the systems with one contact mass alone are taken
    off, whose ratios are integrated along rays: what is left of R falls much faster. Held by the
    system as ``system.fact(PartitionLines)``.
    """

    def __init__(self, system: System) -> None:
        """Prepare the lines; none is evaluated yet."""
        shell = system.fact(EnergyShell)
        self.system, self.n, self.masses = system, system.n, system.contact_masses
        self.springs = np.array([law.precision for law in conditionals(system, self.masses)])
        self.unit = max(shell.contact_energies) or 1.0
        # The loss of digits at H = ρ n/β₀ is n (ρ − 1 − ln ρ) nats.
        shares = np.linspace(1.0, 80.0, 8000)
        loss = self.n * (shares - 1.0 - np.log(shares))
        self.first, last = np.interp(NATS, loss, shares).tolist()
        self.factor = last / self.first
        terms = system.damping_terms
        self.groups = sorted({(term.degree, term.factors) for term in terms})
        most = self.n + 0.5 * max((order for _, order in self.groups), default=0)
        alias = self.n * shares - most * np.log1p(shares / self.first)
        self.step = 2.0 * np.pi / float(shares[np.argmax(alias > ALIAS)])
        self.free, self.size = (
            np.bincount(self._rows(system), [1.0, *x], 1 + len(self.groups))
            for x in system.fact(parts_of).gaussian(shell)
        )
        degree, order = np.array(self.groups).reshape(-1, 2).T
        rest = np.exp(gammaln(self.n) - gammaln(self.n + 0.5 * order))
        self.of_degree = (degree == np.unique(degree)[:, None]) * rest
        self.alone: list[System] = []
        if self._end(1.0) > LONG:
            touching = ([c for c in system.contacts if c.index == i] for i in self.masses)
            self.alone = [replace(system, contacts=tuple(own)) for own in touching]
        self.lines: dict[int, Line] = {}

    def __call__(self, energy: Array, alone: Alone) -> Array:
        """Return T/T_lin, the same of the phase volume, H T'/T and the damping power, with errors.

        These are the columns (energies, 4 + 2 degrees) of ``averaging.shell.averages``; ``alone``
        returns them for a system with one contact mass.
        """
        # T/T_lin, the same of the phase volume and of T', the power times T/T_lin, their errors.
        rows = [(0, 0), (0, 2), (0, -2), *((1 + k, m) for k, (_, m) in enumerate(self.groups))]
        values, errors = (
            np.column_stack([x[:3].T, (self.of_degree @ x[3:]).T])
            for x in self._inverted(energy, rows)
        )
        free = np.array([1.0, 1.0, 1.0, *(self.of_degree @ self.free[1:])])
        for own in self.alone:
            of_own = alone(own, energy)
            states, error = of_own[:, :1], of_own[:, 3:4]
            volume, log_slope = of_own[:, 1:2], of_own[:, 2:3]
            g, g_error = np.split(of_own[:, 4:], 2, axis=1)
            slope = states * log_slope / (self.n - 1.0)
            values += np.hstack([states, volume, slope, states * g]) - free
            g_error = (g_error + np.abs(g) * error) * states
            errors += np.hstack([error * states, error * volume, 0.0 * error, g_error])
        states, g = values[:, :1], values[:, 3:] / values[:, :1]
        error = np.max(errors[:, :2] / values[:, :2], axis=1, keepdims=True)
        log_slope, g_error = (self.n - 1.0) * values[:, 2:3] / states, errors[:, 3:] / states
        return np.hstack([values[:, :2], log_slope, error, g, g_error + np.abs(g) * error])

    def _rows(self, system: System) -> list[int]:
        """The row of R and of each part of the damping terms."""
        parts = system.fact(parts_of)
        keys = zip(parts.degree.tolist(), parts.order.tolist(), strict=True)
        return [0, *(1 + self.groups.index(key) for key in keys)]

    def _end(self, ratio: float) -> float:
        """End of a line over its real part, where R is ``ratio`` at its beginning."""
        constant, missing, most = ENDS
        order = 2.0 * self.n + (3.0 if self.alone else 0.0)
        return float(min(constant * (missing * ratio) ** (-1.0 / order), most))

    def _line(self, real: float) -> Line:
        """The line Re β = ``real``."""
        end = self._end(1.0)
        both = np.array([real, complex(real, real * end)])
        (least, far), *_ = np.abs(self._transforms(self.system, both, self._grids(real, end)[0]))
        end = self._end(least / max(far, least))
        count = CHECKED * ceil(self.n * end / self.step / CHECKED)
        beta = np.empty(count + 1, dtype=complex)
        beta.real, beta.imag = real, real * end * np.arange(count + 1) / count
        lower, rule = self._grids(real, end)
        change = self._transforms(self.system, beta, rule)
        # What contact takes most of is not left to the difference to a chain without contact.
        known = 1.0 if self.alone or least > MOSTLY else 0.0
        checked = slice(None, None, count // CHECKED)
        every = np.arange(count + 1)
        each = np.abs(self._transforms(self.system, beta[checked], lower) - change[:, checked])
        error = np.array([np.interp(every, every[checked], row) for row in each])
        largest = np.maximum(np.abs(change), self.size[:, None] * np.abs(change[0]))
        error += EPS * (count * largest + known * self.size[:, None])
        change -= known * self.free[:, None]
        for own, displacements in zip(self.alone, rule, strict=False):
            change -= self._transforms(own, beta, [displacements]) - self.free[:, None]
        return Line(beta, change, error, known)

    def _transforms(
        self, system: System, beta: Complexes, grids: Sequence[tuple[Array, Array]]
    ) -> Complexes:
        """R and what it is with the damping power as a weight, (rows, points), at equidistant β.

        ``grids`` are displacements and weights of each contact mass of ``system``.
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
            step = (beta[-1] - beta[0]).imag / max(beta.size - 1, 1)
            reach = np.sqrt(2.0 * DEPTH / (beta[0].real * stiffness))
            # Few rows at once stay in the cache, and see few columns.
            for rows in np.array_split(np.arange(before.size), ceil(before.size / ROWS)):
                x = before[rows, None]
                low, high = np.searchsorted(q, [x[0, 0] - reach, x[-1, 0] + reach])
                height = 0.5 * stiffness * (x - q[low:high]) ** 2
                f[:, rows] = passed(
                    height, beta[0].real, step, np.ascontiguousarray(g[:, low:high])
                )
            f *= np.sqrt(beta * stiffness / (2.0 * np.pi))[:, None, None]
        moments = f[:, 0] * beta[:, None] ** (0.5 * powers.sum(axis=1))
        rows = np.zeros((1 + len(self.groups), beta.size), dtype=complex)
        np.add.at(
            rows, self._rows(system), (moments[:, column.ravel()] * [1.0, *parts.coefficient]).T
        )
        return rows

    def _grids(self, real: float, end: float) -> list[list[tuple[Array, Array]]]:
        """Displacements and weights by both rules, for β from ``real`` to (1 + i ``end``)."""
        masses = range(self.springs.size)
        panels = [self._panels(j, real, end) for j in masses]
        return [[self._rule(j, panels[j], points, real) for j in masses] for points in POINTS]

    def _panels(self, j: int, real: float, end: float) -> Array:
        """Nodes along the displacement of contact mass j."""
        longest = min(WIDTHS, POINTS[1] * RADIANS / (end * (2.0 * RISE) ** 0.5))
        width = longest / (real * float(self.springs[j : j + 2].sum())) ** 0.5
        levels = [1.0]
        while levels[-1] < DEPTH:
            turns = POINTS[1] * RADIANS / end if levels[-1] < RISE else DEPTH
            levels.append(levels[-1] + min(levels[-1], turns))
        levels = [level / real for level in levels]
        mass, last = self.masses[j], DEPTH / real
        nodes = stop_panels(self.system, mass, width=width, end=last, levels=levels)
        points = ceil((nodes[-1] - nodes[0]) / width) * POINTS[1]
        if points > MOST_POINTS:
            raise NotApplicable(
                f"mass {mass + 1} is tied too stiffly to another contact mass: the passes along the"
                f" chain would take {points} points of it, {MOST_POINTS} at the most"
            )
        return nodes

    def _rule(self, j: int, nodes: Array, points: int, real: float) -> tuple[Array, Array]:
        """Displacements and weights of contact mass j, of ``points`` on each panel.

        Next to a stop they are Gauss points of the root of the overlap, in which the contact energy
        of a Hertz law is a polynomial.
        """
        q, weights = panel_rule(nodes, points)
        for stop in self.system.stops:
            if stop.index == self.masses[j]:
                overlap = stop.sign * nodes - stop.clearance
                middle, root = overlap[1:] + overlap[:-1], np.sqrt(np.maximum(overlap, 0.0))
                near = (middle > 0.0) & (middle < 2.0 * stop.overlap_at(1.0 / real))
                s, ds = panel_rule(root, points)
                q[near] = stop.sign * (stop.clearance + s[near] ** 2)
                weights[near] = 2.0 * s[near] * np.abs(ds[near])
        return q.ravel(), weights.ravel()

    def _inverted(self, energy: Array, rows: Sequence[tuple[int, int]]) -> tuple[Array, Array]:
        """Inverse transforms of rows of the lines, and their errors, (rows, energies) each.

        Of the order m they are relative to H^(n − 1 + m/2)/Γ(n + m/2); ``rows`` are row and order.
        """
        values, errors = np.empty((2, len(rows), energy.size))
        index = np.floor(np.log(energy / self.unit) / np.log(self.factor)).astype(int)
        for k in np.unique(index).tolist():
            if k not in self.lines:
                self.lines[k] = self._line(self.first * self.n / (self.unit * self.factor**k))
            line, here = self.lines[k], index == k
            s = energy[here, None] * line.beta
            window = self._windows(line.beta.size)
            size = energy[here, None] * (line.beta[1] - line.beta[0]).imag / np.pi
            for at, (row, order) in enumerate(rows):
                power = self.n + 0.5 * order
                terms = size * np.exp(s + gammaln(power) - power * np.log(s))
                by_window = (terms * line.change[row]).real @ window.T
                missing = np.abs(by_window[:, 1:] - by_window[:, :1]).max(axis=1)
                values[at, here] = line.known * self.free[row] + by_window[:, 0]
                errors[at, here] = SAFETY * (missing + np.abs(terms) @ line.error[row])
        return values, errors

    def _windows(self, count: int) -> Array:
        """Weights of the points of a line, and of the same line ended earlier."""
        share = np.arange(count) / (count - 1)
        ends = 1.0 - np.array([0.0, *SHORTER])[:, None] / (2.0 * self.n)
        # A window that is flat at 0 moves T only by what is not smooth over 1/(its end).
        flat, steepness = WINDOW
        window: Array = 0.5 * erfc(steepness * (2.0 * (share / ends - flat) / (1.0 - flat) - 1.0))
        window[:, 0] *= 0.5
        return window


def by_lines(shell: EnergyShell) -> bool:
    """Whether averages over the shell follow from the partition function, not along rays."""
    degree = max((term.degree for term in shell.system.damping_terms), default=0)
    return shell.count > 2 or (shell.count == 2 and shell.system.n + 0.25 * degree > MOST_MASSES)
