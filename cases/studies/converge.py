"""The convergence study of a scene: every averaged equation, and the simulation."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from time import perf_counter
from typing import Any

from cases.scene.errors import BadInput
from cases.scene.scene import Scene
from cases.studies.equations import EQUATIONS
from cases.studies.ladders import Ladder, degree_ladder, ladders
from cases.studies.orders import LIMITS
from cases.studies.weak import SampleSlope, WeakOrder, sample_slope, weak_order
from fpk.errors import NotApplicable, NotCertified
from fpk.method import Progress, silent
from sim.montecarlo import MonteCarlo

SIMULATION = MonteCarlo().route.method
SCHEMES_STUDIED = ("exact_flow", "baoab", "euler_maruyama")
SECONDS = 10.0
"""Processor time that the steps of one scheme may take where the resolution wanted needs more."""


@dataclass
class ConvergenceStudy:
    """All that was measured for a scene; ``refusals`` are routes that do not apply, with reason.

    ``equations`` describe the averaged equations, each with its ``ladders``. ``without_contact`` is
    the p-ladder of (24) of the same system without its contacts: it shows whether a kink at the
    contact energy costs the exponential convergence.
    """

    scene: Scene
    equations: list[dict[str, Any]] = field(default_factory=list)
    without_contact: Ladder | None = None
    schemes: list[WeakOrder] = field(default_factory=list)
    samples: SampleSlope | None = None
    refusals: dict[str, str] = field(default_factory=dict)
    seconds: float = 0.0

    @property
    def ladders(self) -> list[Ladder]:
        """Every ladder; the one without contacts has that in the name of its equation."""
        ladders = [ladder for e in self.equations for ladder in e["ladders"]]
        if free := self.without_contact:
            ladders.append(replace(free, equation=f"{free.equation} without contact"))
        return ladders

    @property
    def problems(self) -> tuple[str, ...]:
        """Every estimate that is below the true error, in words."""
        return tuple(
            f"{ladder.equation}, {ladder.name}, {level.settings}: the estimate {level.estimate:.2g}"
            f" is below the true L1 error {level.error:.2g}"
            for ladder in self.ladders
            for level in ladder.levels
            if not level.honest
        )

    def record(self) -> dict[str, Any]:
        """Return the study as ``plain`` takes it."""
        return {**vars(self), "scene": self.scene.name, "limits_of_the_index": LIMITS}


def chosen_routes(route: str | None, of: str | None) -> tuple[str, ...]:
    """Return the routes asked for by name or by observable; raise ``BadInput`` for another."""
    known = (*EQUATIONS, SIMULATION)
    if route not in (None, *known):
        raise BadInput(f"--route {route}: use one of {', '.join(known)}")
    if of is None:
        return (route,) if route else known
    theories = tuple(name for name, (observable, _) in EQUATIONS.items() if observable == of)
    if not theories:
        raise BadInput(f'--of "{of}": use H for (24) or H1,H2 for (17)')
    if route not in (None, *theories):
        raise BadInput(f'--of "{of}": not what --route {route} solves')
    return theories


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
            families = ladders(equation, progress=progress)
            study.equations.append({**equation.description(), "ladders": families})
            if equation.dimension == 1 and system.contacts:
                study.without_contact = degree_ladder(make(replace(system, contacts=())))
        except (NotApplicable, NotCertified) as reason:
            if len(routes) == 1:  # it was asked for, and there is nothing else to show
                raise
            study.refusals[route] = str(reason)
    study.seconds = perf_counter() - start
    return study
