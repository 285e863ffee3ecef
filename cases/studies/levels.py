"""Levels of refinement of one averaged equation, each measured against a reference.

A study is a loop: ``refined_levels`` solves, measures the error, and goes on with ``refined()``.
Convergence and cost differ only in what they do with the levels.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from math import exp, inf, nan, sqrt
from typing import Literal

import numpy as np

from cases.studies.timing import Timing, timed_first
from fpk.density import Array, gauss_grid, integral

NORMS = ("L1", "L2", "max")
FUNCTIONALS = ("mean energy", "integral of p²")
"""Moments of a density: E H (of two energies, E H1 + E H2), and ∫p²."""


@dataclass(frozen=True, eq=False)
class Answer:
    """A density of one or two energies: smooth between ``panels``, zero beyond them.

    ``l1_error`` is its own estimate; ``variant`` says which of several ways a route took.
    """

    panels: tuple[Array, ...]
    density: Callable[..., Array]
    l1_error: float
    unknowns: int = 0
    variant: str = ""

    def errors(self, reference: "Answer") -> dict[str, float]:
        """Return the L1, L2 and largest distance to ``reference``, and the errors of the moments.

        L1 is ∫|p_h − p| over all energies at which either is known.
        """
        mesh, grids = gauss_grid(list(map(np.union1d, self.panels, reference.panels)))
        p, q = self.density(*mesh), reference.density(*mesh)
        values = np.abs(p - q), (p - q) ** 2, (p - q) * sum(mesh), (p - q) * (p + q)
        L1, square, *moments = (integral(v, grids) for v in values)
        norms = dict(zip(NORMS, (L1, square**0.5, float(np.max(values[0]))), strict=True))
        return norms | dict(zip(FUNCTIONALS, map(abs, moments), strict=True))

    def sizes(self) -> dict[str, float]:
        """Return the norms and moments of the density itself: its distances from zero."""
        return replace(self, density=lambda *H: 0.0 * sum(H)).errors(self)


@dataclass(frozen=True)
class Level:
    """One level of refinement or one setting of a route, as it was measured.

    ``error`` is the L1 error, of a simulation the expected one; ``errors`` those by norm and
    moment; ``stated`` the answer's own estimate. ``distance`` is the L1 distance to the reference,
    ``estimate`` the largest that both errors allow; ``size`` as in ``observed_orders``.
    ``promised`` is the tolerance asked for, if any; ``modelled``: computed by the law of sampling.
    """

    settings: str
    error: float
    stated: float
    timing: Timing
    distance: float = nan
    estimate: float = nan
    unknowns: int = 0
    size: float = nan
    errors: dict[str, float] = field(default_factory=dict)
    functionals: dict[str, float] = field(default_factory=dict)
    promised: float = inf
    modelled: bool = False
    label: str = ""

    @property
    def seconds(self) -> float:
        """Median processor time."""
        return self.timing.seconds

    @property
    def honest(self) -> bool:
        """Whether the distance to the reference is allowed."""
        return self.distance <= self.estimate


@dataclass(frozen=True, eq=False)
class Discretisation:
    """One level of a family of discretisations of one equation.

    ``name`` is the family's: in "h" elements of ``degree`` are halved, in "p" the degree grows, in
    "tol" the tolerance falls. ``settings``, ``size`` and ``promised`` are those of ``Level``.
    """

    family: Literal["h", "p", "tol"]
    name: str
    settings: str
    solve: Callable[[], Answer]
    refined: Callable[[], "Discretisation"]
    size: float = nan
    promised: float = inf
    degree: int | None = None


def refined_levels(
    first: Discretisation, reference: Answer, count: int
) -> Iterator[tuple[Discretisation, Level]]:
    """Yield ``count`` discretisations from coarse to fine, each with what was measured.

    Sizes are h; or, so that the order is a rate of exponential convergence, exp(−p) and
    exp(−√unknowns): nats of error a degree, or a unit of √unknowns. Raises what the solvers raise.
    """
    setting = first
    for k in range(count):
        setting = setting.refined() if k else first
        answer, seconds = timed_first(setting.solve)
        distances, moments = answer.errors(reference), answer.sizes()
        words = ", ".join(filter(None, (setting.settings, answer.variant)))
        level = Level(
            settings=words,
            error=distances["L1"],
            stated=answer.l1_error,
            timing=Timing(seconds),
            distance=distances["L1"],
            estimate=answer.l1_error + reference.l1_error,
            unknowns=answer.unknowns,
            size=exp(-sqrt(answer.unknowns)) if first.family == "tol" else setting.size,
            errors=distances,
            functionals={key: moments[key] for key in FUNCTIONALS},
            promised=setting.promised,
            label=words,
        )
        yield setting, level
