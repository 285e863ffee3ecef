"""What the deterministic routes of one averaged equation cost: checked first, then timed."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from math import inf

import numpy as np

from cases.studies.answer import Answer, errors
from cases.studies.equations import Equation
from cases.studies.ladders import TOLERANCES, h_meshes
from cases.studies.names import BY_TOL, QUADRATURE, elements
from cases.studies.priced import NotTimed, Point, Priced
from cases.studies.timing import timed_first, timing
from fpk.errors import InvalidInput, NotApplicable, NotCertified
from fpk.method import Progress, silent

DEGREES = (1, 2, 4, 8)
LEVELS = {1: 7, 2: 5}
LONGEST = 0.4
"""Seconds of one solve beyond which a route is not refined further: the next takes up to ten times
as long in two dimensions."""
TIMED_TOLERANCES = TOLERANCES[1::2]


@dataclass(frozen=True)
class Candidate:
    """A route before it is checked: its settings from coarse to fine, and how each is solved.

    ``by_tol``: the settings are tolerances.
    """

    route: str
    settings: tuple[tuple[str, Callable[[], Answer]], ...]
    by_tol: bool = False


def candidates(equation: Equation) -> tuple[Candidate, ...]:
    """Return elements in h, the solver steered by tol, and quadrature where there is one."""
    found = []
    for degree in DEGREES:
        meshes = h_meshes(equation, degree, LEVELS[equation.dimension])
        steps = [
            (
                f"{m[0].size - 1}{'²' * (equation.dimension - 1)}",
                partial(equation.on_mesh, m, degree),
            )
            for m in meshes
        ]
        found.append(Candidate(elements(degree), tuple(steps)))
    by_tol = [(f"{tol:.0e}", partial(equation.adaptive, tol)) for tol in TIMED_TOLERANCES]
    found.append(Candidate(BY_TOL[equation.dimension], tuple(by_tol), by_tol=True))
    if equation.quadrature is not None:
        solve = equation.quadrature
        by_tol = [(f"{tol:.0e}", partial(solve, tol)) for tol in TIMED_TOLERANCES]
        found.append(Candidate(QUADRATURE, tuple(by_tol), by_tol=True))
    return tuple(found)


def priced(
    equation: Equation, offered: Sequence[Candidate], *, progress: Progress = silent
) -> tuple[list[Priced], list[NotTimed]]:
    """Check every answer of every route against the reference; time those routes that agree.

    An answer agrees if its L1 distance is within its own estimate and that of the reference. A
    route with one answer that does not, or with none at all, is named and not timed.
    """
    good: list[Priced] = []
    bad: list[NotTimed] = []
    for k, candidate in enumerate(offered):
        progress(k, len(offered), f"cost of {equation.name}")
        found = _priced(equation, candidate)
        if isinstance(found, Priced):
            good.append(found)
        else:
            bad.append(found)
    progress(len(offered), len(offered), f"cost of {equation.name}")
    return good, bad


def _priced(equation: Equation, candidate: Candidate) -> Priced | NotTimed:
    checked = []
    for settings, solve in candidate.settings:
        try:
            answer, first = timed_first(solve)
        except (NotCertified, NotApplicable, InvalidInput, np.linalg.LinAlgError) as error:
            nan = float("nan")
            return NotTimed(candidate.route, equation.name, settings, nan, nan, str(error))
        true = errors(answer, equation.reference)["L1"]
        allowed = answer.l1_error + equation.reference.l1_error
        if not np.isfinite(allowed):
            words = "states no finite error of its own: its density does not fall off"
            return NotTimed(candidate.route, equation.name, settings, true, allowed, words)
        if not true <= allowed:
            words = f"differs from the {equation.reference_words} by more than both state"
            return NotTimed(candidate.route, equation.name, settings, true, allowed, words)
        checked.append((settings, solve, answer, true, first))
        if first > LONGEST:
            break
    points = tuple(
        Point(settings, true, answer.l1_error, timing(solve, first, equation.coefficients),
              answer.unknowns, promised=float(settings) if candidate.by_tol else inf)
        for settings, solve, answer, true, first in checked
    )  # fmt: skip
    observable = ", ".join(
        "H" if c.index is None else f"H{c.index + 1}" for c in equation.observable
    )
    return Priced(
        candidate.route, equation.name, f"numerical: L1 of p({observable}), {equation.name}", points
    )
