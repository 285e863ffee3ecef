"""Observed orders of convergence, their classes, Richardson extrapolation, grid convergence index.

Sources: P. J. Roache, J. Fluids Eng. 116, 1994, 405; W. L. Oberkampf and C. J. Roy, Verification
and Validation in Scientific Computing, 2010, sections 8.5-8.7.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import isnan, log2, nan
from typing import Literal

import numpy as np

from fpk.numeric.arrays import Array

Kind = Literal["asymptotic", "pre-asymptotic", "at the floor", "oscillating", "diverging"]

NEAR_THEORY = 0.15
"""Distance of an observed order from theory that counts as reaching it."""
STEADY = 0.25
"""Share by which the rate of exponential convergence may drop from one level to the next."""
ABOVE_FLOOR = 10.0
"""Times the floor above which an error gives an order: the floor moves it by 0.14 at most."""
TRUSTED = 0.1
"""Relative distance of the observed order from theory up to which the safety factor is 1.25."""
LIMITS = (
    "The index is an error bar, not a bound: it rests on three levels, on a constant ratio of their"
    " sizes and on one leading power of h. Where the solution is not smooth, or the levels have not"
    " reached that power, the true error may lie outside it, factor 3 or not."
)


def observed_orders(sizes: Sequence[float], errors: Sequence[float]) -> Array:
    """Return ln(e_k/e_k+1)/ln(h_k/h_k+1) of consecutive levels, (levels − 1,).

    ``sizes`` h_k descend; ``errors`` are e_k, of any sign. NaN stands beside an error of 0. For
    exponential convergence, e ~ exp(−γ x), give h = exp(−x): the order then is γ.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        orders = np.diff(np.log(np.abs(errors))) / np.diff(np.log(sizes))
    return np.asarray(np.where(np.isfinite(orders), orders, nan))


@dataclass(frozen=True)
class Convergence:
    """Observed orders of a sequence of errors, and the class of the sequence by them.

    ``orders`` are between consecutive levels above the floor, ``order`` the median of the last
    three and ``spread`` half their range, NaN without ``orders``; ``theory`` None stands for
    exponential convergence.
    """

    orders: tuple[float, ...]
    order: float
    spread: float
    theory: float | None
    kind: Kind


def convergence(
    sizes: Sequence[float], errors: Sequence[float], *, theory: float | None, floor: float
) -> Convergence:
    """Classify the ``errors`` of levels from coarse to fine with mesh ``sizes`` h.

    ``floor`` is the error below which the reference resolves nothing.

    "at the floor": an error is at most ``ABOVE_FLOOR`` times it. "diverging": the last error is
    not below the first, or some error is not finite. "oscillating": an error rises between two of
    the last four levels. "asymptotic": the last two orders are within ``NEAR_THEORY`` of
    ``theory``; if that is None (exponential convergence), the rate does not drop by more than
    ``STEADY``. Else "pre-asymptotic".
    """
    low = np.flatnonzero(np.asarray(errors) <= ABOVE_FLOOR * floor)
    above = int(low[0]) if low.size else len(errors)
    orders = observed_orders(sizes[:above], errors[:above])
    last = orders[-3:]
    order, spread = (np.median(last), 0.5 * np.ptp(last)) if last.size else (nan, nan)
    kind: Kind = "pre-asymptotic"
    if low.size:
        kind = "at the floor"
    elif not np.all(np.isfinite(errors)) or errors[-1] >= errors[0]:
        kind = "diverging"
    elif np.any(last < 0.0):
        kind = "oscillating"
    elif orders.size > 1:
        steady = theory is None and orders[-1] >= (1.0 - STEADY) * orders[-2]
        if steady or (theory is not None and np.all(np.abs(orders[-2:] - theory) <= NEAR_THEORY)):
            kind = "asymptotic"
    return Convergence(tuple(orders.tolist()), float(order), float(spread), theory, kind)


@dataclass(frozen=True)
class GridConvergence:
    """Richardson's value of a functional and the grid convergence index of the finest level.

    ``observed`` is the order of the differences of three levels, ``used`` the order of the
    extrapolation; ``index`` is absolute, in units of the functional.
    """

    value: float
    observed: float
    used: float
    safety: float
    index: float
    kind: Kind


def grid_convergence(values: Sequence[float], *, theory: float, floor: float) -> GridConvergence:
    """Return f₁ + (f₁ − f₂)/(2ᵖ − 1) and F |f₁ − f₂|/(2ᵖ − 1) from the three finest levels.

    ``values`` of a functional are on three or more meshes, each the bisection of the previous mesh.

    F = 1.25 and p = ``theory`` if the observed order is within ``TRUSTED`` of it ("asymptotic");
    else F = 3 and p is the observed order, between 0.5 and theory (Oberkampf and Roy, Table 8.1).
    Differences that grow are "diverging"; differences that change sign, "oscillating", have no
    order, and p = 0.5. The index is at least the ``floor``, and 3 times it if the last difference
    is within it.
    """
    coarse, fine = values[-3] - values[-2], values[-2] - values[-1]
    if abs(fine) <= floor:
        return GridConvergence(values[-1], nan, theory, 3.0, 3.0 * floor, "at the floor")
    kind: Kind = "asymptotic"
    observed = log2(coarse / fine) if coarse / fine > 0 else nan
    used, safety = theory, 1.25
    if not abs(observed - theory) <= TRUSTED * theory:
        used, safety = (0.5 if isnan(observed) else float(np.clip(observed, 0.5, theory))), 3.0
        kind = "diverging" if observed < 0.0 else "pre-asymptotic"
    if isnan(observed):
        kind = "oscillating"
    step = fine / (2.0**used - 1.0)
    index = max(safety * abs(step), floor)
    return GridConvergence(values[-1] - step, observed, used, safety, index, kind)
