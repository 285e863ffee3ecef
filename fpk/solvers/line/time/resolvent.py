"""The chain of elements of one energy: its equations, solved along it from H = 0 upwards.

At the ends of the elements an equation (zM + A) f = load is one of conductances in series and
admittances to ground. Eliminated from one side, all terms of all sums have one sign (z > 0), or
lie in one sector of the complex plane: nothing cancels, whatever range the density spans.
"""

from itertools import accumulate
from typing import Any

import numpy as np

from fpk.numeric.arrays import EPS, SMALLEST, Array
from fpk.solvers.contour import contours
from fpk.solvers.line.time.elements import Elements, Evolved

Numbers = np.ndarray[tuple[Any, ...], np.dtype[Any]]
"""Real numbers, or complex ones where the Laplace variables are."""


def eliminated(e: Elements, z: Numbers) -> tuple[Numbers, ...]:
    """Return the elements at the Laplace variables ``z`` (points,), each with all below eliminated.

    Every array is (elements, …, points): ``series``, the conductance of an element from end to end;
    ``shunt`` (elements, 2, …), what flows off at each of its ends; ``damped``, 1 + zν of its own
    functions; ``total``, the admittance at its left end, its own conductance included; ``ratio``,
    the share of that conductance in it, by which the right end acts on the left one; ``passed``,
    what of the rest is seen through it from the right. The first element conducts nothing.
    """
    coupling, own = e.mass[:, 2:, :2], e.load[:, 2:]
    damped = 1.0 + e.relaxation[:, :, None] * z
    pairs = np.stack([coupling[:, :, 0] * coupling[:, :, 1], *np.moveaxis(coupling, 2, 0) * own])
    sums = np.einsum("aev,evz->aez", pairs, 1.0 / damped)
    series = e.conductance[:, None] - z * (e.mass[:, 0, 1, None] - z * sums[0])
    shunt = z * (e.load[:, :2, None] - z * np.moveaxis(sums[1:], 0, 1))
    total, ratio, passed = np.ones_like(series), np.zeros_like(series), np.zeros_like(series)
    for k in range(1, e.count):
        below = (passed[k - 1] + shunt[k - 1, 1]) * e.steps[k - 1] + shunt[k, 0]
        total[k] = below + series[k]
        zero = total[k] == 0.0  # at an eigenvalue of the part below
        total[k, zero] = EPS * series[k, zero]
        ratio[k] = series[k] / total[k]
        passed[k] = below * ratio[k]
    return series, shunt, damped, total, ratio, passed


def resolvent(
    e: Elements, z: Numbers, load: Array, end: Numbers | None = None, *, density: bool = True
) -> tuple[Numbers, float]:
    """Return the coefficients f (elements, functions, points) of (z − L) f = ``load``.

    ``end`` (points,) is f at the right end of the last element; None: no flux leaves there. A
    ``density`` is f = p/π of the unit 1/e^``log_scale`` in each element, its load (elements,
    functions) physical; otherwise f has one unit, and the load is ∫π f_i … in the units of the
    elements. Of a density is returned, too, the residual of the equations at the nodes, relative to
    their terms.
    """
    series, shunt, damped, total, ratio, passed = eliminated(e, z)
    coupling = e.mass[:, 2:, :2]
    up, down = (np.ones(e.count - 1), e.steps) if density else (e.steps, np.ones(e.count - 1))
    inner = load[:, 2:, None] / damped
    source = load[:, :2, None] - z * np.einsum("eva,evz->eaz", coupling, inner)
    current = np.zeros_like(total)
    for k in range(1, e.count):
        current[k] = (ratio[k - 1] * current[k - 1] + source[k - 1, 1]) * up[k - 1] + source[k, 0]
    f = np.empty((e.count, e.degree + 1, z.size), dtype=total.dtype)
    low, high = f[:, 0], f[:, 1]
    if end is None:
        end = (ratio[-1] * current[-1] + source[-1, 1]) / (passed[-1] + shunt[-1, 1])
    high[-1] = end
    for k in range(e.count - 1, 0, -1):
        low[k] = ratio[k] * high[k] + current[k] / total[k]
        high[k - 1] = low[k] * down[k - 1]
    low[0] = high[0]
    f[:, 2:] = inner - z * np.einsum("eva,eaz->evz", coupling, f[:, :2]) / damped
    if not density:
        return f, 0.0
    flux = series * high, series * low
    right = np.array([flux[0], -flux[1], shunt[:, 1] * high, -source[:, 1]])[:, :-1]
    left = np.array([flux[1], -flux[0], shunt[:, 0] * low, -source[:, 0]])[:, 1:]
    terms = np.concatenate([right, left])
    # Smaller numbers lose precision in their products with EPS.
    size = np.maximum(np.abs(terms).sum(axis=0), SMALLEST / EPS)
    return f, float((np.abs(terms.sum(axis=0)) / size).max())


def evolved(
    e: Elements, load: Array, times: Array, *, held: float | None = None, more: int = 0,
    density: bool = True,
) -> Evolved:  # fmt: skip
    """Return the coefficients at ``times`` > 0 of what begins with ``load``, as of ``resolvent``.

    Contours have ``more`` points. The last end is ``held`` at a value from the time 0 on; None: no
    flux leaves there.
    """
    values, size = np.zeros((2, times.size, e.count, e.degree + 1))
    residuals = [0.0]
    for c in contours(times, more=more):
        end = None if held is None else held / c.z
        f, residual = resolvent(e, c.z, load, end, density=density)
        values[c.places] = np.einsum("tz,eiz->tei", c.factors, f).imag
        size[c.places] = np.einsum("tz,eiz->tei", np.abs(c.factors), np.abs(f))
        residuals.append(residual)
    return Evolved(e, values, size, float(np.max(residuals)))


def moment(e: Elements, load: Array) -> Array:
    """Return (−L)⁻¹ of a load in the units of the elements, 0 at the right end: first passage."""
    own = zip(load[:, :2].sum(axis=1), e.steps, strict=False)
    below = accumulate(own, lambda current, k: (current + k[0]) * k[1], initial=0.0)
    current = np.fromiter(below, float, e.count) + load[:, 0]
    drop = np.append(current[:0:-1] / e.conductance[:0:-1], 0.0)
    ends = np.append(0.0, np.cumsum(drop))[::-1]
    return np.concatenate([ends[:-1, None], ends[1:, None], load[:, 2:]], axis=1)
