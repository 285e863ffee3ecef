"""Elements of one energy solved one by one, and scaled to a continuous density of mass one."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fpk.line.elements import Form, LocalSolutions, gauss_rule, local_density, local_solutions
from fpk.process import Coefficients, DiffusionProcess

Array = NDArray[np.float64]

ENRICHMENT = 2
"""Degrees by which the comparison solution exceeds the answer."""


class SolvedElements(NamedTuple):
    """Solved elements, each array or record indexed by element; concatenated as the mesh grows."""

    left: Array
    right: Array
    base: LocalSolutions
    better: LocalSolutions
    values: Array  # densities of mass 1 at the Gauss points, of the answer ...
    better_values: Array  # ... and of the enriched twin
    coefficient_error: Array  # largest relative error of the coefficients


def solve_elements(
    process: DiffusionProcess, left: Array, right: Array, degree: int, form: Form
) -> SolvedElements:
    """Solve the elements between ``left`` and ``right`` in ``degree`` and in the enriched one."""
    # Each degree has its own Gauss points, so that their distance shows quadrature errors too.
    degrees = (degree, degree + ENRICHMENT)
    grids = [left[:, None] + (right - left)[:, None] * gauss_rule(k)[0] for k in degrees]
    flat = process.coefficients(np.concatenate([grid.ravel() for grid in grids]))
    c, finer = (
        Coefficients(*(part.reshape(grid.shape) for part in parts))
        for grid, parts in zip(
            grids,
            zip(*(np.split(part, [grids[0].size]) for part in flat), strict=True),
            strict=True,
        )
    )
    base = local_solutions(c, right - left, degree, form)
    better = local_solutions(finer, right - left, degree + ENRICHMENT, form)
    values, better_values = (
        local_density(c, local, rule=degree, form=form) for local in (base, better)
    )
    error = c.relative_error.max(axis=1)
    return SolvedElements(left, right, base, better, values, better_values, error)


def merged(old: SolvedElements, new: SolvedElements, keep: NDArray[np.bool_]) -> SolvedElements:
    """Return the elements of ``old`` to ``keep`` and the ``new`` ones, ascending."""
    order = np.argsort(np.concatenate([old.left[keep], new.left]))

    def joined(a: Array, b: Array) -> Array:
        return np.concatenate([a[keep], b])[order]

    def record(a: LocalSolutions, b: LocalSolutions) -> LocalSolutions:
        fields = ("u", "log_factor", "residual", "net_flux", "one_way")
        return LocalSolutions(*(joined(getattr(a, f), getattr(b, f)) for f in fields))

    return SolvedElements(
        left=joined(old.left, new.left),
        right=joined(old.right, new.right),
        base=record(old.base, new.base),
        better=record(old.better, new.better),
        values=joined(old.values, new.values),
        better_values=joined(old.better_values, new.better_values),
        coefficient_error=joined(old.coefficient_error, new.coefficient_error),
    )


def _chain(local: LocalSolutions) -> tuple[Array, Array, Array]:
    """Signs and logs of the elements' scales of u, and logs of their masses.

    The scales make u continuous, the masses sum to one, and where mass is most u is positive.
    """
    leaving, entering = local.u[:-1, 1], local.u[1:, 0]
    tiny = np.finfo(float).tiny
    steps = np.log(np.maximum(np.abs(leaving), tiny)) - np.log(np.maximum(np.abs(entering), tiny))
    log_scale = np.concatenate([[0.0], np.cumsum(steps)])
    sign = np.concatenate([[1.0], np.cumprod(np.where(leaving * entering < 0, -1.0, 1.0))])
    log_mass = log_scale + local.log_factor
    top = np.argmax(log_mass)
    sign *= sign[top]
    total = log_mass[top] + np.log(np.sum(sign * np.exp(log_mass - log_mass[top])))
    return sign, log_scale - total, log_mass - total


@dataclass(frozen=True, eq=False)
class Assembled:
    """The elements scaled to one density of mass 1, beside their enriched twin.

    ``u``, ``log_scale`` (and the same of the twin) as in ``StationarySolution``; ``share`` the mass
    of each element, ``p`` (elements, points) the density at the Gauss points with ``weights``;
    ``distance`` ∫|p − p_enriched| of each element, and ``indicator`` what of it is its own making.
    """

    u: Array
    log_scale: Array
    enriched_u: Array
    enriched_log_scale: Array
    share: Array
    weights: Array
    p: Array
    distance: Array
    indicator: Array


def assembled(e: SolvedElements, degree: int) -> Assembled:
    """Scale the elements to a global solution."""
    sign, scale, log_mass = _chain(e.base)
    better_sign, better_scale, better_log_mass = _chain(e.better)
    weights = (e.right - e.left)[:, None] * gauss_rule(degree)[1]
    share, better_share = sign * np.exp(log_mass), better_sign * np.exp(better_log_mass)
    p = e.values * share[:, None]
    better = e.better_values * better_share[:, None]
    shape = np.abs(share) * np.sum(weights * np.abs(e.values - e.better_values), axis=1)
    # A wrong step between two neighbours moves the smaller of the masses on its sides.
    step = np.abs(np.diff(log_mass) - np.diff(better_log_mass))
    below = np.cumsum(np.abs(share))[:-1]
    moved = step * np.minimum(below, np.maximum(1.0 - below, 0.0))
    return Assembled(
        u=sign[:, None] * e.base.u,
        log_scale=scale,
        enriched_u=better_sign[:, None] * e.better.u,
        enriched_log_scale=better_scale,
        share=share,
        weights=weights,
        p=p,
        distance=np.sum(weights * np.abs(p - better), axis=1),
        indicator=shape + np.append(moved, 0.0) + np.append(0.0, moved),
    )
