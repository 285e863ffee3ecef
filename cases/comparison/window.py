"""Points at which transient densities are compared and drawn: where each is, found by looking."""

from collections.abc import Sequence
from dataclasses import fields, replace
from typing import Any

import numpy as np

from cases.scene.questions import TransientQuestion
from fpk.arrays import Array
from fpk.errors import InvalidInput, NotApplicable, NotCertified
from fpk.method import silent
from fpk.system import System
from sim.montecarlo import LEAST_PATHS

POINTS = 129
"""Points in the window of one time."""

DECADES, MANY = (-8.0, 3.0), 4401
"""Energies that are looked at, in decades of their scale, and how many points."""

REACH = 12.0
"""Displacements and momenta that are looked at, in units of their scale."""

SHOWN = 1e-3
"""Share of the largest density below which it lies outside the window of its time."""

SCOUT = {"paths": LEAST_PATHS, "seconds": None, "checkpoint": None, "partial": False}
"""Settings of a simulation that is run to see where the densities are."""

TOL = 1e-3
"""Error with which a solver is asked for that."""


def window_of(
    system: System, question: TransientQuestion, methods: Sequence[Any]
) -> tuple[Array, tuple[Any, ...]]:
    """Return ascending points, and of each time the indices of the ``POINTS`` in its window.

    By the first of ``methods`` that answers; none at all where none does.
    """
    at = _wide(system, question)
    for method in methods:
        known = {f.name for f in fields(method)}
        quick = replace(method, **{k: v for k, v in SCOUT.items() if k in known})
        asked = system, question.of, question.start, np.array(question.times), (at,)
        try:
            answer = quick.transient(
                *asked, tol=None if method.route.sampled else TOL, progress=silent
            )
        except (NotApplicable, NotCertified, InvalidInput):
            continue
        grids = [_window(at, p) for p in answer.values]
        points = np.unique(np.concatenate(grids))
        return points, tuple(np.searchsorted(points, grid) for grid in grids)
    return at, ()


def _wide(system: System, question: TransientQuestion) -> Array:
    """Points over all scales of the coordinate: those of the noise, or of the start."""
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
    inside = np.flatnonzero(density > SHOWN * density.max())
    if not inside.size:
        raise NotCertified("no density is seen at any energy or displacement of the scene's scale")
    low, high = max(inside[0] - 1, 0), min(inside[-1] + 1, at.size - 1)
    return np.linspace(at[low], at[high], POINTS)
