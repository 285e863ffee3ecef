"""Elements of one energy solved one by one, and scaled to a continuous density of mass one."""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fpk.line.elements import Form, LocalSolutions, gauss_rule, local_density, local_solutions
from fpk.process import Coefficients, DiffusionProcess

Array = NDArray[np.float64]

ENRICHMENT = 2
"""Degrees by which the comparison solution exceeds the answer."""
AT_ONCE = 10_000
"""Elements whose coefficients are evaluated at once: a hundred quadrature points for each of ten
energies of each are 80 MB."""


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
    if left.size > AT_ONCE:
        parts = np.array_split(np.arange(left.size), -(-left.size // AT_ONCE))
        return _joined([solve_elements(process, left[k], right[k], degree, form) for k in parts])
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
    joined = _joined([_picked(old, keep), new])
    return _picked(joined, np.argsort(joined.left))


def _picked(e: SolvedElements, index: NDArray[Any]) -> SolvedElements:
    base, better = (
        LocalSolutions(*(getattr(local, f.name)[index] for f in fields(LocalSolutions)))
        for local in (e.base, e.better)
    )
    rest = {name: getattr(e, name)[index] for name in e._fields if name not in ("base", "better")}
    return SolvedElements(base=base, better=better, **rest)


def _joined(parts: Sequence[SolvedElements]) -> SolvedElements:
    def locals_of(name: str) -> LocalSolutions:
        found = [getattr(part, name) for part in parts]
        return LocalSolutions(
            *(np.concatenate([getattr(x, f.name) for x in found]) for f in fields(LocalSolutions))
        )

    names = [name for name in SolvedElements._fields if name not in ("base", "better")]
    rest = {name: np.concatenate([getattr(part, name) for part in parts]) for name in names}
    return SolvedElements(base=locals_of("base"), better=locals_of("better"), **rest)


def _chain(local: LocalSolutions) -> tuple[Array, Array, Array]:
    """Signs and logs of the elements' scales of u, and logs of their masses.

    The scales make u continuous, the masses sum to one, and where mass is most u is positive.
    """
    leaving, entering = local.u[:-1, 1], local.u[1:, 0]
    tiny = np.finfo(float).tiny
    steps = np.log(np.maximum(np.abs(leaving), tiny)) - np.log(np.maximum(np.abs(entering), tiny))
    log_scale = np.concatenate([[0.0], np.cumsum(steps)])
    turned = (leaving < 0.0) != (entering < 0.0)
    sign = np.concatenate([[1.0], np.cumprod(np.where(turned, -1.0, 1.0))])
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
