"""The elements of one energy scaled to one continuous density of mass one."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fpk.line.assembly import SolvedElements

Array = NDArray[np.float64]

TINY = float(np.finfo(float).tiny)


class Assembled(NamedTuple):
    """The elements scaled to one density of mass 1, beside the enriched solution.

    ``u`` (elements, degree + 1) has to be multiplied by exp(``log_scale``) (elements,); the same of
    the enriched solution. ``share`` is the mass of each element, ``p`` (elements, points) the
    density at the points of its integrals; ``indicator`` what each element contributes of itself to
    ``distance``, ∫|p − p_enriched|. ``mass`` is ∫p, ``residual`` the largest one, ``net_flux`` the
    largest relative to the largest one-way flux, ``coefficient_error`` the relative error of the
    coefficients, each element's worst counted by its share.
    """

    u: Array
    log_scale: Array
    enriched: Array
    enriched_log_scale: Array
    share: Array
    p: Array
    indicator: Array
    distance: float
    mass: float
    residual: float
    net_flux: float
    coefficient_error: float


def assembled(elements: SolvedElements) -> Assembled:
    """Scale the elements, ascending, to a global solution."""
    s = elements.solved
    sign, log_scale, log_mass = _chained(s.u, s.log_factor)
    other_sign, other_log_scale, other_log_mass = _chained(s.enriched, s.log_factor)
    share, other_share = sign * np.exp(log_mass), other_sign * np.exp(other_log_mass)
    p = share[:, None] * s.values
    distance = np.sum(s.weights * np.abs(p - other_share[:, None] * s.enriched_values))
    size = np.abs(share)
    indicator = size * np.sum(s.weights * np.abs(s.values - s.enriched_values), axis=1)
    # A wrong step between two neighbours moves the smaller of the masses on its sides.
    below = np.cumsum(size)[:-1]
    gap = np.abs(np.diff(log_mass) - np.diff(other_log_mass))
    moved = gap * np.minimum(below, np.maximum(1.0 - below, 0.0))
    indicator[:-1] += moved
    indicator[1:] += moved
    return Assembled(
        u=sign[:, None] * s.u,
        log_scale=log_scale,
        enriched=other_sign[:, None] * s.enriched,
        enriched_log_scale=other_log_scale,
        share=share,
        p=p,
        indicator=indicator,
        distance=float(distance),
        mass=float(np.sum(s.weights * p)),
        residual=float(s.residual.max()),
        net_flux=float(np.max(size * s.net_flux) / np.max(size * s.one_way)),
        coefficient_error=float(size @ elements.coefficient_error),
    )


def _chained(u: Array, log_factor: Array) -> tuple[Array, Array, Array]:
    """Signs and logs of the elements' scales of u, and logs of their masses.

    The scales make u continuous, the masses sum to one, and where mass is most u is positive.
    """
    leaving, entering = u[:-1, 1], u[1:, 0]
    steps = np.log(np.maximum(np.abs(leaving), TINY)) - np.log(np.maximum(np.abs(entering), TINY))
    log_scale = np.append(0.0, np.cumsum(steps))
    sign = np.append(1.0, np.cumprod(np.where((leaving < 0.0) != (entering < 0.0), -1.0, 1.0)))
    log_mass = log_scale + log_factor
    top = int(np.argmax(log_mass))
    sign *= sign[top]
    total = log_mass[top] + np.log(np.sum(sign * np.exp(log_mass - log_mass[top])))
    return sign, log_scale - total, log_mass - total
