"""An answer to one averaged equation, and its distance from another in every norm of a study."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from fpk.density import Array
from fpk.quadrature import panel_rule

POINTS = {1: 16, 2: 10}
"""Gauss points a panel and axis of the norms, by the number of axes: of |p_a − p_b| they miss
about 1/points² at its kinks, far less than what tells one order from another."""
NORMS = ("L1", "L2", "max")
FUNCTIONALS = ("mean energy", "integral of p²")
"""Moments of a density: E H (of two energies, E H1 + E H2), and ∫p²."""


@dataclass(frozen=True, eq=False)
class Answer:
    """A density of one or two energies: smooth between ``panels``, zero beyond them.

    ``l1_error`` is its own estimate of its L1 error; ``made`` says how it was made where a route
    has several ways.
    """

    panels: tuple[Array, ...]
    density: Callable[..., Array]
    l1_error: float
    unknowns: int
    degree: int = 0
    made: str = ""


def errors(answer: Answer, reference: Answer) -> dict[str, float]:
    """Return the L1, L2 and largest distance of two densities, and the errors of the moments.

    L1 is ∫|p_h − p| over all energies that either knows.
    """
    grids = [
        panel_rule(np.unique(np.concatenate(pair)), POINTS[len(answer.panels)])
        for pair in zip(answer.panels, reference.panels, strict=True)
    ]
    mesh = np.meshgrid(*(x.ravel() for x, _ in grids), indexing="ij", sparse=True)
    weights = [w.ravel() for _, w in grids]
    mine, true = answer.density(*mesh), reference.density(*mesh)
    difference = mine - true
    energy = sum(mesh[1:], start=mesh[0])
    found = {
        "L1": _integral(np.abs(difference), weights),
        "L2": float(np.sqrt(_integral(difference**2, weights))),
        "max": float(np.max(np.abs(difference))),
        FUNCTIONALS[0]: abs(_integral(difference * energy, weights)),
        FUNCTIONALS[1]: abs(_integral(difference * (mine + true), weights)),
    }
    return found


def functionals(answer: Answer) -> dict[str, float]:
    """Return E H and ∫p² of an answer."""
    grids = [panel_rule(nodes, POINTS[len(answer.panels)]) for nodes in answer.panels]
    mesh = np.meshgrid(*(x.ravel() for x, _ in grids), indexing="ij", sparse=True)
    weights = [w.ravel() for _, w in grids]
    p = answer.density(*mesh)
    energy = sum(mesh[1:], start=mesh[0])
    return {
        FUNCTIONALS[0]: _integral(p * energy, weights),
        FUNCTIONALS[1]: _integral(p * p, weights),
    }


def _integral(values: Array, weights: list[Array]) -> float:
    total = values
    for w in reversed(weights):
        total = total @ w
    return float(total)
