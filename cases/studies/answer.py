"""An answer to one averaged equation, on a given mesh or another, and its errors."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from fpk.density import Array, gauss_grid, integral
from fpk.line.stationary import StationarySolution, solve_on_mesh
from fpk.plane.solution import graded
from fpk.plane.stationary import PlaneSolution, solve_plane_on_mesh
from fpk.process import Process

Nodes = tuple[Array, ...]

ELEMENTS = {1: {1: 8, 2: 8, 4: 8, 8: 2}, 2: {1: 4, 2: 3, 3: 3, 4: 2, 8: 1}}
"""Elements an axis of the coarsest mesh, by the number of energies and the degree."""

NORMS = ("L1", "L2", "max")
FUNCTIONALS = ("mean energy", "integral of p²")
"""Moments of a density: E H (of two energies, E H1 + E H2), and ∫p²."""


@dataclass(frozen=True, eq=False)
class Answer:
    """A density of one or two energies: smooth between ``panels``, zero beyond them.

    ``l1_error`` is its own estimate of its L1 error; ``variant`` says which of several ways a
    route took, empty where it has one.
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


def answer_of(s: StationarySolution | PlaneSolution) -> Answer:
    """Return the answer of a solver of one or two energies."""
    if isinstance(s, StationarySolution):
        return Answer((s.nodes,), s.density, s.l1_error, s.unknowns)
    return Answer(s.nodes, s.density, s.l1_error, s.unknowns, "w = 1" if s.weight is None else "")


def solve_on(process: Process, nodes: Nodes, degree: int) -> Answer:
    """Return the answer by elements of one degree on a given mesh."""
    if len(nodes) == 1:
        return answer_of(solve_on_mesh(process, nodes[0], degree))
    return answer_of(solve_plane_on_mesh(process, (nodes[0], nodes[1]), degree))


def given_mesh(process: Process, ends: Sequence[float], degree: int, halvings: int = 0) -> Nodes:
    """Return the nodes of each axis of the coarsest mesh of a degree, its elements then halved.

    Of one energy they are equidistant, with the contact energies among them; of two they are
    equidistant in √H and are halved in it.
    """
    count = ELEMENTS[len(ends)][degree]
    if len(ends) == 2:
        return graded(ends, count * 2**halvings)
    inside = [H for H in process.nonsmooth if ends[0] > H]
    nodes = np.union1d(np.linspace(0.0, ends[0], count + 1), inside)
    for _ in range(halvings):
        nodes = np.sort(np.append(nodes, 0.5 * (nodes[1:] + nodes[:-1])))
    return (nodes,)
