"""An answer to one averaged equation, and its distance from another in every norm of a study."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from fpk.density import Array, gauss_grid, integral

Nodes = tuple[Array, ...]

NORMS = ("L1", "L2", "max")
FUNCTIONALS = ("mean energy", "integral of p²")
"""Moments of a density: E H (of two energies, E H1 + E H2), and ∫p²."""


@dataclass(frozen=True, eq=False)
class Answer:
    """A density of one or two energies: smooth between ``panels``, zero beyond them.

    ``l1_error`` is its own estimate of its L1 error; ``unknowns`` the degrees of freedom solved
    for; ``variant`` says which of several ways a route took, empty where it has one.
    """

    panels: Nodes
    density: Callable[..., Array]
    l1_error: float
    unknowns: int = 0
    variant: str = ""


def errors(answer: Answer, reference: Answer) -> dict[str, float]:
    """Return the L1, L2 and largest distance of two densities, and the errors of the moments.

    L1 is ∫|p_h − p| over all energies at which either is known.
    """
    mesh, grids = gauss_grid(list(map(np.union1d, answer.panels, reference.panels)))
    p, q = answer.density(*mesh), reference.density(*mesh)
    values = np.abs(p - q), (p - q) ** 2, (p - q) * sum(mesh), (p - q) * (p + q)
    L1, square, *moments = (integral(v, grids) for v in values)
    norms = dict(zip(NORMS, (L1, square**0.5, float(np.max(values[0]))), strict=True))
    return norms | dict(zip(FUNCTIONALS, map(abs, moments), strict=True))


def sizes(answer: Answer) -> dict[str, float]:
    """Return the norms and moments of a density itself: its distances from zero."""
    return errors(replace(answer, density=lambda *H: 0.0 * sum(H)), answer)
