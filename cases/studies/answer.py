"""An answer to one averaged equation, and its distance from another in every norm of a study."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from fpk.density import Array
from fpk.quadrature import panel_rule

POINTS = {1: 16, 2: 10}
"""Gauss points a panel and axis of the norms, by the number of axes: at the kinks of |p_a − p_b|
they miss about 1/points² of it, far less than what separates one order from another."""
NORMS = ("L1", "L2", "max")
FUNCTIONALS = ("mean energy", "integral of p²")
"""Moments of a density: E H (of two energies, E H1 + E H2), and ∫p²."""


@dataclass(frozen=True, eq=False)
class Answer:
    """A density of one or two energies: smooth between ``panels``, zero beyond them.

    ``l1_error`` is its own estimate of its L1 error; ``unknowns`` the degrees of freedom solved
    for; ``variant`` says which of several ways a route took, empty where it has one.
    """

    panels: tuple[Array, ...]
    density: Callable[..., Array]
    l1_error: float
    unknowns: int
    variant: str = ""


def errors(answer: Answer, reference: Answer) -> dict[str, float]:
    """Return the L1, L2 and largest distance of two densities, and the errors of the moments.

    L1 is ∫|p_h − p| over all energies at which either is known.
    """
    panels = [
        np.unique(np.concatenate(pair))
        for pair in zip(answer.panels, reference.panels, strict=True)
    ]
    mesh, weights = _grid(panels)
    p, q = answer.density(*mesh), reference.density(*mesh)
    values = np.abs(p - q), (p - q) ** 2, (p - q) * sum(mesh), (p - q) * (p + q)
    L1, square, *moments = (_integral(v, weights) for v in values)
    norms = dict(zip(NORMS, (L1, square**0.5, float(np.max(values[0]))), strict=True))
    return norms | dict(zip(FUNCTIONALS, map(abs, moments), strict=True))


def sizes(answer: Answer) -> dict[str, float]:
    """Return the norms and moments of a density itself: its distances from zero."""
    return errors(replace(answer, density=lambda *H: 0.0 * sum(H)), answer)


def functionals(answer: Answer) -> dict[str, float]:
    """Return E H and ∫p² of an answer."""
    own = sizes(answer)
    return {key: own[key] for key in FUNCTIONALS}


def _grid(panels: Sequence[Array]) -> tuple[list[Array], list[Array]]:
    """Gauss points of every axis, shaped to be broadcast together, and their weights."""
    rules = [panel_rule(nodes, POINTS[len(panels)]) for nodes in panels]
    mesh = np.meshgrid(*(x.ravel() for x, _ in rules), indexing="ij", sparse=True)
    return list(mesh), [w.ravel() for _, w in rules]


def _integral(values: Array, weights: list[Array]) -> float:
    for w in reversed(weights):
        values = values @ w
    return float(values)
