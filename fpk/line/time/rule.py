"""Points of the integrals over one element of an energy, where π is no polynomial."""

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.polynomial.legendre import legint, legvander
from scipy.special import roots_jacobi

from fpk.arrays import Array
from fpk.quadrature import gauss_legendre

MORE_POINTS = 6
"""Gauss points of an element beyond its degree: π is no polynomial."""
CONTACT_POINTS = 8
"""Points beyond three times the degree, in the cubic root of H − H_c, above a contact energy."""
MOST_POWERS = 7
"""Powers of H in π that the points of Gauss and Legendre integrate beside a polynomial."""


class Rule(NamedTuple):
    """Points ``t`` and weights on [0, 1], the Legendre polynomials there, and what integrates.

    ``running`` (points, points) integrates up to each point, ``total`` over all. ``values``
    (points, degree + 1) are P_0 … P_degree at ``t``, ``antiderivative`` (degree + 1, degree) the
    Legendre coefficients of ∫_0^t P_j.
    """

    t: Array
    weight: Array
    running: Array
    total: Array
    values: Array
    antiderivative: Array


@lru_cache
def rule(degree: int, contact: bool, steepness: int) -> Rule:
    """Return the points of an element of ``degree``; ``contact`` of one that begins at contact.

    Where π ~ t^``steepness`` with more than a few powers they are those of Gauss and Jacobi; over
    such an element, which is short, what else varies is linear.
    """
    count = 3 * degree + CONTACT_POINTS if contact else degree + MORE_POINTS
    if steepness > MOST_POWERS and not contact:
        x, w = roots_jacobi(count, 0, steepness)
        t = 0.5 * (1.0 + x)
        weight = np.exp(np.log(w) - (steepness + 1) * np.log(2.0) - steepness * np.log(t))
        total = np.full(count, 1.0 / count)
        running = t[:, None] * total
    else:
        x, w = gauss_legendre(count)
        s = 0.5 * (1.0 + x)
        t, stretch = (s**3, 3.0 * s**2) if contact else (s, np.ones(count))
        project = (np.arange(count) + 0.5)[:, None] * (legvander(x, count - 1).T * w)
        running = 0.5 * legvander(x, count) @ legint(project, lbnd=-1.0) * stretch
        total = weight = 0.5 * w * stretch
    return Rule(
        t=t,
        weight=weight,
        running=running,
        total=total,
        values=np.asarray(legvander(2.0 * t - 1.0, degree), dtype=float),
        antiderivative=np.asarray(0.5 * legint(np.eye(degree), lbnd=-1.0, axis=0), dtype=float),
    )
