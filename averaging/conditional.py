"""Laws of the displacements of a chain given those of some other masses.

A mass depends on its nearest neighbours among these alone, through the springs in between in
series: nothing in its law ½ a (q − μ)² + U(q) cancels at any ratio of the springs.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from fpk.arrays import Array
from fpk.contact import Contact
from fpk.system import System


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
    flexibility, weights = 1.0 / system.stiffness, np.zeros(len(given))
    below = max((k for k in given if k < mass), default=-1)
    above = min((k for k in given if k > mass), default=None)
    left = 1.0 / float(flexibility[below + 1 : mass + 1].sum())
    right = 0.0 if above is None else 1.0 / float(flexibility[mass + 1 : above + 1].sum())
    for neighbour, stiffness in ((below, left), (above, right)):
        if neighbour is not None and neighbour in given:
            weights[list(given).index(neighbour)] = stiffness / (left + right)
    return Conditional(system, mass, left + right, weights)


def conditionals(system: System, masses: Sequence[int]) -> tuple[Conditional, ...]:
    """Return the law of each displacement given those before it: Π √a_k² is det K_red."""
    return tuple(conditional(system, mass, masses[:k]) for k, mass in enumerate(masses))


def bridge_covariance(system: System, given: Sequence[int]) -> Array:
    """Return the covariance (n, n) at temperature 1 of displacements given those of some masses.

    ``given`` ascends. Masses with one of these in between are independent. Between two of them the
    chain is a bridge: with the flexibilities a from the lower one up to the nearer of two masses, b
    from the farther one on and s in all the covariance is a b / s, and a where none is above.
    """
    flexibility, covariance = 1.0 / system.stiffness, np.zeros((system.n, system.n))
    for below, above in pairwise([-1, *given, system.n]):
        a = np.cumsum(flexibility[below + 1 : above])
        block = np.minimum.outer(a, a)
        if above < system.n:
            s, *b = (flexibility[k : above + 1].sum() for k in range(below + 1, above + 1))
            block = block * (np.minimum.outer(b, b) / s)
        covariance[below + 1 : above, below + 1 : above] = block
    return covariance
