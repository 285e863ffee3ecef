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
    """Points of an element and what shape functions are there.

    ``share`` and ``weight`` (points,) are Gauss points of [0, 1], those of the answer before those
    of its twin; ``phi``, ``dphi`` (points, degree + 1) are shape functions and slopes of the answer
    at its own, ``twin_phi``, ``twin_dphi`` of the twin at its own, ``seen`` of the twin at those of
    the answer.
    """

    share: Array
    weight: Array
    phi: Array
    dphi: Array
    twin_phi: Array
    twin_dphi: Array
    seen: Array


@lru_cache
def element_rule(degree: int) -> Rule:
    """Return the points of elements of ``degree``: each degree has Gauss points of its own."""
    return _rule(degree, *zip(*map(gauss_rule, (degree, degree + ENRICHMENT)), strict=True))


@lru_cache
def contact_rule(degree: int) -> Rule:
    """Return the points for integrals over an element that begins where contact does.

    Gauss points in (H − H_c)^⅓: in √(H − H_c) T is smooth, but stiff contact leaves a layer just
    above H_c, which asks for more points there. Slopes are not needed.
    """
    count = degree + MORE_POINTS
    rules = [gauss_rule(d) for d in (count, count + ENRICHMENT)]
    cubed = [(t**3, 3.0 * t**2 * w) for t, w in rules]
    return _rule(degree, *zip(*cubed, strict=True))


def _rule(degree: int, points: tuple[Array, ...], weights: tuple[Array, ...]) -> Rule:
    own, twin = points
    phi, dphi = _shapes(degree, own)
    twin_phi, twin_dphi = _shapes(degree + ENRICHMENT, twin)
    seen, _ = _shapes(degree + ENRICHMENT, own)
    share, weight = np.concatenate(points), np.concatenate(weights)
    return Rule(share, weight, phi, dphi, twin_phi, twin_dphi, seen)


def _shapes(degree: int, share: Array) -> tuple[Array, Array]:
    value, slope = shape_functions(degree, share)
    return np.ascontiguousarray(value.T), np.ascontiguousarray(slope.T)
