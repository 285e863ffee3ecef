"""State-dependent damping: monomials added to the matrix of Eq. (1), and Gaussian moments."""

from dataclasses import dataclass, field
from functools import cache
from math import isfinite
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from fpk.numeric.arrays import Array
from fpk.numeric.errors import require

Powers = tuple[tuple[int, int], ...]

MOST_POWERS = 8
"""Highest degree of a term, an energy counting twice: averages of higher degrees lose digits, and
explicit steps their stability."""


@dataclass(frozen=True)
class DampingTerm:
    """One monomial added to an entry of the damping matrix of Eq. (1).

    ``c_ij += coefficient · Π q_a^m · Π v_a^n · H^energy`` adds the force ``−coefficient · … · v_j``
    on mass i and none on mass j, which takes a second term. ``i``, ``j`` and the masses in the
    pairs (mass, power) of ``q`` and ``v`` count from 1; powers are integers >= 1; ``energy`` >= 0.
    ``degree`` is the sum of the powers plus 2 ``energy``, at most ``MOST_POWERS``. A negative
    coefficient feeds energy in, as in van der Pol's oscillator.

    Van der Pol's oscillator, c = −0.1 + 0.4 q²::

        term = fpk.DampingTerm(1, 1, 0.4, q=((1, 2),))
        fpk.System([1.0], [1.0], [-0.1], [0.005], damping_terms=(term,))
        term.value(q=[0.5], v=[0.0], energy=0.125)

    Raises ``InvalidInput`` with the name of the field that cannot be used.
    ``System`` refuses masses that it does not have.
    """

    i: int
    j: int
    coefficient: float
    q: Powers = ()
    v: Powers = ()
    energy: int = 0
    degree: int = field(init=False)

    def __post_init__(self) -> None:
        """Check the fields, and sort the powers so that equal terms compare equal."""
        finite = isfinite(self.coefficient)
        require(finite, "coefficient", self.coefficient, "must be a finite number")
        for key in ("q", "v"):
            powers: Powers = tuple(sorted(getattr(self, key)))
            once = len(dict(powers)) == len(powers)
            require(once, key, powers, "must name each mass once, with the sum of its powers")
            for mass, power in powers:
                whole = power >= 1 and power == int(power)
                require(whole, f"{key}.{mass}", power, "must be a whole power of 1 or more")
            object.__setattr__(self, key, powers)
        require(self.energy >= 0, "energy", self.energy, "must be a power of 0 or more")
        degree = sum(power for _, power in self.q + self.v) + 2 * self.energy
        remedy = f"is the degree, an energy counting 2; use at most {MOST_POWERS}"
        require(degree <= MOST_POWERS, "degree", degree, remedy)
        object.__setattr__(self, "degree", degree)

    @property
    def row(self) -> int:
        """Number of the mass i, counted from 0."""
        return self.i - 1

    @property
    def column(self) -> int:
        """Number of the mass j, counted from 0."""
        return self.j - 1

    @property
    def masses(self) -> dict[str, int]:
        """Every mass of the term, counted from 1, by its place: i, j, q.1, v.2 and so on."""
        powers = {f"{key}.{m}": m for key in ("q", "v") for m, _ in getattr(self, key)}
        return {"i": self.i, "j": self.j, **powers}

    def powers(self, key: str, n: int) -> tuple[int, ...]:
        """Return the exponents (n,) of all displacements or velocities, ``key`` "q" or "v"."""
        power_of: dict[int, int] = dict(getattr(self, key))
        return tuple(power_of.get(mass, 0) for mass in range(1, n + 1))

    @property
    def factors(self) -> int:
        """Sum of the exponents of q and v in the dissipated power c_ij v_i v_j, without H."""
        return self.degree - 2 * self.energy + 2

    def velocities(self, n: int) -> tuple[int, ...]:
        """Return the exponents (n,) of all velocities in the dissipated power c_ij v_i v_j.

        They include the velocities in this term of c_ij; ``n`` is the number of masses.
        """
        own = (self.row, self.column)
        return tuple(power + own.count(k) for k, power in enumerate(self.powers("v", n)))

    def value(self, q: ArrayLike, v: ArrayLike, energy: ArrayLike) -> Array:
        """Return this term of c_ij (...), with its coefficient, at displacements ``q``, velocities
        ``v``, (..., n) each, and ``energy`` H (...)."""
        q, v = np.asarray(q, dtype=float), np.asarray(v, dtype=float)
        value = np.asarray(self.coefficient * np.asarray(energy, dtype=float) ** self.energy)
        for x, powers in ((q, self.q), (v, self.v)):
            for mass, power in powers:
                value = value * x[..., mass - 1] ** power
        return value


def gaussian_moment(covariance: Array, powers: tuple[int, ...]) -> Any:
    """Return E Π_a x_a^powers[a] of x (n,) ~ N(0, ``covariance`` (n, n)), by Isserlis' theorem.

    Integration by parts, ``E x_a f = Σ_b cov_ab E ∂f/∂x_b``, leads to monomials two degrees lower.
    A ``covariance`` (n, n, m) is a sum of m parts: the result (m, m, ..) is then to be summed over
    all axes, one for each pair of factors, the first for the pair of the x_a with the smallest a.
    For odd degrees the result is 0.0.
    """

    @cache
    def moment(at: tuple[int, ...]) -> Any:
        """E Π x_a over the ascending indices a in ``at``."""
        if not at:
            return 1.0
        a, total = at[0], 0.0
        for b in sorted(set(at[1:])):
            k = at.index(b, 1)
            rest = at[1:].count(b) * moment(at[1:k] + at[k + 1 :])
            total = total + np.multiply.outer(covariance[a, b], rest)
        return total

    at = tuple(np.repeat(np.arange(len(powers)), powers).tolist())
    return 0.0 if len(at) % 2 else moment(at)
