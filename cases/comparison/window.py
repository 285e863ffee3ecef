"""Points at which transient densities are compared and drawn, where a quick solution is large."""

from collections.abc import Sequence
from dataclasses import fields, replace
from functools import partial
from typing import Any

import numpy as np

from cases.comparison.budget import Budget
from cases.scene.questions import TransientQuestion
from fpk.arrays import Array
from fpk.errors import InvalidInput, NotApplicable, NotCertified
from fpk.method import silent
from fpk.system import System
from sim.montecarlo import LEAST_PATHS

POINTS = 129
"""Points in the window of one time."""

DECADES, MANY = (-8.0, 3.0), 4401
"""Range of energies of the quick solution, in decades of the energy scale, and its points."""

REACH = 12.0
"""Largest displacement or momentum of the quick solution, in units of its scale."""

SHOWN = 1e-3
"""Share of the largest density below which it lies outside the window of its time."""

SCOUT = {"paths": LEAST_PATHS, "checkpoint": None, "partial": False}
"""Settings of a simulation by which windows are chosen."""

TOL = 1e-3
"""Tolerance of a solver by which windows are chosen."""


def window_of(
    system: System, question: TransientQuestion, methods: Sequence[Any], budget: Budget
) -> tuple[Array, tuple[Any, ...]]:
    """Return ascending points, and of each time the indices of the ``POINTS`` in its window.

    By the first of ``methods`` that answers, within the ``budget``; none at all where none does.
    """
    at = _wide(system, question)
    for method in methods:
        known = {f.name for f in fields(method)}
        quick = replace(method, **{k: v for k, v in SCOUT.items() if k in known})
        asked = system, question.of, question.start, np.array(question.times), (at,)
        try:
            work = partial(_transient, asked, None if method.route.sampled else TOL)
            answer = budget.spend(quick, work)
            grids = [_window(at, p) for p in answer.values]
        except (NotApplicable, NotCertified, InvalidInput):
            continue  # its reason is that of its answer, which is asked for later
        points = np.unique(np.concatenate(grids))
        return points, tuple(np.searchsorted(points, grid) for grid in grids)
    return at, ()


def _transient(asked: Any, tol: float | None, method: Any) -> Any:
    return method.transient(*asked, tol=tol, progress=silent)


def _wide(system: System, question: TransientQuestion) -> Array:
    """Points up to the largest scale of the coordinate, that of the noise or that of the start."""
    (coordinate,) = question.of
    damping, noise = np.diag(system.damping), np.diag(system.noise_matrix)
    warm = noise.sum() / damping.sum() if damping.sum() > 0.0 else noise.sum()
    values = question.start.values
    energy = float(max(warm, 1e-300) * max(1.0, values.get("noise", 1.0)))
    energy = max([energy, *(v for k, v in values.items() if k.startswith("H"))])
    if question.start.kind == "state":
        energy = max(energy, float(system.hamiltonian(*question.start.state(system.n))))
    if coordinate.kind == "H":
        return np.concatenate([[0.0], energy * np.logspace(*DECADES, MANY)])
    row = coordinate.row
    unit = system.mass[row] if coordinate.kind == "p" else system.compliance[row, row]
    return np.linspace(-REACH, REACH, MANY) * float(np.sqrt(2.0 * energy * unit))


def _window(at: Array, density: Array) -> Array:
    """``POINTS`` points over the part of ``at`` in which the density is above ``SHOWN``."""
    inside = np.flatnonzero(density > SHOWN * density.max())
    if not inside.size:
        raise NotCertified("no density is seen at any energy or displacement of the scene's scale")
    low, high = max(inside[0] - 1, 0), min(inside[-1] + 1, at.size - 1)
    return np.linspace(at[low], at[high], POINTS)
