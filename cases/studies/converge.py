"""The convergence study of a scene: every averaged equation, and the simulation."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from time import perf_counter
from typing import Any

from cases.scene.errors import BadInput
from cases.scene.scene import Scene
from cases.studies.equations import EQUATIONS
from cases.studies.ladders import Ladder, degree_ladder, ladders
from cases.studies.levels import Equation
from cases.studies.orders import LIMITS
from cases.studies.weak import SampleSlope, WeakOrder, sample_slope, weak_order
from fpk.errors import NotApplicable, NotCertified
from fpk.method import Progress, silent
from fpk.observable import observable_name
from sim.montecarlo import MonteCarlo

SIMULATION = MonteCarlo().route.method
SCHEMES_STUDIED = ("exact_flow", "baoab", "euler_maruyama")
SECONDS = 10.0
"""Processor time that the steps of one scheme may take where the resolution wanted needs more."""


@dataclass
class ConvergenceStudy:
    """All that was measured for a scene; ``refusals`` are routes that do not apply, with reason.

    ``equations`` holds the ladders of each equation, the p-ladder among them. ``without_contact``
    is the p-ladder of (24) of the same system with its contacts taken away: it shows whether a kink
    at the contact energy costs the exponential convergence.
    """

    scene: Scene
    equations: list[tuple[Equation, tuple[Ladder, ...]]] = field(default_factory=list)
    without_contact: Ladder | None = None
    schemes: list[WeakOrder] = field(default_factory=list)
    samples: SampleSlope | None = None
    refusals: dict[str, str] = field(default_factory=dict)
    seconds: float = 0.0

    @property
    def ladders(self) -> list[tuple[str, Ladder]]:
        """Every ladder with the name of its equation."""
        pairs = [(e.name, ladder) for e, own in self.equations for ladder in own]
        if self.without_contact is not None:
            pairs.append(
                (f"{self.without_contact.equation.name} without contact", self.without_contact)
            )
        return pairs

    @property
    def problems(self) -> tuple[str, ...]:
        """Every estimate that is below the true error, in words."""
        return tuple(
            f"{where}, {ladder.name}, {level.settings}: the estimate {level.estimate:.2g} is below"
            f" the true L1 error {level.error:.2g}"
            for where, ladder in self.ladders
            for level in ladder.levels
            if not level.honest
        )

    def record(self) -> dict[str, Any]:
        """Return the study as ``plain`` takes it."""
        return {
            "scene": self.scene.name,
            "equations": [
                {
                    "theory": e.theory,
                    "equation": e.name,
                    "observable": observable_name(e.observable),
                    "dimension": e.dimension,
                    "reference": e.reference_words,
                    "reference_error": e.reference.l1_error,
                    "by_tolerance": e.words,
                    "ladders": [ladder.record() for ladder in own],
                }
                for e, own in self.equations
            ],
            "without_contact": self.without_contact and self.without_contact.record(),
            **{key: getattr(self, key) for key in ("schemes", "samples", "refusals", "seconds")},
            "limits_of_the_index": LIMITS,
        }


def chosen_routes(route: str | None, of: str | None) -> tuple[str, ...]:
    """Return the routes asked for by name or by observable; raise ``BadInput`` for another."""
    known = (*EQUATIONS, SIMULATION)
    if route is not None and route not in known:
        raise BadInput(f"--route {route}: use one of {', '.join(known)}")
    by_name = (route,) if route else known
    if of is None:
        return by_name
    theory = next((name for name, (observable, _) in EQUATIONS.items() if observable == of), None)
    if theory is None:
        raise BadInput(f'--of "{of}": use H for (24) or H1,H2 for (17)')
    if theory not in by_name:
        raise BadInput(f'--of "{of}": not what --route {route} solves')
    return (theory,)


def study_convergence(
    scene: Scene,
    routes: Sequence[str],
    *,
    seconds: float = SECONDS,
    seed: int = 1,
    threads: int | None = None,
    progress: Progress = silent,
) -> ConvergenceStudy:
    """Measure how the errors of ``routes`` fall; ``seconds`` is for the steps of each scheme.

    Of several routes those that do not apply are named with the reason; one alone raises
    ``NotApplicable`` or ``NotCertified``.
    """
    start, system, study = perf_counter(), scene.system, ConvergenceStudy(scene)
    for route in routes:
        try:
            if route == SIMULATION:
                method = MonteCarlo(seed=seed, threads=threads)
                for scheme in SCHEMES_STUDIED:
                    own = replace(method, scheme=scheme)
                    study.schemes.append(weak_order(system, own, seconds=seconds))
                    progress(len(study.schemes), len(SCHEMES_STUDIED), f"steps of {scheme}")
                study.samples = sample_slope(system, method)
                continue
            _, make = EQUATIONS[route]
            equation = make(system)
            study.equations.append((equation, ladders(equation, progress=progress)))
            if equation.dimension == 1 and system.contacts:
                study.without_contact = degree_ladder(make(replace(system, contacts=())))
        except (NotApplicable, NotCertified) as reason:
            if len(routes) == 1:  # it was asked for, and there is nothing else to show
                raise
            study.refusals[route] = str(reason)
    study.seconds = perf_counter() - start
    return study
