"""Meshes of one energy: where they end, and how they follow the coefficients."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fpk.errors import NotCertified
from fpk.process import DiffusionProcess, log_density_slope

Array = NDArray[np.float64]

NATS_PER_ELEMENT = 3.0
"""Fall of ln(p/T) over one element: exp(−3 t) is met by degree 10 to 1e-11."""
GRADING = 0.15
"""Ratio of neighbouring lengths towards a point where smoothness is lost."""
GRADED_LAYERS = 5
SAGITTA = 1.0
"""Largest (d²ln(p H)/d(ln H)²)·(Δ ln H)² between two points of a survey: eight times what ln p H
may rise above its chord. Asked for where p is within exp(−``DEEP``) of its maximum."""
DEEP = 100.0
SURVEY_ROUNDS = 20


@dataclass(frozen=True, eq=False)
class Survey:
    """Coarse look at the coefficients, from which a mesh starts; the answer does not rest on it.

    ``slope`` is d ln p/dH and ``roughness`` |d ln(p/T)/dH| at ``energy``, all (points,).
    """

    energy: Array
    slope: Array
    roughness: Array


def survey(process: DiffusionProcess) -> Survey:
    """Evaluate the slopes on a grid from far below to far above the process's energy scale."""
    grid = np.concatenate([np.logspace(-3.0, 0.0, 10), np.logspace(0.0, 4.0, 60)[1:]])
    view = _looked_at(process, process.energy_scale * grid)
    return _closer(process, view) if process.state_damping else view


def _looked_at(process: DiffusionProcess, energy: Array) -> Survey:
    c = process.coefficients(energy)
    return Survey(energy, log_density_slope(c), np.abs(2.0 * c.dissipation / c.diffusion))


def _closer(process: DiffusionProcess, view: Survey) -> Survey:
    """Add points until no maximum of p can hide between two of them: it may be narrow."""
    for _ in range(SURVEY_ROUNDS):
        log_mass = _log_mass(view)
        bulk = np.maximum(log_mass[1:], log_mass[:-1]) > log_mass.max() - DEEP
        rate = 1.0 + view.energy * view.slope
        bent = np.abs(np.diff(rate)) * np.diff(np.log(view.energy)) > SAGITTA
        i = np.flatnonzero(bulk & bent)
        if not i.size:
            break
        new = _looked_at(process, np.sqrt(view.energy[i] * view.energy[i + 1]))
        view = Survey(
            np.insert(view.energy, i + 1, new.energy),
            np.insert(view.slope, i + 1, new.slope),
            np.insert(view.roughness, i + 1, new.roughness),
        )
    return view


def _log_mass(view: Survey) -> Array:
    """ln of p H at the points of the survey, up to a constant."""
    # In the variable ln H, where the slope varies slowly: d ln(p H)/d ln H = 1 + H d ln p/dH.
    rate = 1.0 + view.energy * view.slope
    steps = 0.5 * (rate[1:] + rate[:-1]) * np.diff(np.log(view.energy))
    return np.concatenate([[0.0], np.cumsum(steps)])


def truncation_energy(view: Survey, tail: float) -> float:
    """Return an energy beyond which about the share ``tail`` of the probability lies.

    The solver bounds the tail again from its own solution. Raises ``NotCertified`` where the
    density does not fall to that share.
    """
    log_mass = _log_mass(view)
    depth = log_mass - log_mass.max()
    beyond = np.flatnonzero((depth < np.log(tail)) & (view.energy > view.energy[depth.argmax()]))
    if not beyond.size:
        raise NotCertified(
            "the density does not fall off: damping does not balance the noise at high energy"
        )
    i = beyond[0]
    share = (np.log(tail) - depth[i - 1]) / (depth[i] - depth[i - 1])
    return float(view.energy[i - 1] * (view.energy[i] / view.energy[i - 1]) ** share)


def initial_nodes(view: Survey, end: float, nonsmooth: tuple[float, ...]) -> Array:
    """Return nodes from 0 to ``end``: on the nonsmooth energies, dense where p/T varies fast.

    Geometric layers lie above every nonsmooth energy (below it, the density is smooth up to it).
    """
    energy = np.linspace(0.0, end, 65)
    rate = np.interp(energy, view.energy, view.roughness) / NATS_PER_ELEMENT
    steps = 0.5 * (rate[1:] + rate[:-1]) * energy[1]
    count = np.concatenate([[0.0], np.cumsum(steps)])
    levels = np.linspace(0.0, count[-1], max(int(np.ceil(count[-1])), 2) + 1)
    nodes = np.interp(levels, count, energy)
    fixed = np.array(nonsmooth)
    fixed = fixed[fixed < end]
    for H in fixed:
        spacing = np.diff(nodes)[min(int(np.searchsorted(nodes, H)), nodes.size - 1) - 1]
        nodes = nodes[(np.abs(nodes - H) > 0.3 * spacing) | (nodes == 0.0) | (nodes == end)]
    nodes = np.unique(np.concatenate([nodes, fixed]))
    layers = GRADING ** np.arange(1.0, GRADED_LAYERS + 1.0)
    for H in fixed:
        gap = nodes[np.searchsorted(nodes, H, side="right")] - H
        nodes = np.unique(np.concatenate([nodes, H + gap * layers]))
    return nodes


def split_points(left: Array, right: Array, special: Array) -> Array:
    """Return where to cut elements in two: towards a special point they begin at, else half-way."""
    share = np.where(np.isin(left, special), GRADING, 0.5)
    return left + share * (right - left)


def e_fold(view: Survey, end: float) -> float:
    """Return the mean energy over which p/T changes by the factor e, below ``end``."""
    inside = view.energy < end
    energy = np.concatenate([[0.0], view.energy[inside], [end]])
    nats = float(np.trapezoid(np.interp(energy, view.energy, view.roughness), energy))
    return end / nats


def tail_bound(view: Survey, end: float, density_at_end: float) -> float:
    """Return a bound of the mass above ``end``: p(end) over the least rate at which p falls there.

    The rate is that of the survey above ``end``, and taken not to drop below it further out.
    """
    # The least rate may be that at the end itself, between two points of the survey.
    at_end = -float(np.interp(end, view.energy, view.slope))
    rate = float(np.min(-view.slope[view.energy >= end], initial=at_end))
    return density_at_end / rate if 0.0 < rate < np.inf else float("inf")
