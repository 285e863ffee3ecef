"""Quadrature points of the elements of one energy, and the shape functions there."""

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fpk.line.elements import gauss_rule, shape_functions

Array = NDArray[np.float64]

ENRICHMENT = 2
"""Degrees by which the comparison solution exceeds the answer."""
MORE_POINTS = 8
"""Points by which integrals over an element that begins where contact does exceed the others."""


class Rule(NamedTuple):
    """Points of an element, of [0, 1], and what shape functions are there.

    At the Gauss points ``share`` (points,) with their ``weight`` the flux is tested, for the answer
    and for the enriched solution; ``phi``, ``dphi`` (points, degree + 1) are shape functions and
    slopes of the answer, ``enriched_phi``, ``enriched_dphi`` of the enriched solution, whose mass
    is integrated with ``enriched_weight``, an interpolation at all points but one: how far the two
    masses differ shows what T lacks of being a polynomial, and exceeds the error of the Gauss rule.
    """

    share: Array
    weight: Array
    enriched_weight: Array
    phi: Array
    dphi: Array
    enriched_phi: Array
    enriched_dphi: Array


class ContactRule(NamedTuple):
    """Points for the mass of an element that begins where contact does, enriched ones last.

    Gauss points in (H − H_c)^⅓: in √(H − H_c) T is smooth, but stiff contact leaves a layer just
    above H_c, which asks for more points there. Without clearance, or with very little beside a
    stiff stop, T has other roots and both rules converge algebraically: twice as many points keep
    less than half of the error for any power of H − H_c from ½ on. ``phi`` are the shape functions
    of the answer at its own points, ``enriched_phi`` of the enriched solution at its own,
    ``compared`` of the enriched solution at the answer's.
    """

    share: Array
    weight: Array
    phi: Array
    enriched_phi: Array
    compared: Array


@lru_cache
def element_rule(degree: int) -> Rule:
    """Return the points of elements of ``degree``."""
    share, weight = gauss_rule(degree + ENRICHMENT)
    return Rule(
        share,
        weight,
        _without_one(share),
        *_shapes(degree, share),
        *_shapes(degree + ENRICHMENT, share),
    )


@lru_cache
def contact_rule(degree: int) -> ContactRule:
    """Return the points for masses of elements of ``degree`` that begin where contact does."""
    own = gauss_rule(degree + MORE_POINTS)
    enriched = gauss_rule(2 * (degree + MORE_POINTS))
    t, w = (np.concatenate(part) for part in zip(own, enriched, strict=True))
    share, count = t**3, own[0].size
    return ContactRule(
        share,
        3.0 * t**2 * w,
        _shapes(degree, share[:count])[0],
        _shapes(degree + ENRICHMENT, share[count:])[0],
        _shapes(degree + ENRICHMENT, share[:count])[0],
    )


def _without_one(share: Array) -> Array:
    """Weights at the points, 0 at the middle one, exact for as many degrees as are left."""
    kept = np.arange(share.size) != share.size // 2
    vandermonde = np.polynomial.legendre.legvander(2.0 * share[kept] - 1.0, share.size - 2)
    moments = np.zeros(share.size - 1)
    moments[0] = 1.0
    weight = np.zeros(share.size)
    weight[kept] = np.linalg.solve(vandermonde.T, moments)
    return weight


def _shapes(degree: int, share: Array) -> tuple[Array, Array]:
    value, slope = shape_functions(degree, share)
    return np.ascontiguousarray(value.T), np.ascontiguousarray(slope.T)
