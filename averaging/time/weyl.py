"""Weyl integrals of u = p(H, t)/T(H) at all times of a transient, with their errors."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from math import gamma

import numpy as np

from averaging.weyl import weyl_integral
from fpk.arrays import EPS, Array
from fpk.line.mesh import with_layers
from fpk.line.time.transition import ROUND_OFF, SAFETY, Transition, common_error
from fpk.piecewise import Piecewise, interpolated
from fpk.quadrature import panel_rule

POINTS = (20, 24)
"""Gauss points an element of the coarser table of Ψ, and of the answer."""
CHECKED = 21
"""Points an element at which errors of u are measured, none of which is one of its table."""


@dataclass(frozen=True, eq=False)
class WeylInTime:
    """Ψ(E) = ∫_E u(H) (H − E)^(ν−1)/Γ(ν) dH at all times, ν = ``order`` = 0, ½, 1, …; Ψ_0 is u."""

    solved: Transition
    order: float

    @cached_property
    def nodes(self) -> Array:
        """Ends of halves of the enriched solution's elements, with layers at contact energies."""
        nodes = self.solved.enriched.elements.nodes
        halves = np.sort(np.append(nodes, 0.5 * (nodes[1:] + nodes[:-1])))
        return with_layers(halves, self.solved.enriched.process.nonsmooth)

    def __call__(self, energy: Array) -> Array:
        """Return Ψ at ``energy``, (*shape, times)."""
        return self._table(energy)

    def error(self, energy: Array) -> Array:
        """Return the error of Ψ; beyond the last element Ψ is less than its error before."""
        last = 0.5 * float(self.nodes[-2] + self.nodes[-1])
        E = np.minimum(energy, last).ravel()
        k = np.searchsorted(self.nodes, E, side="right") - 1
        total = self._moved[k]
        if self.order == 0.0:
            total = total + self._of_u[k]
        else:
            with np.errstate(invalid="ignore"):
                powers = np.maximum(self.nodes - E[:, None], 0.0) ** self.order
            total = total + np.diff(powers, axis=1) @ self._of_u / gamma(self.order + 1.0)
        return np.asarray(total.reshape(*np.shape(energy), -1))

    @property
    def added(self) -> float:
        """The error of the table relative to the largest Ψ."""
        return float(np.max(self._moved / np.max(np.abs(self._table.coefficients[:, 0]), axis=0)))

    @cached_property
    def _u(self) -> Piecewise:
        """u at all times."""
        return self._of_energy(lambda x: self._answer(x)[0], POINTS[1])

    def _answer(self, x: Array) -> tuple[Array, Array]:
        """u and the size of its terms (points, times); 0 beyond the last element of the answer."""
        u, size = self.solved.solution.state_density(x)
        inside = x <= self.solved.elements.right[-1]
        return (u * inside).T, (size * inside).T

    @cached_property
    def _of_u(self) -> Array:
        """The largest error of u in each element (elements, times)."""
        x = panel_rule(self.nodes, CHECKED)[0]
        u, size = self._answer(x.ravel())
        better, other = self.solved.enriched.state_density(x.ravel())
        error = SAFETY * (np.abs(u - better.T) + np.abs(u - self._u(x.ravel())))
        within = np.minimum(x.ravel(), self.solved.elements.right[-1])
        question = self.solved.question
        error += common_error(question, self.solved.elements, u.T, size.T + other, within).T
        # What is left of larger numbers far from the peak, of u and of p = T u.
        c = question.process.coefficients(x.ravel())
        with np.errstate(over="ignore"):
            of_p = np.multiply.outer(np.exp(-c.log_density_of_states), self.solved.top)
        error += ROUND_OFF * EPS * np.minimum(of_p, np.abs(u).max(axis=0))
        return np.asarray(error.reshape(*x.shape, -1).max(axis=1))

    @cached_property
    def _table(self) -> Piecewise:
        if self.order == 0.0:
            return self._u
        return self._of_energy(lambda E: self._integral(E, POINTS[1]), POINTS[1])

    @cached_property
    def _moved(self) -> Array:
        """Largest distance of two tables in each element (elements, times)."""
        f = self._u if self.order == 0.0 else lambda E: self._integral(E, POINTS[0])
        coarse = self._of_energy(f, POINTS[0])
        x = panel_rule(self.nodes, sum(POINTS))[0]
        distance = np.abs(coarse(x) - self._table(x)).max(axis=1)
        return np.asarray(distance + ROUND_OFF * EPS * np.abs(self._table(x)).max(axis=1))

    def _of_energy(self, f: Callable[[Array], Array], points: int) -> Piecewise:
        left, right = self.nodes[:-1], self.nodes[1:]
        return Piecewise(self.nodes, interpolated(f, left, right, points - 1))

    def _integral(self, energy: Array, points: int) -> Array:
        return weyl_integral(self.order, self.nodes, self._u, energy, points=points)
