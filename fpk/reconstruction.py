"""Weights that turn the contents of bins into the density at a point, free of the bins' width.

About a point x the density is taken as ``p = r(y) Σ_k c_k y^k``, k up to ``DEGREE``, r a reference
of nearly the same steepness. The c_k are fitted to the *contents* of the bins nearby, integrals of
p, not to values at their middles (least squares, with weights that fall to zero at the radius of
the window, so that the estimate is continuous but for the steepness of r). Given r, it is a linear
function of the bins, exact for bins of any width where p/r is such a polynomial: what is left is of
order (radius · width)^(``DEGREE`` + 1) of the derivatives of p/r. Local polynomials with a
parametric start: Hjort and Glad, Ann. Stat. 23, 1995, 882; Fan and Gijbels, Local Polynomial
Modelling, 1996.
"""

from collections.abc import Callable

import numpy as np
from numpy.polynomial.polynomial import polyvander

from fpk.arrays import Array, Integers
from fpk.quadrature import gauss_legendre, panel_rule

LogReference = Callable[[Array], Array]
"""ln r of one coordinate, but for a constant; smooth where p is, with the kinks of p at stops.
Where there are none it is ``numpy.zeros_like``."""

DEGREE = 4
"""Degree of the local polynomial. Even: at the middle of a window the next odd one is for free."""

LEAST_RADIUS, RADIUS = 4, 10
"""Radius of a window in bins: a fortieth of the axis between these limits, 10 of 1024 and 4 of 128.
The variance is then that of the mean of five bins, and of two."""

NODES = 5
"""Gauss points of a bin: round-off of the integrals while ln r changes by 2 within it."""

STEEPENED = 3
"""Newton steps for the steepness of the reference: a stop as narrow as three bins needs a second,
where the temperature is wrong by a factor 2; what a third adds is below the noise."""


def radius_of(bins: int) -> int:
    """Return the radius of a window, in bins, on an axis of ``bins``."""
    return max(1, min(max(bins // 40, LEAST_RADIUS), RADIUS, bins // 2))


def windows(edges: Array, x: Array) -> Integers:
    """Return the bins (points, window) about each ``x`` (points,); ``edges`` are equidistant."""
    bins = edges.size - 1
    window = min(2 * radius_of(bins) + 1, bins)
    middle = np.floor((x - edges[0]) / (edges[1] - edges[0])).astype(np.int64)
    first = np.clip(middle - window // 2, 0, bins - window)
    return np.asarray(first[:, None] + np.arange(window))


def local_fit(
    edges: Array, x: Array, index: Integers, held: Array, *, log_reference: LogReference
) -> tuple[Array, Array]:
    """Return the weights of the bins ``index`` = ``windows(edges, x)`` in the density at ``x``.

    The density at a point is the sum of the bins' mean densities times these (points, window). Also
    returned are the shares of a window's samples that the reference expects in each bin, in sum
    one. ``held`` (points, window) are the samples that there are, by which the reference is made as
    steep as p is: r^s exp(t y).
    """
    width = edges[1] - edges[0]
    radius = radius_of(edges.size - 1) * width
    # At the ends of the axis the window stays inside, and x leaves its middle.
    half = radius + 0.5 * width
    middle = np.clip(x, edges[0] + half, max(edges[-1] - half, edges[0] + half))
    nodes, w = panel_rule(edges, NODES)
    u, at_x = (nodes[index] - middle[:, None, None]) / radius, (x - middle) / radius
    log_r, log_r_at_x = log_reference(nodes)[index], log_reference(x)
    # Zero where a bin leaves the window as x moves on.
    kernel = np.maximum(1.0 - (u.mean(axis=2) * (radius / half)) ** 2, 0.0) ** 2
    power, tilt = _steepness(held, log_r, u, kernel)
    log_r = power[:, None, None] * log_r + tilt[:, None, None] * u
    log_r_at_x = power * log_r_at_x + tilt * at_x
    largest = log_r.max(axis=(1, 2))
    r = w[index] / width * np.exp(log_r - largest[:, None, None])
    content = r.sum(axis=2)
    # The variance of what a bin holds is in proportion to that: rows of least squares.
    scale = np.sqrt(np.divide(kernel, content, out=np.zeros_like(kernel), where=content > 0.0))
    degree = min(DEGREE, index.shape[1] - 1)
    rows = scale[..., None] * np.einsum("pbg,pbgk->pbk", r, polyvander(u, degree))
    value = np.exp(log_r_at_x - largest)[:, None] * polyvander(at_x, degree)
    weights = np.einsum("pk,pkb->pb", value, np.linalg.pinv(rows)) * scale
    return weights, content / content.sum(axis=1, keepdims=True)


def _steepness(held: Array, log_r: Array, u: Array, kernel: Array) -> tuple[Array, Array]:
    """Return s and t such that r^s exp(t u) is about as steep as what the windows ``held``.

    Least squares of logarithms, bins weighted by what they hold; half a sample more in each: in an
    empty window the reference becomes flat.
    """
    held = held + 0.5
    scale = np.sqrt(kernel * held)
    mean = log_r.mean(axis=2)
    ones = np.ones_like(mean)
    columns = scale[..., None] * np.stack([ones, u.mean(axis=2), mean - mean[:, :1]], axis=2)
    # Of two columns in proportion, or one that is zero, the solution of least norm.
    inverse, weights = np.linalg.pinv(columns), gauss_legendre(NODES)[1]
    power, tilt = np.ones(len(u)), np.zeros(len(u))
    for _ in range(STEEPENED):
        tried = power[:, None, None] * log_r + tilt[:, None, None] * u
        top = tried.max(axis=2)
        content = np.exp(tried - top[..., None]) @ weights  # no overflow of a steep reference
        excess = scale * (np.log(held) - top - np.log(content))
        _, more_tilt, more_power = np.einsum("pkb,pb->kp", inverse, excess)
        power, tilt = power + more_power, tilt + more_tilt
    return power, tilt
