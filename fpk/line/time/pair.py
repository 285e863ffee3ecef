"""Meshes of one energy in pairs: of the answer, and of the enriched solution that judges it."""

import math

import numpy as np

from fpk.arrays import Array, Flags
from fpk.line.time.mesh import HIGHEST, NONE
from fpk.line.time.modes import Modes, modes, refined
from fpk.process import Process

ENRICHMENT = 2
"""Degrees by which the enriched solution, of the error estimate, exceeds the answer."""
FEWEST_DIGITS, MORE = 4, 4
"""Digits below which elements have no lower degree, and degrees beyond the digits wanted."""
MOST_ROUNDS = 12
"""Most rounds of cutting elements in two."""
Pair = tuple[Modes, Modes]
"""The elements of the answer and of the enriched solution."""


def degree_for(tol: float) -> int:
    """Return the degree of the elements of an answer to the tolerance ``tol``."""
    return int(np.clip(round(-math.log10(tol)), FEWEST_DIGITS, HIGHEST - MORE)) + MORE


def meshed(process: Process, nodes: Array, degree: int, *, beyond: Array = NONE) -> Pair:
    """Return elements between ``nodes``; those of the enriched solution end at ``beyond``, too."""
    every = np.append(nodes, beyond)
    return (
        modes(process, nodes[:-1], nodes[1:], degree),
        modes(process, every[:-1], every[1:], degree + ENRICHMENT, enriched=True),
    )


def cut(process: Process, pair: Pair, marked: Flags) -> Pair:
    """Return a pair with the elements of the answer that are ``marked`` cut in two in both."""
    more = np.append(marked, np.zeros(pair[1].count - marked.size, dtype=bool))
    return refined(process, pair[0], marked), refined(process, pair[1], more, enriched=True)
