"""Density of states of many contact masses: inverse Laplace transform of the partition function.

The chain couples neighbours only, so that Z(β) = ∫exp(−βH) dq dp is one pass of integral operators
from its end to the wall, at a cost linear in the number of contact masses. With R = Z/Z_lin, Z_lin
that of the chain without contact, and any β₀ > 0

``T/T_lin = 1 + Γ(n) H^(1−n)/(2πi) ∫ e^(βH) β^(−n) (R(β) − 1) dβ`` along Re β = β₀,

the phase volume the same with n + 1 and T' with n − 1 in the place of n. What contact adds beyond a
stop falls along the line like |β|^(−n) times what R − 1 falls: well conditioned near β₀ = n/H.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from math import ceil, lgamma
from typing import NamedTuple

import numpy as np
from scipy.special import erfc

from averaging.conditional import conditionals
from averaging.shell.energy_shell import EnergyShell
from fpk.arrays import Array, Complexes
from fpk.errors import NotApplicable
from fpk.quadrature import panel_rule
from fpk.system import System

DEPTH = 40.0
"""Height of the potential, in units of 1/β₀, that the grids reach: e^−40 = 4e-18."""
LEVELS = (1e-5, 1e-3, 0.1, 1.0, 2.0, 4.0, 8.0, 16.0, DEPTH)
"""Contact energies, in units of 1/β₀, at which panels end beyond a stop."""
POINTS = (15, 16)
"""Gauss points per panel, of the rule that estimates the error and of the answer."""
WIDTHS = 1.8
"""Longest panel in units of the width of a displacement between its neighbours at β₀."""
RADIANS, RISE = 2.0, 25.0
"""Most radians of exp(−i Im β V) between two points of the answer where V is ``RISE``/β₀: sixteen
points integrate 32 radians to about 1e-13 of what is left there."""
ENDS = (1.6, 1e-13, 20.0)
"""A line ends at Im β = 1.6 (1e-13 R)^(−1/2n) β₀, R at its beginning, at most at 20 β₀: what is
missing beyond ``end`` was measured to be about (1.6/end)^2n, with Hertz stops and n = 4 to 30."""
ALIAS = 30.0
"""Nats by which the trapezoidal rule's nearest alias, T(H + 2π/step) e^(−2πβ₀/step), is down."""
NATS = 1.5
"""Largest loss of digits, in nats, at the energies of a line farthest above n/β₀."""
SHORTER = (0.6, 1.2, 1.8)
"""Nats by which shorter ends of the same line miss more: their answers estimate what it misses."""
MOSTLY = 0.5
"""R at the beginning of a line below which R itself is inverted, not R − 1."""
SAFETY = 1.5
"""Factor on both: the error is at the most 0.9 of their sum in 30 random chains of two contact
masses, 4 to 30 masses, against integrals along rays."""
CHECKED = 4
"""Parts of a line at whose ends the rule over displacements is checked by a lower one."""
MOST_POINTS = 4000
"""Points along one displacement: the kernel between two of them takes 256 MB then."""
ROWS = 32
"""Points of one mass at which the integral over the next one is evaluated at once."""
WINDOW = (0.3, 3.5)
"""Share of a line up to which nothing is taken off, and steepness of the fall to nothing."""
EPS = float(np.finfo(float).eps)


class Line(NamedTuple):
    """Points β of one line, what is to be inverted there, and its error, all (points,).

    ``known`` is how often the chain without contact is in what was taken off: R − ``known``.
    """

    beta: Complexes
    change: Complexes
    error: Array
    known: float


class PartitionLines:
    """T, phase volume and T' relative to the chain without contact, by lines of Z(β) on demand.

    A line serves the energies from n/β₀ to a factor above, where no digits are lost. With few
    masses the line would have to be long; there the systems with one contact mass alone are taken
    off, whose ratios are integrated along rays: what is left of R falls much faster. Held by the
    system as ``system.fact(PartitionLines)``.
    """

    def __init__(self, system: System) -> None:
        """Prepare the lines; none is evaluated yet."""
        shell = system.fact(EnergyShell)
        self.system, self.n, self.masses = system, system.n, shell.masses
        self.springs = np.array([law.precision for law in conditionals(system, shell.masses)])
        self.unit = max(shell.contact_energies) or 1.0
        # The loss of digits at H = ρ n/β₀ is n (ρ − 1 − ln ρ) nats.
        shares = np.linspace(1.0, 20.0, 2000)
        loss = self.n * (shares - 1.0 - np.log(shares))
        self.factor = float(np.interp(NATS, loss, shares))
        alias = self.n * (shares - np.log1p(shares))
        self.step = 2.0 * np.pi / float(np.interp(ALIAS, alias, shares))
        self.alone: list[System] = []
        if _end(self.n, 1.0) == ENDS[2]:
            touching = ([c for c in system.contacts if c.index == i] for i in shell.masses)
            self.alone = [replace(system, contacts=tuple(own)) for own in touching]
        self.lines: dict[int, Line] = {}

    def __call__(self, energy: Array, alone: Callable[[System, Array], Array]) -> Array:
        """Return T/T_lin, the same of the phase volume, H T'/T and the error of the first two.

        These are the rows (4, energies) of ``ShellRatios``; ``alone`` returns them for a system
        with one contact mass.
        """
        index = np.floor(np.log(energy / self.unit) / np.log(self.factor)).astype(int)
        # T/T_lin, the same of the phase volume and of T', and their errors.
        values, errors = np.empty((2, 3, energy.size))
        for k in np.unique(index).tolist():
            if k not in self.lines:
                self.lines[k] = self._line(self.n / (self.unit * self.factor**k))
            here = index == k
            values[:, here], errors[:, here] = self._inverted(energy[here], self.lines[k])
        for own in self.alone:
            states, volume, log_slope, error = alone(own, energy)
            slope = states * log_slope / (self.n - 1.0)
            values += np.stack([states, volume, slope]) - 1.0
            errors[:2] += np.stack([error * states, error * volume])
        states, volume, slope = values
        error = np.maximum(errors[0] / states, errors[1] / volume)
        return np.stack([states, volume, (self.n - 1.0) * slope / states, error])

    def _line(self, real: float) -> Line:
        """The line Re β = ``real``."""
        whole = list(range(len(self.masses)))
        end, grids = _end(self.n, 1.0), self._grids(real, 1.0)
        least = self._ratio(np.array([real], dtype=complex), whole, grids[1])[0].real
        for _ in range(2):
            far = self._ratio(np.array([complex(real, real * end)]), whole, grids[1])[0]
            end = _end(self.n, least / max(abs(far), least))
        count = CHECKED * ceil(self.n * end / self.step / CHECKED)
        beta = np.empty(count + 1, dtype=complex)
        beta.real, beta.imag = real, real * end * np.arange(count + 1) / count
        lower, rule = self._grids(real, end)
        change: Complexes = self._ratio(beta, whole, rule)
        # What contact takes most of is not left to the difference to a chain without contact.
        known = 1.0 if self.alone or least > MOSTLY else 0.0
        checked = slice(None, None, count // CHECKED)
        each = np.abs(self._ratio(beta[checked], whole, lower) - change[checked])
        error = np.interp(np.arange(count + 1), np.arange(count + 1)[checked], each)
        error += EPS * count * np.abs(change) + EPS * known
        change = np.asarray(change - known, dtype=complex)
        for j in whole[: len(self.alone)]:
            change -= self._ratio(beta, [j], [rule[j]]) - 1.0
        return Line(beta, change, error, known)

    def _ratio(
        self, beta: Complexes, which: Sequence[int], grids: Sequence[tuple[Array, Array]]
    ) -> Complexes:
        """R at equidistant β of a line, of some contact masses by displacements and weights."""
        f: Complexes = np.ones((beta.size, 1), dtype=complex)
        masses = [self.masses[j] for j in which]
        springs = [law.precision for law in conditionals(self.system, masses)]
        befores = [np.zeros(1), *(q for q, _ in grids[:-1])]
        links = zip(masses, springs, grids, befores, strict=True)
        for mass, stiffness, (q, weights), before in reversed(list(links)):
            g = f * np.exp(-beta[:, None] * self.system.contact_energy(mass, q)) * weights
            f = np.empty((beta.size, before.size), dtype=complex)
            step = (beta[-1] - beta[0]) / max(beta.size - 1, 1)
            reach = np.sqrt(2.0 * DEPTH / (beta[0].real * stiffness))
            # Few rows at once stay in the cache, and see few columns.
            for rows in np.array_split(np.arange(before.size), ceil(before.size / ROWS)):
                x = before[rows, None]
                low, high = np.searchsorted(q, [x[0, 0] - reach, x[-1, 0] + reach])
                height = 0.5 * stiffness * (x - q[low:high]) ** 2
                kernel = np.exp(-beta[0] * height)
                factor = np.exp(-step * height) if beta.size > 1 else 1.0
                for k in range(beta.size):
                    f[k, rows] = kernel @ g[k, low:high]
                    kernel *= factor
            f *= np.sqrt(beta * stiffness / (2.0 * np.pi))[:, None]
        return f[:, 0]

    def _grids(self, real: float, end: float) -> list[list[tuple[Array, Array]]]:
        """Displacements and weights by both rules, for β from ``real`` to (1 + i ``end``)."""
        panels = [self._panels(j, real, end) for j in range(self.springs.size)]
        return [
            [(x.ravel(), w.ravel()) for x, w in (panel_rule(nodes, points) for nodes in panels)]
            for points in POINTS
        ]

    def _panels(self, j: int, real: float, end: float) -> Array:
        """Nodes along the displacement of contact mass j."""
        mass = self.masses[j]
        low = high = float(np.sqrt(2.0 * DEPTH * self.system.compliance[mass, mass] / real))
        parts = []
        for stop in self.system.stops:
            if stop.index == mass:
                overlaps = [stop.overlap_at(level / real) for level in LEVELS]
                parts.append(stop.sign * (stop.clearance + np.array([0.0, *overlaps])))
                far = stop.clearance + overlaps[-1]
                low, high = (min(low, far), high) if stop.sign < 0.0 else (low, min(high, far))
        longest = min(WIDTHS, POINTS[1] * RADIANS / (end * (2.0 * RISE) ** 0.5))
        stiffness = float(self.springs[j : j + 2].sum())
        count = ceil((low + high) * (real * stiffness) ** 0.5 / longest)
        if count * POINTS[1] > MOST_POINTS:
            raise NotApplicable(
                f"mass {mass + 1} is tied too stiffly to another contact mass: the passes along the"
                f" chain would take {count * POINTS[1]} points of it, {MOST_POINTS} at the most"
            )
        nodes = np.concatenate([np.linspace(-low, high, count + 1), *parts])
        return np.unique(np.clip(nodes, -low, high))

    def _inverted(self, energy: Array, line: Line) -> tuple[Array, Array]:
        """T/T_lin, the same of phase volume and of T', and their errors, (3, energies) each."""
        s = energy[:, None] * line.beta
        share = np.arange(line.beta.size) / (line.beta.size - 1)
        ends = 1.0 - np.array([0.0, *SHORTER])[:, None] / (2.0 * self.n)
        # A window that is flat at 0 moves T only by what is not smooth over 1/(its end).
        flat, steepness = WINDOW
        window = 0.5 * erfc(steepness * (2.0 * (share / ends - flat) / (1.0 - flat) - 1.0))
        window[:, 0] *= 0.5
        size = energy[:, None] * (line.beta[1] - line.beta[0]).imag / np.pi
        values, errors = np.empty((2, 3, energy.size))
        for row, power in enumerate((self.n, self.n + 1, self.n - 1)):
            terms = size * np.exp(s + lgamma(power) - power * np.log(s))
            by_window = (terms * line.change).real @ window.T
            missing = np.abs(by_window[:, 1:] - by_window[:, :1]).max(axis=1)
            values[row] = line.known + by_window[:, 0]
            errors[row] = SAFETY * (missing + np.abs(terms) @ line.error)
        return values, errors


def _end(masses: int, ratio: float) -> float:
    """End of a line over its real part, where R is ``ratio`` at its beginning."""
    constant, missing, most = ENDS
    return float(min(constant * (missing * ratio) ** (-0.5 / masses), most))
