"""The chain of elements of one energy: its equations, solved along it from H = 0 upwards.

At the ends of the elements an equation (zM + A) f = load is one of conductances in series and
admittances to ground. Eliminated from one side, all terms of all sums have one sign (z > 0), or
lie in one sector of the complex plane: nothing cancels, whatever range the density spans.
"""

from typing import Any, NamedTuple

import numpy as np

from fpk.arrays import EPS, SMALLEST, Array, Complexes
from fpk.line.time.modes import Modes

Numbers = np.ndarray[tuple[Any, ...], np.dtype[Any]]
"""Real numbers, or complex ones where the Laplace variables are."""
UNDERFLOW = SMALLEST / EPS
"""Below it numbers lose digits."""


class Solution(NamedTuple):
    """f = low h_0 + high h_1 + Σ inner_j v_j in each element.

    ``low`` and ``high`` (elements, …) are f at its ends, ``inner`` (elements, modes, …) are of the
    v_j of ``Modes`` as they are, or, of a resolvent, turned as in ``Modes.diagonal``.
    """

    low: Numbers
    high: Numbers
    inner: Numbers


def loads(e: Modes, f: Solution) -> tuple[Array, Array]:
    """Return ∫π f h_a (elements, 2) and ∫π f v_j (elements, modes) in the units of the elements."""
    low, high = f.low, f.high
    at_ends = np.stack(
        [e.mass[:, 0] * low + e.mass[:, 1] * high, e.mass[:, 1] * low + e.mass[:, 2] * high], axis=1
    )
    at_ends += np.einsum("eva,ev->ea", e.coupling, f.inner)
    inner = e.coupling[:, :, 0] * low[:, None] + e.coupling[:, :, 1] * high[:, None]
    inner += np.einsum("evw,ew->ev", e.gram, f.inner)
    return at_ends, inner


def inverse(e: Modes, at_ends: Array, inner: Array) -> Solution:
    """Return (−L)⁻¹ of a load, 0 at the right end of the last element: first passage."""
    steps, own = e.steps.tolist(), at_ends.sum(axis=1).tolist()
    below, current = 0.0, np.empty(e.count)
    for k in range(e.count):
        current[k] = below
        if k + 1 < e.count:
            below = (below + own[k]) * steps[k]
    current += at_ends[:, 0]
    drop = np.zeros(e.count)
    drop[1:] = current[1:] / e.conductance[1:]
    ends = np.append(np.cumsum(drop[::-1])[::-1], 0.0)
    return Solution(ends[:-1], ends[1:], inner)


class Admittances(NamedTuple):
    """Elements at the Laplace variables z: every array (elements, …, points).

    ``series`` is the conductance of an element from end to end and ``shunt`` (elements, 2, …) what
    flows off at each of its ends; ``damped`` is 1 + zν of its own modes, ``coupling`` their
    ∫π v_j h_a.
    """

    z: Numbers
    series: Numbers
    shunt: Numbers
    damped: Numbers
    coupling: Array


def admittances(e: Modes, z: Numbers) -> Admittances:
    """Return the elements at the Laplace variables ``z`` (points,)."""
    nu, turn = e.diagonal
    coupling = np.einsum("evw,eva->ewa", turn, e.coupling)
    damped = 1.0 + nu[:, :, None] * z
    both = coupling.sum(axis=2)
    pairs = np.stack(
        [coupling[:, :, 0] * coupling[:, :, 1], *(coupling[:, :, a] * both for a in (0, 1))]
    )
    sums = np.einsum("aev,evz->aez", pairs, 1.0 / damped)
    series = e.conductance[:, None] - z * (e.mass[:, 1, None] - z * sums[0])
    shunt = z * (e.load[:, :, None] - z * np.moveaxis(sums[1:], 0, 1))
    return Admittances(z, series, shunt, damped, coupling)


def resolvent(
    e: Modes, y: Admittances, at_ends: Array, inner: Array, *, absorbing: bool = False
) -> Solution:
    """Return p/π of (z − L*) p = load, each element's in units of 1/e^``log_scale``: a density.

    The load is physical, ``inner`` that of the modes turned as in ``Modes.diagonal``. No flux
    leaves at either end, or the right one is ``absorbing``.
    """
    relaxed = inner[:, :, None] / y.damped
    source = at_ends[:, :, None] - y.z * np.einsum("eva,evz->eaz", y.coupling, relaxed)
    s = eliminated(e, y)
    current = np.zeros_like(s.total)
    for k in range(1, e.count):
        current[k] = s.ratio[k - 1] * current[k - 1] + source[k - 1, 1] + source[k, 0]
    low, high = np.empty_like(current), np.empty_like(current)
    high[-1] = (s.ratio[-1] * current[-1] + source[-1, 1]) / (s.passed[-1] + y.shunt[-1, 1])
    if absorbing:
        high[-1] = 0.0
    for k in range(e.count - 1, 0, -1):
        low[k] = s.ratio[k] * high[k] + current[k] / s.total[k]
        high[k - 1] = low[k] * e.steps[k - 1]
    low[0] = high[0]
    coupled = y.coupling[:, :, :1] * low[:, None] + y.coupling[:, :, 1:] * high[:, None]
    return Solution(low, high, relaxed - y.z * coupled / y.damped)


def residual(e: Modes, y: Admittances, f: Solution, at_ends: Array, inner: Array) -> float:
    """Return what ``resolvent`` leaves of its equations at the nodes, relative to their terms."""
    relaxed = inner[:, :, None] / y.damped
    source = at_ends[:, :, None] - y.z * np.einsum("eva,evz->eaz", y.coupling, relaxed)
    low, high = y.series * f.low, y.series * f.high
    right = np.array([high, -low, y.shunt[:, 1] * f.high, -source[:, 1]])[:, :-1]
    left = np.array([low, -high, y.shunt[:, 0] * f.low, -source[:, 0]])[:, 1:]
    terms = np.concatenate([right, left])
    size = np.maximum(np.abs(terms).sum(axis=0), UNDERFLOW)
    return float((np.abs(terms.sum(axis=0)) / size).max())


def kept(e: Modes, f: Solution) -> Complexes:
    """Return ∫p of a density that ``resolvent`` gives, (points,)."""
    turn = e.diagonal[1]
    own = np.einsum("ewv,ew->ev", turn, e.coupling.sum(axis=2))
    return np.asarray(
        e.load[:, 0] @ f.low + e.load[:, 1] @ f.high + np.einsum("ev,evz->z", own, f.inner)
    )


def lifted(e: Modes, y: Admittances, end: Complexes) -> Solution:
    """Return f of (z − L) f = 0 that is ``end`` (points,) at the right end of the last element."""
    ratio = eliminated(e, y).ratio
    high = np.empty_like(ratio)
    high[-1] = end
    for k in range(e.count - 1, 0, -1):
        high[k - 1] = ratio[k] * high[k]
    low = ratio * high
    low[0] = high[0]
    coupled = y.coupling[:, :, :1] * low[:, None] + y.coupling[:, :, 1:] * high[:, None]
    return Solution(low, high, -y.z * coupled / y.damped)


class Eliminated(NamedTuple):
    """The chain below each element eliminated; every array (elements, points).

    ``total`` is the admittance at its left end, its own conductance included, ``ratio`` the share
    of that conductance in it, by which the right end acts on the left one, and ``passed`` what of
    the rest is seen through it from the right. The first element conducts nothing.
    """

    total: Numbers
    ratio: Numbers
    passed: Numbers


def eliminated(e: Modes, y: Admittances) -> Eliminated:
    """Return the elements of the chain, each with all below it eliminated."""
    s = Eliminated(np.ones_like(y.series), np.zeros_like(y.series), np.zeros_like(y.series))
    for k in range(1, e.count):
        below = (s.passed[k - 1] + y.shunt[k - 1, 1]) * e.steps[k - 1] + y.shunt[k, 0]
        s.total[k] = below + y.series[k]
        s.total[k, s.total[k] == 0.0] = SMALLEST  # at an eigenvalue of the part below
        s.ratio[k] = y.series[k] / s.total[k]
        s.passed[k] = below * s.ratio[k]
    return s


def values(e: Modes, f: Solution, x: Array, *, turned: bool = False) -> Array:
    """Return f at the points x, (points, …)."""
    k, h, v = e.shapes(x)
    if turned:
        v = np.einsum("xv,xvw->xw", v, e.diagonal[1][k])
    h = h.reshape(-1, *(1,) * (f.low.ndim - 1))
    rise = f.high[k] - f.low[k]
    return np.asarray(f.low[k] + h * rise + np.einsum("xv,xv...->x...", v, f.inner[k]))


def amplified(e: Modes, f: Solution, x: Array) -> Array:
    """Return the size of what cancels in the own modes of the elements at the points x.

    Round-off is relative to it: at H = 0, where π vanishes, the v_j may be large.
    """
    k, _, v = e.shapes(x)
    return np.asarray(np.linalg.norm(v, axis=1) * np.linalg.norm(f.inner[k], axis=1))
