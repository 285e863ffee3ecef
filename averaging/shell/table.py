"""Piecewise polynomials of the shell ratios, for systems whose shells are dear to integrate.

With two or more contact masses one energy costs milliseconds to seconds, and a solver asks for
thousands. Between contact energies the ratios are smooth: a panel of Chebyshev points is built
when a solver first asks for as many energies in it, and split until its coefficients have decayed.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import NDArray

Array = NDArray[np.float64]
Evaluate = Callable[[Array], Array]

GRADING = 0.2
"""Panels shrink towards each contact energy from above, where (H − H_c)³ or rougher terms begin."""
DOUBLINGS = 60


@dataclass(frozen=True)
class Resolution:
    """Chebyshev points a panel, panels towards a contact energy, and when a panel is split.

    A panel is split, at most ``deepest`` times, while its last coefficients exceed ``target``.
    """

    points: int = 16
    layers: int = 5
    target: float = 1e-11
    deepest: int = 8


@dataclass(frozen=True, eq=False)
class Panel:
    """Chebyshev coefficients (points, quantities) on [left, right] and a bound of their error."""

    left: float
    right: float
    coefficients: Array
    error: float

    def __call__(self, energy: Array) -> Array:
        """Values (energies, quantities + 1); the last column is the error."""
        t = (2.0 * energy - self.left - self.right) / (self.right - self.left)
        values = chebyshev.chebvander(t, self.coefficients.shape[0] - 1) @ self.coefficients
        return np.column_stack([values, np.full(energy.size, self.error)])


class ShellTable:
    """Function of the energy that remembers panels of ``evaluate``, built on demand.

    ``evaluate`` returns (energies, quantities + 1), relative quantities of order one and their
    error; ``breaks`` are the energies, ascending, where it loses smoothness, the first one being
    the least energy asked for.
    """

    def __init__(
        self, evaluate: Evaluate, breaks: tuple[float, ...], resolution: Resolution
    ) -> None:
        """Lay out the panels; none is built yet."""
        self.evaluate, self.resolution = evaluate, resolution
        nodes = [np.array(breaks)]
        ends = [*breaks[1:], 2.0 * breaks[-1] if breaks[-1] > 0 else 1.0]
        for low, high in zip(breaks, ends, strict=True):
            nodes.append(low + (high - low) * GRADING ** np.arange(1.0, resolution.layers + 1.0))
        nodes.append(ends[-1] * 2.0 ** np.arange(DOUBLINGS))
        self.edges = np.unique(np.concatenate(nodes))
        self.panels: dict[int, list[Panel]] = {}
        self.single: dict[float, Array] = {}

    def __call__(self, energy: Array) -> Array:
        """Values at energies (energies,), from panels where these are worth their building."""
        index = np.searchsorted(self.edges, energy, side="right") - 1
        direct = np.zeros(energy.size, dtype=bool)
        result: Array = np.empty((0, 0))
        for k in np.unique(index):
            rows = np.flatnonzero(index == k)
            if int(k) not in self.panels and rows.size < self.resolution.points:
                direct[rows] = True
                continue
            if int(k) not in self.panels:
                self.panels[int(k)] = self._built(self.edges[k], self.edges[k + 1], 0)
            result = _sized(result, energy.size, self.panels[int(k)][0])
            for panel in self.panels[int(k)]:
                inside = rows[(energy[rows] >= panel.left) & (energy[rows] <= panel.right)]
                result[inside] = panel(energy[inside])
        if direct.any():
            values = self._single_values(energy[direct])
            if not result.size:
                result = np.empty((energy.size, values.shape[1]))
            result[direct] = values
        return result

    def _single_values(self, energy: Array) -> Array:
        """Values at single energies; solvers begin by looking at the same ones."""
        new = np.array([H for H in energy if float(H) not in self.single])
        if new.size:
            self.single |= zip(map(float, new), self.evaluate(new), strict=True)
        return np.array([self.single[float(H)] for H in energy])

    def _built(self, left: float, right: float, depth: int) -> list[Panel]:
        points = self.resolution.points
        t = np.cos(np.pi * (np.arange(points) + 0.5) / points)
        values = self.evaluate(0.5 * (left + right) + 0.5 * (right - left) * t)
        vander = chebyshev.chebvander(t, points - 1)
        coefficients = vander.T @ values[:, :-1] * (2.0 / points)
        coefficients[0] *= 0.5
        decay = float(np.max(np.abs(coefficients[-2:])))
        if decay > self.resolution.target and depth < self.resolution.deepest:
            cut = left + GRADING * (right - left)
            return [*self._built(left, cut, depth + 1), *self._built(cut, right, depth + 1)]
        error = 2.0 * decay + float(values[:, -1].max())
        return [Panel(left, right, coefficients, error)]


def _sized(result: Array, rows: int, panel: Panel) -> Array:
    return result if result.size else np.empty((rows, panel.coefficients.shape[1] + 1))
