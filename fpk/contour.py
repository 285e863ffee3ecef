"""Inverse Laplace transforms of functions whose singularities lie on the negative real axis."""

from dataclasses import dataclass
from math import acosh, ceil, log, pi, sin

import numpy as np

from fpk.arrays import EPS, Array, Complexes

SPREAD = 10.0
"""Largest ratio of the times that share one contour: 75 points, where one time has 46."""
PHI = 0.5
"""Inclination of the hyperbola. Faster converging ones (1.17) lie flat along the negative axis,
where the transform of what has drifted for a time t_0 grows as e^(−z t_0): that cancels to
less than a millionth where many masses start from rest."""
GROWTH = 6.0
"""z t where the contour crosses the real axis, times 1/(1 − sin φ): e^3.1 multiplies round-off."""


@dataclass(frozen=True, eq=False)
class Contour:
    """Points ``z`` and ``weights`` (points,) for f(t) = Im Σ e^(z t) w F(z) at ``times``.

    The trapezoidal rule on the hyperbola z(θ) = μ (1 + sin(iθ − φ)) around the negative real axis,
    of which the half with Im z > 0 is enough: f is real. For errors of the rule and of where it
    ends see J. A. C. Weideman and L. N. Trefethen, Math. Comp. 76 (2007) 1341, section 4. ``index``
    are the places of the times among those asked for.
    """

    times: Array
    index: np.ndarray[tuple[int, ...], np.dtype[np.intp]]
    z: Complexes
    weights: Complexes

    @property
    def factors(self) -> Complexes:
        """e^(z t) w, (times, points)."""
        return np.asarray(np.exp(np.multiply.outer(self.times, self.z)) * self.weights)


def contours(times: Array, *, more: int = 0) -> list[Contour]:
    """Return contours for ``times`` > 0 in any order, with ``more`` points than round-off asks."""
    order, found = np.argsort(times, kind="stable"), []
    while order.size:
        first = times[order[0]]
        together = order[times[order] <= SPREAD * first]
        order = order[together.size :]
        last = float(times[together[-1]])
        z, weights = _hyperbola(last, last / float(first), more)
        found.append(Contour(times[together], together, z, weights))
    return found


def _hyperbola(last: float, spread: float, more: int) -> tuple[Complexes, Complexes]:
    """Points and weights for times from ``last``/``spread`` to ``last``.

    The rule errs by e^(μt − 2πφ/h), and ends where e^(z t) is round-off at the first time.
    """
    digits, mu = -log(EPS), GROWTH / last
    step = 2.0 * pi * PHI / (GROWTH + digits)
    points = ceil(acosh((digits * spread + GROWTH) / (GROWTH * sin(PHI))) / step) + more
    theta = step * (points - more) / points * (np.arange(points) + 0.5)
    z = mu * (1.0 + np.sin(1j * theta - PHI))
    weights = step * (points - more) / points / pi * mu * 1j * np.cos(1j * theta - PHI)
    return z, weights
