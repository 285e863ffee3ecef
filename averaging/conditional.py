"""Laws of the displacements of a chain given those of some other masses.

A chain conditioned on some displacements falls apart at them: a mass depends on its neighbours
among them alone, through the springs in between in series. Its law given those is
½ a (q − μ)² + U(q), and nothing in a or μ cancels at any ratio of the springs.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fpk.contact import Contact
from fpk.system import System

Array = NDArray[np.float64]

BETWEEN = 65
"""Overlaps within a factor of two among which that of an energy is interpolated."""


@dataclass(frozen=True, eq=False)
class Conditional:
    """Law of one displacement of a chain given some others: ½ a (q − Σ w_k q_k)² + U(q).

    ``mass`` counts from 0; ``precision`` is a, the stiffness of the springs to the neighbours among
    the others, in series; ``weights`` (others,) are the w_k.
    """

    system: System
    mass: int
    precision: float
    weights: Array

    @property
    def stops(self) -> tuple[Contact, ...]:
        """The one-sided stops of the mass."""
        return tuple(stop for stop in self.system.stops if stop.index == self.mass)

    def energy(self, q: Array, mean: Array) -> Array:
        """½ a (q − mean)² + U(q)."""
        return 0.5 * self.precision * (q - mean) ** 2 + self.system.contact_energy(self.mass, q)


def conditional(system: System, mass: int, given: Sequence[int]) -> Conditional:
    """Return the law of q_mass given the displacements of ``given`` (masses from 0)."""
    flexibility = 1.0 / system.stiffness
    weights = np.zeros(len(given))
    below = max((k for k in given if k < mass), default=-1)
    left = 1.0 / float(flexibility[below + 1 : mass + 1].sum())
    precision = left
    above = min((k for k in given if k > mass), default=None)
    if above is not None:
        right = 1.0 / float(flexibility[mass + 1 : above + 1].sum())
        precision = left + right
        weights[list(given).index(above)] = right / precision
    if below >= 0:
        weights[list(given).index(below)] = left / precision
    return Conditional(system, mass, precision, weights)


def conditionals(system: System, masses: Sequence[int]) -> tuple[Conditional, ...]:
    """Return the law of each displacement given those before it: Π √a_k² is det K_red."""
    return tuple(conditional(system, mass, masses[:k]) for k, mass in enumerate(masses))


def bridge_covariance(system: System, free: Sequence[int], given: Sequence[int]) -> Array:
    """Return the covariance at temperature 1 of the displacements of ``free`` masses given others.

    Two masses share what lies between them and their common neighbours among ``given``: with the
    flexibilities a up to the nearer, b from the farther on and s in all it is a b / s, and a where
    nothing above is given. Masses with one of ``given`` in between are independent.
    """
    flexibility = 1.0 / system.stiffness
    covariance = np.zeros((len(free), len(free)))
    for row, i in enumerate(free):
        for column, j in enumerate(free):
            low, high = min(i, j), max(i, j)
            below = max((k for k in given if k < low), default=-1)
            above = min((k for k in given if k > low), default=None)
            if above is not None and above < high:
                continue
            covariance[row, column] = np.sum(flexibility[below + 1 : low + 1])
            if above is not None:
                left, total = flexibility[high + 1 : above + 1], flexibility[below + 1 : above + 1]
                covariance[row, column] *= np.sum(left) / np.sum(total)
    return covariance


def overlap_at(stop: Contact, energy: float) -> float:
    """Return about the overlap of one stop at a contact energy > 0, to place panels by.

    It is exact for a power law; for another one it is off by 1e-5 of itself or so.
    """
    high = 1.0
    while stop.energy(high) < energy:
        high *= 2.0
    while stop.energy(0.5 * high) > energy:
        high *= 0.5
    # ln U is linear in ln x for a power law, and nearly so between x and 2 x for others.
    x = high * 2.0 ** np.linspace(-1.0, 0.0, BETWEEN)
    return float(np.exp(np.interp(np.log(energy), np.log(stop.energy(x)), np.log(x))))


def side_sign(stop: Contact) -> float:
    """Return +1 for a stop on the right, −1 on the left."""
    return 1.0 if stop.side == "right" else -1.0
